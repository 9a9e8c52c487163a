"""What lies before the near side of what stands is something else."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.config.sensors import FieldOfView, Mount
from candaemon.radar.mounting import SensorView
from tests.support.builders import HandFedVehicles, Seen, times

AHEAD = SensorView(Mount(x=0.0), FieldOfView(range=100, azimuth_deg=60), 0)
CAR = Seen(1, 12.0, 0.0)
"""The rear of one that stands."""


def obstacles_with(second: Seen, comes: int, lost: int, **reflections: float) -> int:
    """Return how many obstacles there are after 10 s of a car that stands, and of what comes near it.

    Args:
        second: what comes.
        comes: number of the scan in which it does.
        lost: number of scans for which it is not detected in between, which ends the id's reflection.
        reflections: settings.
    """
    fed = HandFedVehicles(views=[AHEAD], reflections=dict(reflections))
    for k, t in enumerate(times(0, 200)):
        seen = k >= comes and not comes + 20 <= k < comes + 20 + lost
        told = fed.scan(t, [CAR, second] if seen else [CAR])
    return len(told)


@pytest.mark.parametrize(
    ("second", "comes", "reflections", "obstacles"),
    [
        (Seen(2, 8.8, 1.0), 100, {}, 2),
        (Seen(2, 8.8, 1.0), 20, {}, 1),
        (Seen(2, 10.8, 1.0), 100, {}, 1),
        (Seen(2, 15.2, 1.0), 100, {}, 1),
        (Seen(2, 8.8, 1.0), 100, {"before": 4.0}, 1),
    ],
    ids=["stops behind it", "was there all the time", "on its rear", "on its front", "as a YAML says"],
)
def test_who_stops_behind_a_car_that_stands_is_no_part_of_it(
    second: Seen, comes: int, reflections: dict[str, float], obstacles: int
) -> None:
    assert obstacles_with(second, comes, 0, **reflections) == obstacles


def test_who_was_told_from_a_car_does_not_merge_with_it_while_not_detected() -> None:
    assert obstacles_with(Seen(2, 8.8, 1.0), 100, 8) == 2


@pytest.mark.parametrize("walks", [1.4, 0.0], ids=["walks", "is a part of it"])
def test_who_walks_past_a_car_that_stopped_beside_us_is_no_part_of_it(walks: float) -> None:
    """Coming out before it, he lies on its course, and nearly stands along the line of sight."""
    fed = HandFedVehicles(views=[AHEAD])
    for t in times(0, 120):
        brakes = min(max(t - 1.0, 0.0), 2.0)
        front, speed = 5.0 * min(t, 1.0) + (5.0 - 1.25 * brakes) * brakes - 5.0, 5.0 - 2.5 * brakes
        car = [Seen(1, front, -2.6, speed), Seen(2, front - 0.5, -2.6, speed)]
        comes = Seen(3, 7.3, -2.7 + walks * (t - 4.0), 0.0, walks)
        told = fed.scan(t, [*car, comes] if t > 4.0 else car, identified=False)
    assert len(told) == (2 if walks else 1)
    at = int(np.argmin(np.hypot(told.x - 5.0, told.y + 2.6)))
    assert np.hypot(told.vx[at], told.vy[at]) < 0.3
    if walks:
        assert told.vy[1 - at] == pytest.approx(walks, abs=0.3)
