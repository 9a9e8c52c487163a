"""Federated filtering with feedback (FR mode), batched over tracks, section 3.3; equations counted as there.

Source: Gao et al. 2016.

Each sensor has a local filter of the whole state, a global filter fuses them and hands the result back. A local filter
is given only its share β of the information: covariance and process noise divided by β, Σ β = 1. The shares add up to
what there is, so that nothing counts twice: the fused estimate is the centralised filter's, whatever the shares.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.estimation.estimator_state import FederatedTracksState
from candaemon.estimation.filter_bank import MomentBank
from candaemon.estimation.kalman import Fit, predict, symmetrise, update
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.motion_models import MotionModel
from candaemon.estimation.psd import factorise
from candaemon.estimation.sensor_noise import SensorNoise


def fused(mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return X_g = P_g Σ Pᵢ⁻¹ Xᵢ and P_g = (Σ Pᵢ⁻¹)⁻¹.

    Source: Gao et al. 2016, eqs. (19), (20).

    Two at a time, and by the inverse of their sum: P_g = P₁ (P₁ + P₂)⁻¹ P₂. So a component that the model lacks, whose
    variance is zero, does no harm.

    Args:
        mean: independent estimates of one state (…, S, D).
        covariance: (…, S, D, D).

    Returns:
        (…, D) and (…, D, D).
    """
    x, p = mean[..., 0, :], covariance[..., 0, :, :]
    for sensor in range(1, mean.shape[-2]):
        other = covariance[..., sensor, :, :]
        root = factorise(p + other).inverse
        weight = p @ np.swapaxes(root, -1, -2) @ root
        x = x + np.matmul(weight, (mean[..., sensor, :] - x)[..., None])[..., 0]
        p = weight @ other
        symmetrise(p)
    return x, p


def information_shares(trace: Floats, outage: float = 20.0, least: float = 0.01) -> Floats:
    """Return the information factors β, for any number of sensors.

    Source: Gao et al. 2016, eqs. (21), (22).

    In proportion to 1/tr(R); but a sensor whose tr(R) is `outage` times that of the best, or more, is left `least`, and
    the others share the rest. The paper has two sensors and watches the lidar alone. None is left more than 1/S, so
    that the others never have less.

    Args:
        trace: tr(R) of each sensor (…, S), positive.
        outage: 20 in the paper.
        least: 0.01 in the paper.

    Returns:
        β (…, S), positive, of sum one.
    """
    least = min(least, 1.0 / trace.shape[-1])
    best = trace.min(axis=-1, keepdims=True)
    failed = trace >= outage * best
    weight = np.where(failed, 0.0, best / trace)
    remaining = 1.0 - least * failed.sum(axis=-1, keepdims=True)
    return np.where(failed, least, remaining * weight / weight.sum(axis=-1, keepdims=True))


class Federated:
    """Local filters of S sensors and the global filter above them, for n tracks.

    Rows are tracks; the state is the caller's, (D,), as are F, Q and every H.

    `fuse` after the updates and before the next `predict`, and the fused estimate equals that of one centralised filter
    with the same F, Q, H and R. It is so for a sensor that measured nothing too: its local filter keeps its prediction.

    Args:
        sensors: S.
        outage: see `information_shares`.
        least: see `information_shares`.

    Attributes:
        mean: of the local filters (n, S, D).
        covariance: of the local filters (n, S, D, D).
        share: β (n, S), of sum one.
    """

    def __init__(self, sensors: int, *, outage: float = 20.0, least: float = 0.01) -> None:
        self._sensors = sensors
        self._outage = outage
        self._least = least
        self.mean: Floats = np.zeros((0, sensors, 0))
        self.covariance: Floats = np.zeros((0, sensors, 0, 0))
        self.share: Floats = np.zeros((0, sensors))

    def __len__(self) -> int:
        return len(self.share)

    def spawn(self, mean: Floats, covariance: Floats) -> None:
        """Append tracks with means (k, D) and covariances (k, D, D), which the sensors share alike."""
        share = np.full((len(mean), self._sensors), 1.0 / self._sensors)
        locals_, spread = self._handed_out(mean, covariance, share)
        if not len(self):
            width = mean.shape[1]
            self.mean, self.covariance = (np.zeros((0, self._sensors, *size)) for size in ((width,), (width, width)))
        self.mean = np.concatenate([self.mean, locals_])
        self.covariance = np.concatenate([self.covariance, spread])
        self.share = np.concatenate([self.share, share])

    def keep(self, rows: Indices | Booleans) -> None:
        """Keep the given rows and forget the others."""
        self.mean, self.covariance, self.share = self.mean[rows], self.covariance[rows], self.share[rows]

    def predict(self, transition: Floats, noise: Floats, predicted: Floats | None = None) -> None:
        """Predict all local filters, (8) and (9) with Qᵢ = Q/βᵢ of (23).

        Source: Gao et al. 2016, eqs. (8), (9), (23).

        Args:
            transition: F, or the Jacobian of f, (D, D) or (n, 1, D, D).
            noise: Q, (D, D) or (n, 1, D, D).
            predicted: f(x) of each local mean (n, S, D); None: F x.
        """
        predict(self.mean, self.covariance, transition, noise / self.share[:, :, None, None], predicted)

    def expected(self, sensor: int, rows: Indices, observation: Floats) -> tuple[Floats, Floats]:
        """Return what a sensor should measure of the given rows and the covariance of that, (m, d) and (m, d, d).

        H x⁻ and β H Pᵢ⁻ Hᵀ: the local filter's own covariance is 1/β times that of its error, as long as it has not
        been updated since it was reset; and an estimator of the sensor's noise needs the error's.
        """
        spread = observation @ self.covariance[rows, sensor] @ np.swapaxes(observation, -1, -2)
        return self.mean[rows, sensor] @ observation.T, self.share[rows, sensor, None, None] * spread

    def update(self, sensor: int, rows: Indices, innovation: Floats, observation: Floats, noise: Floats) -> Fit:
        """Update a sensor's local filter of the given rows, (10) to (12).

        Source: Gao et al. 2016, eqs. (10), (11), (12).

        Args:
            sensor: index among the sensors.
            rows: (m,), each once.
            innovation: (m, d).
            observation: H, (d, D) or (m, d, D).
            noise: R, (d, d) or (m, d, d).
        """
        mean, covariance = self.mean[rows, sensor], self.covariance[rows, sensor]
        fit = update(mean, covariance, innovation, observation, noise)
        self.mean[rows, sensor], self.covariance[rows, sensor] = mean, covariance
        return fit

    def combined(self) -> tuple[Floats, Floats]:
        """Return the fused mean (n, D) and covariance (n, D, D)."""
        return fused(self.mean, self.covariance)

    def fuse(self, trace: Floats) -> tuple[Floats, Floats]:
        """Fuse the local filters and hand the result back to them by shares, (19) to (25).

        Source: Gao et al. 2016, eqs. (19), (20), (21), (22), (23), (24), (25).

        Args:
            trace: tr(R) of each sensor (n, S), positive.

        Returns:
            The fused mean X_g (n, D) and covariance P_g (n, D, D).
        """
        mean, covariance = self.combined()
        self.share = information_shares(trace, self._outage, self._least)
        self.mean, self.covariance = self._handed_out(mean, covariance, self.share)
        return mean, covariance

    def _handed_out(self, mean: Floats, covariance: Floats, share: Floats) -> tuple[Floats, Floats]:
        """Return the local filters' means Xᵢ = X_g and covariances Pᵢ = P_g/βᵢ, (24) and (25)."""
        return (
            np.repeat(mean[:, None], self._sensors, axis=1),
            covariance[:, None] / share[:, :, None, None],
        )


class FederatedTracks(MomentBank):
    """A local filter for each sensor and a global one over them; rows are tracks.

    Source: Gao et al. 2016, eqs. (10), (11), (12), (19), (20).

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
        noise: estimates how noisy each track's detections are; None: they are as noisy as stated.
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

    def _update_models(
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

    def _update_probabilities(self, rows: Indices, log_likelihood: Floats) -> None:
        """Do nothing: there is one model."""


def _traces(measurement: Measurement) -> Floats:
    """Return tr(R) of the position of each detection, (m,), m²."""
    return np.asarray(np.trace(measurement.noise, axis1=1, axis2=2))
