"""The shipped scenarios of traffic: nobody runs into another, all move as vehicles do, and every radar can see them."""

from __future__ import annotations

import cmath
import math
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from candaemon.simulation.scenario import Scenario, load_scenario
from candaemon.simulation.scene import Scene
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding as bound
from tests.support.paths import ROOT

SCENARIOS = sorted((ROOT / "config" / "scenarios").glob("traffic_*.yaml"))
CONFIGS = sorted(path.stem for path in (ROOT / "config").glob("*.yaml"))
OWN = (1.35, 2.25, 0.9)  # m: the own body's centre ahead of the rear axle, half its length and width
CORNERS = np.array([1 + 1j, 1 - 1j, -1 - 1j, -1 + 1j])

Corners = np.ndarray[Any, np.dtype[np.complex128]]


def corners(centre: complex, yaw: float, half_length: float, half_width: float) -> Corners:
    box = half_length * CORNERS.real + 1j * half_width * CORNERS.imag
    return np.asarray(centre + box * cmath.exp(1j * yaw))


def overlap(one: Corners, other: Corners) -> bool:
    """Return whether two rectangles have a point in common: no side of either keeps them apart."""
    for box in (one, other):
        for side in (box[1] - box[0], box[2] - box[1]):
            first, second = (np.real(each * np.conj(1j * side)) for each in (one, other))
            if first.max() < second.min() or second.max() < first.min():
                return False
    return True


def bodies(scenario: Scenario, scene: Scene, step: float) -> list[list[Corners]]:
    """Return the corners of all bodies, our own last, at each instant."""
    found = []
    for instant in scene.states(np.arange(0.0, scenario.duration, step)):
        actors, ego = instant.actors, instant.ego
        boxes = zip(actors.position, actors.yaw, scene.half_length, scene.half_width, strict=True)
        ahead, half_length, half_width = OWN
        own = corners(ego.position + ahead * cmath.exp(1j * ego.yaw), ego.yaw, half_length, half_width)
        found.append([*(corners(complex(p), float(y), float(a), float(b)) for p, y, a, b in boxes), own])
    return found


def test_there_is_traffic_of_many_kinds() -> None:
    assert len(SCENARIOS) >= 14
    kinds = {actor.kind for path in SCENARIOS for actor in load_scenario(path).actors}
    assert kinds == {"car", "truck", "two-wheeler", "pedestrian"}


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_vehicles_move_as_vehicles_do(path: Path) -> None:
    scenario = load_scenario(path)
    assert 20 <= scenario.duration <= 40
    assert 5 <= len(scenario.actors) <= 40
    assert scenario.measurement.traffic is not None
    scene = Scene(scenario)
    names = [*(actor.name for actor in scenario.actors), "we"]
    for boxes in bodies(scenario, scene, 0.25):
        centres = [complex(box.mean()) for box in boxes]
        for (one, other), (a, b) in zip(combinations(range(len(boxes)), 2), combinations(centres, 2), strict=True):
            assert abs(a - b) > 20 or not overlap(boxes[one], boxes[other]), (names[one], names[other])
    for instant in scene.states(np.arange(0.0, scenario.duration, 0.25)):
        local = instant.actors.acceleration * np.exp(-1j * instant.actors.yaw)
        assert np.abs(local.real).max() < 5.0
        assert np.abs(local.imag).max() < 4.5
        assert np.abs(instant.actors.yaw_rate).max() < math.radians(45)


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_every_scenario_shows_its_actors_and_what_stands(path: Path) -> None:
    scenario = load_scenario(path).model_copy(update={"duration": 3.0})
    owners = np.concatenate([report.owner for _, report in simulate(scenario, bound("esr_ins")).reports(0)])
    assert len(np.unique(owners[(owners >= 0) & (owners < len(scenario.actors))])) >= 2
    assert (owners >= len(scenario.actors)).any()
    assert (owners < 0).any()


@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_every_radar_can_be_simulated_in_it(path: Path, name: str) -> None:
    scenario = load_scenario(path).model_copy(update={"duration": 0.2})
    simulation = simulate(scenario, bound(name))
    assert len(list(simulation.frames())) > 20
    assert len(list(simulation.truth())) >= 2
