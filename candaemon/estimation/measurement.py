"""Measurements as the filters take them: positions and speeds in the local frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from candaemon import compiled
from candaemon.arrays import Floats, Indices, Integers


@dataclass(frozen=True, slots=True)
class Projection:
    """A measured component of the velocity over ground in a fixed direction, with one entry a detection.

    Attributes:
        direction: unit vectors (m, 2), local frame.
        value: m/s (m,); NaN where it was not measured.
        variance: (m/s)², (m,).
    """

    direction: Floats
    value: Floats
    variance: Floats


@dataclass(slots=True)  # made each cycle, and never changed: freezing takes four times as long as filling
class Measurement:
    """m detections of one scan in the local frame.

    Attributes:
        position: (m, 2), m.
        noise: covariance of the position (m, 2, 2), m².
        origin: position of the sensor (2,), m.
        velocity: velocity of the sensor over ground (2,), m/s, the vehicle's turning included.
        range_rate: speed along the line of sight, positive away (m,), m/s; NaN where there is none; or None.
        range_rate_variance: (m,), (m/s)².
        projections: further velocity components.
        sensor: index of the sensor.
    """

    position: Floats
    noise: Floats
    origin: Floats
    velocity: Floats
    range_rate: Floats | None = None
    range_rate_variance: Floats | None = None
    projections: tuple[Projection, ...] = ()
    sensor: int = 0

    @property
    def degrees_of_freedom(self) -> int:
        """Degrees of freedom of a detection of which everything was measured."""
        return 2 + (self.range_rate is not None) + len(self.projections)

    @property
    def measured(self) -> Integers:
        """Degrees of freedom of each detection (m,), those speeds left out that were not measured."""
        speeds = [part.value for part in self.projections]
        if self.range_rate is not None:
            speeds.append(self.range_rate)
        if not speeds:
            count: Integers = np.empty(len(self.position), np.int64)
            count.fill(2)
            return count
        count = np.isfinite(speeds[0]) + np.int64(2)
        for speed in speeds[1:]:
            count += np.isfinite(speed)
        return count

    def linearised(self, mean: Floats) -> tuple[Floats, Floats, Floats]:
        """Return all parts as one linear measurement at the predicted states.

        What was not measured has neither innovation nor Jacobian, and variance 1/(2π): so it changes no state, and adds
        nothing to the normalised innovation squared nor to the log likelihood.

        Args:
            mean: states (m, D), [x, y, vx, vy, …].

        Returns:
            Innovation (m, f), Jacobian H (m, f, D) and noise R (m, f, f), f the degrees of freedom.
        """
        m, f = len(mean), self.degrees_of_freedom
        innovation, observation, noise = np.zeros((m, f)), np.zeros((m, f, mean.shape[1])), np.zeros((m, f, f))
        innovation[:, :2] = self.position - mean[:, :2]
        observation[:, 0, 0] = observation[:, 1, 1] = 1.0
        noise[:, :2, :2] = self.noise
        at = 2
        if self.range_rate is not None and self.range_rate_variance is not None:
            rate, observation[:, at, :4] = line_of_sight(mean, self.origin, self.velocity)
            innovation[:, at], noise[:, at, at] = self.range_rate - rate, self.range_rate_variance
            at += 1
        for part in self.projections:
            observation[:, at, 2:4] = part.direction
            innovation[:, at] = part.value - (part.direction * mean[:, 2:4]).sum(axis=1)
            noise[:, at, at] = part.variance
            at += 1
        unknown = ~np.isfinite(innovation)
        innovation[unknown], observation[unknown] = 0.0, 0.0
        row, part_of = np.nonzero(unknown)
        noise[row, part_of, part_of] = 0.5 / np.pi
        return innovation, observation, noise

    def take(self, rows: Indices) -> Measurement:
        """Return the detections of the given rows; those of all rows in order are the measurement itself."""
        if len(rows) == len(self.position) and in_order(rows):
            return self
        return Measurement(
            self.position.take(rows, axis=0),
            self.noise.take(rows, axis=0),
            self.origin,
            self.velocity,
            None if self.range_rate is None else self.range_rate.take(rows),
            None if self.range_rate_variance is None else self.range_rate_variance.take(rows),
            tuple(
                Projection(p.direction.take(rows, axis=0), p.value.take(rows), p.variance.take(rows))
                for p in self.projections
            ),
            self.sensor,
        )

    def scaled(self, factor: Floats) -> Measurement:
        """Return the detections with the variances of their positions multiplied by a factor each (m,)."""
        return replace(self, noise=_scaled(self.noise, factor))

    def weakened(self, factor: Floats) -> Measurement:
        """Return the detections with all their variances multiplied by a factor each (m,)."""
        rate = self.range_rate_variance
        return Measurement(
            self.position,
            _scaled(self.noise, factor),
            self.origin,
            self.velocity,
            self.range_rate,
            None if rate is None else rate * factor,
            tuple(replace(each, variance=each.variance * factor) for each in self.projections),
            self.sensor,
        )


def _scaled(noise: Floats, factor: Floats) -> Floats:
    """Return covariances (m, 2, 2), multiplied by a factor each (m,)."""
    if compiled.in_use:
        return compiled.kernels.scaled_noise(noise, factor)
    return noise * factor[:, None, None]


def in_order(rows: Indices) -> bool:
    """Return whether rows (m,) are 0, 1, 2 and so on."""
    if compiled.in_use:
        return compiled.kernels.in_order(rows)
    return bool((rows == np.arange(len(rows))).all())


def line_of_sight(mean: Floats, origin: Floats, velocity: Floats) -> tuple[Floats, Floats]:
    """Return the predicted range rate (…) and its Jacobian (…, 4) over x, y, vx, vy.

    Args:
        mean: states (…, D).
        origin: the sensor's position (…, 2), m, in the axes of the state.
        velocity: the sensor's velocity over ground (…, 2), m/s.
    """
    if compiled.in_use and origin.ndim == velocity.ndim == 1:
        each = mean.reshape(-1, mean.shape[-1])
        rate, row = compiled.kernels.line_of_sight(each, *origin.tolist(), *velocity.tolist())
        return rate.reshape(mean.shape[:-1]), row.reshape(*mean.shape[:-1], 4)
    x, y = mean[..., 0] - origin[..., 0], mean[..., 1] - origin[..., 1]
    vx, vy = mean[..., 2] - velocity[..., 0], mean[..., 3] - velocity[..., 1]
    distance = np.sqrt(x * x + y * y)
    nearest = np.maximum(distance, 1e-3)
    x /= nearest
    y /= nearest
    rate = x * vx + y * vy
    row = np.empty((*mean.shape[:-1], 4))
    far = np.maximum(distance, 1.0)
    row[..., 0] = (vx - rate * x) / far
    row[..., 1] = (vy - rate * y) / far
    row[..., 2] = x
    row[..., 3] = y
    return rate, row
