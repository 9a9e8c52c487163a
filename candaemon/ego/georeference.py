"""The level frame's place on earth, from the fixes of the INS.

The level frame is continuous and has an origin of its own. A fix moves nothing in it; a fix tells which latitude and
longitude one of its points has, and a filter smooths what the fixes tell.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, pi, sin, tau
from typing import Final, NamedTuple

import numpy as np

from candaemon.arrays import Floats
from candaemon.config.ego import InsSettings
from candaemon.config.gnss import GnssSettings
from candaemon.ego.fix_filters import make_filter
from candaemon.ego.geodesy import TangentPlane
from candaemon.ego.ins_epoch import InsEpoch
from candaemon.ego.motion import MotionHistory
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.frames.times import LONG_AGO_NS

MOST_WAITING: Final = 256
"""Fixes that may wait for own motion."""


@dataclass(frozen=True, slots=True)
class Georeference:
    """Where the level frame lies on earth: latitude and longitude of one of its points; its axes are east and north.

    Attributes:
        time_ns: of the fix it rests on.
        east, north: the point in the level frame, m.
        plane: touches the earth at the point.
        deviation: one standard deviation, east and north each, m.
    """

    time_ns: int
    east: float
    north: float
    plane: TangentPlane
    deviation: float

    def to_earth(self, east: Floats, north: Floats) -> tuple[Floats, Floats]:
        """Return latitude and longitude (n,), rad, of points in the level frame (n,), m."""
        return self.plane.to_earth(east - self.east, north - self.north)

    def to_level(self, latitude: Floats, longitude: Floats) -> tuple[Floats, Floats]:
        """Return east and north in the level frame (n,), m, of places on earth (n,), rad."""
        east, north = self.plane.project(latitude, longitude)
        return east + self.east, north + self.north


@dataclass(slots=True)
class FixCounts:
    """What became of the fixes.

    Attributes:
        fixes: complete, latitude and longitude.
        invalid: told while the INS's solution was not valid, or no place on earth; not used.
        unplaced: of an instant at which own motion is not known, or not newer than the one before; not used.
        rejected: too far from where the vehicle was expected; not used.
        restarts: as far off, but believed, because there had been no other for long.
        innovations: sum over the used ones of the squared distance from where they were expected, m².
        compared: fixes in that sum; the first one is not.
    """

    fixes: int = 0
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


class _Fix(NamedTuple):
    """Where the INS said it was, rad."""

    time_ns: int
    latitude: float
    longitude: float


class Georeferencer:
    """Places the level frame on earth.

    A fix waits until own motion is known at its instant. It is compared with what its filter expects, refused where it
    lies too far off, and otherwise moves the placement.

    The filter's east and north run on from fix to fix, each seen in the plane that touches the earth at the place
    before; so its state means the same however far the vehicle goes, and never begins anew for it.

    Args:
        settings: of the INS: lever arm, latency.
        gnss: how its fixes are used.
        history: own motion in the level frame.

    Attributes:
        wanted: the quantities it makes use of.
        counts: what became of the fixes.
    """

    wanted = frozenset({"latitude", "longitude", "valid"})

    def __init__(self, settings: InsSettings, gnss: GnssSettings, history: MotionHistory) -> None:
        self._gnss, self._arm, self._history = gnss, settings.lever_arm, history
        self._latency_ns = round(settings.latency * 1e9)
        self._hold_ns, self._reacquire_ns = round(gnss.hold * 1e9), round(gnss.reacquire * 1e9)
        self._burst = InsEpoch(("latitude", "longitude"), "latitude", settings.age_limit)
        self._waiting: deque[_Fix] = deque()
        self._filter = make_filter(gnss.filter, gnss.noise)
        self._noise: Floats = gnss.noise**2 * np.eye(2)
        self._placement: Georeference | None = None
        self._placed: Floats = np.zeros(2)  # where the filter was then
        self._predicted_ns = LONG_AGO_NS
        self._unseen = 0.0
        self._rejected_since_ns: int | None = None
        self.counts = FixCounts()

    def update(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> None:
        """Take the quantities of one frame, SI units, angles in radians."""
        self._use_known()
        value = self._burst.value
        if self._burst.take(time_ns, names, values):
            self.counts.fixes += 1
            self._waiting.append(_Fix(self._burst.time_ns - self._latency_ns, value["latitude"], value["longitude"]))
        if value.get("valid", 1.0) == 0.0:
            self.counts.invalid += len(self._waiting)
            self._waiting.clear()
        elif len(self._waiting) > MOST_WAITING:
            self.counts.unplaced += 1
            self._waiting.popleft()

    def at(self, time_ns: int) -> Georeference | None:
        """Return the placement for an instant; None before the first fix, and where the last used one is too old."""
        self._use_known()
        placement = self._placement
        return placement if placement is not None and time_ns - placement.time_ns <= self._hold_ns else None

    @property
    def deviation(self) -> float:
        """One standard deviation of the latest placement, east and north each, m; NaN before the first fix."""
        return float("nan") if self._placement is None else self._placement.deviation

    def _use_known(self) -> None:
        """Use the fixes at whose instants own motion is known."""
        latest = self._history.latest
        while latest is not None and self._waiting and self._waiting[0].time_ns <= latest.time_ns:
            fix = self._waiting.popleft()
            pose = self._history.pose(fix.time_ns)
            if not (abs(fix.latitude) <= pi / 2 and abs(fix.longitude) <= tau):
                self.counts.invalid += 1
            elif pose is None or pose.status is not EgoStatus.VALID or fix.time_ns <= self._predicted_ns:
                self.counts.unplaced += 1
            elif self._placement is None:
                self._begin(fix, pose)
            else:
                self._use(fix, pose, self._placement)

    def _use(self, fix: _Fix, pose: EgoPose, placement: Georeference) -> None:
        """Predict, gate, update."""
        plane, moved = placement.plane, np.array([pose.east - placement.east, pose.north - placement.north])
        measured = self._placed + np.array(plane.project(fix.latitude, fix.longitude)) - self._offset(pose)
        unseen, self._unseen = self._history.unseen - self._unseen, self._history.unseen
        self._filter.predict((fix.time_ns - self._predicted_ns) * 1e-9, self._placed + moved, unseen)
        self._predicted_ns = fix.time_ns
        innovation = measured - self._filter.position
        nis = innovation @ np.linalg.solve(self._filter.covariance + self._noise, innovation)
        if not nis <= self._gnss.gate:
            self._reject(fix, pose)
            return
        self._rejected_since_ns = None
        self.counts.compared += 1
        self.counts.innovations += float(innovation @ innovation)
        self._filter.update(measured)
        self._place(fix.time_ns, pose, plane, self._filter.position - self._placed)

    def _reject(self, fix: _Fix, pose: EgoPose) -> None:
        """Refuse a fix that lies too far off; believe it where there has been no other for long enough."""
        if self._rejected_since_ns is None:
            self._rejected_since_ns = fix.time_ns
        if fix.time_ns - self._rejected_since_ns < self._reacquire_ns:
            self.counts.rejected += 1
            return
        self.counts.restarts += 1
        self._begin(fix, pose)

    def _begin(self, fix: _Fix, pose: EgoPose) -> None:
        """Believe a fix."""
        self._filter.start(np.zeros(2), self._noise, np.array([pose.ve, pose.vn]), pose.speed_variance)
        self._predicted_ns, self._unseen = fix.time_ns, self._history.unseen
        self._rejected_since_ns = None
        self._place(fix.time_ns, pose, TangentPlane(fix.latitude, fix.longitude), -self._offset(pose))

    def _place(self, time_ns: int, pose: EgoPose, plane: TangentPlane, position: Floats) -> None:
        """Let own place in the level frame be a point of a plane, which is where the filter says."""
        latitude, longitude = plane.to_earth(position[:1], position[1:])
        deviation = float(np.sqrt(np.trace(self._filter.covariance) / 2))
        touching = TangentPlane(float(latitude[0]), float(longitude[0]))
        self._placement = Georeference(time_ns, pose.east, pose.north, touching, deviation)
        self._placed = self._filter.position

    def _offset(self, pose: EgoPose) -> Floats:
        """Return where the INS is, seen from the rear axle's centre, level axes, m."""
        c, s = cos(pose.heading), sin(pose.heading)
        return np.array([c * self._arm.x - s * self._arm.y, s * self._arm.x + c * self._arm.y])
