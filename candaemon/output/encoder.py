"""Obstacles of a cycle into the frames that tell them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import isfinite
from typing import Final, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.binding.bound import BoundOutput
from candaemon.ego.georeference import Georeference
from candaemon.ego.pose import EgoPose
from candaemon.output.quantities import MountView, OwnAcceleration
from candaemon.output.slots import OFF_PATH, SlotColumns, SlotEncoding
from candaemon.tracking.obstacles import TENTATIVE, Obstacles

Columns: TypeAlias = dict[str, Floats | Integers]
Value = TypeVar("Value", bound=np.generic)

FARTHEST: Final = 1e5
"""m and m/s; an obstacle with more, or with no number at all, is not told."""
UNKNOWN: Final = 1e9
"""Stands for a standard deviation or a place on earth that is no number: its signal shows the greatest value it can."""
MAY_BE_UNKNOWN: Final = frozenset({"sx", "sy", "svx", "svy", "latitude", "longitude"})
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

    Counters of the protection count the frames of each message; where `counter` is among the output's quantities they
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
        self._may_be_unknown = [row for row, name in enumerate(self._names) if name in MAY_BE_UNKNOWN]
        self._polar = "range" in settings.signals
        self._counts_cycles = "counter" in settings.signals
        self._own_acceleration = OwnAcceleration() if "rel_ax" in settings.signals else None
        self._tells_id = "id" in settings.signals
        self._seating = SlotEncoding(output.writer.slots, send_all=self._all, send_freed=not self._listed)
        self._sent = np.zeros(output.writer.slots, np.int64)
        self._cycle = 0
        self.unreported = 0

    @property
    def saturated(self) -> int:
        """Values so far that did not fit their signal and were brought to its limits."""
        return self._writer.saturated

    def encode(
        self, obstacles: Obstacles, status: OutputStatus, pose: EgoPose, placement: Georeference | None = None
    ) -> list[tuple[int, bytes]]:
        """Encode one cycle.

        Args:
            obstacles: of the cycle.
            status: what the status message says.
            pose: own pose at the obstacles' time.
            placement: of the level frame on earth; None: not known.

        Returns:
            CAN id and payload: the status, then the first message of every slot in order, then the second, and so on.
        """
        told = self._told(obstacles)
        seats = self._seating.seats(obstacles.id[told], partial(self._urgency, obstacles, told))
        held = len(seats.order)
        self.unreported = self._worth(obstacles) - held
        frames = [] if self._status is None else [self._write_status(status, held, seats)]
        own = 0j if self._own_acceleration is None else self._own_acceleration.update(pose)
        view = MountView(obstacles, told, self._mount, pose, own, placement)
        columns = self._columns(view, obstacles.id[told], seats)
        frames += self._writer.write(seats.sent, columns, seats.occupied, counter=self._count(seats), new=seats.new)
        self._cycle += 1
        return frames

    def _count(self, seats: SlotColumns) -> int | Integers:
        """Give what the counters of this cycle's frames show."""
        if self._counts_cycles:
            return self._cycle
        if self._listed:
            first = self._sent[0]
            self._sent[0] += len(seats.sent)
            return np.arange(first, self._sent[0])
        counted = self._sent[seats.sent]
        self._sent[seats.sent] = counted + 1
        return counted

    def _worth(self, obstacles: Obstacles) -> int:
        """Count the obstacles that should be told."""
        return len(obstacles) if self._tentative else int(np.count_nonzero(obstacles.state != TENTATIVE))

    def _told(self, obstacles: Obstacles) -> Indices | slice:
        """List the obstacles that can be told: of the states asked for, with position and velocity in bounds."""
        motion = np.array([obstacles.x, obstacles.y, obstacles.vx, obstacles.vy])
        asked = None if self._tentative else obstacles.state != TENTATIVE
        if np.vdot(motion, motion) < FARTHEST**2:  # then each one is in bounds
            return slice(None) if asked is None else asked.nonzero()[0]
        good = (np.abs(motion) < FARTHEST).all(axis=0)  # NaN is not
        return np.flatnonzero(good if asked is None else good & asked)

    def _urgency(self, obstacles: Obstacles, rows: Indices | slice) -> Floats:
        x, y = obstacles.x[rows], obstacles.y[rows]
        in_path = (x > 0) & (np.abs(y) <= self._half_width)
        return np.hypot(x, y) + np.where(in_path, 0.0, OFF_PATH)

    def _columns(self, view: MountView, ids: Integers, seats: SlotColumns) -> Columns:
        """Return each quantity of the slots sent: of their holders where occupied, 0 elsewhere; all are finite."""
        with np.errstate(invalid="ignore", over="ignore"):  # what is no number is dealt with below
            table = np.array([view.quantity(name, polar=self._polar) for name in self._names], np.float64)
        table = table.take(seats.order, axis=-1)
        if not isfinite(np.vdot(table, table)):
            filler = np.zeros((len(self._names), 1))
            filler[self._may_be_unknown] = UNKNOWN
            table = np.where(np.isfinite(table), table, filler)
        columns: Columns = dict(zip(self._names, _spread(table, seats.occupied), strict=True))
        if self._tells_id:
            columns["id"] = _spread(ids[seats.order], seats.occupied)
        return columns

    def _write_status(self, status: OutputStatus, held: int, seats: SlotColumns) -> tuple[int, bytes]:
        """Write the status message."""
        assert self._status is not None  # noqa: S101  # the caller asked
        # A reader takes `count` objects from a list, or the first `count` of all slots.
        count = int(np.flatnonzero(seats.occupied).max(initial=-1)) + 1 if self._all else len(seats.sent)
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
    if values.shape[-1] == len(occupied):
        return values
    full = np.zeros((*values.shape[:-1], len(occupied)), values.dtype)
    full[..., occupied] = values
    return full
