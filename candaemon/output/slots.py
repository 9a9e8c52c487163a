"""Slots of the output: an obstacle keeps its slot, and a freed one rests for a cycle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Final

OFF_PATH: Final = 1e6
"""Added to the distance (m) of an obstacle outside the vehicle's path: it comes after all those inside."""
MARGIN: Final = 5.0
"""m by which an obstacle must be more urgent to push another out of its slot, so that two do not take turns."""


@dataclass(frozen=True, slots=True)
class Assignment:
    """Slots of one cycle.

    Attributes:
        slot: of each obstacle, −1 where it has none, in the order given.
        new: whether it has the slot since this cycle, in the order given.
        freed: slots that were held in the cycle before and are empty in this one.
    """

    slot: list[int]
    new: list[bool]
    freed: list[int]


class SlotTable:
    """Which obstacle holds which slot.

    An obstacle keeps its slot while it lives. A slot that becomes free is given away in the next cycle at the earliest,
    so that whoever listens sees it empty in between. Where slots run short, an obstacle in the path takes that of the
    least urgent one, a cycle later for the same reason.

    Args:
        capacity: number of slots.
    """

    def __init__(self, capacity: int) -> None:
        self._free = list(range(capacity))
        self._holder: dict[int, int] = {}

    def assign(self, ids: Sequence[int], urgency: Sequence[float]) -> Assignment:
        """Hand out the slots of one cycle.

        Args:
            ids: identities of the obstacles, each once.
            urgency: distance of each, m, `OFF_PATH` more outside the path; the lowest first.
        """
        holder = self._holder
        urgent = dict(zip(ids, urgency, strict=True))
        freed = [holder.pop(gone) for gone in [each for each in holder if each not in urgent]]
        waiting = sorted((each for each in ids if each not in holder), key=urgent.__getitem__)
        served = waiting[: len(self._free)]
        for each in served:
            holder[each] = heappop(self._free)
        # Slots freed just before are for the first of those that wait; only the others need an eviction.
        for each in waiting[len(served) + len(freed) :]:
            if not self._make_room(urgent[each], urgent, freed):
                break
        for slot in freed:
            heappush(self._free, slot)
        fresh = set(served)
        return Assignment([holder.get(each, -1) for each in ids], [each in fresh for each in ids], freed)

    def _make_room(self, urgency: float, urgent: dict[int, float], freed: list[int]) -> bool:
        """Free the least urgent slot for an obstacle in the path; tell whether one is less urgent enough."""
        if urgency >= OFF_PATH or not self._holder:
            return False
        last = max(self._holder, key=urgent.__getitem__)
        if urgent[last] <= urgency + MARGIN:
            return False
        freed.append(self._holder.pop(last))
        return True
