"""The data that the scene and the report draw, as coarse as a reader sees it, and its digests."""

from __future__ import annotations

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np

from candaemon.exports.drive_tables import summary_rows
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import Simulation, simulate
from candaemon.tracking.obstacles import STATE_NAMES
from tests.support.bound import binding
from tests.support.paths import ROOT

CONFIG: Final = "esr_ins"
SCENARIO: Final = "intersection"
SEED: Final = 1
AT: Final = 4.3
"""s since the first cycle: the instant of the scene."""
FOLDER: Final = ROOT / "docs" / "images"
DIGESTS: Final = FOLDER / "drawn.json"
SCENE, REPORT = "scene.svg", "report.png"

_GRID: Final = 0.5  # m
_SHOWN: Final = (
    "seconds",
    "log.frames",
    "cycles.told",
    "tracks.",
    "nis.",
    "predictions.",
    "stationary.speed",
    "duplicates.",
)


def simulated() -> Simulation:
    """Return the drive of all pictures."""
    return simulate(load_scenario(ROOT / "config" / "scenarios" / f"{SCENARIO}.yaml"), binding(CONFIG), SEED)


def scene() -> list[tuple[int, str, float, float]]:
    """Return id, state and place of each confirmed obstacle at the instant that the scene shows."""
    begin_ns: int | None = None
    for cycle in Pipeline(binding(CONFIG)).run(simulated().frames()):
        obstacles = cycle.obstacles
        begin_ns = obstacles.time_ns if begin_ns is None else begin_ns
        if obstacles.time_ns - begin_ns >= AT * 1e9:
            rows = np.flatnonzero(obstacles.state > 0).tolist()
            return [
                (
                    int(obstacles.id[row]),
                    STATE_NAMES[obstacles.state[row]],
                    float(np.round(obstacles.x[row] / _GRID) * _GRID),
                    float(np.round(obstacles.y[row] / _GRID) * _GRID),
                )
                for row in sorted(rows, key=lambda row: int(obstacles.id[row]))
            ]
    raise ValueError("the drive ends before that instant")


def report(figures: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures that the picture of a report shows, with two digits."""
    _, columns = summary_rows(figures)
    keys, values = columns["key"], columns["value"]
    assert isinstance(keys, list)
    assert isinstance(values, np.ndarray)
    return {key: f"{value:.2g}" for key, value in zip(keys, values.tolist(), strict=True) if key.startswith(_SHOWN)}


def digest(data: Any) -> str:
    """Return a digest of data that JSON can hold."""
    return sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def kept() -> dict[str, str]:
    """Return the digests of the pictures as they are in the documentation."""
    found: dict[str, str] = json.loads(DIGESTS.read_text(encoding="utf-8"))
    return found


def pictures() -> list[Path]:
    """Return the pictures."""
    return [FOLDER / name for name in (SCENE, REPORT)]
