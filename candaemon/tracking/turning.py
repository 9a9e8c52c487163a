"""What the turning of bodies adds to the velocities of their points.

Where a body turns at ω, a point at r from another, that moves at v, moves at v + ω × r. Two metres from the centre of a
car that turns off, that is a metre per second. The filter tells the velocity of one point of each body, its pivot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from candaemon import compiled
from candaemon.arrays import Floats, Indices
from candaemon.estimation.measurement import Measurement


@dataclass(slots=True)  # made each cycle
class Turning:
    """How k bodies turn.

    Attributes:
        rate: ω (k,), rad/s, positive to the left; 0 of those that may be points.
        variance: of it (k,), (rad/s)²; likewise.
        pivot: the point whose velocity the filter tells (k, 2), local frame, m: of a known box the centre, of others
            the reference point, about which their reflections lie.
    """

    rate: Floats
    variance: Floats
    pivot: Floats

    def velocities(self, body: Indices, place: Floats) -> Floats:
        """Return ω × r of places on bodies (n, 2), local frame, m/s.

        Args:
            body: row of the body of each (n,).
            place: (n, 2), local frame, m.
        """
        arm, rate = place - self.pivot.take(body, axis=0), self.rate.take(body)
        return np.stack([-rate * arm[:, 1], rate * arm[:, 0]], axis=1)

    def swing(self, arm: Floats) -> tuple[Floats, Floats]:
        """Return ω × r and one standard deviation of it, a vector, m/s, of an r on each body (k, 2), local frame, m."""
        left = np.stack([-arm[:, 1], arm[:, 0]], axis=1)
        return self.rate[:, None] * left, np.sqrt(self.variance)[:, None] * left

    def surely(self, deviations: float, share: Floats) -> Turning:
        """Return it with what of each ω is beyond so many standard deviations of it, times a share (k,)."""
        beyond = np.maximum(np.abs(self.rate) - deviations * np.sqrt(self.variance), 0.0)
        return Turning(np.copysign(share * beyond, self.rate), self.variance, self.pivot)

    def arms(self, body: Indices, shown: Floats, offset: Floats) -> Floats:
        """Return r of reflections of bodies (n, 2), local frame, m; zero where no turning is known.

        Args:
            body: row of the body of each (n,).
            shown: place where the leading reflections of the bodies are expected, and velocity (k, 4), local frame.
            offset: of the reflections from those (n, 2), local frame, m.
        """
        if compiled.in_use:
            return compiled.kernels.arms_of_reflections(shown, offset, body, self.pivot, self.variance)
        known, place = self.variance.take(body) > 0.0, shown.take(body, axis=0)[:, :2] + offset
        return np.asarray((place - self.pivot.take(body, axis=0)) * known[:, None])

    def left_out(self, measurement: Measurement, body: Indices, place: Floats) -> Measurement:
        """Return detections with the velocities that they would have if the bodies did not turn.

        What is unknown of ω adds to their noise. Range rates, which tell of ω themselves, are left as they are.

        Args:
            measurement: m detections.
            body: row of the body of each (m,).
            place: of the reflections (m, 2), local frame, m.
        """
        projections = []
        for part in measurement.projections:
            added, unknown = self._along(part.direction, body, place)
            projections.append(replace(part, value=part.value - added, variance=part.variance + unknown))
        return replace(measurement, projections=tuple(projections))

    def _along(self, direction: Floats, body: Indices, place: Floats) -> tuple[Floats, Floats]:
        """Return ω × r along unit vectors (n, 2) and its variance, m/s and (m/s)² (n,)."""
        arm = place - self.pivot.take(body, axis=0)
        lever = direction[:, 1] * arm[:, 0] - direction[:, 0] * arm[:, 1]
        return lever * self.rate.take(body), lever * lever * self.variance.take(body)


def rate_and_pivot(turning: Turning | None) -> tuple[Floats | None, Floats | None]:
    """Return ω and the pivots as the kernels take them; None of bodies of which none is known to turn."""
    return (None, None) if turning is None else (turning.rate, turning.pivot)
