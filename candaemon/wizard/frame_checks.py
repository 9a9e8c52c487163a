"""Which signals are counters and checksums, found in the bytes themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, get_args

import numpy as np

from candaemon.arrays import Floats
from candaemon.dbc.bits import first_bit
from candaemon.dbc.types import SignalSpec
from candaemon.errors import ConfigError
from candaemon.protection.checksums import Kind, Protector
from candaemon.wizard.layouts import Part
from candaemon.wizard.traffic import LogTraffic

_TRIED: Final = 400
"""Frames of a message on which a kind of checksum is tried."""
_ALMOST: Final = 0.99


@dataclass(frozen=True, slots=True)
class Checksum:
    """A checksum that a log's frames carry.

    Attributes:
        signal: its name.
        kind: how it is made.
        frames: how many were tried.
        share: of them that it fits.
    """

    signal: str
    kind: Kind
    frames: int
    share: float


def find_checksum(part: Part, traffic: LogTraffic, channel: int) -> Checksum | None:
    """Find the checksum of the frames of one part of a layout, by trying each kind on each byte; None if none fits."""
    sets = {names for message_sets in part.signal_sets for names in message_sets}
    if part.names not in sets:
        return None  # a name in each slot: the settings of protection name one for all
    candidates = [spec for spec in part.specs if _may_be_checksum(spec)]
    for spec in candidates:
        for kind in get_args(Kind):
            found = _fits(part, traffic, channel, spec, kind)
            if found is not None:
                return found
    return None


def _may_be_checksum(spec: SignalSpec) -> bool:
    return spec.length in {4, 8} and first_bit(spec) % spec.length == 0 and spec.scale == 1 and spec.offset == 0


def _fits(part: Part, traffic: LogTraffic, channel: int, spec: SignalSpec, kind: Kind) -> Checksum | None:
    """Return a kind of checksum if nearly all frames carry it in a signal."""
    if (kind == "honda") != (spec.length == 4):
        return None
    try:
        protector = Protector(kind, part.messages, spec.name)
    except ConfigError:
        return None  # of some slot it is no byte of its own
    tried = right = 0
    values: set[int] = set()
    for message in part.messages[:8]:
        stream = traffic.stream(channel, message)
        if stream is None:
            continue
        for data in map(bytes, stream.payload[:_TRIED]):
            right += protector.verify(message.can_id, data)
            values.add(protector.checksum(message.can_id, data))
            tried += 1
        if tried >= 20 and right < 0.9 * tried:
            return None
    if not tried or right < _ALMOST * tried or len(values) < 4:
        return None
    return Checksum(spec.name, kind, tried, right / tried)


def steps_of(values: Floats, length: int) -> tuple[int, float]:
    """Return by how much a counter of so many bits goes on from one frame to the next, and the share that does."""
    steps = np.diff(values).astype(np.int64) % (1 << min(length, 32))
    if not len(steps):
        return 0, 0.0
    found, counts = np.unique(steps, return_counts=True)
    best = int(counts.argmax())
    return int(found[best]), float(counts[best] / len(steps))
