"""All that a running service can lose, in one table: journal, status, metrics and the last line take it from here.

The counters themselves are where the loss happens: at a bus, a sensor, the recording, the log. Here they are added up,
over all buses and sensors and over reloads: what a reload takes away keeps what it has lost in the sums.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from typing import TypeAlias

from candaemon.can_io.port import PortCounts
from candaemon.daemon.observer import DaemonView
from candaemon.ego.motion_plausibility import MotionFaults
from candaemon.pipeline.cycle import BusCounts
from candaemon.radar.scan import ScanCounts
from candaemon.tracking.update import TrackerCounts

LOSS_CAUSES = ("kernel_lost", "queue_full", "malformed", "fd_unset", "unread")
"""Causes of a live bus's frames being lost before the pipeline."""
UNSENT_CAUSES = ("send_dropped", "send_failed")
"""Causes of frames not being sent."""
UNUSABLE_CAUSES = (
    "short", "checksum", "repeated", "jumped", "too_fast", "late", "duplicate", "surplus", "discarded",
)  # fmt: skip
"""Causes of a sensor's frames not being used."""
EGO_UNUSABLE_CAUSES = ("checksum", "repeated", "jumped", "too_fast", "not_finite", "out_of_range", "impossible")
"""Causes of ego-motion frames not being used, those too short aside."""
OBJECT_CAUSES = ("unpaired", "rejected", "not_finite", "out_of_range", "impossible", "at_end")
"""Causes of a sensor's objects being left out."""


@dataclass(frozen=True, slots=True)
class Losses:
    """What was lost since the start; each thing lost is in one count.

    What is not lost is not here: frames that nothing asks for, frames that a sensor did not send, items whose time was
    corrected, values brought into their signal's range. Controllers report overflows of their own buffers without
    the number of frames; those are among a bus's events.

    Attributes:
        kernel_lost: frames that found no room in the kernel's receive buffer.
        queue_full: frames dropped behind a driver because the core loop did not take them in time.
        malformed: messages that no CAN frame can be, datagrams of a multicast bus among them.
        fd_unset: CAN FD frames on a bus without `fd: true`.
        unread: frames that had come when their bus was closed or left, and that nobody has read.
        short: frames shorter than their message, of which a signal is asked for.
        checksum: frames with a wrong checksum, or another message's data id.
        repeated: frames whose counter had not moved.
        jumped: frames whose counter stepped too far, and those until it had settled.
        too_fast: frames that came faster than the message's rate allows.
        late: frames of a scan that was closed already.
        duplicate: second frames of the same message and object in one scan.
        surplus: frames of more objects than the format has slots, or of no object at all.
        discarded: frames of scans that were discarded whole, because too many of their frames failed.
        not_finite: frames of ego motion with a value that is no number.
        out_of_range: frames of ego motion with a value outside the DBC's range.
        impossible: frames of ego motion with a value that changed faster than it can.
        send_dropped: frames given up because a newer state came, or the bus took none for too long.
        send_failed: frames not sent because the bus was down.
        scans_without_ego: scans dropped because ego motion was not known yet.
        objects_unpaired: objects left out because their messages are of different cycles.
        objects_rejected: objects left out because a required message or the position did not come.
        objects_not_finite: objects left out because a value is no number.
        objects_out_of_range: objects left out because a value is outside the DBC's range.
        objects_impossible: objects left out because they moved as nothing can.
        objects_at_end: objects left out because their place is at an end of its signal: they may lie anywhere beyond.
        detections_crowded: detections dropped because `max_tracks` was reached.
        recording_items: frames and ticks that were to be recorded and were not.
        recording_events: events that were to be kept and were not.
        log_lines: lines of the log left out because too many were like them.
        status_clients: clients of the status socket that were hung up on: they did not read, or others came.
        scrapes: connections to the metrics endpoint that got no metrics.
    """

    kernel_lost: int = 0
    queue_full: int = 0
    malformed: int = 0
    fd_unset: int = 0
    unread: int = 0
    short: int = 0
    checksum: int = 0
    repeated: int = 0
    jumped: int = 0
    too_fast: int = 0
    late: int = 0
    duplicate: int = 0
    surplus: int = 0
    discarded: int = 0
    not_finite: int = 0
    out_of_range: int = 0
    impossible: int = 0
    send_dropped: int = 0
    send_failed: int = 0
    scans_without_ego: int = 0
    objects_unpaired: int = 0
    objects_rejected: int = 0
    objects_not_finite: int = 0
    objects_out_of_range: int = 0
    objects_impossible: int = 0
    objects_at_end: int = 0
    detections_crowded: int = 0
    recording_items: int = 0
    recording_events: int = 0
    log_lines: int = 0
    status_clients: int = 0
    scrapes: int = 0

    def __add__(self, other: Losses) -> Losses:
        """Return both together."""
        return Losses(*(getattr(self, each.name) + getattr(other, each.name) for each in fields(self)))

    def __str__(self) -> str:
        """Return each count that is not 0 with its name, such as `kernel lost 5, short 2`; empty for none."""
        return ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in asdict(self).items() if count)

    @property
    def lost(self) -> int:
        """Frames that should have reached the pipeline and did not."""
        return sum(getattr(self, cause) for cause in LOSS_CAUSES)

    @property
    def unusable(self) -> int:
        """Frames that reached the pipeline and could not be used."""
        return sum(getattr(self, cause) for cause in dict.fromkeys((*UNUSABLE_CAUSES, *EGO_UNUSABLE_CAUSES)))

    @property
    def unsent(self) -> int:
        """Frames that should have gone onto a bus and did not."""
        return sum(getattr(self, cause) for cause in UNSENT_CAUSES)

    @property
    def frames(self) -> int:
        """All frames that came to nothing."""
        return self.lost + self.unusable + self.unsent


Counter: TypeAlias = PortCounts | BusCounts | ScanCounts | MotionFaults | TrackerCounts
"""What counts losses and may go with a reload."""


class LossLedger:
    """Adds up what the counters of a daemon hold, and what those held that a reload has replaced."""

    def __init__(self) -> None:
        self._counters: Sequence[Counter] = ()
        self._gone = Losses()

    def watch(self, daemon: DaemonView) -> None:
        """Go on with the counters that there are; to be called after each reload."""
        counters = tuple(_counters(daemon))
        here = {id(each) for each in counters}
        for each in self._counters:
            if id(each) not in here:
                self._gone += _losses_of(each)
        self._counters = counters

    def total(self, daemon: DaemonView, others: Losses) -> Losses:
        """Return all losses.

        Args:
            daemon: the one that is watched, between two iterations of its loop.
            others: those that neither its buses nor its pipeline count.
        """
        self.watch(daemon)
        total = self._gone + others + Losses(scans_without_ego=daemon.pipeline.counts.without_ego)
        for each in self._counters:
            total += _losses_of(each)
        return total


def _counters(daemon: DaemonView) -> Iterator[Counter]:
    """Yield all counters of the buses and the pipeline that count losses."""
    pipeline = daemon.pipeline
    yield from (bus.counts for bus in daemon.buses)
    yield from pipeline.counts.buses
    yield pipeline.counts.ego_motion
    yield from (assembler.counts for assembler in pipeline.assemblers)
    yield from (tracker.counts for tracker in pipeline.trackers)


def _losses_of(counter: Counter) -> Losses:
    """Return what a counter holds of losses."""
    match counter:
        case PortCounts():
            return _taken(counter, (*LOSS_CAUSES, *UNSENT_CAUSES))
        case BusCounts():
            return Losses(short=counter.short)
        case ScanCounts():
            objects = {f"objects_{cause}": getattr(counter, cause) for cause in OBJECT_CAUSES}
            return _taken(counter, UNUSABLE_CAUSES) + Losses(**objects)
        case MotionFaults():
            return _taken(counter, EGO_UNUSABLE_CAUSES)
        case TrackerCounts():
            return Losses(detections_crowded=counter.crowded)


def _taken(counter: Counter, causes: Sequence[str]) -> Losses:
    """Return the counts that have the same name there."""
    return Losses(**{cause: getattr(counter, cause) for cause in causes})
