"""Radars that filter their objects by themselves: their own later word, beside holding the last one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import yaml

from candaemon.arrays import Floats, Integers
from candaemon.evaluation.drive_score import DriveScore, PredictionScore
from candaemon.evaluation.object_runs import ObjectRuns
from candaemon.evaluation.tables import STATES, STATIONARY
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.playback.predictions import PredictionQueue
from candaemon.playback.replay import HORIZONS
from candaemon.radar.detections import Detections
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import Simulation
from candaemon.tracking.obstacles import TENTATIVE
from tests.accuracy.experiments.finding import Effort, Experiment, Finding
from tests.accuracy.oracle import Sources, sources
from tests.accuracy.simulated_runs import RememberingSimulation, bound, cycles_of
from tests.support.paths import ROOT

WALKS: Final = (0.06, 0.4)
"""m²/s, of the reflections across the sight, as measured on radars of two makers."""
CONFIGS: Final = ("esr_ins", "ars408")
SCENARIOS: Final = ("traffic_motorway", "traffic_town")
SECONDS: Final = 15.0
WORSE: Final = 1.05
"""How many times the error of holding is allowed."""
STANDS: Final = 1.0
"""m/s, below which an object is held in place."""
STANDING: Final = 0.3
"""m/s, the largest RMS speed of what stands."""


class LaterWord(DriveScore):
    """Errors of predictions of where the radar will place its objects, and of holding its last word.

    Args:
        pipeline: that makes the cycles.
        truth: what the detections are of.
        standing: ids in the truth of what stands.

    Attributes:
        held: errors of holding, of the same objects and times.
        squares, samples: of the speed of confirmed obstacles of what stands, (m/s)².
    """

    def __init__(self, pipeline: Pipeline, truth: Sources, standing: frozenset[int]) -> None:
        cycle_times = [sensor.settings.cycle_time for sensor in pipeline.binding.sensors]
        super().__init__(cycle_times, HORIZONS)
        self.held = PredictionScore(HORIZONS, cycle_times)
        self.squares, self.samples = 0.0, 0
        self._truth, self._standing = truth, standing
        self._ego = pipeline.ego
        self._radar_runs = ObjectRuns(cycle_times)
        self._words: dict[tuple[int, int], tuple[Integers, Floats, Floats]] = {}

    def add(self, cycle: Cycle) -> None:
        """Take a cycle."""
        detections, obstacles, update = cycle.detections, cycle.obstacles, cycle.update
        if detections is None or not update:
            return
        run = self._radar_runs.update(detections.sensor, detections.time_ns, detections.object_id, detections.new)
        for score in (self.predictions, self.held):
            score.measure(detections.sensor, detections.time_ns, run, detections.x, detections.y)
        used, key = update.detection, (detections.sensor, detections.time_ns)
        self._words[key] = run[used], detections.measurement.position[used], told_velocity(detections)[used]
        source = self._truth.get(key, {})
        stands = [source.get(each) in self._standing for each in obstacles.used_object.tolist()]
        rows = obstacles.used_row[np.array(stands, dtype=np.bool_)]
        rows = rows[obstacles.state[rows] > TENTATIVE]
        self.squares += float((obstacles.vx[rows] ** 2 + obstacles.vy[rows] ** 2).sum())
        self.samples += len(rows)

    def add_predictions(self, sensor: int, time_ns: int, horizon: int, x: Floats, y: Floats) -> None:
        """Take the predictions of one scan's used detections for one horizon."""
        run, place, velocity = self._words[sensor, time_ns]
        self.predictions.predict(sensor, time_ns, horizon, run, x, y)
        ahead = HORIZONS[horizon]
        pose = self._ego.pose(time_ns + round(ahead * 1e9))
        if pose is not None:
            held = pose.to_vehicle(place + ahead * velocity)
            self.held.predict(sensor, time_ns, horizon, run, held[:, 0], held[:, 1])


def told_velocity(detections: Detections) -> Floats:
    """Return the velocity over ground as the radar tells it (n, 2), 0 of what stands."""
    measurement = detections.measurement
    unit = measurement.position - measurement.origin
    unit = unit / np.maximum(np.hypot(*unit.T), 1e-3)[:, None]
    velocity: Floats = np.zeros_like(unit)
    for part in measurement.projections:
        velocity += part.value[:, None] * part.direction
    if measurement.range_rate is not None:
        velocity = (measurement.range_rate + unit @ measurement.velocity)[:, None] * unit
    velocity[np.hypot(*velocity.T) < STANDS] = 0.0
    return velocity


def standing_ids(simulation: Simulation) -> frozenset[int]:
    """Return the ids in the truth of the posts and rails of a simulation."""
    standing: set[int] = set()
    for cycle in simulation.truth():
        standing.update(cycle.columns["id"][cycle.columns["state"] == STATES[STATIONARY]].tolist())
    return frozenset(standing)


def filtered_scenario(name: str, walk: float, seconds: float) -> Scenario:
    """Return a shipped scenario, seen by a radar that filters by itself."""
    data: dict[str, Any] = yaml.safe_load((ROOT / "config" / "scenarios" / f"{name}.yaml").read_text(encoding="utf-8"))
    data["duration"] = min(seconds, data["duration"])
    measurement = data.setdefault("measurement", {})
    measurement["traffic"] = measurement.get("traffic", {}) | {"own_filter": {"walk": walk}}
    return Scenario.model_validate(data)


def run(
    effort: Effort,
    walks: tuple[float, ...] = WALKS,
    configs: tuple[str, ...] = CONFIGS,
    scenarios: tuple[str, ...] = SCENARIOS,
) -> Iterator[Finding]:
    """Yield the figures of each radar and walk."""
    chosen = (("default", None), *effort.tracker)
    for config in configs:
        binding = bound(ROOT / "config" / f"{config}.yaml", chosen)
        for walk in walks:
            scores = []
            for scenario in scenarios:
                drive = filtered_scenario(scenario, walk, min(effort.seconds, SECONDS))
                for seed in effort.seeds:
                    pipeline = Pipeline(binding)
                    simulation = RememberingSimulation(drive, binding, seed)
                    score = LaterWord(pipeline, sources(simulation), standing_ids(simulation))
                    predictions = PredictionQueue(pipeline, HORIZONS, None, score)
                    for cycle in cycles_of(simulation.frames(), pipeline):
                        score.add(cycle)
                        predictions.tell(predictions.add(cycle))
                    predictions.tell(predictions.finish())
                    scores.append(score)
            name = f"{config}, walk {walk:g} m²/s"
            for row, ahead in enumerate(HORIZONS):
                for axis, direction in (("x", "along"), ("y", "across")):
                    held = _rmse([score.held for score in scores], row, axis)
                    ours = _rmse([score.predictions for score in scores], row, axis)
                    yield Finding(f"{name}: {ahead:g} s ahead, {direction}, holding", held)
                    yield Finding(f"{name}: {ahead:g} s ahead, {direction}", ours, most=WORSE * held)
            samples = sum(score.samples for score in scores)
            speed = math.sqrt(sum(score.squares for score in scores) / samples) if samples else math.nan
            yield Finding(f"{name}: speed of what stands", speed, "m/s", most=STANDING)


def _rmse(scores: list[PredictionScore], row: int, axis: str) -> float:
    """Return the RMSE of one horizon along an axis over several drives."""
    results = [score.result()[row] for score in scores]
    samples = sum(one.samples for one in results)
    square = sum(getattr(one, axis) ** 2 * one.samples for one in results if one.samples)
    return math.sqrt(square / samples) if samples else math.nan


OWN_FILTERS: Final = Experiment(
    "does it tell radars that filter by themselves no worse what they will say than their last word does?",
    (
        ("walk", "the simulation's own_filter with this walk across the sight, and slides; its defaults otherwise"),
        ("drives", f"{', '.join(SCENARIOS)}, {SECONDS:g} s each, configurations without a tracker section"),
        ("ahead", "RMSE of where a reflection is expected, beside where the radar places it then, vehicle axes"),
        ("holding", "its last reported place, moved on with the reported velocity over ground; of a radar that tells"),
        ("", f"range rate alone, with that along the line of sight; below {STANDS:g} m/s held in place"),
        ("what stands", "RMS speed of the confirmed obstacles of detections that are, in truth, of posts and rails"),
    ),
    2,
    run,
)
