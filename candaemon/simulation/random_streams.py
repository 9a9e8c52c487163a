"""Random numbers: one stream for each sensor and purpose, so that a change to one does not affect the others."""

from __future__ import annotations

from typing import Literal

import numpy as np

Purpose = Literal[
    "cycle", "detection", "noise", "drift", "clutter", "slots", "frames", "loss", "own_motion",
    "reflections", "errors", "ghosts", "swaps", "faults", "failing", "clock",
]  # fmt: skip
_PURPOSES: tuple[Purpose, ...] = (
    "cycle", "detection", "noise", "drift", "clutter", "slots", "frames", "loss", "own_motion",
    "reflections", "errors", "ghosts", "swaps", "faults", "failing", "clock",
)  # fmt: skip


def stream(seed: int, source: int, purpose: Purpose) -> np.random.Generator:
    """Return the generator of one purpose.

    Args:
        seed: of the whole simulation, ≥ 0.
        source: index of the sensor, or the number of sensors for the ego.
        purpose: what it is used for.

    """
    sequence = np.random.SeedSequence(seed, spawn_key=(source, _PURPOSES.index(purpose)))
    return np.random.Generator(np.random.PCG64(sequence))
