"""Pictures of what is known in advance: a log, or the frames of a simulation."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import Final

import numpy as np

from candaemon.binding.bound import Binding
from candaemon.can_io.drive_reader import DriveReader
from candaemon.can_io.logs.formats import check_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.can_io.reorder import ItemBlock, ReorderBuffer
from candaemon.can_io.time_range import WHOLE_DRIVE
from candaemon.frames.frame import Frame
from candaemon.frames.frame_block import FrameBlock
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state import fingerprint
from candaemon.playback.recording_files import runs_of
from candaemon.playback.replay import begun_runs, channel_indices, last_cycles
from candaemon.playback.summary import doubts, received, require_used
from candaemon.view.painter import Painter
from candaemon.view.picture import Picture

logger = logging.getLogger(__name__)

_STEP_NS: Final = 100_000_000


def pictures_of_log(
    binding: Binding,
    logs: Sequence[Path],
    channels: Mapping[str, str] | None = None,
    progress: Callable[[LogCounts], None] | None = None,
) -> Iterator[Picture]:
    """Yield the pictures of a recorded drive, as fast as it goes.

    Args:
        binding: the configuration, bound to its DBC files.
        logs: the recorded drive, of one log or several; or a folder: a recording of the service, or consecutive logs.
        channels: additional channel names in the log: channel → bus.
        progress: called once a picture.

    Raises:
        InputError: there is no such log, it holds no frame of the configured buses, or nothing can be
            tracked with what it holds: said at the end.
    """
    indices, counts = channel_indices(binding, dict(channels or {})), LogCounts()
    recorded = runs_of(logs, fingerprint(binding))
    for each in chain.from_iterable(run.logs for run in recorded):
        check_log(each)
    shows = False
    for run, pipeline in begun_runs(binding, recorded):
        painter = Painter(pipeline)
        sequence = ReorderBuffer(round(binding.settings.ordering_window * 1e9))
        reader = DriveReader(indices, counts, WHOLE_DRIVE)
        blocks = reader.by_time(run.logs) if run.by_time else reader.consecutive(run.logs)
        cycles = pipeline.run_blocks(_in_steps(sequence.sequenced_blocks(blocks)))
        for cycle in chain(cycles, last_cycles(run, pipeline)):
            picture = painter.paint(cycle)
            shows = shows or len(picture) > 0
            yield picture
            if progress is not None:
                progress(counts)
        got = received(pipeline)
        for doubt in doubts(got):
            logger.warning("%s", doubt)
    counts.require_frames(logs[0])
    if not shows:
        require_used(logs[0], {**got, "log": {"other_channels": counts.other_channels}}, "nothing can be shown")


def _in_steps(blocks: Iterable[ItemBlock]) -> Iterator[ItemBlock]:
    """Yield blocks cut into short ones: the counts of a bus are ahead of the cycles by what a block holds."""
    for block in blocks:
        if not isinstance(block, FrameBlock):
            yield block
            continue
        ends = np.flatnonzero(np.diff(block.time_ns // _STEP_NS)) + 1
        for begin, end in pairwise([0, *ends.tolist(), len(block)]):
            yield block.rows(slice(begin, end))


def pictures_of_frames(binding: Binding, frames: Iterable[Frame]) -> Iterator[Picture]:
    """Yield the pictures of frames in order of time, such as those of a simulation."""
    pipeline = Pipeline(binding)
    painter = Painter(pipeline)
    for cycle in chain(pipeline.run(frames), pipeline.finish()):
        yield painter.paint(cycle)
