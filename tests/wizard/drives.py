"""A drive that tells a wizard much: bends to both sides past things that stand, and traffic both ways."""

from __future__ import annotations

import math
from pathlib import Path

from candaemon.binding.bound import Binding
from candaemon.can_io.logs.write import open_log_writer
from candaemon.files.outputs import Outputs
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate

SPEED = 14.0
_TURNS = ((2.0, 0.0), (5.0, 7.0), (5.0, -9.0), (3.0, 0.0), (4.0, 8.0), (3.0, -6.0))
"""s and deg/s of the way's pieces."""


def _way(further: float) -> list[tuple[float, float, float]]:
    """Return x, y and heading each 0.1 s of the way, and so many seconds on."""
    x = y = heading = 0.0
    points = [(x, y, heading)]
    for seconds, turn in (*_TURNS, (further, 0.0)):
        for _ in range(round(seconds / 0.1)):
            heading += math.radians(turn) * 0.1
            x += SPEED * 0.1 * math.cos(heading)
            y += SPEED * 0.1 * math.sin(heading)
            points.append((x, y, heading))
    return points


def _survey() -> str:
    """Return the drive as a scenario's YAML."""
    points = _way(8.0)
    posts = []
    for index, (x, y, heading) in enumerate(points[::9]):
        side = (-6.0, 7.5)[index % 2]
        posts.append(f"{{x: {x - side * math.sin(heading):.2f}, y: {y + side * math.cos(heading):.2f}}}")
    seconds = sum(duration for duration, _ in _TURNS)
    segments = ", ".join(f"{{duration: {duration:g}, yaw_rate_deg: {turn:g}}}" for duration, turn in _TURNS)
    return f"""duration: {seconds:g}
ego:
  start: {{speed: {SPEED:g}}}
  segments: [{segments}]
actors:
  - {{name: ahead, start: {{x: 28, y: 0, speed: 15.5}}, segments: [{{duration: {seconds:g}, yaw_rate_deg: 1}}]}}
  - {{name: oncoming, start: {{x: 160, y: 30, speed: 9, heading_deg: 195}}}}
  - {{name: crosses, start: {{x: 90, y: -30, speed: 4, heading_deg: 90}}}}
stationary:
  posts: [{", ".join(posts)}]
"""


def survey_log(binding: Binding, folder: Path, seed: int = 3) -> Path:
    """Simulate the drive through a configuration, and write its log."""
    scenario = folder / "survey.yaml"
    scenario.write_text(_survey(), encoding="utf-8")
    log = folder / "survey.log"
    channels = [bus.settings.log_channel or bus.settings.channel for bus in binding.buses]
    with Outputs() as outputs, open_log_writer(outputs.open(log), channels) as writer:
        writer.write(list(simulate(load_scenario(scenario), binding, seed).frames()))
    return log
