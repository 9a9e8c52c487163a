"""Calibration of whole drives: all their windows at once, evaluated again until the estimate stays; and the noise."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.binding.bound import BoundSensor
from candaemon.calibration.calibrator import GatheredWindow
from candaemon.calibration.noise import WALK_TIME, NoiseParts, NoiseSamples, noise_parts, residual_pairs
from candaemon.calibration.parameters import LATENCY, YAW, Estimate, ego_noise, prior
from candaemon.calibration.readings import Readings, SensorReader
from candaemon.calibration.window import WindowReader
from candaemon.calibration.windows import REACH, WindowsState, added, estimate

_MOST_PASSES: Final = 6
_WALK_PASSES: Final = 4
_SETTLED: Final = 1.05
"""Growth of the walk from pass to pass, at which it is found."""
_DIRECTIONS: Final = {"range": "along", "x": "along", "y": "across", "azimuth": "across"}
"""To the line of sight, in which most errors of a quantity go."""
MEASURED: Final = ("range", "azimuth", "x", "y", "range_rate", "vx", "vy")
RANGES: Final = ((0.0, 40.0), (40.0, 80.0), (80.0, float("inf")))
"""m, of which the noise is told apart."""
_BOUNDS: Final = [begin for begin, _ in RANGES]


@dataclass(frozen=True, slots=True)
class SensorFindings:
    """What drives show of a sensor.

    Attributes:
        estimate: of latency, yaw, and what odometry reads wrongly.
        windows: seconds of standing returns.
        noise: of each quantity that the sensor measures; None where there is not enough.
        by_range: likewise, for each of `RANGES`.
        walk: random walk of the position along and across the line of sight, m²/s, and its standard deviation; None
            where there is not enough.
    """

    estimate: Estimate
    windows: int
    noise: dict[str, NoiseParts | None]
    by_range: dict[str, list[NoiseParts | None]]
    walk: tuple[NoiseParts | None, NoiseParts | None]


def findings(sensor: BoundSensor, ego: object, gathered: Sequence[GatheredWindow]) -> SensorFindings:
    """Return what the windows of some drives show of one sensor.

    Args:
        sensor: the sensor.
        ego: settings of ego motion.
        gathered: windows of any sensors.
    """
    reader = SensorReader(sensor.settings, sensor.reader.quantities)
    equations, noise = WindowReader(reader), ego_noise(ego)
    windows = [each for each in gathered if each.sensor == sensor.index]
    readings = [reader.read(each.scans) for each in windows]
    times = [np.array([float(scan.time_ns - each.path.first_ns) for scan in each.scans]) for each in windows]
    found = begun = prior(ego)
    state = WindowsState(begun.mean, begun.covariance)
    for _ in range(_MOST_PASSES):
        at, state = found, WindowsState(begun.mean, begun.covariance)
        for each, read, stamped in zip(windows, readings, times, strict=True):
            said = equations.equations(read, stamped, each.path, at)
            if said is not None:
                state = added(state, said, at, each.scans[0].time_ns * 1e-9, noise)
        found = estimate(state, noise)
        if (np.abs(found.mean - at.mean)[[LATENCY, YAW]] < REACH / 10).all():
            break
    return _with_noise(sensor, equations, found, state.windows, list(zip(windows, readings, times, strict=True)))


def _with_noise(
    sensor: BoundSensor,
    equations: WindowReader,
    found: Estimate,
    count: int,
    windows: Sequence[tuple[GatheredWindow, Readings, Floats]],
) -> SensorFindings:
    """Return the findings with the noise of what stands, seen with the estimate.

    What walks is told from what drives by how far it walks, so the walk is found in several passes.
    """
    names = [str(name) for name in MEASURED if name in sensor.reader.quantities]
    walk = 0.0, 0.0
    for _ in range(_WALK_PASSES):
        samples = _samples(sensor.settings.cycle_time, equations, found, windows, walk)
        parts = {name: noise_parts(samples[name][0]) for name in ("along", "across")}
        before, walk = walk, (_walk(parts["along"]), _walk(parts["across"]))
        if all(now <= _SETTLED * then for now, then in zip(walk, before, strict=True)):
            break
    like = {name: parts.get(_DIRECTIONS.get(name, "")) for name in names}
    noise = {name: noise_parts(samples[name][0], like[name]) for name in names}
    by_range = {name: [noise_parts(each, like[name]) for each in samples[name][1:]] for name in names}
    return SensorFindings(found, count, noise, by_range, (parts["along"], parts["across"]))


def _walk(parts: NoiseParts | None) -> float:
    """Return the walk that the next pass is to expect of what stands, m²/s.

    Errors that last for `WALK_TIME`, the longest time that is told from a walk, may be a walk of which the returns that
    walked far were left out as traffic: expected is the walk that they would be.
    """
    if parts is None:
        return 0.0
    return 2.0 * parts.slow**2 / parts.time if parts.time >= WALK_TIME else parts.walk


def _samples(
    cycle: float,
    equations: WindowReader,
    found: Estimate,
    windows: Sequence[tuple[GatheredWindow, Readings, Floats]],
    walk: tuple[float, float],
) -> defaultdict[str, list[NoiseSamples]]:
    """Return the differences of residuals by quantity: all of them, and those of each of `RANGES`."""
    samples: defaultdict[str, list[NoiseSamples]] = defaultdict(
        lambda: [NoiseSamples(cycle) for _ in range(len(RANGES) + 1)]
    )
    for window, read, stamped in windows:
        standing = equations.residuals(read, stamped, window.path, found, walk)
        if standing is None:
            continue
        pairs = residual_pairs(cycle, standing.scan, standing.first, standing.count)
        part = np.searchsorted(_BOUNDS, standing.distance, side="right")
        part = np.where(part[pairs.earlier] == part[pairs.later], part[pairs.earlier], 0)
        for name, residual in standing.residuals.items():
            squares = (residual[pairs.later] - residual[pairs.earlier]) ** 2
            whole, *parts = samples[name]
            whole.add(squares, pairs.bounds)
            for k, of in enumerate(parts, 1):
                of.add(np.where(part == k, squares, np.nan), pairs.bounds)
    return samples
