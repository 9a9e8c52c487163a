"""What the tracker must reach on simulated drives through the ESR's DBC: a seed each by default, 20 with `-m slow`."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from candaemon.config.tracker import TrackerSettings
from candaemon.evaluation.results import Evaluation
from tests.support.simulated import drive, scenario

CONFIRMED_WITHIN = 0.5  # s, 10 scans
AUTOMOTIVE = {
    "automotive_cruise": (0.085, 0.087),
    "automotive_brake": (0.235, 0.49),
    "automotive_cut_in": (0.17, 0.49),
    "automotive_turn": (0.165, 0.24),
}
"""Largest RMSE of position (m) and velocity (m/s) of a point target."""
MLKF_FACTORS = {"automotive_cruise": (2.4, 11.0), "automotive_cut_in": (1.5, 1.7)}
"""Most times the error of `imm` in position and velocity, which cruises by a model of constant velocity."""
DRAMAS = ("highway", "stop_and_go", "intersection", "guard_rail", "turning_ego")
LONG = {"highway", "stop_and_go", "guard_rail"}
"""Drives of which even one takes long."""


def seeds_of(*names: str) -> pytest.MarkDecorator:
    """Give a test each drive's name and the number of seeds: one by default, 20 with `-m slow`."""
    some = [pytest.param(name, 1) for name in names if name not in LONG]
    return pytest.mark.parametrize(
        ("name", "seeds"), some + [pytest.param(name, 20, marks=pytest.mark.slow) for name in names]
    )


@cache
def run(name: str, seed: int) -> Evaluation:
    return drive("esr_ins", scenario(name), seed)[0]


def runs(name: str, seeds: int) -> list[Evaluation]:
    return [run(name, seed) for seed in range(seeds)]


@seeds_of(*AUTOMOTIVE)
def test_a_point_target_is_tracked_as_well_as_can_be(name: str, seeds: int) -> None:
    position, velocity = AUTOMOTIVE[name]
    errors = [run.errors for run in runs(name, seeds)]
    assert np.sqrt(np.mean([each.position**2 for each in errors])) <= position
    assert np.sqrt(np.mean([each.velocity**2 for each in errors])) <= velocity
    assert sum(run.id_switches for run in runs(name, seeds)) == 0


@seeds_of(*AUTOMOTIVE)
def test_the_models_of_points_track_one_as_well(name: str, seeds: int) -> None:
    position, velocity = AUTOMOTIVE[name]
    tracker = TrackerSettings.model_validate({"estimator": {"kind": "imm"}})
    found = [drive("esr_ins", scenario(name), seed, tracker)[0] for seed in range(seeds)]
    assert sum(each.id_switches for each in found) == 0
    assert np.sqrt(np.mean([each.errors.position**2 for each in found])) <= position
    assert np.sqrt(np.mean([each.errors.velocity**2 for each in found])) <= velocity


@pytest.mark.slow
@pytest.mark.parametrize("name", MLKF_FACTORS)
def test_the_mlkf_tracks_a_point_target_not_much_worse(name: str) -> None:
    off: dict[str, list[tuple[float, float]]] = {"imm": [], "mlkf": []}
    fits: list[tuple[float, float]] = []
    for seed in range(3):
        for kind, errors in off.items():
            tracker = TrackerSettings.model_validate({"estimator": {"kind": kind}})
            found = drive("esr_ins", scenario(name), seed, tracker)[0]
            assert found.id_switches == 0
            if kind == "mlkf":
                fits.append((found.nees.mean, found.nees.coverage))
            errors.append((found.errors.position, found.errors.velocity))
    imm, mlkf = (np.sqrt(np.square(each).mean(axis=0)) for each in off.values())
    assert (mlkf <= np.array(MLKF_FACTORS[name]) * imm).all()
    nees, coverage = np.mean(fits, axis=0)
    assert 2.5 < nees < 6.0
    assert coverage > 0.88


@seeds_of(*AUTOMOTIVE, *DRAMAS)
def test_every_actor_in_view_is_confirmed_in_time(name: str, seeds: int) -> None:
    for run in runs(name, seeds):
        assert run.time_to_confirm.unconfirmed == 0
        assert run.time_to_confirm.max <= CONFIRMED_WITHIN


@seeds_of(*AUTOMOTIVE, *DRAMAS)
def test_hardly_any_run_has_a_false_track(name: str, seeds: int) -> None:
    assert sum(run.false_tracks.ids > 0 for run in runs(name, seeds)) <= 0.05 * seeds


@seeds_of(*DRAMAS)
def test_a_vehicle_is_one_obstacle(name: str, seeds: int) -> None:
    assert np.mean([run.duplicates.share for run in runs(name, seeds)]) < 0.05
