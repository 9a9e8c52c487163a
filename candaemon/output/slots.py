"""Slots of the output: an obstacle keeps its slot, and a freed slot stays empty for one cycle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices, Integers

OFF_PATH: Final = 1e6
"""Added to the distance (m) of an obstacle outside the vehicle's path: it ranks after all those inside."""
MARGIN: Final = 5.0
"""m by which an obstacle must be more urgent to displace another from its slot; prevents alternating between two."""


@dataclass(frozen=True, slots=True)
class SlotAssignment:
    """Slots of one cycle.

    Attributes:
        slot: of each obstacle, in the order of the argument; −1 where it has none.
        new: whether the slot was assigned in this cycle, in the same order.
        freed: slots that were held in the cycle before and are empty in this one.
    """

    slot: list[int]
    new: list[bool]
    freed: list[int]


@dataclass(slots=True)
class SlotState:
    """Which obstacle holds which slot.

    Attributes:
        free: slots that no obstacle holds, a heap: the lowest first.
        holder: slot of each obstacle that holds one, by the obstacle's identity.
    """

    free: list[int]
    holder: dict[int, int] = field(default_factory=dict)


class OutputSlots:
    """Which obstacle holds which slot.

    An obstacle keeps its slot while it lives. A slot that becomes free is assigned in the next cycle at the earliest,
    so that a reader of the bus sees it empty in between. Where slots run short, an obstacle in the path displaces the
    least urgent one and gets its slot one cycle later, for the same reason.

    Args:
        capacity: number of slots.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._state = SlotState(list(range(capacity)))

    @property
    def state(self) -> SlotState:
        """Which obstacle holds which slot.

        Raises:
            ValueError: when set to a state in which a slot is held twice or missing.
        """
        return self._state

    @state.setter
    def state(self, state: SlotState) -> None:
        if sorted([*state.free, *state.holder.values()]) != list(range(self._capacity)):
            raise ValueError(f"other slots than 0 to {self._capacity - 1}, each once")
        self._state = state

    def assign(self, ids: Sequence[int], urgency: Sequence[float]) -> SlotAssignment:
        """Assign the slots of one cycle.

        Args:
            ids: identities of the obstacles, without repetition.
            urgency: distance of each, m, `OFF_PATH` more outside the path; the lowest first.
        """
        free, holder = self._state.free, self._state.holder
        urgent = dict(zip(ids, urgency, strict=True))
        freed = [holder.pop(gone) for gone in [each for each in holder if each not in urgent]]
        waiting = sorted((each for each in ids if each not in holder), key=urgent.__getitem__)
        served = waiting[: len(free)]
        for each in served:
            holder[each] = heappop(free)
        # Slots freed above go to the first waiting obstacles in the next cycle; only the others need an eviction.
        for each in waiting[len(served) + len(freed) :]:
            if not self._make_room(urgent[each], urgent, freed):
                break
        for slot in freed:
            heappush(free, slot)
        fresh = set(served)
        return SlotAssignment([holder.get(each, -1) for each in ids], [each in fresh for each in ids], freed)

    def _make_room(self, urgency: float, urgent: dict[int, float], freed: list[int]) -> bool:
        """Free the least urgent slot for an obstacle in the path; return whether one is less urgent by the margin."""
        holder = self._state.holder
        if urgency >= OFF_PATH or not holder:
            return False
        last = max(holder, key=urgent.__getitem__)
        if urgent[last] <= urgency + MARGIN:
            return False
        freed.append(holder.pop(last))
        return True


@dataclass(slots=True)  # made each cycle
class SlotColumns:
    """Slots of one cycle; k are held, m are sent.

    Attributes:
        order: (k,) rows of the obstacles that hold a slot, in order of slot.
        sent: (m,) slots to send, ascending.
        occupied: (m,) whether the slot is held.
        new: (m,) whether the slot was assigned in this cycle.
    """

    order: Indices
    sent: Integers
    occupied: Booleans
    new: Booleans


class SlotEncoding:
    """Assigns slots to the obstacles, cycle by cycle; unchanged obstacles cost only a comparison of their ids.

    Args:
        capacity: number of slots.
        send_all: every slot is sent, not only the occupied ones.
        send_freed: a freed slot is sent once as empty.
    """

    def __init__(self, capacity: int, *, send_all: bool, send_freed: bool) -> None:
        self._table = OutputSlots(capacity)
        self._every_slot = np.arange(capacity)
        self._send_all, self._send_freed = send_all, send_freed
        # the latest cycle's slots, while the same obstacles would get the same again
        self._lasting: SlotColumns | None = None
        self._lasting_ids = b""
        self._waiting: Indices | None = None  # rows of those that wait for a slot, the others having all

    @property
    def state(self) -> SlotState:
        """Which obstacle holds which slot.

        Raises:
            ValueError: when set to a state in which a slot is held twice or missing.
        """
        return self._table.state

    @state.setter
    def state(self, state: SlotState) -> None:
        self._table.state, self._lasting = state, None

    def assign(self, ids: Integers, urgency: Callable[[], Floats]) -> SlotColumns:
        """Return the slots of one cycle.

        Args:
            ids: (n,) identities of the obstacles, without repetition.
            urgency: returns the urgency of each, (n,); called only where an obstacle is new, gone or waiting.
        """
        key = ids.tobytes()
        columns = self._lasting
        if columns is None or key != self._lasting_ids:
            return self._assigned(ids, key, urgency())
        if self._waiting is None:
            return columns
        urgent = urgency()
        return self._assigned(ids, key, urgent) if self._is_displaced(columns.order, urgent) else columns

    def _is_displaced(self, holding: Indices, urgency: Floats) -> bool:
        """Return whether the most urgent obstacle that waits gets the slot of the least urgent one that holds one."""
        most = urgency[self._waiting].min()
        return bool(most < OFF_PATH and urgency[holding].max() > most + MARGIN)

    def _assigned(self, ids: Integers, key: bytes, urgency: Floats) -> SlotColumns:
        assigned = self._table.assign(ids.tolist(), urgency.tolist())
        slots = np.array(assigned.slot, np.int64)
        order = np.argsort(slots)[np.count_nonzero(slots < 0) :]
        held = slots[order]
        sent = self._sent(held, assigned.freed)
        is_held = np.zeros(len(self._every_slot), np.bool_)
        is_held[held] = True
        occupied = is_held[sent]
        new = np.zeros(len(sent), np.bool_)
        new[occupied] = np.array(assigned.new, np.bool_)[order]
        waiting = np.flatnonzero(slots < 0)
        lasting = not assigned.freed and not any(assigned.new) and (not len(waiting) or not self._table.state.free)
        columns = SlotColumns(order, sent, occupied, new)
        self._lasting, self._lasting_ids = columns if lasting else None, key
        self._waiting = waiting if len(waiting) else None
        return columns

    def _sent(self, held: Integers, freed: list[int]) -> Integers:
        """Return the slots to send, in order."""
        if self._send_all:
            return self._every_slot
        if not freed or not self._send_freed:
            return held
        return np.sort(np.concatenate([held, np.array(freed, np.int64)]))
