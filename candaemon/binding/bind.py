"""Settings × DBC: every name checked, every signal resolved."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from candaemon.binding.bind_ego import BoundEgo, bind_ego
from candaemon.binding.bind_protection import guard_plan, part_guards
from candaemon.binding.bound import Binding, BoundBus, BoundOutput, BoundSensor, quantities_of
from candaemon.binding.bus_load import Traffic, bus_load
from candaemon.binding.conflicts import check_identifiers, range_warnings
from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.config.base import SignalRef
from candaemon.config.ego import StaticSettings
from candaemon.config.load import LoadedConfig
from candaemon.config.output import OutputSettings
from candaemon.config.sensors import CounterScan, HeaderScan, SensorSettings, TriggerScan
from candaemon.dbc.database import load_database
from candaemon.dbc.types import Database, MessageSpec
from candaemon.errors import ConfigError
from candaemon.frames.frame import EXTENDED
from candaemon.objects.layout import find_message, find_signal
from candaemon.objects.reader import ObjectReader
from candaemon.objects.scan_messages import ScanHeader, StatusWriter
from candaemon.objects.signals import field_reader
from candaemon.objects.writer import ObjectWriter
from candaemon.protection.monitor import GuardPlan

FULL = 0.6
"""Share of a bus's time from which `check` warns."""
DEFAULT_CYCLE_TIME = 0.02
"""s, of a message whose cycle time the DBC does not give, for the bus load."""
CLASSIC_LENGTH = 8
"""Greatest payload of a classic CAN frame, bytes."""


def bind(loaded: LoadedConfig) -> Binding:
    """Bind a configuration to its DBC files.

    Raises:
        ConfigError: naming every problem, each with the YAML's (or the DBC's) file and line.

    """
    return _Binder(loaded).bind()


@dataclass(slots=True)
class _Binder:
    """Collects what is bound, and what is wrong, on the way through the configuration."""

    loaded: LoadedConfig
    databases: dict[Path, Database] = field(default_factory=dict)
    errors: list[ConfigError] = field(default_factory=list)
    failed: set[Path] = field(default_factory=set)
    warnings: list[str] = field(default_factory=list)

    def bind(self) -> Binding:
        config = self.loaded.config
        sensors: list[BoundSensor] = []
        ego: BoundEgo | None = None
        output: BoundOutput | None = None
        if not isinstance(config.ego, StaticSettings):
            with collected(self.errors):
                database = self.database(config.ego.dbc, ("ego",))
                if database is not None:
                    ego = bind_ego(config.ego, self.bus(config.ego.bus), database, self.where("ego"))
        for index, (name, settings) in enumerate(config.sensors.items()):
            with collected(self.errors):
                database = self.database(settings.dbc, ("sensors", name))
                if database is not None:
                    sensors.append(self.sensor(index, name, settings, database))
        if config.output is not None:
            with collected(self.errors):
                database = self.database(config.output.dbc, ("output",))
                if database is not None:
                    output = self.output(config.output, database)
        for name, bus in config.buses.items():
            for relative in bus.dbc:
                with collected(self.errors):
                    self.database(relative, ("buses", name))
        self.errors += check_identifiers(self.where(), ego, sensors, output, self.on_output_bus())
        self.errors += self.long_frames(ego, sensors, output)
        raise_all(self.errors)
        buses = tuple(self.buses(ego, sensors, output))
        warnings = (
            *(str(diagnostic) for database in self.databases.values() for diagnostic in database.warnings),
            *self.warnings,
            *range_warnings(ego, sensors, output),
            *_load_warnings(buses),
        )
        databases = {str(path): database for path, database in self.databases.items()}
        return Binding(self.loaded, buses, tuple(sensors), ego, output, databases, warnings)

    def on_output_bus(self) -> list[Database]:
        """List the DBC files that the output's bus itself names, those left out that could not be loaded."""
        config = self.loaded.config
        named = [] if config.output is None else config.buses[config.output.bus].dbc
        found = (self.databases.get(self.loaded.resolve(relative)) for relative in named)
        return [database for database in found if database is not None]

    def where(self, *location: str | int) -> SettingLocation:
        return SettingLocation(self.loaded, location)

    def bus(self, name: str) -> int:
        return list(self.loaded.config.buses).index(name)

    def database(self, relative: str, location: tuple[str, ...]) -> Database | None:
        """Load a DBC once; None where it failed before, which is told once."""
        path = self.loaded.resolve(relative)
        if path in self.failed:
            return None
        if path not in self.databases:
            self.failed.add(path)
            if not path.is_file():
                raise self.where(*location, "dbc").error(
                    f"no DBC file '{relative}'; expected it at {path}, as paths start from the YAML's folder"
                )
            self.databases[path] = load_database(path)
            self.failed.discard(path)
        return self.databases[path]

    def sensor(self, index: int, name: str, settings: SensorSettings, database: Database) -> BoundSensor:
        where = self.where("sensors", name)
        reader = ObjectReader(settings.objects, quantities_of(settings.signals), database, where=where)
        scan, place = settings.scan, where.at("scan")
        marked = place.at("protection")
        can_ids = set(reader.routes)
        counters: list[Callable[[bytes], int]] = []
        trigger: MessageSpec | None = None
        header: ScanHeader | None = None
        mark_guard: GuardPlan | None = None
        if isinstance(scan, CounterScan):
            counters = [
                field_reader(part.layout, find_signal(part.layout, scan.signal, place.at("signal")))
                for part in reader.parts
            ]
        elif isinstance(scan, TriggerScan):
            trigger = find_message(database, scan.message, place.at("message"))
            can_ids.add(trigger.can_id)
            if trigger.can_id not in reader.routes:
                mark_guard = guard_plan([trigger], scan.protection, marked, cycle_time=settings.cycle_time)
        elif isinstance(scan, HeaderScan):
            header = ScanHeader(scan, database, place)
            can_ids.add(header.can_id)
            mark_guard = guard_plan([header.message], scan.protection, marked, cycle_time=settings.cycle_time)
        guards = part_guards(reader, settings, where)
        bus = self.bus(settings.bus)
        bound = BoundSensor(
            index,
            name,
            settings,
            bus,
            database,
            reader,
            frozenset(can_ids),
            tuple(counters),
            trigger,
            header,
            guards,
            mark_guard,
        )
        try:
            bound.writer(where)
        except ConfigError as error:
            self.warnings.append(f"{error}; reading does without, simulating sensor '{name}' does not")
        return bound

    def output(self, settings: OutputSettings, database: Database) -> BoundOutput:
        where = self.where("output")
        signals: dict[str, SignalRef | tuple[SignalRef, ...]] = {str(q): refs for q, refs in settings.signals.items()}
        writer = ObjectWriter(settings.objects, signals, database, settings.protection, where=where)
        status = None
        if settings.status is not None:
            place = where.at("status")
            status = StatusWriter(settings.status, database, settings.protection, place, index=writer.data_ids)
        messages = [message for part in writer.parts for message in part.messages]
        if status is not None:
            messages.append(status.message)
        can_ids = frozenset(message.can_id for message in messages)
        fd_ids = frozenset(message.can_id for message in messages if is_fd(message))
        return BoundOutput(settings, self.bus(settings.bus), database, writer, status, can_ids, fd_ids)

    def long_frames(
        self, ego: BoundEgo | None, sensors: Iterable[BoundSensor], output: BoundOutput | None
    ) -> Iterator[ConfigError]:
        """Yield an error for each part of the configuration whose frames its bus cannot carry."""
        used: list[tuple[tuple[str, ...], int, Iterable[int], Database]] = [
            (("sensors", sensor.name, "bus"), sensor.bus, sensor.can_ids, sensor.database) for sensor in sensors
        ]
        if ego is not None:
            used.append((("ego", "bus"), ego.bus, ego.messages, ego.database))
        if output is not None:
            used.append((("output", "bus"), output.bus, output.can_ids, output.database))
        for location, bus, can_ids, database in used:
            name, settings = list(self.loaded.config.buses.items())[bus]
            long = next((database.by_id[i] for i in sorted(can_ids) if is_fd(database.by_id[i])), None)
            if long is not None and not settings.fd:
                yield self.where(*location).error(
                    f"message '{long.name}' of {long.length} bytes is a CAN FD frame but bus '{name}' is classic; "
                    "give the bus fd: true"
                )

    def buses(
        self, ego: BoundEgo | None, sensors: Iterable[BoundSensor], output: BoundOutput | None
    ) -> Iterator[BoundBus]:
        """Yield the buses with their identifiers and loads."""
        sensors = list(sensors)
        for index, (name, settings) in enumerate(self.loaded.config.buses.items()):
            here = [sensor for sensor in sensors if sensor.bus == index]
            traffic = [
                _traffic(sensor.database.by_id[can_id], _frames_a_scan(sensor, can_id) / sensor.settings.cycle_time)
                for sensor in here
                for can_id in sensor.can_ids
            ]
            taken = {can_id for sensor in here for can_id in sensor.can_ids}
            if ego is not None and ego.bus == index:
                taken |= set(ego.messages)
                traffic += [
                    _traffic(each.message, 1 / (each.message.cycle_time or DEFAULT_CYCLE_TIME))
                    for each in ego.messages.values()
                ]
            sent: list[Traffic] = []
            if output is not None and output.bus == index:
                rate = sum(1 / sensor.settings.cycle_time for sensor in sensors)  # a cycle is told a scan
                slots = output.writer.slots
                sent = [_traffic(part.layout, rate * slots) for part in output.writer.parts] + (
                    [] if output.status is None else [_traffic(output.status.message, rate)]
                )
            load, output_load = (bus_load(each, settings.bitrate, settings.data_bitrate) for each in (traffic, sent))
            on_it = [self.databases[self.loaded.resolve(relative)] for relative in settings.dbc]
            on_it += [ego.database] if ego is not None and ego.bus == index else []
            on_it += [sensor.database for sensor in here]
            rate = sum(each.rate for each in traffic)
            yield BoundBus(index, name, settings, frozenset(taken), rate, load, output_load, tuple(on_it))


def is_fd(message: MessageSpec) -> bool:
    """Tell whether a message is a CAN FD frame; files often lack the attribute, but not the length."""
    return message.is_fd or message.length > CLASSIC_LENGTH


def _frames_a_scan(sensor: BoundSensor, can_id: int) -> int:
    """Count the frames of one identifier in a full scan."""
    return sensor.reader.slots if sensor.reader.multiplexed and can_id in sensor.reader.routes else 1


def _traffic(message: MessageSpec, rate: float) -> Traffic:
    return Traffic(rate, message.length, bool(message.can_id & EXTENDED), is_fd(message))


def _load_warnings(buses: Iterable[BoundBus]) -> Iterator[str]:
    """Yield a warning for each bus that our output fills."""
    for bus in buses:
        total = bus.load + bus.output_load
        if bus.output_load and total > FULL:
            yield (
                f"bus '{bus.name}': with every slot occupied the output adds {bus.output_load:.0%} to "
                f"{bus.load:.0%} of {bus.settings.bitrate / 1000:g} kbit/s; use fewer slots or messages, CAN FD, "
                "or a bus of its own"
            )
