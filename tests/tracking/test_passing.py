"""What passes beside us shows its side: what is seen of it slides along it, and at times of any vehicle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.support.builders import HandFedVehicles, Seen, pose, times

SPEED, SIDE, HALF = 4.0, 2.6, 1.0
"""m/s of a car that passes us, who stand; m from us to its side, and how far from its centre that is seen."""


@pytest.mark.parametrize("half", [HALF, 0.0], ids=["car", "motorcycle"])
@pytest.mark.parametrize("seed", range(3))
def test_a_car_that_passes_is_as_fast_while_it_shows_us_the_point_beside_us(half: float, seed: int) -> None:
    """One reflection, which stays where the side is nearest to us, tells nothing of the speed; nor is it a post."""
    fed, rng, told = HandFedVehicles(), np.random.default_rng(seed), list[float]()
    for t in times(1, 75):
        centre = -9.0 + SPEED * t
        x, y = rng.normal(size=2) * 0.1 + (np.clip(0.0, centre - half, centre + half), SIDE)
        obstacles = fed.scan(t, [Seen(1, x, y, SPEED)])
        if -1.0 < centre < HALF:
            told += obstacles.vx.tolist()
    assert len(set(obstacles.id.tolist())) == 1
    assert min(told) > 0.7 * SPEED
    assert max(told) < 1.3 * SPEED


@pytest.mark.parametrize("seed", range(3))
def test_a_coach_that_crosses_close_ahead_drives_straight_on(seed: int) -> None:
    """What is nearest of its side stays before us: a shorter vehicle would be half as fast, and turn away."""
    fed, rng, told = HandFedVehicles(), np.random.default_rng(seed), list[tuple[float, float]]()
    for t in times(1, 50):
        centre = 12.0 - 10.0 * t
        nearest = np.clip(0.0, centre - 4.0, centre + 4.0)
        seen = [Seen(1, 8.5 + rng.normal() * 0.1, nearest + rng.normal() * 0.1, 0.0, -10.0)]
        if t < 0.6:
            seen.append(Seen(2, 8.5 + rng.normal() * 0.1, nearest - 1.0 + rng.normal() * 0.1, 0.0, -10.0))
        obstacles = fed.scan(t, seen)
        if -4.0 < centre < 4.0:
            (row,) = np.flatnonzero(obstacles.id == obstacles.id.min())
            told.append((float(obstacles.vx[row]), float(obstacles.vy[row])))
    vx, vy = np.array(told).T
    assert np.abs(vx).max() < 1.5
    assert (vy < -7.0).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_coach_of_known_length_that_crosses_is_as_fast_while_another_part_of_its_side_shows(seed: int) -> None:
    """To a lidar, which tells no speed: what is seen of the side stays before us while the coach drives on."""
    fed, rng, told = HandFedVehicles(noise=(0.15, 0.15, 0.1)), np.random.default_rng(seed), list[float]()
    for t in times(1, 90):
        centre = 28.0 - 11.0 * t
        x, y = rng.normal(size=2) * 0.15 + (11.0, np.clip(0.0, centre - 8.0, centre + 8.0))
        obstacles = fed.scan(t, [Seen(1, x, y, rated=False)], length=np.array([18.0]), width=np.array([2.5]))
        if abs(centre) < 8.0:
            told.append(float(obstacles.vy[0]))
    assert len(obstacles) == 1
    assert max(told) < -5.0


@pytest.mark.parametrize("speed", [9.0, 14.0])
@pytest.mark.parametrize("told", [True, False], ids=["of known length", "of two reflections"])
@pytest.mark.parametrize("seed", range(3))
def test_a_car_that_passes_beside_us_keeps_its_speed_and_place(speed: float, told: bool, seed: int) -> None:
    """What is nearest of it stays beside us while it passes, and leaves with its rear."""
    fed, rng, errors = HandFedVehicles(noise=(0.2, 0.2, 0.1)), np.random.default_rng(seed), list[list[float]]()
    size: dict[str, Any] = {"length": np.array([4.5]), "width": np.array([1.8])} if told else {}
    for t in times(0, 100):
        centre = -20.0 + speed * t
        nearest = np.clip(0.0, centre - 2.25, centre + 2.25)
        x, y = rng.normal(size=2) * 0.15 + (nearest, 2.0)
        seen = [Seen(1, x, y, speed)]
        if not told and t < 1.2:
            x, y = rng.normal(size=2) * 0.15 + (centre + 0.5, 2.8)
            seen.append(Seen(2, x, y, speed))
        found = fed.scan(t, seen, **size)
        if abs(centre) < 10.0:
            errors.append([found.vx[0] - speed, found.vy[0], found.x[0] - nearest])
    assert len(found) == 1
    along, across, place = np.abs(np.array(errors)).max(axis=0)
    assert max(along, across) < 1.0
    assert place < (1.0 if told else 2.0)  # without a size, it may be a longer one


@pytest.mark.parametrize("length", [8.0, 12.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_lorry_of_unknown_size_that_passes_keeps_its_speed(length: float, seed: int) -> None:
    """It has shown two reflections first; its side is seen for longer than a car's would be."""
    fed, rng, told = HandFedVehicles(noise=(0.2, 0.2, 0.1)), np.random.default_rng(seed), list[float]()
    for t in times(1, 70):
        centre = -20.0 + 10.0 * t
        x, y = rng.normal(size=2) * 0.15 + (np.clip(0.0, centre - length / 2, centre + length / 2), 2.0)
        seen = [Seen(1, x, y, 10.0)]
        if t < 1.2:
            x, y = rng.normal(size=2) * 0.15 + (centre + 0.5, 3.2)
            seen.append(Seen(2, x, y, 10.0))
        obstacles = fed.scan(t, seen)
        told.append(float(obstacles.vx[0]))
    assert len(obstacles) == 1
    assert np.abs(np.array(told[20:]) - 10.0).max() < 1.5


@pytest.mark.parametrize("told", [True, False])
def test_a_car_that_brakes_beside_us_and_shows_both_ends_is_told_at_once(told: bool) -> None:
    """To a lidar, which tells no speed: both ends do not slide."""
    fed, rng = HandFedVehicles(noise=(0.2, 0.2, 0.1)), np.random.default_rng(1)
    size: dict[str, Any] = {"length": np.full(2, 4.5), "width": np.full(2, 1.8)} if told else {}
    for t in times(1, 66):
        own, braked = pose(t, east=15.0 * t, ve=15.0), max(t - 3.0, 0.0)
        centre = -10.0 + 18.0 * t - 3.0 * braked * braked
        ends = rng.normal(size=(2, 2)) * 0.15 + [(centre - 2.25, 2.0), (centre + 2.25, 2.0)]
        found = fed.scan(t, [Seen(key, x, y, rated=False) for key, (x, y) in enumerate(ends)], ego=own, **size)
    assert found.vx[0] < 18.0 - 6.0 * braked + 2.5


@pytest.mark.parametrize("jump", [1.0, 1.6, 2.2])
def test_a_car_whose_reflection_has_slid_for_good_is_told_where_it_is_seen(jump: float) -> None:
    """It may slide back, but the longer it does not, the likelier the place before was that of another part."""
    fed, rng = HandFedVehicles(noise=(0.3, 0.3, 0.1)), np.random.default_rng(1)
    for t in times(0, 120):
        x = 20.0 + 15.0 * t
        seen = x + (jump if t < 3.0 else 0.0) + rng.normal() * 0.2
        told = fed.scan(t, [Seen(1, seen, 3.0 + rng.normal() * 0.2, 15.0)])
        if t > 3.0:
            assert told.vx[0] == pytest.approx(15.0, abs=0.1)
    assert told.x[0] == pytest.approx(x, abs=0.4)


@pytest.mark.parametrize("seed", range(3))
def test_what_turns_goes_on_turning_while_its_reflection_slides(seed: int) -> None:
    """A car on a circle of 100 m at 16 m/s; every .4 s its reflection is elsewhere by about a metre."""
    fed, rng, errors, slid = HandFedVehicles(noise=(0.2, 0.4, 0.1)), np.random.default_rng(seed), list[float](), 0.0
    for k, t in enumerate(times(0, 120)):
        angle = 0.16 * t
        x, y = 60.0 + 100.0 * np.sin(angle), -60.0 + 100.0 * np.cos(angle)
        if k % 8 == 0:
            slid = rng.normal()
        along = slid + rng.normal() * 0.2
        seen = x + along * np.cos(angle), y - along * np.sin(angle) + rng.normal() * 0.4
        told = fed.scan(t, [Seen(1, *seen, 16.0 * np.cos(angle), -16.0 * np.sin(angle))])
        if t > 3.0 and len(told.id):
            course = np.arctan2(told.vy[0], told.vx[0])
            errors.append(np.degrees(course + angle))
    assert np.sqrt(np.mean(np.square(errors))) < 4.0
