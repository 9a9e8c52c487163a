"""What a cycle costs: one filter an obstacle beside one a reflection, and many radars."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from candaemon.binding.bound import Binding
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import Simulation
from tests.accuracy.experiments.finding import Effort, Experiment, Finding
from tests.accuracy.experiments.on_ring import configuration
from tests.accuracy.simulated_runs import bound, cycles_of, scenario_of
from tests.support.paths import ROOT

SECONDS: Final = 3.0
"""Of a drive that is timed."""
RADARS, OBJECTS = 12, 20
MOST: Final = 3.0
"""Times the cost of a cycle of 64 targets that one of the many radars may take."""
IMM: Final = (("default", None), ("estimator.kind", "imm"))
VEHICLE: Final = (("default", None), ("estimator.kind", "vehicle"))


def crowd(seconds: float) -> Scenario:
    """Return points on rings around our vehicle, `OBJECTS` in each radar's direction, each on a course of its own."""
    actors: list[dict[str, Any]] = []
    for k in range(RADARS * OBJECTS):
        direction, row = math.radians(360 / RADARS * (k // OBJECTS)), k % OBJECTS
        angle = direction + math.radians((row % 4 - 1.5) * 6)
        distance = 14 + 8 * (row // 4)
        actors.append({
            "name": f"p{k}",
            "size": {"length": 0, "width": 0},
            "start": {"x": round(distance * math.cos(angle), 3), "y": round(distance * math.sin(angle), 3),
                      "speed": 1 + 0.1 * row, "heading_deg": round(math.degrees(angle), 3)},
        })  # fmt: skip
    return Scenario.model_validate({"duration": seconds, "actors": actors, "measurement": {"clutter": 0}})


def cycle_cost(binding: Binding, frames: list[Frame]) -> float:
    """Return the processor time of a cycle, decoding and reports included, ms."""
    begun = time.process_time()
    cycles = sum(1 for _ in cycles_of(frames, Pipeline(binding)))
    return (time.process_time() - begun) / cycles * 1e3


def run(effort: Effort) -> Iterator[Finding]:
    """Yield the costs: each the least of several runs that take turns."""
    seconds = min(effort.seconds, SECONDS)
    with TemporaryDirectory() as folder:
        esr, scenario = ROOT / "config" / "esr_ins.yaml", scenario_of(ROOT / "config" / "scenarios" / "dense.yaml")
        ring = configuration(RADARS, Path(folder), slots=OBJECTS + 12, halves=(15.0, 15.0))
        chosen = (("default", None), *effort.tracker) if effort.tracker else VEHICLE
        bindings = {"imm": bound(esr, IMM), "vehicle": bound(esr, chosen), "radars": bound(ring, chosen)}
        short = scenario.model_copy(update={"duration": seconds})
        dense = list(Simulation(short, bindings["imm"], 1).frames())
        around = list(Simulation(crowd(seconds), bindings["radars"], 1).frames())
    cost = dict.fromkeys(bindings, math.inf)
    for _ in effort.seeds:
        for name, binding in bindings.items():
            cost[name] = min(cost[name], cycle_cost(binding, around if name == "radars" else dense))
    yield Finding("64 point targets, kind imm", cost["imm"], "ms")
    yield Finding("64 point targets, kind vehicle", cost["vehicle"], "ms", most=cost["imm"])
    yield Finding("the same, ratio", cost["vehicle"] / cost["imm"], "", most=1.0)
    yield Finding(f"{RADARS} radars with {OBJECTS} objects each, kind vehicle", cost["radars"], "ms")
    yield Finding("the same beside 64 targets of kind imm", cost["radars"] / cost["imm"], "", most=MOST)


COST: Final = Experiment(
    "does one filter an obstacle cost no more than one a reflection?",
    (
        ("64 point targets", f"{SECONDS:g} s of dense.yaml through esr_ins"),
        (f"{RADARS} radars", "each sees its own objects: points that move away from our vehicle"),
        ("ms", "processor time of a cycle with decoding, own motion and report; the least of the runs"),
        ("kind vehicle", "or --tracker's"),
    ),
    5,
    run,
)
