"""One car that drives around our vehicle, through the fields of view of twelve radars."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import yaml

from candaemon.arrays import Booleans, Floats
from candaemon.evaluation.tables import TrackTable
from candaemon.pipeline.pipeline import Pipeline
from candaemon.radar.mounting import SensorView
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import Simulation
from candaemon.tracking.obstacles import TENTATIVE
from tests.accuracy.experiments.finding import Effort, Experiment, Finding
from tests.accuracy.simulated_runs import bound, cycles_of, truth_rows
from tests.support.paths import ROOT

DIRECTIONS: Final = (0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180)
"""deg, where the radars look, in the order in which they are added."""
NUMBERS: Final = (1, 2, 5, 12)
"""Radars that are there."""
FIRST_HALF, HALF = 45.0, 22.5
"""deg, half of the field of view of the first radar and of the others."""
RADIUS, SPEED = 20.0, 8.0
"""m and m/s of the car's course around the rear axle."""
ROUND: Final = 2 * math.pi * RADIUS / SPEED
"""s, once around."""
SLOTS: Final = 8


def configuration(
    number: int, folder: Path, slots: int = SLOTS, halves: tuple[float, float] = (FIRST_HALF, HALF)
) -> Path:
    """Write a configuration of radars, each on a bus of its own, ESR and ARS408 in turn; return its path.

    Args:
        number: of radars.
        folder: for the file.
        slots: objects that each can tell.
        halves: deg, half of the field of view of the first radar and of the others.
    """
    shipped = [yaml.safe_load((ROOT / "config" / f"{name}.yaml").read_text()) for name in ("esr_ins", "ars408")]
    sensors: dict[str, Any] = {}
    for k, direction in enumerate(DIRECTIONS[:number]):
        front = shipped[k % 2]["sensors"]["front"]
        yaw = math.radians(direction)
        sensors[f"radar_{k:02d}"] = front | {
            "bus": f"bus_{k}",
            "dbc": str(ROOT / "dbc" / Path(front["dbc"]).name),
            # the corners and sides of a car of 4.6 m by 1.8 m
            "mount": {
                "x": round(1.3 + 2.3 * math.cos(yaw), 3),
                "y": round(0.9 * math.sin(yaw), 3),
                "yaw_deg": direction,
            },
            "cycle_time": 0.05,
            "timeout": 0.035,
            "objects": front["objects"] | {"slots": slots},
            "field_of_view": {"range": 60, "azimuth_deg": halves[min(k, 1)]},
        }
    buses = {sensor["bus"]: {"channel": f"can{k}"} for k, sensor in enumerate(sensors.values())}
    path = folder / f"ring_{number}.yaml"
    path.write_text(yaml.safe_dump({"name": "ring", "buses": buses, "ego": {"kind": "static"}, "sensors": sensors}))
    return path


def scenario(seconds: float) -> Scenario:
    """Return the drive: the car begins ahead and turns to the left, once around."""
    car = {
        "name": "car",
        "start": {"x": RADIUS, "y": 0, "speed": SPEED, "heading_deg": 90},
        "segments": [{"yaw_rate_deg": math.degrees(SPEED / RADIUS)}],
    }
    return Scenario.model_validate(
        {"duration": min(seconds, 1.25 * ROUND), "actors": [car], "measurement": {"clutter": 0}}
    )


@dataclass(frozen=True, slots=True)
class Lap:
    """What the tracker made of a lap, one entry a cycle in which the car was in some field of view.

    Attributes:
        id: of the confirmed obstacle nearest to the car; 0 where there is none.
        error: its distance from the car's reference point, m; NaN where there is none.
        extra: further confirmed obstacles.
        in_first: whether the car was in the first radar's field of view.
        views: in how many of those of all twelve it was.
    """

    id: list[int]
    error: Floats
    extra: list[int]
    in_first: Booleans
    views: Floats


def course(config: Path, seconds: float) -> TrackTable:
    """Return the truth of the car, in steps of a scan of the only radar of a configuration."""
    return truth_rows(Simulation(scenario(seconds), bound(config, ()), 1))


def lap(config: Path, effort: Effort, seed: int, truth: TrackTable, whole: tuple[SensorView, ...]) -> Lap:
    """Return what the tracker makes of a lap.

    Args:
        config: YAML of the radars.
        effort: with the tracker's settings and the seconds that are driven.
        seed: of the simulation.
        truth: of the car.
        whole: what the twelve can see.
    """
    binding = bound(config, effort.tracker)
    frames = Simulation(scenario(effort.seconds), binding, seed).frames()
    views = whole[: len(binding.sensors)]
    identity, errors, extra, places = [], [], [], []
    for cycle in cycles_of(frames, Pipeline(binding)):
        obstacles = cycle.obstacles
        time_ns = obstacles.time_ns
        place = np.array([np.interp(time_ns, truth.time_ns, each) for each in (truth.x, truth.y)])
        if not any(view.sees(place[None])[0] for view in views):
            continue
        rows = np.flatnonzero(obstacles.state > TENTATIVE)
        off = np.hypot(obstacles.x[rows] - place[0], obstacles.y[rows] - place[1])
        nearest = int(off.argmin()) if len(off) else -1
        identity.append(int(obstacles.id[rows[nearest]]) if len(off) else 0)
        errors.append(off[nearest] if len(off) else math.nan)
        extra.append(max(len(off) - 1, 0))
        places.append(place)
    at = np.array(places)
    seen = np.array([view.sees(at) for view in whole])
    return Lap(identity, np.array(errors), extra, seen[0], seen.sum(axis=0))


def run(effort: Effort, numbers: tuple[int, ...] = NUMBERS) -> Iterator[Finding]:
    """Yield the figures by the number of radars."""
    before: dict[str, float] = {}
    with TemporaryDirectory() as folder:
        full = bound(configuration(len(DIRECTIONS), Path(folder)), effort.tracker)
        whole = tuple(SensorView(each.settings.mount, each.settings.field_of_view) for each in full.sensors)
        truth = course(configuration(1, Path(folder)), effort.seconds)
        for number in numbers:
            config = configuration(number, Path(folder))
            laps = [lap(config, effort, seed, truth, whole) for seed in effort.seeds]
            found = {
                "error in the first radar's view": _rms(laps, overlap=None),
                "error where only it looks": _rms(laps, overlap=False),
                "error in it where views of the twelve overlap": _rms(laps, overlap=True),
            }
            for name, value in found.items():
                bounded = "only" not in name
                yield Finding(f"{number}: {name}", value, most=before.get(name, math.inf) if bounded else math.inf)
            before = found
            cycles = sum(len(one.id) for one in laps)
            duplicates = sum(extra > 0 for one in laps for extra in one.extra)
            yield Finding(f"{number}: cycles with duplicates", duplicates, f"of {cycles}", most=0)
            several = sum(len(set(one.id) - {0}) != 1 for one in laps)
            most = 0 if number == len(DIRECTIONS) else math.inf
            yield Finding(f"{number}: laps in which the id changes", several, f"of {len(laps)}", most=most)
            silent = sum(Counter(one.id)[0] for one in laps)
            yield Finding(f"{number}: cycles in view without an obstacle", 100 * silent / cycles, "%")


def _rms(laps: list[Lap], overlap: bool | None) -> float:
    """Return the RMS of the errors in the first radar's view, of all or those where views overlap, or where not."""
    parts = []
    for one in laps:
        chosen = one.in_first & np.isfinite(one.error)
        if overlap is not None:
            chosen &= (one.views > 1) == overlap
        parts.append(one.error[chosen])
    errors = np.concatenate(parts)
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else math.nan


RING: Final = Experiment(
    "does one car keep its id around the vehicle, and does every further radar help?",
    (
        ("1, 2, 5, 12", f"radars on own buses, ESR and ARS408 in turn, at {', '.join(map(str, DIRECTIONS))} deg"),
        ("views", f"± {FIRST_HALF:g} deg of the first radar, ± {HALF:g} deg of the others"),
        ("car", f"at {SPEED:g} m/s on a circle of {RADIUS:g} m around our vehicle, which stands; a lap and a quarter"),
        ("error", "RMS of the distance of the confirmed obstacle nearest to the car's reference point"),
        ("overlap", "wanted: no more than with fewer radars"),
        ("duplicates", "confirmed obstacles beside the nearest one, while the car is in view"),
    ),
    20,
    run,
)
