"""Slots of the output: an obstacle keeps its slot, and a freed one rests for a cycle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices, Integers

OFF_PATH: Final = 1e6
"""Added to the distance (m) of an obstacle outside the vehicle's path: it comes after all those inside."""
MARGIN: Final = 5.0
"""m by which an obstacle must be more urgent to push another out of its slot, so that two do not take turns."""


@dataclass(frozen=True, slots=True)
class SlotAssignment:
    """Slots of one cycle.

    Attributes:
        slot: of each obstacle, −1 where it has none, in the order given.
        new: whether it has the slot since this cycle, in the order given.
        freed: slots that were held in the cycle before and are empty in this one.
    """

    slot: list[int]
    new: list[bool]
    freed: list[int]


class OutputSlots:
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

    def assign(self, ids: Sequence[int], urgency: Sequence[float]) -> SlotAssignment:
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
        return SlotAssignment([holder.get(each, -1) for each in ids], [each in fresh for each in ids], freed)

    def _make_room(self, urgency: float, urgent: dict[int, float], freed: list[int]) -> bool:
        """Free the least urgent slot for an obstacle in the path; tell whether one is less urgent enough."""
        if urgency >= OFF_PATH or not self._holder:
            return False
        last = max(self._holder, key=urgent.__getitem__)
        if urgent[last] <= urgency + MARGIN:
            return False
        freed.append(self._holder.pop(last))
        return True


@dataclass(frozen=True, slots=True)
class SlotColumns:
    """Slots of one cycle; k are held, m are sent.

    Attributes:
        order: (k,) places of the holders among the obstacles given, in order of slot.
        sent: (m,) slots to send, ascending.
        occupied: (m,) whether the slot is held.
        new: (m,) whether its holder has it since this cycle.
        lasting: whether the same obstacles, given again, are seated alike: none came, left or waits.
    """

    order: Indices
    sent: Integers
    occupied: Booleans
    new: Booleans
    lasting: bool


class SlotEncoding:
    """SlotColumns the obstacles, cycle by cycle; where the same ones come again, at the cost of a comparison.

    Args:
        capacity: number of slots.
        send_all: every slot is sent, not only the occupied ones.
        send_freed: a freed slot is sent once as empty.
    """

    def __init__(self, capacity: int, *, send_all: bool, send_freed: bool) -> None:
        self._table = OutputSlots(capacity)
        self._every_slot = np.arange(capacity)
        self._send_all, self._send_freed = send_all, send_freed
        self._seats: SlotColumns | None = None
        self._ids = b""

    def seats(self, ids: Integers, urgency: Callable[[], Floats]) -> SlotColumns:
        """Hand out the slots of one cycle.

        Args:
            ids: (n,) identities of the obstacles, each once.
            urgency: gives (n,) what `OutputSlots.assign` takes; asked only where somebody came or waits.
        """
        key = ids.tobytes()
        seats = self._seats
        if seats is None or not seats.lasting or key != self._ids:
            self._seats = seats = self._seated(ids, urgency())
            self._ids = key
        return seats

    def _seated(self, ids: Integers, urgency: Floats) -> SlotColumns:
        assigned = self._table.assign(ids.tolist(), urgency.tolist())
        slots = np.array(assigned.slot, np.int64)
        order = np.argsort(slots)[np.count_nonzero(slots < 0) :]
        held = slots[order]
        sent = self._sent(held, assigned.freed)
        occupied = np.isin(sent, held, assume_unique=True)
        new = np.zeros(len(sent), np.bool_)
        new[occupied] = np.array(assigned.new, np.bool_)[order]
        lasting = len(order) == len(ids) and not assigned.freed and not any(assigned.new)
        return SlotColumns(order, sent, occupied, new, lasting)

    def _sent(self, held: Integers, freed: list[int]) -> Integers:
        """List the slots to send, in order."""
        if self._send_all:
            return self._every_slot
        if not freed or not self._send_freed:
            return held
        return np.sort(np.concatenate([held, np.array(freed, np.int64)]))
