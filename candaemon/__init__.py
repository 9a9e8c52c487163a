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

from candaemon._version import __version__ as __version__

if TYPE_CHECKING:
    from candaemon.binding.bind import bind as bind
    from candaemon.binding.bound import Binding as Binding
    from candaemon.can_io.logs.read import read_log as read_log
    from candaemon.can_io.logs.stream import LogCounts as LogCounts
    from candaemon.config.load import json_schema as json_schema
    from candaemon.config.load import load_config as load_config
    from candaemon.config.shipped import shared_folder as shared_folder
    from candaemon.estimation.adaptive_filter import AdaptiveFilter as AdaptiveFilter
    from candaemon.estimation.alignment import lagrange as lagrange
    from candaemon.estimation.alignment import mounting_rotation as mounting_rotation
    from candaemon.estimation.axis_filter import AxisFilter as AxisFilter
    from candaemon.estimation.axis_filter import WhiteAxis as WhiteAxis
    from candaemon.estimation.body_filter import BodyDynamics as BodyDynamics
    from candaemon.estimation.body_filter import BodyFilter as BodyFilter
    from candaemon.estimation.body_filter import BodyMode as BodyMode
    from candaemon.estimation.federated import Federated as Federated
    from candaemon.estimation.imm import Imm as Imm
    from candaemon.estimation.information import InformationFilter as InformationFilter
    from candaemon.estimation.innovation_noise import InnovationNoise as InnovationNoise
    from candaemon.estimation.manoeuvre_detection import SwitchRule as SwitchRule
    from candaemon.estimation.measurement import Measurement as Measurement
    from candaemon.estimation.motion_models import CoordinatedTurn as CoordinatedTurn
    from candaemon.estimation.motion_models import CurrentStatistical as CurrentStatistical
    from candaemon.estimation.motion_models import LinearModel as LinearModel
    from candaemon.estimation.motion_models import Singer as Singer
    from candaemon.estimation.noise_factor import NoiseScale as NoiseScale
    from candaemon.estimation.radial import ModifiedLinearKalman as ModifiedLinearKalman
    from candaemon.estimation.smoothing import FixedLag as FixedLag
    from candaemon.estimation.smoothing import Link as Link
    from candaemon.estimation.smoothing import Step as Step
    from candaemon.estimation.smoothing import smooth as smooth
    from candaemon.estimation.switching import CvCsmSwitch as CvCsmSwitch
    from candaemon.estimation.trilateration import Status as Status
    from candaemon.estimation.trilateration import Trilateration as Trilateration
    from candaemon.estimation.trilateration import trilaterate as trilaterate
    from candaemon.estimation.variational_noise import VariationalNoise as VariationalNoise
    from candaemon.evaluation.metrics import evaluate as evaluate
    from candaemon.frames.frame import Frame as Frame
    from candaemon.frames.frame import Tick as Tick
    from candaemon.pipeline.cycle import Cycle as Cycle
    from candaemon.pipeline.pipeline import Pipeline as Pipeline
    from candaemon.playback.replay import Replayed as Replayed
    from candaemon.playback.replay import ReplayRequest as ReplayRequest
    from candaemon.playback.replay import replay as replay
    from candaemon.playback.summary import summarise as summarise
    from candaemon.simulation.drive_files import record as record
    from candaemon.simulation.scenario import load_scenario as load_scenario
    from candaemon.simulation.simulate import simulate as simulate
    from candaemon.tracking.obstacles import Obstacles as Obstacles
    from candaemon.tracking.tracker import Tracker as Tracker
    from candaemon.tracking.vehicle_tracker import VehicleTracker as VehicleTracker

_NAMES = {
    "candaemon.binding.bind": ("bind",),
    "candaemon.binding.bound": ("Binding",),
    "candaemon.can_io.logs.read": ("read_log",),
    "candaemon.can_io.logs.stream": ("LogCounts",),
    "candaemon.config.load": ("json_schema", "load_config"),
    "candaemon.config.shipped": ("shared_folder",),
    "candaemon.estimation.adaptive_filter": ("AdaptiveFilter",),
    "candaemon.estimation.alignment": ("lagrange", "mounting_rotation"),
    "candaemon.estimation.axis_filter": ("AxisFilter", "WhiteAxis"),
    "candaemon.estimation.body_filter": ("BodyDynamics", "BodyFilter", "BodyMode"),
    "candaemon.estimation.switching": ("CvCsmSwitch",),
    "candaemon.estimation.federated": ("Federated",),
    "candaemon.estimation.imm": ("Imm",),
    "candaemon.estimation.information": ("InformationFilter",),
    "candaemon.estimation.innovation_noise": ("InnovationNoise",),
    "candaemon.estimation.manoeuvre_detection": ("SwitchRule",),
    "candaemon.estimation.measurement": ("Measurement",),
    "candaemon.estimation.motion_models": ("CoordinatedTurn", "CurrentStatistical", "LinearModel", "Singer"),
    "candaemon.estimation.noise_factor": ("NoiseScale",),
    "candaemon.estimation.radial": ("ModifiedLinearKalman",),
    "candaemon.estimation.smoothing": ("FixedLag", "Link", "Step", "smooth"),
    "candaemon.estimation.trilateration": ("Status", "Trilateration", "trilaterate"),
    "candaemon.estimation.variational_noise": ("VariationalNoise",),
    "candaemon.evaluation.metrics": ("evaluate",),
    "candaemon.frames.frame": ("Frame", "Tick"),
    "candaemon.pipeline.cycle": ("Cycle",),
    "candaemon.pipeline.pipeline": ("Pipeline",),
    "candaemon.playback.replay": ("ReplayRequest", "Replayed", "replay"),
    "candaemon.playback.summary": ("summarise",),
    "candaemon.simulation.scenario": ("load_scenario",),
    "candaemon.simulation.simulate": ("simulate",),
    "candaemon.simulation.drive_files": ("record",),
    "candaemon.tracking.obstacles": ("Obstacles",),
    "candaemon.tracking.tracker": ("Tracker",),
    "candaemon.tracking.vehicle_tracker": ("VehicleTracker",),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}

__all__ = sorted([*_MODULE_OF, "__version__"])  # noqa: PLE0605  # one table of names, not two


def __getattr__(name: str) -> Any:
    """Import what is asked for."""
    module = _MODULE_OF.get(name)
    if module is None:
        raise AttributeError(f"module 'candaemon' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(module), name)
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
