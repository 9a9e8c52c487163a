"""Trilateration: from range, range rate and range acceleration at several sensors to a motion in the plane.

Source: Avatirak et al. 2012.

Two sensors: the closed form of (8) to (12), with the centripetal term that (12) leaves out. More: least squares over
all that they measure, from the closed form of the two that stand farthest apart. Batched over targets.

Points of the plane are [x, y, vx, vy, ax, ay] in the axes in which the sensors rest, such as vehicle axes (x forward,
y left): m, m/s, m/s². Along a line of sight [r, ṙ, r̈], positive away from the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.kalman import times
from candaemon.estimation.radial import radial, radial_jacobian
from candaemon.estimation.radial_fit import UNKNOWN, RadialFit, covariance_of

_APART = 5.0
"""Standard deviations by which a range may miss the result."""
_CONVINCING = 9.0
"""Difference of χ² by which the measurements must speak for one of two mirror images."""


class Status(IntEnum):
    """Validity of a result; all but the first two are no measurement of the target."""

    OK = 0
    BEHIND = 1
    """The target is on the side of the sensors to which they do not look; its motion holds."""
    ON_BASELINE = 2
    """The lines of sight are parallel: the target is on the line through the sensors, or too far for their distance.

    The motion along the line of sight holds, that across it is 0 and unknown."""
    APART = 3
    """The circles of the ranges do not meet by far: the ranges are not of one target. The state is the nearest one."""
    TOO_FEW = 4
    """Fewer than two sensors at different places see the target. The state is 0 and unknown."""


@dataclass(frozen=True, slots=True)
class Trilateration:
    """Motion of n targets; always finite, whatever was measured.

    Attributes:
        state: [x, y, vx, vy, ax, ay] (n, 6), relative to the sensors' axes.
        covariance: (n, 6, 6), that of the radial measurements propagated; what they do not determine has a standard
            deviation of 1,000.
        status: a `Status` each, (n,).
    """

    state: Floats
    covariance: Floats
    status: NDArray[np.int8]


def trilaterate(
    measured: Floats,
    covariance: Floats,
    sensors: Floats,
    side: Floats,
    *,
    centripetal: bool = True,
    expected: Floats | None = None,
    least_angle: float = 1e-3,
) -> Trilateration:
    """Return where targets are and how they move.

    Source: Avatirak et al. 2012, eqs. (8), (9), (10), (11), (12).

    Sensors on one line, as any two are, cannot distinguish a target from its mirror image behind them. It is taken to
    be on the `side` they look at, or, with `expected`, to be the image that is nearer to where a track expects it.

    Args:
        measured: [r, ṙ, r̈] of each target at each sensor (n, s, 3); NaN where a sensor does not see it.
        covariance: of each measurement (3, 3), (s, 3, 3) or (n, s, 3, 3), positive definite.
        sensors: positions (s, 2), m.
        side: the direction in which the sensors look (2,).
        centripetal: take v⊥²/r off the range accelerations before (12), as geometry demands; False: (12) as printed.
        expected: where tracks expect the targets (n, 2), m; None: on the side.
        least_angle: between two lines of sight, rad; below, the target counts as on the baseline.

    Raises:
        numpy.linalg.LinAlgError: a covariance is not positive definite.
    """
    fit = RadialFit.of(measured, covariance, sensors, centripetal=centripetal)
    baseline = _Baseline.widest(sensors, fit.seen, side)
    images = np.stack([_motion(fit, position, least_angle) for position in baseline.intersections(fit.measured)])
    state = _chosen(fit, baseline, fit.refined(images), expected)
    state[~baseline.there] = 0.0
    spread = covariance_of(fit.information(state)[0])
    spread[~baseline.there] = UNKNOWN**2 * np.eye(6)
    return Trilateration(state, spread, _status(fit, baseline.there, state, side, least_angle))


@dataclass(frozen=True, slots=True)
class _Baseline:
    """For each target the line from one sensor that sees it to another.

    Attributes:
        there: whether two sensors at different places see the target (n,).
        first, second: indices of the sensors (n,).
        origin: position of the first (n, 2).
        length: m (n,).
        along, normal: unit vectors (n, 2); the normal points to the side that the sensors look at.
    """

    there: Booleans
    first: Indices
    second: Indices
    origin: Floats
    length: Floats
    along: Floats
    normal: Floats

    @classmethod
    def widest(cls, sensors: Floats, seen: Booleans, side: Floats) -> _Baseline:
        """Return the longest there is for each target."""
        # A single sensor is paired with itself, a baseline of no length, which determines nothing.
        first, second = np.triu_indices(len(sensors), min(len(sensors) - 1, 1))
        lengths = np.linalg.norm(sensors[second] - sensors[first], axis=1)
        usable = seen[:, first] & seen[:, second] & (lengths > 1e-6)
        best = np.argmax(np.where(usable, lengths, -1.0), axis=1)
        there, first, second = usable.any(axis=1), first[best], second[best]
        length = np.where(there, lengths[best], 1.0)
        along = np.where(there[:, None], sensors[second] - sensors[first], (1.0, 0.0)) / length[:, None]
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
        normal *= np.where(normal @ side < 0.0, -1.0, 1.0)[:, None]
        return cls(there, first, second, sensors[first], length, along, normal)

    def height(self, state: Floats) -> Floats:
        """Return how far targets (…, n, 6) are from the line, m, positive on the side looked at, (…, n)."""
        return np.asarray(((state[..., :2] - self.origin) * self.normal).sum(axis=-1))

    def intersections(self, measured: Floats) -> Floats:
        """Return where the circles of the two ranges meet, on the side looked at and behind: (9), (10), (2, n, 2).

        Where they do not meet it is the point of the line that fits the two ranges best, twice.
        """
        every = np.arange(len(measured))
        r1, r2, length = measured[every, self.first, 0], measured[every, self.second, 0], self.length
        along = (r1**2 - r2**2 + length**2) / (2 * length)
        squared = (r1**2 + r2**2 - along**2 - (along - length) ** 2) / 2
        on_line = np.select(
            [r1 > r2 + length, r2 > r1 + length],
            [(r1 + r2 + length) / 2, -(r1 + r2 - length) / 2],
            (r1 - r2 + length) / 2,
        )
        along = np.where(squared < 0.0, on_line, along)
        across = np.sqrt(np.maximum(squared, 0.0))
        foot = self.origin + along[:, None] * self.along
        return np.stack([foot + across[:, None] * self.normal, foot - across[:, None] * self.normal])


def _motion(fit: RadialFit, position: Floats, least_angle: float) -> Floats:
    """Return the states (n, 6) of targets at known positions (n, 2): velocity by (11), acceleration by (12)."""
    state = np.concatenate([position, np.zeros((len(position), 4))], axis=1)
    lines = radial_jacobian(state, fit.sensors)[..., 0, :2] * fit.seen[..., None]
    # The singular values of two lines of sight are in the ratio of the tangent of half the angle between them.
    inverse = np.asarray(np.linalg.pinv(lines, rcond=least_angle / 2))
    state[:, 2:4] = times(inverse, fit.measured[..., 1])
    left = fit.measured[..., 2] - radial(state, fit.sensors, centripetal=fit.centripetal)[..., 2]
    state[:, 4:6] = times(inverse, left * fit.seen)
    return state


def _chosen(fit: RadialFit, baseline: _Baseline, images: Floats, expected: Floats | None) -> Floats:
    """Return the one of each target's two images (2, n, 6) that the measurements, or else the caller, speak for."""
    misfit = (fit.residual(images) ** 2).sum(axis=(-1, -2))
    sides = baseline.height(images)
    undecided = (sides[0] * sides[1] < 0.0) & (np.abs(misfit[1] - misfit[0]) < _CONVINCING)
    wanted = sides[0] < sides[1]
    if expected is not None:
        off = ((images[..., :2] - expected) ** 2).sum(axis=-1)
        wanted = off[1] < off[0]
    second = np.where(undecided, wanted, misfit[1] < misfit[0])
    return np.asarray(np.where(second[:, None], images[1], images[0]))


def _status(fit: RadialFit, there: Booleans, state: Floats, side: Floats, least_angle: float) -> NDArray[np.int8]:
    """Return the validity of each state; of several reasons against it the gravest."""
    lines = radial_jacobian(state, fit.sensors)[..., 0, :2] * fit.seen[..., None]
    gram = np.swapaxes(lines, 1, 2) @ lines
    half, spread = gram.trace(axis1=1, axis2=2) / 2, np.hypot((gram[:, 0, 0] - gram[:, 1, 1]) / 2, gram[:, 0, 1])
    parallel = half - spread < (least_angle / 2) ** 2 * (half + spread)
    apart = (np.abs(fit.residual(state)[..., 0]) > _APART).any(axis=1)
    behind = (state[:, :2] - fit.middle) @ side < 0.0
    statuses = [Status.TOO_FEW, Status.APART, Status.ON_BASELINE, Status.BEHIND]
    return np.select([~there, apart, parallel, behind], statuses, Status.OK).astype(np.int8)
