"""Endless traffic for a configuration: a recorded or simulated drive again and again, and payloads of pure chance."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from candaemon.binding.bound import Binding
from candaemon.can_io.logs.candump import ChunkDecoder, candump_text, read_candump_blocks
from candaemon.can_io.logs.stream import ChannelMap, LogCounts
from candaemon.frames.frame import Frame
from candaemon.frames.frame_block import FrameBlock, joined_blocks
from candaemon.protection.checksums import FrameProtector
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate

from .mutations import mutated, sealed

BLOCK = 4000
"""Frames that are mutated together."""
_SCENARIO = Path(__file__).resolve().parents[2] / "config/scenarios/highway.yaml"
_SIMULATED_S = 10.0
_START_NS = 1_700_000_000_000_000_000
_LISTED = 16
_NOISY = 0.2  # share of blocks
_SOUND = 0.3  # share of blocks that go through as they are
_SEALED = 0.6  # share of mutated blocks whose checksums hold


class Traffic:
    """Frames for a configuration, in blocks; the same from the same seed.

    Args:
        binding: of the configuration.
        seed: of chance.
        drive: a candump log that is mutated; None: a simulated drive is, and some blocks are random payloads.
    """

    def __init__(self, binding: Binding, seed: int, drive: Path | None = None) -> None:
        self._rng = np.random.default_rng(seed)
        self._drive = _simulated(binding) if drive is None else _recorded(binding, drive)
        self._noisy = _NOISY if drive is None else 0.0
        self._at = 0
        kinds = kinds_of(binding)
        self._kinds = np.array(kinds, np.int64)
        self._lengths = {(kind.bus, kind.can_id): kind.length for kind in kinds}
        self._protectors = protectors_of(binding)
        cycle_time = min(sensor.settings.cycle_time for sensor in binding.sensors)
        self._spacing_ns = cycle_time * 1e9 / len(self._kinds)
        self._now_ns = _START_NS

    def frames(self, count: int) -> Iterator[Frame]:
        """Yield so many frames; ticks, frames of a negative bus, are among them."""
        while count > 0:
            block = self._block()
            if self._rng.random() >= _SOUND:
                block = mutated(block, self._rng)
                if self._rng.random() < _SEALED:
                    block = sealed(block, self._protectors, self._lengths)
            block = block.rows(np.arange(min(count, len(block))))
            count -= len(block)
            if len(block):
                self._now_ns = int(block.time_ns[-1])
            yield from block.frames()

    def _block(self) -> FrameBlock:
        """Return frames as they are sent, from the present time on."""
        block = self._noise() if self._rng.random() < self._noisy else self._part()
        block.time_ns[:] += self._now_ns - block.time_ns[0] + 100_000
        return block

    def _part(self) -> FrameBlock:
        """Return what follows in the drive, which begins again at its end."""
        if self._at >= len(self._drive):
            self._at = 0
        rows = np.arange(self._at, min(self._at + BLOCK, len(self._drive)))
        self._at += BLOCK
        return self._drive.rows(rows)

    def _noise(self) -> FrameBlock:
        """Return scans of random payloads: of one scan they differ in some bytes only, so that it has many objects."""
        rng, kinds = self._rng, self._kinds
        rounds = BLOCK // len(kinds) + 1
        order = rng.permuted(np.tile(np.arange(len(kinds)), (rounds, 1)), axis=1)
        order[rng.random(rounds) < 0.5] = np.arange(len(kinds))
        rows = order.ravel()
        count = len(rows)
        width = 8 if kinds[:, 2].max() <= 8 else 64
        base = np.repeat(rng.integers(0, 256, (rounds, width), np.uint8), len(kinds), axis=0)
        other = rng.integers(0, 256, base.shape, np.uint8)
        payload = np.where(rng.random(base.shape) < 10 ** rng.uniform(-2, -0.3), other, base)
        gaps = rng.choice([0.0, 0.5, 1.0, 1.0, 1.0, 2.5], count) * self._spacing_ns
        length = kinds[rows, 2].astype(np.uint8)
        payload[np.arange(width) >= length[:, None]] = 0
        return FrameBlock(
            time_ns=np.cumsum(gaps).astype(np.int64),
            bus=kinds[rows, 0].astype(np.int16),
            can_id=kinds[rows, 1].astype(np.uint32),
            length=length,
            fd=length > 8,
            payload=payload,
        )


class Kind(NamedTuple):
    """A message that a configuration takes: its bus, CAN id and length in bytes."""

    bus: int
    can_id: int
    length: int


def kinds_of(binding: Binding) -> list[Kind]:
    """Return the messages that a configuration takes; one that lists objects is there many times."""
    listed = {
        message.can_id
        for sensor in binding.sensors
        if sensor.reader.multiplexed
        for part in sensor.reader.layouts
        for message in part.messages
    }
    return [
        Kind(bus.index, can_id, message.length)
        for bus in binding.buses
        for database in bus.databases
        for can_id, message in sorted(database.by_id.items())
        if can_id in bus.can_ids
        for _ in range(_LISTED if can_id in listed else 1)
    ]


def protectors_of(binding: Binding) -> dict[tuple[int, int], FrameProtector]:
    """Return what seals the frames of sensors, by bus and CAN id."""
    return {
        (sensor.bus, message.can_id): protector
        for sensor in binding.sensors
        for part, protector in zip(sensor.reader.layouts, sensor.protectors, strict=True)
        for message in part.messages
        if protector is not None
    }


def _simulated(binding: Binding) -> FrameBlock:
    """Return the frames of a simulated drive."""
    scenario = load_scenario(_SCENARIO).model_copy(update={"duration": _SIMULATED_S})
    names = [bus.name for bus in binding.buses]
    text = candump_text(simulate(scenario, binding).frames(), names)
    channels = ChannelMap({name: bus.index for bus, name in zip(binding.buses, names, strict=True)})
    return ChunkDecoder(text, channels, LogCounts()).decode()


def _recorded(binding: Binding, drive: Path) -> FrameBlock:
    """Return a candump log's frames of the configured buses, in order of time."""
    channels = ChannelMap({name: bus.index for bus in binding.buses for name in bus.settings.names_in_logs})
    counts = LogCounts()
    block = joined_blocks(list(read_candump_blocks(drive, channels, counts)))
    counts.require_frames(drive)
    return block.rows(np.argsort(block.time_ns, kind="stable"))
