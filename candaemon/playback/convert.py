"""Logs of a drive written as one log of any format."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from candaemon.can_io.drive_reader import DriveReader
from candaemon.can_io.logs.formats import check_log, written_suffix
from candaemon.can_io.logs.stream import EveryChannel, LogCounts
from candaemon.can_io.logs.write import open_log_writer
from candaemon.can_io.time_range import WHOLE_DRIVE, TimeRange
from candaemon.files.outputs import Outputs
from candaemon.frames.frame_block import FrameBlock

WITHOUT_CHANNELS: Final = (".csv", ".pcap")
"""Formats that do not say on which bus a frame was."""
WITHOUT_EPOCH: Final = (".asc",)
"""Formats whose times count from the first frame."""


@dataclass(frozen=True, slots=True)
class Converted:
    """What was written.

    Attributes:
        log: counts of the reader.
        frames: written, by channel.
        lost: what the other format does not hold, in words.
    """

    log: LogCounts
    frames: Mapping[str, int]
    lost: Sequence[str]


def convert(
    logs: Sequence[Path],
    output: Path,
    time_range: TimeRange = WHOLE_DRIVE,
    progress: Callable[[LogCounts], None] | None = None,
) -> Converted:
    """Write the data frames of logs as one log, in the order in which they were recorded.

    Args:
        logs: of one drive.
        output: the log to write; its name says the format.
        time_range: what of the drive is written.
        progress: called now and then.

    Raises:
        InputError: a log cannot be read, holds no frame, or has one that the other format cannot hold.
    """
    counts, channels = LogCounts(), EveryChannel()
    for log in logs:
        check_log(log)
    reader = DriveReader(channels, counts, time_range, corrects=False)
    written: dict[int, int] = {}
    # opened before the logs are read, finished after: nothing stays where that fails
    with Outputs(logs) as outputs:
        with open_log_writer(outputs.open(output), channels.names) as writer:
            for block in reader.by_time(logs):
                frames = [
                    frame for frame in (block.frames() if isinstance(block, FrameBlock) else block) if frame.bus >= 0
                ]
                for frame in frames:
                    written[frame.bus] = written.get(frame.bus, 0) + 1
                writer.write(frames)
                if progress is not None:
                    progress(counts)
        counts.require_frames(logs[0])
    by_channel = {channels.names[bus]: frames for bus, frames in sorted(written.items())}
    return Converted(counts, by_channel, _lost(counts, written_suffix(output), len(written)))


def _lost(counts: LogCounts, suffix: str, buses: int) -> list[str]:
    """Return what was not written, in words."""
    skipped = {
        "malformed": counts.malformed,
        "remote frames": counts.remote,
        "error frames": counts.error_frames,
        "ticks": counts.ticks,
        "of further channels": sum(counts.other_channels.values()),
    }
    lost = [f"{number:,} {what}" for what, number in skipped.items() if number]
    if suffix in WITHOUT_CHANNELS and buses > 1:
        lost.append(f"which of {buses} channels a frame is of ({suffix} has none)")
    if suffix in WITHOUT_EPOCH:
        lost.append(f"the date ({suffix} counts from the first frame)")
    return lost
