"""The tracker where each track finds out how noisy each sensor is: a sensor goes bad, and recovers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from candaemon.tracking.obstacles import Obstacles
from tests.support.builders import CYCLE, HandFed, Seen, car, place, states, times

DEVIATION = 0.2
BAD = range(200, 400)
"""Cycles of the burst: 10 s."""
LATE = range(260, 400)
"""Those in which it has been found out."""
WELL = range(600, 700)


class Drive:
    """A vehicle that drives ahead for 35 s, seen by radars of which the first is noisy for a while.

    Args:
        radars: how many; those after the first stay good.
        burst: times its variance the first radar has in the meantime.
        seed: of the noise.
        settings: of the tracker.

    Attributes:
        identities: all that were ever told.
        error: of the place of identity 1 (cycles,), m; NaN where it is not told.
    """

    def __init__(self, *, radars: int, burst: float = 200.0, seed: int = 1, **settings: Any) -> None:
        rng = np.random.default_rng(seed)
        fed = HandFed(noise=(DEVIATION, DEVIATION, 0.12), **settings)
        self.identities: set[int] = set()
        self.error = np.full(700, np.nan)
        for k in range(len(self.error)):
            for radar in range(radars):
                t = CYCLE * k + 0.02 * radar
                scale = np.sqrt(burst) if radar == 0 and k in BAD else 1.0
                x, y = rng.normal(size=2) * DEVIATION * scale
                seen = Seen(7 + radar, 20.0 + 15.0 * t + x, 3.0 + y, 15.0 + rng.normal() * 0.12)
                told = fed.scan(t, [seen], sensor=radar)
                self.identities |= set(told.id.tolist())
            if 1 in told.id:
                at = place(told, 1)
                self.error[k] = np.hypot(at[0] - 20.0 - 15.0 * t, at[1] - 3.0)

    def mean_error(self, cycles: range) -> float:
        """Return the mean error over some cycles, m."""
        return float(self.error[cycles.start : cycles.stop].mean())


def adapting(kind: str, **more: Any) -> dict[str, Any]:
    return {"kind": "imm", "measurement_noise": {"kind": kind, **more}}


WIDE = {"gate": 1000, "id_gate": 1e6}
"""Gates that keep the identity though the noise is fixed."""


def test_the_only_radar_goes_bad_and_recovers() -> None:
    assert len(Drive(radars=1).identities) > 20
    fixed = Drive(radars=1, association=WIDE)
    for kind in ("variational", "window"):
        drive = Drive(radars=1, estimator=adapting(kind))
        assert drive.identities == {1}
        assert drive.mean_error(LATE) < 0.6 * fixed.mean_error(LATE)
        assert drive.mean_error(WELL) < 1.2 * fixed.mean_error(WELL)


@pytest.mark.slow
def test_one_of_two_radars_goes_bad_and_recovers() -> None:
    """Then the other is all that counts."""
    assert len(Drive(radars=2).identities) > 20
    never_bad = Drive(radars=2, burst=1.0)
    for kind in ("variational", "window"):
        drive = Drive(radars=2, estimator=adapting(kind))
        assert drive.identities == {1}
        assert drive.mean_error(LATE) < 1.5 * never_bad.mean_error(LATE)
        assert drive.mean_error(WELL) < 1.2 * never_bad.mean_error(WELL)


def test_an_id_that_jumps_is_still_found_out() -> None:
    """To another vehicle far away, however much the noise may have grown."""
    fed = HandFed(estimator=adapting("variational"))
    for t in times(0, 40):
        fed.scan(t, [car(7, t, 20.0)])
    told: Obstacles | None = None
    for t in times(40, 60):
        told = fed.scan(t, [car(7, t, 60.0), car(8, t, 20.0)])
    assert told is not None
    assert place(told, 1)[0] == pytest.approx(20.0 + 20.0 * 59 * CYCLE, abs=0.2)
    assert len(states(told)) == 2


def test_an_obstacle_that_is_not_confirmed_is_held_to_the_stated_noise() -> None:
    fed = HandFed(estimator=adapting("variational"))
    fed.scan(0.0, [car(7, 0.0, 20.0)])
    told = fed.scan(CYCLE, [car(7, CYCLE, 26.0)])
    assert len(states(told)) == 2


def test_each_radars_id_stands_for_the_obstacle() -> None:
    """Where the noise is found out; one radar renames what it sees, the other's id stays."""
    fed = HandFed(estimator=adapting("variational"))
    for t in times(0, 40):
        fed.scan(t, [car(7, t, 20.0)])
        fed.scan(t + 0.02, [car(3, t + 0.02, 20.0)], sensor=1)
    rows = fed.tracker._tracks.row_of
    assert rows == {(0, 7): 0, (1, 3): 0}
    fed.scan(2.0, [car(9, 2.0, 20.0)])
    assert rows == {(0, 9): 0, (1, 3): 0}
    fed.scan(2.02, [car(9, 2.02, 20.0), car(3, 2.02, 50.0)], sensor=1)
    assert rows[1, 9] == 0
    assert rows[1, 3] == 1
