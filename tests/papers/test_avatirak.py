"""Paper 001: the scenario's geometry, and the figures that its filters must reach."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np
import pytest

from candaemon.papers.avatirak import EXPERIMENTS
from candaemon.papers.avatirak_scenario import SENSORS, STEP, LeftTurn
from candaemon.papers.experiment import Result
from candaemon.papers.range_ekf import range_ekf

RUNS = 8
TURNS = (LeftTurn(11.0, 15.0, 0.8), LeftTurn(30.0, 10.0, 0.4), LeftTurn(20.0, 15.0, 0.6))
(TABLE,) = EXPERIMENTS


@pytest.fixture(scope="module")
def ran() -> tuple[Result, list[float]]:
    told: list[float] = []
    return TABLE.run(RUNS, 1, told.append), told


@pytest.fixture
def errors(ran: tuple[Result, list[float]]) -> Mapping[tuple[str, str], Mapping[str, float]]:
    """Return what was measured by (case, quantity) and method; the default estimator and the bound among them."""
    found: dict[tuple[str, str], dict[str, float]] = {}
    for row in ran[0].rows:
        assert row.default is not None
        assert row.bound is not None
        cell = found.setdefault((row.case, row.quantity), {"default": row.default, "bound": row.bound})
        cell[row.method] = row.here
    return found


@pytest.mark.parametrize("turn", TURNS)
def test_the_tracked_point_is_the_nearest_corner_and_moves_as_a_rigid_body(turn: LeftTurn) -> None:
    truth = turn.truth
    assert len(truth) == len(turn.time) == round(turn.duration / STEP)
    np.testing.assert_allclose(truth[0, :2], (5.0, 10.0), atol=0.01)
    others = [turn.outline(corner) for corner in product((1, -1), (1, -1))]
    distance = [np.hypot(each[:, 0], each[:, 1]) for each in others]
    np.testing.assert_array_equal(np.min(distance, axis=0), np.hypot(truth[:, 0], truth[:, 1]))
    assert truth[:, 1].min() > 0.0, "never on the line through the radars or behind it"
    slope = (truth[2:, :4] - truth[:-2, :4]) / (2 * STEP)
    np.testing.assert_allclose(truth[1:-1, 2:], slope, rtol=1e-5, atol=1e-5)


def test_the_vehicle_is_four_metres_by_one_point_eight_and_its_centre_turns_as_told() -> None:
    turn = TURNS[1]
    rear_left, rear_right, front_left, front_right = (
        turn.outline(corner) for corner in ((-1, -1), (1, -1), (-1, 1), (1, 1))
    )
    assert np.hypot(*(rear_left - rear_right)[:, :2].T) == pytest.approx(1.8)
    assert np.hypot(*(rear_left - front_left)[:, :2].T) == pytest.approx(4.0)
    centre = (rear_left + front_right) / 2 + [0.0, 0.0, 0.0, 21.0, 0.0, 0.0]
    assert np.hypot(centre[:, 2], centre[:, 3]) == pytest.approx(30.0)
    assert np.hypot(centre[:, 4], centre[:, 5]) == pytest.approx(90.0)
    assert centre[0, 4] == pytest.approx(-90.0, abs=0.1)
    assert centre[0, 3] == pytest.approx(30.0, abs=0.1)


def test_the_radars_measure_with_the_papers_noise() -> None:
    turn = TURNS[0]
    measured = turn.measured(3, np.random.default_rng(2))
    assert measured.shape == (4000, 3, 2, 3)
    exact = np.hypot(*(turn.truth[:, None, :2] - SENSORS).transpose(2, 0, 1))
    assert (measured[..., 0] - exact[:, None]).std() == pytest.approx(0.05, rel=0.02)
    without = turn.measured(3, np.random.default_rng(2), centripetal=False)
    np.testing.assert_array_equal(measured[..., :2], without[..., :2])
    assert (measured - without)[..., 2].min() > 0.0


@pytest.mark.slow
def test_the_turning_ekf_is_below_the_best_of_the_paper_in_all_cells(
    ran: tuple[Result, list[float]], errors: Mapping[tuple[str, str], Mapping[str, float]]
) -> None:
    best: dict[tuple[str, str], float] = {}
    for row in ran[0].rows:
        if row.printed is not None:
            key = (row.case, row.quantity)
            best[key] = min(best.get(key, np.inf), row.printed)
    assert len(best) == 18
    assert [key for key in best if errors[key]["turning EKF"] >= best[key]] == []


@pytest.mark.slow
def test_all_but_the_papers_own_are_near_the_bound_in_position_and_velocity(
    errors: Mapping[tuple[str, str], Mapping[str, float]],
) -> None:
    for (case, quantity), cell in errors.items():
        most = {"position": 0.02, "velocity": 0.12}.get(quantity.partition(" ")[0])
        if most is not None:
            assert max(cell["MLKF"], cell["turning EKF"]) < most
            assert cell["default"] < most or case == "s2", "which turns as no vehicle does"
        assert cell["bound"] < min(cell["turning EKF"], cell["default"])


@pytest.mark.slow
def test_what_the_paper_drops_is_what_its_mlkf_errs_by(
    errors: Mapping[tuple[str, str], Mapping[str, float]],
) -> None:
    for case, axis in product(("s1", "s2", "s3"), "xy"):
        cell = errors[case, f"velocity {axis}"]
        assert cell["MLKF without centripetal term"] > 5 * cell["MLKF"]
    # of the printed biases these come out as they are printed
    assert errors["s1", "velocity x"]["MLKF without centripetal term"] == pytest.approx(0.276, rel=0.1)
    assert errors["s2", "velocity x"]["MLKF without centripetal term"] == pytest.approx(0.4801, rel=0.2)


@pytest.mark.slow
def test_ranges_alone_and_no_process_noise_lose_a_hard_turn(
    errors: Mapping[tuple[str, str], Mapping[str, float]],
) -> None:
    assert errors["s2", "position x"]["EKF"] > 0.5
    assert errors["s2", "velocity x"]["EKF"] > 4.0


def test_the_baseline_ekf_finds_what_its_model_allows() -> None:
    """Constant acceleration and ranges without noise: it ends on the truth that it does not start from."""
    time = 0.01 * np.arange(400)
    start = np.array([5.0, 12.0, -2.0, -1.0, 0.5, -0.3])
    place = start[:2] + time[:, None] * start[2:4] + time[:, None] ** 2 / 2 * start[4:]
    ranges = np.hypot(*(place[:, None] - SENSORS).transpose(2, 0, 1))[:, None]
    told: list[float] = []
    first = start + np.array([0.3, -0.3, 0.5, 0.5, 0.4, 0.4])
    estimates = range_ekf(ranges, SENSORS, 1e-3, 0.01, first[None], 100, told.append)
    assert estimates.shape == (4, 1, 6)
    np.testing.assert_allclose(estimates[-1, 0, :2], place[-1], atol=0.02)
    assert told == [1.0]


@pytest.mark.slow
def test_the_table_is_whole_and_its_drawings_small(ran: tuple[Result, list[float]]) -> None:
    result, told = ran
    assert sum(told) == pytest.approx(1.0)
    assert TABLE.paper == "001"
    assert len(result.rows) == 3 * 6 * 4
    assert [figure.name for figure in result.figures] == ["001-s1", "001-s2", "001-s3"]
    for figure in result.figures:
        assert len(figure.panels) == 7
        for line in (line for panel in figure.panels for line in panel.lines):
            assert line.x.shape == line.y.shape
            assert len(line.x) <= 2000
            assert np.isfinite(line.y).all()
