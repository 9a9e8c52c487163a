"""Runs a scenario through a configuration's sensors and the whole pipeline, and compares with the truth."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from candaemon.config.tracker import TrackerSettings
from candaemon.evaluation.metrics import evaluate
from candaemon.evaluation.results import Evaluation
from candaemon.evaluation.tables import TRACK_COLUMNS, TRUTH_COLUMNS, TrackWriter, track_columns
from candaemon.files.outputs import OutputFile
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario, load_scenario
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding as bound
from tests.support.paths import ROOT


def scenario(name: str) -> Scenario:
    """Load one of the project's scenarios."""
    return load_scenario(ROOT / "config" / "scenarios" / f"{name}.yaml")


def drive(
    config: str, drama: Scenario, seed: int, tracker: TrackerSettings | None = None
) -> tuple[Evaluation, Pipeline]:
    """Simulate, track and evaluate, with the configuration's tracker unless another is given."""
    binding = bound(config)
    if tracker is not None:
        told = binding.settings.model_copy(update={"tracker": tracker})
        binding = replace(binding, loaded=replace(binding.loaded, config=told))
    simulation, pipeline = simulate(drama, binding, seed), Pipeline(binding)
    names = [sensor.name for sensor in binding.sensors]
    with tempfile.TemporaryDirectory() as folder:
        tracks, truth = Path(folder) / "tracks.csv", Path(folder) / "truth.csv"
        with OutputFile(tracks) as file, TrackWriter(file, TRACK_COLUMNS) as table:
            for cycle in pipeline.run(simulation.frames()):
                table.write_cycle(cycle.obstacles.time_ns, track_columns(cycle.obstacles, names))
        with OutputFile(truth) as file, TrackWriter(file, TRUTH_COLUMNS) as table:
            for row in simulation.truth():
                table.write_cycle(row.time_ns, row.columns)
        return evaluate(tracks, truth), pipeline
