"""The experiments of paper 004 on few runs: the figures to hold, and that the tables are whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from candaemon.arrays import Floats
from candaemon.estimation.variational_noise import VariationalNoise
from candaemon.papers.experiment import Advance, Result
from candaemon.papers.gao import EXPERIMENTS
from candaemon.papers.gao_drives import FIRST, SECOND, THIRD, LidarRadarDrive
from candaemon.papers.gao_filters import METHODS, NOMINAL, STEADY, bound, conventional, joint, record
from candaemon.papers.gao_sweeps import ACCELERATIONS, VARIANCES, acceleration_sweep, noise_sweep

COMPONENTS = ("displacement", "velocity", "acceleration")


def run(experiment: Callable[[int, int, Advance], Result], runs: int) -> Result:
    """Run an experiment, and hold that what it says to have done adds up."""
    done: list[float] = []
    result = experiment(runs, 1, done.append)
    assert sum(done) == pytest.approx(1.0)
    return result


@cache
def third() -> Result:
    return run(THIRD.run, 10)


@cache
def noise() -> Result:
    return run(lambda runs, seed, advance: noise_sweep(runs, seed, advance, VARIANCES[::6]), 25)


@cache
def accelerations() -> Result:
    return run(lambda runs, seed, advance: acceleration_sweep(runs, seed, advance, ACCELERATIONS[::30]), 40)


def here(result: Result, method: str, case: str | None = None) -> Floats:
    """Return a method's errors of displacement, velocity and acceleration."""
    return np.array(
        [
            row.here
            for component in COMPONENTS
            for row in result.rows
            if row.method == method and row.quantity == component and case in {None, row.case}
        ]
    )


@pytest.mark.slow
def test_figures_of_the_first_drive() -> None:
    recording = record(FIRST.truth[:, None], FIRST.variance(), FIRST.start, 8, np.random.default_rng(1))
    counted = slice(FIRST.counted, None)

    def error(estimates: Floats) -> Floats:
        return np.asarray(np.sqrt(np.square(estimates - recording.truth)[counted].mean(axis=(0, 1))))

    fused, adaptation = joint(recording, [VariationalNoise(np.full(3, variance)) for variance in NOMINAL], STEADY)
    assert (error(fused) <= (0.023, 0.017, 0.009)).all()
    assert (error(bound(recording)) <= (0.015, 0.005, 0.001)).all()
    printed = [row[0] for row in FIRST.printed[:2]]
    np.testing.assert_allclose(error(conventional(recording, 0))[:2], printed, rtol=0.1)
    burst, calm = slice(2200, 3000), slice(4300, 5000)
    np.testing.assert_allclose(adaptation.variance[burst, 0].mean(axis=0), 2.0, rtol=0.3)
    np.testing.assert_allclose(adaptation.variance[calm, 0].mean(axis=0), 0.03, rtol=0.3)
    assert adaptation.share[burst, 0].mean() < 0.08
    assert adaptation.share[calm, 0].mean() == pytest.approx(10 / 13, abs=0.05)


@pytest.mark.slow
def test_nothing_beats_the_bound_of_a_constant_acceleration() -> None:
    start_and_burst = replace(FIRST, truth=FIRST.truth[:1500])
    for result in (run(start_and_burst.run, 4), noise(), accelerations()):
        errors = [row for row in result.rows if row.error]
        assert errors
        assert [row for row in errors if row.bound is None or row.bound > row.here] == []


@pytest.mark.parametrize("method", ["JAKF", "JAKF, variational R"])
@pytest.mark.slow
def test_average_of_the_noise_sweep(method: str) -> None:
    average = "average of the sweep"
    assert (here(noise(), method, average) <= (0.033, 0.023, 0.015)).all()
    order = [here(noise(), each, average)[:2] for each in (method, "IAKF lidar", "CKF lidar")]
    assert (order[0] < 0.8 * order[1]).all()
    assert (order[1] < 0.8 * order[2]).all()


@pytest.mark.slow
def test_fusion_beats_either_sensor_at_any_acceleration() -> None:
    result = accelerations()
    for case, printed in (("largest of the sweep", 0.0403), ("average of the sweep", 0.0261)):
        errors = {method: here(result, method, case) for method in METHODS[:6]}
        for joint_ in ("JAKF", "JAKF, variational R"):
            assert all((errors[joint_] < errors[method]).all() for method in METHODS[:4])
        row = next(row for row in result.rows if row.case == case and row.method == "JAKF")
        assert row.printed == printed
        assert row.here < printed


@pytest.mark.slow
def test_third_drive_needs_a_wider_q() -> None:
    """An adaptive R takes for noise what a Q of next to nothing cannot follow."""
    result = third()
    assert (here(result, "IAKF lidar") > here(result, "CKF lidar")).all()
    assert (here(result, "JAKF, wider Q") < np.array([row[4] for row in THIRD.printed[:3]]) * (1, 1, 1.25)).all()
    assert (2 * here(result, "JAKF, wider Q") < here(result, "JAKF")).all()


@pytest.mark.parametrize("drive", [FIRST, SECOND, THIRD])
def test_stand_ins_move_as_the_paper_says(drive: LidarRadarDrive) -> None:
    """Variances are the printed ones; each component is the next one summed up."""
    printed = np.mean(drive.printed[3:], axis=1)
    found = drive.truth.var(axis=0)
    assert found[1] == pytest.approx(printed[1], rel=0.02)
    if drive is not FIRST:  # where the acceleration is constant, only its estimates vary
        assert found[2] == pytest.approx(printed[2], rel=0.02)
    else:
        assert found[0] == pytest.approx(printed[0], rel=0.01)
    x, v, a = np.concatenate([drive.start[None], drive.truth]).T
    np.testing.assert_allclose(np.diff(x), 0.005 * (v[1:] + v[:-1]), atol=1e-6)
    np.testing.assert_allclose(np.diff(v), 0.005 * (a[1:] + a[:-1]), atol=1e-6)


@pytest.mark.slow
def test_tables_are_whole() -> None:
    rows = third().rows
    assert len(rows) == 6 * len(METHODS)
    printed = {(row.quantity, row.method): row.printed for row in rows}
    for method, column in zip(METHODS, zip(*THIRD.printed, strict=True), strict=False):
        assert tuple(printed[quantity, method] for quantity in dict.fromkeys(row.quantity for row in rows)) == column
    assert all(value is None for (_, method), value in printed.items() if method in METHODS[5:])
    for result in (third(), noise()):
        for row in result.rows:
            assert row.error is not row.quantity.startswith("variance of")
            assert (row.default is not None) is (row.bound is not None) is row.error
            assert all(np.isfinite(value) for value in (row.here, row.default, row.bound) if value is not None)
        lines = [line for figure in result.figures for panel in figure.panels for line in panel.lines]
        assert all(line.x.shape == line.y.shape and 0 < len(line.x) <= 2000 for line in lines)
        assert all(np.isfinite(line.y).all() for line in lines)
        assert len({figure.name for figure in result.figures}) == len(result.figures)


def test_experiments_are_named_after_their_paper() -> None:
    assert {experiment.paper for experiment in EXPERIMENTS} == {"004"}
    assert all(experiment.choices for experiment in EXPERIMENTS)
