"""Encodes a cycle's obstacles as frames: slots, quantities, payloads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Final, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.binding.bind_writer import MAY_BE_UNKNOWN
from candaemon.binding.bound import BoundOutput
from candaemon.ego.georeference import Georeference
from candaemon.ego.pose import EgoPose
from candaemon.frames.payload_table import Payloads, PayloadTable, TabledPayloads
from candaemon.objects.writer import SlotValues
from candaemon.output.quantities import EgoAcceleration, EgoAccelerationState, MountView, SeenCycle, finder
from candaemon.output.slots import OFF_PATH, SlotColumns, SlotEncoding, SlotState
from candaemon.tracking.obstacles import TENTATIVE, Obstacles

Columns: TypeAlias = dict[str, Floats | Integers]
Value = TypeVar("Value", bound=np.generic)

FARTHEST: Final = 1e5
"""m and m/s; an obstacle beyond this limit, or with a NaN, is not sent."""
TOGETHER: Final = 16
"""Cycles that are written at once where nobody asks for their frames before: arrays of one cycle are short."""
OF_FRAME: Final = frozenset({"id", "counter"})
"""Quantities outside the table of floats: identities stay integers, the counter belongs to the frame."""


@dataclass(frozen=True, slots=True)
class OutputStatus:
    """Contents of the status message besides the slots.

    Attributes:
        ego: validity of ego motion, as `EgoStatus`.
        health: 0 ok, 1 degraded, 2 a sensor is lost, 3 fault.
        drops: frames and objects lost or refused since the start.
    """

    ego: int = 0
    health: int = 0
    drops: int = 0


@dataclass(slots=True)
class OutputEncoderState:
    """State of the encoder between two cycles.

    Attributes:
        slots: the assignment of slots.
        ego_acceleration: state of the derivation of the ego acceleration.
        sent: frames of each slot so far (slots,), for its counters; where all objects share their messages, the first
            element counts all frames.
        cycle: number of the next cycle.
        unreported: obstacles of the last cycle that have no slot, or no finite position and velocity.
        saturated: values so far that were out of their signal's range and were saturated.
    """

    slots: SlotState
    sent: Integers
    ego_acceleration: EgoAccelerationState = field(default_factory=EgoAccelerationState)
    cycle: int = 0
    unreported: int = 0
    saturated: int = 0


@dataclass(slots=True)  # made each cycle, and never changed: freezing takes four times as long as filling
class _PlannedCycle:
    """What one cycle sends.

    Attributes:
        seen: the obstacles that may be sent.
        slots: which of them have which.
        counter: values of this cycle's frames, one for all or one a slot sent.
    """

    seen: SeenCycle
    slots: SlotColumns
    counter: int | Integers


class PlannedPayloads(TabledPayloads):
    """CAN id and payload of a cycle's frames, written when somebody asks for them, with those of other cycles.

    Args:
        encoder: that writes them.
        status: of the status message, as it is; none where none is sent.
        count: how many they are.
    """

    __slots__ = ("_count", "_encoder", "_status", "_written")

    def __init__(self, encoder: OutputEncoder, status: Payloads, count: int) -> None:
        super().__init__()
        self._encoder, self._status, self._count = encoder, status, count
        self._written: Sequence[PayloadTable] | None = None

    def __len__(self) -> int:
        return self._count

    @property
    def first(self) -> Payloads:
        """The status."""
        return self._status

    @property
    def tables(self) -> Sequence[PayloadTable]:
        """The frames of the slots, a table a message."""
        if self._written is None:
            self._encoder.write_planned()
        assert self._written is not None  # noqa: S101 # what is planned is written
        return self._written

    def complete(self, slots: Sequence[PayloadTable]) -> None:
        """Take the frames of the slots."""
        self._written = slots
        self._count = len(self._status) + sum(map(len, slots))


class OutputEncoder:
    """Obstacles → slots → frames, cycle by cycle.

    Sends the status, then the occupied slots and, once, each freed slot as empty; with `send: all`, every slot, and
    so where a message holds several. Where all objects share their messages, only the occupied slots are sent.

    Counters of the protection count the frames of each message; where `counter` is among the output's quantities, they
    count cycles, the same in all slots.

    Args:
        output: the bound output.
    """

    def __init__(self, output: BoundOutput) -> None:
        settings = output.settings
        self._writer, self._status = output.writer, output.status
        self._mount, self._half_width = settings.mount, settings.path_half_width
        self._tentative = settings.tentative
        self._listed = settings.objects.multiplexed
        several = len(settings.objects.points) > 1  # then a message may hold slots that nothing else makes be sent
        self._all = (settings.send == "all" or several) and not self._listed
        self._names = tuple(name for name in settings.signals if name not in OF_FRAME)
        self._may_be_unknown = [row for row, name in enumerate(self._names) if name in MAY_BE_UNKNOWN]
        polar = "range" in settings.signals
        self._finders = [finder(name, polar=polar) for name in self._names]
        self._counts_cycles = "counter" in settings.signals
        self._relative = "rel_ax" in settings.signals
        self._ego_acceleration = EgoAcceleration()
        self._sends_id = "id" in settings.signals
        self._slots = SlotEncoding(output.writer.slots, send_all=self._all, send_freed=not self._listed)
        sent = np.zeros(output.writer.slots, np.int64)
        self._planned: list[tuple[_PlannedCycle, PlannedPayloads]] = []
        self._state = OutputEncoderState(self._slots.state, sent, self._ego_acceleration.state)

    @property
    def state(self) -> OutputEncoderState:
        """State between two cycles.

        Raises:
            ValueError: a state that is set does not fit the configuration.
        """
        self.write_planned()
        return self._state

    @state.setter
    def state(self, state: OutputEncoderState) -> None:
        if state.sent.shape != self._state.sent.shape:
            raise ValueError(f"{len(state.sent)} output slots, expected {len(self._state.sent)}")
        self.write_planned()
        self._state, self._slots.state, self._ego_acceleration.state = state, state.slots, state.ego_acceleration

    @property
    def saturated(self) -> int:
        """Number of values so far that were out of their signal's range and were saturated."""
        self.write_planned()
        return self._state.saturated

    def encode(
        self, obstacles: Obstacles, status: OutputStatus, pose: EgoPose, georeference: Georeference | None = None
    ) -> Payloads:
        """Encode one cycle at once; arguments as `plan`."""
        return list(self.plan(obstacles, status, pose, georeference))

    def plan(
        self, obstacles: Obstacles, status: OutputStatus, pose: EgoPose, georeference: Georeference | None = None
    ) -> PlannedPayloads:
        """Decide what one cycle sends; it is written when it is asked for, or when `TOGETHER` cycles wait.

        Args:
            obstacles: of the cycle.
            status: contents of the status message.
            pose: ego pose at the obstacles' time.
            georeference: of the local frame on earth; None: not known.

        Returns:
            CAN id and payload: the status, then the first message of every slot in order, then the second, and so on.
        """
        state = self._state
        requested = None if self._tentative else obstacles.state != TENTATIVE
        rows = _sendable(obstacles, requested)
        slots = self._slots.assign(obstacles.id[rows], partial(self._urgency, obstacles, rows))
        held = len(slots.order)
        state.unreported = (len(obstacles) if requested is None else int(np.count_nonzero(requested))) - held
        told = [] if self._status is None else [self._write_status(status, held, slots)]
        acceleration = self._ego_acceleration.update(pose) if self._relative else 0j
        seen = SeenCycle(obstacles, rows, pose, acceleration, georeference)
        of_slot = self._writer.frames_a_slot
        payloads = PlannedPayloads(self, told, len(told) + (of_slot or 0) * len(slots.sent))
        self._planned.append((_PlannedCycle(seen, slots, self._count(slots)), payloads))
        if len(self._planned) == TOGETHER or of_slot is None:
            self.write_planned()
        state.cycle += 1
        return payloads

    def write_planned(self) -> None:
        """Write the cycles that nobody has asked for yet."""
        if not self._planned:
            return
        planned, self._planned = self._planned, []
        cycles = [each for each, _ in planned]
        sent = [each.slots.sent for each in cycles]
        told = SlotValues(
            np.concatenate(sent),
            self._columns(cycles),
            np.concatenate([each.slots.occupied for each in cycles]),
            self._counters(cycles),
            np.concatenate([each.slots.new for each in cycles]),
        )
        writer, before = self._writer, self._writer.saturated  # the writer counts all of its callers
        written = writer.write_cycles(told, [len(each) for each in sent])
        self._state.saturated += writer.saturated - before
        for (_, payloads), slots in zip(planned, written, strict=True):
            payloads.complete(slots)

    def _count(self, slots: SlotColumns) -> int | Integers:
        """Return the counter values of this cycle's frames."""
        if self._counts_cycles:
            return self._state.cycle
        sent = self._state.sent
        if self._listed:
            first = sent[0]
            sent[0] += len(slots.sent)
            return np.arange(first, sent[0])
        counted = sent[slots.sent]
        sent[slots.sent] = counted + 1
        return counted

    def _counters(self, cycles: Sequence[_PlannedCycle]) -> Integers:
        """Return the counter values of the frames of cycles, one after the other."""
        counters = [each.counter for each in cycles]
        if self._counts_cycles:
            return np.array(counters).repeat([len(each.slots.sent) for each in cycles])
        return np.concatenate(counters)

    def _urgency(self, obstacles: Obstacles, rows: Indices | slice) -> Floats:
        x, y = obstacles.x[rows], obstacles.y[rows]
        in_path = (x > 0) & (np.abs(y) <= self._half_width)
        return np.hypot(x, y) + np.where(in_path, 0.0, OFF_PATH)

    def _columns(self, cycles: Sequence[_PlannedCycle]) -> Columns:
        """Return each quantity of the slots sent: of the obstacle where occupied, 0 elsewhere; NaN where unknown."""
        view = MountView([each.seen for each in cycles], self._mount, self._half_width)
        with np.errstate(invalid="ignore", over="ignore"):  # what is no number is replaced below
            table = np.array([find(view) for find in self._finders], np.float64)
        ids = [each.seen.obstacles.id[each.seen.rows] for each in cycles]
        begins = np.cumsum([0, *map(len, ids[:-1])]).tolist()
        order = np.concatenate([each.slots.order + begin for each, begin in zip(cycles, begins, strict=True)])
        occupied = np.concatenate([each.slots.occupied for each in cycles])
        table = table.take(order, axis=-1)
        known = np.isfinite(table)
        if np.count_nonzero(known) < known.size:
            filler = np.zeros((len(self._names), 1))
            filler[self._may_be_unknown] = np.nan
            table = np.where(known, table, filler)
        columns: Columns = dict(zip(self._names, _spread(table, occupied), strict=True))
        if self._sends_id:
            columns["id"] = _spread(np.concatenate(ids)[order], occupied)
        return columns

    def _write_status(self, status: OutputStatus, held: int, slots: SlotColumns) -> tuple[int, bytes]:
        """Write the status message."""
        assert self._status is not None  # noqa: S101  # checked by the caller
        # A reader takes `count` objects from a list, or the first `count` of all slots.
        count = int(np.flatnonzero(slots.occupied).max(initial=-1)) + 1 if self._all else len(slots.sent)
        values = {
            "cycle": self._state.cycle,
            "occupied": held,
            "unreported": self._state.unreported,
            "ego": status.ego,
            "health": status.health,
            "drops": status.drops,
            "count": count,
        }
        return self._status.write(values, counter=self._state.cycle)


def _spread(values: NDArray[Value], occupied: Booleans) -> NDArray[Value]:
    """Scatter values (…, occupied slots) to their slots (…, slots), zeros elsewhere."""
    if values.shape[-1] == len(occupied):
        return values
    full = np.zeros((*values.shape[:-1], len(occupied)), values.dtype)
    full[..., occupied] = values
    return full


def _sendable(obstacles: Obstacles, requested: Booleans | None) -> Indices | slice:
    """Return the rows that can be sent: of those requested, with position and velocity in bounds."""
    motion = np.array([obstacles.x, obstacles.y, obstacles.vx, obstacles.vy])
    if np.vdot(motion, motion) < FARTHEST**2:  # then every value is in bounds
        return slice(None) if requested is None else requested.nonzero()[0]
    good = (np.abs(motion) < FARTHEST).all(axis=0)  # NaN is not
    return np.flatnonzero(good if requested is None else good & requested)
