"""Logs of a drive written as one log of any format."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from candaemon.can_io.drive_reader import DriveReader
from candaemon.can_io.logs.formats import WITH_NAMES, check_log, is_named_file, open_log, written_suffix
from candaemon.can_io.logs.read import read_log_blocks
from candaemon.can_io.logs.stream import EveryChannel, LogCounts
from candaemon.can_io.logs.write import NUMBERED, open_log_writer
from candaemon.can_io.time_range import WHOLE_DRIVE, TimeRange
from candaemon.files.outputs import Outputs
from candaemon.frames.frame_block import FrameBlock

WITHOUT_CHANNELS: Final = (".csv", ".pcap")
"""Formats that do not say on which bus a frame was."""


@dataclass(frozen=True, slots=True)
class Converted:
    """What was written.

    Attributes:
        log: counts of the reader.
        frames: written, by channel.
        lost: what was not written, or not as it was, in words.
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
    suffix = written_suffix(output)
    reader = DriveReader(channels, counts, time_range, corrects=False)
    written: dict[int, int] = {}
    fd_frames = 0
    # opened before the logs are read, finished after: nothing stays where that fails
    with Outputs(logs) as outputs:
        file = outputs.open(output)
        if suffix in NUMBERED:
            _find_channels(logs, channels)
        with open_log_writer(file, channels.names) as writer:
            for block in reader.by_time(logs):
                frames = [
                    frame for frame in (block.frames() if isinstance(block, FrameBlock) else block) if frame.bus >= 0
                ]
                for frame in frames:
                    written[frame.bus] = written.get(frame.bus, 0) + 1
                    fd_frames += frame.fd
                writer.write(frames)
                if progress is not None:
                    progress(counts)
        counts.require_frames(logs[0])
    by_channel = {channels.names[bus]: frames for bus, frames in sorted(written.items())}
    lost = _left_out(counts)
    if suffix in WITHOUT_CHANNELS and len(written) > 1:
        lost.append(f"which of {len(written)} channels a frame is of ({suffix} has none)")
    lost += writer.lost()
    # frames carry neither
    if fd_frames:
        lost.append(f"the flags BRS and ESI of {fd_frames:,} CAN FD frames")
    lost.append("whether a frame was sent or received")
    return Converted(counts, by_channel, lost)


def _find_channels(logs: Sequence[Path], channels: EveryChannel) -> None:
    """Read logs for the names of their channels, to which numbers are to be given; what flows is read only once.

    Where none holds a name, each channel has the number that it is read by.
    """
    files, named = list(filter(is_named_file, logs)), False
    for log in files:
        suffix, stream = open_log(log, LogCounts(tells=False))
        stream.close()
        named |= suffix in WITH_NAMES
    for log in files if named else ():
        for _ in read_log_blocks(log, channels, LogCounts(tells=False)):
            pass


def _left_out(counts: LogCounts) -> list[str]:
    """Return which lines of the logs were not written, in words."""
    skipped = {
        "malformed": counts.malformed,
        "remote frames": counts.remote,
        "error frames": counts.error_frames,
        "ticks": counts.ticks,
        "of further channels": sum(counts.other_channels.values()),
    }
    return [f"{number:,} {what}" for what, number in skipped.items() if number]
