"""What a cycle of the pipeline results in, and what the pipeline counts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from candaemon.ego.georeference import Georeference
from candaemon.ego.motion_plausibility import MotionFaults
from candaemon.ego.pose import EgoPose
from candaemon.frames.frame import Frame
from candaemon.radar.detections import Detections
from candaemon.tracking.any_tracker import AnyTracker
from candaemon.tracking.obstacles import Obstacles
from candaemon.tracking.update import Update


@dataclass(slots=True)
class BusCounts:
    """Frames of one bus.

    Attributes:
        frames: all.
        spare: in a DBC of this bus, but nothing asks for them.
        spare_short: those of them that have fewer bytes than the DBC says; nothing that is used is lost by that.
        unknown: in no DBC of this bus.
        short: of ego motion, with fewer bytes than the DBC says; those of sensors are counted with their scans.
        fd_unset: CAN FD frames among all, where the bus has no `fd: true`: of logs only, live they are not read.
    """

    frames: int = 0
    spare: int = 0
    spare_short: int = 0
    unknown: int = 0
    short: int = 0
    fd_unset: int = 0

    @property
    def used(self) -> int:
        """Frames that a sensor or ego motion took."""
        return self.frames - self.spare - self.unknown - self.short


@dataclass(slots=True)
class PipelineCounts:
    """What the pipeline did.

    Attributes:
        cycles: times that obstacles were reported, which is not after each scan where `output.cycle_time` says so.
        coasting_cycles: those of them without a scan, because every sensor was silent.
        dead_reckoning, ego_lost: those of them in which ego motion had that status; no velocity had come for so long.
        without_ego: scans dropped because ego motion was not known yet.
        ego_motion_short: frames of ego motion with fewer bytes than the DBC says.
        ego_motion: frames of ego motion that failed otherwise, by cause.
        sent: frames made for the output bus.
        buses: per bus.
    """

    cycles: int = 0
    coasting_cycles: int = 0
    dead_reckoning: int = 0
    ego_lost: int = 0
    without_ego: int = 0
    ego_motion_short: int = 0
    ego_motion: MotionFaults = field(default_factory=MotionFaults)
    sent: int = 0
    buses: list[BusCounts] = field(default_factory=list)


@dataclass(slots=True)  # made each cycle, and never changed: freezing takes four times as long as filling
class Cycle:
    """One cycle of the daemon: a scan that was tracked, or an instant at which obstacles coast.

    Attributes:
        time_ns: of the frame that closed the scan, or of the instant at which obstacles coast.
        obstacles: of all groups; their own time is that of the measurement.
        frames: what goes onto the output bus.
        pose: ego pose at the obstacles' time.
        detections: the scan's, None in a cycle without one.
        tracker: the group's tracker that took them; its latest step is this one until the next cycle.
        update: what the detections updated; None in a cycle without any.
        georeference: of the local frame on earth at the obstacles' time; None where it is not known or not asked for.
        reported: the obstacles as they go out, with all detections used since the latest output; None in a cycle that
            no output follows.
    """

    time_ns: int
    obstacles: Obstacles
    frames: Sequence[Frame]
    pose: EgoPose
    detections: Detections | None
    tracker: AnyTracker | None
    update: Update | None = None
    georeference: Georeference | None = None
    reported: Obstacles | None = None
