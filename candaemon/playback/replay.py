"""A recorded drive through the pipeline: logs in; obstacles, tables and figures out."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Final

from candaemon.binding.bound import Binding
from candaemon.can_io.drive_reader import DriveReader
from candaemon.can_io.logs.formats import check_log
from candaemon.can_io.logs.merge import LogBlock
from candaemon.can_io.logs.read import frames_of
from candaemon.can_io.logs.stream import LogCounts
from candaemon.can_io.logs.write import open_log_writer
from candaemon.can_io.reorder import ItemBlock, ReorderBuffer, ReorderCounts
from candaemon.can_io.time_range import WHOLE_DRIVE, TimeRange
from candaemon.config.ego import InsSettings
from candaemon.errors import InputError
from candaemon.evaluation.detection_columns import detection_columns
from candaemon.evaluation.drive_score import DriveScore
from candaemon.evaluation.tables import (
    EARTH_COLUMNS,
    TRACK_COLUMNS,
    DetectionWriter,
    PredictionWriter,
    TrackWriter,
    track_columns,
)
from candaemon.exports.drive_sink import DriveSink
from candaemon.exports.drive_tables import CYCLES, DETECTIONS, TRACKS
from candaemon.exports.mcap_drive import McapDrive
from candaemon.exports.parquet import SUFFIX, ParquetDrive, ParquetTable
from candaemon.files.outputs import Outputs, make_folder
from candaemon.frames.frame import Frame, Tick
from candaemon.frames.frame_block import FrameBlock
from candaemon.output.encoder import TOGETHER
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state import begun, fingerprint
from candaemon.playback.cycle_smoothing import CycleSmoother
from candaemon.playback.predictions import Predicted, PredictionQueue
from candaemon.playback.recording_files import Run, files_of, runs_of
from candaemon.playback.stage_times import StageTimes
from candaemon.printable import printable

logger = logging.getLogger(__name__)

HORIZONS = (0.5, 1.0)
"""Default horizons of predictions, s."""

LONGEST_PAUSE_S: Final = 3600.0
"""s: from which on a pause of a log that is replayed at a pace is skipped; it may be years."""


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """What to replay and what to write.

    Attributes:
        log: the recorded drive, or a folder: a recording of the service, or consecutive logs.
        further: more logs of the same drive, in any order.
        output: log of the frames that the service would have sent; None: not written.
        tracks: table of obstacles, in Parquet if its name ends so, else in CSV; None: not written.
        predictions: table of expected positions; None: not written.
        horizons: of the predictions, s.
        speed: times real time; None: as fast as possible.
        channels: additional channel names in the log: channel → bus.
        smooth: lag of the smoothing of the table of obstacles, s; None: the table holds the causal estimates.
        fresh: start with an empty pipeline, even where the recording holds the service's state.
        parquet: folder of the tables of tracks, detections and cycles in Parquet; None: not written.
        mcap: the drive for Foxglove; None: not written.
        detections: table of what the sensors said and what became of it; None: not written.
        time_range: what of the drive is replayed; with a beginning, the pipeline starts empty.
        scored: score predictions, standing objects and duplicates too, which costs half as much as tracking; False:
            NIS alone, unless predictions are written.
    """

    log: Path
    output: Path | None = None
    tracks: Path | None = None
    predictions: Path | None = None
    horizons: tuple[float, ...] = HORIZONS
    speed: float | None = None
    channels: dict[str, str] = field(default_factory=dict)
    smooth: float | None = None
    fresh: bool = False
    parquet: Path | None = None
    mcap: Path | None = None
    further: tuple[Path, ...] = ()
    time_range: TimeRange = WHOLE_DRIVE
    detections: Path | None = None
    scored: bool = True

    @property
    def logs(self) -> tuple[Path, ...]:
        """All logs."""
        return (self.log, *self.further)


@dataclass(frozen=True, slots=True)
class Replayed:
    """Result of a replay.

    Attributes:
        pipeline: the pipeline of the last run; its counts continue from the state that the recording began with.
        log: counts of the log reader.
        sequence: counts of clock steps and reordering.
        stray_times: frames whose time stamp was far from those before and after, and was corrected.
        score: scores without ground truth.
        first_ns, last_ns: times of the first and last frame; 0 without frames.
        seconds: duration of the replay.
    """

    pipeline: Pipeline
    log: LogCounts
    sequence: ReorderCounts
    stray_times: int
    score: DriveScore
    first_ns: int
    last_ns: int
    seconds: float


def replay(
    binding: Binding,
    request: ReplayRequest,
    progress: Callable[[LogCounts], None] | None = None,
    outputs: Outputs | None = None,
    sinks: Sequence[DriveSink] = (),
    times: StageTimes | None = None,
) -> Replayed:
    """Replay a log.

    Args:
        binding: the configuration, bound to its DBC files.
        request: the log and the files to write.
        progress: called once a cycle.
        outputs: where the files are written among others, made with all that is read; None: they are all.
        sinks: what else takes the drive.
        times: takes the time of each stage.

    Raises:
        ConfigError: a file would be written over one that is read, or twice.
        InputError: there is no such log, it holds no frame of the configured buses, or a file cannot be written.
    """
    started = time.perf_counter()
    channels, counts, steps = channel_indices(binding, request.channels), LogCounts(), ReorderCounts()
    clock, reader = _LogClock(), DriveReader(channels, counts, request.time_range)
    brief = not request.scored and request.predictions is None
    score = DriveScore([sensor.settings.cycle_time for sensor in binding.sensors], request.horizons, brief=brief)
    is_fresh = request.fresh or request.time_range.begin is not None
    recorded = runs_of(request.logs, fingerprint(binding), fresh=is_fresh)
    for log in chain.from_iterable(run.logs for run in recorded):
        check_log(log)
    with ExitStack() as files:
        outputs = outputs or files.enter_context(Outputs([*binding.files, *files_of(*request.logs)]))
        writers = _Writers(binding, request, outputs, files, sinks)
        for sink in writers.sinks:
            sink.attach(score)
        for run, pipeline in begun_runs(binding, recorded):
            sequence = ReorderBuffer(round(binding.settings.ordering_window * 1e9))
            written = _CycleOutputs(binding, pipeline, request, writers, score)
            blocks = reader.by_time(run.logs) if run.by_time else reader.consecutive(run.logs)
            clock.sinks = tuple(sink for sink in writers.sinks if sink.takes_frames)
            if times is not None:
                times.watch_pipeline(pipeline)
                written.watch(times)
            for cycle in _cycles(pipeline, sequence, blocks, clock, request.speed, times):
                written.write(cycle)
                if progress is not None:
                    progress(counts)
            for cycle in last_cycles(run, pipeline):
                written.write(cycle)
            written.finish()
            steps.add(sequence)
        for sink in writers.sinks:
            sink.finish()
        counts.require_frames(request.log)
    seconds = time.perf_counter() - started
    return Replayed(pipeline, counts, steps, reader.stray_times, score, clock.first_ns, clock.last_ns, seconds)


def last_cycles(run: Run, pipeline: Pipeline) -> Iterator[Cycle]:
    """Yield the cycles that were open at the end of a run, as far as the service reported them.

    Args:
        run: all of whose logs were read.
        pipeline: that they were run through.
    """
    if run.ends:
        yield from pipeline.finish()
    elif run.settled_ns is not None:
        yield from pipeline.settle(run.settled_ns)


def begun_runs(binding: Binding, recorded: Iterable[Run]) -> Iterator[tuple[Run, Pipeline]]:
    """Yield runs with the pipelines that they begin with; a log whose state is refused is left out, with a warning.

    What comes after it in its run begins with the next state.

    Raises:
        InputError: there is none that can be replayed; says what is wrong with the first.
    """
    refused: list[tuple[Path, InputError]] = []
    has_begun = False
    for run in recorded:
        rest: Run | None = run
        while rest is not None:
            try:
                pipeline = begun(binding, rest.state)
            except InputError as error:
                refused.append((rest.logs[0], error))
                rest = rest.without_first()
                continue
            _warn(refused)
            has_begun = True
            yield rest, pipeline
            break
    if refused and not has_begun:
        raise refused[0][1]
    _warn(refused)


def _warn(refused: list[tuple[Path, InputError]]) -> None:
    """Log a warning for each log that is left out, once."""
    for log, error in refused:
        logger.warning("%s: left out: %s", printable(str(log)), error.message)
    refused.clear()


def _cycles(
    pipeline: Pipeline,
    sequence: ReorderBuffer,
    blocks: Iterable[LogBlock],
    clock: _LogClock,
    speed: float | None,
    times: StageTimes | None,
) -> Iterator[Cycle]:
    """Run a log through the pipeline: frame by frame at a given speed, else in blocks; both give the same cycles."""
    if times is not None:
        blocks = times.each("read the log", blocks)
    if speed is not None:
        return pipeline.run(clock.paced(sequence.sequenced(frames_of(blocks)), speed))
    ordered = sequence.sequenced_blocks(blocks)
    return pipeline.run_blocks(clock.observed(ordered if times is None else times.each("order frames", ordered)))


class _LogClock:
    """Records the log's time, paces frames to a multiple of real time, and shows them to who takes frames.

    Attributes:
        first_ns, last_ns: times of the first and last item that passed. A first time of 0 counts as none.
        sinks: take the frames that pass.
    """

    def __init__(self) -> None:
        self.first_ns = 0
        self.last_ns = 0
        self.sinks: tuple[DriveSink, ...] = ()

    def observed(self, blocks: Iterable[ItemBlock]) -> Iterator[ItemBlock]:
        """Pass blocks on unchanged."""
        for block in blocks:
            if len(block):
                times = block.time_ns if isinstance(block, FrameBlock) else [item[0] for item in block]
                self.first_ns = self.first_ns or int(next(filter(None, times), 0))
                self.last_ns = int(times[-1])
            for sink in self.sinks:
                sink.add_frames(block)
            yield block

    def paced(self, items: Iterable[Frame | Tick], speed: float) -> Iterator[Frame | Tick]:
        """Pass single items on at their time; a pause of `LONGEST_PAUSE_S` and more, at that speed, is not waited for.

        Args:
            items: in order of time.
            speed: times real time.
        """
        started = time.monotonic()
        for item in items:
            self.last_ns = item[0]
            self.first_ns = self.first_ns or item[0]
            ahead = (item[0] - self.first_ns) * 1e-9 / speed - (time.monotonic() - started)
            if ahead >= LONGEST_PAUSE_S:
                started -= ahead
            elif ahead > 0.001:
                time.sleep(ahead)
            for sink in self.sinks:
                sink.add_frames((item,))
            yield item


def channel_indices(binding: Binding, further: dict[str, str]) -> dict[str, int]:
    """Return the bus index of each channel name that a log may use."""
    index = {bus.name: bus.index for bus in binding.buses}
    channels = {name: bus.index for bus in binding.buses for name in bus.settings.names_in_logs}
    return channels | {channel: index[bus] for channel, bus in further.items()}


class _Writers:
    """The open files that a replay writes."""

    def __init__(
        self,
        binding: Binding,
        request: ReplayRequest,
        outputs: Outputs,
        files: ExitStack,
        sinks: Sequence[DriveSink],
    ) -> None:
        channels = [bus.settings.log_channel or bus.settings.channel for bus in binding.buses]
        ego = binding.settings.ego
        georeferenced = isinstance(ego, InsSettings) and ego.gnss is not None
        self.log = self.tracks = self.predictions = self.detections = None
        if request.output is not None:
            self.log = files.enter_context(open_log_writer(outputs.open(request.output), channels))
        self.sinks = (*sinks, *_exports(binding, request, outputs))
        if request.tracks is not None and request.tracks.suffix != SUFFIX:
            self.tracks = files.enter_context(
                TrackWriter(outputs.open(request.tracks), (*(EARTH_COLUMNS if georeferenced else ()), *TRACK_COLUMNS))
            )
        if request.predictions is not None:
            self.predictions = files.enter_context(PredictionWriter(outputs.open(request.predictions)))
        if request.detections is not None:
            self.detections = files.enter_context(DetectionWriter(outputs.open(request.detections)))


def _exports(binding: Binding, request: ReplayRequest, outputs: Outputs) -> Iterator[DriveSink]:
    """Yield what writes the files of other tools that are asked for."""
    sensors = [sensor.name for sensor in binding.sensors]
    if request.tracks is not None and request.tracks.suffix == SUFFIX:
        yield ParquetDrive(sensors, tracks=ParquetTable(outputs.open(request.tracks), TRACKS))
    if request.parquet is not None:
        make_folder(request.parquet)
        yield ParquetDrive.of_files(
            sensors, *(outputs.open(request.parquet / f"{form.name}{SUFFIX}") for form in (TRACKS, DETECTIONS, CYCLES))
        )
    if request.mcap is not None:
        yield McapDrive(binding, outputs.open(request.mcap))


class _CycleOutputs:
    """Passes each cycle of a run to the writers and the score."""

    def __init__(
        self, binding: Binding, pipeline: Pipeline, request: ReplayRequest, writers: _Writers, score: DriveScore
    ) -> None:
        self._names = [sensor.name for sensor in binding.sensors]
        self._pipeline = pipeline
        self._writers = writers
        self._score = score
        smooth = request.smooth if request.tracks or request.parquet else None
        self._smoother = CycleSmoother(pipeline.trackers, smooth) if smooth is not None else None
        self._waiting: list[tuple[Cycle, Sequence[Predicted]]] = []
        self._told: list[Cycle] = []
        self._together = TOGETHER if request.speed is None else 1
        self._predictions = (
            None if score.brief else PredictionQueue(pipeline, request.horizons, writers.predictions, score)
        )

    def watch(self, times: StageTimes) -> None:
        """Count what writing and scoring take from here on."""
        if self._writers.log is not None:
            times.watch(self._writers.log, {"write": "write frames"})
        if self._writers.detections is not None:
            times.watch(self._writers.detections, {"write_cycle": "write tables"})
        for sink in self._writers.sinks:
            times.watch(sink, dict.fromkeys(("add_frames", "add_cycle", "add_obstacles"), "write tables"))
        times.watch(self, dict.fromkeys(("_followed", "_write_tracks"), "write tables"))
        times.watch(self._score, {"add": "scores"})
        if self._predictions is not None:
            times.watch(self._predictions, {"add": "scores", "tell": "scores", "write": "write tables"})

    def write(self, cycle: Cycle) -> None:
        """Write and score one cycle."""
        for sink in self._writers.sinks:
            sink.add_cycle(cycle, self._pipeline)
        if self._writers.detections is not None and cycle.detections is not None:
            columns = detection_columns(cycle, self._names)
            self._writers.detections.write_cycle(cycle.detections.time_ns, columns)
        self._waiting.append((cycle, () if self._predictions is None else self._predictions.add(cycle)))
        self._told += self._followed(cycle)
        if len(self._waiting) >= self._together:
            self._write_waiting()

    def finish(self) -> None:
        """Write and score the cycles that wait; report pending predictions and smoothed cycles."""
        if self._smoother is not None:
            self._told += self._smoother.finish()
        self._write_waiting()
        if self._predictions is not None:
            due = self._predictions.finish()
            self._predictions.tell(due)
            self._predictions.write(due)

    def _followed(self, cycle: Cycle) -> list[Cycle]:
        """Return the cycles that the tables of obstacles tell next."""
        return [cycle] if self._smoother is None else list(self._smoother.add(cycle))

    def _write_waiting(self) -> None:
        """Write and score the cycles that wait, one after the other: each alone would find no cache warm."""
        waiting, self._waiting, told, self._told = self._waiting, [], self._told, []
        if self._writers.log is not None:
            for cycle, _ in waiting:
                self._writers.log.write(cycle.frames)
        self._write_tracks(told)
        for cycle, due in waiting:
            self._score.add(cycle)
            if self._predictions is not None:
                self._predictions.tell(due)
        if self._predictions is not None:
            self._predictions.write([each for _, due in waiting for each in due])

    def _write_tracks(self, cycles: Iterable[Cycle]) -> None:
        """Write the cycles that an output follows to the tables of obstacles."""
        told = [
            each if each.reported is each.obstacles else replace(each, obstacles=each.reported)
            for each in cycles
            if each.reported is not None
        ]
        for sink in self._writers.sinks:
            for cycle in told:
                sink.add_obstacles(cycle)
        if self._writers.tracks is not None:
            self._writers.tracks.write_cycles(
                (cycle.obstacles.time_ns, track_columns(cycle.obstacles, self._names, cycle.georeference))
                for cycle in told
            )
