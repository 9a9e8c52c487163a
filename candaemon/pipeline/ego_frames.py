"""Frames of ego motion: decoded, checked, and passed to ego motion and to the georeferencer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from candaemon.arrays import Booleans, Bytes, Floats, Indices, Integers
from candaemon.binding.bound import BoundEgo, EgoMessage
from candaemon.dbc.batch_codec import BatchDecoder
from candaemon.ego.georeference import Georeferencer
from candaemon.ego.ins import InsMotion
from candaemon.ego.motion import EgoMotion
from candaemon.ego.motion_plausibility import MotionPlausibility, MotionPlausibilityState
from candaemon.pipeline.cycle import PipelineCounts
from candaemon.protection.monitor import FrameMonitor, FrameMonitorState


@dataclass(slots=True)
class EgoFramesState:
    """What is remembered of one message's frames.

    Attributes:
        monitor: of their counters and rate; None where they are not monitored.
        plausibility: of their values.
        used: frames that were used.
        absent: how many of them the DBC's multiplexer left each value out of, in the order of the quantities.
    """

    monitor: FrameMonitorState | None
    plausibility: MotionPlausibilityState
    used: int = 0
    absent: list[int] = field(default_factory=list)


class EgoFrames:
    """Receives the frames of one message.

    Args:
        message: the message.
        ego: the settings it belongs to.
        consumers: ego motion and the georeferencer; those that make no use of its quantities are left out.
        counts: where frames that fail are counted; the owner's.
    """

    def __init__(
        self,
        message: EgoMessage,
        ego: BoundEgo,
        consumers: Sequence[EgoMotion | Georeferencer],
        counts: PipelineCounts,
    ) -> None:
        self._message = message
        self._many: BatchDecoder | None = None
        self._decode, self._names = message.decode, message.quantities
        self._length, self._can_id, self._bus = message.message.length, message.message.can_id, ego.bus
        self._consumers = [each for each in consumers if not each.wanted.isdisjoint(message.quantities)]
        self._monitor = None if message.monitor is None else FrameMonitor(message.monitor, counts.ego_motion)
        self._plausibility = MotionPlausibility(message, ego.settings.plausibility, counts.ego_motion)
        self._counts = counts
        self._used, self._absent = 0, [0] * len(message.quantities)
        self._is_multiplexed = any(each.signal.multiplexer_signal is not None for each in message.bindings)

    @property
    def came(self) -> Iterator[tuple[str, int]]:
        """Each quantity, and how often it came in a frame that was used."""
        for name, absent in zip(self._names, self._absent, strict=True):
            yield name, self._used - absent

    @property
    def state(self) -> EgoFramesState:
        """What it remembers.

        Raises:
            ValueError: a state that is set does not fit the message.
        """
        monitor = None if self._monitor is None else self._monitor.state
        return EgoFramesState(monitor, self._plausibility.state, self._used, self._absent)

    @state.setter
    def state(self, state: EgoFramesState) -> None:
        if (self._monitor is None) != (state.monitor is None):
            raise ValueError("other frame guards than the configuration's")
        if self._monitor is not None and state.monitor is not None:
            self._monitor.state = state.monitor
        if len(state.absent) != len(self._names):
            raise ValueError(f"{len(state.absent)} quantities of a message of ego motion, expected {len(self._names)}")
        self._plausibility.state = state.plausibility
        self._used, self._absent = state.used, state.absent

    def count_into(self, counts: PipelineCounts) -> None:
        """Count frames that fail in other counts from here on."""
        self._counts, self._plausibility.faults = counts, counts.ego_motion
        if self._monitor is not None:
            self._monitor.faults = counts.ego_motion

    @property
    def names(self) -> tuple[str, ...]:
        """The quantity of each value that somebody makes use of."""
        return self._names if self._consumers else ()

    def are_all_for(self, consumer: object) -> bool:
        """Return whether nobody else makes use of them."""
        return all(each is consumer for each in self._consumers)

    @property
    def are_judged_together(self) -> bool:
        """Whether `judged` says anything of them: no frame lacks a value, and none is looked at for its counter."""
        return self._monitor is None and not self._is_multiplexed

    def judged(self, times_ns: Integers, payloads: Sequence[bytes]) -> list[Sequence[float] | None]:
        """Return the values of frames that are used for sure, in order of time; None of others, which `receive` takes.

        To be called when all frames before them were received.

        Args:
            times_ns: their time stamps (n,).
            payloads: their payloads.
        """
        if not self._consumers:
            return [() if len(data) >= self._length else None for data in payloads]
        values = [self._decode(data) for data in payloads]
        if None in values:
            return [None] * len(values)
        sure = self._plausibility.surely(times_ns, np.array(values, np.float64))
        return [each if is_sure else None for each, is_sure in zip(values, sure.tolist(), strict=True)]

    def judged_table(self, times_ns: Integers, payloads: Bytes, lengths: Bytes) -> tuple[Booleans, Floats]:
        """As `judged`: return which frames are used for sure (n,), and their values (n, values).

        No values are read where nobody makes use of them.

        Args:
            times_ns: their time stamps (n,).
            payloads: their payloads (n, bytes), zeros after the end of each.
            lengths: of those, bytes (n,).
        """
        whole = lengths >= self._length
        if not self._consumers:
            return whole, np.empty((len(payloads), 0))
        if not whole.all():
            return np.zeros(len(payloads), np.bool_), np.zeros((len(payloads), len(self._names)))
        table = self._decoder.decode(payloads[:, : self._length]).T
        return self._plausibility.surely(times_ns, table), table

    @property
    def _decoder(self) -> BatchDecoder:
        """What decodes many frames at once, made where that is first asked for."""
        if self._many is None:
            self._many = BatchDecoder(self._message.scaled, [each.signal.name for each in self._message.bindings])
        return self._many

    def count_judged(self, frames: int) -> None:
        """Count frames that are used for sure."""
        self._used += frames

    @property
    def remembers(self) -> bool:
        """Whether `note_judged` does anything."""
        return bool(self._consumers) and self._plausibility.remembers

    def note_judged(self, time_ns: int, values: Floats) -> None:
        """Remember a frame that is used for sure.

        Args:
            time_ns: its time stamp.
            values: of it.
        """
        self._plausibility.note(time_ns, values.tolist())

    def pass_judged(self, time_ns: int, values: Floats) -> None:
        """Pass on the values of a frame that is remembered."""
        for consumer in self._consumers:
            consumer.update(time_ns, self._names, values.tolist())

    def receive_judged(self, _part: int, _slot: int, values: Sequence[float], time_ns: int) -> None:
        """Take the values of a frame that is used for sure."""
        self._used += 1
        if self._consumers:
            self._plausibility.note(time_ns, values)
            for consumer in self._consumers:
                consumer.update(time_ns, self._names, values)

    def receive(self, _part: int, _slot: int, data: bytes, time_ns: int) -> None:
        """Take a frame."""
        values = self._decode(data) if self._consumers else ()
        if values is None or len(data) < self._length:
            self._counts.ego_motion_short += 1
            self._counts.buses[self._bus].short += 1
            return
        if self._monitor is not None and not self._monitor.admits(self._can_id, data, time_ns):
            return
        if self._consumers and not self._plausibility.admits(time_ns, values):
            return
        self._used += 1
        if self._is_multiplexed:
            for index, value in enumerate(values):
                self._absent[index] += value != value
        for consumer in self._consumers:
            consumer.update(time_ns, self._names, values)


class SteadyFrames:
    """Takes frames of an INS that are used for sure and came one after the other, without a Python call for each.

    Args:
        motion: the INS.
        messages: who receives the frames of each message; nobody else makes use of them.
    """

    def __init__(self, motion: InsMotion, messages: Sequence[EgoFrames]) -> None:
        self._motion, self._messages = motion, messages
        self._columns = motion.columns([each.names for each in messages])
        self._remembering = [number for number, each in enumerate(messages) if each.remembers]
        self._times: list[int] = []
        self._of: list[int] = []
        self._values: Floats = np.empty((0, 0))
        self._latest: list[list[int]] = []  # of each that remembers, its last frame before each frame; −1 before all

    def judged(self, times_ns: Integers, message: Indices, payloads: Bytes, lengths: Bytes) -> Booleans:
        """Return which frames are used for sure (n,), and keep them for `receive`; they are counted at once.

        To be called when all frames before them were received.

        Args:
            times_ns: their time stamps (n,), in order.
            message: which message each is (n,).
            payloads: their payloads (n, bytes), zeros after the end of each.
            lengths: of those, bytes (n,).
        """
        sure, values = np.zeros(len(payloads), np.bool_), np.empty((len(payloads), self._columns.shape[1]))
        for number, frames in enumerate(self._messages):
            mine = (message == number).nonzero()[0]
            if len(mine):
                sure[mine], table = frames.judged_table(times_ns[mine], payloads[mine], lengths[mine])
                values[mine, : table.shape[1]] = table
                frames.count_judged(int(np.count_nonzero(sure[mine])))
        times_ns, message, self._values = times_ns[sure], message[sure], values[sure]
        self._times, self._of = times_ns.tolist(), message.tolist()
        places = np.arange(len(message))
        self._latest = [
            np.maximum.accumulate(np.where(message == number, places, -1)).tolist() for number in self._remembering
        ]
        self._motion.keep(times_ns, message, self._values, self._columns)
        return sure

    def receive(self, begin: int, end: int, _data: object, _time_ns: int) -> None:
        """Take the kept frames from `begin` to before `end`."""
        for number, latest in zip(self._remembering, self._latest, strict=True):
            last = latest[end - 1]
            if last >= begin:
                self._messages[number].note_judged(self._times[last], self._values[last])
        for k in range(self._motion.update_together(begin, end), end):
            self._messages[self._of[k]].pass_judged(self._times[k], self._values[k])
