"""How alike a sensor's errors are from scan to scan, learnt from innovations.

The innovations of a filter that knows its noise are white. Where the errors of one scan are those of the scan before,
in part, so are the innovations: of a filter that remembers longer than errors last they are little else than errors,
and their correlation over T, the time after which a sensor has looked everywhere, is share · exp(−T / time). What
slides over a body counts like that, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import exp, isfinite
from typing import Final

import numpy as np

from candaemon import compiled
from candaemon.arrays import Floats, Indices
from candaemon.config.sensors import ErrorCorrelation, SensorSettings
from candaemon.estimation.measurement import Measurement
from candaemon.tracking.body_store import UNUSED, Bodies

UNKNOWN: Final = ErrorCorrelation.defaults()
"""Of a sensor as long as little is known; the time stands."""
_UNKNOWN_WEIGHT = 20.0  # sum of squares of innovations that counts for as much as what is not known
_MOST_WEIGHT = 10_000.0  # sum of squares beyond which what is older counts half
_MOST = 9.0  # square of an innovation that is an error; beyond, something else happened
_FRESH = 1.5  # times of looking everywhere, from one detection to the next
_SETTLED_NS = 1_000_000_000  # age from which on a body's velocity is known
_MOST_SHARE = 0.9
_ROUNDED = 1.0 + 1e-9  # to which sums of alike innovations may exceed one another


@dataclass(slots=True)
class InnovationSums:
    """Sums over pairs of innovations that lie one scan apart, each in standard deviations of its noise.

    Attributes:
        products: sum of the products of the two.
        squares: sum of the means of both squares.
    """

    products: float = 0.0
    squares: float = 0.0


@dataclass(slots=True)
class InnovationCorrelationState:
    """What is remembered of each sensor, by its number."""

    sensors: dict[int, InnovationSums] = field(default_factory=dict)


class InnovationCorrelation:
    """Learns how alike the errors of each sensor are.

    Args:
        sensors: settings of each sensor by its number. A correlation that they give stands, whatever is learnt.
    """

    def __init__(self, sensors: Mapping[int, SensorSettings]) -> None:
        self._given = {number: settings.noise.correlation for number, settings in sensors.items()}
        self._revisit_times = {number: settings.revisit_time for number, settings in sensors.items()}
        self._state = InnovationCorrelationState({number: InnovationSums() for number in sensors})

    @property
    def state(self) -> InnovationCorrelationState:
        """All that it remembers. Of a sensor that a state does not have, nothing is known yet.

        Raises:
            ValueError: a state that is set is of other sensors, or contradicts itself.
        """
        return self._state

    @state.setter
    def state(self, state: InnovationCorrelationState) -> None:
        if not state.sensors.keys() <= self._given.keys():
            raise ValueError("innovations of other sensors than the configuration's")
        for each in state.sensors.values():
            if not (
                isfinite(each.products) and isfinite(each.squares) and each.squares * _ROUNDED >= abs(each.products)
            ):
                raise ValueError("the products of innovations exceed their squares")
        self._state = InnovationCorrelationState({number: InnovationSums() for number in self._given} | state.sensors)

    def renumber_sensors(self, sensors: Mapping[int, int]) -> None:
        """Give what is known to the sensors' other numbers, and forget those left out.

        Args:
            sensors: number of a sensor from here on, by the number it had.
        """
        self._given = {sensors[old]: each for old, each in self._given.items() if old in sensors}
        self._revisit_times = {sensors[old]: each for old, each in self._revisit_times.items() if old in sensors}
        remembered = self._state.sensors
        self._state.sensors = {sensors[old]: each for old, each in remembered.items() if old in sensors}

    def share(self, sensor: int) -> tuple[float, float]:
        """Return the share of a sensor's noise that is correlated, and its time, s: of the settings, else learnt.

        Of a sensor without settings nothing is.
        """
        given, sums = self._given.get(sensor), self._state.sensors.get(sensor)
        if given is not None:
            return given.share, given.time
        if sums is None:
            return 0.0, UNKNOWN.time
        kept = exp(-self._revisit_times[sensor] / UNKNOWN.time)
        products = sums.products + _UNKNOWN_WEIGHT * UNKNOWN.share * kept
        learnt = products / (sums.squares + _UNKNOWN_WEIGHT) / kept
        return min(max(learnt, 0.0), _MOST_SHARE), UNKNOWN.time

    def observe(self, bodies: Bodies, rows: Indices, measurement: Measurement, time_ns: int) -> None:
        """Take the innovations of a scan; to be called before the bodies are updated with it.

        Only leading reflections count: where the others of a body lie is known less well. So do only confirmed bodies,
        from a second after their first detection on, when their velocities are known.

        Args:
            bodies: predicted to the time of the scan.
            rows: of the reflections detected (m,), none twice.
            measurement: the detection of each.
            time_ns: of the scan.
        """
        sensor = measurement.sensor
        sums = self._state.sensors.get(sensor)
        if sums is None:
            return
        since_ns = time_ns - round(_FRESH * self._revisit_times[sensor] * 1e9)
        products, squares = _innovations(bodies, rows, measurement, since_ns, time_ns - _SETTLED_NS)
        sums.products += products
        sums.squares += squares
        if sums.squares > _MOST_WEIGHT:
            sums.products, sums.squares = 0.5 * sums.products, 0.5 * sums.squares


def _innovations(
    bodies: Bodies, rows: Indices, measurement: Measurement, since_ns: int, born_ns: int
) -> tuple[float, float]:
    """Note innovations with the reflections; return the sums over those that come one scan after another.

    Args:
        bodies: as in `observe`.
        rows: likewise.
        measurement: likewise.
        since_ns: when what was detected in the scan before was, at the earliest.
        born_ns: when a body was first detected whose velocity is known, at the latest.
    """
    obstacles, reflections, shown = bodies.obstacles, bodies.reflections, bodies.moments().shown
    if compiled.in_use:
        return compiled.kernels.note_innovations(
            reflections.innovation,
            rows,
            reflections.body,
            reflections.sensor,
            reflections.last_ns,
            obstacles.leader,
            obstacles.confirmed,
            obstacles.first_ns,
            shown,
            measurement.position,
            measurement.noise,
            measurement.sensor,
            since_ns,
            born_ns,
            _MOST,
            UNUSED,
        )
    body, noise = reflections.body[rows], measurement.noise
    told = obstacles.confirmed[body] & (obstacles.first_ns[body] < born_ns) & (obstacles.leader[body] == rows)
    deviation = np.sqrt(0.5 * (noise[:, 0, 0] + noise[:, 1, 1]))
    innovation = (measurement.position - shown[body, :2]) / deviation[:, None]
    before = reflections.innovation[rows]
    square, square_before = _squares(innovation), _squares(before)
    fresh = told & (reflections.last_ns[rows] >= since_ns) & (reflections.sensor[rows] == measurement.sensor)
    fresh &= (square < _MOST) & (square_before < _MOST)
    reflections.innovation[rows] = np.where(told[:, None], innovation, UNUSED)
    products = innovation[:, 0] * before[:, 0] + innovation[:, 1] * before[:, 1]
    return _total(products[fresh]), _total((0.5 * (square + square_before))[fresh])


def _total(values: Floats) -> float:
    """Return the sum of values (m,), one after the other as the kernel adds them up; `sum` compensates for rounding."""
    total = 0.0
    for value in values.tolist():
        total += value
    return total


def _squares(innovation: Floats) -> Floats:
    """Return the squares of innovations (m, 2)."""
    return np.asarray(innovation[:, 0] * innovation[:, 0] + innovation[:, 1] * innovation[:, 1])
