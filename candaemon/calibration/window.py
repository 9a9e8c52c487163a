"""One window of one sensor: what its standing returns say of latency, yaw, speed scale and yaw rate bias.

A point that stands is measured at z in sensor axes, from the pose (p, ψ) that the vehicle had when it was measured.
It lies at P = p + e^{iψ} (m + e^{i(ψ₀ + δ)} z), with the mounting m, ψ₀ and its error δ, and P is the same in all
scans. Its speed relative to the sensor is minus the sensor's own, V = v + i ω m in vehicle axes. Both are linear in
small errors of the four parameters; where the points lie is eliminated, track by track. The result are the normal
equations of the window, to be solved with those of others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians
from typing import Final

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, ComplexPlane, Floats, Indices, Integers
from candaemon.calibration.ego_path import EgoMoments, EgoPath
from candaemon.calibration.parameters import ALL_COLUMNS, BIAS, COUNT, LATENCY, OFFSET, SCALE, SIGHT, YAW, Estimate
from candaemon.calibration.readings import Readings, SensorReader, Speeds

LEAST_SPEED: Final = 6.0
"""m/s of the vehicle, below which standing returns show little, and who walks is hardly told from them."""
_NEAREST: Final = 3.0
"""m from the sensor: nearer, a return is any part of what it is of."""
_SLOWEST: Final = 0.4
"""m/s over ground, up to which what moves cannot be told from what stands."""
_GATE: Final = 3.0
"""Standard deviations."""
_FEWEST: Final = 5
"""Scans in which a standing return is measured."""
_SHARE: Final = 0.3
"""Of the window, at least, from a standing return's first measurement to its last."""
_HUBER: Final = 2.0
"""Standard deviations from which on a residual counts linearly."""
_LARGEST_SHARE: Final = 0.5
"""Of what a scan says of a shared error, above which a residual says nothing of its own."""
_AS_STRAIGHT: Final = 0.03
"""m across from one scan to the next, which rounding may make of none."""
_SHORTEST: Final = 1e-3
"""s, at least, between two measurements."""
_JUMP: Final = 3.0
"""m over ground from scan to scan, from which on it is another object."""


@dataclass(frozen=True, slots=True)
class WindowEquations:
    """Normal equations of a window: information × step = score.

    Attributes:
        information: (6, 6), the last rows those of what is off in this window alone.
        score: (6,).
        returns: standing returns whose drift was used.
        measurements: of them.
    """

    information: Floats
    score: Floats
    returns: int
    measurements: int


@dataclass(frozen=True, slots=True)
class StandingReturns:
    """Measurements of what stands, sorted by return, and where the parameters would move them.

    Attributes:
        readings: of the sensor, n of them.
        first: row of each return's first measurement (k,).
        count: measurements of each (k,).
        seconds: since the window began (n,).
        along, across: residual of the place along and across the line of sight, m (n,).
        along_rows, across_rows: its derivatives (n, 6).
    """

    readings: Readings
    first: Integers
    count: Integers
    seconds: Floats
    along: Floats
    across: Floats
    along_rows: Floats
    across_rows: Floats

    def take(self, returns: Booleans) -> StandingReturns:
        """Return some of the returns (k,)."""
        rows, count = np.flatnonzero(np.repeat(returns, self.count)), self.count[returns]
        return StandingReturns(
            self.readings.take(rows),
            np.concatenate([[0], np.cumsum(count)[:-1]]),
            count,
            self.seconds[rows],
            self.along[rows],
            self.across[rows],
            self.along_rows[rows],
            self.across_rows[rows],
        )


@dataclass(frozen=True, slots=True)
class StandingResiduals:
    """Residuals of n measurements of what stands, sorted by return and scan.

    Attributes:
        scan: number of the scan of each (n,).
        first: row of each return's first measurement (k,).
        count: measurements of each (k,).
        distance: from the sensor, m (n,).
        residuals: of each quantity in its own unit, and of the place `along` and `across` the line of sight, m (n,).
    """

    scan: Indices
    first: Integers
    count: Integers
    distance: Floats
    residuals: dict[str, Floats]


class WindowReader:
    """Makes the equations of one sensor's windows.

    Args:
        reader: of its scans.
    """

    def __init__(self, reader: SensorReader) -> None:
        settings = reader.settings
        self._mount = complex(settings.mount.x, settings.mount.y)
        self._yaw = radians(settings.mount.yaw_deg)
        self._polar = settings.signals.polar
        self._turning = settings.rates == "of_position"
        self._identified = settings.identified
        self._longest_gap = 4.0 * settings.revisit_time

    def equations(self, readings: Readings, times_ns: Floats, path: EgoPath, at: Estimate) -> WindowEquations | None:
        """Return the equations at an estimate; None where nothing that stands is seen.

        Args:
            readings: of the window's scans.
            times_ns: of each scan as stamped, relative to the path's first instant.
            path: ego motion, as far as the estimated latency needs it.
            at: estimate at which they are linear, and how far it may be wrong.
        """
        information, score = np.zeros((ALL_COLUMNS, ALL_COLUMNS)), np.zeros(ALL_COLUMNS)
        found = self.standing(readings, times_ns, path, at)
        if found is None:
            return None
        returns, moments = found
        for speeds in returns.readings.sight_speeds:
            residual, rows = self._speed_rows(speeds, returns.readings, moments, at)
            known = np.isfinite(residual)
            residual, rows, noise = residual[known], rows[known], speeds.noise[known]
            _add(information, score, rows, residual, _huber(residual / noise) / noise)
        readings, sizes = returns.readings, returns.count
        for residual, rows, noise in (
            (returns.along, returns.along_rows, readings.along),
            (returns.across, returns.across_rows, readings.across),
        ):
            deviation = _means(noise, returns)
            weight = np.repeat(_huber(_spread_of(residual, returns) / np.maximum(deviation, 1e-9)) / deviation, sizes)
            _add(information, score, rows, residual, weight)
        return WindowEquations(information, score, len(sizes), len(residual))

    def residuals(
        self, readings: Readings, times_ns: Floats, path: EgoPath, at: Estimate, walk: tuple[float, float]
    ) -> StandingResiduals | None:
        """Return the residuals of what stands; None where nothing that stands is seen.

        Args:
            readings: of the window's scans.
            times_ns: as for `equations`.
            path: likewise.
            at: the estimate.
            walk: of what stands, along and across the line of sight, m²/s: it does not drift faster for that.
        """
        found = self.standing(readings, times_ns, path, at, walk)
        if found is None:
            return None
        returns, moments = found
        of, distance = returns.readings, np.abs(returns.readings.place)
        (across,) = _without_shared([(returns.across, distance, of.across)], of.scan)  # what the ego's heading is off
        residuals = {"along": returns.along, "across": across}
        if self._polar:
            residuals |= {"range": returns.along, "azimuth": across / distance}
        else:
            middle = returns.first + returns.count // 2
            sight = np.repeat(of.place[middle] / distance[middle], returns.count)
            place = sight * (returns.along + 1j * across)
            residuals |= {"x": place.real, "y": place.imag}
        residuals |= self._speed_residuals(of, moments, at)
        return StandingResiduals(of.scan, returns.first, returns.count, distance, residuals)

    def standing(
        self,
        readings: Readings,
        times_ns: Floats,
        path: EgoPath,
        at: Estimate,
        walk: tuple[float, float] = (0.0, 0.0),
    ) -> tuple[StandingReturns, EgoMoments] | None:
        """Return the returns that stand, and the ego motion at each scan; None: there are none."""
        latency, _, scale, bias = at.mean
        moments = path.at(times_ns - latency * 1e9, 1.0 + scale, bias)
        if moments.speed.min(initial=LEAST_SPEED) < LEAST_SPEED:
            return None
        slow = _squared(readings.place) > _NEAREST**2
        for speeds in readings.sight_speeds:
            residual, rows = self._speed_rows(speeds, readings, moments, at)
            slow &= np.abs(residual) < _SLOWEST + _GATE * np.hypot(speeds.noise, _expected(rows, at))
        if self._identified and slow.any():
            slow &= ~_coasted(readings)
        if np.count_nonzero(slow) < _FEWEST:
            return None
        if not slow.all():
            readings = readings.take(np.flatnonzero(slow))
        found = self._tracked(readings, moments, at, walk)
        return None if found is None else (found, moments)

    def _tracked(
        self, readings: Readings, moments: EgoMoments, at: Estimate, walk: tuple[float, float]
    ) -> StandingReturns | None:
        """Return the measurements by what they are of, without what drifts more than any estimate explains."""
        scan = readings.scan
        seen = self._seen(readings.place, at)
        place = moments.position.take(scan) + moments.ahead.take(scan) * seen
        if self._identified:
            order, first, counts = self._by_identity(readings, moments.since, place)
        else:
            order, first, counts = _by_place(readings, place)
        begin, end = order.take(first), order.take(first + counts - 1)
        length = moments.since.take(scan.take(end)) - moments.since.take(scan.take(begin))
        window = moments.since[scan[-1]] - moments.since[scan[0]]
        kept = (counts >= _FEWEST) & (length >= _SHARE * window)
        length = np.maximum(length, _SHORTEST)
        drift = np.abs(place.take(end) - place.take(begin)) / length
        kept &= drift < _SLOWEST + _GATE * self._likely_drift(readings, begin, moments, at, length, walk)
        if not kept.any():
            return None
        rows = order[np.repeat(kept, counts)]
        returns = self._returns(readings.take(rows), seen.take(rows), moments, counts[kept])
        still = _stands(returns, at, walk)
        if not still.any():
            return None
        return returns if still.all() else returns.take(still)

    def _likely_drift(
        self,
        readings: Readings,
        begin: Indices,
        moments: EgoMoments,
        at: Estimate,
        length: Floats,
        walk: tuple[float, float],
    ) -> Floats:
        """Return how fast k returns that stand may seem to drift from first to last, m/s (k,).

        No smaller than one standard deviation of that: what drifts faster is told without any derivatives.

        Args:
            readings: of the sensor.
            begin: rows of their first measurements (k,).
            moments: at each scan.
            at: the estimate.
            length: s from the first measurement to the last (k,).
            walk: as for `residuals`.
        """
        speed, turn = float(np.abs(moments.speed).max()), float(np.abs(moments.turn).max())
        faster, sharper = float(np.abs(moments.acceleration).max()), float(np.abs(moments.turn_change).max())
        nearest = np.abs(readings.place.take(begin))
        distance = nearest + (abs(self._mount) + speed * length)  # the farthest meanwhile
        latency, yaw, scale, bias = at.deviation.tolist()
        drift = (latency * (turn**2 + sharper) + 2.0 * bias) * distance
        drift += latency * (faster + 2.0 * speed * turn) + scale / (1.0 + float(at.mean[SCALE])) * speed
        drift += yaw * (speed + turn * abs(self._mount))
        along, across = readings.along.take(begin), readings.across.take(begin) * distance / nearest
        noise = np.sqrt(2.0 * (along**2 + across**2))  # of both ends
        return np.asarray(drift + noise / length + np.sqrt(sum(walk) / length))

    def _returns(
        self, readings: Readings, seen: ComplexPlane, moments: EgoMoments, counts: Integers
    ) -> StandingReturns:
        """Return residuals and derivatives of the places, less their means over each return.

        Args:
            readings: sorted by return (n,).
            seen: their places in vehicle axes (n,).
            moments: at each scan.
            counts: measurements of each return (k,).
        """
        scan, ahead = readings.scan, moments.ahead
        offset = ahead.take(scan) * seen
        turned = (1j * ahead).take(scan) * (seen - self._mount)
        place = moments.position.take(scan) + offset
        rows = np.empty((len(place), ALL_COLUMNS), np.complex128)
        rows[:, LATENCY] = -((moments.speed * ahead).take(scan) + (1j * moments.turn).take(scan) * offset)
        rows[:, YAW] = turned
        rows[:, SCALE] = moments.per_scale.take(scan)
        rows[:, OFFSET] = moments.per_offset.take(scan)
        rows[:, SIGHT] = 0.0
        rows[:, BIAS] = moments.per_bias.take(scan) - (1j * moments.since).take(scan) * offset
        first = counts.cumsum() - counts
        sight = turned.take(first + counts // 2)
        sight = (sight / np.maximum(np.abs(sight), 1e-9) / 1j).conj().repeat(counts)
        place, rows = sight * place, sight[:, None] * rows
        place -= (np.add.reduceat(place, first) / counts).repeat(counts)
        rows -= (np.add.reduceat(rows, first) / counts[:, None]).repeat(counts, axis=0)
        seconds = moments.since.take(scan)
        return StandingReturns(
            readings, first, counts, seconds, -place.real, -place.imag, rows.real.copy(), rows.imag.copy()
        )

    def _seen(self, place: ComplexPlane, at: Estimate) -> ComplexPlane:
        """Return places in vehicle axes, as the estimate turns the sensor."""
        return np.asarray(self._mount + np.exp(1j * (self._yaw + at.mean[YAW])) * place)

    def _speed_rows(
        self, speeds: Speeds, readings: Readings, moments: EgoMoments, at: Estimate
    ) -> tuple[Floats, Floats]:
        """Return by how much measured speeds differ from those of what stands (n,), and these' derivatives (n, 6).

        Args:
            speeds: of the readings (n,).
            readings: n of them.
            moments: at each scan.
            at: the estimate.
        """
        place, scan = readings.place, readings.scan
        turn = np.exp(1j * (self._yaw + at.mean[YAW]))
        own = (moments.speed + 1j * moments.turn * self._mount) / turn  # the sensor's velocity in its own axes
        change = (moments.acceleration + 1j * moments.turn_change * self._mount) / turn
        rows = np.empty((len(own), ALL_COLUMNS), np.complex128)
        rows[:, LATENCY] = change
        rows[:, YAW] = 1j * own
        rows[:, SCALE] = -moments.speed / (1.0 + at.mean[SCALE]) / turn
        rows[:, BIAS] = 1j * self._mount / turn
        rows[:, OFFSET] = -1.0 / turn
        rows[:, SIGHT] = rows[:, YAW]
        expected, rows = -own[scan], rows[scan]
        if self._turning and speeds.name != "range_rate":
            expected = expected - (1j * moments.turn)[scan] * place
            rows[:, LATENCY] += (1j * moments.turn_change)[scan] * place
            rows[:, BIAS] += 1j * place
        unit: ComplexPlane = np.full(len(place), 1j if speeds.name == "vy" else 1.0 + 0j)
        if speeds.name == "range_rate":
            unit = place / np.maximum(np.abs(place), 1e-9)
        shown = np.real(unit.conj() * expected)
        return speeds.value - shown, np.real(unit.conj()[:, None] * rows)

    def _speed_residuals(self, readings: Readings, moments: EgoMoments, at: Estimate) -> dict[str, Floats]:
        """Return the residuals of each measured speed (n,), without what all returns of a scan share by own turning."""
        found = {each.name: self._speed_rows(each, readings, moments, at) for each in readings.speeds}
        residuals = {name: residual for name, (residual, _) in found.items()}
        turned = [each for each in readings.speeds if self._turning and each.name != "range_rate"]
        shared = [(residuals[each.name], found[each.name][1][:, BIAS], each.noise) for each in turned]
        return residuals | dict(
            zip((each.name for each in turned), _without_shared(shared, readings.scan), strict=True)
        )

    def _by_identity(self, readings: Readings, since: Floats, place: ComplexPlane) -> tuple[Indices, Indices, Indices]:
        """Return which measurements are of one return, by the sensor's ids and where they jump.

        Args:
            readings: n of them.
            since: time of each scan, s.
            place: of the measurements over ground (n,).

        Returns:
            Rows of the measurements, sorted by return and scan (n,), where in these each return begins, and how many of
            them are of it (k,).
        """
        order = readings.object_id.argsort(kind="stable")  # the scans ascend
        if compiled.in_use:
            parts = (readings.object_id, readings.new, readings.scan, since, place)
            return order, *compiled.kernels.successions(order, *parts, _JUMP**2, self._longest_gap)
        key, place = readings.object_id.take(order), place.take(order)
        begins = readings.new.take(order)
        begins[0] = True
        begins[1:] |= key[1:] != key[:-1]
        begins[1:] |= _squared(place[1:] - place[:-1]) > _JUMP**2
        begins[1:] |= np.diff(since.take(readings.scan.take(order))) > self._longest_gap
        return order, *_successions(begins)


def _squared(plane: ComplexPlane) -> Floats:
    """Return the squares of lengths; the lengths themselves take five times as long."""
    return np.asarray(plane.real**2 + plane.imag**2)


def _without_shared(parts: Sequence[tuple[Floats, Floats, Floats]], scan: Indices) -> list[Floats]:
    """Return residuals without what all of a scan share, as far as they themselves tell it.

    What is left is made larger by as much as the fit made it smaller; NaN where the fit follows one residual.

    Args:
        parts: residuals of n measurements, how much each has of what is shared, and their noise, (n,) each.
        scan: number of the scan of each measurement (n,).
    """
    information, score = np.zeros((2, 1 + int(scan.max())))
    for residual, lever, noise in parts:
        known = np.isfinite(residual)
        np.add.at(information, scan[known], (lever / noise)[known] ** 2)
        np.add.at(score, scan[known], (lever / noise**2 * residual)[known])
    information = np.maximum(information, 1e-9)
    rest = []
    for residual, lever, noise in parts:
        share = (lever / noise) ** 2 / information[scan]
        left = (residual - lever * (score / information)[scan]) / np.sqrt(np.maximum(1.0 - share, 0.1))
        rest.append(np.where(share < _LARGEST_SHARE, left, np.nan))
    return rest


def _coasted(readings: Readings) -> Booleans:
    """Return which measurements only go on along the line of sight at the speed of the scan before, (n,).

    A radar that lost sight of a thing reports it for a while where it would be, and the way across is not in that: what
    is passed then seems to drift, as if the sensor were turned.
    """
    rates = [each.value for each in readings.speeds if each.name == "range_rate"]
    coasted = np.zeros(len(readings.place), dtype=np.bool_)
    if not rates:
        return coasted
    order = np.lexsort((readings.scan, readings.object_id))
    later, earlier = order[1:], order[:-1]
    angle = np.angle(readings.place[later] * readings.place[earlier].conj())
    same = readings.object_id[later] == readings.object_id[earlier]
    same &= (rates[0][later] == rates[0][earlier]) & (np.abs(angle) * np.abs(readings.place[later]) < _AS_STRAIGHT)
    coasted[later[same]] = True
    return coasted


def _successions(begins: Booleans) -> tuple[Indices, Indices]:
    """Return the rows that begin something (k,), and how many rows it has, out of whether each does (n,)."""
    first = begins.nonzero()[0]
    return first, np.diff(first, append=len(begins))


def _by_place(readings: Readings, place: ComplexPlane) -> tuple[Indices, Indices, Indices]:
    """Return which measurements are of one return, as `_by_identity`, of a sensor without ids: what is nearest."""
    track = np.empty(len(place), np.int64)
    last = np.empty(0, np.complex128)
    numbers = np.empty(0, np.int64)
    given = 0
    for scan in range(int(readings.scan[-1]) + 1):
        rows = np.flatnonzero(readings.scan == scan)
        if not len(rows):
            continue
        here, number = place[rows], np.full(len(rows), -1, np.int64)
        if len(last):
            apart = np.abs(here[:, None] - last[None, :])
            nearest, back = apart.argmin(axis=1), apart.argmin(axis=0)
            mutual = (back[nearest] == np.arange(len(rows))) & (apart.min(axis=1) < _JUMP / 2)
            number[mutual] = numbers[nearest[mutual]]
            last[nearest[mutual]] = here[mutual]
        fresh = np.flatnonzero(number < 0)
        number[fresh] = given + np.arange(len(fresh))
        given += len(fresh)
        last, numbers = np.concatenate([last, here[fresh]]), np.concatenate([numbers, number[fresh]])
        track[rows] = number
    order = track.argsort(kind="stable")
    return order, *_successions(np.diff(track.take(order), prepend=-1) != 0)


def _stands(returns: StandingReturns, at: Estimate, walk: tuple[float, float]) -> Booleans:
    """Return which returns drift no faster than noise, their walk and a wrong estimate explain.

    The slope that is fitted to a random walk of density q over a time T has the variance 6 q / (5 T).
    """
    seconds = returns.seconds - _means(returns.seconds, returns).repeat(returns.count)
    swept = np.maximum(np.add.reduceat(seconds**2, returns.first), 1e-9)
    last = returns.first + returns.count - 1
    length = np.maximum(returns.seconds.take(last) - returns.seconds.take(returns.first), _SHORTEST)
    residual = np.array([returns.along, returns.across])
    rows = np.array([returns.along_rows[:, :COUNT], returns.across_rows[:, :COUNT]])
    noise = np.array([returns.readings.along, returns.readings.across])
    drift = np.add.reduceat(seconds * residual, returns.first, axis=1) / swept
    per = np.add.reduceat(seconds[:, None] * rows, returns.first, axis=1) / swept[:, None]
    error = np.hypot(_means(noise, returns) / np.sqrt(swept), _expected(per, at))
    error = np.hypot(error, np.sqrt(1.2 * np.array(walk)[:, None] / length))
    return np.asarray((np.abs(drift) < _SLOWEST + _GATE * error).all(axis=0))


def _means(values: Floats, returns: StandingReturns) -> Floats:
    """Return the means (…, k) over each return of values (…, n)."""
    return np.asarray(np.add.reduceat(values, returns.first, axis=-1) / returns.count)


def _spread_of(values: Floats, returns: StandingReturns) -> Floats:
    """Return the root mean square over each return (k,)."""
    return np.sqrt(_means(values**2, returns))


def _expected(rows: Floats, at: Estimate) -> Floats:
    """Return one standard deviation of what the estimate's error does to rows (…, n, 4 or more), as (…, n)."""
    rows = rows[..., :COUNT]
    return np.asarray(np.sqrt(np.maximum(np.sum((rows @ at.covariance) * rows, axis=-1), 0.0)))


def _huber(deviations: Floats) -> Floats:
    """Return the square root of the weight of residuals, in standard deviations."""
    return np.sqrt(np.minimum(1.0, _HUBER / np.maximum(np.abs(deviations), 1e-9)))


def _add(information: Floats, score: Floats, rows: Floats, residual: Floats, weight: Floats) -> None:
    """Add weighted equations rows · step = residual, in place."""
    weighted = rows * weight[:, None]
    information += weighted.T @ weighted
    score += weighted.T @ (residual * weight)
