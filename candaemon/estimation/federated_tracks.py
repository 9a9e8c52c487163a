"""Tracks of several sensors under a federated filter: paper 004, section 3.3, with the radar's measurements."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.estimator_state import FederatedTracksState
from candaemon.estimation.federated import fused, information_shares
from candaemon.estimation.filter_bank import MomentBank
from candaemon.estimation.kalman import update
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.motion_models import MotionModel
from candaemon.estimation.sensor_noise import SensorNoise


class FederatedTracks(MomentBank):
    """A local filter for each sensor and a global one over them; rows are tracks.

    The global filter fuses after every scan and hands the result back, so that between scans the local filters are the
    global one with its covariance divided by β, and the global one is all that has to be kept. Each scan updates the
    local filter of its sensor, which starts from its share β of what is known; the others hold the rest. All parts of a
    detection are linearised once, at the global prediction. So β divides the work and changes no result: what weighs a
    sensor is its noise, as stated or as each track finds it out, and β follows that.

    Args:
        model: of every filter.
        acceleration: standard deviation of a track's first acceleration, m/s².
        turn_rate: standard deviation of a track's first turn rate, rad/s.
        jerk: standard deviation of a track's first jerk, m/s³.
        outage: times the noise of the best sensor from which on a sensor is left the least share.
        least: that share; never more than an even one.
        noise: finds out how noisy each track's detections are; None: they are as noisy as they say.
    """

    _state: FederatedTracksState

    def __init__(
        self,
        model: MotionModel,
        *,
        acceleration: float,
        turn_rate: float,
        jerk: float,
        outage: float,
        least: float,
        noise: SensorNoise | None = None,
    ) -> None:
        super().__init__([model], acceleration=acceleration, turn_rate=turn_rate, jerk=jerk, noise=noise)
        self._outage, self._least = outage, least

    @property
    def share(self) -> Floats:
        """Information factors β of the sensors in the order of their first scans, (n, S)."""
        return information_shares(self._state.trace, self._outage, self._least)

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others; a row given twice becomes two."""
        super().keep(rows)
        self._state.trace = self._state.trace[rows]

    def renumber_sensors(self, sensors: Mapping[int, int]) -> None:
        """Give sensors other numbers; what is known of those left out is forgotten."""
        super().renumber_sensors(sensors)
        state = self._state
        known = [k for k, each in enumerate(state.sensors) if each in sensors]
        state.sensors = [sensors[state.sensors[k]] for k in known]
        state.stated, state.trace = state.stated[known], state.trace[:, known]

    def _empty(self) -> FederatedTracksState:
        return FederatedTracksState(*self._empty_weights(), *self._empty_moments(), [], np.zeros(0), np.zeros((0, 0)))

    def _hand_down(self) -> None:
        super()._hand_down()
        state = self._state
        if state.trace.shape != (len(self), len(state.sensors)) or state.stated.shape != (len(state.sensors),):
            raise ValueError("what is known of the sensors' noise does not fit the tracks")

    def _adapted(self, rows: Indices, measurement: Measurement) -> Measurement:
        """Return the measurement as noisy as the tracks have found it to be, and note that for the shares."""
        adapted = super()._adapted(rows, measurement)
        if len(rows):
            sensor = self._place(measurement)
            self._state.trace[rows, sensor] = _traces(adapted)
        return adapted

    def _corrected(
        self, rows: Indices, mean: Floats, covariance: Floats, measurement: Measurement
    ) -> tuple[Floats, Floats]:
        """Update the sensor's local filters and fuse them with the others' share, (10) to (12), (19) and (20)."""
        if not len(rows):
            return np.zeros((0, 1)), np.zeros((0, 1))
        innovation, observation, noise = measurement.linearised(mean[:, 0])
        whole, spread = mean[:, 0].copy(), covariance[:, 0].copy()
        fit = update(whole, spread, innovation, observation, noise)
        sensors = self._state.sensors
        if len(sensors) > 1:
            mine = self.share[rows, sensors.index(measurement.sensor), None, None]
            locals_ = np.repeat(mean, 2, axis=1)
            spreads = np.stack([covariance[:, 0] / mine, covariance[:, 0] / (1.0 - mine)], axis=1)
            update(locals_[:, 0], spreads[:, 0], innovation, observation, noise)
            whole, spread = fused(locals_, spreads)
        mean[:, 0], covariance[:, 0] = whole, spread
        return fit.nis[:, None], fit.log_likelihood[:, None]

    def _place(self, measurement: Measurement) -> int:
        """Return the sensor's column; a sensor that has not been seen gets one, as noisy as it says."""
        state = self._state
        if measurement.sensor not in state.sensors:
            state.sensors.append(measurement.sensor)
            stated = _traces(measurement).mean()
            state.stated = np.append(state.stated, stated)
            state.trace = np.concatenate([state.trace, np.full((len(self), 1), stated)], axis=1)
        return state.sensors.index(measurement.sensor)

    def _append(self, mean: Floats, covariance: Floats, probability: Floats) -> None:
        super()._append(mean, covariance, probability)
        state = self._state
        state.trace = np.concatenate([state.trace, np.tile(state.stated, (len(mean), 1))])

    def _interact(self, dt: float) -> None:
        """Do nothing: the filters meet after each scan."""

    def _weigh(self, rows: Indices, log_likelihood: Floats) -> None:
        """Do nothing: there is one model."""


def _traces(measurement: Measurement) -> Floats:
    """Return tr(R) of the position of each detection, (m,), m²."""
    return np.asarray(np.trace(measurement.noise, axis1=1, axis2=2))
