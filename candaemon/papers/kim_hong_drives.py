"""Drives, made of straights and turns at a constant speed, and the bound for who must track them.

Source: Kim and Hong 2004.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from typing import TypeAlias

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation.kalman import predict, update
from candaemon.estimation.motion_models import TURN, CoordinatedTurn

DT = 1.0
"""T, s."""

_LAST_SCAN = 200
_SPEED = 28.0
_TURN = CoordinatedTurn(0.0, 0.0)
_ANY_DIRECTION = np.zeros((1, 2))

Turns: TypeAlias = tuple[tuple[int, int, float], ...]
"""(first scan, last scan, angle in degrees, positive to the left) of each turn."""


@dataclass(frozen=True, slots=True)
class TurnDrive:
    """The truth at the scans 0 to 200.

    Attributes:
        state: (steps, 6) of [x, y, vx, vy, ax, ay].
        turn_rate: ω of the step that ends at the scan (steps,), rad/s.
    """

    state: Floats
    turn_rate: Floats

    @property
    def time(self) -> Floats:
        """Instants (steps,), s."""
        return np.arange(len(self.state), dtype=np.float64) * DT

    def measured(self, deviation: float, runs: int, rng: np.random.Generator) -> Floats:
        """Return positions with white noise of a standard deviation (m) on each axis, (steps, runs, 2)."""
        positions: Floats = self.state[:, None, :2] + rng.normal(0.0, deviation, (len(self.state), runs, 2))
        return positions


def drive(start: tuple[float, float], turns: Turns) -> TurnDrive:
    """Return a drive at 28 m/s that begins along x.

    Args:
        start: position at scan 0, m.
        turns: one after another; the first step of a turn ends at its first scan.
    """
    turn_rate = np.zeros(_LAST_SCAN + 1)
    for first, last, angle in turns:
        turn_rate[first : last + 1] = radians(angle) / ((last - first + 1) * DT)
    motion = np.zeros((1, TURN + 1))
    motion[0, :3] = *start, _SPEED
    state = np.empty((_LAST_SCAN + 1, 6))
    for k, rate in enumerate(turn_rate):
        if k:
            motion[0, TURN] = rate
            motion, _, _ = _TURN.transition(motion, DT, _ANY_DIRECTION)
        x, y, vx, vy = motion[0, :4]
        state[k] = x, y, vx, vy, -rate * vy, rate * vx
    return TurnDrive(state, turn_rate)


def bound(drive: TurnDrive, deviation: float, speed_spread: float) -> Floats:
    """Return the Cramér-Rao bound of a filter that knows when, and how much on average, the target turns.

    That is the covariance of the extended Kalman filter without process noise, linearised at the truth. A filter
    with that knowledge linearises at its estimates, which without process noise loses the target in turns so long.

    Args:
        drive: the truth.
        deviation: standard deviation of the measured positions, m.
        speed_spread: of the first velocity, m/s.

    Returns:
        Variances (steps, 2) of position, m², and velocity, (m/s)², over both axes.
    """
    variances = np.empty((len(drive.state), 2))
    truth = np.zeros((1, TURN + 1))
    covariance = np.zeros((1, TURN + 1, TURN + 1))
    covariance[0, :4, :4] = np.diag([deviation, deviation, speed_spread, speed_spread]) ** 2
    covariance[0, TURN, TURN] = turn_rate_variance = float(np.square(drive.turn_rate).mean())
    noise, observation = deviation**2 * np.eye(2), np.eye(2, TURN + 1)
    for k, rate in enumerate(drive.turn_rate):
        if k:
            if rate != truth[0, TURN]:
                covariance[0, TURN, :] = covariance[0, :, TURN] = 0.0
                covariance[0, TURN, TURN] = turn_rate_variance
            truth[0, :4], truth[0, TURN] = drive.state[k - 1, :4], rate
            _, jacobian, disturbance = _TURN.transition(truth, DT, _ANY_DIRECTION)
            predict(truth.copy(), covariance, jacobian, disturbance)
            update(truth.copy(), covariance, np.zeros((1, 2)), observation, noise)
        diagonal = np.diagonal(covariance[0])
        variances[k] = diagonal[:2].sum(), diagonal[2:4].sum()
    return variances
