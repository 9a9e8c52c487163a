"""The blocks of a transition do what the whole matrix does, and mixing in one pool what mixing by every pair does."""

from __future__ import annotations

import numpy as np

from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.estimation.body_filter import ACCELERATION, TURN, BodyFilter
from candaemon.estimation.body_transition import BodyTransition
from candaemon.estimation.imm import mix
from candaemon.tracking.body_modes import MANOEUVRING, TURNING, dynamics_of, modes_of

BODIES, MODES = 7, len(modes_of(VehicleEstimatorSettings(kind="vehicle")))
STEP = 0.05  # s


def covariances(random: np.random.Generator, *shape: int) -> np.ndarray:
    root = random.normal(size=(*shape, 8, 8))
    return root @ np.swapaxes(root, -2, -1)


def test_blocks_propagate_as_the_whole_matrix_does() -> None:
    random = np.random.default_rng(1)
    fade = random.uniform(0.5, 1.0, BODIES)
    transition = BodyTransition(random.normal(size=(4, 4, MODES, BODIES)), random.uniform(0.5, 1.0, (2, MODES)), fade)
    before = covariances(random, BODIES, MODES)
    whole = transition.dense().T.swapaxes(-2, -1)
    expected = whole @ before @ whole.swapaxes(-2, -1)
    found = np.asfortranarray(before)
    transition.propagate(found.T)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()
    assert np.abs(whole[..., :2, 2:6]).min() > 0.0


def test_mixing_in_a_pool_is_mixing_by_every_pair() -> None:
    random, settings = np.random.default_rng(2), VehicleEstimatorSettings(kind="vehicle")
    modes = modes_of(settings)
    bodies = BodyFilter(modes, dynamics_of(settings))
    # slow enough in some mode that they may stand
    velocity, share = random.normal(0.0, 1.0, (BODIES, MODES, 2)), random.dirichlet(np.ones(MODES), BODIES)
    place, noise = random.normal(0.0, 30.0, (BODIES, 2)), np.broadcast_to(np.eye(2), (BODIES, 2, 2))
    bodies.spawn(place, noise, velocity, covariances(random, BODIES, MODES)[..., :2, :2], share)
    dwell = np.array([mode.dwell for mode in modes])
    leave = -np.expm1(-STEP / dwell)
    others = np.where(np.eye(MODES, dtype=np.bool_), 0.0, dwell)
    chain = leave[:, None] * others / others.sum(axis=1, keepdims=True) + np.diag(1.0 - leave)
    state = bodies.state
    mean, covariance, probability = mix(state.mean, state.covariance, state.probability, chain)
    # what has just entered `turning`, by every pair, may turn at any rate, and what entered `manoeuvring` may brake
    began, braked = (
        state.probability[:, others] @ chain[others, mode] / probability[:, mode]
        for mode, others in ((mode, np.arange(MODES) != mode) for mode in (TURNING, MANOEUVRING))
    )
    hidden = random.random(BODIES)
    speed = np.hypot(mean[:, TURNING, 2], mean[:, TURNING, 3])
    rate = np.minimum(modes[TURNING].onset / np.maximum(speed, 1.0), 0.6) * np.maximum(1.0 - hidden, 0.03) ** 2
    covariance[:, TURNING, TURN, TURN] += began * rate**2
    covariance[:, MANOEUVRING, ACCELERATION, ACCELERATION] += braked * modes[MANOEUVRING].acceleration_onset ** 2
    bodies._interact(STEP, hidden)
    assert np.abs(bodies.state.mean - mean).max() < 1e-12
    assert np.abs(bodies.state.covariance - covariance).max() < 1e-10
    assert np.abs(bodies.state.probability - probability).max() < 1e-14
