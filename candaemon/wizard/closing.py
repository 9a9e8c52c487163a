"""When a scan is complete: a counter that its frames share, a message that ends it, a header that counts, a pause."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from candaemon.arrays import Floats, Indices, Integers
from candaemon.dbc.batch_codec import BatchDecoder
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.wizard.frame_checks import steps_of
from candaemon.wizard.object_table import ObjectTable
from candaemon.wizard.traffic import LogTraffic
from candaemon.wizard.vocabulary import role_of


@dataclass(frozen=True, slots=True)
class Closing:
    """How a scan closes.

    Attributes:
        keys: of `scan` in a configuration, in their order.
        why: the evidence.
        guess: whether the log does not prove it.
        timeout: s, between a burst's length and the time to the next.
        burst: s, length of nearly all bursts.
        scans: how many there were.
    """

    keys: dict[str, str]
    why: str
    guess: bool
    timeout: float
    burst: float
    scans: int


@dataclass(frozen=True, slots=True)
class Frames:
    """All frames of a sensor's objects, in the log's order.

    Attributes:
        time: (n,) s.
        order: (n,) place in the log.
        message: (n,) index into `messages`.
        messages: of all parts.
        part: (n,) which part of the layout.
    """

    time: Floats
    order: Indices
    message: Indices
    messages: tuple[MessageSpec, ...]
    part: Indices


def frames_of(table: ObjectTable, traffic: LogTraffic) -> Frames:
    """Return the frames of a table's objects."""
    messages: list[MessageSpec] = []
    times, orders, numbers, parts = [], [], [], []
    for part, each in enumerate(table.layout.parts):
        for message in each.messages:
            stream = traffic.stream(table.channel, message)
            if stream is not None:
                times.append(stream.time)
                orders.append(stream.order)
                numbers.append(np.full(len(stream.time), len(messages), np.intp))
                parts.append(np.full(len(stream.time), part, np.intp))
            messages.append(message)
    order = np.concatenate(orders)
    rows = np.argsort(order)
    return Frames(
        np.concatenate(times)[rows],
        order[rows],
        np.concatenate(numbers)[rows],
        tuple(messages),
        np.concatenate(parts)[rows],
    )


def find_closing(table: ObjectTable, traffic: LogTraffic, others: Iterable[MessageSpec]) -> Closing:
    """Find out how the scans of a sensor close.

    Args:
        table: its objects.
        traffic: the log.
        others: further messages of its DBC, of which one may be a header or a trigger.
    """
    frames = frames_of(table, traffic)
    counter = None if table.layout.listed else _counter(table, traffic, frames)
    if counter is not None:
        name, scan, why = counter
        keys = {"close": "counter", "signal": name}
        return _closing(keys, why, False, frames, scan, table.cycle_time)
    scan = _by_pauses(frames, table)
    header = _header(table, traffic, others, frames)
    if header is not None:
        keys, why, scan = header
        return _closing(keys, why, False, frames, scan, table.cycle_time)
    ends = np.append(np.flatnonzero(np.diff(scan)), len(scan) - 1)
    last = frames.message[ends]
    values, counts = np.unique(last, return_counts=True)
    share = counts.max() / len(last)
    if share > 0.95 and not table.layout.listed:
        name = frames.messages[int(values[counts.argmax()])].name
        why = f"the last frame before the pause in {share:.1%} of the scans"
        return _closing({"close": "trigger", "message": name}, why, bool(share < 0.98), frames, scan, table.cycle_time)
    why = "no counter, header or last message in common: a scan ends with a pause"
    return _closing({"close": "timeout"}, why, True, frames, scan, table.cycle_time)


def _closing(keys: dict[str, str], why: str, guess: bool, frames: Frames, scan: Integers, cycle: float) -> Closing:
    """Return a closing rule with the time-out that fits the bursts."""
    begins = np.flatnonzero(np.diff(scan, prepend=scan[0] - 1))
    ends = np.append(begins[1:] - 1, len(scan) - 1)
    lengths = frames.time[ends] - frames.time[begins]
    burst = float(np.quantile(lengths, 0.99)) if len(lengths) else 0.0
    burst = min(burst, cycle)
    pause = keys["close"] == "timeout"
    timeout = burst + (0.35 if pause else 0.5) * max(0.0, cycle - burst)
    return Closing(keys, why, guess, max(0.002, round(timeout, 3)), burst, len(begins))


def _counter(table: ObjectTable, traffic: LogTraffic, frames: Frames) -> tuple[str, Integers, str] | None:
    """Return the counter that all frames of a scan share: its name, each frame's scan, and the evidence."""
    shared = set.intersection(*(set(part.names) for part in table.layout.parts))
    specs = {name: spec for part in table.layout.parts for name, spec in zip(part.names, part.specs, strict=True)}
    wanted = [
        name for name in shared if specs[name].scale == 1 and not specs[name].is_float and specs[name].length <= 32
    ]
    best: tuple[tuple[int, int], str, Integers, str] | None = None
    scans = len(frames.time) / max(1, len(frames.messages))
    for name in sorted(wanted):
        values = _of_frames(table, traffic, frames, name)
        if values is None:
            continue
        changes = int(np.count_nonzero(np.diff(values)))
        # as often as there are scans: each frame of a scan carries the same
        if not 0.5 * scans <= changes <= 1.5 * scans + 2:
            continue
        first = values[frames.message == frames.message[0]]
        step, share = steps_of(first, specs[name].length)
        if step == 0 or share < 0.8:
            continue
        scan = np.cumsum(np.diff(values, prepend=values[0]) != 0)
        why = f"the same in all frames of a scan, {step:g} more in the next ({share:.1%})"
        merit = (role_of(name)[0] == "counter", -changes)
        if best is None or merit > best[0]:
            best = (merit, name, scan, why)
    return None if best is None else best[1:]


def _of_frames(table: ObjectTable, traffic: LogTraffic, frames: Frames, name: str) -> Floats | None:
    """Return a signal of every object frame, in the log's order."""
    values = np.full(len(frames.time), np.nan)
    number = 0
    decoders: dict[tuple[object, ...], BatchDecoder] = {}
    for part in table.layout.parts:
        row = part.names.index(name)
        for message, sets in zip(part.messages, part.signal_sets, strict=True):
            stream = traffic.stream(table.channel, message)
            if stream is not None:
                spec = message.signal(sets[0][row])
                key = (message.length, spec.start, spec.length, spec.byte_order, spec.multiplexer_signal, spec.name)
                decoder = decoders.setdefault(key, BatchDecoder(message, [spec.name]))
                values[frames.message == number] = decoder.decode(stream.payload)[0]
            number += 1
    return None if np.isnan(values).any() else values


def _by_pauses(frames: Frames, table: ObjectTable) -> Integers:
    """Return the scan of each frame, by the pauses between bursts."""
    gaps = np.diff(frames.time, prepend=frames.time[0])
    scans = max(1, round(float(np.ptp(frames.time)) / table.cycle_time))
    ordered = np.sort(gaps)
    at = max(0, len(ordered) - scans)
    above, below = ordered[at], ordered[max(0, at - 1)]
    limit = max(0.5 * (above + below), 0.05 * table.cycle_time)
    if np.count_nonzero(gaps > limit) < 0.8 * scans:  # the burst goes on nearly all the time
        limit = min(limit, float(np.quantile(gaps, max(0.0, 1 - 1.05 * scans / len(gaps)))))
    return np.cumsum(gaps > limit)


def _header(
    table: ObjectTable, traffic: LogTraffic, others: Iterable[MessageSpec], frames: Frames
) -> tuple[dict[str, str], str, Integers] | None:
    """Return the header message that counts the objects which follow: keys, evidence, and each frame's scan."""
    best: tuple[float, dict[str, str], str, Integers] | None = None
    first_part = frames.order[frames.part == 0]
    mine = {message.can_id for message in frames.messages}
    for message in others:
        stream = None if message.can_id in mine else traffic.stream(table.channel, message)
        if stream is None or len(stream.time) < 5:
            continue
        period = float(np.median(np.diff(stream.time)))
        if not 0.9 < period / _scan_period(table, stream.time) < 1.1:
            continue
        decoded = BatchDecoder(message).decode(stream.payload)
        edges = np.searchsorted(first_part, stream.order)
        following = np.diff(np.append(edges, len(first_part)))
        occupied = _occupied_following(table, stream.order)
        for counting, counted in _counted(message.signals, decoded):
            if len(np.unique(counted)) < 2:
                continue
            sent = float(np.mean(counted[1:-1] == following[1:-1]))
            used = float(np.mean(counted[1:-1] == occupied[1:-1]))
            share = max(sent, used)
            if share > 0.8 and (best is None or share > best[0]):
                count = counting[0] if len(counting) == 1 else f"[{', '.join(counting)}]"
                keys = {"close": "header", "message": message.name, "count": count}
                names = [
                    each.name
                    for row, each in enumerate(message.signals)
                    if each.name not in counting and _counts(decoded[row], each.length)
                ]
                if names:
                    keys["counter"] = names[0]
                every = len(frames.messages) if not table.layout.listed else 0
                if used > sent and every and float(np.mean(following[1:-1] * len(table.layout.parts) == every)) > 0.9:
                    keys["used_only"] = "false"
                what = "objects that follow" if sent >= used else "occupied slots that follow"
                scan = np.searchsorted(stream.order, frames.order)
                why = f"it says how many: {' + '.join(counting)} is the number of {what} in {share:.1%}"
                best = (share, keys, why, scan)
    return None if best is None else best[1:]


def _counted(signals: Sequence[SignalSpec], decoded: Floats) -> Iterator[tuple[tuple[str, ...], Floats]]:
    """Yield what may count objects: each signal of a message, and then each two that add up, by their names."""
    wide = [(each.name, values) for each, values in zip(signals, decoded, strict=True) if each.length >= 2]
    for name, values in wide:
        yield (name,), values
    for (one, its), (other, theirs) in combinations(wide, 2):
        yield (one, other), its + theirs


def _scan_period(table: ObjectTable, times: Floats) -> float:
    """Return the s between scans; of listed objects, which do not come in each, that of the would-be header."""
    return float(np.median(np.diff(times))) if table.layout.listed else table.cycle_time


def _counts(values: Floats, length: int) -> bool:
    step, share = steps_of(values, length)
    return step != 0 and share > 0.9 and length >= 2


def _occupied_following(table: ObjectTable, order: Indices) -> Integers:
    """Return how many objects that are somewhere follow each header."""
    position = next(
        (table.values(name) for name in table.columns if role_of(name)[0] in {"range", "x"}), np.ones(len(table))
    )
    there = np.sort(table.order[np.nan_to_num(position) > 0])
    return np.diff(np.append(np.searchsorted(there, order), len(there)))


def pairs_of(table: ObjectTable) -> tuple[str, ...] | None:
    """Return signals, one a message, that are equal in all frames of an object of one scan and change between scans."""
    parts = len(table.layout.parts)
    if parts < 2:
        return None
    by_part: list[list[str]] = [
        [
            column.name
            for column in table.columns.values()
            if column.part == part and column.spec.length <= 8 and _changes(table, column.values)
        ]
        for part in range(parts)
    ]
    for name in by_part[0]:
        chosen: list[str] = [name]
        for part in range(1, parts):
            match = next((other for other in by_part[part] if _equal(table, name, other)), None)
            if match is not None:
                chosen.append(match)
        if len(chosen) == parts:
            return tuple(chosen)
    return None


def _changes(table: ObjectTable, values: Floats) -> bool:
    """Return whether a signal is another one in nearly each scan."""
    at = np.flatnonzero(table.following)
    return len(at) > 10 and float(np.mean(values[at] != values[at + 1])) > 0.8


def _equal(table: ObjectTable, one: str, other: str) -> bool:
    a, b = table.values(one), table.values(other)
    both = np.isfinite(a) & np.isfinite(b)
    return bool(both.any()) and float(np.mean(a[both] == b[both])) > 0.9
