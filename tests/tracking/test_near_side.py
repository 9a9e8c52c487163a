"""What lies before the near side of what stands is something else."""

from __future__ import annotations

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
