"""The filters that are compared on Avatirak et al. 2012's turns, all runs as one batch of targets.

State order [x, y, vx, vy, ax, ay] relative to the host, in the axes of `avatirak_scenario`: m, m/s, m/s².
"""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation.kalman import propagated, symmetrise, update_scalar
from candaemon.estimation.measurement import Measurement, line_of_sight
from candaemon.estimation.motion_models import TURN, CoordinatedTurn
from candaemon.estimation.radial import ModifiedLinearKalman
from candaemon.estimation.trilateration import Trilateration, trilaterate
from candaemon.papers.avatirak_scenario import DEVIATIONS, FORWARD, HOST, SENSORS, STEP
from candaemon.papers.tracking import default_estimator

SAMPLE = 10
"""Steps between two estimates that are kept."""

_VARIANCES = DEVIATIONS**2
_FIRST_TURN_RATE = 3.0
"""rad/s, standard deviation of a turn rate of which nothing is known."""
_CYCLE = 5
"""Estimates of MLKF that become one measurement of the default estimator: a cycle of 10 ms."""


def first_motion(measured: Floats) -> Trilateration:
    """Return the motion (runs, …) that the first measurements (steps, runs, s, 3) give by themselves."""
    return trilaterate(measured[0], np.diag(_VARIANCES), SENSORS, FORWARD)


def mlkf(measured: Floats, *, centripetal: bool = True) -> tuple[Floats, Floats]:
    """Filter each radar's range and its rates, then trilaterate: the system of the paper.

    Args:
        measured: [r, ṙ, r̈] (steps, runs, s, 3); the first begins the tracks.
        centripetal: see `trilaterate`.

    Returns:
        Estimates (samples, runs, 6) and covariances (samples, runs, 6, 6), one for `SAMPLE` steps.
    """
    steps, runs, sensors, _ = measured.shape
    filtered = ModifiedLinearKalman()
    rows, rate = np.arange(runs * sensors), measured.reshape(steps, runs * sensors, 3)
    filtered.spawn(rate[0])
    states, covariances = [], []
    for step in range(1, steps):
        filtered.predict(STEP)
        filtered.update(rows, rate[step], _VARIANCES)
        if (step + 1) % SAMPLE == 0:
            states.append(filtered.mean.copy())
            covariances.append(filtered.covariance.copy())
    seen = np.stack(states).reshape(-1, sensors, 3), np.stack(covariances).reshape(-1, sensors, 3, 3)
    placed = trilaterate(*seen, SENSORS, FORWARD, centripetal=centripetal)
    return placed.state.reshape(-1, runs, 6), placed.covariance.reshape(-1, runs, 6, 6)


def turning_ekf(measured: Floats, model: CoordinatedTurn) -> Floats:
    """Track a coordinated turn over ground by range and range rate of each radar; the host's speed is known.

    Args:
        measured: [r, ṙ, r̈] (steps, runs, s, 3); the first begins the tracks, of the others r̈ is not used.
        model: of the motion.

    Returns:
        Estimates (samples, runs, 6), one for `SAMPLE` steps; the acceleration is ω × v.
    """
    steps, runs = measured.shape[:2]
    first, size = first_motion(measured), TURN + 1
    mean, covariance = np.zeros((runs, size)), np.zeros((runs, size, size))
    mean[:, :4], covariance[:, :4, :4] = first.state[:, :4], first.covariance[:, :4, :4]
    mean[:, 2:4] += HOST
    covariance[:, TURN, TURN] = _FIRST_TURN_RATE**2
    anywhere = np.zeros((runs, 2))
    estimates = []
    for step in range(1, steps):
        mean, f, q = model.transition(mean, STEP, anywhere)
        covariance = propagated(covariance, f) + q
        travelled = HOST * (step * STEP)
        for k, sensor in enumerate(SENSORS + travelled):
            _update(mean, covariance, sensor, measured[step, :, k])
        symmetrise(covariance)
        if (step + 1) % SAMPLE == 0:
            estimates.append(_relative(mean, travelled))
    return np.stack(estimates)


def _update(mean: Floats, covariance: Floats, sensor: Floats, measured: Floats) -> None:
    """Update with the range and then the range rate (runs, 3) of a radar that is at a place (2,) over ground."""
    _, row = line_of_sight(mean, sensor, HOST)
    distance = np.hypot(mean[:, 0] - sensor[0], mean[:, 1] - sensor[1])
    update_scalar(mean, covariance, row[:, 2:], measured[:, 0] - distance, _VARIANCES[0])
    rate, row = line_of_sight(mean, sensor, HOST)
    update_scalar(mean, covariance, row, measured[:, 1] - rate, _VARIANCES[1])


def _relative(mean: Floats, travelled: Floats) -> Floats:
    """Return a turn over ground (runs, 7) as motion relative to the host that has travelled so far, (runs, 6)."""
    turn_rate, velocity = mean[:, TURN, None], mean[:, 2:4]
    pull = turn_rate * np.stack([-velocity[:, 1], velocity[:, 0]], axis=1)
    return np.concatenate([mean[:, :2] - travelled, velocity - HOST, pull], axis=1)


def by_default(states: Floats, covariances: Floats) -> Floats:
    """Track with the default estimator the positions that MLKF and trilateration give every 10 ms.

    Args:
        states: of MLKF (samples, runs, 6).
        covariances: (samples, runs, 6, 6).

    Returns:
        The last estimate (runs, 6).
    """
    samples, runs, _ = states.shape
    rows, direction, at_rest = np.arange(runs), np.tile(FORWARD, (runs, 1)), np.zeros(2)
    estimator = default_estimator()
    for k in range(_CYCLE - 1, samples, _CYCLE):
        travelled = HOST * ((k + 1) * SAMPLE * STEP)
        place, spread = states[k, :, :2] + travelled, covariances[k, :, :2, :2]
        if len(estimator):
            estimator.predict(_CYCLE * SAMPLE * STEP, direction)
            estimator.update(rows, Measurement(place, spread, at_rest, at_rest))
        else:
            estimator.spawn(place, spread, states[k, :, 2:4] + HOST, covariances[k, :, 2:4, 2:4])
    state = estimator.combined()[0].copy()
    state[:, :2] -= travelled
    state[:, 2:4] -= HOST
    return state
