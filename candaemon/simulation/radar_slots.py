"""Slots as real radars hand them out: kept while an object is seen, reused without warning."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

_MARGIN = 5.0
"""How much more urgent (in m) a new object must be to push another out of its slot."""


@dataclass(frozen=True, slots=True)
class RadarSlotAssignment:
    """Slots after one scan.

    Attributes:
        slot: of each object seen, −1 where none was left, in the order given.
        new: whether it took that slot in this scan, in the order given.
        missed: slots kept by objects that are there but were not seen in this scan.

    """

    slot: list[int]
    new: list[bool]
    missed: list[int]


@dataclass(slots=True)
class _Holder:
    """What holds a slot."""

    slot: int
    urgency: float
    misses: int = 0


class RadarSlots:
    """Which object holds which slot.

    Args:
        capacity: slots there are.
        hold: scans an object that is there but not seen keeps its slot.
        reuse: probability that a new object takes a slot that became free in the same scan, if there is one;
            otherwise it takes the lowest slot that was free before.
        random: generator for that choice.

    """

    def __init__(self, capacity: int, *, hold: int, reuse: float, random: np.random.Generator) -> None:
        self._hold = hold
        self._reuse = reuse
        self._random = random
        self._free = list(range(capacity))
        self._holders: dict[int, _Holder] = {}

    def assign(self, keys: Sequence[int], urgency: Sequence[float], there: Collection[int]) -> RadarSlotAssignment:
        """Hand out slots for one scan.

        Args:
            keys: identity of each object seen.
            urgency: of each object seen, the lowest first (m; a distance, more for what matters less).
            there: identities of the objects that could be seen, whether they were or not; others give up their slot.

        """
        seen = set(keys)
        freed, missed = self._release(seen, there)
        for key, urgent in zip(keys, urgency, strict=True):
            holder = self._holders.get(key)
            if holder is not None:
                holder.urgency, holder.misses = urgent, 0
        fresh = [k for k in np.argsort(np.asarray(urgency), kind="stable").tolist() if keys[k] not in self._holders]
        taken: set[int] = set()
        for k in fresh:
            if not self._admit(keys[k], urgency[k], freed):
                break  # the others are less urgent still
            taken.add(keys[k])
        self._free = sorted(self._free + freed)
        holders = [self._holders.get(key) for key in keys]
        held = {holder.slot for holder in holders if holder is not None}
        return RadarSlotAssignment(
            [-1 if holder is None else holder.slot for holder in holders],
            [key in taken and holder is not None for key, holder in zip(keys, holders, strict=True)],
            [slot for slot in missed if slot not in held],
        )

    def _release(self, seen: set[int], there: Collection[int]) -> tuple[list[int], list[int]]:
        """Free the slots of what left or was missed too long; return those slots, and those kept through a miss."""
        freed: list[int] = []
        missed: list[int] = []
        for key in [key for key in self._holders if key not in seen]:
            holder = self._holders[key]
            holder.misses += 1
            if key in there and holder.misses <= self._hold:
                missed.append(holder.slot)
            else:
                freed.append(holder.slot)
                del self._holders[key]
        return freed, missed

    def _admit(self, key: int, urgency: float, freed: list[int]) -> bool:
        """Give a new object a slot, if need be that of a less urgent one; tell whether it got one."""
        if freed and (not self._free or self._random.random() < self._reuse):
            slot = freed.pop(0)
        elif self._free:
            slot = self._free.pop(0)
        else:
            last = max(self._holders, key=lambda held: self._holders[held].urgency)
            if self._holders[last].urgency <= urgency + _MARGIN:
                return False
            slot = self._holders.pop(last).slot
        self._holders[key] = _Holder(slot, urgency)
        return True
