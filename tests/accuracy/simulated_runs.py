"""One run: a scenario, simulated and replayed in this process, as tables of tracks and of truth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from candaemon.arrays import Floats, Integers
from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.config.tracker import TrackerSettings
from candaemon.evaluation.tables import STATES, TrackTable
from candaemon.frames.bodies import CLASSES
from candaemon.frames.frame import Frame
from candaemon.frames.frame_block import block_of
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario, load_scenario
from candaemon.simulation.simulate import Simulation
from candaemon.simulation.slot_reports import SlotReport
from candaemon.tracking.obstacles import Obstacles

_FRAMES_AT_ONCE = 8192


@dataclass(frozen=True, slots=True)
class Job:
    """What to run.

    Attributes:
        config: YAML of the configuration.
        scenario: YAML of the scenario.
        seed: of the simulation.
        tracker: settings of the tracker that replace those of the configuration, as (dotted key, value).
    """

    config: Path
    scenario: Path
    seed: int
    tracker: tuple[tuple[str, Any], ...] = ()


class RememberingSimulation(Simulation):
    """A simulation that simulates the sensors once, however often it is asked."""

    def __init__(self, scenario: Scenario, binding: Binding, seed: int) -> None:
        super().__init__(scenario, binding, seed)
        self._reports: dict[int, list[tuple[int, SlotReport]]] = {}

    def reports(self, sensor: int) -> Iterator[tuple[int, SlotReport]]:
        """Yield the reports of one sensor."""
        if sensor not in self._reports:
            self._reports[sensor] = list(super().reports(sensor))
        return iter(self._reports[sensor])


@dataclass(frozen=True, slots=True)
class TrackRows:
    """A table of tracks, with the whole covariance where the tracker tells it.

    Attributes:
        table: n rows, ordered by time, then id.
        covariance: of x, y, vx, vy, vehicle axes (n, 4, 4), or None.
        broken: rows left out, because their place or velocity is no number.
    """

    table: TrackTable
    covariance: Floats | None
    broken: int = 0


@lru_cache(maxsize=32)
def bound(config: Path, tracker: tuple[tuple[str, Any], ...]) -> Binding:
    """Bind a configuration without output, with other settings of its tracker."""
    loaded = load_config(config)
    settings = with_settings(loaded.config.tracker, tracker)
    return bind(replace(loaded, config=loaded.config.model_copy(update={"output": None, "tracker": settings})))


def with_settings(settings: TrackerSettings, changes: Sequence[tuple[str, Any]]) -> TrackerSettings:
    """Return settings of a tracker with some replaced.

    Args:
        settings: of the configuration.
        changes: (dotted key, value); one that ends in `.kind` drops what its section had; the key `default` drops all.
    """
    data: dict[str, Any] = settings.model_dump(exclude_unset=True)
    for key, value in changes:
        if key == "default":
            data = {}
            continue
        *path, last = key.split(".")
        section = data
        for step in path:
            section = section.setdefault(step, {})
        if last == "kind":
            section.clear()
        section[last] = value
    return TrackerSettings.model_validate(data)


@lru_cache(maxsize=64)
def scenario_of(path: Path) -> Scenario:
    """Load a scenario."""
    return load_scenario(path)


def simulated(job: Job) -> tuple[Simulation, Pipeline]:
    """Return the simulation of a job and a fresh pipeline for its frames."""
    binding = bound(job.config, job.tracker)
    return RememberingSimulation(scenario_of(job.scenario), binding, job.seed), Pipeline(binding)


def cycles_of(frames: Iterable[Frame], pipeline: Pipeline) -> Iterator[Cycle]:
    """Yield the cycles of frames, up to the last one."""
    remaining = iter(frames)
    blocks = iter(lambda: list(islice(remaining, _FRAMES_AT_ONCE)), [])
    yield from pipeline.run_blocks(block_of(block) for block in blocks)
    yield from pipeline.finish()


def track_rows(obstacles: Sequence[Obstacles]) -> TrackRows:
    """Return the obstacles of many cycles as one table."""
    parts = [{name: getattr(one, name) for name in _names(one)} for one in obstacles]
    covariances = [part.pop("covariance", None) for part in parts]
    times = np.repeat([one.time_ns for one in obstacles], [len(one) for one in obstacles])
    table, order = _table(times, parts)
    if any(one is None for one in covariances) or not covariances:
        covariance = None
    else:
        covariance = np.concatenate([np.asarray(one) for one in covariances])[order]
    sound = np.asarray(np.isfinite(np.stack([table.x, table.y, table.vx, table.vy])).all(axis=0))
    if sound.all():
        return TrackRows(table, covariance)
    return TrackRows(table.take(sound), None if covariance is None else covariance[sound], int((~sound).sum()))


def truth_rows(simulation: Simulation) -> TrackTable:
    """Return the truth of a simulation."""
    parts, times = [], []
    for cycle in simulation.truth():
        codes = np.array([STATES.index(str(name)) for name in cycle.columns["state"]], dtype=np.int8)
        kinds = np.array([CLASSES.index(str(name)) for name in cycle.columns["class"]], dtype=np.int8)
        parts.append({**cycle.columns, "state": codes, "kind": kinds})
        times.append(np.full(len(codes), cycle.time_ns))
    return _table(np.concatenate([np.empty(0, np.int64), *times]), parts)[0]


def _names(obstacles: Obstacles) -> set[str]:
    """Return the columns that obstacles share with the table, and their covariance."""
    shared = {*(each.name for each in fields(TrackTable)), "covariance"} - {"time_ns"}
    return {each.name for each in fields(obstacles)} & shared


def _table(times: Integers, parts: Sequence[Mapping[str, Any]]) -> tuple[TrackTable, Integers]:
    """Return columns of many cycles as a table, and which of their rows it holds; NaN where there is no such column."""
    rows = len(times)
    columns: dict[str, Any] = {"time_ns": times.astype(np.int64)}
    for each in fields(TrackTable):
        dtype, empty = _FORMS.get(each.name, (np.float64, math.nan))
        known = [part[each.name] for part in parts if part.get(each.name) is not None]
        if each.name in columns:
            continue
        if known and len(known) == len(parts):
            columns[each.name] = np.concatenate(known).astype(dtype)
        else:
            columns[each.name] = np.full(rows, empty, dtype=dtype)
    # of two cycles at one time the later one counts
    order = np.lexsort((-np.arange(rows), columns["id"], columns["time_ns"]))
    twice = np.zeros(rows, dtype=bool)
    twice[1:] = (np.diff(columns["time_ns"][order]) == 0) & (np.diff(columns["id"][order]) == 0)
    order = order[~twice]
    return TrackTable(**{name: column[order] for name, column in columns.items()}), order


_FORMS: Mapping[str, tuple[Any, Any]] = {
    "id": (np.int64, 0),
    "state": (np.int8, 0),
    "kind": (np.int8, 0),
    "objects": (np.object_, ""),
}
"""Type of the columns that are no numbers, and what stands where there is none."""
