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
