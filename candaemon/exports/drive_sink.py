"""What takes a drive while it is replayed."""

from __future__ import annotations

from collections.abc import Sequence

from candaemon.evaluation.drive_score import DriveScore
from candaemon.frames.frame import Frame, Tick
from candaemon.frames.frame_block import FrameBlock
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline


class DriveSink:
    """Takes the frames and the cycles of a drive; each method does nothing unless a sink needs what it gives."""

    takes_frames: bool = False
    """Whether `add_frames` does anything."""

    def attach(self, score: DriveScore) -> None:
        """See the drive's score before its first cycle."""

    def add_frames(self, block: FrameBlock | Sequence[Frame | Tick]) -> None:
        """Take frames in order of time, before the cycles that they complete."""

    def add_cycle(self, cycle: Cycle, pipeline: Pipeline) -> None:
        """Take a cycle right after it was made, while the trackers still hold what its detections updated."""

    def add_obstacles(self, cycle: Cycle) -> None:
        """Take a cycle's obstacles for the table of tracks: some cycles later, smoothed where that is asked for."""

    def finish(self) -> None:
        """Write what is left, at the end of the drive."""
