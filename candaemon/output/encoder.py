"""Obstacles of a cycle into the frames that tell them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from candaemon.binding.bound import BoundOutput
from candaemon.output.quantities import OwnAcceleration, View
from candaemon.output.slots import OFF_PATH, SlotTable
from candaemon.sensing.pose import EgoPose
from candaemon.tracking.obstacles import TENTATIVE, Obstacles

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Rows = NDArray[np.intp]
Columns: TypeAlias = dict[str, NDArray[np.float64] | NDArray[np.int64]]
Value = TypeVar("Value", bound=np.generic)

FARTHEST: Final = 1e5
"""m and m/s; an obstacle with more, or with no number at all, is not told."""
UNKNOWN_DEVIATION: Final = 1e9
"""Stands for a standard deviation that is not a number: its signal shows the greatest value it can."""
DEVIATIONS: Final = frozenset({"sx", "sy", "svx", "svy"})
OF_FRAME: Final = frozenset({"id", "counter"})
"""Quantities that do not pass through the table of numbers: identities stay integers, the counter is the frame's."""


@dataclass(frozen=True, slots=True)
class OutputStatus:
    """What the status message says beside the slots.

    Attributes:
        ego: validity of own motion, as `EgoStatus`.
        health: 0 ok, 1 degraded, 2 a sensor is lost, 3 fault.
        drops: frames and objects lost or refused since the start.
    """

    ego: int = 0
    health: int = 0
    drops: int = 0


class OutputEncoder:
    """Obstacles → slots → frames, cycle by cycle.

    Sent are the status, then the occupied slots and once each freed one as empty, or with `send: all` every slot. Where
    all objects share their messages, a list of those there are is sent: absence says enough.

    Counters of the protection count the frames of each slot; where `counter` is among the output's quantities they
    count cycles, alike in all slots.

    Args:
        output: the bound output.

    Attributes:
        unreported: obstacles of the last cycle that have no slot, or no finite position and velocity.
    """

    def __init__(self, output: BoundOutput) -> None:
        settings = output.settings
        self._writer, self._status = output.writer, output.status
        self._mount, self._half_width = settings.mount, settings.path_half_width
        self._tentative = settings.tentative
        self._listed = settings.objects.multiplexed
        self._all = settings.send == "all" and not self._listed
        self._names = tuple(name for name in settings.signals if name not in OF_FRAME)
        self._deviations = [row for row, name in enumerate(self._names) if name in DEVIATIONS]
        self._polar = "range" in settings.signals
        self._counts_cycles = "counter" in settings.signals
        self._own_acceleration = OwnAcceleration() if "rel_ax" in settings.signals else None
        self._slots = SlotTable(output.writer.slots)
        self._every_slot = np.arange(output.writer.slots)
        self._sent = np.zeros(output.writer.slots, np.int64)
        self._cycle = 0
        self.unreported = 0

    @property
    def saturated(self) -> int:
        """Values so far that did not fit their signal and were brought to its limits."""
        return self._writer.saturated

    def encode(self, obstacles: Obstacles, status: OutputStatus, pose: EgoPose) -> list[tuple[int, bytes]]:
        """Encode one cycle.

        Args:
            obstacles: of the cycle.
            status: what the status message says.
            pose: own pose at the obstacles' time.

        Returns:
            CAN id and payload: the status, then the first message of every slot in order, then the second, and so on.
        """
        told = self._told(obstacles)
        assigned = self._slots.assign(obstacles.id[told].tolist(), self._urgency(obstacles, told).tolist())
        slots = np.array(assigned.slot, np.int64)
        by_slot = np.argsort(slots)[np.count_nonzero(slots < 0) :]
        rows, held = told[by_slot], slots[by_slot]
        new = np.array(assigned.new, np.bool_)[by_slot]
        self.unreported = self._worth(obstacles) - len(held)
        sent = self._sent_slots(held, assigned.freed)
        occupied = np.zeros(len(self._every_slot), np.bool_)
        occupied[held] = True
        occupied = occupied[sent]
        frames = [] if self._status is None else [self._write_status(status, len(held), sent, occupied)]
        columns = self._columns(obstacles, rows, pose, occupied)
        counter = self._cycle if self._counts_cycles else self._sent[sent]
        frames += self._writer.write(sent, columns, occupied, counter=counter, new=_spread(new, occupied))
        self._sent[sent] += 1
        self._cycle += 1
        return frames

    def _worth(self, obstacles: Obstacles) -> int:
        """Count the obstacles that should be told."""
        return len(obstacles) if self._tentative else int(np.count_nonzero(obstacles.state != TENTATIVE))

    def _told(self, obstacles: Obstacles) -> Rows:
        """List the obstacles that can be told: of the states asked for, with position and velocity in bounds."""
        motion = np.abs([obstacles.x, obstacles.y, obstacles.vx, obstacles.vy])
        good = (motion < FARTHEST).all(axis=0)  # NaN is not
        if not self._tentative:
            good &= obstacles.state != TENTATIVE
        return np.flatnonzero(good)

    def _urgency(self, obstacles: Obstacles, rows: Rows) -> Floats:
        x, y = obstacles.x[rows], obstacles.y[rows]
        in_path = (x > 0) & (np.abs(y) <= self._half_width)
        return np.hypot(x, y) + np.where(in_path, 0.0, OFF_PATH)

    def _sent_slots(self, held: Integers, freed: list[int]) -> Integers:
        """List the slots to send, in order."""
        if self._all:
            return self._every_slot
        if not freed or self._listed:
            return held
        return np.sort(np.concatenate([held, np.array(freed, np.int64)]))

    def _columns(self, obstacles: Obstacles, rows: Rows, pose: EgoPose, occupied: Booleans) -> Columns:
        """Return each quantity of the slots sent: of the obstacles in these rows where occupied; all are finite."""
        own = 0j if self._own_acceleration is None else self._own_acceleration.update(pose)
        view = View(obstacles, rows, self._mount, pose, own)
        with np.errstate(invalid="ignore", over="ignore"):  # what is no number is dealt with below
            table = np.array([view.quantity(name, polar=self._polar) for name in self._names], np.float64)
        finite = np.isfinite(table)
        if not finite.all():
            filler = np.zeros((len(self._names), 1))
            filler[self._deviations] = UNKNOWN_DEVIATION
            table = np.where(finite, table, filler)
        columns: Columns = dict(zip(self._names, _spread(table, occupied), strict=True))
        columns["id"] = _spread(obstacles.id[rows], occupied)
        return columns

    def _write_status(self, status: OutputStatus, held: int, sent: Integers, occupied: Booleans) -> tuple[int, bytes]:
        """Write the status message."""
        assert self._status is not None  # noqa: S101  # the caller asked
        # A reader takes `count` objects from a list, or the first `count` of all slots.
        count = int(np.flatnonzero(occupied).max(initial=-1)) + 1 if self._all else len(sent)
        values = {
            "cycle": self._cycle,
            "occupied": held,
            "unreported": self.unreported,
            "ego": status.ego,
            "health": status.health,
            "drops": status.drops,
            "count": count,
        }
        return self._status.write(values, counter=self._cycle)


def _spread(values: NDArray[Value], occupied: Booleans) -> NDArray[Value]:
    """Put the values (…, occupied slots) in their places (…, slots), zeros between."""
    if occupied.all():
        return values
    full = np.zeros((*values.shape[:-1], len(occupied)), values.dtype)
    full[..., occupied] = values
    return full
