"""The IMM on the automotive set: the numbers to hold, and the drives they are held on."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.papers.automotive_set import DRIVES, DT, EXPERIMENTS
from candaemon.papers.experiment import Result


@pytest.fixture(scope="module")
def table() -> Result:
    (experiment,) = EXPERIMENTS
    return experiment.run(100, 11, lambda _: None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "position_limit", "velocity_limit"),
    [("cruise", 0.085, 0.087), ("brake", 0.235, 0.49), ("cut-in", 0.17, 0.49), ("turn", 0.165, 0.24)],
)
def test_automotive_set_with_range_rate(table: Result, name: str, position_limit: float, velocity_limit: float) -> None:
    position, velocity, nis = (row for row in table.rows if row.case == name)
    assert position.here <= position_limit
    assert velocity.here <= velocity_limit
    assert 2.7 <= nis.here <= 3.3


@pytest.mark.parametrize(
    ("name", "steps", "last"),
    [
        ("cruise", 400, (20.05, 1.0, -1.0, 0.0)),
        ("brake", 400, (40.0, 1.0, 0.0, 0.0)),
        ("cut-in", 400, (30.0 + 19.95 - 3.0 * 6.45, -0.001, -2.0, 0.0)),
        ("turn", 180, (53.3333 - 10.0 * (8.95 - 3.0 - np.pi / 1.2), 16.6667, -10.0, 0.0)),
    ],
)
def test_a_drive_ends_where_its_pushes_and_turns_take_it(name: str, steps: int, last: tuple[float, ...]) -> None:
    states = DRIVES[name].states()
    assert states.shape == (steps, 4)
    np.testing.assert_array_equal(states[0], DRIVES[name].start)
    np.testing.assert_allclose(np.diff(states[:, :2], axis=0), (states[1:, 2:] + states[:-1, 2:]) * DT / 2, atol=4e-3)
    np.testing.assert_allclose(states[-1], last, atol=2e-3)
