"""Self-calibration while driving: scans in, estimates and corrections out.

Scans are held until a window of them is complete, and are then evaluated together; a scan costs no more than being
held. Nothing here depends on what is corrected: scans are held as they were stamped and in the sensor's own axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import exp, radians
from typing import Final, Protocol

import numpy as np

from candaemon.arrays import ComplexPlane, Floats
from candaemon.binding.bound import BoundSensor
from candaemon.calibration.ego_path import EgoPath, ego_path
from candaemon.calibration.parameters import (
    BIAS,
    LARGEST_YAW,
    LATENCY,
    LONGEST_LATENCY,
    SCALE,
    YAW,
    Estimate,
    ego_noise,
    prior,
)
from candaemon.calibration.readings import HeldScan, SensorReader
from candaemon.calibration.window import WindowEquations, WindowReader
from candaemon.calibration.windows import REACH, WindowsState, added, age, estimate, is_covariance
from candaemon.config.calibration import CalibrationSettings
from candaemon.config.ego import OdometrySettings
from candaemon.radar.scan import Scan

WINDOW_NS: Final = 1_000_000_000
"""ns of scans that are evaluated together."""
MOST_HELD: Final = 64
"""Scans of a sensor that are held: of a faster one, a window is shorter."""
_RELINEARISATIONS: Final = 3
"""Times that a window is evaluated, at an estimate that is nearer each time."""
_SHORTEST: Final = 0.5
"""s, of a window that is evaluated."""
_GIVEN_UP: Final = 1.0
"""Standard deviations below which a correction in force is given up."""
_TURNED: Final = radians(0.3)
"""rad, by which a sensor is turned so that it matters to the yaw rate's bias."""
_PATIENCE_NS: Final = 400_000_000
"""How long after a window's end ego motion may come."""


@dataclass(slots=True)
class SensorCalibrationState:
    """What is remembered of one sensor.

    Attributes:
        held: scans of the current window.
        windows: what the former ones have shown.
        mean, covariance: the estimate after the latest of them (4,), (4, 4).
        in_force: latency (s) and yaw (rad) by which scans are corrected.
        applied: which of the two are applied.
        corrected_ns: time of the latest scan that was corrected.
    """

    windows: WindowsState
    mean: Floats
    covariance: Floats
    held: list[HeldScan] = field(default_factory=list)
    in_force: list[float] = field(default_factory=lambda: [0.0, 0.0])
    applied: list[bool] = field(default_factory=lambda: [False, False])
    corrected_ns: int | None = None

    def validate(self) -> None:
        """Refuse what contradicts itself.

        Raises:
            ValueError: too many scans are held, or there are not two corrections.
        """
        if len(self.held) > MOST_HELD or len(self.in_force) != 2 or len(self.applied) != 2:
            raise ValueError(f"{len(self.held)} held scans, expected {MOST_HELD} at most, and two corrections")
        if any(each.values.shape[0] != self.held[0].values.shape[0] for each in self.held):
            raise ValueError("held scans of different quantities")
        if abs(self.in_force[LATENCY]) > LONGEST_LATENCY or abs(self.in_force[YAW]) > LARGEST_YAW:
            raise ValueError("a correction beyond what is estimated")
        if not is_covariance(self.covariance):
            raise ValueError("a covariance of calibration that is not positive")

    @property
    def estimate(self) -> Estimate:
        """The estimate."""
        return Estimate(self.mean, self.covariance)


@dataclass(slots=True)
class CalibratorState:
    """What a calibrator remembers, of each sensor in the order of the configuration."""

    sensors: list[SensorCalibrationState]


@dataclass(frozen=True, slots=True)
class GatheredWindow:
    """A window of a sensor, and how the vehicle moved from well before to well after."""

    sensor: int
    scans: list[HeldScan]
    path: EgoPath


class CalibratedEgo(Protocol):
    """What is asked of a source of ego motion."""

    @property
    def corrections(self) -> tuple[float, float]:
        """Factor on the speed as read, and what is taken from the yaw rate as read, rad/s."""
        ...

    def course(self, begin_ns: int, step_ns: int, count: int) -> tuple[ComplexPlane, Floats] | None:
        """Return places, east + i north, m, and unwrapped headings, rad, at even steps (count,), if all are known."""
        ...

    def correct(self, scale: float, yaw_rate: float, scale_sd: float, yaw_rate_sd: float) -> None:
        """Set the corrections, and how well they are known."""
        ...


class Calibrator:
    """Estimates what the configuration says wrongly of each sensor, and corrects it where that is asked for.

    Args:
        settings: whether it corrects, and from when on.
        sensors: of the configuration.
        ego: source of ego motion.
        ego_settings: of it.

    Attributes:
        state: all that it remembers.
        gathered: each window with its ego motion, to be evaluated when the drive is over; None: at once.
    """

    def __init__(
        self, settings: CalibrationSettings, sensors: Sequence[BoundSensor], ego: CalibratedEgo, ego_settings: object
    ) -> None:
        self.settings = settings
        self._ego = ego
        self.gathered: list[GatheredWindow] | None = None
        self._has_odometry = isinstance(ego_settings, OdometrySettings)
        self._prior = prior(ego_settings)
        self._noise = ego_noise(ego_settings)
        self._readers = [SensorReader(each.settings, each.reader.quantities) for each in sensors]
        self._windows = [WindowReader(each) for each in self._readers]
        mean, covariance = self._prior.mean, self._prior.covariance
        self._state = CalibratorState(
            [
                SensorCalibrationState(WindowsState(mean.copy(), covariance.copy()), mean.copy(), covariance.copy())
                for _ in sensors
            ]
        )

    @property
    def state(self) -> CalibratorState:
        """What it remembers.

        Raises:
            ValueError: a state that is set is of other sensors.
        """
        return self._state

    @state.setter
    def state(self, state: CalibratorState) -> None:
        if len(state.sensors) != len(self._readers):
            raise ValueError("calibration of other sensors than the configuration's")
        for sensor, reader in zip(state.sensors, self._readers, strict=True):
            if any(len(held.values) != len(reader.taken) for held in sensor.held):
                raise ValueError("held scans with other quantities than the sensor's")
        self._state = state

    def begin_with(self, sensor: int, known: Estimate) -> None:
        """Let a sensor begin with what was learnt before; corrections are in force at once."""
        state = self._state.sensors[sensor]
        state.windows = WindowsState(known.mean.copy(), known.covariance.copy())
        state.mean, state.covariance = known.mean.copy(), known.covariance.copy()
        if self.settings.apply:
            self._decide(state)
            state.in_force = [
                float(value) if on else 0.0 for value, on in zip(known.mean[:2], state.applied, strict=True)
            ]

    @property
    def has_odometry(self) -> bool:
        """Whether ego motion is read by sensors whose errors are estimated, too."""
        return self._has_odometry

    def is_known(self, sensor: int) -> bool:
        """Return whether anything was learnt of a sensor, here or before."""
        state = self._state.sensors[sensor]
        return bool((state.covariance.diagonal() < self._prior.covariance.diagonal()).any())

    def is_turned(self, sensor: int) -> bool:
        """Return whether things seem to drift because a sensor is turned by more than is corrected."""
        state = self._state.sensors[sensor]
        error = abs(float(state.mean[YAW]) - state.in_force[YAW])
        return error > max(_TURNED, 2.0 * float(np.sqrt(state.covariance[YAW, YAW])))

    def latency_ns(self, sensor: int) -> int:
        """Return by how much a sensor's scans are put back in time beyond the configured latency, ns."""
        return round(self._state.sensors[sensor].in_force[LATENCY] * 1e9)

    def yaw(self, sensor: int) -> float:
        """Return by how much a sensor is taken as turned to the left beyond its configured mounting, rad."""
        return self._state.sensors[sensor].in_force[YAW]

    def corrected(self, scan: Scan) -> Scan:
        """Return a scan with its time corrected, after the corrections have moved on towards the estimates."""
        state = self._state.sensors[scan.sensor]
        if state.corrected_ns is not None and scan.time_ns > state.corrected_ns:
            share = 1.0 - exp((state.corrected_ns - scan.time_ns) * 1e-9 / self.settings.settling)
            for k in (LATENCY, YAW):
                target = float(state.mean[k]) if state.applied[k] else 0.0
                state.in_force[k] += share * (target - state.in_force[k])
        state.corrected_ns = scan.time_ns
        moved_ns = self.latency_ns(scan.sensor)
        return replace(scan, time_ns=scan.time_ns - moved_ns) if moved_ns else scan

    def learn(self, scan: Scan) -> bool:
        """Hold a scan, as stamped, and evaluate the window that it ends; return whether there is another estimate."""
        if not self._readers[scan.sensor].locates:
            return False
        state = self._state.sensors[scan.sensor]
        held = state.held
        scale, bias = self._ego.corrections
        held.append(self._readers[scan.sensor].hold(scan, scale, bias))
        first_ns = held[0].time_ns
        if len(held) > 1 and scan.time_ns <= held[-2].time_ns:  # the clock was set
            held[:] = held[-1:]
            return False
        if scan.time_ns - first_ns < WINDOW_NS + _PATIENCE_NS and len(held) < MOST_HELD:
            return False
        end = sum(each.time_ns < min(first_ns + WINDOW_NS, scan.time_ns - _PATIENCE_NS) for each in held)
        window = held[: max(end, 1)]
        held[:] = held[len(window) :]
        return self._evaluate(scan.sensor, window)

    def _evaluate(self, sensor: int, window: list[HeldScan]) -> bool:
        """Take a window in."""
        state = self._state.sensors[sensor]
        first_ns, last_ns = window[0].time_ns, window[-1].time_ns
        seconds = (last_ns - first_ns) * 1e-9
        if seconds < _SHORTEST or not any(len(each.object_id) for each in window):
            return False
        if self.gathered is not None:
            self._gather(sensor, window, self.gathered)
            return False
        age(state.windows, seconds)
        at, found = state.estimate, None
        for _ in range(_RELINEARISATIONS):
            equations = self._equations(sensor, window, at)
            if equations is None:
                break
            windows = added(state.windows, equations, at, first_ns * 1e-9, self._noise)
            found = estimate(windows, self._noise)
            if (np.abs(found.mean - at.mean)[[LATENCY, YAW]] < REACH / 2).all():
                break
            at = found
        if found is None:
            return False
        state.windows, state.mean, state.covariance = windows, found.mean, found.covariance
        if self.settings.apply:
            self._decide(state)
            self._correct_ego()
        return True

    def _gather(self, sensor: int, window: list[HeldScan], gathered: list[GatheredWindow]) -> None:
        """Keep a window with ego motion for any latency."""
        first_ns, last_ns = window[0].time_ns, window[-1].time_ns
        margin_ns = round(LONGEST_LATENCY * 1e9)
        path = self._path(window, first_ns - margin_ns, last_ns + margin_ns)
        if path is not None:
            gathered.append(GatheredWindow(sensor, window, path))

    def _path(self, window: list[HeldScan], first_ns: int, last_ns: int) -> EgoPath | None:
        """Return ego motion between two instants, as its sensors read it."""
        times = np.array([(each.time_ns - first_ns) * 1e-9 for each in window])
        return ego_path(
            self._ego.course,
            first_ns,
            last_ns,
            np.array([times, [each.scale for each in window]]),
            np.array([times, [each.bias for each in window]]),
        )

    def _equations(self, sensor: int, window: list[HeldScan], at: Estimate) -> WindowEquations | None:
        """Return a window's equations at an estimate; None where ego motion or what stands is missing."""
        first_ns, last_ns = window[0].time_ns, window[-1].time_ns
        latency_ns = round(at.mean[LATENCY] * 1e9)
        path = self._path(window, first_ns - latency_ns, last_ns - latency_ns)
        if path is None:
            return None
        relative = np.array([float(each.time_ns - path.first_ns) for each in window])
        return self._windows[sensor].equations(self._readers[sensor].read(window), relative, path, at)

    def _decide(self, state: SensorCalibrationState) -> None:
        """Apply what is surely not 0; go on with what is applied until it may be 0."""
        for k in (LATENCY, YAW):
            deviations = abs(state.mean[k]) / np.sqrt(state.covariance[k, k])
            least = _GIVEN_UP if state.applied[k] else self.settings.significance
            state.applied[k] = bool(deviations > least)

    @property
    def ego(self) -> tuple[Floats, Floats]:
        """Speed scale − 1 and yaw rate bias (rad/s) of all sensors together, and one standard deviation of each."""
        known = 1.0 / np.diag(self._prior.covariance)[[SCALE, BIAS]]
        weight = np.array([1.0 / each.covariance.diagonal()[[SCALE, BIAS]] for each in self._state.sensors]) - known
        weight = np.maximum(weight, 0.0)
        mean = np.array([each.mean[[SCALE, BIAS]] for each in self._state.sensors])
        total = weight.sum(axis=0) + known
        return (weight * mean).sum(axis=0) / total, 1.0 / np.sqrt(total)

    def _correct_ego(self) -> None:
        """Correct what ego motion takes out of its sensors where that is surely wrong."""
        mean, deviation = self.ego
        in_force = np.array(self._ego.corrections) - (1.0, 0.0)
        if (np.abs(mean - in_force) > self.settings.significance * deviation).any():
            self._ego.correct(1.0 + float(mean[0]), float(mean[1]), float(deviation[0]), float(deviation[1]))
