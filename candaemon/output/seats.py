"""Slots of a cycle as arrays: whose row goes where, what is sent, what is empty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from candaemon.output.slots import SlotTable

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Seats:
    """Slots of one cycle; k are held, m are sent.

    Attributes:
        order: (k,) places of the holders among the obstacles given, in order of slot.
        sent: (m,) slots to send, ascending.
        occupied: (m,) whether the slot is held.
        new: (m,) whether its holder has it since this cycle.
        lasting: whether the same obstacles, given again, are seated alike: none came, left or waits.
    """

    order: Rows
    sent: Integers
    occupied: Booleans
    new: Booleans
    lasting: bool


class Seating:
    """Seats the obstacles, cycle by cycle; where the same ones come again, at the cost of a comparison.

    Args:
        capacity: number of slots.
        send_all: every slot is sent, not only the occupied ones.
        send_freed: a freed slot is sent once as empty.
    """

    def __init__(self, capacity: int, *, send_all: bool, send_freed: bool) -> None:
        self._table = SlotTable(capacity)
        self._every_slot = np.arange(capacity)
        self._send_all, self._send_freed = send_all, send_freed
        self._seats: Seats | None = None
        self._ids = b""

    def seats(self, ids: Integers, urgency: Callable[[], Floats]) -> Seats:
        """Hand out the slots of one cycle.

        Args:
            ids: (n,) identities of the obstacles, each once.
            urgency: gives (n,) what `SlotTable.assign` takes; asked only where somebody came or waits.
        """
        key = ids.tobytes()
        seats = self._seats
        if seats is None or not seats.lasting or key != self._ids:
            self._seats = seats = self._seated(ids, urgency())
            self._ids = key
        return seats

    def _seated(self, ids: Integers, urgency: Floats) -> Seats:
        assigned = self._table.assign(ids.tolist(), urgency.tolist())
        slots = np.array(assigned.slot, np.int64)
        order = np.argsort(slots)[np.count_nonzero(slots < 0) :]
        held = slots[order]
        sent = self._sent(held, assigned.freed)
        occupied = np.isin(sent, held, assume_unique=True)
        new = np.zeros(len(sent), np.bool_)
        new[occupied] = np.array(assigned.new, np.bool_)[order]
        lasting = len(order) == len(ids) and not assigned.freed and not any(assigned.new)
        return Seats(order, sent, occupied, new, lasting)

    def _sent(self, held: Integers, freed: list[int]) -> Integers:
        """List the slots to send, in order."""
        if self._send_all:
            return self._every_slot
        if not freed or not self._send_freed:
            return held
        return np.sort(np.concatenate([held, np.array(freed, np.int64)]))
