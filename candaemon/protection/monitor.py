"""Frames of a message one after another: counter, rate, silence. All is judged by the frames' own time stamps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from candaemon.protection.checksums import FrameProtector

UNWATCHED: Final = 1 << 62
"""ns, of a time-out that never comes."""


@dataclass(slots=True)
class FrameFaults:
    """Frames that failed, each under one cause, and what else protection finds.

    Attributes:
        checksum: frames with a wrong checksum, or another message's data id.
        repeated: frames whose counter had not moved.
        jumped: frames whose counter stepped too far, and those after them until it had settled.
        too_fast: frames that came faster than the message's rate allows.
        lost: frames that never came, by the counters of those that did.
        timeouts: silences of a message longer than its time-out.
    """

    checksum: int = 0
    repeated: int = 0
    jumped: int = 0
    too_fast: int = 0
    lost: int = 0
    timeouts: int = 0

    @property
    def failed(self) -> int:
        """Frames that were not used because they failed."""
        return self.checksum + self.repeated + self.jumped + self.too_fast


@dataclass(frozen=True, slots=True)
class FrameMonitorSettings:
    """What frames of some messages must be to be used.

    Attributes:
        protector: their checksum, None where they carry none.
        counter: payload → counter, None where it is not watched.
        counter_values: values the counter goes through.
        max_step: greatest step of the counter that is no jump.
        settle: frames whose counters follow one another until they are used again after a jump.
        use_jumps: whether a frame whose counter jumped is used, and counts as frames lost.
        timeout_ns: silence after which the counter may start anywhere, `UNWATCHED` for none.
        spacing_ns: least mean time between two frames, 0 for any.
        slack_ns: how far ahead of that spacing a frame may come: the jitter of a nominal cycle.
    """

    protector: FrameProtector | None = None
    counter: Callable[[bytes], int] | None = None
    counter_values: int = 256
    max_step: int = 1
    settle: int = 1
    use_jumps: bool = False
    timeout_ns: int = UNWATCHED
    spacing_ns: int = 0
    slack_ns: int = 0

    @property
    def watches(self) -> bool:
        """Whether more than the checksum is looked at."""
        return self.counter is not None or self.spacing_ns > 0 or self.timeout_ns < UNWATCHED


@dataclass(slots=True)
class MessageSequence:
    """The frames of one message so far.

    Attributes:
        heard_ns: time of the latest frame, used or not.
        due_ns: time at which the next frame is due, by the rate.
        counter: of the latest frame; None before the first, and after a silence.
        settling: frames whose counters must follow one another until they are used again.
    """

    heard_ns: int
    due_ns: int
    counter: int | None = None
    settling: int = 0


@dataclass(slots=True)
class FrameMonitorState:
    """State of a frame monitor: the sequence of each message, by its CAN id."""

    sequences: dict[int, MessageSequence] = field(default_factory=dict)


@dataclass(slots=True)
class FrameMonitor:
    """Monitor of the frames of some messages: checksum, then silence, counter and rate.

    The rate is a leaky bucket (the generic cell rate algorithm of ITU-T I.371): jitter of a cycle passes, a babbling
    sender does not.

    Args:
        settings: what frames must be to be used.
        faults: where those that fail are counted; the owner's.
        state: what it remembers.
    """

    settings: FrameMonitorSettings
    faults: FrameFaults
    state: FrameMonitorState = field(default_factory=FrameMonitorState)

    def admits(self, can_id: int, data: bytes, time_ns: int) -> bool:
        """Return whether a frame may be used; one that may not is counted.

        Args:
            can_id: of one of the messages.
            data: payload, not shorter than its message.
            time_ns: time stamp, not before that of the frame before.
        """
        settings = self.settings
        if settings.protector is not None and not settings.protector.verify(can_id, data):
            self.faults.checksum += 1
            return False
        if not settings.watches:
            return True
        sequence = self.state.sequences.get(can_id)
        if sequence is None:
            sequence = self.state.sequences[can_id] = MessageSequence(time_ns, time_ns)
        if time_ns - sequence.heard_ns > settings.timeout_ns:
            self.faults.timeouts += 1
            sequence.counter, sequence.settling = None, 0
        sequence.heard_ns = time_ns
        if settings.counter is not None and not self._follows(sequence, settings.counter(data)):
            return False
        if settings.spacing_ns:
            if time_ns < sequence.due_ns - settings.slack_ns:
                self.faults.too_fast += 1
                return False
            sequence.due_ns = max(sequence.due_ns, time_ns) + settings.spacing_ns
        return True

    def _follows(self, sequence: MessageSequence, counter: int) -> bool:
        """Return whether a counter follows the one before it."""
        settings, faults = self.settings, self.faults
        if counter >= settings.counter_values:  # no value that it goes through: nothing follows from it
            faults.jumped += 1
            return False
        before, sequence.counter = sequence.counter, counter
        if before is None:
            return True
        step = (counter - before) % settings.counter_values
        if step == 0:
            faults.repeated += 1
            return False
        if step <= settings.max_step or settings.use_jumps:
            faults.lost += step - 1
            sequence.settling = max(sequence.settling - 1, 0)
        else:
            sequence.settling = settings.settle
        if sequence.settling:
            faults.jumped += 1
        return not sequence.settling
