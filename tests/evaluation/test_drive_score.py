from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from candaemon.arrays import Booleans, Integers
from candaemon.evaluation.chi_square import chi2_quantile
from candaemon.evaluation.drive_score import NisScore, PredictionScore, StationarySpeed
from candaemon.evaluation.duplicates import DuplicateScore, duplicated
from candaemon.evaluation.object_runs import ObjectRuns

CYCLE_NS = 50_000_000


def objects(*numbers: int) -> Integers:
    return np.array(numbers, dtype=np.int64)


def flags(*values: bool) -> Booleans:
    return np.array(values, dtype=bool)


def test_a_run_ends_with_a_flag_an_absence_or_a_lost_scan() -> None:
    runs = ObjectRuns([0.05, 0.05])
    old = flags(False, False)
    first = runs.update(0, 0, objects(5, 2), old)
    assert first.tolist() == [0, 1]
    assert runs.update(0, CYCLE_NS, objects(2, 5), old).tolist() == [1, 0]
    assert runs.update(1, CYCLE_NS, objects(2, 5), old).tolist() == [2, 3]
    assert runs.update(0, 2 * CYCLE_NS, objects(2, 5), flags(True, False)).tolist() == [4, 0]
    assert runs.update(0, 3 * CYCLE_NS, objects(5), flags(False)).tolist() == [0]
    assert runs.update(0, 4 * CYCLE_NS, objects(2, 5), old).tolist() == [5, 0]
    assert runs.update(0, 6 * CYCLE_NS, objects(5), flags(False)).tolist() == [6]
    assert runs.update(0, 5 * CYCLE_NS, objects(5), flags(False)).tolist() == [7]


def score_of(scans: int, *, late: bool = False, break_at: int | None = None, jitter_ns: int = 0) -> PredictionScore:
    """Predict the true place plus 0.3 m in x and minus 0.4 m in y of one object that moves at 2 m/s along x."""
    score = PredictionScore([0.5, 1.0], [0.05])
    runs = ObjectRuns([0.05])
    made: list[tuple[int, Integers]] = []
    for k in range(scans):
        time_ns = k * CYCLE_NS + (jitter_ns if k % 2 else 0)
        run = runs.update(0, time_ns, objects(3), flags(k == break_at))
        made.append((time_ns, run))
        score.measure(0, time_ns, run, np.array([2e-9 * time_ns]), np.array([1.0]))
        for horizon, ahead in enumerate((10, 20)):
            told = k - ahead if late else k
            if told < 0:
                continue
            at_ns, of = made[told]
            due = at_ns + ahead * CYCLE_NS
            score.predict(0, at_ns, horizon, of, np.array([2e-9 * due + 0.3]), np.array([0.6]))
    return score


@pytest.mark.parametrize("late", [False, True])
def test_predictions_are_compared_at_their_horizons(late: bool) -> None:
    half, one = score_of(100, late=late).result()
    assert (half.horizon, one.horizon) == (0.5, 1.0)
    assert (half.samples, one.samples) == (90, 80)
    assert half.x == pytest.approx(0.3)
    assert one.y == pytest.approx(0.4)


def test_the_nearest_scan_within_half_a_cycle_is_taken() -> None:
    half, _ = score_of(100, jitter_ns=10_000_000).result()
    assert half.samples == 90
    assert half.x == pytest.approx(0.3)


def test_a_short_run_does_not_count_and_a_new_flag_voids() -> None:
    assert score_of(60).result()[0].samples == 0
    assert math.isnan(score_of(60).result()[0].x)
    # 3.0 s from the first to the last scan
    assert score_of(61).result()[0].samples == 51
    # two runs, 80 and 70 scans: none of the predictions made in the last ten scans of either is met
    assert score_of(150, break_at=80).result()[0].samples == 70 + 60


def test_a_lost_scan_or_a_step_back_leaves_nothing_to_compare() -> None:
    score = PredictionScore([0.5], [0.05], minimum_run=0.0)
    run, x = objects(0), np.array([1.0])
    score.measure(0, 0, run, x, x)
    score.predict(0, 0, 0, run, x, x)
    score.measure(0, 450_000_000, run, x, x)
    score.measure(0, 550_000_000, run, x, x)
    assert score.result()[0].samples == 0
    score.predict(0, 550_000_000, 0, run, x, x)
    score.measure(0, 100_000_000, run, x, x)
    score.measure(0, 1_050_000_000, run, x, x)
    assert score.result()[0].samples == 0


def samples(score: PredictionScore) -> list[int]:
    return [error.samples for error in score.result()]


def test_what_comes_in_bulk_at_the_end_of_a_drive_counts() -> None:
    """The predictions of a short horizon wait for those of a long one."""
    score, run, x = PredictionScore([0.5, 5.0], [0.05], minimum_run=0.0), objects(0), np.array([1.0])
    for k in range(200):
        score.measure(0, k * CYCLE_NS, run, x, x)
        for horizon in (0, 1) if k >= 100 else ():
            score.predict(0, (k - 100) * CYCLE_NS, horizon, run, x, x)
    for k in range(100, 190):
        score.predict(0, k * CYCLE_NS, 0, run, x, x)
    assert samples(score) == [190, 100]


def test_what_ego_motion_lets_wait_for_two_seconds_counts() -> None:
    score, run, x = PredictionScore([0.5, 1.0], [0.05], minimum_run=0.0), objects(0), np.array([1.0])
    told = 0
    for k in range(400):
        score.measure(0, k * CYCLE_NS, run, x, x)
        known = k if k % 40 == 39 else k // 40 * 40 - 1
        for at in range(told, max(known - 19, told)):
            for horizon in (0, 1):
                score.predict(0, at * CYCLE_NS, horizon, run, x, x)
        told = max(known - 19, told)
    assert samples(score) == [told, told]


def test_a_sensor_that_pauses_keeps_what_its_runs_have_shown() -> None:
    score, x, runs = PredictionScore([0.5, 1.0], [0.05, 0.05]), np.array([1.0]), range(6)
    for run in runs:
        for k in range(200):
            time_ns = (200 * run + k) * CYCLE_NS
            score.measure(0, time_ns, objects(1000), x, x)
            if k >= 73:
                continue
            score.measure(1, time_ns, objects(run), x, x)
            for horizon in (0, 1) if k >= 20 else ():
                score.predict(1, time_ns - 20 * CYCLE_NS, horizon, objects(run), x, x)
    assert samples(score) == [6 * 53, 6 * 53]


def test_two_drives_one_after_the_other_with_two_sensors() -> None:
    score, x = PredictionScore([0.5, 1.0], [0.05, 0.05]), np.array([1.0])
    for k in range(100):
        for sensor in (0, 1):
            score.measure(sensor, k * CYCLE_NS, objects(sensor), x, x)
            for horizon in (0, 1) if k >= 20 else ():
                score.predict(sensor, (k - 20) * CYCLE_NS, horizon, objects(sensor), x, x)
    for k in range(80, 90):
        for sensor in (0, 1):
            score.predict(sensor, k * CYCLE_NS, 0, objects(sensor), x, x)
    for k in range(2000, 2100):
        for sensor in (0, 1):
            score.measure(sensor, k * CYCLE_NS, objects(sensor + 10), x, x)
    assert samples(score) == [180, 160]


def test_memory_is_bounded_over_many_runs() -> None:
    score = PredictionScore([0.5], [0.05], minimum_run=0.5)
    nothing = np.array([0.0, 0.0])
    counted = 0
    for k in range(4000):
        run = objects(2 * (k // 40), 2 * (k // 40) + 1)
        score.measure(0, k * CYCLE_NS, run, nothing, nothing)
        score.predict(0, k * CYCLE_NS, 0, run, nothing + 1.0, nothing)
        counted += 2 * (k % 40 >= 10)
        assert len(score._runs.open().last_ns) <= 8
        assert len(score._streams[0].scans) <= 64
    assert score.result()[0].samples == counted
    assert score.result()[0].x == pytest.approx(1.0)


def test_stationary_speed_counts_runs_by_their_median() -> None:
    score = StationarySpeed(minimum_samples=4)
    # run 0 stands (three of five below 1 m/s), run 1 moves (two of five), run 2 is too short
    closing = {0: [0.1, -0.2, 5.0, 0.9, -7.0], 1: [0.1, -0.2, 5.0, 1.1, -7.0], 2: [0.0, 0.0, 0.0]}
    for k in range(5):
        run = objects(*(r for r in closing if k < len(closing[r])))
        here = np.array([closing[int(r)][k] for r in run])
        vx = np.where(run == 0, 0.3, 9.0)
        vy = np.where(run == 0, 0.4, 9.0)
        if k == 0:
            vx[0] = np.nan
        score.add(k * CYCLE_NS, run, here, vx, vy)
    result = score.result()
    assert (result.runs, result.samples) == (1, 4)
    assert result.vx == pytest.approx(0.3)
    assert result.speed == pytest.approx(0.5)
    score.add(60_000_000_000, objects(9), np.array([9.0]), np.array([9.0]), np.array([9.0]))
    assert score.result() == result


def test_nothing_seen_gives_nan() -> None:
    assert math.isnan(StationarySpeed().result().vx)
    assert math.isnan(NisScore().mean)
    assert DuplicateScore().share == 0.0


@given(st.integers(1, 20), st.floats(0.01, 0.99))
@settings(deadline=None)
def test_chi2_quantile_is_scipys(dof: int, share: float) -> None:
    assert chi2_quantile(share, dof) == pytest.approx(float(chi2.ppf(share, dof)), rel=1e-9)


def test_nis_of_consistent_innovations() -> None:
    generator = np.random.default_rng(4)
    score = NisScore()
    for _ in range(400):
        dof = generator.integers(1, 4, size=20)
        score.add(np.array([float(generator.chisquare(k)) for k in dof]), dof)
    score.add(np.empty(0), np.empty(0, dtype=np.int64))
    assert score.samples == 8000
    assert score.expected == pytest.approx(2.0, abs=0.05)
    assert score.mean / score.expected == pytest.approx(1.0, abs=0.04)
    assert score.coverage == pytest.approx(0.95, abs=0.01)


def test_nis_by_hand() -> None:
    score = NisScore()
    score.add(np.array([3.8, 3.9, 7.7]), np.array([1, 1, 3]))
    assert score.mean == pytest.approx(15.4 / 3)
    assert score.expected == pytest.approx(5 / 3)
    # 95 % quantiles: 3.841 and 7.815
    assert score.coverage == pytest.approx(2 / 3)


def test_duplicates_by_hand() -> None:
    x = np.array([10.0, 12.9, 20.0, 22.0, 40.0, 41.0])
    y = np.array([0.0, 0.9, 0.0, 1.1, 0.0, 0.0])
    vx = np.array([5.0, 5.9, 5.0, 5.0, 5.0, 6.1])
    assert duplicated(x, y, vx).tolist() == [True, True, False, False, False, False]
    score = DuplicateScore()
    score.add(x, y, vx)
    score.add(x[:2], y[:2], np.array([5.0, np.nan]))
    assert (score.samples, score.duplicates) == (8, 2)
    assert score.share == 0.25


@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-2, 2), st.floats(-2, 2)), max_size=12))
@settings(deadline=None)
def test_duplicates_do_not_depend_on_the_order(rows: list[tuple[float, float, float]]) -> None:
    table = np.array(rows).reshape(-1, 3)
    order = np.argsort(table[:, 0], kind="stable")
    assert duplicated(*table[order].T).tolist() == duplicated(*table.T)[order].tolist()
