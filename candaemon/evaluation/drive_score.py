"""Quality of a drive's tracks without ground truth: predictions, NIS, stationary objects, duplicates.

Predictions are compared with what the radar itself measures later. All scores are updated cycle by cycle with arrays,
use bounded memory, and give their result at any time.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, nan, sqrt

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.evaluation.chi_square import chi2_quantile
from candaemon.evaluation.duplicates import DuplicateScore
from candaemon.evaluation.object_runs import ObjectRuns, RunSums, RunTotals
from candaemon.pipeline.cycle import Cycle
from candaemon.tracking.obstacles import TENTATIVE

_MOTION_DELAY = 2.0  # s that predictions may wait for ego motion


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
        update = cycle.tracker.update if cycle.tracker is not None and cycle.detections is not None else None
        if update:
            known = np.isfinite(update.nis)
            self.nis.add(update.nis[known], update.degrees_of_freedom[known])
        if self.brief:
            return
        obstacles = cycle.obstacles
        sure = obstacles.state > TENTATIVE
        if sure.any():
            self.duplicates.add(obstacles.x[sure], obstacles.y[sure], obstacles.vx[sure])
        if cycle.detections is not None and cycle.tracker is not None:
            self._add_scan(cycle)

    def _add_scan(self, cycle: Cycle) -> None:
        detections, obstacles, update = cycle.detections, cycle.obstacles, cycle.tracker and cycle.tracker.update
        if detections is None or not update:
            return
        new = detections.new | self._id_reassigned(cycle) | (not detections.identified)
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

    def _id_reassigned(self, cycle: Cycle) -> Booleans:
        """Return which detections carry a sensor id that updated another obstacle in the previous scan."""
        detections, obstacles, update = cycle.detections, cycle.obstacles, cycle.tracker and cycle.tracker.update
        changed = np.zeros(0 if detections is None else len(detections), dtype=np.bool_)
        if detections is None or not update:
            return changed
        order = np.argsort(obstacles.used_object, kind="stable")
        objects, owners = obstacles.used_object[order], obstacles.id[obstacles.used_row][order]
        last = np.append(objects[1:] != objects[:-1], np.ones(min(len(objects), 1), dtype=np.bool_))
        objects, owners = objects[last], owners[last]
        before = self._owners.get(detections.sensor)
        self._owners[detections.sensor] = (objects, owners)
        if before is None or not len(before[0]) or not len(objects):
            return changed
        known, known_owners = before
        at = np.minimum(np.searchsorted(known, obstacles.used_object), len(known) - 1)
        owner = owners[np.searchsorted(objects, obstacles.used_object)]
        changed[update.detection] = (known[at] == obstacles.used_object) & (known_owners[at] != owner)
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
    """One sensor's recent scans and its predictions that are not due yet."""

    def __init__(self, cycle_ns: int, horizons_ns: Sequence[int]) -> None:
        self.tolerance_ns = cycle_ns // 2
        self.times: list[int] = []
        self.scans: list[tuple[Integers, Floats, Floats]] = []
        # one scan's predictions a cycle; room for twice as many before the oldest is dropped
        self.waiting: tuple[deque[tuple[int, Integers, Floats, Floats]], ...] = tuple(
            deque(maxlen=2 * ceil(ahead / cycle_ns) + 16) for ahead in horizons_ns
        )

    def nearest(self, time_ns: int) -> tuple[Integers, Floats, Floats] | None:
        """Return the scan nearest to a time, if it is within half a cycle."""
        after = bisect_left(self.times, time_ns)
        best = min(
            (k for k in (after - 1, after) if 0 <= k < len(self.times)), key=lambda k: abs(self.times[k] - time_ns)
        )
        return self.scans[best] if abs(self.times[best] - time_ns) <= self.tolerance_ns else None


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
        times, scans = stream.times, stream.scans
        if times and time_ns <= times[-1]:
            times.clear()
            scans.clear()
            for queue in stream.waiting:
                queue.clear()
        order = np.argsort(run)
        times.append(time_ns)
        scans.append((run[order], x[order], y[order]))
        self._totals += self._total(self._runs.touch(time_ns, run))
        if time_ns - times[0] > 2 * self._keep_ns:
            old = bisect_left(times, time_ns - self._keep_ns)
            del times[:old], scans[:old]
        for horizon in range(len(self.horizons)):
            self._settle(sensor, horizon)

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
        stream = self._streams[sensor]
        stream.waiting[horizon].append((time_ns + self._horizons_ns[horizon], run, x, y))
        self._settle(sensor, horizon)

    def result(self) -> tuple[PredictionError, ...]:
        """Return the errors so far, one row per horizon; open runs count once they are long enough."""
        count, x, y = (self._totals + self._total(self._runs.open())).reshape(-1, 3).T
        return tuple(
            PredictionError(horizon, sqrt(sx / n) if n else nan, sqrt(sy / n) if n else nan, int(n))
            for horizon, n, sx, sy in zip(self.horizons, count.tolist(), x.tolist(), y.tolist(), strict=True)
        )

    def _total(self, ended: RunTotals) -> Floats:
        """Return the sums of the runs that are long enough."""
        total: Floats = ended.sums[ended.last_ns - ended.first_ns >= self._minimum_ns].sum(axis=0)
        return total

    def _settle(self, sensor: int, horizon: int) -> None:
        """Compare the predictions whose due time the scans have reached."""
        stream = self._streams[sensor]
        queue, times = stream.waiting[horizon], stream.times
        while queue and times and queue[0][0] <= times[-1]:
            due_ns, run, x, y = queue.popleft()
            scan = stream.nearest(due_ns)
            if scan is None or not len(scan[0]):
                continue
            seen, seen_x, seen_y = scan
            at = np.minimum(np.searchsorted(seen, run), len(seen) - 1)
            same = np.flatnonzero((seen[at] == run) & np.isfinite(x) & np.isfinite(y))
            at = at[same]
            off_x, off_y = x[same] - seen_x[at], y[same] - seen_y[at]
            self._runs.add(run[same], 3 * horizon, np.stack((np.ones(len(same)), off_x**2, off_y**2), axis=1))
            if self.listener is not None:
                self.listener(sensor, due_ns - self._horizons_ns[horizon], horizon, same, off_x, off_y)


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

    def add(self, time_ns: int, run: Integers, closing: Floats, vx: Floats, vy: Floats) -> None:
        """Process one scan, each array of shape (n,).

        Args:
            time_ns: its measurement time.
            run: run of each object, without repetition.
            closing: range rate + ego speed along the line of sight, m/s: the object's own speed along that line.
            vx: velocity over ground of the object's obstacle along x, m/s; NaN where it has no confirmed one.
            vy: the same along y.
        """
        self._totals += self._total(self._runs.touch(time_ns, run))
        confirmed = np.isfinite(vx) & np.isfinite(vy)
        along = np.where(confirmed, vx, 0.0) ** 2
        across = np.where(confirmed, vy, 0.0) ** 2
        slow = np.abs(closing) < self._threshold
        self._runs.add(run, 0, np.stack((np.isfinite(closing), slow, confirmed, along, along + across), axis=1))

    def result(self) -> StationaryError:
        """Return the figures so far, open runs included."""
        runs, samples, along, plane = (self._totals + self._total(self._runs.open())).tolist()
        if not samples:
            return StationaryError(int(runs), 0, nan, nan)
        return StationaryError(int(runs), int(samples), sqrt(along / samples), sqrt(plane / samples))

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

    def add(self, nis: Floats, dof: Integers) -> None:
        """Add n innovations by their normalised innovation squared and degrees of freedom (≥ 1), shape (n,)."""
        if not len(nis):
            return
        limits = np.array([0.0, *(chi2_quantile(0.95, k) for k in range(1, int(dof.max()) + 1))])
        self._samples += len(nis)
        self._sum += float(nis.sum())
        self._dof += int(dof.sum())
        self._inside += int((nis <= limits[dof]).sum())

    @property
    def samples(self) -> int:
        """Number of innovations so far."""
        return self._samples

    @property
    def mean(self) -> float:
        """Mean NIS; NaN without samples."""
        return self._sum / self._samples if self._samples else nan

    @property
    def expected(self) -> float:
        """Mean number of degrees of freedom: the expected mean NIS of a consistent filter."""
        return self._dof / self._samples if self._samples else nan

    @property
    def coverage(self) -> float:
        """Share of innovations within their 95 % quantile; 0.95 for a consistent filter."""
        return self._inside / self._samples if self._samples else nan
