"""Paper 002's drives, the numbers to hold in them, and that both forms of its filter are one."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest

from candaemon.estimation.imm import Imm
from candaemon.estimation.motion_models import CoordinatedTurn, LinearModel
from candaemon.papers.experiment import Experiment, Result
from candaemon.papers.kim_hong import EXPERIMENTS
from candaemon.papers.kim_hong_drives import DT, Turns, bound, drive
from candaemon.papers.tracking import follow, rmse

RUNS, SEED = 40, 0
NAMES = ("002-straight-and-curve", "002-cut", "002-u-turn", "002-interchange")
HELD = {"002-u-turn": (7.7, 2.3), "002-interchange": (8.4, 2.5), "002-cut": (9.5, 3.9)}
"""Position, m, and velocity, m/s, of the tuned filters."""
DRIVES = (
    ("002-u-turn", (10.0, 10.0), ((61, 145, 180.0),)),
    ("002-interchange", (0.0, 0.0), ((41, 168, 270.0),)),
    ("002-cut", (0.0, 20.0), ((20, 39, 74.8), (42, 63, -82.28), (135, 154, -74.8), (160, 179, 74.8))),
)


def silent(share: float) -> None:
    del share


@pytest.fixture(scope="module")
def results() -> dict[str, Result]:
    """Return all four experiments' results."""
    return {each.name: each.run(RUNS, SEED, silent) for each in EXPERIMENTS}


def figure(result: Result, quantity: str, method: str) -> float:
    (row,) = (each for each in result.rows if (each.quantity, each.method) == (quantity, method))
    return row.here


def test_there_is_an_experiment_a_drive() -> None:
    assert tuple(each.name for each in EXPERIMENTS) == NAMES
    assert {each.paper for each in EXPERIMENTS} == {"002"}


@pytest.mark.parametrize("name", HELD)
@pytest.mark.parametrize("method", ["IMM-EKF", "IMM-IF"])
def test_the_numbers_to_hold(results: dict[str, Result], name: str, method: str) -> None:
    position, velocity = HELD[name]
    assert figure(results[name], "position", method) <= position
    assert figure(results[name], "velocity", method) <= velocity


@pytest.mark.parametrize("name", NAMES)
def test_they_beat_the_default_and_no_filter_beats_the_bound(results: dict[str, Result], name: str) -> None:
    for row in results[name].rows:
        assert row.printed is None
        assert row.default is not None
        assert row.bound is not None
        assert row.bound < min(row.here, row.default)
        if row.method != "IMM-EKF, printed noise" and "worst" not in row.quantity:
            assert row.here < row.default


def test_the_printed_noise_cannot_leave_a_turn_for_another(results: dict[str, Result]) -> None:
    assert figure(results["002-cut"], "position", "IMM-EKF, printed noise") > 20.0
    assert figure(results["002-u-turn"], "position", "IMM-EKF, printed noise") < 7.7


@pytest.mark.parametrize(("name", "start", "turns"), DRIVES)
def test_both_forms_are_one_filter_and_hold_the_numbers_from_the_first_scan(
    name: str, start: tuple[float, float], turns: Turns
) -> None:
    """Where the first velocity is right, no scan has to be left out."""
    truth = drive(start, turns)
    measured = truth.measured(10.0, RUNS, np.random.default_rng(1))
    models = (LinearModel(1, (1e-3, 1e-3)), CoordinatedTurn(0.1, 1e-4))
    estimates = []
    for form in ("covariance", "information"):
        imm = Imm(models, switch_rate=0.05, acceleration=1.0, turn_rate=0.03, forms=("covariance", form))
        estimates.append(follow(imm, DT, measured, 100 * np.eye(2), truth.state[0, 2:4], 100 * np.eye(2)))
    assert np.abs(estimates[0] - estimates[1]).max() <= 1e-8
    assert (estimates[0] != estimates[1]).any()  # else there was but one form
    errors = rmse(estimates[0], truth.state)
    assert np.hypot(errors[0], errors[1]) <= HELD[name][0]
    assert np.hypot(errors[2], errors[3]) <= HELD[name][1]


def test_tables_of_both_forms_agree(results: dict[str, Result]) -> None:
    for result in results.values():
        for quantity in {row.quantity for row in result.rows}:
            difference = figure(result, quantity, "IMM-EKF") - figure(result, quantity, "IMM-IF")
            assert abs(difference) <= 1e-8


def experiment(name: str) -> Experiment:
    (found,) = (each for each in EXPERIMENTS if each.name == name)
    return found


def test_the_same_seed_gives_the_same_and_progress_comes_to_one() -> None:
    shares: list[float] = []
    first = experiment("002-u-turn").run(2, 3, shares.append)
    again = experiment("002-u-turn").run(2, 3, silent)
    other = experiment("002-u-turn").run(2, 4, silent)
    assert first.rows == again.rows != other.rows
    assert sum(shares) == pytest.approx(1.0)


def test_the_turns_probability_follows_the_drive(results: dict[str, Result]) -> None:
    (drawn,) = results["002-u-turn"].figures
    curves = {line.label: line.y for line in drawn.panels[-1].lines}
    assert curves["IMM-EKF"][90:140].mean() > 0.6
    assert curves["IMM-EKF"][30:60].mean() < 0.4
    assert curves["IMM-EKF"][170:].mean() < 0.4


def test_drawings_have_a_point_a_scan(results: dict[str, Result]) -> None:
    for name, result in results.items():
        (drawn,) = result.figures
        assert drawn.name == name
        for panel in drawn.panels:
            for line in panel.lines:
                assert line.x.shape == line.y.shape == (201,)
                assert np.isfinite(line.y).all()


def test_a_drive_turns_as_told() -> None:
    truth = drive((10.0, 10.0), ((61, 145, 180.0),))
    speeds = np.hypot(truth.state[:, 2], truth.state[:, 3])
    np.testing.assert_allclose(speeds, 28.0, rtol=1e-12)
    np.testing.assert_allclose(truth.state[60, :4], (10 + 60 * 28, 10, 28, 0), atol=1e-9)
    np.testing.assert_allclose(truth.state[-1, 2:4], (-28.0, 0.0), atol=1e-9)
    rate = radians(180 / 85)
    centre = np.array([10 + 60 * 28, 10 + 28 / rate])
    offset = truth.state[60:146, :2] - centre
    np.testing.assert_allclose(np.hypot(offset[:, 0], offset[:, 1]), 28 / rate, rtol=1e-12)
    assert (truth.turn_rate > 0).sum() == 85
    np.testing.assert_allclose(truth.state[100, 4:], rate * np.array([-truth.state[100, 3], truth.state[100, 2]]))


def test_the_bound_of_straight_motion_is_that_of_a_fitted_line() -> None:
    truth = drive((0.0, 0.0), ())
    variances = bound(truth, 10.0, 1e4)  # a first velocity as good as unknown
    n = np.arange(3, 202)
    line = 2 * 100.0 * (4 * n - 2) / (n * (n + 1))
    slope = 2 * 100.0 * 12 / (n * (n * n - 1))
    np.testing.assert_allclose(variances[2:], np.stack([line, slope], axis=1), rtol=1e-4)


def test_the_bound_opens_where_a_turn_begins() -> None:
    variances = bound(drive((0.0, 0.0), ((100, 150, 90.0),)), 10.0, 10.0)
    assert (np.diff(variances[10:100, 1]) < 0).all()
    assert variances[100, 1] > variances[99, 1]
    assert variances[151, 1] > variances[150, 1]
