"""All that a pipeline remembers between two frames: the states of its stages."""

from __future__ import annotations

from dataclasses import dataclass, field

from candaemon.calibration.calibrator import CalibratorState
from candaemon.ego.georeference import GeoreferencerState
from candaemon.ego.ins import InsMotionState
from candaemon.ego.odometry import OdometryState
from candaemon.frames.times import LONG_AGO_NS, NEVER_NS
from candaemon.output.encoder import OutputEncoderState
from candaemon.pipeline.cycle import PipelineCounts
from candaemon.pipeline.ego_frames import EgoFramesState
from candaemon.pipeline.health import HealthState
from candaemon.pipeline.output_cycle import OutputCycleState
from candaemon.pipeline.scan_alignment import AlignmentState
from candaemon.radar.assembly import AssemblerState
from candaemon.tracking.groups import TrackersState
from candaemon.tracking.sensor_trust import TrustState
from candaemon.tracking.stationary import StationaryWatchState


@dataclass(slots=True)
class Schedule:
    """When something happens without a frame.

    Attributes:
        coast_due_ns: from when on obstacles coast if no scan comes; `NEVER_NS` before the first frame.
        deadline_ns: until when nothing can be due.
        latest_ns: time of the latest measurement that was tracked.
        lag_ns: from there to when it was; None before the first.
    """

    coast_due_ns: int = NEVER_NS
    deadline_ns: int = 0
    latest_ns: int = LONG_AGO_NS
    lag_ns: int | None = None

    def track(self, measured_ns: int, now_ns: int) -> None:
        """Note when a scan is tracked; one that comes late does not turn back the time of what coasts."""
        if not measured_ns < self.latest_ns <= now_ns:
            self.latest_ns = measured_ns
        self.lag_ns = now_ns - self.latest_ns


@dataclass(slots=True)
class PipelineState:
    """What a pipeline remembers: data, nothing that the configuration decides.

    Attributes:
        counts: what it did.
        assemblers: of each sensor's open scan.
        ego: of ego motion; None where the vehicle stands for good.
        georeferencer: of the local frame's place on earth; None where it is not asked for.
        ego_frames: of each message of ego motion, by its CAN id.
        trust: of how far the sensors can be trusted.
        trackers: of the obstacles.
        stationary: of what stands still; None where ego motion has nothing to learn from it.
        output_cycle: of when obstacles go out.
        calibrator: of what is estimated of the sensors; None where nothing is.
        encoder: of the output; None where there is none.
        health: of the sensors and of what was dropped.
        schedule: of what happens without a frame.
        alignments: of the groups whose scans are brought to one instant.
    """

    counts: PipelineCounts
    assemblers: list[AssemblerState]
    ego: InsMotionState | OdometryState | None
    georeferencer: GeoreferencerState | None
    ego_frames: dict[int, EgoFramesState]
    trust: TrustState
    trackers: TrackersState
    stationary: StationaryWatchState | None
    output_cycle: OutputCycleState
    calibrator: CalibratorState | None
    encoder: OutputEncoderState | None
    health: HealthState
    schedule: Schedule
    alignments: list[AlignmentState] = field(default_factory=list)
