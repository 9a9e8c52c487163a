"""Ranges without a direction: which track each is of, and where those of two sensors meet (trilateration).

Source: Avatirak et al. 2012.

A range that fits a track updates it along the line of sight to where it is expected; the scans of two sensors so fix it
where their circles meet, without being brought to one instant. What fits no track is paired with what other sensors
have left over: where the circles meet inside both fields of view, a track begins. Ranges of two different targets meet
as well, in a ghost. Ghosts are resolved by the tracks, which take their ranges first, and by the range rates: the two
must be those of something that stands, or moves as traffic does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import hypot
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.arrays.rows import checked_state
from candaemon.config.directions import AlongAcross
from candaemon.ego.pose import EgoPose
from candaemon.estimation.kalman import LOG_2PI
from candaemon.estimation.measurement import Measurement, line_of_sight
from candaemon.estimation.trilateration import Status, trilaterate
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import SensorView
from candaemon.tracking.association import assign

MOST_RANGES: Final = 256
"""Ranges of a scan, the nearest first, that are paired with those of another sensor."""
_UNKNOWN = 1e3  # m, standard deviation across the line of sight of what only a range tells
_ACCELERATION = 20.0  # m/s², standard deviation of a range's between two sensors' scans
_UNMEASURED = 1e3  # m/s², that of the range acceleration, which no sensor tells
_DEVIATIONS = 3.0  # by which something may be outside of where it should be
_SCANS_APART = 1.5  # cycles; older ranges are not paired
_OUT_OF_GATE = 1e9


def _floats() -> Floats:
    return np.zeros(0)


@dataclass(slots=True)
class UnpairedRanges:
    """What a sensor's latest scan measured of no track, m ranges.

    Attributes:
        time_ns: of the scan.
        distance: m (m,).
        variance: of the distance, m² (m,).
        rate: of the range, m/s (m,).
        rate_variance: (m/s)² (m,).
    """

    time_ns: int = 0
    distance: Floats = field(default_factory=_floats)
    variance: Floats = field(default_factory=_floats)
    rate: Floats = field(default_factory=_floats)
    rate_variance: Floats = field(default_factory=_floats)

    def __len__(self) -> int:
        return len(self.distance)

    def validate(self) -> None:
        """Raise a ValueError where the arrays do not fit together, or a range has no variance."""
        checked_state(self, UnpairedRanges())
        if not (self.variance > 0.0).all() or not (self.rate_variance > 0.0).all():
            raise ValueError("a range without a variance")

    def taken(self, rows: Indices) -> UnpairedRanges:
        """Return the given rows."""
        kept = (each[rows] for each in (self.distance, self.variance, self.rate, self.rate_variance))
        return UnpairedRanges(self.time_ns, *kept)

    def predicted(self, time_ns: int) -> UnpairedRanges:
        """Return the ranges expected at another instant."""
        dt = (time_ns - self.time_ns) * 1e-9
        wandering = self.rate_variance * dt**2 + (0.5 * _ACCELERATION * dt * dt) ** 2
        changed = self.rate_variance + (_ACCELERATION * dt) ** 2
        return UnpairedRanges(time_ns, self.distance + dt * self.rate, self.variance + wandering, self.rate, changed)


@dataclass(frozen=True, slots=True)
class PlacedRanges:
    """The ranges of a scan of which it is known where they are.

    Attributes:
        detections: those of tracks first, placed on the line of sight to where the track is expected, with a standard
            deviation across it that says that nothing is known; then those where two sensors' circles meet.
        tracks: rows of the tracks that the first of them are of.
    """

    detections: Detections
    tracks: Indices


class RangeAssociation:
    """Finds where the ranges of a group's sensors are.

    Args:
        views: what the sensors of the group can see.
        gate: largest normalised innovation squared of a range and its rate.
        first_speed: standard deviation over ground of an unknown target, along and across our own heading, m/s.
        cycle_time: the longest of the sensors, s.
    """

    def __init__(self, views: Sequence[SensorView], gate: float, first_speed: AlongAcross, cycle_time: float) -> None:
        self._views: dict[int, list[SensorView]] = {}
        for view in views:
            self._views.setdefault(view.sensor, []).append(view)
        self._gate = gate
        self._first_speed = first_speed
        self._latest_ns = round(_SCANS_APART * cycle_time * 1e9)

    def placed(
        self,
        detections: Detections,
        mean: Floats,
        covariance: Floats,
        confirmed: Booleans,
        pose: EgoPose,
        unpaired: dict[int, UnpairedRanges],
    ) -> PlacedRanges:
        """Return which ranges of a scan are of which tracks, and where others meet those of other sensors.

        Args:
            detections: of a scan; of their positions only the distance from the sensor counts.
            mean: states of n tracks at its instant (n, 6).
            covariance: (n, 6, 6).
            confirmed: whether a track is of a confirmed obstacle (n,); these have the first choice.
            pose: at its instant.
            unpaired: by the sensors' numbers, what their latest scans have left over; changed in place.
        """
        scan = _ranges(detections)
        fit = _Fit.of(scan, mean, covariance, detections.measurement)
        possible = (fit.nis <= self._gate) & self._in_view(detections, mean, covariance, pose)[:, None]
        tracks, rows = _best(np.where(possible & confirmed[:, None], fit.nis, np.inf))
        free = possible & ~confirmed[:, None]
        free[:, rows] = False
        more_tracks, more_rows = _best(np.where(free, fit.nis, np.inf))
        tracks, rows = np.concatenate([tracks, more_tracks]), np.concatenate([rows, more_rows])
        position, noise = fit.on_sight(tracks, scan.distance[rows], scan.variance[rows])

        left = np.setdiff1d(np.arange(len(scan)), rows)
        left = left[np.isfinite(scan.rate[left])]
        met, where, spread = self._met(scan.taken(left), detections, pose, unpaired)
        unpaired[detections.sensor] = scan.taken(np.delete(left, met))
        rows = np.concatenate([rows, left[met]])
        return PlacedRanges(
            _moved(detections, rows, np.concatenate([position, where]), np.concatenate([noise, spread]), pose), tracks
        )

    def check(self, unpaired: dict[int, UnpairedRanges]) -> None:
        """Refuse ranges of sensors that are not of the group.

        Raises:
            ValueError: there are some.
        """
        if not unpaired.keys() <= self._views.keys():
            raise ValueError("ranges of a sensor that the group does not have")

    def _in_view(self, detections: Detections, mean: Floats, covariance: Floats, pose: EgoPose) -> Booleans:
        """Return which tracks the sensor may see (n,), given how surely their place is known."""
        points = pose.to_vehicle(mean[:, :2])
        margin = _DEVIATIONS * np.sqrt(covariance[:, 0, 0] + covariance[:, 1, 1])
        return _seen(self._views[detections.sensor], points, margin)

    def _met(
        self, scan: UnpairedRanges, detections: Detections, pose: EgoPose, unpaired: dict[int, UnpairedRanges]
    ) -> tuple[Indices, Floats, Floats]:
        """Return which ranges meet those of other sensors, and where: rows, positions (m, 2) and covariances.

        What is paired is taken out of what the other sensors have left over. The longest baseline comes first.
        """
        others = self._others(detections.sensor, unpaired)
        rows, positions, noises = [np.empty(0, np.intp)], [np.zeros((0, 2))], [np.zeros((0, 2, 2))]
        free = np.arange(len(scan))[np.argsort(scan.distance, kind="stable")[:MOST_RANGES]]
        for other in others:
            there = unpaired[other]
            if not len(free) or not len(there) or abs(scan.time_ns - there.time_ns) > self._latest_ns:
                continue
            mine, theirs, state, noise = self._intersections(
                scan.taken(free), there.predicted(scan.time_ns), detections.sensor, other, pose
            )
            rows.append(free[mine])
            positions.append(state)
            noises.append(noise)
            free = np.delete(free, mine)
            unpaired[other] = there.taken(np.delete(np.arange(len(there)), theirs))
        return np.concatenate(rows), np.concatenate(positions), np.concatenate(noises)

    def _others(self, sensor: int, unpaired: dict[int, UnpairedRanges]) -> list[int]:
        """Return the other sensors that have left something over, the farthest from a sensor first."""
        here = self._views[sensor][0].mount

        def nearness(other: int) -> tuple[float, int]:
            there = self._views[other][0].mount
            return -hypot(there.x - here.x, there.y - here.y), other

        return sorted((each for each in unpaired if each != sensor), key=nearness)

    def _intersections(
        self, one: UnpairedRanges, other: UnpairedRanges, sensor: int, second: int, pose: EgoPose
    ) -> tuple[Indices, Indices, Floats, Floats]:
        """Pair the ranges of two sensors at one instant: rows of each, positions (m, 2) and covariances (m, 2, 2)."""
        views = self._views[sensor], self._views[second]
        mounts = [pose.place(each[0].mount.x, each[0].mount.y) for each in views]
        sensors = np.array([position for position, _ in mounts])
        looks = [pose.heading + view.yaw for each in views for view in each]
        side = np.array([np.cos(looks).sum(), np.sin(looks).sum()])
        nearest = np.argsort(other.distance, kind="stable")[:MOST_RANGES]
        width = _DEVIATIONS * np.sqrt(one.variance[:, None] + other.variance[nearest])
        apart = np.abs(one.distance[:, None] - other.distance[nearest])
        i, k = np.nonzero(apart <= np.hypot(*(sensors[1] - sensors[0])) + width)
        k = nearest[k]
        measured, variance = np.zeros((len(i), 2, 3)), np.full((len(i), 2, 3), _UNMEASURED**2)
        for column, (of, at) in enumerate(((one, i), (other, k))):
            measured[:, column, 0], variance[:, column, 0] = of.distance[at], of.variance[at]
            measured[:, column, 1], variance[:, column, 1] = of.rate[at], of.rate_variance[at]
        found = trilaterate(measured, variance[..., None] * np.eye(3), sensors, side)
        position, noise = found.state[:, :2], found.covariance[:, :2, :2]
        points, none = pose.to_vehicle(position), np.zeros(len(i))
        good = (found.status == Status.OK) | (found.status == Status.BEHIND)
        good &= _seen(views[0], points, none) & _seen(views[1], points, none)
        nis, log_likelihood = self._plausible(
            position, noise, measured[..., 1], variance[..., 1], sensors, np.array([v for _, v in mounts]), pose
        )
        good &= nis <= self._gate
        cost = np.full((len(one), len(other)), np.inf)
        cost[i[good], k[good]] = -log_likelihood[good]
        pair = np.full(cost.shape, -1)
        pair[i, k] = np.arange(len(i))
        mine, theirs = _best(cost)
        chosen = pair[mine, theirs]
        return mine, theirs, position[chosen], noise[chosen]

    def _plausible(
        self,
        position: Floats,
        noise: Floats,
        rate: Floats,
        variance: Floats,
        sensors: Floats,
        velocity: Floats,
        pose: EgoPose,
    ) -> tuple[Floats, Floats]:
        """Return how well two range rates are those of something at a place: NIS and log likelihood, (m,).

        It stands, or moves with a velocity over ground that is normally distributed: the likelier of the two counts.

        Args:
            position: (m, 2), local frame, m.
            noise: covariance of the positions (m, 2, 2).
            rate: range rates (m, 2), m/s.
            variance: of the rates (m, 2).
            sensors: positions (2, 2), m.
            velocity: of the sensors over ground (2, 2), m/s.
            pose: own pose.
        """
        offset = position[:, None] - sensors
        sight = offset / np.maximum(np.hypot(offset[..., 0], offset[..., 1]), 1e-3)[..., None]
        over_ground = rate + (sight * velocity).sum(axis=-1)
        # an uncertain place turns the lines of sight, and so how much of our own velocity is along them
        distance = np.maximum(np.hypot(offset[..., 0], offset[..., 1]), 1.0)[..., None]
        turn = (velocity - (sight * velocity).sum(axis=-1, keepdims=True) * sight) / distance
        standing = turn @ noise @ np.swapaxes(turn, 1, 2) + variance[..., None] * np.eye(2)
        axes = pose.rotation
        speeds = axes @ np.diag([self._first_speed.along**2, self._first_speed.across**2]) @ axes.T
        moving = standing + sight @ speeds @ np.swapaxes(sight, 1, 2)
        found = [_normal(over_ground, each) for each in (standing, moving)]
        better = found[1][1] > found[0][1]
        return np.where(better, found[1][0], found[0][0]), np.where(better, found[1][1], found[0][1])


@dataclass(frozen=True, slots=True)
class _Fit:
    """How m ranges fit n tracks.

    Attributes:
        nis: normalised innovation squared of range and range rate (n, m).
        origin: position of the sensor (2,), m.
        sight: unit vectors from the sensor to the tracks (n, 2).
        farther: by how much the tracks are farther off than their means, since circles bend, m (n,).
    """

    nis: Floats
    origin: Floats
    sight: Floats
    farther: Floats

    @classmethod
    def of(cls, scan: UnpairedRanges, mean: Floats, covariance: Floats, measurement: Measurement) -> _Fit:
        offset = mean[:, :2] - measurement.origin
        distance = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-3)
        sight = offset / distance[:, None]
        across = np.stack([-sight[:, 1], sight[:, 0]], axis=1)
        wide = np.einsum("ni,nij,nj->n", across, covariance[:, :2, :2], across)
        # the second order of the range: what is known badly across the line of sight lies on a bent line
        farther = 0.5 * wide / np.maximum(distance, 1.0)
        rate, row = line_of_sight(mean, measurement.origin, measurement.velocity)
        jacobian = np.zeros((len(mean), 2, 4))
        jacobian[:, 0, :2], jacobian[:, 1] = sight, row
        spread = jacobian @ covariance[:, :4, :4] @ np.swapaxes(jacobian, 1, 2)
        a = spread[:, 0, 0, None] + 2.0 * farther[:, None] ** 2 + scan.variance
        b, c = spread[:, 0, 1, None], spread[:, 1, 1, None] + scan.rate_variance
        off, faster = scan.distance - (distance + farther)[:, None], scan.rate - rate[:, None]
        both = (c * off * off - 2 * b * off * faster + a * faster * faster) / (a * c - b * b)
        return cls(np.where(np.isfinite(faster), both, off * off / a), measurement.origin, sight, farther)

    def on_sight(self, tracks: Indices, distance: Floats, variance: Floats) -> tuple[Floats, Floats]:
        """Return positions (k, 2) and covariances (k, 2, 2) of ranges on the lines of sight to their tracks."""
        sight = self.sight[tracks]
        along = sight[:, :, None] * sight[:, None, :]
        farther = self.farther[tracks]
        variance = (variance + 2.0 * farther**2)[:, None, None]
        place = self.origin + (distance - farther)[:, None] * sight
        return place, variance * along + _UNKNOWN**2 * (np.eye(2) - along)


def _ranges(detections: Detections) -> UnpairedRanges:
    """Return the ranges of a scan."""
    measurement = detections.measurement
    offset = measurement.position - measurement.origin
    distance = np.hypot(offset[:, 0], offset[:, 1])
    sight = offset / np.maximum(distance, 1e-9)[:, None]
    variance = np.einsum("ni,nij,nj->n", sight, measurement.noise, sight)
    rate, rate_variance = measurement.range_rate, measurement.range_rate_variance
    if rate is None or rate_variance is None:
        rate, rate_variance = np.full(len(distance), np.nan), np.ones(len(distance))
    return UnpairedRanges(detections.time_ns, distance, variance, rate, rate_variance)


def _seen(views: Sequence[SensorView], points: Floats, margin: Floats) -> Booleans:
    """Return which points in vehicle axes (n, 2) lie in a field of view, or outside by a margin (n,) at most."""
    seen = np.zeros(len(points), dtype=np.bool_)
    for view in views:
        x, y = points[:, 0] - view.mount.x, points[:, 1] - view.mount.y
        distance = np.hypot(x, y)
        off = np.abs(np.remainder(np.arctan2(y, x) - view.yaw + np.pi, 2 * np.pi) - np.pi)
        wide = np.radians(view.field.azimuth_deg) + margin / np.maximum(distance, 1.0)
        seen |= (off <= wide) & (distance <= view.field.range + margin) & (distance >= view.field.min_range - margin)
    return seen


def _best(cost: Floats) -> tuple[Indices, Indices]:
    """Return the rows and columns of a cost matrix that are paired at the least sum; what is infinite never is."""
    rows, columns = np.flatnonzero(np.isfinite(cost).any(axis=1)), np.flatnonzero(np.isfinite(cost).any(axis=0))
    part = np.minimum(cost[np.ix_(rows, columns)], _OUT_OF_GATE)
    chosen, of = assign(part)
    real = part[chosen, of] < _OUT_OF_GATE
    return rows[chosen[real]], columns[of[real]]


def _normal(error: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return NIS and log likelihood (m,) of errors (m, 2) with covariances (m, 2, 2)."""
    a, b, d = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    determinant = a * d - b * b
    x, y = error[:, 0], error[:, 1]
    nis = (d * x * x - 2 * b * x * y + a * y * y) / determinant
    return nis, -0.5 * (nis + np.log(determinant)) - LOG_2PI


def _moved(detections: Detections, rows: Indices, position: Floats, noise: Floats, pose: EgoPose) -> Detections:
    """Return the detections of the given rows at other positions; their ids say nothing of another sensor's."""
    places = pose.to_vehicle(position)
    return replace(
        detections,
        object_id=detections.object_id[rows],
        new=detections.new[rows],
        measurement=replace(detections.measurement.take(rows), position=position, noise=noise),
        x=places[:, 0],
        y=places[:, 1],
        length=None if detections.length is None else detections.length[rows],
        width=None if detections.width is None else detections.width[rows],
        heading=None if detections.heading is None else detections.heading[rows],
        identified=False,
    )
