"""What `init` reads from the tables of values of a DBC file."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from candaemon.dbc.types import SignalSpec
from candaemon.wizard.object_table import ObjectColumn
from candaemon.wizard.occupancy import tabled_tests


def column(
    name: str, length: int, choices: Mapping[int, str], *, scale: float = 1.0, offset: float = 0.0
) -> ObjectColumn:
    """Return a signal with a table of values, of which no log is known."""
    return ObjectColumn(name, SignalSpec(name, 0, length, scale=scale, offset=offset, choices=choices), 0, np.zeros(0))


@pytest.mark.parametrize(
    ("text", "gone"),
    [
        ("no_target", True),
        ("No_Object", True),
        ("invalid_coasted_target", True),
        ("empty", True),
        ("slot_unused", True),
        ("empty_trailer", False),
        ("unused_lane", False),
        ("unpredictable", False),
    ],
)
def test_words_that_tell_of_no_object(text: str, gone: bool) -> None:
    valid, _ = tabled_tests([column("State", 1, {0: text, 1: "measured"})])
    assert (valid is not None) == gone


STATE = {0: "no_target", 1: "new", 2: "measured", 3: "predicted"}


@pytest.mark.parametrize(
    "other",
    [
        column("Range", 12, {4095: "invalid", 4094: "init"}),
        column("Dist", 4, {15: "invalid", 14: "init"}),
        column("Range_rms", 2, STATE),
        column("Class", 2, {0: "invalid", 1: "car", 2: "truck", 3: "walker"}),
        column("Kind_Meas", 2, {0: "invalid", 1: "car", 2: "truck", 3: "walker"}),
        column("Score", 1, {0: "invalid", 1: "new"}),
    ],
    ids=lambda each: each.name,
)
def test_the_likeliest_table_is_taken_as_a_guess(other: ObjectColumn) -> None:
    for columns in ([other, column("Obj_State", 2, STATE)], [column("Obj_State", 2, STATE), other]):
        valid, new = tabled_tests(columns, {"Score"})
        assert valid is not None
        assert new is not None
        assert (valid.signal, valid.bound, valid.guess) == ("Obj_State", "in: [1, 2]", True)
        assert (new.signal, new.bound, new.guess) == ("Obj_State", "in: [1]", True)


@pytest.mark.parametrize(
    "alone",
    [
        column("Range", 12, {4095: "invalid", 4094: "init"}),
        column("Dist", 4, {15: "invalid", 14: "init"}),
        column("State_rms", 2, STATE),
        column("Score", 2, STATE),
    ],
    ids=lambda each: each.name,
)
def test_what_is_no_table_of_states_tells_nothing(alone: ObjectColumn) -> None:
    assert tabled_tests([alone], {"Score"}) == (None, None)


@pytest.mark.parametrize(
    ("scale", "offset", "bound"),
    [
        (1.0, 8_388_607.0, "in: [8388608, 8388609]"),
        (1_234_567.0, 0.0, "in: [1234567, 2469134]"),
        (0.1, 0.2, "in: [0.3, 0.4]"),
    ],
)
def test_values_are_written_with_all_their_digits(scale: float, offset: float, bound: str) -> None:
    valid, _ = tabled_tests([column("Obj_State", 2, STATE, scale=scale, offset=offset)])
    assert valid is not None
    assert valid.bound == bound
