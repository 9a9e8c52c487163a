"""A proposal as a commented YAML file: the evidence stands beside each line, and guesses are marked."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from candaemon.can_io.logs.stream import NO_CHANNEL
from candaemon.config.names import interface_problem, is_log_channel
from candaemon.dbc.types import MessageSpec
from candaemon.printable import printable
from candaemon.wizard.draft import GUESS, Choice
from candaemon.wizard.occupancy import Test
from candaemon.wizard.own_motion import FALSE_RANGE, outside_share
from candaemon.wizard.proposal import Proposal, Sensor

LONGEST_WHY: Final = 300
"""Characters of a comment."""
_PLAIN: Final = re.compile(r"-?[A-Za-z_][A-Za-z0-9_.]*|-?\d+(\.\d+)?([eE][-+]?\d+)?|[\[{].*[\]}]", re.DOTALL)
_MESSAGE_OF: Final = re.compile(r"([A-Za-z_]\w*)\.")
"""The messages in a reference to signals, as a configuration has it."""
_FILTERED: Final = 3.2
"""Times the scatter from scan to scan: the noise of distances ahead that a radar has filtered itself.

Across, the tracker learns how they walk, and it takes such a radar's speeds for noisier by itself.
"""


class Lines:
    """The lines of a YAML file under way."""

    def __init__(self) -> None:
        self._lines: list[str] = []

    def add(self, depth: int, text: str, why: str = "", *, guess: bool = False) -> None:
        """Add a line with its evidence."""
        comment = printable(" ".join(why.split()), LONGEST_WHY)
        mark = f" # {GUESS if guess else ''}{comment}" if comment or guess else ""
        self._lines.append(f"{'  ' * depth}{text}{mark}")

    def choice(self, depth: int, key: str, choice: Choice) -> None:
        """Add a key with what was found for it."""
        self.add(depth, f"{key}: {quoted(choice.value)}", choice.why, guess=choice.guess)

    def text(self) -> str:
        """Return the file."""
        return "\n".join(self._lines) + "\n"


def quoted(value: str) -> str:
    """Return a value as YAML: as it is where nothing in it means something else there."""
    if _PLAIN.fullmatch(value) and value.lower() not in {
        "y",
        "n",
        "yes",
        "no",
        "on",
        "off",
        "true",
        "false",
        "null",
        "~",
    }:
        return value
    return _in_quotes(value)


def _in_quotes(text: str) -> str:
    """Return a text as YAML takes it for nothing else, such as the number that a channel is called by."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def draft_text(proposal: Proposal, path_of: Callable[[Path], str], noise_factor: float = 1.0, nis: str = "") -> str:
    """Return the YAML of a proposal.

    Args:
        proposal: what was found.
        path_of: a DBC file's path as the YAML is to have it.
        noise_factor: on all standard deviations.
        nis: evidence for that factor.
    """
    lines = Lines()
    log = "" if proposal.traffic is None else f" and {printable(proposal.traffic.log.name)}"
    files = ", ".join(printable(path.name) for path in proposal.databases)
    lines.add(0, f"# candaemon init made this of {files}{log}. What a line was found by stands beside it;")
    lines.add(
        0, f"# '# {GUESS.strip()}' marks what nothing proves, and `candaemon check` repeats that until it is removed."
    )
    lines.add(0, f"name: {quoted(proposal.sensors[0].layout.name[:60])}")
    names = _buses(lines, proposal, path_of)
    _ego(lines, proposal, names, path_of)
    lines.add(0, "sensors:")
    for sensor in proposal.sensors:
        _sensor(lines, sensor, names[sensor.channel], path_of, noise_factor, nis)
    return lines.text()


def relative_path(folder: Path) -> Callable[[Path], str]:
    """Return what tells a file's path as a YAML in a folder has it."""

    def told(path: Path) -> str:
        relative = os.path.relpath(path.resolve(), folder.resolve())
        return str(path.resolve()) if relative.count("..") > 4 else relative

    return told


def _buses(lines: Lines, proposal: Proposal, path_of: Callable[[Path], str]) -> dict[int, str]:
    """Add the buses; return their names by channel."""
    lines.add(0, "buses:")
    traffic, own = proposal.traffic, proposal.own
    channels = list(dict.fromkeys(sensor.channel for sensor in proposal.sensors))
    names = {channel: "radar" if k == 0 else f"radar_{k + 1}" for k, channel in enumerate(channels)}
    if own is not None and own.kind != "static":
        if traffic is None:
            names[-2] = "ins" if own.kind == "ins" else "car"
        elif own.channel in names:
            names[own.channel] = "car"
        else:
            names[own.channel] = "ins" if own.kind == "ins" else "car"
    for number, (channel, name) in enumerate(names.items()):
        if traffic is None:
            long = any(message.is_fd for message in _read_messages(proposal, channel))
            keys = [f"channel: can{number}", *(["fd: true"] if long else [])]
            lines.add(1, f"{name}: {{{', '.join(keys)}}}", "no log was given", guess=True)
            continue
        told, log_channel = _channel(traffic.channels[channel], number)
        used = {sensor.dbc for sensor in proposal.sensors if sensor.channel == channel}
        used |= {own.dbc} if own is not None and own.dbc is not None and own.channel == channel else set()
        further = [
            quoted(path_of(path))
            for path, database in proposal.databases.items()
            if path not in used and traffic.channel_of(tuple(database.messages.values())) == channel
        ]
        keys = [f"channel: {quoted(told)}"]
        keys += [f"log_channel: {_in_quotes(log_channel)}"] if log_channel else []
        keys += [f"dbc: [{', '.join(further)}]"] if further else []
        long = any(message.is_fd for message in _read_messages(proposal, channel))
        long |= any(s.fd for (c, _), s in traffic.streams.items() if c == channel)
        keys += ["fd: true"] if long else []
        lines.add(
            1, f"{name}: {{{', '.join(keys)}}}", f"its messages came on the log's channel {traffic.channels[channel]}"
        )
    return names


def _read_messages(proposal: Proposal, channel: int) -> Iterator[MessageSpec]:
    """Yield the messages that are read of a channel: objects, what closes scans, and own motion."""
    for sensor in proposal.sensors:
        if sensor.channel != channel:
            continue
        for part in sensor.layout.parts:
            yield from part.messages
        closes = proposal.databases[sensor.dbc].messages.get(sensor.closing.keys.get("message", ""))
        yield from () if closes is None else (closes,)
    own = proposal.own
    if own is None or own.dbc is None or channel != (-2 if proposal.traffic is None else own.channel):
        return
    named = {name for choice in own.signals.values() for name in _MESSAGE_OF.findall(choice.value)}
    for name, message in proposal.databases[own.dbc].messages.items():
        if name in named:
            yield message


def _channel(name: str, number: int) -> tuple[str, str]:
    """Return an interface for a log's channel, and the name in logs where that is another one."""
    if name.isdigit():
        return f"can{name}", name
    if name == NO_CHANNEL:
        return f"can{number}", name
    if not interface_problem(name) and is_log_channel(name):
        return name, ""
    return f"can{number}", ""


def _ego(lines: Lines, proposal: Proposal, names: dict[int, str], path_of: Callable[[Path], str]) -> None:
    own = proposal.own
    if own is None or own.dbc is None:
        files = ", ".join(printable(path.name) for path in proposal.databases)
        why = f"no signals of own motion found in {files}: give the DBC file of the car or INS, or write ego by hand"
        lines.add(0, "ego: {kind: static}", why, guess=True)
        return
    lines.add(0, "ego:")
    lines.add(1, f"kind: {own.kind}")
    lines.add(1, f"bus: {names[own.channel if proposal.traffic is not None else -2]}")
    lines.add(1, f"dbc: {quoted(path_of(own.dbc))}")
    lines.add(1, "signals:")
    for key, choice in own.signals.items():
        lines.choice(2, key, choice)
    for key, choice in own.extra.items():
        lines.choice(1, key, choice)
    if "latitude" in own.signals:
        lines.add(1, "gnss: {}", "latitude and longitude place the obstacles on earth")


def _sensor(
    lines: Lines, sensor: Sensor, bus: str, path_of: Callable[[Path], str], noise_factor: float, nis: str
) -> None:
    mapped, closing, layout = sensor.mapped, sensor.closing, sensor.layout
    for note in mapped.notes:
        lines.add(1, f"# {printable(note, LONGEST_WHY)}")
    left_out = layout.left_out
    lines.add(1, f"{sensor.name}:", left_out or layout.why, guess=bool(left_out))
    lines.add(2, f"bus: {bus}")
    lines.add(2, f"dbc: {quoted(path_of(sensor.dbc))}")
    lines.add(2, "mount: {x: 3.6}", "the front bumper of most cars, from the rear axle; measure it", guess=True)
    lines.choice(2, "cycle_time", sensor.cycle_time)
    if sensor.latency is not None:
        lines.choice(2, "latency", sensor.latency)
    scans = f"99 % of the scans took {closing.burst * 1e3:.1f} ms or less" if closing.scans else "s, 0.7 of the cycle"
    lines.add(2, f"timeout: {closing.timeout:g}", scans, guess=not closing.scans)
    _objects(lines, sensor)
    scan = ", ".join(f"{key}: {value if key == 'used_only' else quoted(value)}" for key, value in closing.keys.items())
    lines.add(2, f"scan: {{{scan}}}", closing.why, guess=bool(closing.guess))
    lines.add(2, "signals:")
    for key, choice in mapped.choices.items():
        lines.choice(3, key, choice)
    if mapped.over_ground:
        key = "range_rates" if "range_rate" in mapped.choices else "rates"
        lines.add(2, f"{key}: absolute", mapped.over_ground, guess=not len(mapped.table))
    _noise(lines, sensor, noise_factor, nis)
    far, wide = mapped.seen
    if mapped.looks is not None:
        signal, views = mapped.looks
        lines.add(2, "looks:", f"what is seen is seen again {mapped.apart} scans later; each value sees otherwise")
        lines.add(3, f"signal: {quoted(signal)}")
        lines.add(3, "fields_of_view:", "how far the log's objects reach in each")
        for value, (reach, opening) in views.items():
            lines.add(4, f"{value}: {{range: {max(reach, 20):.0f}, azimuth_deg: {min(max(opening, 5), 180):.0f}}}")
    elif far:
        view = f"{{range: {min(max(far, 20), 1000):.0f}, azimuth_deg: {min(max(wide, 5), 180):.0f}}}"
        lines.add(2, f"field_of_view: {view}", "how far the log's objects reach")
    else:
        lines.add(2, "field_of_view: {range: 150, azimuth_deg: 45}", "by habit: no log", guess=True)
    column = max(
        (mapped.table.columns[name] for name in mapped.columns.values() if name in mapped.table.columns),
        key=lambda column: outside_share(column.spec, column.values[mapped.held.occupied]),
        default=None,
    )
    if column is not None and (share := outside_share(column.spec, column.values[mapped.held.occupied])) > FALSE_RANGE:
        lines.add(2, "plausibility: {ranges: false}", f"{share:.0%} of {column.name} are outside the DBC's range")
    if sensor.checksum is not None:
        fits = f"fits {sensor.checksum.share:.1%} of {sensor.checksum.frames:,} frames"
        keys = f"checksum: {quoted(sensor.checksum.signal)}, kind: {sensor.checksum.kind}"
        lines.add(2, f"protection: {{{keys}}}", fits)


def _objects(lines: Lines, sensor: Sensor) -> None:
    mapped, layout = sensor.mapped, sensor.layout
    lines.add(2, "objects:")
    lines.add(3, "messages:")
    for number, part in enumerate(layout.parts):
        keys = [f"message: {quoted(part.template)}"]
        keys += [f"id_signal: {quoted(part.id_name)}"] if part.id_name is not None else []
        keys += ["id_signal: false"] if layout.unnumbered else []
        keys += ["optional: true"] if number in sensor.optional else []
        lines.add(4, f"- {{{', '.join(keys)}}}")
    if layout.unnumbered:
        told = "half as many again as any scan of the log has, or more" if len(mapped.table) else "no log: plenty"
        lines.add(3, f"slots: {layout.slots}", told, guess=True)
    else:
        lines.add(3, f"slots: {layout.slots}")
    if layout.points:
        lines.add(3, f"points: [{', '.join(map(str, layout.points))}]", "objects in one message")
    if layout.first:
        lines.add(3, f"first: {layout.first}")
    if layout.step != 1:
        lines.add(3, f"step: {layout.step}")
    if layout.unnumbered:
        lines.add(3, "identity: false", "the order in which they come is no identity")
    elif mapped.identity is not None:
        name = mapped.identity.value
        lines.add(3, f"identity: {name if name == 'false' else quoted(name)}", mapped.identity.why)
    elif layout.listed and layout.parts[0].id_name in layout.parts[0].names:
        lines.add(3, f"identity: {quoted(layout.parts[0].id_name)}", "the number in each frame")
    if sensor.pair:
        lines.add(
            3,
            f"pair: [{', '.join(map(quoted, sensor.pair))}]",
            "equal in the messages of one scan, another in the next",
        )
    _tests(lines, "valid", mapped.valid)
    if not (layout.unnumbered or (mapped.identity is not None and mapped.identity.value == "false")):
        _tests(lines, "new", mapped.new)  # no slot keeps an object else, so that none is new in it
    if not mapped.valid and not layout.listed:
        why = "no log: nothing tells empty slots from objects"
        if len(mapped.table):
            why = "nothing in the log tells empty slots from objects"
        lines.add(3, "valid: []", why, guess=True)


def _tests(lines: Lines, key: str, tests: tuple[Test, ...]) -> None:
    if tests:
        lines.add(3, f"{key}:")
    for test in tests:
        lines.add(4, f"- {{signal: {quoted(test.signal)}, {test.bound}}}", test.why, guess=test.guess)


def _noise(lines: Lines, sensor: Sensor, factor: float, nis: str) -> None:
    filters = f"it filters by itself, {sensor.mapped.own_filter}" if sensor.mapped.own_filter else ""
    lines.add(2, "noise:", "; ".join(filter(None, [nis, filters])))
    for key, choice in sensor.mapped.noise.items():
        scale = factor * (_FILTERED if filters and key in {"x", "range"} else 1.0)
        why = f"{choice.why}: {choice.value}, times {scale:.2g}" if scale != 1.0 else choice.why
        lines.add(3, f"{key}: {float(choice.value) * scale:.3g}", why, guess=choice.guess)
