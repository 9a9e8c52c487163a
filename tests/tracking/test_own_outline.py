"""What lies on either side of our own vehicle is two."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.config.sensors import FieldOfView, Mount
from candaemon.radar.mounting import SensorView
from candaemon.tracking.own_outline import OwnOutline
from tests.support.builders import HandFedVehicles, Seen, times

CORNERS = [
    SensorView(Mount(x=x, y=y, yaw_deg=yaw), FieldOfView(range=80, azimuth_deg=75), number)
    for number, (x, y, yaw) in enumerate([(3.6, 0.8, 45), (3.6, -0.8, -45), (-0.8, 0.8, 135), (-0.8, -0.8, -135)])
]


@pytest.mark.parametrize(
    ("one", "other", "between"),
    [
        ((1.0, 1.6), (1.2, -1.6), True),
        ((-2.0, 0.0), (5.0, 0.1), True),
        ((4.5, 1.6), (4.5, -1.6), False),
        ((5.0, 0.0), (3.0, 2.0), False),
        ((1.0, 1.6), (1.0, 2.6), False),
        ((1.0, -1.6), (1.0, -1.0), False),
    ],
    ids=["on both sides", "before and behind", "before us", "round a corner", "on the left", "on the right"],
)
def test_our_vehicle_is_where_its_sensors_are(
    one: tuple[float, float], other: tuple[float, float], between: bool
) -> None:
    outline = OwnOutline.around(CORNERS)
    assert outline is not None
    assert outline.lies_between(np.array(one), np.array(other)) is between
    assert outline.lies_between(np.array(other), np.array(one)) is between


def test_without_sensors_nobody_knows() -> None:
    assert OwnOutline.around([]) is None


@pytest.mark.parametrize(("views", "obstacles"), [(CORNERS, 2), ((), 1)])
def test_cars_that_we_are_parked_between_are_two(views: list[SensorView], obstacles: int) -> None:
    """No radar sees both, so that no scan tells that they are two; they lie as close together as a car is long."""
    fed = HandFedVehicles(views=views)
    for t in times(0, 60):
        fed.scan(t, [Seen(0, 1.0, 1.6)], sensor=0)
        told = fed.scan(t + 0.02, [Seen(0, 1.2, -1.5)], sensor=1)
    assert len(told) == obstacles
