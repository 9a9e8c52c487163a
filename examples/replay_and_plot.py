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
TRAIL, TRAIL_STEP = 3.0, 2  # s of trail, every second cycle of it
AT = 4.3  # s into the drive
AHEAD, BESIDE = (-18.0, 66.0), (-18.0, 18.0)  # m, what the drawing shows


def frames(arguments: list[str]) -> tuple[Binding, Iterable[Frame]]:
    """Return the configuration and the frames of the drive that is meant: two files, or a simulation."""
    if arguments:
        config, log = map(Path, arguments)
        binding = bind(load_config(config))
        channels = {name: bus.index for bus in binding.buses for name in bus.settings.names_in_logs}
        return binding, read_log(log, channels, LogCounts())
    shipped = shared_folder() / "config"
    binding = bind(load_config(shipped / "esr_ins.yaml"))
    return binding, simulate(load_scenario(shipped / "scenarios" / "intersection.yaml"), binding, seed=1).frames()


def draw(cycles: list[Cycle], path: Path) -> None:
    """Draw the last of some cycles in vehicle axes (x forward is to the right), with the trails that led there."""
    last, now = cycles[-1], cycles[-1].obstacles
    figure, axes = plt.subplots(figsize=(10, 4.6), layout="constrained")
    trails = defaultdict(list)
    for cycle in cycles[::-TRAIL_STEP]:
        obstacles = cycle.obstacles
        for row in (obstacles.state >= CONFIRMED).nonzero()[0]:
            trails[int(obstacles.id[row])].append((obstacles.east[row], obstacles.north[row]))
        if cycle.detections is not None:
            x, y = last.pose.to_vehicle(cycle.detections.measurement.position).T
            seen = axes.scatter(x, y, s=9, color="0.72", linewidths=0, zorder=1)
    seen.set_label(f"detections of {TRAIL:g} s, over ground")
    labelled: list[tuple[float, float]] = []
    shown = [
        row
        for row in (now.state >= CONFIRMED).nonzero()[0]
        if AHEAD[0] < now.x[row] < AHEAD[1] and BESIDE[0] < now.y[row] < BESIDE[1]
    ]
    for row in sorted(shown, key=lambda row: now.x[row]):
        number, x, y, vx, vy = (int(now.id[row]), *(float(a[row]) for a in (now.x, now.y, now.vx, now.vy)))
        color = f"C{number % 10}"
        trail = last.pose.to_vehicle(trails[number])
        axes.plot(trail[:, 0], trail[:, 1], color=color, linewidth=2, alpha=0.7, zorder=2)
        if vx * vx + vy * vy > 1.0:
            arrow = {"arrowstyle": "-|>", "color": color, "linewidth": 1.5, "shrinkA": 0, "shrinkB": 0}
            axes.annotate("", (x + vx / 2, y + vy / 2), (x, y), arrowprops=arrow, zorder=3)
        axes.scatter(x, y, s=60, color=color, edgecolors="white", zorder=4)
        # above it, but below where another label is near, and to the side of what drives across
        near = any(abs(x - other) < 12.0 and abs(y - beside) < 3.0 for other, beside in labelled)
        offset, side = ((-10, -4), "right") if abs(vy) > max(abs(vx), 1.0) else ((0, -17 if near else 8), "center")
        labelled.append((x, y))
        text, box = f"{number}: {(vx**2 + vy**2) ** 0.5 * 3.6:.0f} km/h", {"color": "white", "alpha": 0.8, "pad": 0.5}
        axes.annotate(text, (x, y), offset, textcoords="offset points", ha=side, bbox=box, zorder=5)
    axes.add_patch(plt.Rectangle((-1.0, -0.9), 4.6, 1.8, color="black", zorder=4, label="the car with the radar"))
    axes.plot([], [], color="C0", marker="o", linewidth=2, label="obstacle: id and speed over ground, its trail")
    own = last.pose.to_vehicle([(cycle.pose.east, cycle.pose.north) for cycle in cycles])
    axes.plot(own[:, 0], own[:, 1], color="black", linewidth=1, linestyle=":", zorder=2)
    axes.set(xlim=AHEAD, ylim=BESIDE, aspect="equal", xlabel="x, forward (m)", ylabel="y, to the left (m)")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=3, frameon=False)
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
