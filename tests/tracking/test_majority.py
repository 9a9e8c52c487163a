"""What most of a vehicle's detections contradict is no part of it."""

from __future__ import annotations

import pytest

from tests.support.builders import HandFedVehicles, Seen, times

STOPS, STARTS, ACCELERATION = 3.0, 6.0, 3.0


def approaching(t: float) -> tuple[float, float]:
    """Return where the near end of a car is, m, and its speed, m/s: it comes, stops 27 m ahead, and starts again."""
    if t < STOPS:
        return 27.0 + 0.5 * ACCELERATION * (STOPS - t) ** 2, -ACCELERATION * (STOPS - t)
    moved = max(t - STARTS, 0.0)
    return 27.0 - 0.5 * ACCELERATION * moved**2, -ACCELERATION * moved


def scan(t: float, reflections: int) -> list[Seen]:
    """Return a scan of so many reflections of the car, and of a manhole cover beneath where it stops."""
    x, speed = approaching(t)
    first = 1 if t < STARTS else 11
    car = [Seen(first + k, x + 1.5 * k, 2.0 + 0.6 * k, speed) for k in range(reflections)]
    cover = Seen(9, 28.0, 2.2)
    if t < STOPS + 1.0:
        return car
    return [cover] if STARTS - 1.0 < t < STARTS else [*car, cover]


@pytest.mark.parametrize("reflections", [2, 3])
def test_a_manhole_cover_does_not_hold_back_the_car_that_starts_off_it(reflections: int) -> None:
    fed = HandFedVehicles(noise=(0.5, 0.5, 0.5))
    for t in times(0, 120):
        told = fed.scan(t, scan(t, reflections))
    (car,) = told.id.tolist()
    errors = []
    for t in times(120, 160):
        told = fed.scan(t, scan(t, reflections))
        errors.append(abs(told.vx[told.id == car].item() - approaching(t)[1]))
    assert max(errors) < 0.8
    assert told.x[told.id == car].item() == pytest.approx(approaching(t)[0], abs=0.5)
