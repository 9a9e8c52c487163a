"""The motion in the plane that fits several sensors' ranges, range rates and range accelerations best.

Least squares by Gauss-Newton steps, batched over targets; states are [x, y, vx, vy, ax, ay] as in `radial`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Booleans, ComplexPlane, Floats, Indices
from candaemon.estimation.kalman import times
from candaemon.estimation.radial import radial, radial_jacobian

UNKNOWN = 1e3
"""Standard deviation, SI units, of what the measurements do not determine."""
_LARGEST = 1e6
"""Beyond it, in SI units, a number is none that a sensor measures."""
_ITERATIONS, _FIRST_DAMPING = 8, 1e-3
_LARGEST_TURN = 0.5
"""rad, by which a step may turn a target about the sensors."""


@dataclass(frozen=True, slots=True)
class RadialFit:
    """How well states fit what s sensors measured of n targets; the sum of squared residuals is χ².

    Attributes:
        measured: [r, ṙ, r̈] (n, s, 3); 0 where a sensor does not see a target.
        whitening: inverse roots of their covariances (n, s, 3, 3), lower triangular; 0 where a sensor does not.
        seen: whether it does (n, s).
        sensors: positions (s, 2), m.
        centripetal: see `radial`.
    """

    measured: Floats
    whitening: Floats
    seen: Booleans
    sensors: Floats
    centripetal: bool

    @classmethod
    def of(cls, measured: Floats, covariance: Floats, sensors: Floats, *, centripetal: bool) -> RadialFit:
        """Return the fit to measurements (n, s, 3), NaN where a sensor does not see a target; see `trilaterate`."""
        seen = np.asarray((np.abs(measured) < _LARGEST).all(axis=-1))
        mask = seen[..., None, None]
        root = np.linalg.inv(np.linalg.cholesky(np.where(mask, covariance, np.eye(3))))
        exact = np.where(seen[..., None], measured, 0.0)
        return cls(exact, np.where(mask, root, 0.0), seen, sensors, centripetal)

    @property
    def middle(self) -> Floats:
        """The middle of the sensors that see each target, (n, 2)."""
        return np.asarray(self.seen @ self.sensors / np.maximum(self.seen.sum(axis=1), 1)[:, None])

    def residual(self, state: Floats, rows: Indices | slice = slice(None)) -> Floats:
        """Return measured minus predicted in standard deviations, (…, rows, s, 3), ranges first; 0 where not seen."""
        missed = self.measured[rows] - radial(state, self.sensors, centripetal=self.centripetal)
        return times(self.whitening[rows], missed)

    def information(self, state: Floats, rows: Indices | slice = slice(None)) -> tuple[Floats, Floats]:
        """Return information matrices (…, rows, 6, 6), kept invertible, and the gradients Jᵀ W (z − h) (…, rows, 6)."""
        jacobian = self.whitening[rows] @ radial_jacobian(state, self.sensors, centripetal=self.centripetal)
        count = 3 * len(self.sensors)
        stacked = jacobian.reshape(*state.shape[:-1], count, 6)
        missed = self.residual(state, rows).reshape(*state.shape[:-1], count)
        transposed = np.swapaxes(stacked, -1, -2)
        return transposed @ stacked + np.eye(6) / UNKNOWN**2, times(transposed, missed)

    def refined(self, state: Floats) -> Floats:
        """Return states (2, n, 6) after Gauss-Newton steps, for targets that more than two sensors see.

        A step that fits worse is not taken, and the next one damped more (Levenberg and Marquardt).
        """
        rows = np.flatnonzero(self.seen.sum(axis=1) > 2)
        if not len(rows):
            return state
        part, middle = state[:, rows], self.middle[rows]
        misfit, damping = (self.residual(part, rows) ** 2).sum(axis=(-1, -2)), np.full(part.shape[:-1], _FIRST_DAMPING)
        for _ in range(_ITERATIONS):
            matrix, gradient = self.information(part, rows)
            matrix *= 1.0 + damping[..., None, None] * np.eye(6)
            step = np.asarray(np.linalg.solve(matrix, gradient[..., None])[..., 0])
            trial = _moved(part, step, middle)
            trial_misfit = (self.residual(trial, rows) ** 2).sum(axis=(-1, -2))
            better = trial_misfit < misfit
            part = np.where(better[..., None], trial, part)
            misfit = np.where(better, trial_misfit, misfit)
            damping = damping * np.where(better, 0.1, 10.0)
        state = state.copy()
        state[:, rows] = part
        return state


def covariance_of(information: Floats) -> Floats:
    """Return covariances (…, 6, 6); what is not determined, exactly or but for rounding, has the largest variance."""
    weight, axes = np.linalg.eigh(information)
    return np.asarray((axes / np.maximum(weight, UNKNOWN**-2)[..., None, :]) @ np.swapaxes(axes, -1, -2))


def _moved(state: Floats, step: Floats, middle: Floats) -> Floats:
    """Return states (…, 6) after steps that keep to circles round the sensors' middle (n, 2).

    Ranges determine the distance well and the direction badly: a long step straight across the line of sight would
    spoil the distance, and only tiny ones would be taken.
    """
    centre = _complex(middle)
    place, velocity, acceleration = (_complex(state[..., c : c + 2]) for c in (0, 2, 4))
    outwards, faster, harder = (_complex(step[..., c : c + 2]) for c in (0, 2, 4))
    distance = np.maximum(np.abs(place - centre), 1e-9)
    line = (place - centre) / distance
    outwards = np.conj(line) * outwards
    angle = np.clip(outwards.imag / distance, -_LARGEST_TURN, _LARGEST_TURN)
    turn = np.exp(1j * angle)
    place = centre + (distance + outwards.real) * line * turn
    velocity, acceleration = (
        (old + new - 1j * angle * old) * turn for old, new in ((velocity, faster), (acceleration, harder))
    )
    return np.stack([part for each in (place, velocity, acceleration) for part in (each.real, each.imag)], axis=-1)


def _complex(vector: Floats) -> ComplexPlane:
    """Return vectors (…, 2) as x + i y."""
    return np.asarray(vector[..., 0] + 1j * vector[..., 1])
