"""The nonlinear information filter on the constant-speed turn, paper 002 (9) to (17)."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.estimation import kalman
from candaemon.estimation.information import InformationFilter
from candaemon.estimation.measurement import line_of_sight
from candaemon.estimation.motion_models import TURN, CoordinatedTurn, LinearModel, MotionModel
from tests.support.builders import random_covariance
from tests.support.effort import examples

TURNING = [0, 1, 2, 3, TURN]


def turning_drive(steps: int, dt: float) -> Floats:
    """Return a car that drives straight, turns left, then right, [x, y, vx, vy, ω], from the second step on."""
    states, state = [], np.array([[20.0, -3.0, 15.0, 2.0, 0.0, 0.0, 0.0]])
    for k in range(steps):
        state[0, TURN] = (0.0, 0.4, -0.6)[3 * k // steps]
        state, _, _ = CoordinatedTurn(0.0, 0.0).transition(state, dt, np.zeros((1, 2)))
        states.append(state[0, TURNING])
    return np.array(states)


def test_the_nonlinear_filter_is_the_extended_kalman_filter() -> None:
    """(15) to (17) on the turn model (9), (11); position and range rate measured, both linearised at the prediction."""
    steps, n, dt = 400, 5, 0.05
    rng, model, own = np.random.default_rng(6), CoordinatedTurn(0.05, 0.1), np.array([8.0, 0.0])
    truth = turning_drive(steps, dt)
    z = truth[:, None, :2] + rng.normal(size=(steps, n, 2)) * 0.3
    rates, _ = line_of_sight(truth, np.zeros(2), own)
    z_rate = rates[:, None] + rng.normal(size=(steps, n)) * 0.1
    mean = np.concatenate([z[0], np.tile(truth[0, 2:4], (n, 1)), np.zeros((n, 1))], axis=1)
    covariance = np.tile(np.diag([0.09, 0.09, 25.0, 25.0, 0.1]), (n, 1, 1))
    noise = np.diag([0.09, 0.09, 0.01])[None]
    ours = InformationFilter.known(mean, covariance)
    furthest = 0.0

    def predicted(state: Floats) -> tuple[Floats, Floats, Floats]:
        whole = np.zeros((n, 7))
        whole[:, TURNING] = state
        ahead, f, q = model.transition(whole, dt, np.zeros((n, 2)))
        at = np.ix_(range(len(f)), TURNING, TURNING)
        return ahead[:, TURNING], f[at], q[:1, TURNING][:, :, TURNING]

    def measured(state: Floats, k: int) -> tuple[Floats, Floats]:
        rate, row = line_of_sight(state, np.zeros(2), own)
        observation = np.zeros((n, 3, 5))
        observation[:, 0, 0] = observation[:, 1, 1] = 1.0
        observation[:, 2, :4] = row
        return np.concatenate([z[k] - state[:, :2], (z_rate[k] - rate)[:, None]], axis=1), observation

    for k in range(1, steps):
        ahead, f, q = predicted(mean)
        kalman.predict(mean, covariance, f, q, ahead)
        kalman.update(mean, covariance, *measured(mean, k), noise)
        ahead, f, q = predicted(ours.mean)
        ours.predict(f, q, ahead)
        ours.update(*measured(ours.mean, k), noise)
        furthest = max(
            furthest, float(np.abs(ours.mean - mean).max()), float(np.abs(ours.covariance - covariance).max())
        )
    assert furthest <= 1e-8
    assert np.abs(mean - truth[-1]).max() < 1.0


@settings(deadline=None, max_examples=examples(100))
@given(
    speed=st.tuples(st.floats(-40, 40), st.floats(-40, 40)),
    turn_rate=st.floats(0.01, 1.5) | st.floats(-1.5, -0.01),
    dt=st.floats(0.01, 1.0),
)
def test_the_turns_jacobian_is_the_papers_with_its_misprints_put_right(
    speed: tuple[float, float], turn_rate: float, dt: float
) -> None:
    """Section 3.2; every ξ̂, η̂ in f_ω is a velocity, and f_ω,2 and f_ω,4 lack T in the arguments of sine and cosine."""
    (vx, vy), w, t = speed, turn_rate, dt
    s, c = sin(w * t), cos(w * t)
    f_w1 = t * vx * c / w - vx * s / w**2 - t * vy * s / w - vy * (-1 + c) / w**2
    f_w2 = -t * vx * s - t * vy * c
    f_w3 = t * vx * s / w - vx * (1 - c) / w**2 + t * vy * c / w - vy * s / w**2
    f_w4 = t * vx * c - t * vy * s
    paper = np.array(
        [
            [1, s / w, 0, -(1 - c) / w, f_w1],
            [0, c, 0, -s, f_w2],
            [0, (1 - c) / w, 1, s / w, f_w3],
            [0, s, 0, c, f_w4],
            [0, 0, 0, 0, 1],
        ]
    )
    state = np.array([[3.0, -2.0, vx, vy, 0.0, 0.0, w]])
    predicted, f, _ = CoordinatedTurn(0.1, 0.1).transition(state, t, np.zeros((1, 2)))
    order = [0, 2, 1, 3, TURN]  # [ξ, ξ̇, η, η̇, ω], (10)
    np.testing.assert_allclose(f[0][np.ix_(order, order)], paper, rtol=1e-9, atol=1e-9)
    turned = paper[:, :4] @ state[0, order[:4]]  # (11), its first row with the Jacobian's sign
    np.testing.assert_allclose(predicted[0, order[:4]], turned[:4], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("model", [CoordinatedTurn(0.05, 0.1), LinearModel(1, (0.1, 0.2)), LinearModel(3, (1.0, 1.0))])
def test_a_motion_model_is_cut_to_its_own_components(model: MotionModel) -> None:
    """As the class tells it; a bank's state of nine components, of which no model has all."""
    rng, n = np.random.default_rng(3), 3
    components = list(model.components)
    rows, columns = np.ix_(components, components)
    small, small_covariance = rng.normal(size=(n, len(components))), random_covariance(rng, len(components), n)
    mean, covariance = np.zeros((n, 9)), np.zeros((n, 9, 9))
    mean[:, components], covariance[:, rows, columns] = small, small_covariance
    information = InformationFilter.known(small, small_covariance)
    predicted, f, q = model.transition(mean, 0.1, np.tile([0.6, 0.8], (n, 1)))
    kalman.predict(mean, covariance, f, q, predicted)
    information.predict(f[:, rows, columns], q[:, rows, columns], predicted[:, components])
    np.testing.assert_allclose(information.mean, mean[:, components], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(information.covariance, covariance[:, rows, columns], rtol=1e-9, atol=1e-9)
