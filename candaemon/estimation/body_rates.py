"""Range rates of rigid bodies, each along its own line of sight.

The reflections of a lorry that passes close by are seen at angles that differ by tens of degrees, and come nearer or go
away at as many speeds: one line of sight for all of them would turn its velocity. About what is known of a body each
range rate is linear in its place and velocity. Those of one body are added up to at most two components of the
velocity, by the principal axes of their information, which say all that the single ones say of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.estimation.measurement import line_of_sight

_LEAST_INFORMATION = 0.05  # (s/m)², below which a component is not worth an update


@dataclass(frozen=True, slots=True)
class SpeedComponent:
    """One number of each of m bodies, which depends on place p and velocity v as slope · p + direction · v.

    Attributes:
        slope: over the place that the sensor sees (m, 2), 1/s.
        direction: unit vectors over the velocity (m, 2).
        value: m/s (m,); NaN where nothing tells it.
        variance: (m/s)², (m,).
    """

    slope: Floats
    direction: Floats
    value: Floats
    variance: Floats


@dataclass(frozen=True, slots=True)
class BodyRates:
    """Range rates of n detections of m bodies.

    Attributes:
        value: speed along the line of sight, positive away (n,), m/s; NaN where there is none.
        variance: (n,), (m/s)².
        body: index of the body of each (n,), 0 to m − 1.
        offset: from the place of the body's leading reflection (n, 2), local frame, m.
        origin: position of the sensor (2,), m.
        velocity: of the sensor over ground (2,), m/s.
        share: times the variance of its own that a mean of several speeds is taken to have.
    """

    value: Floats
    variance: Floats
    body: Indices
    offset: Floats
    origin: Floats
    velocity: Floats
    share: float = 1.0

    def components(self, state: Floats) -> tuple[SpeedComponent, ...]:
        """Return what the range rates tell, linearised about places and velocities, in order of what they know.

        Args:
            state: place of the leading reflection and velocity of each body (m, 4), local frame.
        """
        m, body = len(state), self.body
        each = state.take(body, axis=0)
        each[:, :2] += self.offset
        rate, row = line_of_sight(each, self.origin, self.velocity)
        slope_x, slope_y, x, y = np.ascontiguousarray(row.T)
        known = np.isfinite(self.value)
        weight = np.where(known, 1.0 / self.variance, 0.0)
        innovation = np.where(known, self.value - rate, 0.0)

        def total(values: Floats) -> Floats:
            return np.asarray(np.bincount(body, values, m), dtype=np.float64)

        xx, xy, yy = total(weight * x * x), total(weight * x * y), total(weight * y * y)
        middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
        root = np.hypot(half, xy)
        angle = 0.5 * np.arctan2(xy, half)
        c, s = np.cos(angle), np.sin(angle)
        found = []
        for information, cx, cy in ((middle + root, c, s), (middle - root, -s, c)):
            tells = information > _LEAST_INFORMATION
            if not tells.any():
                continue
            divisor = np.where(tells, information, 1.0)
            part = weight * (x * cx[body] + y * cy[body])
            slope = np.stack([total(part * slope_x) / divisor, total(part * slope_y) / divisor], axis=1)
            direction = np.stack([cx, cy], axis=1)
            value = total(part * innovation) / divisor
            value += (slope * state[:, :2]).sum(axis=1) + (direction * state[:, 2:]).sum(axis=1)
            value[~tells] = np.nan
            found.append(SpeedComponent(slope, direction, value, self.share / divisor))
        return tuple(found)
