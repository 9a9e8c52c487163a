"""All objects that a radar sent in a log as one table: a row an object of a scan, a column a signal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.dbc.batch_codec import BatchDecoder
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.wizard.families import MOST_SLOTS
from candaemon.wizard.layouts import Layout, Part
from candaemon.wizard.traffic import LogTraffic

FEWEST_ROWS: Final = 50
"""Objects of a log, below which it says nothing of a radar."""
_USUAL_GAPS: Final = 0.99
"""Share of the gaps between frames that are no interruption of the recording."""
FEWEST_LISTED: Final = 3
"""Frames in a burst, that one burst at least has if a message is a list."""


@dataclass(frozen=True, slots=True)
class ObjectColumn:
    """A signal of the objects.

    Attributes:
        name: as a configuration writes it.
        spec: what the DBC says of it, of the first slot.
        part: index of the message that it is in.
        values: (n,) in the DBC's unit; NaN where no frame carried it.
    """

    name: str
    spec: SignalSpec
    part: int
    values: Floats


@dataclass(frozen=True, slots=True)
class ObjectTable:
    """The objects of a log, n of them, by slot and then by time.

    Attributes:
        layout: of the messages.
        channel: index of the log's channel.
        time: (n,) s since the log's first frame.
        slot: (n,) number of the slot, from 0 on.
        order: (n,) place of the frame in the log.
        columns: by name.
        cycle_time: s between two objects of a slot.
        following: (n,) whether the next row is of the same slot and the next scan.
    """

    layout: Layout
    channel: int
    time: Floats
    slot: Indices
    order: Indices
    columns: dict[str, ObjectColumn]
    cycle_time: float
    following: Booleans = field(init=False)

    def __post_init__(self) -> None:
        step = np.diff(self.time, append=np.inf)
        same = np.diff(self.slot, append=-1) == 0
        object.__setattr__(self, "following", same & (step > 0) & (step < 1.6 * self.cycle_time))

    def __len__(self) -> int:
        return len(self.time)

    def rows(self, rows: Indices, slot: Indices, scans: int = 1) -> ObjectTable:
        """Return some of its rows, with other numbers for their slots, so many scans apart."""
        columns = {name: replace(column, values=column.values[rows]) for name, column in self.columns.items()}
        return ObjectTable(
            self.layout, self.channel, self.time[rows], slot, self.order[rows], columns, self.cycle_time * scans
        )

    def values(self, name: str) -> Floats:
        """Return a column's values."""
        return self.columns[name].values


def object_table(layout: Layout, traffic: LogTraffic) -> ObjectTable | None:
    """Return the objects that came in a log; None where there are too few."""
    channel = traffic.channel_of(layout.parts[0].messages)
    if channel is None:
        return None
    gathered = [_gathered(part, traffic, channel) for part in layout.parts]
    first = gathered[0]
    if first is None or len(first.time) < FEWEST_ROWS:
        return None
    if layout.unnumbered:
        first = _ranked(first)
        most = int(first.slot.max()) + 1
        if most < FEWEST_LISTED:
            return None
        layout = replace(layout, slots=min(MOST_SLOTS, 2 ** math.ceil(math.log2(1.5 * most))))
    cycle_time = _cycle_time(first)
    if not np.isfinite(cycle_time):
        return None
    columns = {name: ObjectColumn(name, spec, 0, values) for name, spec, values in first.columns}
    for number, other in enumerate(gathered[1:], 1):
        if other is None:
            continue
        rows, near = _nearest(first, other, 0.5 * cycle_time)
        for name, spec, values in other.columns:
            columns.setdefault(name, ObjectColumn(name, spec, number, np.where(near, values[rows], np.nan)))
    return ObjectTable(layout, channel, first.time, first.slot, first.order, columns, cycle_time)


@dataclass(frozen=True, slots=True)
class _Gathered:
    """The objects in the frames of one message, by slot and then by time."""

    time: Floats
    slot: Indices
    order: Indices
    columns: Sequence[tuple[str, SignalSpec, Floats]]


def _gathered(part: Part, traffic: LogTraffic, channel: int) -> _Gathered | None:
    """Return the objects of one part of a layout."""
    times, slots, orders, values = [], [], [], []
    for time, order, slot, decoded in _decoded(part, traffic, channel):
        times.append(time)
        orders.append(order)
        slots.append(slot)
        values.append(decoded)
    if not times:
        return None
    time, slot, order = np.concatenate(times), np.concatenate(slots), np.concatenate(orders)
    table = np.concatenate(values, axis=1)
    rows = np.lexsort((order, slot))
    columns = [(name, spec, table[k, rows]) for k, (name, spec) in enumerate(zip(part.names, part.specs, strict=True))]
    return _Gathered(time[rows], slot[rows], order[rows], columns)


def _ranked(objects: _Gathered) -> _Gathered:
    """Return the objects of a list without numbers, by their place in its scan: bursts of frames, with pauses between.

    Pauses and the gaps within bursts are the two groups of gaps between which most of the variance lies (Otsu 1979, "A
    threshold selection method from gray-level histograms").
    """
    rows = np.argsort(objects.order, kind="stable")
    gaps = np.diff(objects.time[rows])
    gaps = np.minimum(gaps, np.quantile(gaps, _USUAL_GAPS))
    ordered = np.sort(gaps)
    below = np.arange(1, len(ordered))
    sums = np.cumsum(ordered)[:-1]
    between = (sums * len(ordered) - below * ordered.sum()) ** 2 / (below * (len(ordered) - below.astype(float)))
    limit = ordered[int(between.argmax())]
    begins = np.concatenate([[True], gaps > limit])
    place = np.arange(len(rows))
    rank = place - np.maximum.accumulate(np.where(begins, place, 0))
    rows, rank = rows[np.lexsort((place, rank))], np.sort(rank, kind="stable")
    columns = [(name, spec, values[rows]) for name, spec, values in objects.columns]
    return _Gathered(objects.time[rows], rank, objects.order[rows], columns)


def _decoded(part: Part, traffic: LogTraffic, channel: int) -> Iterator[tuple[Floats, Indices, Indices, Floats]]:
    """Yield times, places in the log, slots and values (signals, n) of a part, message by message."""
    decoders: dict[int, BatchDecoder] = {}
    for number, (message, sets) in enumerate(zip(part.messages, part.signal_sets, strict=True)):
        stream = traffic.stream(channel, message)
        if stream is None:
            continue
        for point, names in enumerate(sets):
            decoder = decoders.setdefault(_shape(message, names), BatchDecoder(message, names))
            decoded = decoder.decode(stream.payload)
            if part.id_name is not None and part.id_name in part.names:
                slot = np.nan_to_num(decoded[part.names.index(part.id_name)]).astype(np.intp)
            else:
                slot = np.full(len(stream.time), number * len(sets) + point, np.intp)
            carried = ~np.isnan(decoded).all(axis=0)
            yield stream.time[carried], stream.order[carried], slot[carried], decoded[:, carried]


def _shape(message: MessageSpec, names: Sequence[str]) -> int:
    """Return a key that only signals with the same bits share."""
    specs = message.select(names)
    return hash(
        (
            message.length,
            tuple((s.start, s.length, s.byte_order, s.signed, s.is_float, s.scale, s.offset) for s in specs),
        )
        if all(s.multiplexer_signal is None for s in specs)
        else (message.can_id, tuple(names))
    )


def _cycle_time(objects: _Gathered) -> float:
    """Return the s between two objects of a slot."""
    step, same = np.diff(objects.time), np.diff(objects.slot) == 0
    steps = step[same & (step > 1e-4)]
    return float(np.median(steps)) if len(steps) else float("inf")


def _nearest(first: _Gathered, other: _Gathered, within: float) -> tuple[Indices, Booleans]:
    """Return for each object the row of the other message of its slot nearest in time, and whether it is near."""
    stride = max(float(first.time[-1:].max(initial=0)), float(first.time.max()), float(other.time.max())) + 10.0
    wanted, have = first.slot * stride + first.time, other.slot * stride + other.time
    at = np.searchsorted(have, wanted)
    before, after = np.clip(at - 1, 0, len(have) - 1), np.clip(at, 0, len(have) - 1)
    rows = np.where(np.abs(have[after] - wanted) <= np.abs(have[before] - wanted), after, before)
    return rows, np.abs(have[rows] - wanted) <= within
