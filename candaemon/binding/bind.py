"""A configuration bound to its DBC files: every name checked, every signal resolved, before a bus is opened."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from candaemon.binding.bind_ego import assumed_speeds, bind_ego
from candaemon.binding.bind_output import bind_output
from candaemon.binding.bind_sensor import bind_sensor, bind_sensor_writer
from candaemon.binding.bound import Binding, BoundBus, BoundEgo, BoundOutput, BoundSensor
from candaemon.binding.bus_load import Traffic, bus_load
from candaemon.binding.conflicts import (
    check_identifiers,
    misplaced_error,
    misplaced_identifiers,
    multiplexed_warnings,
    range_warnings,
)
from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.binding.oddities import oddities
from candaemon.config.ego import StaticSettings
from candaemon.config.load import LoadedConfig
from candaemon.config.sensors import SensorSettings
from candaemon.config.settings import Config
from candaemon.config.shipped import shared_folder
from candaemon.dbc.database_cache import load_cached
from candaemon.dbc.types import Database, MessageSpec
from candaemon.errors import ConfigError, DatabaseError
from candaemon.files.entry_cache import cache_folder
from candaemon.frames.frame import EXTENDED

FULL: Final = 0.65
"""Share of a bus's time from which `check` warns."""
DEFAULT_CYCLE_TIME: Final = 0.02
"""s, of a message whose cycle time the DBC does not give, for the bus load."""


def bind(loaded: LoadedConfig) -> Binding:
    """Bind a configuration to its DBC files.

    Raises:
        ConfigError: naming every problem, each with the YAML's (or the DBC's) file and line.

    """
    config, location = loaded.config, SettingLocation(loaded)
    databases = _Databases(loaded)
    errors: list[ConfigError] = []
    bus_index = {name: index for index, name in enumerate(config.buses)}

    # Each part of the configuration is bound to its own DBC; what is wrong in it does not hide what is wrong in others.
    ego: BoundEgo | None = None
    if not isinstance(config.ego, StaticSettings):
        with collected(errors):
            database = databases.load(config.ego.dbc, location.at("ego"))
            if database is not None:
                ego = bind_ego(config.ego, bus_index[config.ego.bus], database, location.at("ego"))
    sensors: list[BoundSensor] = []
    for index, (name, sensor) in enumerate(config.sensors.items()):
        place = location.at("sensors", name)
        with collected(errors):
            database = databases.load(sensor.dbc, place)
            if database is not None:
                sensors.append(_bind_shifted(sensor, index, name, bus_index[sensor.bus], database, place))
    output: BoundOutput | None = None
    if config.output is not None:
        with collected(errors):
            database = databases.load(config.output.dbc, location.at("output"))
            if database is not None:
                output = bind_output(config.output, bus_index[config.output.bus], database, location.at("output"))
    for name, bus in config.buses.items():
        for relative in bus.dbc:
            with collected(errors):
                databases.load(relative, location.at("buses", name))

    # The parts together: two owners of one identifier, frames that their bus cannot carry.
    on_output_bus = [] if config.output is None else databases.loaded_of(config.buses[config.output.bus].dbc)
    errors += check_identifiers(location, ego, sensors, output, on_output_bus)
    errors += _long_frames(location, loaded, ego, sensors, output)
    raise_all(errors)

    # What can be used, but looks wrong.
    buses = tuple(_buses(loaded, databases, ego, sensors, output))
    warnings = (
        *(str(diagnostic) for database in databases.by_path.values() for diagnostic in database.warnings),
        *_unwritable(location, sensors),
        *range_warnings(ego, sensors, output),
        *multiplexed_warnings(sensors),
        *([] if ego is None else assumed_speeds(ego, location.at("ego"))),
        *_load_warnings(buses),
        *oddities(location, buses, ego, sensors, output),
    )
    by_path = {str(path): database for path, database in databases.by_path.items()}
    return Binding(loaded, buses, tuple(sensors), ego, output, by_path, warnings)


def _bind_shifted(
    settings: SensorSettings, index: int, name: str, bus: int, database: Database, location: SettingLocation
) -> BoundSensor:
    """Bind a sensor to its DBC with the identifiers of its `id_offset`; the arguments are `bind_sensor`'s.

    Which of them it needs, the DBC as it is tells: nothing is made of an identifier that cannot be.

    Raises:
        ConfigError: as for `bind_sensor`, and one of the sensor's messages would have no identifier any more.
    """
    misplaced = misplaced_identifiers(database.by_id, settings.id_offset)
    if misplaced:
        needed = bind_sensor(settings, index, name, bus, database, location).can_ids
        wrong = next((can_id for can_id in misplaced if can_id in needed), None)
        if wrong is not None:
            raise misplaced_error(database.by_id[wrong], settings.id_offset, location.at("id_offset"))
    return bind_sensor(settings, index, name, bus, database.shifted(settings.id_offset), location)


@dataclass(slots=True)
class _Databases:
    """The configuration's DBC files, each loaded once.

    Attributes:
        loaded: the configuration.
        by_path: those loaded, in the order of their first use.
        failed: paths of those that could not be loaded.

    """

    loaded: LoadedConfig
    by_path: dict[Path, Database] = field(default_factory=dict)
    failed: set[Path] = field(default_factory=set)

    def load(self, relative: str, location: SettingLocation) -> Database | None:
        """Load a DBC; None where that has failed before, which is reported once.

        Args:
            relative: the file as the YAML names it.
            location: place of the settings that name it as their `dbc`.

        Raises:
            ConfigError: there is no such file, or it cannot be used.

        """
        path = self.loaded.resolve(relative)
        if path in self.failed:
            return None
        if path not in self.by_path:
            self.failed.add(path)
            try:
                self.by_path[path] = load_cached(path, self.loaded.read, cache_folder("dbc"))
            except DatabaseError as error:
                if not isinstance(error.__cause__, FileNotFoundError):
                    raise
                ours = shared_folder() / "dbc" / path.name
                hint = f"; the one that comes with candaemon is {ours}" if ours.is_file() else ""
                raise location.at("dbc").error(
                    f"no DBC file '{relative}'; expected it at {path}, as paths start from the YAML's folder{hint}"
                ) from None
            self.failed.discard(path)
        return self.by_path[path]

    def loaded_of(self, relatives: Iterable[str]) -> list[Database]:
        """Return those of some files that could be loaded."""
        found = (self.by_path.get(self.loaded.resolve(relative)) for relative in relatives)
        return [database for database in found if database is not None]


def _long_frames(
    location: SettingLocation,
    loaded: LoadedConfig,
    ego: BoundEgo | None,
    sensors: Iterable[BoundSensor],
    output: BoundOutput | None,
) -> Iterator[ConfigError]:
    """Yield an error for each part of the configuration whose frames its bus cannot carry."""
    used: list[tuple[SettingLocation, int, Iterable[int], Database]] = [
        (location.at("sensors", sensor.name, "bus"), sensor.bus, sensor.can_ids, sensor.database) for sensor in sensors
    ]
    if ego is not None:
        used.append((location.at("ego", "bus"), ego.bus, ego.messages, ego.database))
    if output is not None:
        used.append((location.at("output", "bus"), output.bus, output.can_ids, output.database))
    for place, bus, can_ids, database in used:
        name, settings = list(loaded.config.buses.items())[bus]
        long = next((database.by_id[i] for i in sorted(can_ids) if database.by_id[i].is_fd), None)
        if long is not None and not settings.fd:
            yield place.error(
                f"message '{long.name}' of {long.length} bytes is a CAN FD frame but bus '{name}' is classic; "
                "give the bus fd: true"
            )


def _buses(
    loaded: LoadedConfig,
    databases: _Databases,
    ego: BoundEgo | None,
    sensors: Iterable[BoundSensor],
    output: BoundOutput | None,
) -> Iterator[BoundBus]:
    """Yield the buses with their identifiers and loads."""
    sensors = list(sensors)
    for index, (name, settings) in enumerate(loaded.config.buses.items()):
        here = [sensor for sensor in sensors if sensor.bus == index]
        traffic = [
            _traffic(sensor.database.by_id[can_id], _frames_a_scan(sensor, can_id) / sensor.settings.cycle_time)
            for sensor in here
            for can_id in sensor.can_ids
        ]
        read = {can_id for sensor in here for can_id in sensor.can_ids}
        if ego is not None and ego.bus == index:
            read |= set(ego.messages)
            traffic += [
                _traffic(each.message, 1 / (each.message.cycle_time or DEFAULT_CYCLE_TIME))
                for each in ego.messages.values()
            ]
        sent: list[Traffic] = []
        if output is not None and output.bus == index:
            rate = _output_rate(loaded.config)
            slots = output.writer.places
            sent = [_traffic(layout.shortest, rate * slots) for layout in output.writer.layouts] + (
                [] if output.status is None else [_traffic(output.status.message, rate)]
            )
        load, output_load = (bus_load(each, settings.bitrate, settings.data_bitrate) for each in (traffic, sent))
        on_it = databases.loaded_of(settings.dbc)
        on_it += [ego.database] if ego is not None and ego.bus == index else []
        on_it += [sensor.database for sensor in here]
        rate = sum(each.rate for each in traffic)
        yield BoundBus(index, name, settings, frozenset(read), rate, load, output_load, tuple(on_it))


def _output_rate(config: Config) -> float:
    """Return how often obstacles are sent: after every scan, or every so often but never without one, 1/s."""
    scans = sum(1 / sensor.cycle_time for sensor in config.sensors.values())
    return min(scans, 1 / config.output_cycle_time) if config.output_cycle_time else scans


def _frames_a_scan(sensor: BoundSensor, can_id: int) -> int:
    """Count the frames of one identifier in a full scan."""
    if can_id not in sensor.reader.routes:
        return 1
    pages = sensor.settings.objects.pages
    return sensor.reader.places if sensor.reader.multiplexed else 1 if pages is None else pages.count


def _traffic(message: MessageSpec, rate: float) -> Traffic:
    return Traffic(rate, message.length, bool(message.can_id & EXTENDED), message.is_fd)


def _unwritable(location: SettingLocation, sensors: Iterable[BoundSensor]) -> Iterator[str]:
    """Yield a warning for each sensor whose frames can be read but not simulated."""
    for sensor in sensors:
        try:
            bind_sensor_writer(sensor, location.at("sensors", sensor.name))
        except ConfigError as error:
            yield f"{error}; reading does without, simulating sensor '{sensor.name}' does not"


def _load_warnings(buses: Iterable[BoundBus]) -> Iterator[str]:
    """Yield a warning for each bus that our output fills."""
    for bus in buses:
        total = bus.load + bus.output_load
        if bus.output_load and total > FULL:
            yield (
                f"bus '{bus.name}': with every slot occupied the output adds {bus.output_load:.0%} to "
                f"{bus.load:.0%} of {bus.settings.bitrate / 1000:g} kbit/s; use fewer slots or messages, a "
                "longer output.cycle_time, CAN FD, or a bus of its own"
            )
