"""A radar whose detections have no identity, and that looks into four fields of view in turn."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import yaml

from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import Simulation
from tests.accuracy.experiments.finding import Effort, Experiment, Finding
from tests.accuracy.scores import LEGEND, scored
from tests.accuracy.simulated_runs import bound, cycles_of, track_rows, truth_rows
from tests.support.paths import ROOT

SCENARIOS: Final = ("traffic_motorway", "traffic_country_road", "traffic_junction")
SECONDS: Final = 15.0
MISSED, DUPLICATES = 0.015, 0.03
DBC: Final = """\
VERSION ""
NS_ :
BS_:
BU_: RADAR

BO_ 1024 HEAD: 8 RADAR
 SG_ COUNT : 0|7@1+ (1,0) [0|64] "" RADAR
 SG_ LOOK : 8|2@1+ (1,0) [0|3] "" RADAR

BO_ 1025 POINT: 8 RADAR
 SG_ INDEX : 0|6@1+ (1,0) [0|63] "" RADAR
 SG_ VALID : 6|1@1+ (1,0) [0|1] "" RADAR
 SG_ RANGE : 8|12@1+ (0.0625,0) [0|255] "m" RADAR
 SG_ ANGLE : 20|12@1- (0.0625,0) [-90|90] "deg" RADAR
 SG_ RATE : 32|12@1- (0.0625,0) [-128|127] "m/s" RADAR
"""
SENSOR: Final[dict[str, Any]] = {
    "bus": "radar",
    "mount": {"x": 3.6},
    "cycle_time": 0.03,
    "timeout": 0.02,
    "objects": {
        "messages": [{"message": "POINT", "id_signal": "INDEX"}],
        "slots": 64,
        "identity": False,
        "valid": [{"signal": "VALID", "in": [1]}],
    },
    "scan": {"close": "header", "message": "HEAD", "count": "COUNT"},
    "looks": {
        "signal": "LOOK",
        "fields_of_view": {
            "0": {"range": 70, "azimuth_deg": 45},
            "1": {"range": 160, "azimuth_deg": 12},
            "2": {"range": 70, "azimuth_deg": 30, "yaw_deg": 45},
            "3": {"range": 70, "azimuth_deg": 30, "yaw_deg": -45},
        },
    },
    "signals": {"range": "RANGE", "azimuth": "ANGLE", "range_rate": "RATE"},
    "noise": {"range": 0.25, "azimuth_deg": 0.5, "range_rate": 0.12},
}
"""Without identities, with looks that say which they are."""


def configuration(folder: Path) -> Path:
    """Write the configuration with the own motion of the shipped INS; return its path."""
    (folder / "points.dbc").write_text(DBC, encoding="utf-8")
    shipped = yaml.safe_load((ROOT / "config" / "esr_ins.yaml").read_text(encoding="utf-8"))
    ego = shipped["ego"] | {"dbc": str(ROOT / "dbc" / "oxts.dbc")}
    sensors = {"front": SENSOR | {"dbc": "points.dbc"}}
    path = folder / "unidentified.yaml"
    data = {"buses": {name: shipped["buses"][name] for name in ("radar", "ins")}, "ego": ego, "sensors": sensors}
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


def shortened(name: str, seconds: float) -> Scenario:
    """Return a shipped scenario, cut off."""
    data = yaml.safe_load((ROOT / "config" / "scenarios" / f"{name}.yaml").read_text(encoding="utf-8"))
    return Scenario.model_validate(data | {"duration": min(seconds, data["duration"])})


def run(effort: Effort, scenarios: tuple[str, ...] = SCENARIOS) -> Iterator[Finding]:
    """Yield the figures over all drives."""
    with TemporaryDirectory() as folder:
        binding = bound(configuration(Path(folder)), effort.tracker)
    scores = []
    for name in scenarios:
        drive = shortened(name, min(effort.seconds, SECONDS))
        for seed in effort.seeds:
            simulation = Simulation(drive, binding, seed)
            obstacles = [cycle.obstacles for cycle in cycles_of(simulation.frames(), Pipeline(binding))]
            scores.append(scored(track_rows(obstacles), truth_rows(simulation)))
    total = scores[0]
    for score in scores[1:]:
        total = total + score
    figures = total.figures()
    yield Finding("missed", 100 * figures["missed"], "%", most=100 * MISSED)
    yield Finding("duplicates", 100 * figures["duplicates"], "%", most=100 * DUPLICATES)
    yield Finding("position", figures["position"])
    yield Finding("velocity", figures["velocity"], "m/s")
    yield Finding("GOSPA", figures["gospa"])
    yield Finding("id switches", figures["switches"], "a minute")
    yield Finding("false", figures["false"], "a minute")


UNIDENTIFIED: Final = Experiment(
    "are detections without identity, of four looks in turn, tracked?",
    (
        ("drives", f"{', '.join(SCENARIOS)}, {SECONDS:g} s each"),
        ("looks", "± 45 deg 70 m, ± 12 deg 160 m, to the left and to the right; one each 30 ms"),
        *(each for each in LEGEND if each[0] in ("missed", "duplicates", "GOSPA", "switches", "false")),
    ),
    6,
    run,
)
