"""Trilateration: exact on exact measurements, honest about its errors, and never silent about bad geometry."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from candaemon.arrays import Floats
from candaemon.estimation.radial import radial
from candaemon.estimation.trilateration import Status, Trilateration, trilaterate
from tests.support.effort import examples

SEEDS = st.integers(0, 2**32 - 1)
BUMPER = np.array([(3.6, 0.8), (3.6, -0.8)])
CORNERS = np.array([(3.6, 0.8), (3.6, -0.8), (0.2, 0.9), (0.2, -0.9)])
AHEAD = np.array([1.0, 0.0])
DEVIATIONS = np.array([0.05, 0.02, 1.0])
NOISE = np.diag(DEVIATIONS**2)


def ahead(seed: int, count: int) -> Floats:
    """Return the motion of targets before the bumper, (count, 6)."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-1.3, 1.3, (count, 1))
    place = BUMPER.mean(axis=0) + rng.uniform(2, 80, (count, 1)) * np.concatenate([np.cos(angle), np.sin(angle)], 1)
    return np.concatenate([place, 15.0 * rng.normal(size=(count, 2)), 5.0 * rng.normal(size=(count, 2))], axis=1)


def told(state: Floats, sensors: Floats = BUMPER, *, centripetal: bool = True) -> Trilateration:
    """Return what is told of exact measurements."""
    return trilaterate(radial(state, sensors), NOISE, sensors, AHEAD, centripetal=centripetal)


@settings(deadline=None, max_examples=examples(50))
@given(seed=SEEDS)
def test_two_sensors_anywhere_tell_the_motion_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sensors = np.array([[2.0, 0.0], [-2.0, 0.0]]) + rng.uniform(-3.0, 3.0, (2, 2))
    along = sensors[0] - sensors[1]
    normal = np.array([-along[1], along[0]]) / np.hypot(*along) * rng.choice([-1.0, 1.0])
    state = rng.uniform(-20.0, 20.0, (30, 6))
    state[:, :2] = (
        sensors.mean(axis=0) + rng.uniform(-20, 20, (30, 1)) * along / 4 + rng.uniform(2, 60, (30, 1)) * normal
    )
    result = trilaterate(radial(state, sensors), NOISE, sensors, normal)
    assert (result.status == Status.OK).all()
    np.testing.assert_allclose(result.state, state, rtol=1e-6, atol=1e-6)


def test_trilateration_equals_the_papers_closed_form() -> None:
    """(9) to (12) written out, sensors on the x axis, y forward, without the centripetal term."""
    x1, x2 = 0.8, -0.8
    r = np.array([[9.0, -4.0, 1.0], [9.6, -3.0, -2.0]])
    x = (x1**2 - x2**2 - r[0, 0] ** 2 + r[1, 0] ** 2) / (2 * (x1 - x2))
    y = np.sqrt((r[1, 0] ** 2 + r[0, 0] ** 2 - (x - x1) ** 2 - (x - x2) ** 2) / 2)
    lines = np.array([[(x - x1) / r[0, 0], y / r[0, 0]], [(x - x2) / r[1, 0], y / r[1, 0]]])
    sensors = np.array([(x1, 0.0), (x2, 0.0)])
    result = trilaterate(r[None], NOISE, sensors, np.array([0.0, 1.0]), centripetal=False)
    expected = [x, y, *np.linalg.solve(lines, r[:, 1]), *np.linalg.solve(lines, r[:, 2])]
    np.testing.assert_allclose(result.state[0], expected, rtol=1e-9)


def test_without_the_centripetal_term_accelerations_are_off_by_tens_near_the_car() -> None:
    state = np.array([[9.0, 2.0, -11.0, 5.0, 0.0, 0.0]])
    error = told(state, centripetal=False).state - state
    np.testing.assert_allclose(error[0, :4], 0.0, atol=1e-9)
    assert np.hypot(*error[0, 4:]) > 10.0
    np.testing.assert_allclose(told(state).state, state, atol=1e-9)


@settings(deadline=None, max_examples=examples(30))
@given(seed=SEEDS)
def test_more_sensors_are_the_least_squares_solution(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = ahead(seed, 5)
    measured = radial(state, CORNERS) + DEVIATIONS * rng.normal(size=(5, 4, 3))
    result = trilaterate(measured, NOISE, CORNERS, AHEAD)
    for k in range(5):

        def misfit(guess: Floats, k: int = k) -> Floats:
            return np.asarray(((measured[k] - radial(guess, CORNERS)) / DEVIATIONS).ravel())

        # wherever it starts from, scipy finds nothing that fits better
        found = [least_squares(misfit, start, x_scale="jac", xtol=1e-12) for start in (state[k], result.state[k])]
        assert np.square(misfit(result.state[k])).sum() <= 2 * min(each.cost for each in found) + 1e-4


def test_the_covariance_is_that_of_the_errors() -> None:
    rng = np.random.default_rng(7)
    state = np.repeat([[14.0, 3.0, -8.0, 4.0, 1.0, -2.0], [20.0, -9.0, 5.0, 9.0, 0.0, 3.0]], 4000, axis=0)
    for sensors in (BUMPER, CORNERS):
        noise = 0.2 * DEVIATIONS
        measured = radial(state, sensors) + noise * rng.normal(size=(len(state), len(sensors), 3))
        result = trilaterate(measured, np.diag(noise**2), sensors, AHEAD)
        error = result.state - state
        nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(result.covariance), error)
        assert (result.status == Status.OK).all()
        assert nees.mean() == pytest.approx(6.0, abs=0.15)
        ratio = np.sqrt(np.diagonal(result.covariance, axis1=1, axis2=2).mean(axis=0)) / error.std(axis=0)
        assert ratio == pytest.approx(np.ones(6), abs=0.06)


def test_each_measurement_counts_by_its_own_covariance() -> None:
    state = ahead(8, 50)
    measured = radial(state, CORNERS)
    measured[:, 3] += 0.5
    vague = np.tile(NOISE, (50, 4, 1, 1))
    vague[:, 3] *= 1e8
    result = trilaterate(measured, vague, CORNERS, AHEAD)
    np.testing.assert_allclose(result.state, state, rtol=1e-4, atol=1e-3)


def test_a_sensor_that_does_not_see_a_target_is_left_out_of_it_alone() -> None:
    state = ahead(9, 3)
    measured = radial(state, CORNERS)
    measured[0, 2:] = np.nan
    measured[1, 1, 2] = np.nan
    covariance = np.tile(NOISE, (3, 4, 1, 1))
    covariance[0, 2:] = np.nan
    result = trilaterate(measured, covariance, CORNERS, AHEAD)
    np.testing.assert_allclose(result.state, state, rtol=1e-6, atol=1e-6)
    pair = told(state[:1])
    np.testing.assert_allclose(result.covariance[0], pair.covariance[0], rtol=1e-9)
    assert np.trace(told(state, CORNERS).covariance[1]) < np.trace(result.covariance[1])


def test_two_sensors_take_the_mirror_image_that_a_track_expects() -> None:
    behind = np.array([[-8.0, 2.0, 3.0, 1.0, 0.5, 0.5]])
    mirrored = told(behind)
    np.testing.assert_allclose(mirrored.state[0, :2], (2 * 3.6 + 8.0, 2.0))
    assert mirrored.status == [Status.OK]
    result = trilaterate(radial(behind, BUMPER), NOISE, BUMPER, AHEAD, expected=np.array([[-7.0, 3.0]]))
    np.testing.assert_allclose(result.state, behind, atol=1e-9)
    assert result.status == [Status.BEHIND]


def test_sensors_off_one_line_tell_behind_by_themselves() -> None:
    state = ahead(10, 40)
    state[:20, 0] = 1.9 - (state[:20, 0] - 1.9)
    result = told(state, CORNERS)
    np.testing.assert_allclose(result.state, state, rtol=1e-6, atol=1e-6)
    assert (result.status[:20] == Status.BEHIND).all()
    assert (result.status[20:] == Status.OK).all()


@pytest.mark.parametrize(
    ("measured", "status", "place"),
    [
        ([(10.0, -1.0, 0.5), (11.6, -1.0, 0.5)], Status.ON_BASELINE, (3.6, 10.8)),
        ([(11.58, -1.0, 0.5), (9.96, -1.0, 0.5)], Status.ON_BASELINE, (3.6, -10.77)),
        ([(0.6, 1.0, 0.5), (0.98, -1.0, 0.5)], Status.ON_BASELINE, (3.6, 0.19)),
        ([(900_000.0, 1.0, 0.0), (900_000.0, 1.0, 0.0)], Status.ON_BASELINE, (900_003.6, 0.0)),
        ([(10.0, 0.0, 0.0), (15.0, 0.0, 0.0)], Status.APART, (3.6, 12.5)),
        ([(0.2, 0.0, 0.0), (0.3, 0.0, 0.0)], Status.APART, (3.6, 0.05)),
        ([(10.0, 0.0, 0.0), (np.nan, 0.0, 0.0)], Status.TOO_FEW, (0.0, 0.0)),
        ([(10.0, 0.0, np.inf), (10.0, 0.0, 0.0)], Status.TOO_FEW, (0.0, 0.0)),
        ([(np.nan,) * 3] * 2, Status.TOO_FEW, (0.0, 0.0)),
    ],
)
def test_degenerate_geometry_is_reported(
    measured: list[tuple[float, float, float]], status: Status, place: tuple[float, float]
) -> None:
    result = trilaterate(np.array([measured]), NOISE, BUMPER, AHEAD)
    assert result.status == [status]
    np.testing.assert_allclose(result.state[0, :2], place, atol=1e-6)
    deviation = np.sqrt(np.linalg.eigvalsh(result.covariance[0]))
    assert deviation.max() == pytest.approx(1000.0, rel=0.01)


def test_on_the_baseline_the_motion_along_it_holds() -> None:
    result = told(np.array([[3.6, 12.0, 7.0, -3.0, 2.0, 0.0]]))
    np.testing.assert_allclose(result.state[0, 2:4], (0.0, -3.0), atol=1e-6)
    assert np.sqrt(result.covariance[0, 2, 2]) > 500.0
    assert np.sqrt(result.covariance[0, 3, 3]) < 0.1


def test_sensors_at_one_place_are_as_one() -> None:
    result = told(ahead(11, 4), np.array([(3.6, 0.0), (3.6, 0.0)]))
    assert (result.status == Status.TOO_FEW).all()
    assert not result.state.any()


@settings(deadline=None, max_examples=examples(100))
@given(
    values=st.lists(
        st.sampled_from([0.0, -1.0, 1e-9, 0.8, 1.6, 10.0, 1e5, 1e300, np.inf, np.nan]), min_size=12, max_size=12
    ),
    count=st.integers(2, 4),
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
    centripetal=st.booleans(),
)
def test_any_measurement_gives_a_finite_result(
    values: list[float], count: int, scale: float, centripetal: bool
) -> None:
    measured = np.array(values).reshape(1, 4, 3)[:, :count]
    result = trilaterate(measured, scale**2 * NOISE, CORNERS[:count], AHEAD, centripetal=centripetal)
    assert np.isfinite(result.state).all()
    assert np.isfinite(result.covariance).all()
    if result.status[0] <= Status.BEHIND:
        used = (np.abs(measured[0]) < 1e6).all(axis=1)
        missed = measured[0, used, 0] - radial(result.state, CORNERS[:count])[0, used, 0]
        assert np.abs(missed).max() <= 5.01 * scale * DEVIATIONS[0]


def test_no_targets_are_no_results() -> None:
    result = trilaterate(np.empty((0, 2, 3)), NOISE, BUMPER, AHEAD)
    assert (result.state.shape, result.covariance.shape, result.status.shape) == ((0, 6), (0, 6, 6), (0,))


@pytest.mark.parametrize("measured", [8.0, np.nan])
def test_a_single_sensor_is_too_few(measured: float) -> None:
    result = trilaterate(np.full((2, 1, 3), measured), NOISE, BUMPER[:1], AHEAD)
    assert (result.status == Status.TOO_FEW).all()
    assert not result.state.any()
    np.testing.assert_array_equal(result.covariance, np.tile(1e6 * np.eye(6), (2, 1, 1)))
