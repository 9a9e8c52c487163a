"""Simulates a scenario through a configuration's sensors: frames, and the truth that belongs to them."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass
from operator import itemgetter
from typing import Final

import numpy as np

from candaemon.arrays import Indices
from candaemon.binding.bound import Binding, BoundSensor
from candaemon.binding.location import SettingLocation
from candaemon.config.settings import unknown_name
from candaemon.errors import ConfigError
from candaemon.frames.frame import Frame
from candaemon.simulation.ego_sensors import EgoEncoder
from candaemon.simulation.failing_sensor import FailingSensor
from candaemon.simulation.random_streams import stream
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.scene import Scene, SceneState
from candaemon.simulation.schedule import scan_times, start_ns
from candaemon.simulation.sensor_frames import SensorEncoder
from candaemon.simulation.sensor_model import turned
from candaemon.simulation.slot_reports import SlotReport, SlotReporter
from candaemon.simulation.truth import Truth, TruthCycle

MOST_SCANS: Final = 5_000_000
"""Scans of all sensors in a simulation: a day of two radars at 25 Hz."""


@dataclass(frozen=True, slots=True)
class Origins:
    """What the objects of one scan really are, n of them.

    Attributes:
        time_ns: the scan's time as a reader of its frames gives it, in the log's clock.
        measured_ns: the instant of the measurement, in the log's clock; the truth has this time.
        sensor: index of the sensor.
        object_id: of each object, as a reader of the frames identifies it (n,).
        source: `id` in the truth of what each object is of; 0 for a false one (n,).

    """

    time_ns: int
    measured_ns: int
    sensor: int
    object_id: Indices
    source: Indices


class Simulation:
    """A scenario as the sensors of a configuration report it. The same arguments give the same frames.

    Args:
        scenario: the drive.
        binding: the configuration, bound to its DBC files.
        seed: of all random streams; default: the scenario's.

    Raises:
        ConfigError: the ego of the scenario moves but that of the configuration is static, a sensor's frames cannot be
            written with its DBC, a fault is of a sensor that is not there, or there would be more than `MOST_SCANS`.

    """

    def __init__(self, scenario: Scenario, binding: Binding, seed: int | None = None) -> None:
        self.scenario = scenario
        self.seed = scenario.seed if seed is None else seed
        self._binding = binding
        self._scene = Scene(scenario)
        self._settings = [sensor.settings for sensor in binding.sensors]
        if binding.ego is None and (scenario.ego.segments or scenario.ego.start.speed != 0.0):
            raise ConfigError(
                "the configuration's ego is static but the scenario's moves; let it stand there, "
                "or give an ego of kind ins or odometry",
                file=binding.loaded.path,
                line=binding.loaded.line_of(("ego",)),
            )
        scans = sum(math.ceil(scenario.duration / settings.cycle_time) for settings in self._settings)
        if scans > MOST_SCANS:
            raise ConfigError(
                f"{scenario.duration:g} s of the scenario are {scans:,} scans of all sensors, expected {MOST_SCANS:,} "
                "at most; make its duration shorter, or the sensors' cycle_time longer",
                file=binding.loaded.path,
                line=binding.loaded.line_of(("sensors",)),
            )
        names = [sensor.name for sensor in binding.sensors]
        for fault in scenario.sensor_faults:
            if fault.sensor not in names:
                raise ConfigError(
                    f"sensor_faults: {unknown_name('sensor', fault.sensor, names)}, those of the configuration",
                    file=binding.loaded.path,
                    line=binding.loaded.line_of(("sensors",)),
                )
        for sensor in binding.sensors:
            self._encoder(sensor)

    def frames(self) -> Iterator[Frame]:
        """Yield all frames of all buses in order of time, made scan by scan."""
        streams = [self._frames(sensor) for sensor in self._binding.sensors]
        if self._binding.ego is not None:
            ego = EgoEncoder(self._binding.ego, self.scenario, seed=self.seed, source=len(self._binding.sensors))
            streams.append(ego.frames(self._scene))
        return heapq.merge(*streams, key=itemgetter(0))

    def origins(self) -> Iterator[Origins]:
        """Yield what the objects of each scan of which a frame is left are, of all sensors, in order of time."""
        streams = [self._origins(sensor) for sensor in self._binding.sensors]
        return heapq.merge(*streams, key=lambda scan: scan.time_ns)

    def reports(self, sensor: int) -> Iterator[tuple[int, SlotReport]]:
        """Yield the reports of one sensor, while it is not silent: measurement time (ns, log clock), occupied slots."""
        settings = self._settings[sensor]
        reporter = SlotReporter(self._scene, settings, self.scenario, seed=self.seed, source=sensor)
        times = self._times(sensor)
        name = self._binding.sensors[sensor].name
        faults = [fault for fault in self.scenario.sensor_faults if fault.sensor == name]
        failing = FailingSensor(faults, settings, stream(self.seed, sensor, "failing")) if faults else None
        for instant, time_ns in zip(self._states(times), times.tolist(), strict=True):
            report: SlotReport | None = reporter.report(instant)
            if failing is not None and report is not None:
                report = failing.reported(report, (time_ns - start_ns(self.scenario)) * 1e-9)
            if report is not None:
                yield time_ns, report

    def truth(self) -> Iterator[TruthCycle]:
        """Yield the truth at each measurement time of any sensor, in order."""
        measurement = self.scenario.measurement
        mounted = [turned(settings, measurement.turned_deg) for settings in self._settings]
        truth = Truth(self._scene, mounted, occlusion=measurement.occlusion)
        times = np.unique(np.concatenate([self._times(k) for k in range(len(self._settings))]))
        for instant, time_ns in zip(self._states(times), times.tolist(), strict=True):
            yield truth.cycle(instant, time_ns)

    def _times(self, sensor: int) -> Indices:
        """Return the measurement times of a sensor, ns, log clock."""
        return scan_times(self.scenario, self._settings, sensor, self.seed)

    def _states(self, times: Indices) -> Iterator[SceneState]:
        """Yield the scene at times of the log's clock, ns."""
        return self._scene.states((times - start_ns(self.scenario)) / 1e9)

    def _encoder(self, sensor: BoundSensor) -> SensorEncoder:
        """Return the encoder of a sensor's frames."""
        where = SettingLocation(self._binding.loaded, ("sensors", sensor.name))
        return SensorEncoder(sensor, self.scenario.frames, seed=self.seed, where=where)

    def _scans(self, sensor: BoundSensor, encoder: SensorEncoder) -> Iterator[tuple[int, SlotReport, list[Frame]]]:
        """Yield one sensor's measurement times, reports and frames, these in order of time."""
        last = -(1 << 62)
        number = {time_ns: k for k, time_ns in enumerate(self._times(sensor.index).tolist())}  # silent ones count, too
        for time_ns, report in self.reports(sensor.index):
            frames = []
            for frame in encoder.frames(report, number[time_ns], time_ns):
                # a delayed frame delays those behind it: a bus keeps their order
                last = max(last, frame.time_ns)
                frames.append(frame if frame.time_ns == last else frame._replace(time_ns=last))
            yield time_ns, report, frames

    def _frames(self, sensor: BoundSensor) -> Iterator[Frame]:
        """Yield one sensor's frames in order of time."""
        for _, _, frames in self._scans(sensor, self._encoder(sensor)):
            yield from frames

    def _origins(self, sensor: BoundSensor) -> Iterator[Origins]:
        """Yield what one sensor's objects are, scan by scan."""
        encoder, settings = self._encoder(sensor), sensor.settings
        latency_ns, stamping = round(settings.latency * 1e9), -1 if settings.time_from == "last" else 0
        for time_ns, report, frames in self._scans(sensor, encoder):
            if frames:
                read_ns = frames[stamping].time_ns - latency_ns if sensor.stamp is None else time_ns
                yield Origins(read_ns, time_ns, sensor.index, encoder.identities(report), report.owner + 1)


def simulate(scenario: Scenario, binding: Binding, seed: int | None = None) -> Simulation:
    """Simulate a scenario through the sensors of a configuration; see `Simulation`."""
    return Simulation(scenario, binding, seed)
