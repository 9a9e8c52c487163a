"""What the turning of bodies adds to the velocities of their reflections.

A body turns about the centre of its box: a reflection at r from there moves with v + ω × r. Two metres from the centre
of a car that turns off, that is a metre per second along some line of sight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.estimation.measurement import Measurement


@dataclass(frozen=True, slots=True)
class Turning:
    """How k bodies turn.

    Attributes:
        rate: ω (k,), rad/s, positive to the left; 0 of those whose box is not known.
        variance: of it (k,), (rad/s)²; likewise.
        centre: of their boxes (k, 2), local frame, m.
    """

    rate: Floats
    variance: Floats
    centre: Floats

    def velocities(self, body: Indices, place: Floats) -> Floats:
        """Return ω × r of places on bodies (n, 2), local frame, m/s.

        Args:
            body: row of the body of each (n,).
            place: (n, 2), local frame, m.
        """
        arm, rate = place - self.centre.take(body, axis=0), self.rate.take(body)
        return np.stack([-rate * arm[:, 1], rate * arm[:, 0]], axis=1)

    def arms(self, body: Indices, place: Floats) -> Floats:
        """Return r of places on bodies (n, 2), local frame, m; zero where the box is not known.

        Args:
            body: row of the body of each (n,).
            place: (n, 2), local frame, m.
        """
        known = self.variance.take(body) > 0.0
        return np.asarray((place - self.centre.take(body, axis=0)) * known[:, None])

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
        arm = place - self.centre.take(body, axis=0)
        lever = direction[:, 1] * arm[:, 0] - direction[:, 0] * arm[:, 1]
        return lever * self.rate.take(body), lever * lever * self.variance.take(body)


def rate_and_centre(turning: Turning | None) -> tuple[Floats | None, Floats | None]:
    """Return ω and the centres of boxes as the kernels take them; None of bodies of which none is known to turn."""
    return (None, None) if turning is None else (turning.rate, turning.centre)
