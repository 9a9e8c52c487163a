"""A drive replayed from Python and drawn from above: what the radar measured, and where each obstacle went.

`python examples/replay_and_plot.py` replays a simulated drive and writes `scene.svg`. For a drive of your own, name its
configuration and its log: `python examples/replay_and_plot.py my_car.yaml drive.log.gz`.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import matplotlib as mpl

from candaemon import (
    Binding,
    Cycle,
    Frame,
    LogCounts,
    Pipeline,
    bind,
    load_config,
    load_scenario,
    read_log,
    shared_folder,
    simulate,
)

mpl.use("svg")
mpl.rcParams["svg.hashsalt"] = "scene"  # the same drive gives the same bytes
from matplotlib import pyplot as plt  # noqa: E402 - after the choice of what draws

CONFIRMED = 1
TRAIL, TRAIL_STEP = 6.0, 2  # s of trail, every second cycle of it
AT = 20.0  # s into the drive


def frames(arguments: list[str]) -> tuple[Binding, Iterable[Frame]]:
    """Return the configuration and the frames of the drive that is meant: two files, or a simulation."""
    if arguments:
        config, log = map(Path, arguments)
        binding = bind(load_config(config))
        channels = {name: bus.index for bus in binding.buses for name in bus.settings.names_in_logs}
        return binding, read_log(log, channels, LogCounts())
    shipped = shared_folder() / "config"
    binding = bind(load_config(shipped / "esr_ins.yaml"))
    return binding, simulate(load_scenario(shipped / "scenarios" / "highway.yaml"), binding, seed=1).frames()


def draw(cycles: list[Cycle], path: Path) -> None:
    """Draw the last of some cycles in vehicle axes (x forward is up), with the trails that led there."""
    last = cycles[-1]
    figure, axes = plt.subplots(figsize=(6, 8), layout="constrained")
    trails = defaultdict(list)
    for cycle in cycles[::-TRAIL_STEP]:
        obstacles = cycle.obstacles
        for row in (obstacles.state >= CONFIRMED).nonzero()[0]:
            trails[int(obstacles.id[row])].append((obstacles.east[row], obstacles.north[row]))
        if cycle.detections is not None:
            x, y = last.pose.to_vehicle(cycle.detections.measurement.position).T
            axes.scatter(y, x, s=4, color="0.7", linewidths=0, zorder=1)
    sure = (last.obstacles.state >= CONFIRMED).nonzero()[0]
    for row in sure:
        number, x, y = int(last.obstacles.id[row]), last.obstacles.x[row], last.obstacles.y[row]
        vx, vy = last.obstacles.vx[row], last.obstacles.vy[row]
        color = f"C{number % 10}"
        trail = last.pose.to_vehicle(trails[number])
        axes.plot(trail[:, 1], trail[:, 0], color=color, alpha=0.6, zorder=2)
        axes.annotate("", (y + vy, x + vx), (y, x), arrowprops={"arrowstyle": "->", "color": color}, zorder=3)
        axes.scatter(y, x, s=36, color=color, zorder=4)
        axes.annotate(f"{number}: {(vx**2 + vy**2) ** 0.5 * 3.6:.0f} km/h", (y, x), (6, -4), textcoords="offset points")
    axes.scatter(0, 0, s=90, marker="^", color="black", zorder=4)
    axes.set(xlim=(20, -20), ylim=(-10, 150), xlabel="y, to the left (m)", ylabel="x, forward (m)")
    figure.savefig(path, metadata={"Date": None})


def main(arguments: list[str]) -> None:
    """Replay the drive up to the instant that is drawn."""
    binding, drive = frames(arguments)
    cycles: list[Cycle] = []
    for cycle in Pipeline(binding).run(drive):
        cycles.append(cycle)
        seconds = (cycle.obstacles.time_ns - cycles[0].obstacles.time_ns) * 1e-9
        if seconds >= AT:
            break
    kept = [each for each in cycles if cycles[-1].obstacles.time_ns - each.obstacles.time_ns < TRAIL * 1e9]
    draw(kept, Path("scene.svg"))
    print(f"{len(cycles)} cycles; scene.svg shows the last of them")


if __name__ == "__main__":
    main(sys.argv[1:])
