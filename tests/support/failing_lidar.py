"""A lidar that fails beside a radar: the drive, the radar alone, and the errors of what is told."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import Simulation
from candaemon.tracking.obstacles import TENTATIVE
from tests.support.paths import ROOT

SETTLED = 3.0
"""s, from which on errors count."""
LOST = 4.0
"""m, beyond which an actor has no obstacle."""


def scenario(faults: Sequence[Mapping[str, Any]], duration: float, measurement: Mapping[str, Any]) -> Scenario:
    """Return a drive behind a car that brakes, with one beside on either hand."""
    braking = ({"until": 5.0}, {"until": 8.0, "acceleration": -1.5}, {"until": 11.0, "acceleration": 1.5})
    actors = (
        {"name": "ahead", "start": {"x": 30.0, "y": 0.0, "speed": 15.0}, "segments": braking},
        {"name": "left", "start": {"x": 20.0, "y": 3.5, "speed": 16.0}},
        {"name": "right", "start": {"x": 45.0, "y": -3.5, "speed": 14.0}},
    )
    told = {"duration": duration, "ego": {"start": {"speed": 15.0}}, "actors": actors, "sensor_faults": tuple(faults)}
    return Scenario.model_validate(told | {"measurement": dict(measurement)})


def failing(*failures: tuple[str, float, float], amount: float | None = None) -> list[dict[str, Any]]:
    found = []
    for kind, begin, end in failures:
        told: dict[str, Any] = {"sensor": "lidar", "kind": kind, "begin": begin, "end": end}
        found.append(told | ({"amount": 5.0} if kind == "biased" else {} if amount is None else {"amount": amount}))
    return found


def alone(folder: Path) -> Binding:
    """Return the configuration with the radar alone."""
    tree = yaml.safe_load((ROOT / "config" / "radar_lidar.yaml").read_text(encoding="utf-8"))
    del tree["sensors"]["lidar"]
    for part in (tree["ego"], tree["output"], *tree["sensors"].values()):
        part["dbc"] = str(ROOT / "config" / part["dbc"])
    path = folder / "radar.yaml"
    path.write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    return bind(load_config(path))


def squared_errors(
    pipeline: Pipeline, simulation: Simulation, watch: Callable[[float], object] = lambda _: None
) -> Iterator[tuple[float, float, float]]:
    """Yield time and squared errors of position and velocity of each actor in each output from 3 s on.

    Args:
        pipeline: what tracks.
        simulation: of what is to be tracked.
        watch: takes the time of each output, s of the drive.
    """
    drive = simulation.scenario
    truth = {cycle.time_ns: cycle.columns for cycle in simulation.truth()}
    times = np.array(sorted(truth))
    for cycle in pipeline.run(simulation.frames()):
        found = cycle.reported
        if found is None:
            continue
        time = cycle.time_ns * 1e-9 - drive.start_time
        watch(time)
        if time < SETTLED:
            continue
        true = truth[int(times[np.abs(times - found.time_ns).argmin()])]
        for row in range(len(drive.actors)):
            apart = np.hypot(found.x - true["x"][row], found.y - true["y"][row])
            nearest = int(np.where(found.state != TENTATIVE, apart, np.inf).argmin())
            assert apart[nearest] < LOST
            velocity = (found.vx[nearest] - true["vx"][row], found.vy[nearest] - true["vy"][row])
            yield time, float(apart[nearest]) ** 2, float(np.hypot(*velocity)) ** 2
