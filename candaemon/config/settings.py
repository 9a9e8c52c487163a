"""The root of the configuration: one YAML file, one vehicle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Final

from pydantic import Field, model_validator

from candaemon.config.base import CrossReferenceError, Location, Settings
from candaemon.config.buses import BusSettings
from candaemon.config.calibration import CalibrationSettings
from candaemon.config.ego import EgoSettings, InsSettings, StaticSettings
from candaemon.config.names import Line, Name, Prose
from candaemon.config.output import OutputSettings
from candaemon.config.sensors import SensorSettings
from candaemon.config.service import ServiceSettings
from candaemon.config.supervision import SupervisionSettings
from candaemon.config.tracker import GroupSettings, TrackerSettings
from candaemon.config.trust import TrustSettings
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.errors import MOST_PROBLEMS
from candaemon.similar_names import listed_names, meant

MOST_SENSORS: Final = 63
"""A tracked obstacle remembers by a bit each which of them saw it."""
SEVERAL_SENSORS_CYCLE: Final = 0.05
"""s between two outputs of several sensors, where the configuration does not say."""


def unknown_name(kind: str, name: str, known: list[str]) -> str:
    """Return the message about an unknown name, with the known names and the nearest one."""
    return f"found {kind} '{name}', expected one of {listed_names(known)}{meant(name, known)}"


class Config(Settings):
    """Everything a user can vary about one vehicle."""

    name: Line = Field("", description="what to call this configuration")
    description: Prose = Field("", description="what it is for")
    buses: dict[Name, BusSettings] = Field(min_length=1, description="CAN buses by name")
    ego: EgoSettings = Field(description="ego motion")
    sensors: dict[Name, SensorSettings] = Field(
        min_length=1, max_length=MOST_SENSORS, description=f"sensors by name, {MOST_SENSORS} at most"
    )
    tracker: TrackerSettings = Field(
        default_factory=TrackerSettings.defaults, description="how detections become obstacles"
    )
    groups: dict[Name, GroupSettings] = Field(
        default_factory=dict, description="sensors tracked on their own, by group name; default: all together"
    )
    calibration: CalibrationSettings = Field(
        default_factory=CalibrationSettings.defaults, description="what is estimated of the sensors while driving"
    )
    output: OutputSettings | None = Field(None, description="how obstacles go onto a bus; default: they do not")
    ordering_window: float = Field(
        0.0, ge=0, le=1, description="s, frames of several buses are put in order of time within it"
    )
    supervision: SupervisionSettings = Field(
        default_factory=SupervisionSettings.defaults, description="when something counts as silent, lost, degraded"
    )
    trust: TrustSettings = Field(
        default_factory=TrustSettings.defaults, description="when a sensor is weighted down or cut off"
    )
    service: ServiceSettings = Field(default_factory=ServiceSettings.defaults, description="how `candaemon run` serves")

    @property
    def output_cycle_time(self) -> float:
        """Time between two outputs, s; 0: one after each scan."""
        asked = None if self.output is None else self.output.cycle_time
        if asked is None:
            return 0.0 if len(self.sensors) == 1 else SEVERAL_SENSORS_CYCLE
        return asked

    @model_validator(mode="after")
    def _references_hold(self) -> Config:
        problems = list(islice(self._reference_problems(), MOST_PROBLEMS + 1))
        if len(problems) > MOST_PROBLEMS:
            problems[MOST_PROBLEMS:] = [(problems[-1][0], "wrong too, and perhaps more; put the others right first")]
        if problems:
            raise CrossReferenceError(tuple(problems))
        return self

    def _reference_problems(self) -> Iterator[tuple[Location, str]]:
        """Yield each reference to a name that is not defined."""
        buses = list(self.buses)
        references: list[tuple[Location, str]] = [(("sensors", name, "bus"), s.bus) for name, s in self.sensors.items()]
        if not isinstance(self.ego, StaticSettings):
            references.append((("ego", "bus"), self.ego.bus))
        if self.output is not None:
            references.append((("output", "bus"), self.output.bus))
        for location, bus in references:
            if bus not in self.buses:
                yield location, unknown_name("bus", bus, buses)
        channels: dict[tuple[str, str], str] = {}
        logged: dict[str, str] = {}
        for bus, settings in self.buses.items():
            first = channels.setdefault((settings.interface, settings.channel), bus)
            if first != bus:
                yield (
                    ("buses", bus, "channel"),
                    f"channel '{settings.channel}' is bus '{first}' already; a bus has its own",
                )
            for name in settings.names_in_logs:
                owner = logged.setdefault(name, bus)
                if owner != bus and first == bus:
                    yield ("buses", bus), f"'{name}' is bus '{owner}' in a log already; give a log_channel of its own"
        yield from self._earth_problems()
        yield from self._group_problems()
        yield from self._direction_problems()
        yield from self._identity_problems()
        yield from self._alignment_problems()

    def _earth_problems(self) -> Iterator[tuple[Location, str]]:
        """Yield each setting that needs a georeference where none is configured."""
        ins = self.ego if isinstance(self.ego, InsSettings) else None
        georeferenced = ins is not None and ins.gnss is not None
        if georeferenced and ins is not None and ins.signals.latitude is None:
            yield ("ego", "gnss"), "needs the fixes; give signals.latitude and signals.longitude"
        if self.output is not None and not georeferenced:
            for quantity in self.output.signals:
                if quantity in {"latitude", "longitude"}:
                    yield ("output", "signals", quantity), "no place on earth is known; give ego.gnss, of an INS"

    def _identity_problems(self) -> Iterator[tuple[Location, str]]:
        """Yield each tracker that associates by identities alone where one of its sensors has none."""
        grouped = {sensor for group in self.groups.values() for sensor in group.sensors}
        trackers: list[tuple[Location, TrackerSettings, Iterable[str]]] = [
            (("groups", name, "tracker"), group.tracker, group.sensors) for name, group in self.groups.items()
        ]
        trackers.append((("tracker",), self.tracker, [name for name in self.sensors if name not in grouped]))
        for location, tracker, sensors in trackers:
            for name in sensors:
                if tracker.association.method == "id" and name in self.sensors and not self.sensors[name].identified:
                    problem = f"sensor '{name}' tells no identity (objects.identity: false), expected nearest"
                    yield (*location, "association", "method"), problem

    def _direction_problems(self) -> Iterator[tuple[Location, str]]:
        """Yield each sensor that tells too little for its group to place an object, or what its group does not use."""
        ranging = {name: group for name, group in self.groups.items() if group.fusion == "trilateration"}
        placed = {sensor for group in ranging.values() for sensor in group.sensors}
        for name, sensor in self.sensors.items():
            if not sensor.signals.directed and name not in placed:
                problem = "no direction; give azimuth, or put the sensor into a group with fusion: trilateration"
                yield ("sensors", name, "signals"), problem
            elif not sensor.signals.directed and sensor.signals.range_rate is None:
                yield ("sensors", name, "signals"), "trilateration needs range_rate too, which tells ghosts apart"
            elif not sensor.signals.directed and sensor.range_rates == "absolute":
                problem = "found absolute, but without azimuth nobody knows how much of the own motion it holds"
                yield ("sensors", name, "range_rates"), f"{problem}, expected relative"
        for name, group in ranging.items():
            yield from self._trilateration_problems(name, group)

    def _trilateration_problems(self, name: str, group: GroupSettings) -> Iterator[tuple[Location, str]]:
        """Yield what keeps the sensors of a group from finding places by their ranges."""
        for position, sensor in enumerate(group.sensors):
            if sensor in self.sensors and (signals := self.sensors[sensor].signals).directed:
                told = "azimuth" if signals.polar else "x and y"
                problem = f"sensor '{sensor}' tells {told}, which fusion: trilateration does not use, expected range"
                yield ("groups", name, "sensors", position), f"{problem} and range_rate alone"
        mounts = {(each.mount.x, each.mount.y) for key, each in self.sensors.items() if key in group.sensors}
        if len(mounts) < 2:
            problem = "trilateration needs sensors at two places at least, the farther apart the better"
            yield ("groups", name, "sensors"), problem
        if isinstance(group.fused_tracker.estimator, VehicleEstimatorSettings):
            problem = "found vehicle, but fusion: trilateration is of points, expected one of ca, cv, imm, mlkf …"
            yield ("groups", name, "tracker", "estimator"), problem
        if group.tracker.association.method == "id":
            problem = "found id, but the ids of one sensor say nothing of another's, expected nearest"
            yield ("groups", name, "tracker", "association", "method"), problem

    def _alignment_problems(self) -> Iterator[tuple[Location, str]]:
        """Yield what keeps objects of a group's sensors from being interpolated."""
        for name, group in self.groups.items():
            if group.align == "prediction":
                continue
            if len(group.sensors) < 2:
                yield ("groups", name, "align"), "found lagrange, but there is one sensor; nothing is to be aligned"
            for position, sensor in enumerate(group.sensors):
                location = ("groups", name, "sensors", position)
                if sensor in self.sensors and not self.sensors[sensor].identified:
                    problem = f"sensor '{sensor}' tells no identity (objects.identity: false)"
                    yield location, f"{problem}: align: lagrange cannot say which object was which"
                elif sensor in self.sensors and self.sensors[sensor].looks is not None:
                    yield location, f"sensor '{sensor}' sees an object in some of its looks alone, expected no looks"

    def _group_problems(self) -> Iterator[tuple[Location, str]]:
        """Yield each sensor of a group that does not exist or is already in another group."""
        group_of: dict[str, str] = {}
        for group, settings in self.groups.items():
            if settings.fusion in {"federated", "tracks"} and settings.single_model is None:
                kind, needed = settings.tracker.estimator.kind, "one of ca, cs, ct, cv, jerk, singer"
                problem = f"found {kind}, but fusion: {settings.fusion} is of one motion model, expected {needed}"
                yield ("groups", group, "tracker", "estimator"), problem
            for position, sensor in enumerate(settings.sensors):
                location = ("groups", group, "sensors", position)
                if sensor not in self.sensors:
                    yield location, unknown_name("sensor", sensor, list(self.sensors))
                elif sensor in group_of:
                    yield (
                        location,
                        f"sensor '{sensor}' is in group '{group_of[sensor]}' already; a sensor has one group",
                    )
                group_of.setdefault(sensor, group)
