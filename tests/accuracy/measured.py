"""Runs jobs, in a pool of processes, and adds their scores up."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from multiprocessing import get_context

from candaemon.errors import CandaemonError
from candaemon.evaluation.pairing import pair
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.simulate import Simulation
from tests.accuracy.oracle import informed, sources
from tests.accuracy.scores import OPTIONS, Score, score_of, scored
from tests.accuracy.simulated_runs import Job, cycles_of, simulated, track_rows, truth_rows
from tests.accuracy.slot_filters import GRID, SlotFilters, with_simulated_noise

DEFAULT = "candaemon"
ORACLE = "O"


def naive_name(density: float) -> str:
    """Return the name of reference N with one process noise."""
    return f"N {density:g}"


def run(job: Job) -> dict[str, Score]:
    """Return the scores of one run: the project's, and those of the references."""
    simulation, pipeline = simulated(job)
    cycles = list(cycles_of(simulation.frames(), pipeline))
    truth, detected = truth_rows(simulation), sources(simulation)
    scores = {DEFAULT: scored(track_rows([cycle.obstacles for cycle in cycles]), truth, detected)}
    told = informed(pipeline.binding, cycles, detected)
    if told is not None:
        scores[ORACLE] = scored(track_rows(told), truth)
    naive = _filtered(simulation, pipeline, cycles)
    pairing = pair(naive.rows_of(len(GRID) // 2).table, truth, OPTIONS)
    for k, density in enumerate(GRID):
        rows = naive.rows_of(k)
        scores[naive_name(density)] = score_of(replace(pairing, tracks=rows.table), rows.covariance)
    return scores


def _filtered(simulation: Simulation, pipeline: Pipeline, cycles: Sequence[Cycle]) -> SlotFilters:
    """Return the filters of reference N after all detections."""
    sensors = [sensor.settings for sensor in pipeline.binding.sensors]
    filters = SlotFilters(tuple(each.cycle_time for each in sensors))
    noise = simulation.scenario.measurement.noise
    for cycle in cycles:
        if cycle.detections is not None:
            sensor = sensors[cycle.detections.sensor]
            filters.step(with_simulated_noise(cycle.detections, sensor, noise, cycle.pose), cycle.pose)
    return filters


@dataclass(slots=True)
class Measured:
    """The scores of all runs.

    Attributes:
        scores: (scenario, configuration) → tracker → score.
        refused: (scenario, configuration) → why there is none.
    """

    scores: dict[tuple[str, str], dict[str, Score]] = field(default_factory=dict)
    refused: dict[tuple[str, str], str] = field(default_factory=dict)

    def add(self, job: Job, found: dict[str, Score]) -> None:
        """Add the scores of a run."""
        known = self.scores.setdefault((job.scenario.stem, job.config.stem), {})
        for name, score in found.items():
            known[name] = known[name] + score if name in known else score

    def total(self, tracker: str, *, scenario: str | None = None, config: str | None = None) -> Score | None:
        """Return the sum of a tracker's scores, of one scenario or configuration or of all; None without any."""
        chosen = [
            found[tracker]
            for (one, other), found in sorted(self.scores.items())
            if scenario in (None, one) and config in (None, other) and tracker in found
        ]
        if not chosen:
            return None
        total = chosen[0]
        for score in chosen[1:]:
            total = total + score
        return total

    def best_density(self) -> float:
        """Return the process noise of N with the least product of position and velocity error over the whole set."""

        def cost(density: float) -> float:
            total = self.total(naive_name(density))
            return float("inf") if total is None else total.value("position") * total.value("velocity")

        return min(GRID, key=cost)


def measured(jobs: Sequence[Job], processes: int, tell: Callable[[str], None]) -> Measured:
    """Run all jobs.

    Args:
        jobs: what to run.
        processes: at once; 1: in this one.
        tell: takes lines of progress.
    """
    result = Measured()
    begun = time.monotonic()
    for count, (job, found) in enumerate(_results(jobs, processes), start=1):
        name = f"{job.scenario.stem} {job.config.stem} {job.seed}"
        if isinstance(found, CandaemonError):
            result.refused[job.scenario.stem, job.config.stem] = found.message
        else:
            # in order of arrival: sums of floats differ in their last digit, no more
            result.add(job, found)
        left = (time.monotonic() - begun) / count * (len(jobs) - count)
        tell(f"{count} of {len(jobs)}  {name}  {left:.0f} s left")
    return result


def _results(jobs: Sequence[Job], processes: int) -> Iterator[tuple[Job, dict[str, Score] | CandaemonError]]:
    """Yield each job with its scores, or with why it cannot run."""
    if processes == 1:
        for job in jobs:
            yield job, _attempt(job)
        return
    # a process a core: threads of the linear algebra would only wait for each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        waiting = {pool.submit(_attempt, job): job for job in jobs}
        for done in as_completed(waiting):
            yield waiting[done], done.result()


def _attempt(job: Job) -> dict[str, Score] | CandaemonError:
    try:
        return run(job)
    except CandaemonError as error:
        return error


def to_stderr(line: str) -> None:
    """Write a line of progress: over the one before on a terminal."""
    end = "\n" if not sys.stderr.isatty() else "\x1b[K\r"
    print(line, end=end, file=sys.stderr, flush=True)
