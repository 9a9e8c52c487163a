"""Range rates of rigid bodies, each along its own line of sight.

The reflections of a lorry that passes close by are seen at angles that differ by tens of degrees, and come nearer or go
away at as many speeds: one line of sight for all of them would turn its velocity. About what is known of a body each
range rate is linear in its place and velocity. Those of one body are added up to at most two components of the
velocity, by the principal axes of their information, which say all that the single ones say of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.estimation.measurement import line_of_sight

LEAST_INFORMATION: Final = 0.05
"""(s/m)², below which a component is not worth an update."""


@dataclass(frozen=True, slots=True)
class SpeedComponent:
    """One number of each of m bodies: of place p, velocity v and turn rate ω, slope · p + direction · v + lever ω.

    Attributes:
        slope: over the place that the sensor sees (m, 2), 1/s.
        direction: unit vectors over the velocity (m, 2).
        value: m/s (m,); NaN where nothing tells it.
        variance: (m/s)², (m,).
        lever: over the turn rate (m,), m; None: it does not depend on that.
    """

    slope: Floats
    direction: Floats
    value: Floats
    variance: Floats
    lever: Floats | None = None


@dataclass(slots=True)  # made each cycle
class BodyRates:
    """Range rates of n detections of m bodies.

    Attributes:
        value: speed along the line of sight, positive away (n,), m/s; NaN where there is none.
        variance: (n,), (m/s)².
        body: index of the body of each (n,), 0 to m − 1.
        offset: from the place of the body's leading reflection (n, 2), local frame, m.
        spread: variance of each component of the offset (n,), m²: close by, the line of sight is as uncertain.
        origin: position of the sensor (2,), m.
        velocity: of the sensor over ground (2,), m/s.
        share: times the variance of its own that a mean of several speeds is taken to have.
        arm: from the point of its body whose velocity is told (n, 2), local frame, m; zero where no turning is known.
            None: no turning is counted.
    """

    value: Floats
    variance: Floats
    body: Indices
    offset: Floats
    spread: Floats
    origin: Floats
    velocity: Floats
    share: float = 1.0
    arm: Floats | None = None

    def components(self, state: Floats) -> tuple[SpeedComponent, ...]:
        """Return what the range rates tell, linearised about places and velocities, in order of what they know.

        Args:
            state: place of the leading reflection, velocity and turn rate of each body (m, 5), local frame; without
                the turn rates (m, 4) where no turning is counted.
        """
        terms, (xx, xy, yy) = self._terms(state)
        middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
        root = np.sqrt(half * half + xy * xy)
        divisor = np.where(root > 0.0, root, 1.0)
        most = np.sqrt(0.5 + 0.5 * np.where(root > 0.0, np.abs(half) / divisor, 1.0))
        least = 0.5 * np.abs(xy) / (divisor * most)
        c = np.where(half >= 0.0, most, least)
        s = np.copysign(np.where(half >= 0.0, least, most), xy)
        found = []
        for information, cx, cy in ((middle + root, c, s), (middle - root, -s, c)):
            if (information > LEAST_INFORMATION).any():
                found.append(self._component(terms, state, information, cx, cy))
        return tuple(found)

    def _terms(self, state: Floats) -> tuple[Floats, Floats]:
        """Return slope, line of sight, weight, innovation and lever of each range rate (7, n); information (3, m)."""
        each = state.take(self.body, axis=0)
        each[:, :2] += self.offset
        rate, row = line_of_sight(each, self.origin, self.velocity)
        known = np.isfinite(self.value)
        slope_x, slope_y, x, y = row.T
        variance = self.variance + self.spread * (slope_x * slope_x + slope_y * slope_y)
        weight = np.where(known, 1.0 / variance, 0.0)
        information = (self._total(each, len(state)) for each in (weight * x * x, weight * x * y, weight * y * y))
        lever = np.zeros(len(rate))
        if self.arm is not None:
            lever = self.arm[:, 0] * y - self.arm[:, 1] * x
            rate = rate + lever * each[:, 4]
        return np.vstack([row.T, weight, np.where(known, self.value - rate, 0.0), lever]), np.stack(list(information))

    def _component(self, terms: Floats, state: Floats, information: Floats, cx: Floats, cy: Floats) -> SpeedComponent:
        """Return what the range rates tell along the directions (cx, cy) of so much information (m,)."""
        m, (slope_x, slope_y, x, y, weight, innovation, lever) = len(state), terms
        tells = information > LEAST_INFORMATION
        divisor = np.where(tells, information, 1.0)
        part = weight * (x * cx[self.body] + y * cy[self.body])
        slope = np.stack([self._total(part * slope_x, m) / divisor, self._total(part * slope_y, m) / divisor], axis=1)
        direction = np.stack([cx, cy], axis=1)
        value = self._total(part * innovation, m) / divisor
        value += (slope * state[:, :2]).sum(axis=1) + (direction * state[:, 2:4]).sum(axis=1)
        levers = None if self.arm is None else self._total(part * lever, m) / divisor
        if levers is not None:
            value += levers * state[:, 4]
        value[~tells] = np.nan
        return SpeedComponent(slope, direction, value, self.share / divisor, levers)

    def _total(self, values: Floats, bodies: int) -> Floats:
        """Return the sums over the range rates of each body (m,)."""
        return np.asarray(np.bincount(self.body, values, bodies), dtype=np.float64)
