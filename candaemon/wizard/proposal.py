"""The wizard's way from DBC files and a log to a configuration: find the messages, ask the log, ask the user, write."""

from __future__ import annotations

from collections.abc import Mapping as Table
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.dbc.database import load_database
from candaemon.dbc.types import Database, MessageSpec
from candaemon.errors import ConfigError
from candaemon.wizard.closing import Closing, find_closing, pairs_of
from candaemon.wizard.draft import Ask, Choice, take_guess
from candaemon.wizard.frame_checks import Checksum, find_checksum
from candaemon.wizard.layouts import MOST_LAYOUTS, Layout, find_layouts, find_unnumbered
from candaemon.wizard.mapping import Mapping, has_place, map_by_names, map_signals
from candaemon.wizard.object_table import ObjectTable, object_table
from candaemon.wizard.own_motion import (
    Heard,
    OwnMotion,
    find_own_motion,
    heard_signals,
    named_signals,
    with_gear,
    with_gear_age,
)
from candaemon.wizard.traffic import LogTraffic
from candaemon.wizard.vocabulary import role_of

MOST_FILES: Final = 32
"""DBC files that are read together."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """A radar that was found.

    Attributes:
        name: for the configuration.
        dbc: its file.
        layout: of its objects.
        channel: index of the log's; −1 without a log.
        cycle_time: s between scans.
        mapped: its quantities.
        closing: how its scans close.
        checksum: of its frames, None where none was found.
        pair: signals that must be equal within an object; empty where none need be.
        optional: which of its messages did not come with each object.
        latency: s; None where no log tells it.
    """

    name: str
    dbc: Path
    layout: Layout
    channel: int
    cycle_time: Choice
    mapped: Mapping
    closing: Closing
    checksum: Checksum | None
    pair: tuple[str, ...]
    optional: frozenset[int]
    latency: Choice | None = None


@dataclass(frozen=True, slots=True)
class Proposal:
    """All that a configuration needs.

    Attributes:
        sensors: at least one.
        own: the vehicle's motion; None where nothing tells it.
        databases: of all files given.
        traffic: the log, None without one.
    """

    sensors: tuple[Sensor, ...]
    own: OwnMotion | None
    databases: Table[Path, Database]
    traffic: LogTraffic | None


def propose(dbcs: Sequence[Path], traffic: LogTraffic | None, ask: Ask = take_guess) -> Proposal:
    """Find a configuration for strange DBC files.

    Args:
        dbcs: the files: of the radar, and of the car or an INS.
        traffic: a log of them.
        ask: asks the user about guesses.

    Raises:
        ConfigError: a file cannot be used, none has a radar's messages, or none of them came in the log.
    """
    if len(dbcs) > MOST_FILES:
        raise ConfigError(f"found {len(dbcs)} DBC files, expected {MOST_FILES} at most; leave out those of other buses")
    databases = {path: load_database(path) for path in dict.fromkeys(dbcs)}
    found = [
        (path, layout)
        for path, database in databases.items()
        for layout in find_layouts(list(database.messages.values()))
    ]
    found = (
        found
        or [
            (path, layout)
            for path, database in databases.items()
            for layout in find_unnumbered(list(database.messages.values()))
            if has_place(layout)
        ][:MOST_LAYOUTS]
    )
    if not found:
        counted = ", ".join(f"{path.name}: {len(database.messages):,} messages" for path, database in databases.items())
        raise ConfigError(
            f"no radar found in {counted}; expected messages alike with a running number, or one with the object's "
            "number in a signal, whose signals are called as a place is: range and angle, or distances ahead and "
            "across; write the configuration by hand as docs/adding-a-radar.md shows"
        )
    if traffic is None:
        return _by_names(found, databases, ask)
    return _by_log(found, databases, traffic, ask)


def _by_log(
    found: Sequence[tuple[Path, Layout]], databases: Table[Path, Database], traffic: LogTraffic, ask: Ask
) -> Proposal:
    """Return what a log says."""
    tables = [(path, table) for path, layout in found if (table := object_table(layout, traffic)) is not None]
    if not tables:
        names = ", ".join(sorted({layout.parts[0].messages[0].name for _, layout in found})[:4])
        raise ConfigError(
            f"none of the radar's messages ({names} …) came in the log often enough; expected the radar's own bus "
            f"among the channels {', '.join(traffic.channels)}, and its DBC file",
            file=traffic.log,
        )
    others = _others(databases, [layout for _, layout in found])
    first = [(path, mapped) for path, table in tables if (mapped := map_signals(table, None)) is not None]
    own = find_own_motion(heard_signals(others, traffic), _rates([mapped for _, mapped in first]))
    own = with_gear_age(_asked_own(with_gear(own, others, traffic), ask), others, traffic)
    sensors: list[Sensor] = []
    for path, table in tables:
        mapped = map_signals(table, own)
        if mapped is None:
            continue
        sensors.append(_sensor(_name(sensors, table.layout), path, table, mapped, traffic, databases[path], ask))
    return Proposal(tuple(sensors), own, databases, traffic)


def _others(databases: Table[Path, Database], layouts: Sequence[Layout]) -> list[tuple[Path, MessageSpec]]:
    """Return the messages that are of no radar, with their files."""
    taken = {id(message) for layout in layouts for part in layout.parts for message in part.messages}
    return [
        (path, message)
        for path, database in databases.items()
        for message in database.messages.values()
        if id(message) not in taken
    ]


def _rates(mapped: Sequence[Mapping]) -> tuple[Floats, Floats] | None:
    """Return times and range rates of the first radar's objects."""
    for each in mapped:
        key = next((key for key in ("range_rate", "vx") if key in each.columns), None)
        if key is not None:
            held = each.held.occupied
            return each.table.time[held], (each.table.values(each.columns[key]) * each.factors[key])[held]
    return None


def _name(before: Sequence[Sensor], layout: Layout) -> str:
    """Return a sensor's name."""
    if not before:
        return "front"
    name = layout.name[:40]
    return name if name not in {each.name for each in before} else f"{name}_{len(before) + 1}"


def _sensor(
    name: str, path: Path, table: ObjectTable, mapped: Mapping, traffic: LogTraffic, database: Database, ask: Ask
) -> Sensor:
    """Return a sensor with its scans and frames told."""
    closing = find_closing(table, traffic, database.messages.values())
    checksum = next(
        (each for part in table.layout.parts[:1] if (each := find_checksum(part, traffic, table.channel)) is not None),
        None,
    )
    if checksum is not None and any(
        (other := find_checksum(part, traffic, table.channel)) is None
        or (other.signal, other.kind) != (checksum.signal, checksum.kind)
        for part in table.layout.parts[1:]
    ):
        checksum = None
    pair = () if closing.keys["close"] == "counter" else pairs_of(table) or ()
    cycle = Choice(f"{table.cycle_time:.4g}", f"s, {1 / table.cycle_time:.3g} scans a second")
    mapped.choices = {key: ask(f"{name}.signals.{key}", choice) for key, choice in mapped.choices.items()}
    return Sensor(
        name, path, table.layout, table.channel, cycle, mapped, closing, checksum, pair, _optional(table, mapped)
    )


def _optional(table: ObjectTable, mapped: Mapping) -> frozenset[int]:
    """Return which messages need not come: no condition and no measured quantity is in them."""
    needed = {test.signal for test in (*mapped.valid, *mapped.new)}
    needed |= {
        mapped.columns[key] for key in mapped.columns if key not in {"width", "length", "score", "ax", "heading"}
    }
    if mapped.identity is not None:
        needed.add(mapped.identity.value)
    parts = {table.columns[name].part for name in needed if name in table.columns}
    return frozenset(range(1, len(table.layout.parts))) - parts


def _asked_own(own: OwnMotion | None, ask: Ask) -> OwnMotion | None:
    if own is None:
        return None
    return replace(own, signals={key: ask(f"ego.signals.{key}", choice) for key, choice in own.signals.items()})


def _by_names(found: Sequence[tuple[Path, Layout]], databases: Table[Path, Database], ask: Ask) -> Proposal:
    """Return what names alone suggest."""
    others = _others(databases, [layout for _, layout in found])
    heard: list[Heard] = named_signals(others)
    own = with_gear(find_own_motion(heard, None), others, None)
    if own is not None:
        signals = {key: replace(choice, why=_named(choice), guess=True) for key, choice in own.signals.items()}
        own = _asked_own(replace(own, signals=signals), ask)
    sensors: list[Sensor] = []
    for path, layout in found:
        mapped, name = map_by_names(layout), _name(sensors, layout)
        mapped.choices = {key: ask(f"{name}.signals.{key}", choice) for key, choice in mapped.choices.items()}
        told = layout.parts[0].messages[0].cycle_time
        cycle = Choice(f"{told or 0.05:.4g}", "s, by the DBC" if told else "s between scans", guess=told is None)
        closing = _closing_by_names(layout, databases[path], float(cycle.value))
        sensors.append(Sensor(name, path, layout, -1, cycle, mapped, closing, None, (), frozenset()))
    return Proposal(tuple(sensors), own, databases, None)


def _named(choice: Choice) -> str:
    """Return what speaks for a signal of own motion without a log: its name, and what is to be said of its unit."""
    return choice.why if choice.why.startswith("by name") else f"by name; {choice.why}" if choice.why else "by name"


def _closing_by_names(layout: Layout, database: Database, cycle: float) -> Closing:
    """Return the closing rule that names suggest."""
    timeout = max(0.002, round(0.7 * cycle, 3))
    shared = set.intersection(*(set(part.names) for part in layout.parts))
    counters = [name for name in layout.parts[0].names if name in shared and role_of(name)[0] == "counter"]
    if counters and not layout.listed:
        return Closing({"close": "counter", "signal": counters[0]}, "by name", True, timeout, timeout, 0)
    if layout.listed:
        for message in database.messages.values():
            for signal in message.signals:
                if role_of(signal.name)[0] in {"identity", "counter"} and "of" in signal.name.lower():
                    keys = {"close": "header", "message": message.name, "count": signal.name}
                    return Closing(keys, "by name", True, timeout, timeout, 0)
        return Closing({"close": "timeout"}, "nothing else suggests itself", True, timeout, timeout, 0)
    last = max((message for part in layout.parts for message in part.messages), key=lambda message: message.can_id)
    keys = {"close": "trigger", "message": last.name}
    return Closing(keys, "the last identifier, if it comes last", True, timeout, timeout, 0)


def guesses(proposal: Proposal) -> int:
    """Count the quantities that are guesses."""
    choices = [choice for sensor in proposal.sensors for choice in sensor.mapped.choices.values()]
    choices += [] if proposal.own is None else list(proposal.own.signals.values())
    return int(np.sum([choice.guess for choice in choices]))
