"""The RAV4's radar followed reflection by reflection, as far as it can be told what it will say next."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import yaml

from tests.support.paths import ROOT

OF_POINTS: Final[dict[str, Any]] = {
    "tracker": {
        "estimator": {
            "kind": "imm",
            "first_acceleration": 1.0,
            "models": [
                {
                    "kind": "ca",
                    "noise": {"along": 0.1, "across": 0.1},
                    "settling": {"along": 16.0, "across": 0.6},
                    "wander": {"along": 0.0006, "across": 0.028},
                }
            ],
        },
        "lifecycle": {"first_speed": {"along": 20.0, "across": 0.5}},
    },
    "sensors": {"front": {"latency": 0.0, "noise": {"x": 0.14, "y": 0.08, "range_rate": 0.035}}},
}
"""Set for the recorded drive, which is nearly straight: what crosses or turns is taken for drift."""


def of_points(name: str, folder: Path) -> Path:
    """Write a configuration of the RAV4 with those settings; return its path."""
    text = (ROOT / "config" / f"{name}.yaml").read_text(encoding="utf-8")
    settings = yaml.safe_load(text.replace("../dbc", str(ROOT / "dbc")))
    settings["tracker"] = OF_POINTS["tracker"]
    settings["sensors"]["front"] |= OF_POINTS["sensors"]["front"]
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(settings, sort_keys=False), encoding="utf-8")
    return path
