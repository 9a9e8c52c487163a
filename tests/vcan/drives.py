"""A drive without end: traffic that keeps its distance, so that its frames can be played over and over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from candaemon.binding.bound import Binding
from candaemon.frames.frame import Frame
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate

LAP_S = 2.0
"""An even number of the radar's cycles: the rolling count of one bit goes on from lap to lap."""
_SETTLED_S = 1.0
_SPEED = 20.0


def light(settings: dict[str, Any]) -> None:
    """Let the radar tell 8 objects ten times a second: user-mode Linux on a busy machine is slow."""
    settings["sensors"]["front"]["objects"]["slots"] = 8
    settings["sensors"]["front"]["cycle_time"] = 0.1


def lap(binding: Binding, places: Sequence[tuple[float, float]], *, own_rate: float = 20.0) -> list[Frame]:
    """Simulate a lap.

    Args:
        binding: whose sensors see it.
        places: of the vehicles, m ahead and to the left of the ego; each drives as the ego does.
        own_rate: samples of own motion a second.

    Returns:
        Its frames, times in ns from its beginning.
    """
    actors = [
        {"name": f"car{number}", "start": {"x": x, "y": y, "vx": _SPEED, "vy": 0}, "reflections": 1}
        for number, (x, y) in enumerate(places)
    ]
    scenario = Scenario.model_validate(
        {
            "duration": _SETTLED_S + LAP_S + 0.1,
            "start_time": 0,
            "ego": {"start": {"speed": _SPEED}, "own_motion": {"rate": own_rate, "noise": 0.1}},
            "actors": actors,
            "measurement": {"clutter": 0, "detection_probability": 1, "occlusion": False, "cycle_jitter": 0},
        }
    )
    begin_ns, end_ns = round(_SETTLED_S * 1e9), round((_SETTLED_S + LAP_S) * 1e9)
    return [
        frame._replace(time_ns=frame.time_ns - begin_ns)
        for frame in simulate(scenario, binding).frames()
        if begin_ns <= frame.time_ns < end_ns
    ]
