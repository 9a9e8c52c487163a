"""The filter of bodies against a plain extended Kalman filter, and what stays true of its states."""

from __future__ import annotations

from dataclasses import replace
from math import cos, exp, hypot, pi, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats, Indices
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.estimation.body_filter import (
    ACCELERATION,
    BIAS,
    POSITION,
    TURN,
    VELOCITY,
    BodyDynamics,
    BodyFilter,
    BodyFilterState,
    BodyMode,
    report_jacobian,
    reported,
)
from candaemon.estimation.body_rates import BodyRates
from candaemon.estimation.measurement import Measurement, Projection
from candaemon.tracking.body_modes import STANDING, dynamics_of, modes_of
from tests.support.builders import random_covariance, rotation
from tests.support.effort import examples

DEFAULT = VehicleEstimatorSettings(kind="vehicle")
MODES = modes_of(DEFAULT)
DYNAMICS = BodyDynamics(
    first_acceleration=1.0,
    acceleration_time=1.5,
    turn_rate=0.3,
    standing=0.15,
    first_bias=0.2,
    evidence=1.0,
)
BIAS_TIME = 1.2
DRIVING = BodyMode(
    moves=True, acceleration=2.0, lateral_acceleration=1.5, velocity_noise=0.05, bias_walk=0.1, dwell=3.0,
    turn_time=2.0, settles=True,
)  # fmt: skip
FREE = BodyMode(
    moves=True, acceleration=0.0, lateral_acceleration=0.0, velocity_noise=2.0, bias_walk=0.0, dwell=1.0, turn_time=2.0
)
ORIGIN, OWN = np.array([1.0, -2.0]), np.array([12.0, 1.0])
ROUNDING = 1e-9
SEEDS = st.integers(0, 2**32 - 1)


def spawned(modes: tuple[BodyMode, ...], n: int, seed: int, dynamics: BodyDynamics = DYNAMICS) -> BodyFilter:
    """Return a filter of n bodies with any states."""
    rng, m = np.random.default_rng(seed), len(modes)
    mean = rng.normal(size=(n, m, 8)) * [40.0, 20.0, 12.0, 6.0, 0.1, 1.0, 0.3, 0.3]
    mean[..., 0] += 60.0  # ahead of the sensor
    covariance = random_covariance(rng, 8, n * m).reshape(n, m, 8, 8)
    scale = np.diag([1.0, 1.0, 1.0, 1.0, 0.05, 0.5, 0.3, 0.3])
    bodies = BodyFilter(modes, dynamics)
    bodies.state = BodyFilterState(mean, scale @ covariance @ scale, rng.dirichlet(np.ones(m), n))
    return bodies


def directions(n: int, seed: int) -> Floats:
    turned: Floats = rotation(np.random.default_rng(seed).uniform(-pi, pi, n))[:, :, 0]
    return turned


def seen(position: Floats, seed: int, *, rated: bool = True, projected: bool = True) -> Measurement:
    """Return a measurement of places, with range rates and velocities where wanted."""
    rng, n = np.random.default_rng(seed), len(position)
    rate = rng.normal(size=n) * 5 if rated else None
    parts = (Projection(directions(n, seed + 1), rng.normal(size=n) * 5, rng.uniform(0.1, 1, n)),) if projected else ()
    variance = None if rate is None else np.full(n, 0.04)
    return Measurement(position.copy(), random_covariance(rng, 2, n) * 0.2, ORIGIN, OWN, rate, variance, parts)


def updated(bodies: BodyFilter, rows: Indices, measurement: Measurement, alike: float = 1.0) -> Floats:
    """Update with a measurement, its range rates each along the line of sight to its body; return the NIS."""
    rates, m = None, len(rows)
    if measurement.range_rate is not None and measurement.range_rate_variance is not None:
        values = measurement.range_rate, measurement.range_rate_variance
        known = np.zeros((m, 2)), np.zeros(m)
        rates = BodyRates(*values, np.arange(m), *known, measurement.origin, measurement.velocity)
    return bodies.update(rows, measurement, alike, rates)


def plain_motion(x: Floats, dt: float, mode: BodyMode, axis: Floats, settling: float) -> Floats:
    """Return a state (8,) after dt, one component after the other."""
    turns = mode.moves and mode.acceleration > 0.0
    speed = hypot(x[2], x[3])
    course = x[2:4] / speed if speed > 1.0 else axis
    angle = min(max(x[4], -0.6), 0.6) * dt if turns else 0.0
    after = rotation(angle) @ x[2:4] + course * (x[5] * dt if turns else 0.0)
    if not mode.moves:
        after = np.zeros(2)
    left = np.array([-axis[1], axis[0]])
    if mode.settles:
        slow = exp(-((speed / DYNAMICS.settling_speed) ** 2))
        after = after - (1.0 - exp(-settling * slow * dt)) * (left @ after) * left
    before = x[2:4] if mode.moves else np.zeros(2)
    fade = np.exp(-dt / np.array([mode.turn_time, DYNAMICS.acceleration_time, *[BIAS_TIME] * 2]))
    return np.concatenate([x[:2] + dt / 2 * (before + after), after, x[4:] * fade])


def differences(x: Floats, dt: float, mode: BodyMode, axis: Floats) -> Floats:
    """Return the Jacobian of the plain motion by central differences; the course is held."""
    columns = []
    for k in range(8):
        step = np.zeros(8)
        step[k] = 1e-6
        columns.append(
            (plain_motion(x + step, dt, mode, axis, 0.0) - plain_motion(x - step, dt, mode, axis, 0.0)) / 2e-6
        )
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("mode", [DRIVING, FREE, MODES[STANDING]], ids=["driving", "free", "standing"])
@pytest.mark.parametrize("settling", [0.0, 1.5])
def test_the_means_move_as_written_out(mode: BodyMode, settling: float) -> None:
    bodies, axis = spawned((mode,), 20, 3), directions(20, 4)
    before = bodies.state.mean[:, 0].copy()
    bodies.predict(0.07, axis, np.zeros((20, 2)), np.full(20, settling), np.full(20, BIAS_TIME))
    for row in range(20):
        expected = plain_motion(before[row], 0.07, mode, axis[row], settling)
        np.testing.assert_allclose(bodies.state.mean[row, 0], expected, rtol=0, atol=1e-10)


def noiseless(mode: BodyMode) -> tuple[BodyMode, BodyDynamics]:
    """Return a mode and dynamics without process noise, so that the covariance shows the Jacobian alone."""
    still = BodyMode(
        moves=True, acceleration=mode.acceleration and 1e-9, lateral_acceleration=0.0, velocity_noise=0.0,
        bias_walk=0.0, dwell=1.0, turn_time=mode.turn_time,
    )  # fmt: skip
    return still, DYNAMICS


@pytest.mark.parametrize("mode", [DRIVING, FREE], ids=["driving", "free"])
def test_the_covariance_follows_the_jacobian(mode: BodyMode) -> None:
    """The course is held in the Jacobian: so it is exact without acceleration."""
    still, dynamics = noiseless(mode)
    bodies, axis = spawned((still,), 10, 5, dynamics), directions(10, 6)
    bodies.state.mean[..., ACCELERATION] = 0.0
    bodies.state.mean[..., TURN] = np.clip(bodies.state.mean[..., TURN], -0.5, 0.5)
    mean, covariance = bodies.state.mean[:, 0].copy(), bodies.state.covariance[:, 0].copy()
    bodies.predict(0.05, axis, np.zeros((10, 2)), np.zeros(10), np.full(10, BIAS_TIME))
    for row in range(10):
        jacobian = differences(mean[row], 0.05, still, axis[row])
        expected = jacobian @ covariance[row] @ jacobian.T
        # the small turn of a Jacobian that holds the angle while it is differentiated
        np.testing.assert_allclose(bodies.state.covariance[row, 0], expected, rtol=0, atol=2e-3)


def test_the_noise_is_that_of_its_modes() -> None:
    dt, walk = 0.1, np.array([[0.3, 0.1]])
    bodies = BodyFilter((DRIVING,), DYNAMICS)
    mean = np.array([[[30.0, 0.0, 20.0, 0.0, 0.0, 0.0, 0.0, 0.0]]])
    bodies.state = BodyFilterState(mean, np.zeros((1, 1, 8, 8)), np.ones((1, 1)))
    angle = 0.4
    axis = np.array([[cos(angle), sin(angle)]])
    bodies.predict(dt, axis, walk, np.zeros(1), np.full(1, BIAS_TIME))
    q = bodies.state.covariance[0, 0]
    expected = np.zeros((8, 8))
    block = 0.05 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    expected[np.ix_([0, 2], [0, 2])] = expected[np.ix_([1, 3], [1, 3])] = block
    turn = rotation(angle)
    expected[6:, 6:] = turn @ np.diag([0.3, 0.1]) @ turn.T * dt + np.eye(2) * 0.1 * dt
    expected[4, 4] = (1.5 / 20.0) ** 2 * (1 - exp(-2 * dt / DRIVING.turn_time))
    expected[5, 5] = 2.0**2 * (1 - exp(-2 * dt / DYNAMICS.acceleration_time))
    np.testing.assert_allclose(q, expected, atol=1e-12)


def observation(x: Floats, measurement: Measurement, row: int) -> tuple[Floats, Floats, Floats]:
    """Return innovation, H and R of one detection, all its parts after one another."""
    z, h, r = list(measurement.position[row]), [], measurement.noise[row]
    expected = list(x[:2] + x[6:])
    h = [np.eye(8)[0] + np.eye(8)[6], np.eye(8)[1] + np.eye(8)[7]]
    assert measurement.range_rate is not None
    assert measurement.range_rate_variance is not None
    variances = []
    if np.isfinite(measurement.range_rate[row]):
        sight, relative = x[:2] + x[6:] - ORIGIN, x[2:4] - OWN
        distance = hypot(*sight)
        unit = sight / distance
        rate = unit @ relative
        line = np.zeros(8)
        line[:2] = line[6:] = (relative - rate * unit) / distance
        line[2:4] = unit
        z.append(measurement.range_rate[row])
        expected.append(rate)
        h.append(line)
        variances.append(measurement.range_rate_variance[row])
    noise = np.zeros((len(z), len(z)))
    noise[:2, :2] = r
    noise[2:, 2:] = np.diag(variances)
    return np.array(z) - np.array(expected), np.array(h), noise


def test_an_update_of_places_is_the_dense_one() -> None:
    bodies = spawned((DRIVING, FREE), 6, 7)
    before = bodies.state
    mean, covariance, prior = before.mean.copy(), before.covariance.copy(), before.probability.copy()
    measurement = seen(mean[:, 0, :2] + 0.5, 8, rated=False, projected=False)
    nis = updated(bodies, np.arange(6), measurement)
    for row in range(6):
        likelihood, expected_nis = np.zeros(2), np.zeros(2)
        for mode in range(2):
            x, p = mean[row, mode], covariance[row, mode]
            h = np.hstack([np.eye(2), np.zeros((2, 4)), np.eye(2)])
            innovation = measurement.position[row] - h @ x
            s = h @ p @ h.T + measurement.noise[row]
            gain = p @ h.T @ np.linalg.inv(s)
            np.testing.assert_allclose(bodies.state.mean[row, mode], x + gain @ innovation, atol=ROUNDING)
            np.testing.assert_allclose(bodies.state.covariance[row, mode], p - gain @ s @ gain.T, atol=ROUNDING)
            expected_nis[mode] = innovation @ np.linalg.solve(s, innovation)
            likelihood[mode] = exp(-0.5 * expected_nis[mode]) / np.sqrt(np.linalg.det(2 * pi * s))
        weight = prior[row] * likelihood
        np.testing.assert_allclose(bodies.probability[row], weight / weight.sum(), atol=1e-5)
        assert nis[row] == pytest.approx(prior[row] @ expected_nis)


def test_parts_are_taken_one_after_the_other() -> None:
    """The range rate is linearised where the place has moved the state to: an iterated, not a joint update."""
    bodies = spawned((DRIVING,), 5, 9)
    mean, covariance = bodies.state.mean[:, 0].copy(), bodies.state.covariance[:, 0].copy()
    measurement = seen(mean[:, :2] + 0.3, 10, projected=False)
    updated(bodies, np.arange(5), measurement)
    for row in range(5):
        x, p = mean[row], covariance[row]
        for part in (slice(0, 2), slice(2, 3)):
            innovation, h, noise = observation(x, measurement, row)
            innovation, h, noise = innovation[part], h[part], noise[part, part]
            gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + noise)
            x, p = x + gain @ innovation, p - gain @ h @ p
        np.testing.assert_allclose(bodies.state.mean[row, 0], x, atol=ROUNDING)
        np.testing.assert_allclose(bodies.state.covariance[row, 0], p, atol=ROUNDING)


def test_range_rates_of_one_body_tell_what_they_tell_one_after_the_other() -> None:
    """Of bodies whose place is known: two components of the velocity are all that five range rates know."""
    bodies, rng = spawned((DRIVING,), 2, 21), np.random.default_rng(22)
    for side in (bodies.state.covariance, np.swapaxes(bodies.state.covariance, 2, 3)):
        side[:, :, [0, 1, 6, 7]] = 0.0
    mean, covariance = bodies.state.mean[:, 0].copy(), bodies.state.covariance[:, 0].copy()
    measurement = seen(mean[:, :2] + mean[:, 6:], 23, rated=False, projected=False)
    body, offset = np.array([0, 1, 0, 0, 1]), rng.normal(size=(5, 2)) * [8.0, 15.0]
    value, variance = rng.normal(size=5) * 5.0, rng.uniform(1e-4, 1e-3, 5)
    value[2] = np.nan
    bodies.update(np.arange(2), measurement, 1.0, BodyRates(value, variance, body, offset, np.zeros(5), ORIGIN, OWN))
    for row in range(2):
        x, p = mean[row], covariance[row]
        for k in np.flatnonzero((body == row) & np.isfinite(value)):
            sight, h = x[:2] + x[6:] + offset[k] - ORIGIN, np.zeros(8)
            h[2:4] = sight / hypot(*sight)
            gain = p @ h / (h @ p @ h + variance[k])
            x, p = x + gain * (value[k] - h[2:4] @ (x[2:4] - OWN)), p - np.outer(gain, h @ p)
        np.testing.assert_allclose(bodies.state.mean[row, 0], x, atol=ROUNDING)
        np.testing.assert_allclose(bodies.state.covariance[row, 0], p, atol=ROUNDING)


@pytest.mark.parametrize("mode", [DRIVING, MODES[STANDING]], ids=["drives", "stands"])
def test_range_rates_of_two_ends_tell_how_a_body_turns(mode: BodyMode) -> None:
    """As a Kalman filter whose measurement is u · (v + ω × r) does it; what stands turns in no way."""
    bodies = spawned((mode,), 1, 31)
    for side in (bodies.state.covariance, np.swapaxes(bodies.state.covariance, 2, 3)):
        side[:, :, [0, 1, 6, 7]] = 0.0
    x, p = bodies.state.mean[0, 0].copy(), bodies.state.covariance[0, 0].copy()
    measurement = seen((x[:2] + x[6:])[None], 23, rated=False, projected=False)
    arm, value, variance = np.array([[2.0, -1.0], [-1.5, 4.0]]), np.array([3.0, -2.0]), np.array([0.04, 0.01])
    told = value, variance, np.zeros(2, np.intp), 5.0 * arm, np.zeros(2)
    bodies.update(np.arange(1), measurement, 1.0, BodyRates(*told, ORIGIN, OWN, arm=arm))
    place = x[:2] + x[6:]
    for k in range(2):
        sight, h = place + 5.0 * arm[k] - ORIGIN, np.zeros(8)
        u = sight / hypot(*sight)
        h[2:4], h[4] = u, mode.moves * (u[1] * arm[k, 0] - u[0] * arm[k, 1])
        gain = p @ h / (h @ p @ h + variance[k])
        x, p = x + gain * (value[k] + u @ OWN - h @ x), p - np.outer(gain, h @ p)
    np.testing.assert_allclose(bodies.state.mean[0, 0], x, atol=ROUNDING)
    np.testing.assert_allclose(bodies.state.covariance[0, 0], p, atol=ROUNDING)


def test_a_component_that_hardly_anything_tells_is_left_out() -> None:
    """Two reflections side by side far away: they know the speed across to tens of metres a second, no better."""
    aside, value = np.array([[0.0, -0.5], [0.0, 0.5]]), np.array([19.0, 19.2])
    rates = BodyRates(value, np.full(2, 0.04), np.zeros(2, np.intp), aside, np.zeros(2), np.zeros(2), np.zeros(2))
    (only,) = rates.components(np.array([[100.0, 0.0, 20.0, 5.0]]))
    np.testing.assert_allclose(np.abs(only.direction), [[1.0, 0.0]], atol=1e-3)
    np.testing.assert_allclose(only.variance, 0.02, rtol=1e-3)
    silent = replace(rates, value=np.full(2, np.nan))
    assert silent.components(np.ones((1, 4))) == ()


def test_close_by_the_range_rate_of_a_reflection_that_wanders_tells_less() -> None:
    """At 3 m abreast of what passes at 12 m/s, half a metre along it is 2 m/s of range rate; at 60 m, a tenth."""
    told = np.zeros(1), np.full(1, 0.01), np.zeros(1, np.intp)
    rates = BodyRates(*told, np.zeros((1, 2)), np.full(1, 0.25), np.zeros(2), np.zeros(2))
    for distance, deviation in ((3.0, 2.0), (60.0, 0.1)):
        (only,) = rates.components(np.array([[0.0, distance, 12.0, 0.0]]))
        np.testing.assert_allclose(only.variance, 0.01 + deviation**2)


def test_speeds_that_were_not_measured_change_nothing() -> None:
    rated, silent = spawned(MODES, 4, 11), spawned(MODES, 4, 11)
    measurement = seen(rated.state.mean[:, 0, :2], 12)
    assert measurement.range_rate is not None
    measurement.range_rate[:] = np.nan
    measurement.projections[0].value[:] = np.nan
    bare = Measurement(measurement.position, measurement.noise, ORIGIN, OWN)
    np.testing.assert_allclose(updated(rated, np.arange(4), measurement), updated(silent, np.arange(4), bare))
    for name in ("mean", "covariance", "probability"):
        np.testing.assert_allclose(getattr(rated.state, name), getattr(silent.state, name), atol=1e-12)


def test_rows_are_updated_as_if_they_were_alone() -> None:
    every, some = spawned(MODES, 5, 13), spawned(MODES, 5, 13)
    measurement, rows = seen(every.state.mean[:, 0, :2], 14), np.array([3, 1])
    before = some.state.mean[[0, 2, 4]].copy()
    nis = updated(every, np.arange(5), measurement)
    np.testing.assert_allclose(updated(some, rows, measurement.take(rows)), nis[rows])
    np.testing.assert_allclose(some.state.mean[rows], every.state.mean[rows])
    np.testing.assert_allclose(some.state.covariance[rows], every.state.covariance[rows])
    np.testing.assert_array_equal(some.state.mean[[0, 2, 4]], before)


def assert_sound(bodies: BodyFilter) -> None:
    """Hold that states are numbers, covariances symmetric and positive definite, probabilities sum to one."""
    state = bodies.state
    assert np.isfinite(state.mean).all()
    scale = np.sqrt(np.diagonal(state.covariance, axis1=-2, axis2=-1))
    assert (scale > 0.0).all()
    correlation = state.covariance / scale[..., None] / scale[..., None, :]
    np.testing.assert_allclose(correlation, np.swapaxes(correlation, -2, -1), atol=1e-6)
    assert np.linalg.eigvalsh((correlation + np.swapaxes(correlation, -2, -1)) / 2).min() > 0.0
    np.testing.assert_allclose(bodies.probability.sum(axis=1), 1.0, atol=1e-12)
    assert (bodies.probability > 0.0).all()


def first_seen(n: int, rng: np.random.Generator) -> BodyFilter:
    bodies, m = BodyFilter(MODES, dynamics_of(DEFAULT)), len(MODES)
    bodies.spawn(
        rng.uniform(5, 100, (n, 2)),
        np.tile(np.eye(2) * 0.1, (n, 1, 1)),
        np.zeros((n, m, 2)),
        np.tile(np.diag([100.0, 4.0]), (n, m, 1, 1)),
        np.full((n, m), 1 / m),
    )
    return bodies


@pytest.mark.parametrize("settling", [0.0, 2.0])
def test_long_runs_stay_sound(settling: float) -> None:
    """Cars that turn and brake, measured, missed, measured without range rates, in odd steps."""
    rng, n = np.random.default_rng(15), 8
    bodies = first_seen(n, rng)
    place, velocity = bodies.state.mean[:, 0, :2].copy(), rng.normal(size=(n, 2)) * 10
    for k in range(1500):
        dt = float(rng.choice([0.0005, 0.05, 0.05, 0.05, 0.3]))
        place = place + dt * velocity
        velocity = velocity @ rotation(0.2 * dt * np.sin(k / 50)).T
        place[np.hypot(*place.T) > 200.0] *= -0.9
        bodies.predict(dt, directions(n, k), np.tile([0.05, 0.2], (n, 1)), np.full(n, settling), np.full(n, BIAS_TIME))
        rows = np.flatnonzero(rng.random(n) < 0.9)
        measurement = seen((place + rng.normal(size=(n, 2)) * 0.3)[rows], k, projected=k % 3 == 0)
        assert measurement.range_rate is not None
        measurement.range_rate[rng.random(len(rows)) < 0.3] = np.nan
        if len(rows):
            updated(bodies, rows, measurement)
        if k % 100 == 0:
            assert_sound(bodies)
    assert_sound(bodies)


def test_what_the_walk_of_reflections_hides_is_not_taken_for_a_turn() -> None:
    uncertain = []
    for hidden in (0.0, 0.5, 1.0):
        bodies = spawned((DRIVING,), 6, 3)
        bodies.predict(0.5, directions(6, 4), np.zeros((6, 2)), np.full(6, hidden), np.full(6, BIAS_TIME))
        uncertain.append(bodies.state.covariance[:, 0, 4, 4])
    assert (uncertain[0] > uncertain[1]).all()
    assert (uncertain[1] > uncertain[2]).all()


def test_the_course_of_what_is_fast_does_not_settle_to_its_axis() -> None:
    drifts = []
    for speed in (1.0, 30.0):
        bodies = spawned((DRIVING,), 1, 3)
        bodies.state.mean[0, 0, 2:6] = [speed, 0.5, 0.0, 0.0]
        bodies.predict(1.0, np.array([[1.0, 0.0]]), np.zeros((1, 2)), np.ones(1), np.full(1, BIAS_TIME))
        drifts.append(float(bodies.state.mean[0, 0, 3]))
    np.testing.assert_allclose(drifts, [0.5 * exp(-exp(-(1.25 / 25.0))), 0.5], rtol=1e-6)


def test_each_bias_fades_in_a_time_of_its_own() -> None:
    bodies, times = spawned((DRIVING,), 3, 3), np.array([0.5, 1.0, 4.0])
    bodies.state.mean[:, 0, 6:] = [0.3, -0.2]
    bodies.predict(0.5, directions(3, 4), np.zeros((3, 2)), np.zeros(3), times)
    np.testing.assert_allclose(bodies.state.mean[:, 0, 6:], np.exp(-0.5 / times)[:, None] * [0.3, -0.2], rtol=1e-12)


def test_errors_that_are_alike_tell_the_modes_apart_less() -> None:
    shares = []
    for alike in (0.0, 1.0):
        bodies = spawned((DRIVING, FREE), 6, 3, replace(DYNAMICS, evidence=0.5))
        bodies.state.mean[:, 1] = bodies.state.mean[:, 0]
        before = bodies.probability.copy()
        updated(bodies, np.arange(6), seen(bodies.state.mean[:, 0, :2] + 1.0, 5), alike)
        odds = bodies.probability / before
        shares.append(np.log(odds[:, 0] / odds[:, 1]))
    unbounded = np.abs(shares[0]) < 12.5  # beyond, a share is the least there is
    assert np.count_nonzero(unbounded) >= 3
    np.testing.assert_allclose(shares[1][unbounded], 0.5 * shares[0][unbounded], atol=1e-9)


@settings(deadline=None, max_examples=examples(60))
@given(
    place=st.lists(st.floats(-1e6, 1e6), min_size=4, max_size=4),
    rate=st.floats(-1e4, 1e4) | st.just(float("nan")),
    dt=st.floats(1e-6, 60.0),
    deviation=st.floats(1e-3, 1e3),
    seed=SEEDS,
)
def test_absurd_measurements_leave_numbers(
    place: list[float], rate: float, dt: float, deviation: float, seed: int
) -> None:
    bodies = first_seen(2, np.random.default_rng(seed))
    noise = np.tile(np.eye(2) * deviation**2, (2, 1, 1))
    measurement = Measurement(np.array(place).reshape(2, 2), noise, ORIGIN, OWN, np.full(2, rate), np.full(2, 0.01))
    for _ in range(3):
        bodies.predict(dt, directions(2, seed), np.zeros((2, 2)), np.zeros(2), np.full(2, BIAS_TIME))
        nis = updated(bodies, np.arange(2), measurement)
        assert np.isfinite(nis).all()
        assert (nis >= 0.0).all()
    state = bodies.state
    assert np.isfinite(state.mean).all()
    assert np.isfinite(state.covariance).all()
    np.testing.assert_allclose(bodies.probability.sum(axis=1), 1.0, atol=1e-9)


def test_what_a_body_does_shows_in_the_modes() -> None:
    """Standing is found where the range rate leaves it open, and left again at once when it drives off."""
    bodies, axis = first_seen(1, np.random.default_rng(1)), np.array([[1.0, 0.0]])
    x, y = bodies.state.mean[0, 0, :2].tolist()
    speed, rng = 0.0, np.random.default_rng(2)
    for k in range(120):
        speed = 0.0 if k < 80 else min(speed + 0.15, 10.0)
        x += 0.05 * speed
        bodies.predict(0.05, axis, np.zeros((1, 2)), np.zeros(1), np.full(1, DEFAULT.reflections.bias_time))
        place = np.array([[x, y]]) + rng.normal(size=(1, 2)) * 0.1
        rate = np.array([speed])
        updated(
            bodies,
            np.array([0]),
            Measurement(place, np.eye(2)[None] * 0.01, np.array([0.0, y]), np.zeros(2), rate, np.array([0.09])),
        )
        if k == 79:
            assert bodies.probability[0, STANDING] > 0.8
    assert bodies.probability[0, STANDING] < 0.05
    mean, _ = bodies.combined()
    assert mean[0, 2] == pytest.approx(speed, abs=0.3)


def circling(speed: float, rates: list[float], seed: int) -> Floats:
    """Return [ω, vx, vy] of what drives from x = 20 m at a speed, turning at rates a scan of 0.05 s, less the truth."""
    bodies, rng = first_seen(1, np.random.default_rng(seed)), np.random.default_rng(seed)
    place, heading, found = np.array([20.0, -5.0]), 0.5 * pi, []
    bodies.shift(place - bodies.combined()[0][:, :2])
    for rate in rates:
        for _ in range(10):
            place = place + 0.005 * speed * np.array([cos(heading), sin(heading)])
            heading += 0.005 * rate
        course = np.array([cos(heading), sin(heading)])
        bodies.predict(0.05, course[None], np.zeros((1, 2)), np.zeros(1), np.full(1, BIAS_TIME))
        sight = place / np.hypot(*place)
        measured = place + 0.2 * rng.normal(size=2), speed * course @ sight + 0.12 * rng.normal(size=1)
        updated(
            bodies,
            np.array([0]),
            Measurement(
                measured[0][None], np.eye(2)[None] * 0.04, np.zeros(2), np.zeros(2), measured[1], np.array([0.0144])
            ),
        )
        mean = bodies.combined()[0][0]
        found.append([mean[4] - rate, *(mean[2:4] - speed * course)])
    return np.array(found)


def rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(("speed", "rate"), [(3.0, 0.8), (4.5, 0.9), (1.4, 1.0)], ids=["car", "rider", "walker"])
def test_the_rate_of_a_sharp_turn_does_not_run_away(speed: float, rate: float) -> None:
    errors = np.array([circling(speed, [0.0] * 40 + [rate] * 200, seed)[160:] for seed in range(4)])
    assert np.abs(errors[..., 0]).max() < 0.6
    assert rms(errors[..., 1:].ravel()) < 0.3


def test_a_bend_tells_its_rate_and_the_next_one_another() -> None:
    """A turn to the left, and within two seconds one to the right."""
    rates = [0.0] * 40 + [0.4] * 60 + np.linspace(0.4, -0.4, 40).tolist() + [-0.4] * 60
    errors = np.array([circling(10.0, rates, seed) for seed in range(4)])
    assert rms(errors[:, 70:100, 0]) < 0.05
    assert rms(errors[:, 170:, 0]) < 0.08
    assert rms(errors[:, 40:, 1:].ravel()) < 0.4


@pytest.mark.parametrize(("stood", "stands"), [(0.9, 0.8), (0.0, 0.0)], ids=["stood", "moved"])
def test_that_it_would_move_fast_does_not_tell_that_it_moves(stood: float, stands: float) -> None:
    """A noisy place makes the modes that move fast; nothing comes to stand from there, what stands may go on to."""
    bodies = first_seen(1, np.random.default_rng(1))
    moves = np.array([mode.moves for mode in MODES])
    bodies.state.mean[:, moves, 3] = 5.0
    probability = np.where(moves, (1.0 - stood) / np.count_nonzero(moves), stood)[None]
    bodies.state = replace(bodies.state, probability=probability)
    for _ in range(5):
        bodies.predict(0.05, np.array([[1.0, 0.0]]), np.zeros((1, 2)), np.zeros(1), np.ones(1))
    assert bodies.probability[0, STANDING] == pytest.approx(stands, abs=0.1 if stood else 1e-5)


def test_what_is_reported_is_the_motion_of_the_reference_point() -> None:
    bodies = spawned((DRIVING,), 5, 17)
    mean, covariance = bodies.combined()
    state, reported_covariance = reported(mean, covariance)
    np.testing.assert_array_equal(state[:, :4], mean[:, :4])
    for row in range(5):
        vx, vy = mean[row, VELOCITY]
        speed = hypot(vx, vy)
        along, turn = mean[row, ACCELERATION], mean[row, TURN]
        expected = along * np.array([vx, vy]) / max(speed, 1.0) + turn * np.array([-vy, vx])
        np.testing.assert_allclose(state[row, 4:], expected)
        j = report_jacobian(mean[row : row + 1])[0]
        np.testing.assert_allclose(reported_covariance[row], j @ covariance[row] @ j.T)


def test_steps_and_open_places_keep_what_is_measured() -> None:
    """Where it is open where on the body its reflection lies, the reflection itself stays as known as it was."""
    bodies = spawned((DRIVING, FREE), 3, 18)
    before, _ = bodies.combined()
    bodies.loosen(np.array([2]), 0.5)
    after, covariance = bodies.combined()
    np.testing.assert_allclose(after[:, POSITION], before[:, POSITION])
    np.testing.assert_allclose(after[:, BIAS], before[:, BIAS], atol=1e-12)
    fresh = spawned((DRIVING, FREE), 3, 18)
    _, untouched = fresh.combined()
    place = np.hstack([np.eye(2), np.zeros((2, 4)), np.eye(2)])
    np.testing.assert_allclose(place @ covariance[2] @ place.T, place @ untouched[2] @ place.T, atol=1e-12)
    assert covariance[2, 0, 0] > untouched[2, 0, 0] + 0.4
    bodies.settle(np.array([[0.5, -1.0], [0.0, 0.0], [0.0, 0.0]]))
    settled, _ = bodies.combined()
    np.testing.assert_allclose(settled[0, POSITION] - after[0, POSITION], [0.5, -1.0], atol=1e-12)
    np.testing.assert_allclose(settled[:, POSITION] + settled[:, BIAS], after[:, POSITION] + after[:, BIAS])
    bodies.settle(np.array([[-0.5, 1.0], [0.0, 0.0], [0.0, 0.0]]), np.array([[0.0, 0.0], [1.0, -2.0], [0.0, 0.0]]))
    _, opened = bodies.combined()
    difference = np.zeros((3, 8, 8))
    difference[1, 2:4, 2:4] = [[1.0, -2.0], [-2.0, 4.0]]
    np.testing.assert_allclose(opened, covariance + difference, atol=1e-9)
    bodies.shift(np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 2.0]]))
    moved, _ = bodies.combined()
    np.testing.assert_allclose(moved[:, :2] - after[:, :2], [[1.0, 0.0], [0.0, 0.0], [0.0, 2.0]], atol=1e-12)


def test_kept_rows_stay_what_they_are() -> None:
    bodies = spawned(MODES, 4, 19)
    mean = bodies.state.mean.copy()
    bodies.keep(np.array([2, 0, 2]))
    np.testing.assert_array_equal(bodies.state.mean, mean[[2, 0, 2]])
    assert len(bodies) == 3
    bodies.keep(np.zeros(3, dtype=np.bool_))
    bodies.predict(0.1, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    assert bodies.link is None
    assert len(bodies) == 0


def test_states_that_do_not_fit_are_refused() -> None:
    bodies, few = spawned(MODES, 2, 20), spawned((DRIVING,), 2, 20)
    with pytest.raises(ValueError, match=r"BodyFilterState\.mean has the shape"):
        bodies.state = few.state
    other = spawned(MODES, 2, 21).state
    other.probability = other.probability[:1]
    with pytest.raises(ValueError, match="probability"):
        bodies.state = other
