"""What buses, cables and clocks do to frames, on blocks of them: each kind at a share drawn anew for every block."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from candaemon.frames.frame_block import FrameBlock
from candaemon.protection.checksums import FrameProtector

Mutation: TypeAlias = Callable[[FrameBlock, np.random.Generator, float], FrameBlock]
"""Block, source of chance, share of frames that it befalls → block."""

_SHARES = (-3.5, -0.7)  # powers of ten
_JUMPS_NS = np.array([0.04, -0.04, 0.3, -0.5, 3, -3, 30, -3600, 86_400]) * 1e9
_TICK = -1


def mutated(block: FrameBlock, rng: np.random.Generator) -> FrameBlock:
    """Return a block after some of what can befall it; a third of the mutations at a time."""
    for mutate in MUTATIONS:
        if rng.random() < 1 / 3:
            block = mutate(block, rng, 10 ** rng.uniform(*_SHARES))
    return block


def sealed(
    block: FrameBlock, protectors: Mapping[tuple[int, int], FrameProtector], lengths: Mapping[tuple[int, int], int]
) -> FrameBlock:
    """Return a block whose checksums hold, so that what it tells is used.

    Args:
        block: any frames.
        protectors: by bus and CAN id.
        lengths: of these messages, bytes.
    """
    for row, key in enumerate(zip(block.bus.tolist(), block.can_id.tolist(), strict=True)):
        if key in protectors and block.length[row] == lengths[key]:
            data = block.payload[row, : lengths[key]].tobytes()
            block.payload[row, : lengths[key]] = np.frombuffer(protectors[key].seal(key[1], data), np.uint8)
    return block


def _chosen(block: FrameBlock, rng: np.random.Generator, share: float) -> NDArray[np.intp]:
    return np.flatnonzero(rng.random(len(block)) < share)


def _flip_bits(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    rows = _chosen(block, rng, share)
    block.payload[rows, rng.integers(0, 8, len(rows))] ^= np.uint8(1) << rng.integers(0, 8, len(rows)).astype(np.uint8)
    return block


def _garble(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    rows = _chosen(block, rng, share)
    block.payload[rows] = rng.integers(0, 256, (len(rows), block.payload.shape[1]), np.uint8)
    return block


def _fill(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    """Make payloads of nothing but zeros or ones: what a radar sends that has no value."""
    block.payload[_chosen(block, rng, share)] = rng.choice(np.array([0, 255], np.uint8))
    return block


def _truncate(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    rows = _chosen(block, rng, share)
    block.length[rows] = rng.integers(0, block.length[rows] + 1)
    return block


def _swap_ids(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    rows = _chosen(block, rng, share)
    block.can_id[rows] = block.can_id[rng.integers(0, len(block), len(rows))]
    return block


def _swap_buses(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    rows = _chosen(block, rng, share)
    block.bus[rows] = block.bus[rng.integers(0, len(block), len(rows))]
    return block


def _stray(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    """Send from identifiers that no DBC knows."""
    rows = _chosen(block, rng, share)
    block.can_id[rows] = rng.integers(0, 1 << 32, len(rows), np.uint32)
    return block


def _tick(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    """Let frames only tell how late it is."""
    block.bus[_chosen(block, rng, share)] = _TICK
    return block


def _drop(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    return block.rows(np.flatnonzero(rng.random(len(block)) >= share))


def _repeat(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    rows = np.arange(len(block))
    return block.rows(np.repeat(rows, np.where(rng.random(len(block)) < share, rng.integers(2, 20), 1)))


def _reorder(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    """Let some frames come later than their time."""
    late = np.where(rng.random(len(block)) < share, rng.integers(1, 60, len(block)), 0)
    return block.rows(np.argsort(np.arange(len(block)) + late, kind="stable"))


def _jump(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    """Set the clock, rarely."""
    rows = _chosen(block, rng, share * 0.02)
    for row in rows.tolist():
        block.time_ns[row:] += int(rng.choice(_JUMPS_NS))
    return block


def _stand_still(block: FrameBlock, rng: np.random.Generator, share: float) -> FrameBlock:
    """Give frames the time stamp of the one before, as a USB adapter does."""
    rows = np.arange(len(block))
    rows[_chosen(block, rng, share)] = 0
    block.time_ns[:] = block.time_ns[np.maximum.accumulate(rows)]
    return block


MUTATIONS: tuple[Mutation, ...] = (
    _flip_bits,
    _garble,
    _fill,
    _truncate,
    _swap_ids,
    _swap_buses,
    _stray,
    _tick,
    _drop,
    _repeat,
    _reorder,
    _jump,
    _stand_still,
)
