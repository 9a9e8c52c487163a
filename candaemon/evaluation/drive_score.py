"""Quality of a drive's tracks without ground truth: predictions, NIS, stationary objects, duplicates.

Predictions are compared with what the radar itself measures later. All scores are updated cycle by cycle with arrays,
use bounded memory, and give their result at any time.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, nan, sqrt

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.evaluation.chi_square import chi2_quantile
from candaemon.evaluation.duplicates import DuplicateScore
from candaemon.evaluation.object_runs import ObjectRuns, RunSums, RunTotals, last_rows
from candaemon.pipeline.cycle import Cycle
from candaemon.radar.detections import Detections
from candaemon.tracking.obstacles import TENTATIVE, Obstacles
from candaemon.tracking.update import Update

_MOTION_DELAY = 2.0  # s that predictions may wait for ego motion
_TOGETHER = 16  # scans that are scored at once: arrays of one scan are short


class DriveScore:
    """Scores of a drive without ground truth, updated cycle by cycle.

    Args:
        cycle_times: nominal cycle time of each sensor, s.
        horizons: of the predictions, s.
        brief: NIS alone, which costs next to nothing; the other scores stay empty.

    Attributes:
        brief: as given.
    """

    def __init__(self, cycle_times: Sequence[float], horizons: Sequence[float], *, brief: bool = False) -> None:
        self.brief = brief
        self._runs = ObjectRuns(cycle_times)
        self._owners: dict[int, tuple[Integers, Integers]] = {}
        self._run_of: dict[tuple[int, int], Integers] = {}
        self._keep = len(cycle_times) * (round((max(horizons) + _MOTION_DELAY) / min(cycle_times)) + 64)
        self.predictions = PredictionScore(horizons, cycle_times)
        self.stationary = StationarySpeed()
        self.nis = NisScore()
        self.duplicates = DuplicateScore()

    def add(self, cycle: Cycle) -> None:
        """Update all scores with one cycle."""
        update = cycle.update
        if update is not None:
            self.nis.add(update.nis, update.degrees_of_freedom)
        if self.brief:
            return
        obstacles = cycle.obstacles
        sure = obstacles.state > TENTATIVE
        if sure.any():
            self.duplicates.add(obstacles.x[sure], obstacles.y[sure], obstacles.vx[sure])
        if cycle.detections is not None and update is not None:
            self._add_scan(cycle, cycle.detections, update)

    def _add_scan(self, cycle: Cycle, detections: Detections, update: Update) -> None:
        obstacles = cycle.obstacles
        new = detections.new | self._id_reassigned(obstacles, detections, update) | (not detections.identified)
        run = self._runs.update(detections.sensor, detections.time_ns, detections.object_id, new)
        self._run_of[detections.sensor, detections.time_ns] = run[update.detection]
        if len(self._run_of) > self._keep:
            del self._run_of[next(iter(self._run_of))]
        self.predictions.measure(detections.sensor, detections.time_ns, run, detections.x, detections.y)
        measurement = detections.measurement
        if measurement.range_rate is None:
            return
        unit = measurement.position - measurement.origin
        unit = unit / np.maximum(np.hypot(unit[:, 0], unit[:, 1]), 1e-3)[:, None]
        closing = measurement.range_rate + unit @ measurement.velocity
        vx, vy = np.full((2, len(detections)), np.nan)
        rows = obstacles.used_row
        sure = obstacles.state[rows] > TENTATIVE
        vx[update.detection[sure]] = obstacles.vx[rows[sure]]
        vy[update.detection[sure]] = obstacles.vy[rows[sure]]
        self.stationary.add(detections.time_ns, run, closing, vx, vy)

    def _id_reassigned(self, obstacles: Obstacles, detections: Detections, update: Update) -> Booleans:
        """Return which detections carry a sensor id that updated another obstacle in the previous scan."""
        changed = np.zeros(len(detections), dtype=np.bool_)
        used, owner = obstacles.used_object, obstacles.id[obstacles.used_row]
        before = self._owners.get(detections.sensor)
        self._owners[detections.sensor] = (used, owner)
        if before is None or not len(before[0]) or not len(used):
            return changed
        if np.array_equal(before[0], used) and np.array_equal(before[1], owner):  # as a rule
            return changed
        known, known_owners = before
        at = last_rows(known, used)
        changed[update.detection] = (at >= 0) & (known_owners[at] != owner[last_rows(used, used)])
        return changed

    def add_predictions(self, sensor: int, time_ns: int, horizon: int, x: Floats, y: Floats) -> None:
        """Add the predictions of one scan's used detections for one horizon, in the vehicle axes of the due time."""
        run = self._run_of.get((sensor, time_ns))
        if run is not None and len(run) == len(x):
            self.predictions.predict(sensor, time_ns, horizon, run, x, y)


@dataclass(frozen=True, slots=True)
class PredictionError:
    """Error of the predictions of one horizon.

    Attributes:
        horizon: s.
        x: RMSE along the vehicle's x axis, m; NaN without samples.
        y: RMSE along its y axis, m.
        samples: predictions compared.
    """

    horizon: float
    x: float
    y: float
    samples: int


class _Stream:
    """One sensor's recent scans and its predictions that are not due yet.

    Attributes:
        tolerance_ns: half a cycle.
        times: of the scans, ascending.
        scans: run, x and y of their objects.
        waiting: for each horizon the scans' predictions: when they are due, run, x and y.
        fresh: how many of the latest scans have not been compared with predictions.
    """

    def __init__(self, cycle_ns: int, horizons_ns: Sequence[int]) -> None:
        self.tolerance_ns = cycle_ns // 2
        self.times: list[int] = []
        self.scans: list[tuple[Integers, Floats, Floats]] = []
        # one scan's predictions a cycle; room for twice as many before the oldest is dropped
        self.waiting: tuple[deque[tuple[int, Integers, Floats, Floats]], ...] = tuple(
            deque(maxlen=2 * ceil(ahead / cycle_ns) + _TOGETHER) for ahead in horizons_ns
        )
        self.fresh = 0

    def nearest(self, time_ns: int) -> int | None:
        """Return the number of the scan nearest to a time, if it is within half a cycle and saw anything."""
        after = bisect_left(self.times, time_ns)
        best = min(
            (k for k in (after - 1, after) if 0 <= k < len(self.times)), key=lambda k: abs(self.times[k] - time_ns)
        )
        near = abs(self.times[best] - time_ns) <= self.tolerance_ns and len(self.scans[best][0])
        return best if near else None

    def due(self, horizon: int) -> Iterator[tuple[int, int, Integers, Floats, Floats]]:
        """Yield the predictions of a horizon that are due: number of the scan nearest to then, due time, run, x and y.

        Those without a scan near their due time are dropped.
        """
        queue = self.waiting[horizon]
        while queue and self.times and queue[0][0] <= self.times[-1]:
            due_ns, run, x, y = queue.popleft()
            scan = self.nearest(due_ns)
            if scan is not None:
                yield scan, due_ns, run, x, y


class PredictionScore:
    """Compares predicted positions of a sensor's object with the positions that the sensor measures later.

    The scan nearest to the due time, within half a cycle, is used. An object is identified by its run (`ObjectRuns`): a
    prediction whose run ended before the due time is discarded, and only runs of at least `minimum_run` count; where in
    the run the prediction was made does not matter.

    Args:
        horizons: s ahead, each a row of the result.
        cycles: nominal cycle time of each sensor, s, by its index.
        minimum_run: s.

    Attributes:
        horizons: as given.
        listener: called with each scan's compared predictions: sensor, time they were made at, index of the horizon,
            their rows in what `predict` was given, errors of x and y, m. Those of short runs are among them.
    """

    def __init__(self, horizons: Sequence[float], cycles: Sequence[float], *, minimum_run: float = 3.0) -> None:
        self.horizons = tuple(horizons)
        self.listener: Callable[[int, int, int, Indices, Floats, Floats], None] | None = None
        self._horizons_ns = tuple(round(horizon * 1e9) for horizon in horizons)
        # a prediction may arrive up to a second after it was due
        self._keep_ns = max(self._horizons_ns, default=0) + 1_000_000_000
        self._minimum_ns = round(minimum_run * 1e9)
        self._streams = tuple(_Stream(round(cycle * 1e9), self._horizons_ns) for cycle in cycles)
        self._runs = RunSums(3 * len(self.horizons), self._keep_ns)
        self._totals = np.zeros(3 * len(self.horizons))

    def measure(self, sensor: int, time_ns: int, run: Integers, x: Floats, y: Floats) -> None:
        """Process one scan.

        Args:
            sensor: index.
            time_ns: its measurement time; a step back discards the sensor's scans and open predictions.
            run: run of each object, shape (n,), without repetition.
            x: m forward in the vehicle axes of that time, shape (n,).
            y: m to the left, shape (n,).
        """
        stream = self._streams[sensor]
        times = stream.times
        if times and time_ns <= times[-1]:
            self._settle()
            times.clear()
            stream.scans.clear()
            for queue in stream.waiting:
                queue.clear()
        times.append(time_ns)
        stream.scans.append((run, x, y))
        stream.fresh += 1
        kept_long = time_ns - times[0] > 2 * self._keep_ns
        if kept_long or stream.fresh >= (_TOGETHER if self.listener is None else 1):
            self._settle()
            self._totals += self._total(self._runs.sweep(time_ns))
        if kept_long:
            old = bisect_left(times, time_ns - self._keep_ns)
            del times[:old], stream.scans[:old]

    def predict(self, sensor: int, time_ns: int, horizon: int, run: Integers, x: Floats, y: Floats) -> None:
        """Add predictions, in the order of their times; they may arrive after the scan that they are compared with.

        Args:
            sensor: index.
            time_ns: the time they were made at; due one horizon later.
            horizon: index into `horizons`.
            run: run of the predicted object at `time_ns`, shape (n,), without repetition.
            x: m forward in the vehicle axes of the due time, shape (n,).
            y: m to the left, shape (n,).
        """
        queue = self._streams[sensor].waiting[horizon]
        if len(queue) == queue.maxlen:
            self._settle()
        queue.append((time_ns + self._horizons_ns[horizon], run, x, y))
        if self.listener is not None:
            self._settle()

    def result(self) -> tuple[PredictionError, ...]:
        """Return the errors so far, one row per horizon; open runs count once they are long enough."""
        self._settle()
        count, x, y = (self._totals + self._total(self._runs.open())).reshape(-1, 3).T
        return tuple(
            PredictionError(horizon, sqrt(sx / n) if n else nan, sqrt(sy / n) if n else nan, int(n))
            for horizon, n, sx, sy in zip(self.horizons, count.tolist(), x.tolist(), y.tolist(), strict=True)
        )

    def _total(self, ended: RunTotals) -> Floats:
        """Return the sums of the runs that are long enough."""
        total: Floats = ended.sums[ended.last_ns - ended.first_ns >= self._minimum_ns].sum(axis=0)
        return total

    def _settle(self) -> None:
        """Compare the predictions whose due time the scans have reached, of all sensors: before any run is removed."""
        for sensor, stream in enumerate(self._streams):
            if stream.fresh:
                runs = [scan[0] for scan in stream.scans[-stream.fresh :]]
                times = np.repeat(stream.times[-stream.fresh :], [len(run) for run in runs])
                self._runs.touch(times, np.concatenate(runs))
                stream.fresh = 0
            for horizon in range(len(self.horizons)):
                self._compare(sensor, horizon)

    def _compare(self, sensor: int, horizon: int) -> None:
        """Compare the predictions of one horizon that are due with the scans, all at once."""
        stream = self._streams[sensor]
        due = list(stream.due(horizon))
        if not due:
            return
        numbers = [scan for scan, *_ in due]
        sizes = [len(run) for _, _, run, _, _ in due]
        run, x, y = (np.concatenate(columns) for columns in list(zip(*due, strict=True))[2:])
        first = min(numbers)
        seen = stream.scans[first : max(numbers) + 1]
        seen_run, seen_x, seen_y = (np.concatenate(columns) for columns in zip(*seen, strict=True))
        # one number for scan and run together
        many = int(max(run.max(initial=0), seen_run.max(initial=0))) + 1
        key = seen_run + many * np.repeat(np.arange(len(seen)), [len(scan[0]) for scan in seen])
        at = last_rows(key, run + many * np.repeat(np.array(numbers) - first, sizes))
        same = np.flatnonzero((at >= 0) & np.isfinite(x) & np.isfinite(y))
        at = at[same]
        off_x, off_y = x[same] - seen_x[at], y[same] - seen_y[at]
        self._runs.add(run[same], 3 * horizon, np.stack((np.ones(len(same)), off_x**2, off_y**2), axis=1))
        if self.listener is None:
            return
        ends = np.cumsum(sizes)
        bounds = np.searchsorted(same, [0, *ends]).tolist()
        for k, (_, due_ns, *_) in enumerate(due):
            rows = slice(bounds[k], bounds[k + 1])
            mine = same[rows] - (ends[k] - sizes[k])
            self.listener(sensor, due_ns - self._horizons_ns[horizon], horizon, mine, off_x[rows], off_y[rows])


@dataclass(frozen=True, slots=True)
class StationaryError:
    """Estimated speed over ground of stationary objects.

    Attributes:
        runs: stationary runs.
        samples: their obstacle samples.
        vx: RMS of the obstacles' vx, m/s; NaN without samples.
        speed: RMS of their speed in the plane, m/s.
    """

    runs: int
    samples: int
    vx: float
    speed: float


class StationarySpeed:
    """RMS speed over ground of obstacles whose sensor object stands still.

    A run is stationary if the median of |range rate + ego speed along the line of sight| is below `threshold`, that is,
    if more than half of its samples are.

    Args:
        threshold: m/s.
        minimum_samples: runs with fewer samples are left out.
    """

    def __init__(self, *, threshold: float = 1.0, minimum_samples: int = 20) -> None:
        self._threshold = threshold
        self._minimum = minimum_samples
        self._runs = RunSums(5, 1_000_000_000)
        self._totals = np.zeros(4)
        self._scans: list[tuple[int, Integers, Floats, Floats, Floats]] = []

    def add(self, time_ns: int, run: Integers, closing: Floats, vx: Floats, vy: Floats) -> None:
        """Process one scan, each array of shape (n,).

        Args:
            time_ns: its measurement time.
            run: run of each object, without repetition.
            closing: range rate + ego speed along the line of sight, m/s: the object's own speed along that line.
            vx: velocity over ground of the object's obstacle along x, m/s; NaN where it has no confirmed one.
            vy: the same along y.
        """
        self._scans.append((time_ns, run, closing, vx, vy))
        if len(self._scans) >= _TOGETHER:
            self._count()

    def result(self) -> StationaryError:
        """Return the figures so far, open runs included."""
        self._count()
        runs, samples, along, plane = (self._totals + self._total(self._runs.open())).tolist()
        if not samples:
            return StationaryError(int(runs), 0, nan, nan)
        return StationaryError(int(runs), int(samples), sqrt(along / samples), sqrt(plane / samples))

    def _count(self) -> None:
        """Add the scans that wait to their runs."""
        if not self._scans:
            return
        times, *columns = zip(*self._scans, strict=True)
        self._scans.clear()
        run, closing, vx, vy = map(np.concatenate, columns)
        confirmed = np.isfinite(vx) & np.isfinite(vy)
        along = np.where(confirmed, vx, 0.0) ** 2
        across = np.where(confirmed, vy, 0.0) ** 2
        slow = np.abs(closing) < self._threshold
        self._runs.touch(np.repeat(times, [len(each) for each in columns[0]]), run)
        self._runs.add(run, 0, np.stack((np.isfinite(closing), slow, confirmed, along, along + across), axis=1))
        self._totals += self._total(self._runs.sweep(times[-1]))

    def _total(self, ended: RunTotals) -> Floats:
        """Return runs, samples and sums of squares of the stationary runs among these."""
        count, slow = ended.sums[:, 0], ended.sums[:, 1]
        still = ended.sums[(count >= self._minimum) & (2 * slow > count)]
        return np.array([len(still), *still[:, 2:].sum(axis=0)])


class NisScore:
    """Normalised innovation squared: its mean against its expectation, and the share within the 95 % quantile."""

    def __init__(self) -> None:
        self._samples = 0
        self._sum = 0.0
        self._dof = 0
        self._inside = 0
        self._waiting: list[tuple[Floats, Integers]] = []

    def add(self, nis: Floats, dof: Integers) -> None:
        """Add innovations, those left out that there are none of.

        Args:
            nis: their normalised innovations squared (n,); NaN: there is none.
            dof: their degrees of freedom (n,), 1 and more.
        """
        self._waiting.append((nis, dof))
        if len(self._waiting) >= _TOGETHER:
            self._count_waiting()

    def _count_waiting(self) -> None:
        """Count what waits."""
        if not self._waiting:
            return
        nis, dof = (np.concatenate(each) for each in zip(*self._waiting, strict=True))
        self._waiting.clear()
        known = np.isfinite(nis)
        nis, dof = nis[known], dof[known]
        if not len(nis):
            return
        limits = _limits(int(dof.max()))
        self._samples += len(nis)
        self._sum += float(nis.sum())
        self._dof += int(dof.sum())
        self._inside += int((nis <= limits[dof]).sum())

    @property
    def samples(self) -> int:
        """Number of innovations so far."""
        self._count_waiting()
        return self._samples

    @property
    def mean(self) -> float:
        """Mean NIS; NaN without samples."""
        return self._sum / self.samples if self.samples else nan

    @property
    def expected(self) -> float:
        """Mean number of degrees of freedom: the expected mean NIS of a consistent filter."""
        return self._dof / self.samples if self.samples else nan

    @property
    def coverage(self) -> float:
        """Share of innovations within their 95 % quantile; 0.95 for a consistent filter."""
        return self._inside / self.samples if self.samples else nan


@lru_cache
def _limits(most: int) -> Floats:
    """Return the 95 % quantiles of NIS of 0 to so many degrees of freedom."""
    return np.array([0.0, *(chi2_quantile(0.95, k) for k in range(1, most + 1))])
