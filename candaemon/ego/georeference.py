"""The local frame's place on earth, from the fixes of the INS.

The local frame is continuous and has an origin of its own. A fix moves nothing in it; a fix says which latitude and
longitude one of its points has, and a filter smooths what the fixes say.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import cos, pi, sin, tau
from typing import Final, NamedTuple

import numpy as np

from candaemon.arrays import Floats
from candaemon.config.ego import InsSettings
from candaemon.config.gnss import GnssSettings
from candaemon.ego.fix_filters import FixFilterState, make_filter
from candaemon.ego.geodesy import TangentPlane
from candaemon.ego.ins_epoch import InsEpoch, InsEpochState
from candaemon.ego.motion import MotionHistory
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.frames.times import LONG_AGO_NS

MOST_WAITING: Final = 256
"""Fixes that may wait for ego motion."""


@dataclass(frozen=True, slots=True)
class Georeference:
    """Where the local frame lies on earth: latitude and longitude of one of its points; its axes are east and north.

    Attributes:
        time_ns: of the fix it rests on.
        east, north: the point in the local frame, m.
        latitude, longitude: the point on earth, rad.
        deviation: one standard deviation, east and north each, m.
    """

    time_ns: int
    east: float
    north: float
    latitude: float
    longitude: float
    deviation: float

    @property
    def plane(self) -> TangentPlane:
        """What touches the earth at the point."""
        return TangentPlane(self.latitude, self.longitude)

    def to_earth(self, east: Floats, north: Floats) -> tuple[Floats, Floats]:
        """Return latitude and longitude (n,), rad, of points in the local frame (n,), m."""
        return self.plane.to_earth(east - self.east, north - self.north)


@dataclass(slots=True)
class FixCounts:
    """What became of the fixes.

    Attributes:
        fixes: complete, latitude and longitude.
        incomplete: latitudes whose longitude did not come, or later than half of a period.
        invalid: sent while the INS's solution was not valid, or no place on earth; not used.
        unplaced: of an instant at which ego motion is not known, or not newer than the one before; not used.
        rejected: too far from where the vehicle was expected; not used.
        restarts: as far off, but accepted, because there had been no other for long.
        innovations: sum over the used ones of the squared distance from where they were expected, m².
        compared: fixes in that sum; the first one is not.
    """

    fixes: int = 0
    incomplete: int = 0
    invalid: int = 0
    unplaced: int = 0
    rejected: int = 0
    restarts: int = 0
    innovations: float = 0.0
    compared: int = 0

    @property
    def innovation_rms(self) -> float:
        """RMS distance of the used fixes from where they were expected, m; NaN without any."""
        return (self.innovations / self.compared) ** 0.5 if self.compared else float("nan")


class Fix(NamedTuple):
    """Where the INS reported to be, rad."""

    time_ns: int
    latitude: float
    longitude: float


@dataclass(slots=True)
class GeoreferencerState:
    """What a georeferencer remembers.

    Attributes:
        epoch: latitude and longitude of the current burst.
        filter: of the fixes.
        waiting: fixes at whose instants ego motion is not known yet, the oldest first.
        georeference: the latest; None before the first fix.
        position: of the filter then (2,), m.
        predicted_ns: the instant that the filter's estimate holds for.
        unseen: s for which the local frame had been extrapolated without samples then.
        rejected_since_ns: time of the first of the fixes rejected one after another; None where the latest was used.
        counts: what became of the fixes.
    """

    epoch: InsEpochState
    filter: FixFilterState
    waiting: deque[Fix] = field(default_factory=deque)
    georeference: Georeference | None = None
    position: Floats = field(default_factory=lambda: np.zeros(2))
    predicted_ns: int = LONG_AGO_NS
    unseen: float = 0.0
    rejected_since_ns: int | None = None
    counts: FixCounts = field(default_factory=FixCounts)


class Georeferencer:
    """Places the local frame on earth.

    A fix waits until ego motion is known at its instant. It is compared with what its filter expects, refused where it
    lies too far off, and otherwise moves the georeference.

    The filter's east and north run on from fix to fix, each seen in the plane that touches the earth at the place
    before; so its state means the same however far the vehicle goes, and never begins anew for it.

    Args:
        settings: of the INS: lever arm, latency.
        gnss: how its fixes are used.
        history: ego motion in the local frame.

    Attributes:
        wanted: the quantities it makes use of.
    """

    wanted = frozenset({"latitude", "longitude", "valid"})

    def __init__(self, settings: InsSettings, gnss: GnssSettings, history: MotionHistory) -> None:
        self._gnss, self._arm, self._history = gnss, settings.lever_arm, history
        self._latency_ns = round(settings.latency * 1e9)
        self._hold_ns, self._reacquire_ns = round(gnss.hold * 1e9), round(gnss.reacquire * 1e9)
        self._epoch = InsEpoch(("latitude", "longitude"), "latitude", settings.age_limit)
        self._filter = make_filter(gnss.filter, gnss.noise)
        self._noise: Floats = gnss.noise**2 * np.eye(2)
        self._state = GeoreferencerState(self._epoch.state, self._filter.state)

    @property
    def state(self) -> GeoreferencerState:
        """What it remembers; the filter's estimate is taken from the filter.

        Raises:
            ValueError: a state that is set does not fit the configuration.
        """
        self._state.filter = self._filter.state
        return self._state

    @state.setter
    def state(self, state: GeoreferencerState) -> None:
        if len(state.waiting) > MOST_WAITING + 1:
            raise ValueError(f"{len(state.waiting)} fixes wait, expected {MOST_WAITING} at most")
        self._state, self._epoch.state, self._filter.state = state, state.epoch, state.filter
        if state.georeference is not None and not self._filter.started:
            raise ValueError("a georeference without an estimate")

    @property
    def counts(self) -> FixCounts:
        """What became of the fixes."""
        return self._state.counts

    def update(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> None:
        """Take the quantities of one frame, SI units, angles in radians."""
        self._use_known()
        state, epoch = self._state, self._state.epoch
        is_whole = self._epoch.take(time_ns, names, values)
        state.counts.incomplete = epoch.incomplete
        if is_whole:
            state.counts.fixes += 1
            fix_ns = epoch.time_ns - self._latency_ns
            state.waiting.append(Fix(fix_ns, epoch.value["latitude"], epoch.value["longitude"]))
        if epoch.value.get("valid", 1.0) == 0.0:
            state.counts.invalid += len(state.waiting)
            state.waiting.clear()
        elif len(state.waiting) > MOST_WAITING:
            state.counts.unplaced += 1
            state.waiting.popleft()

    def at(self, time_ns: int) -> Georeference | None:
        """Return the georeference for an instant; None before the first fix, and where the last used one is too old."""
        self._use_known()
        latest = self._state.georeference
        return latest if latest is not None and time_ns - latest.time_ns <= self._hold_ns else None

    @property
    def deviation(self) -> float:
        """One standard deviation of the latest georeference, east and north each, m; NaN before the first fix."""
        latest = self._state.georeference
        return float("nan") if latest is None else latest.deviation

    def _use_known(self) -> None:
        """Use the fixes at whose instants ego motion is known."""
        state, latest = self._state, self._history.latest
        while latest is not None and state.waiting and state.waiting[0].time_ns <= latest.time_ns:
            fix = state.waiting.popleft()
            pose = self._history.pose(fix.time_ns)
            if not (abs(fix.latitude) <= pi / 2 and abs(fix.longitude) <= tau):
                state.counts.invalid += 1
            elif pose is None or pose.status is not EgoStatus.VALID or fix.time_ns <= state.predicted_ns:
                state.counts.unplaced += 1
            elif state.georeference is None:
                self._begin(fix, pose)
            else:
                self._use(fix, pose, state.georeference)

    def _use(self, fix: Fix, pose: EgoPose, before: Georeference) -> None:
        """Predict, gate, update."""
        state, plane = self._state, before.plane
        moved = np.array([pose.east - before.east, pose.north - before.north])
        measured = state.position + np.array(plane.project(fix.latitude, fix.longitude)) - self._offset(pose)
        unseen, state.unseen = self._history.unseen - state.unseen, self._history.unseen
        self._filter.predict((fix.time_ns - state.predicted_ns) * 1e-9, state.position + moved, unseen)
        state.predicted_ns = fix.time_ns
        innovation = measured - self._filter.position
        nis = innovation @ np.linalg.solve(self._filter.covariance + self._noise, innovation)
        if not nis <= self._gnss.gate:
            self._reject(fix, pose)
            return
        state.rejected_since_ns = None
        state.counts.compared += 1
        state.counts.innovations += float(innovation @ innovation)
        self._filter.update(measured)
        self._place(fix.time_ns, pose, plane, self._filter.position - state.position)

    def _reject(self, fix: Fix, pose: EgoPose) -> None:
        """Refuse a fix that lies too far off; accept it where there has been no other for long enough."""
        state = self._state
        if state.rejected_since_ns is None:
            state.rejected_since_ns = fix.time_ns
        if fix.time_ns - state.rejected_since_ns < self._reacquire_ns:
            state.counts.rejected += 1
            return
        state.counts.restarts += 1
        self._begin(fix, pose)

    def _begin(self, fix: Fix, pose: EgoPose) -> None:
        """Begin with a fix as it is."""
        state = self._state
        self._filter.start(np.zeros(2), self._noise, np.array([pose.ve, pose.vn]), pose.speed_variance)
        state.predicted_ns, state.unseen = fix.time_ns, self._history.unseen
        state.rejected_since_ns = None
        self._place(fix.time_ns, pose, TangentPlane(fix.latitude, fix.longitude), -self._offset(pose))

    def _place(self, time_ns: int, pose: EgoPose, plane: TangentPlane, position: Floats) -> None:
        """Let the ego position in the local frame be a point of a plane, which is where the filter says."""
        latitude, longitude = plane.to_earth(position[:1], position[1:])
        deviation = float(np.sqrt(np.trace(self._filter.covariance) / 2))
        state = self._state
        state.georeference = Georeference(
            time_ns, pose.east, pose.north, float(latitude[0]), float(longitude[0]), deviation
        )
        state.position = self._filter.position

    def _offset(self, pose: EgoPose) -> Floats:
        """Return where the INS is, seen from the rear axle's centre, axes east and north, m."""
        c, s = cos(pose.heading), sin(pose.heading)
        return np.array([c * self._arm.x - s * self._arm.y, s * self._arm.x + c * self._arm.y])
