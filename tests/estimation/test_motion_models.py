"""Motion models against van Loan's discretisation, filterpy, and numerical differentiation."""

from __future__ import annotations

from math import cos, pi, radians, sin, sqrt

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise, van_loan_discretization
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.estimation.discretisation import decaying_axis, white_axis
from candaemon.estimation.motion_models import (
    CoordinatedTurn,
    CurrentStatistical,
    LinearModel,
    MotionModel,
    Singer,
    predicted_mean,
)
from tests.support.effort import examples

DECAYS = (1e-5, 1e-4, 8e-4, 1e-3, 0.01, 0.099, 0.101, 0.5, 1.0, 2.0, 3.0)
"""αT, over the whole range that the papers and a radar need."""
STATE = np.array([[12.0, -3.0, 17.0, 4.0, 1.5, -0.7, 0.2]])
ANGLES = st.floats(-pi, pi)


def unit(angle: float) -> Floats:
    return np.array([[cos(angle), sin(angle)]])


def rotated(matrix: Floats, angle: float) -> Floats:
    """Turn a 6 × 6 matrix over [x, y, vx, vy, ax, ay] by an angle."""
    turn = np.kron(np.eye(3), np.array([[cos(angle), -sin(angle)], [sin(angle), cos(angle)]]))
    turned: Floats = turn @ matrix @ turn.T
    return turned


def continuous(rate: float, order: int) -> tuple[Floats, Floats]:
    """Return drift and noise matrices over the derivatives 0 to `order`, the highest decaying with the rate."""
    drift = np.diag(np.ones(order), 1)
    drift[order, order] = -rate
    noise = np.zeros((order + 1, 1))
    noise[order, 0] = 1.0
    return drift, noise


def matrices(model: MotionModel, dt: float, angle: float = 0.0, state: Floats = STATE) -> tuple[Floats, Floats]:
    """Return F and Q over [x, y, vx, vy, ax, ay]."""
    _, f, q = model.transition(state[:, :6], dt, unit(angle))
    return f[0], q[0]


@pytest.mark.parametrize("decay", DECAYS)
def test_current_statistical_noise_is_van_loans(decay: float) -> None:
    """Paper 000 (15), (18), (19), q33 put right: its printed form is negative."""
    model = CurrentStatistical(alpha=decay, limit=10.0, floor=0.5)
    f, q = matrices(model, 1.0)
    exact_f, exact_q = van_loan_discretization(*continuous(decay, 2), 1.0)
    for axis, acceleration in ((0, 1.5), (1, 0.7)):
        variance = max((4 - pi) / pi * (10.0 - acceleration) ** 2, 0.5)
        np.testing.assert_allclose(f[axis::2, axis::2], exact_f, rtol=1e-9, atol=0)
        np.testing.assert_allclose(q[axis::2, axis::2], 2 * decay * variance * exact_q, rtol=1e-9, atol=0)
    assert not f[0::2, 1::2].any()
    assert not q[0::2, 1::2].any()


@pytest.mark.parametrize("alpha", [0.02, 0.5, 3.0])
def test_singers_acceleration_keeps_its_variance(alpha: float) -> None:
    """Coloured noise of the stated deviation: what decays and what is driven balance."""
    model, covariance = Singer(alpha, 1.7), np.zeros((6, 6))
    f, q = matrices(model, 0.05)
    for _ in range(20_000):
        covariance = f @ covariance @ f.T + q
    assert covariance[4, 4] == pytest.approx(1.7**2, rel=1e-6)
    assert covariance[5, 5] == pytest.approx(1.7**2, rel=1e-6)


def test_a_constant_jerk_moves_by_its_taylor_series() -> None:
    """Hou's four states of an axis, in the plane; a turn rate beside them stays out of it."""
    state = np.array([[1.0, 2.0, 10.0, -4.0, 3.0, 0.5, 0.3, -2.0, 6.0]])
    model, dt = LinearModel(3, (4.0, 4.0)), 0.5
    predicted, f, q = model.transition(state, dt, unit(0.3))
    for axis, (x, v, a, j) in enumerate(((1.0, 10.0, 3.0, -2.0), (2.0, -4.0, 0.5, 6.0))):
        assert predicted[0, axis] == pytest.approx(x + v * dt + a * dt**2 / 2 + j * dt**3 / 6)
        assert predicted[0, 2 + axis] == pytest.approx(v + a * dt + j * dt**2 / 2)
        assert predicted[0, 4 + axis] == pytest.approx(a + j * dt)
        assert predicted[0, 7 + axis] == j
    assert not f[0, 6].any()
    assert not q[0, 6].any()
    assert model.components == (0, 1, 2, 3, 4, 5, 7, 8)
    north = LinearModel(3, (4.0, 1.0)).transition(state, dt, unit(pi / 2))[2][0]  # along is y
    across, along = np.array((0, 2, 4, 7)), np.array((1, 3, 5, 8))
    np.testing.assert_allclose(north[along[:, None], along], q[0][along[:, None], along])
    np.testing.assert_allclose(north[across[:, None], across], q[0][across[:, None], across] / 4)
    with pytest.raises(ValueError, match="does not settle"):
        LinearModel(3, (1.0, 1.0), (2.0, None))


@pytest.mark.parametrize("decay", DECAYS)
def test_mean_acceleration_makes_it_constant_acceleration(decay: float) -> None:
    """F x + U ā with ā = the current acceleration is the constant-acceleration transition."""
    dt = 0.4
    alpha = decay / dt
    u = decaying_axis(alpha, dt, 1.0, order=2).input
    model = CurrentStatistical(alpha=alpha, limit=10.0, floor=1.0)
    predicted, f, _ = model.transition(STATE[:, :6], dt, unit(0.0))
    constant = np.kron(white_axis(dt, 0.0, order=2).transition, np.eye(2)) @ STATE[0, :6]
    np.testing.assert_allclose(f[0] @ STATE[0, :6] + np.kron(u, STATE[0, 4:6]), constant, rtol=1e-12)
    np.testing.assert_allclose(predicted[0], constant, rtol=1e-13)


def test_the_variance_falls_to_its_floor_at_the_limit_and_stays_there() -> None:
    model = CurrentStatistical(alpha=0.5, limit=8.0, floor=1.2)
    accelerations = np.array([0.0, 4.0, -4.0, 6.5, 7.999, 8.0, -8.0, 12.0, -40.0])
    variance = model.variance(accelerations)
    assert variance[0] == pytest.approx((4 - pi) / pi * 64)
    assert variance[1] == variance[2] == pytest.approx((4 - pi) / pi * 16)
    np.testing.assert_array_equal(variance[4:], 1.2)
    assert (variance >= 1.2).all()
    assert (np.diff(model.variance(np.linspace(0, 20, 201))) <= 0).all()


@pytest.mark.parametrize("width", [6, 7])
def test_current_statistical_fills_any_width_alike(width: int) -> None:
    model = CurrentStatistical(alpha=0.5, limit=8.0, floor=1.0)
    states = np.repeat(STATE, 3, axis=0)
    states[:, 4] = (0.0, 3.0, -9.0)
    _, f, q = model.transition(states[:, :width], 0.05, unit(0.0))
    _, narrow_f, narrow_q = model.transition(states[:, :6], 0.05, unit(0.0))
    np.testing.assert_array_equal(q[:, :6, :6], narrow_q)
    np.testing.assert_array_equal(f[:, :6, :6], narrow_f)
    assert not q[:, 6:].any()
    assert q[0, 0, 0] > q[1, 0, 0] > q[2, 0, 0]


@settings(deadline=None, max_examples=examples(200))
@given(
    decay=st.floats(1e-5, 3.0),
    dt=st.sampled_from((0.01, 0.05, 0.1, 1.0)),
    angle=ANGLES,
    noise=st.tuples(st.floats(0.0, 10.0), st.floats(0.0, 10.0)),
    order=st.sampled_from((1, 2)),
    settles=st.tuples(st.booleans(), st.booleans()),
)
def test_noise_is_symmetric_and_positive_semidefinite(
    decay: float,
    dt: float,
    angle: float,
    noise: tuple[float, float],
    order: int,
    settles: tuple[bool, bool],
) -> None:
    constant = dt / decay
    along, across = (constant if settle else None for settle in settles)
    models: list[MotionModel] = [
        LinearModel(order=order, noise=noise, decay_time=(along, across), position_noise=(0.01, 0.0)),
        CurrentStatistical(alpha=decay / dt, limit=8.0, floor=1.0),
        CoordinatedTurn(noise[0], noise[1]),
    ]
    scale = np.array([dt**2, dt**2, dt, dt, 1.0, 1.0, 1.0])
    for model in models:
        _, _, q = model.transition(STATE, dt, unit(angle))
        scaled = q[0] / np.outer(scale, scale)
        np.testing.assert_allclose(scaled, scaled.T, rtol=1e-12, atol=1e-12 * max(np.abs(scaled).max(), 1e-300))
        assert np.linalg.eigvalsh(scaled).min() >= -1e-13 * np.trace(scaled)


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 90.0, 135.0, -100.0])
@pytest.mark.parametrize("order", [1, 2])
def test_a_linear_model_is_van_loans_in_any_direction(order: int, angle_deg: float) -> None:
    """Along: the highest derivative decays; across: the velocity does; both from the continuous model."""
    dt, memory, lateral, power, wander = 0.5, 4.0, 0.6, (0.8, 0.3), (0.02, 0.05)
    model = LinearModel(order, power, (memory, lateral), wander)
    f, q = matrices(model, dt, radians(angle_deg))
    drift, noise = np.zeros((6, 6)), np.zeros((6, 2))
    drift[0::2, 0::2][: order + 1, : order + 1] = continuous(1 / memory, order)[0]
    drift[1, 3], drift[3, 3] = 1.0, -1 / lateral
    noise[2 * order, 0], noise[3, 1] = sqrt(power[0]), sqrt(power[1])
    exact_f, exact_q = van_loan_discretization(drift, noise, dt)
    exact_q[0, 0] += wander[0] * dt
    exact_q[1, 1] += wander[1] * dt
    unused = [5] if order == 2 else [4, 5]  # van Loan keeps a component that the model lacks; the model forgets it
    exact_f[unused, unused] = 0.0
    np.testing.assert_allclose(f, rotated(exact_f, radians(angle_deg)), rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(q, rotated(exact_q, radians(angle_deg)), rtol=1e-9, atol=1e-11)


@settings(deadline=None)
@given(angle=ANGLES, order=st.sampled_from((1, 2)))
def test_the_same_along_and_across_needs_no_direction(angle: float, order: int) -> None:
    f, q = matrices(LinearModel(order, (0.5, 0.5)), 0.1, angle)
    straight_f, straight_q = matrices(LinearModel(order, (0.5, 0.5)), 0.1)
    np.testing.assert_array_equal(f, straight_f)
    np.testing.assert_array_equal(q, straight_q)
    np.testing.assert_allclose(rotated(q, angle), q, atol=1e-15)


def test_each_row_has_its_own_direction() -> None:
    model = LinearModel(2, (1.0, 0.1), (10.0, 0.6), (0.0, 0.03))
    angles = (0.0, 0.4, -2.0)
    directions = np.concatenate([unit(angle) for angle in angles])
    states = np.repeat(STATE, 3, axis=0) * np.array([[1.0], [2.0], [-1.0]])
    predicted, f, q = model.transition(states, 0.05, directions)
    for k, angle in enumerate(angles):
        alone, alone_f, alone_q = model.transition(states[k : k + 1], 0.05, unit(angle))
        np.testing.assert_allclose(predicted[k], alone[0], rtol=1e-14)
        np.testing.assert_allclose(f[k], alone_f[0], rtol=1e-14, atol=1e-16)
        np.testing.assert_allclose(q[k], alone_q[0], rtol=1e-14, atol=1e-20)
        np.testing.assert_allclose(predicted[k], f[k] @ states[k], rtol=1e-14)


@settings(deadline=None, max_examples=examples(200))
@given(w=st.floats(-3.0, 3.0), speed=st.floats(0.1, 60.0), course=ANGLES, dt=st.sampled_from((0.01, 0.05, 0.565, 1.0)))
def test_a_turns_jacobian_is_its_derivative(w: float, speed: float, course: float, dt: float) -> None:
    model = CoordinatedTurn(0.01, 0.1)
    state = np.array([[5.0, -2.0, speed * cos(course), speed * sin(course), 0.0, 0.0, w]])
    _, f, _ = model.transition(state, dt, unit(0.0))
    step = 1e-4
    for c in model.components:
        nudge = np.zeros((1, 7))
        nudge[0, c] = step
        ahead, behind = (model.transition(state + sign * nudge, dt, unit(0.0))[0] for sign in (1, -1))
        numeric = (ahead - behind)[0] / (2 * step)
        np.testing.assert_allclose(f[0][:, c], numeric, atol=2e-7 * max(speed, 1.0), err_msg=f"component {c}")


@settings(deadline=None, max_examples=examples(200))
@given(w=st.floats(-3.0, 3.0), speed=st.floats(0.0, 60.0), course=ANGLES, dt=st.floats(0.001, 2.0))
def test_a_turn_is_a_circle(w: float, speed: float, course: float, dt: float) -> None:
    """Speed is kept, the course turns by ωT, the chord is that of the arc."""
    state = np.array([[0.0, 0.0, speed * cos(course), speed * sin(course), 0.0, 0.0, w]])
    predicted, _, _ = CoordinatedTurn(0.01, 0.1).transition(state, dt, unit(0.0))
    x, y, vx, vy = predicted[0, :4]
    assert np.hypot(vx, vy) == pytest.approx(speed, rel=1e-12)
    np.testing.assert_allclose((vx, vy), (speed * cos(course + w * dt), speed * sin(course + w * dt)), atol=1e-12 * 60)
    chord = speed * dt * np.sinc(w * dt / 2 / pi)
    np.testing.assert_allclose(
        (x, y), chord * np.array([cos(course + w * dt / 2), sin(course + w * dt / 2)]), atol=1e-6
    )
    assert predicted[0, 6] == w


@pytest.mark.parametrize("w", [0.8, -0.8, 40.0, -40.0])
def test_a_turn_beyond_the_limit_is_drawn_back_to_it_and_stays_correctable(w: float) -> None:
    """The estimate turns at the limit; the Jacobian is the limit's, whose last column a clip would make zero."""
    model, free = CoordinatedTurn(0.01, 0.1, limit=0.5), CoordinatedTurn(0.01, 0.1)
    beyond, at = STATE.copy(), STATE.copy()
    beyond[0, 6], at[0, 6] = w, np.sign(w) * 0.5
    predicted, f, q = model.transition(beyond, 0.5, unit(0.0))
    expected, expected_f, expected_q = free.transition(at, 0.5, unit(0.0))
    np.testing.assert_array_equal(predicted, expected)
    np.testing.assert_array_equal(f, expected_f)
    np.testing.assert_array_equal(q, expected_q)
    assert predicted[0, 6] == np.sign(w) * 0.5
    assert f[0, 6, 6] == 1.0
    assert np.abs(f[0, :4, 6]).min() > 0.1
    within = STATE[:, :7]
    np.testing.assert_array_equal(
        model.transition(within, 0.5, unit(0.0))[0], free.transition(within, 0.5, unit(0.0))[0]
    )


def test_a_turn_is_continuous_through_zero() -> None:
    model, dt = CoordinatedTurn(0.01, 0.1), 0.05
    rates = np.concatenate([-np.logspace(-1, -12, 400), [0.0], np.logspace(-12, -1, 400)])
    states = np.zeros((len(rates), 7))
    states[:, 2], states[:, 3], states[:, 6] = 20.0, -5.0, rates
    predicted, f, _ = model.transition(states, dt, np.tile(unit(0.0), (len(rates), 1)))
    straight = LinearModel(1, (0.0, 0.0)).transition(states[:1, :6], dt, unit(0.0))[0][0, :4]
    np.testing.assert_allclose(predicted[400, :4], straight, rtol=1e-14)
    change = np.abs(np.diff(predicted[:, :4], axis=0)).max(axis=1)
    assert (change <= 1.01 * np.hypot(20, 5) * dt * np.diff(rates) + 1e-13).all()
    change = np.abs(np.diff(f[:, :4, 6], axis=0)).max(axis=1)
    assert (change <= 1.01 * np.hypot(20, 5) * dt**2 * np.diff(rates) + 1e-9).all()


def test_a_turns_noise() -> None:
    _, _, q = CoordinatedTurn(0.3, 0.2, position_noise=0.04).transition(STATE, 0.1, unit(0.0))
    exact = Q_continuous_white_noise(2, 0.1, 0.3, block_size=2, order_by_dim=False)
    exact[0, 0] += 0.004
    exact[1, 1] += 0.004
    np.testing.assert_allclose(q[0, :4, :4], exact, rtol=1e-12)
    assert q[0, 6, 6] == pytest.approx(0.02)
    assert not q[0, 4:6].any()


@pytest.mark.parametrize(
    "model",
    [
        LinearModel(1, (1.0, 1.0)),
        LinearModel(2, (5.0, 0.5), decay_time=(None, 2.0)),
        LinearModel(3, (1.0, 2.0)),
        Singer(0.5, 1.0),
        CurrentStatistical(0.5, 10.0, 1.0),
        CoordinatedTurn(0.01, 0.1, limit=1.0),
    ],
)
def test_a_mean_predicted_alone_is_the_transitions_to_the_last_bit(model: MotionModel) -> None:
    mean = np.random.default_rng(4).normal(size=(5, 9))
    mean[0, 6] = 0.0  # does not turn
    direction = np.concatenate([unit(angle) for angle in range(5)])
    expected, _, _ = model.transition(mean, 0.5, direction)
    np.testing.assert_array_equal(predicted_mean(model, mean, 0.5, direction), expected)
