"""A tracker's state is all that it remembers: another tracker continues alike; one that does not fit is refused."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import fields
from typing import Any, TypeAlias

import numpy as np
import pytest

from candaemon.estimation.sensor_noise import SensorNoiseState
from candaemon.tracking.any_tracker import same_filter, set_state
from candaemon.tracking.body_store import BodyTable
from candaemon.tracking.identities import Identities
from candaemon.tracking.obstacles import Obstacles
from candaemon.tracking.reflection_noise import StandingDisplacements
from candaemon.tracking.tracker import TrackerState
from candaemon.tracking.vehicle_tracker import VehicleTrackerState
from tests.support.builders import HandFed, HandFedVehicles, Seen, times

ESTIMATORS: dict[str, dict[str, Any]] = {
    "cv": {"kind": "cv", "noise": 1.0},
    "cs": {"kind": "cs", "innovation_memory": 0.3, "measurement_noise": {"kind": "window"}},
    "imm": {"kind": "imm", "measurement_noise": {"kind": "variational"}},
    "information": {"kind": "information"},
    "switching": {"kind": "switching", "manoeuvre_time": 1.0, "steady_time": 1.0, "interval": 0.2},
    "federated": {"kind": "federated", "measurement_noise": {"kind": "window"}},
    "vehicle": {"kind": "vehicle"},
    "mlkf": {"kind": "mlkf", "measurement_noise": {"kind": "variational"}},
}


def scan(rng: np.random.Generator, t: float) -> list[Seen]:
    """See two reflections of a lorry, a car that brakes, and what else there is."""
    noise = rng.normal(size=(4, 2)) * 0.1
    points = [(30.0 + 15 * t, 0.0, 15.0), (33.0 + 15 * t, 0.3, 15.0), (60.0 + 20 * t - t * t, 4.0, 20.0 - 2 * t)]
    points.append((*rng.uniform(5, 100, 2), 0.0))
    seen = zip(points, noise, strict=True)
    return [Seen(k, x + dx, y + dy, vx) for k, ((x, y, vx), (dx, dy)) in enumerate(seen) if rng.random() < 0.8]


def hand_fed(kind: str, identities: Identities | None = None) -> HandFed | HandFedVehicles:
    fed = HandFedVehicles if kind == "vehicle" else HandFed
    return fed(identities=identities, estimator=ESTIMATORS[kind])


def drive(fed: HandFed | HandFedVehicles, seed: int, first: int, last: int) -> list[Obstacles]:
    rng = np.random.default_rng(seed)
    return [fed.scan(t, scan(rng, t), sensor=k % 2) for k, t in enumerate(times(first, last))]


def tracked(kind: str) -> tuple[HandFed | HandFedVehicles, Identities]:
    identities = Identities()
    fed = hand_fed(kind, identities)
    drive(fed, 1, 1, 30)
    return fed, identities


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_a_tracker_that_is_given_the_state_goes_on_alike(kind: str) -> None:
    former, identities = tracked(kind)
    others = Identities()
    other = hand_fed(kind, others)
    drive(other, 2, 1, 20)
    assert same_filter(former.tracker, other.tracker)
    set_state(other.tracker, deepcopy(former.tracker.state))
    others.given = identities.given
    for a, b in zip(drive(former, 3, 30, 80), drive(other, 3, 30, 80), strict=True):
        for field in fields(Obstacles):
            np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name), err_msg=field.name)
    assert former.tracker.counts == other.tracker.counts


Damaged: TypeAlias = TrackerState | VehicleTrackerState


def _without_a_filter(state: Damaged) -> None:
    state.tracks.estimator.probability = state.tracks.estimator.probability[1:]


def _with_another_dimension(state: Damaged) -> None:
    obstacles = state.tracks.obstacles
    if isinstance(obstacles, BodyTable):
        obstacles.axis = obstacles.axis[:, :1]
    else:
        obstacles.offset = obstacles.offset[:, :1]


def _with_other_numbers(state: Damaged) -> None:
    state.tracks.obstacles.id = state.tracks.obstacles.id.astype(np.float64)


def _led_by_another(state: Damaged) -> None:
    state.tracks.obstacles.leader = state.tracks.obstacles.leader[::-1].copy()


def _with_a_leader_that_is_not_there(state: Damaged) -> None:
    state.tracks.obstacles.leader += len(state.tracks.reflections)


def _with_an_id_of_nothing(state: Damaged) -> None:
    state.tracks.row_of[0, 99] = -1


def _with_noise(state: Damaged) -> None:
    if isinstance(state, VehicleTrackerState):
        state.noise.sensors[3] = StandingDisplacements()
    else:
        state.tracks.estimator.noise = SensorNoiseState(3)


def _of_another_time(state: Damaged) -> None:
    state.time_ns = 1 << 62


def _of_the_same_number(state: Damaged) -> None:
    state.tracks.obstacles.id[:] = 7


@pytest.mark.parametrize("kind", ["cv", "vehicle"])
@pytest.mark.parametrize(
    "damage",
    [
        _without_a_filter,
        _with_another_dimension,
        _with_other_numbers,
        _led_by_another,
        _with_a_leader_that_is_not_there,
        _with_an_id_of_nothing,
        _with_noise,
        _of_another_time,
        _of_the_same_number,
    ],
)
def test_a_state_that_contradicts_itself_is_refused(damage: Callable[[Damaged], None], kind: str) -> None:
    former, _ = tracked(kind)
    state = deepcopy(former.tracker.state)
    damage(state)
    with pytest.raises(ValueError, match=r"\w"):
        set_state(hand_fed(kind).tracker, state)


def test_a_reflection_followed_to_no_place_is_refused() -> None:
    former, _ = tracked("vehicle")
    state = deepcopy(former.tracker.state)
    assert isinstance(state, VehicleTrackerState)
    state.tracks.reflections.trail[0, 1] = np.nan
    with pytest.raises(ValueError, match="followed to no place"):
        set_state(hand_fed("vehicle").tracker, state)


@pytest.mark.parametrize("kind", ESTIMATORS)
def test_the_state_of_another_filter_is_refused(kind: str) -> None:
    former, _ = tracked(kind)
    for other in ESTIMATORS:
        if other != kind and {kind, other} != {"imm", "information"}:
            with pytest.raises(ValueError, match=r"\w"):
                set_state(hand_fed(other).tracker, deepcopy(former.tracker.state))
