"""The noise of each sensor's detections, estimated by each track."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.noise_factor import NoiseFactor, NoiseFactorState


@dataclass(slots=True)
class SensorNoiseState:
    """Estimates of the noise of the sensors.

    Attributes:
        count: of tracks, n.
        factors: state of the factor of each sensor that has reported, by its number.
    """

    count: int = 0
    factors: dict[int, NoiseFactorState] = field(default_factory=dict)


class SensorNoise:
    """A factor on the position noise for each track and sensor.

    A sensor that has gone bad on a target loses its weight there, and gets it back when it recovers. Speeds keep their
    stated noise.

    Args:
        make: makes a way to learn a factor, without rows; one is made for each sensor as it first reports.
        headroom: times the noise found so far that a sensor may have become worse since; from 1.
        most: factor on the stated noise beyond which headroom does not go.
    """

    def __init__(self, make: Callable[[], NoiseFactor], *, headroom: float = 50.0, most: float = 400.0) -> None:
        self._make = make
        self._headroom, self._most = headroom, most
        self._factors: dict[int, NoiseFactor] = {}
        self._state = SensorNoiseState()

    @property
    def state(self) -> SensorNoiseState:
        """All that it remembers.

        Raises:
            ValueError: a state that is set does not fit.
        """
        return self._state

    @state.setter
    def state(self, state: SensorNoiseState) -> None:
        factors = {}
        for sensor, remembered in state.factors.items():
            factor = factors[sensor] = self._make()
            factor.state = remembered
            if len(factor) != state.count:
                raise ValueError(f"sensor {sensor} has {len(factor)} noise factors, expected {state.count}")
        self._state, self._factors = state, factors

    def spawn(self, count: int) -> None:
        """Append tracks for which all sensors have their stated noise."""
        self._state.count += count
        for factor in self._factors.values():
            factor.spawn(count)

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others; a row given twice becomes two."""
        self._state.count = int(np.count_nonzero(rows)) if rows.dtype == np.bool_ else len(rows)
        for factor in self._factors.values():
            factor.keep(rows)

    def renumber_sensors(self, sensors: Mapping[int, int]) -> None:
        """Give sensors other numbers; the estimates for those left out are dropped."""
        self._factors = {sensors[each]: factor for each, factor in self._factors.items() if each in sensors}
        self._state.factors = {each: factor.state for each, factor in self._factors.items()}

    def inflated(self, rows: Indices, measurement: Measurement) -> Measurement:
        """Return the measurement with its noise inflated to the largest plausible; nothing is learnt.

        Args:
            rows: the tracks, (m,).
            measurement: a detection each, known to be of the track.
        """
        factor = self._factors.get(measurement.sensor)
        found = np.ones(len(rows)) if factor is None else factor.scale[rows]
        return measurement.scaled(np.clip(self._headroom * found, 1.0, self._most))

    def adapted(self, rows: Indices, measurement: Measurement, position: Floats, covariance: Floats) -> Measurement:
        """Learn from the innovations and return the measurement with its estimated noise.

        Args:
            rows: the tracks, (m,), each once.
            measurement: a detection each.
            position: predicted, (m, 2), m.
            covariance: of the predicted positions, (m, 2, 2).
        """
        factor = self._factors.get(measurement.sensor)
        if factor is None:
            factor = self._factors[measurement.sensor] = self._make()
            factor.spawn(self._state.count)
            self._state.factors[measurement.sensor] = factor.state
        return measurement.scaled(factor.observe(rows, measurement.position - position, covariance, measurement.noise))
