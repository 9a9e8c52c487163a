"""A configuration tried on the first seconds of a log, before anybody relies on it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Final

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.calibration.proposals import Finding, proposals
from candaemon.can_io.drive_reader import DriveReader
from candaemon.can_io.logs.formats import check_log
from candaemon.can_io.logs.merge import LogBlock
from candaemon.can_io.logs.stream import LogCounts
from candaemon.can_io.reorder import ReorderBuffer
from candaemon.can_io.time_range import WHOLE_DRIVE
from candaemon.config.load import load_config
from candaemon.ego.pose import EgoPose
from candaemon.evaluation.drive_score import DriveScore
from candaemon.frames.frame_block import FrameBlock
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.playback.calibrating import calibrate
from candaemon.radar.scan import Scan
from candaemon.wizard.draft import Choice
from candaemon.wizard.draft_text import draft_text
from candaemon.wizard.proposal import Proposal, Sensor

TRIAL_SECONDS: Final = 30.0
"""s of a log on which a configuration is tried."""
LEAST_NIS: Final = 200
"""Samples of the NIS, below which it says nothing of the noise."""


@dataclass(frozen=True, slots=True)
class Trial:
    """What a pipeline made of the first seconds of a log.

    Attributes:
        pipeline: with its counts.
        score: without ground truth.
        counts: of the log's reader.
        seconds: duration of what was read.
        scans: of each sensor, with the ego pose at their times; None where that was not known.
    """

    pipeline: Pipeline
    score: DriveScore
    counts: LogCounts
    seconds: float
    scans: tuple[tuple[tuple[Scan, EgoPose | None], ...], ...]


class ObservedPipeline(Pipeline):
    """A pipeline whose scans are kept.

    Args:
        binding: the configuration, bound.
    """

    def __init__(self, binding: Binding) -> None:
        super().__init__(binding)
        self.scans: list[list[tuple[Scan, EgoPose | None]]] = [[] for _ in binding.sensors]

    def _cycle(self, scan: Scan, now_ns: int) -> Iterator[Cycle]:
        self.scans[scan.sensor].append((scan, self.ego.pose(scan.time_ns)))
        return super()._cycle(scan, now_ns)


def try_on(binding: Binding, logs: Sequence[Path], seconds: float = TRIAL_SECONDS) -> Trial:
    """Run a configuration on the first seconds of a log.

    Args:
        binding: the configuration, bound.
        logs: the log; several are one drive.
        seconds: of it.

    Raises:
        InputError: there is no such log.
    """
    for log in logs:
        check_log(log)
    channels = {name: bus.index for bus in binding.buses for name in bus.settings.names_in_logs}
    counts, pipeline = LogCounts(), ObservedPipeline(binding)
    score = DriveScore([sensor.settings.cycle_time for sensor in binding.sensors], (0.5,))
    span = [0, 0]
    sequence = ReorderBuffer(round(binding.settings.ordering_window * 1e9))
    blocks = _first(DriveReader(channels, counts, WHOLE_DRIVE).by_time(logs), round(seconds * 1e9), span)
    for cycle in chain(pipeline.run_blocks(sequence.sequenced_blocks(blocks)), pipeline.finish()):
        score.add(cycle)
    return Trial(pipeline, score, counts, (span[1] - span[0]) * 1e-9, tuple(map(tuple, pipeline.scans)))


def _first(blocks: Iterator[LogBlock], length_ns: int, span: list[int]) -> Iterator[LogBlock]:
    """Yield the blocks that begin within a time from the first frame."""
    for block in blocks:
        if not len(block):
            continue
        times = block.time_ns if isinstance(block, FrameBlock) else [frame.time_ns for frame in block]
        begin, end = int(times[0]), int(times[-1])
        span[0] = span[0] or begin
        if begin - span[0] > length_ns:
            return
        span[1] = max(span[1], end)
        yield block


def calibrated(proposal: Proposal) -> Proposal:
    """Return a proposal with what calibration finds in the log: the latencies, and the noise of unfiltered sensors.

    What it does not find stays as it is; a latency that is not found is a guess.
    """
    if proposal.traffic is None or proposal.own is None:
        return proposal
    with tempfile.TemporaryDirectory(prefix="candaemon-init-") as folder:
        path = Path(folder) / "draft.yaml"
        path.write_text(draft_text(proposal, lambda dbc: str(dbc.resolve())), encoding="utf-8")
        binding = bind(load_config(path))
        if binding.ego is None:
            return proposal
        found = calibrate(binding, proposal.traffic.logs, {})
    rows = {row.what: row for row in proposals(binding, found)}
    return replace(proposal, sensors=tuple(_with_findings(sensor, rows) for sensor in proposal.sensors))


def _with_findings(sensor: Sensor, rows: Mapping[str, Finding]) -> Sensor:
    """Return a sensor with what calibration found of it."""
    for key in sensor.mapped.noise if not sensor.mapped.own_filter else ():
        row = rows.get(f"{sensor.name}.noise.{key}")
        if row is not None and row.found is not None and row.uncertainty is not None:
            why = f"calibrated on what stands, ± {row.uncertainty:.2g} in 95 of 100 drives"
            sensor.mapped.noise[key] = Choice(f"{row.found:g}", why)
    row = rows.get(f"{sensor.name}.latency")
    if row is None or row.found is None or row.uncertainty is None:
        choice = Choice("0", "s; the log brakes and turns too little past what stands to tell it", guess=True)
    elif row.proposed is None:
        choice = Choice("0", f"s, calibrated on what stands: {row.found:g} ± {row.uncertainty:.2g} in 95 of 100 drives")
    else:
        why = f"s, calibrated on what stands, ± {row.uncertainty:.2g} in 95 of 100 drives"
        choice = Choice(f"{row.proposed:g}", why)
    return replace(sensor, latency=choice)


def fitted_noise(proposal: Proposal) -> tuple[float, str]:
    """Return the factor on the standard deviations with which the NIS of a trial is as expected, and the evidence.

    The errors of a radar that filters by itself are alike from scan to scan: a NIS below the expected one is no reason
    to take them for smaller than they scatter.
    """
    if proposal.traffic is None or proposal.own is None:
        return 1.0, ""
    least = 1.0 if any(sensor.mapped.own_filter for sensor in proposal.sensors) else 0.0
    factor, told = 1.0, ""
    with tempfile.TemporaryDirectory(prefix="candaemon-init-") as folder:
        path = Path(folder) / "draft.yaml"
        for _ in range(2):
            path.write_text(draft_text(proposal, lambda dbc: str(dbc.resolve()), factor), encoding="utf-8")
            nis = try_on(bind(load_config(path)), proposal.traffic.logs).score.nis
            if nis.samples < LEAST_NIS or not nis.mean > 0:
                return factor, told
            ratio = nis.mean / nis.expected
            if 0.85 < ratio < 1.15 or (ratio < 1.0 and factor <= least):
                told = f"the NIS of the first {TRIAL_SECONDS:g} s is {nis.mean:.2f}, expected {nis.expected:.2f}"
                return factor, told
            factor = max(factor * min(max(ratio**0.5, 0.5), 2.5), least)
            told = f"times {factor:.2f} for the NIS, which was {ratio:.2f} times the expected one"
    return factor, told
