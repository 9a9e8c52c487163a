"""Lidar and radar on one target that turns, our vehicle at rest, beside an extended Kalman filter of its motion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.config.sensors import FieldOfView, Mount
from candaemon.config.tracker import TrackerSettings
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.estimation.measurement import Measurement
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import SensorView
from candaemon.tracking.any_tracker import make_tracker
from candaemon.tracking.identities import Identities
from tests.accuracy.experiments.finding import Effort, Experiment, Finding
from tests.accuracy.experiments.turning_filter import GRID, TurningFilters

LIDAR, RADAR = 0, 1
BOTH: Final = (LIDAR, RADAR)
SETTLED: Final = 1.0
"""s after the first scan, from which on errors count."""
WORSE: Final = 1.05
"""How many times the error of the extended Kalman filter is allowed."""
COLUMNS: Final = ("x", "y", "vx", "vy")


@dataclass(frozen=True, slots=True)
class Course:
    """A target and what the sensors know of it.

    Attributes:
        name: of the set.
        start: x, y (m), speed (m/s), heading (rad).
        manoeuvres: (time, acceleration, turn rate), s, m/s² and rad/s, straight lines between; the last ends it.
        step: s between the scans of the two sensors, which take turns.
        lidar: m, noise in x and y.
        radar: noise of range (m), azimuth (rad) and range rate (m/s).
    """

    name: str
    start: tuple[float, float, float, float]
    manoeuvres: tuple[tuple[float, float, float], ...]
    step: float
    lidar: float
    radar: tuple[float, float, float]

    def states(self, seconds: float) -> tuple[Floats, Floats]:
        """Return the times (n,) and the target's [x, y, vx, vy] then (n, 4)."""
        fine = 20
        x, y, speed, heading = self.start
        rows, times = [], []
        knots, *controls = np.array(self.manoeuvres).T
        for k in range(fine * math.floor(min(seconds, self.manoeuvres[-1][0]) / self.step)):
            time = k * self.step / fine
            if k % fine == 0:
                times.append(time)
                rows.append((x, y, speed * math.cos(heading), speed * math.sin(heading)))
            dt = self.step / fine
            acceleration, turn = (float(np.interp(time, knots, each)) for each in controls)
            middle = heading + 0.5 * turn * dt
            along = (speed + 0.5 * acceleration * dt) * dt
            x, y = x + along * math.cos(middle), y + along * math.sin(middle)
            speed, heading = speed + acceleration * dt, heading + turn * dt
        return np.array(times), np.array(rows)


EXERCISE: Final = Course(
    "exercise",
    (4.0, 2.0, 5.2, 0.3),
    ((0, 0.0, 0.05), (5, 0.3, 0.1), (8, 0.0, 0.5), (12, -0.3, 0.1), (15, 0.0, -0.55), (20, 0.3, 0.0), (25, 0, 0.4)),
    0.05,
    0.15,
    (0.3, 0.03, 0.3),
)
ROAD: Final = Course(
    "road",
    (70.0, -25.0, 14.0, 2.0),
    ((0, 0.0, 0.0), (3, -3.0, 0.0), (7, 1.0, 0.3), (10, 3.0, 0.0), (14, 0.0, -0.3), (17, -2.0, 0.1), (20, 1, 0.2)),
    0.025,
    0.1,
    (0.25, 0.01, 0.12),
)


@dataclass(frozen=True, slots=True)
class Sightings:
    """What the sensors of a course say: entry k is of sensor k mod 2.

    Attributes:
        course: whose.
        times: (n,), s.
        truth: [x, y, vx, vy] (n, 4).
        position: as measured (n, 2), m.
        noise: its covariance (n, 2, 2), m²; of the radar, linearised where it was measured.
        rate: range rate (n,), m/s; NaN of the lidar.
    """

    course: Course
    times: Floats
    truth: Floats
    position: Floats
    noise: Floats
    rate: Floats

    def measurement(self, k: int) -> Measurement:
        """Return an entry as the filters take it."""
        sensor = k % 2
        rows = slice(k, k + 1)
        rate, variance = (self.rate[rows], np.full(1, self.course.radar[2] ** 2)) if sensor == RADAR else (None, None)
        return Measurement(
            self.position[rows], self.noise[rows], np.zeros(2), np.zeros(2), rate, variance, sensor=sensor
        )


def sightings(course: Course, seed: int, seconds: float) -> Sightings:
    """Return what the sensors say."""
    random = np.random.default_rng(seed)
    times, truth = course.states(seconds)
    n = len(times)
    lidar = truth[:, :2] + course.lidar * random.standard_normal((n, 2))
    distance, angle = np.hypot(*truth[:, :2].T), np.arctan2(truth[:, 1], truth[:, 0])
    rate = (truth[:, :2] * truth[:, 2:]).sum(axis=1) / distance
    deviation = np.array(course.radar)
    seen = np.stack([distance, angle, rate], axis=1) + deviation * random.standard_normal((n, 3))
    unit = np.stack([np.cos(seen[:, 1]), np.sin(seen[:, 1])], axis=1)
    normal = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    along, across = deviation[0] * unit, (deviation[1] * seen[:, 0])[:, None] * normal
    spread = along[:, :, None] * along[:, None] + across[:, :, None] * across[:, None]
    by_radar = np.arange(n) % 2 == RADAR
    return Sightings(
        course,
        times,
        truth,
        np.where(by_radar[:, None], seen[:, :1] * unit, lidar),
        np.where(by_radar[:, None, None], spread, course.lidar**2 * np.eye(2)),
        np.where(by_radar, seen[:, 2], math.nan),
    )


@dataclass(frozen=True, slots=True)
class Tracked:
    """What a tracker made of sightings.

    Attributes:
        errors: [x, y, vx, vy] of the nearest obstacle (m, 4) from `SETTLED` on; NaN where there was none.
        numbers: obstacles, tentative ones too, in each cycle from the third on.
    """

    errors: Floats
    numbers: list[int]


def tracked(seen: Sightings, settings: TrackerSettings, sensors: Sequence[int]) -> Tracked:
    """Return what the tracker makes of the detections of some of the sensors."""
    cycle_time = 2 * seen.course.step
    view = SensorView(Mount(), FieldOfView(range=300, azimuth_deg=180))
    slack_ns = round(1.5 * cycle_time * 1e9) if len(sensors) > 1 else 0
    tracker = make_tracker(
        settings, Identities(), cycle_time=cycle_time, slack_ns=slack_ns, views=[view] * len(sensors)
    )
    errors, numbers = [], []
    for k, time in enumerate(seen.times.tolist()):
        if k % 2 not in sensors:
            continue
        time_ns = round((time + 1.0) * 1e9)
        x, y = seen.position[k : k + 1].T
        detections = Detections(
            time_ns, k % 2, np.ones(1, dtype=np.int64), np.zeros(1, dtype=np.bool_), seen.measurement(k), x, y
        )
        obstacles = tracker.step(detections, EgoPose(time_ns, 0, 0, 0, 0, 0, 0, 0, EgoStatus.VALID))
        numbers.append(len(obstacles))
        if time < SETTLED:
            continue
        off = np.stack([getattr(obstacles, name) for name in COLUMNS], axis=1) - seen.truth[k]
        errors.append(off[np.hypot(off[:, 0], off[:, 1]).argmin()] if len(off) else np.full(4, math.nan))
    return Tracked(np.array(errors), numbers[2:])


def course_findings(course: Course, effort: Effort) -> Iterator[Finding]:
    """Yield the figures of one course."""
    runs = [sightings(course, seed, effort.seconds) for seed in effort.seeds]
    settings = effort.settings
    found = {chosen: [tracked(run, settings, chosen) for run in runs] for chosen in (BOTH, (LIDAR,), (RADAR,))}
    rmse = {chosen: _rmse([one.errors for one in several]) for chosen, several in found.items()}
    filters = TurningFilters(runs[0].times, [[run.measurement(k) for run in runs] for k in range(len(runs[0].times))])
    settled = runs[0].times >= SETTLED
    by_grid = [_rmse([filters.states[settled, s, g] - runs[0].truth[settled] for s in range(len(runs))])
               for g in range(len(GRID))]  # fmt: skip
    best = min(range(len(GRID)), key=lambda g: _plane(by_grid[g], 0) * _plane(by_grid[g], 2))
    reference = by_grid[best]
    tuning = "EKF, {:g} m/s² and {:g} rad/s²".format(*GRID[best])
    for k, name in enumerate(COLUMNS):
        unit = "m/s" if k > 1 else "m"
        yield Finding(f"{name}, {tuning}", reference[k], unit)
        yield Finding(f"{name}, lidar and radar", rmse[BOTH][k], unit, most=WORSE * reference[k])
    for first, quantity, unit in ((0, "position", "m"), (2, "velocity", "m/s")):
        alone = [_plane(rmse[(sensor,)], first) for sensor in BOTH]
        yield Finding(f"{quantity}, lidar alone", alone[LIDAR], unit)
        yield Finding(f"{quantity}, radar alone", alone[RADAR], unit)
        yield Finding(f"{quantity}, lidar and radar", _plane(rmse[BOTH], first), unit, most=min(alone))
    numbers = [number for one in found[BOTH] for number in one.numbers]
    other = sum(number != 1 for number in numbers)
    yield Finding("scans from the third on with none or several obstacles", other, f"of {len(numbers)}", most=0)


def _rmse(errors: Sequence[Floats]) -> Floats:
    """Return the RMSE of each column over all runs."""
    return np.asarray(np.sqrt(np.mean(np.square(np.concatenate(errors)), axis=0)))


def _plane(rmse: Floats, first: int) -> float:
    return math.hypot(rmse[first], rmse[first + 1])


def _numbers(part: int) -> list[str]:
    """Return the different numbers of one part of the grid, as text."""
    return [f"{number:g}" for number in sorted({pair[part] for pair in GRID})]


def run(effort: Effort) -> Iterator[Finding]:
    """Yield the figures of both courses."""
    for course in (EXERCISE, ROAD):
        for one in course_findings(course, effort):
            yield Finding(f"{course.name}: {one.name}", one.value, one.unit, one.least, one.most)


LIDAR_AND_RADAR: Final = Experiment(
    "are lidar and radar on one target better than either, and as good as a filter made for it?",
    (
        ("exercise", "some 5 m/s, turns of .55 rad/s; each sensor at 10 Hz: .15 m; .3 m, .03 rad, .3 m/s"),
        ("road", "some 14 m/s, brakes and turns; each sensor at 20 Hz: .1 m; .25 m, .01 rad, .12 m/s"),
        ("errors", f"RMSE over all runs from {SETTLED:g} s on; position, velocity: in the plane"),
        ("EKF", "constant turn rate and velocity, the best of a grid of its process noise, given the same detections"),
        ("grid", f"{', '.join(_numbers(0))} m/s² by {', '.join(_numbers(1))} rad/s²"),
    ),
    6,
    run,
)
