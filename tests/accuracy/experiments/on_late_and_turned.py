"""Sensors that are later and turned further than the configuration says: are they found, and is all as well then?"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.binding.bound import Binding
from candaemon.config.calibration import CalibrationSettings
from candaemon.evaluation.pairing import NOBODY, pair
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import Simulation
from tests.accuracy.experiments.finding import Effort, Experiment, Finding
from tests.accuracy.scores import OPTIONS
from tests.accuracy.simulated_runs import bound, cycles_of, scenario_of, track_rows, truth_rows
from tests.support.paths import ROOT

RADARS: Final = ("esr_ins", "ars408", "toyota_rav4")
LONGEST_LATENCY, LARGEST_YAW_DEG = 0.250, 4.0
"""s and deg, up to which faults are drawn."""
SETTLED: Final = 20.0
"""s of driving, after which the sensor has to be known."""
QUANTITIES: Final = (("position", "m"), ("velocity", "m/s"))


@dataclass(frozen=True, slots=True)
class Drive:
    """What became of a drive.

    Attributes:
        squares: sums of the squared errors of position and velocity after the sensor has to be known (2,).
        pairs: how many.
        latency, yaw: as estimated by then, s and rad.
    """

    squares: Floats
    pairs: int
    latency: float
    yaw: float


def told(radar: str, effort: Effort) -> Binding:
    """Return a configuration that applies what it learns of its sensors."""
    of = bound(ROOT / "config" / f"{radar}.yaml", effort.tracker)
    config = of.settings.model_copy(update={"calibration": CalibrationSettings(apply=True)})
    return replace(of, loaded=replace(of.loaded, config=config))


def faulty(latency: float, yaw_deg: float) -> Scenario:
    """Return the scenario with a fault of all its sensors."""
    drive = scenario_of(ROOT / "config" / "scenarios" / "late_and_turned.yaml")
    frames = drive.frames.model_copy(update={"latency": latency})
    return drive.model_copy(
        update={"frames": frames, "measurement": drive.measurement.model_copy(update={"turned_deg": yaw_deg})}
    )


def driven(binding: Binding, drive: Scenario, seed: int) -> Drive:
    """Return what becomes of a drive."""
    simulation, pipeline = Simulation(drive, binding, seed), Pipeline(binding)
    begin_ns, cycles, latency, yaw = round((drive.start_time + SETTLED) * 1e9), [], 0.0, 0.0
    for cycle in cycles_of(simulation.frames(), pipeline):
        if cycle.obstacles.time_ns < begin_ns:
            assert pipeline.calibrator is not None
            latency, yaw = pipeline.calibrator.state.sensors[0].mean[:2].tolist()
        else:
            cycles.append(cycle.obstacles)
    pairing = pair(track_rows(cycles).table, truth_rows(simulation), OPTIONS)
    rows = np.flatnonzero(pairing.visible & (pairing.partner != NOBODY))
    tracks, truth = pairing.tracks.take(pairing.partner[rows]), pairing.truth.take(rows)
    squares = [
        np.sum((tracks.x - truth.x) ** 2 + (tracks.y - truth.y) ** 2),
        np.sum((tracks.vx - truth.vx) ** 2 + (tracks.vy - truth.vy) ** 2),
    ]
    return Drive(np.array(squares), len(rows), latency, yaw)


def run(effort: Effort) -> Iterator[Finding]:
    """Yield the figures by radar."""
    for radar in RADARS:
        binding = told(radar, effort)
        late, turned, sound, found = [], [], [], []
        for seed in effort.seeds:
            chance = np.random.default_rng((seed, RADARS.index(radar)))
            latency, yaw_deg = chance.uniform(0, LONGEST_LATENCY), chance.uniform(-LARGEST_YAW_DEG, LARGEST_YAW_DEG)
            sound.append(driven(binding, faulty(0.0, 0.0), seed))
            found.append(driven(binding, faulty(latency, yaw_deg), seed))
            late.append(found[-1].latency - latency)
            turned.append(math.degrees(found[-1].yaw) - yaw_deg)
        yield Finding(f"{radar}: latency off after {SETTLED:g} s", 1e3 * float(np.abs(late).max()), "ms", most=20.0)
        yield Finding(f"{radar}: yaw off after {SETTLED:g} s", float(np.abs(turned).max()), "deg", most=0.3)
        for k, (name, unit) in enumerate(QUANTITIES):
            whole, with_fault = (_rms(drives, k) for drives in (sound, found))
            yield Finding(f"{radar}: {name} without the fault", whole, unit)
            yield Finding(f"{radar}: {name} with it", with_fault, unit, most=1.1 * whole)


def _rms(drives: list[Drive], quantity: int) -> float:
    pairs = sum(one.pairs for one in drives)
    return math.sqrt(sum(one.squares[quantity] for one in drives) / pairs) if pairs else math.nan


LATE_AND_TURNED: Final = Experiment(
    "is a late and turned sensor found while driving, and is all as well then as without the fault?",
    (
        ("fault", f"latency of 0 to {LONGEST_LATENCY:g} s and yaw of ± {LARGEST_YAW_DEG:g} deg, drawn for each drive"),
        ("off", "largest over the drives: the estimate at that time less what was drawn"),
        ("position, velocity", f"RMSE of paired obstacles from {SETTLED:g} s on; wanted: at most a tenth more"),
        ("", "a yaw below three standard deviations, about half a degree, is not corrected by then"),
    ),
    10,
    run,
)
