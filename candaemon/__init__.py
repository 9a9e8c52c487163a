"""A CAN-bus radar tracking daemon: radar object frames in, obstacles with a lasting identity out.

For notebooks::

    from pathlib import Path
    from candaemon import ReplayRequest, bind, load_config, replay

    done = replay(bind(load_config(Path("config/toyota_rav4.yaml"))), ReplayRequest(Path("drive.log.gz")))

Names are imported when they are first used, so that `import candaemon` itself costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from candaemon.binding import Binding, bind
    from candaemon.bus.frame import Frame, Tick
    from candaemon.config import json_schema, load_config
    from candaemon.cycle import Cycle
    from candaemon.estimation.adaptive import AdaptiveFilter, InnovationNoise
    from candaemon.estimation.alignment import lagrange, mounting_rotation
    from candaemon.estimation.axis_filter import AxisFilter, WhiteAxis
    from candaemon.estimation.federated import Federated
    from candaemon.estimation.imm import Imm
    from candaemon.estimation.information import InformationFilter
    from candaemon.estimation.manoeuvre import SwitchRule
    from candaemon.estimation.models import CoordinatedTurn, CurrentStatistical, LinearModel, Singer
    from candaemon.estimation.radial import ModifiedLinearKalman
    from candaemon.estimation.smoothing import FixedLag, Link, Step, smooth
    from candaemon.estimation.switching import CvCsmSwitch
    from candaemon.estimation.trilateration import Status, Trilateration, trilaterate
    from candaemon.estimation.variational import NoiseScale, VariationalNoise
    from candaemon.pipeline import Pipeline
    from candaemon.replayer import Replayed, ReplayRequest, replay
    from candaemon.summary import summarise
    from candaemon.tracking.obstacles import Obstacles
    from candaemon.tracking.tracker import Tracker

__version__ = "0.1.0"

_EXPORTS = {
    "candaemon.binding": ("Binding", "bind"),
    "candaemon.bus.frame": ("Frame", "Tick"),
    "candaemon.config": ("json_schema", "load_config"),
    "candaemon.cycle": ("Cycle",),
    "candaemon.estimation.alignment": ("lagrange", "mounting_rotation"),
    "candaemon.estimation.adaptive": ("AdaptiveFilter", "InnovationNoise"),
    "candaemon.estimation.axis_filter": ("AxisFilter", "WhiteAxis"),
    "candaemon.estimation.federated": ("Federated",),
    "candaemon.estimation.imm": ("Imm",),
    "candaemon.estimation.information": ("InformationFilter",),
    "candaemon.estimation.manoeuvre": ("SwitchRule",),
    "candaemon.estimation.models": ("CoordinatedTurn", "CurrentStatistical", "LinearModel", "Singer"),
    "candaemon.estimation.radial": ("ModifiedLinearKalman",),
    "candaemon.estimation.smoothing": ("FixedLag", "Link", "Step", "smooth"),
    "candaemon.estimation.switching": ("CvCsmSwitch",),
    "candaemon.estimation.trilateration": ("Status", "Trilateration", "trilaterate"),
    "candaemon.estimation.variational": ("NoiseScale", "VariationalNoise"),
    "candaemon.pipeline": ("Pipeline",),
    "candaemon.replayer": ("ReplayRequest", "Replayed", "replay"),
    "candaemon.summary": ("summarise",),
    "candaemon.tracking.obstacles": ("Obstacles",),
    "candaemon.tracking.tracker": ("Tracker",),
}
_MODULE_OF = {name: module for module, names in _EXPORTS.items() for name in names}

__all__ = [
    "AdaptiveFilter",
    "AxisFilter",
    "Binding",
    "CoordinatedTurn",
    "CurrentStatistical",
    "CvCsmSwitch",
    "Cycle",
    "Federated",
    "FixedLag",
    "Frame",
    "Imm",
    "InformationFilter",
    "InnovationNoise",
    "LinearModel",
    "Link",
    "ModifiedLinearKalman",
    "NoiseScale",
    "Obstacles",
    "Pipeline",
    "ReplayRequest",
    "Replayed",
    "Singer",
    "Status",
    "Step",
    "SwitchRule",
    "Tick",
    "Tracker",
    "Trilateration",
    "VariationalNoise",
    "WhiteAxis",
    "__version__",
    "bind",
    "json_schema",
    "lagrange",
    "load_config",
    "mounting_rotation",
    "replay",
    "smooth",
    "summarise",
    "trilaterate",
]


def __getattr__(name: str) -> Any:
    """Import what is asked for."""
    module = _MODULE_OF.get(name)
    if module is None:
        raise AttributeError(f"module 'candaemon' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(module), name)
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
