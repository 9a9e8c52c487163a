"""Ego motion: a history of samples, and the pose at any instant between and shortly after them.

The local frame is continuous: positions are integrated from velocity over ground and heading, so that a GNSS fix
that jumps moves nothing. Its origin is where the first sample was taken, its axes are east and north where the source
knows them; with odometry alone, x is the vehicle's first heading.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import cos, hypot, inf, sin, sqrt
from typing import Any, NamedTuple, Protocol

import numpy as np

from candaemon import compiled
from candaemon.arrays import ComplexPlane, Floats
from candaemon.config.ego import BiasSettings
from candaemon.ego.pose import EgoPose, EgoStatus

_KEPT = 1024


@dataclass(frozen=True, slots=True)
class StationaryReturns:
    """Detections of one scan that lie still, or nearly, for a source of ego motion to learn from.

    Attributes:
        time_ns: measurement time.
        own_speed: what ego motion told for that time, m/s.
        speeds: for each, the ego speed along the line of sight that it implies, m/s, and the cosine of the angle
            between line of sight and travel; none of a sensor that adds the ego speed to its range rates itself.
        drifts: for each that was watched for long enough, how far it seems to have moved to the left over ground, m,
            and its distance ahead integrated over that time, m·s: their ratio is the error of the yaw rate.
    """

    time_ns: int
    own_speed: float
    speeds: tuple[tuple[float, float], ...]
    drifts: tuple[tuple[float, float], ...]


@dataclass(slots=True)
class SampleCounts:
    """Samples of ego motion, and in how many of them a quantity did not come and was derived.

    Attributes:
        samples: all of them.
        yaw_rate_from_curvature: from the path's curvature and the speed.
        yaw_rate_from_heading: from successive headings.
        yaw_rate_from_wheels: from the difference of the wheels' speeds.
        yaw_rate_at_rest: taken for 0, because the vehicle stands.
        heading_from_yaw_rate: turned on by the yaw rate, of a source that measures headings.
        heading_from_course: from the direction of the velocity.
        heading_kept: as it was last.
        acceleration_given: not derived: as it came.
        direction_assumed: taken for ahead, because the signal that tells reverse was silent.
    """

    samples: int = 0
    yaw_rate_from_curvature: int = 0
    yaw_rate_from_heading: int = 0
    yaw_rate_from_wheels: int = 0
    yaw_rate_at_rest: int = 0
    heading_from_yaw_rate: int = 0
    heading_from_course: int = 0
    heading_kept: int = 0
    acceleration_given: int = 0
    direction_assumed: int = 0


class EgoMotion(Protocol):
    """A source of ego motion.

    Attributes:
        state: what it remembers: each source has a dataclass of its own; None for one that remembers nothing.
        teaching: how stationary returns may correct it; None where they may not.
        wanted: the quantities it makes use of.
    """

    state: Any
    teaching: BiasSettings | None
    wanted: frozenset[str]

    @property
    def counts(self) -> SampleCounts:
        """Samples, and what was derived in them."""
        ...

    @property
    def known_until_ns(self) -> int:
        """Time of the latest sample; poses after it are extrapolated."""
        ...

    @property
    def corrections(self) -> tuple[float, float]:
        """Factor on the speed as read, and what is taken from the yaw rate as read, rad/s."""
        ...

    def update(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> None:
        """Take the quantities of one frame, SI units."""
        ...

    def pose(self, time_ns: int) -> EgoPose | None:
        """Return the ego pose at an instant; None before anything is known."""
        ...

    def course(self, begin_ns: int, step_ns: int, count: int) -> tuple[ComplexPlane, Floats] | None:
        """Return places, east + i north, m, and unwrapped headings, rad, at even steps (count,), if all are known."""
        ...

    def learn(self, returns: StationaryReturns) -> None:
        """Correct what the source reads wrongly by what stands still."""
        ...

    def correct(self, scale: float, yaw_rate: float, scale_sd: float, yaw_rate_sd: float) -> None:
        """Set the corrections to what a calibration found, and how well that is known."""
        ...


class Sample(NamedTuple):
    """Ego motion at one instant: as `EgoPose`, with the accelerations east and north, m/s².

    `seen_ns` is the time of the velocity: before `time_ns` where only the heading has come since.
    """

    time_ns: int
    east: float
    north: float
    heading: float
    ve: float
    vn: float
    yaw_rate: float
    ae: float
    an: float
    seen_ns: int


@dataclass(slots=True)
class MotionHistoryState:
    """Samples of ego motion.

    Attributes:
        samples: in order of time, the newest last, no two of one instant.
        unseen: s, all gaps between samples together over which positions were extrapolated.
    """

    samples: list[Sample] = field(default_factory=list)
    unseen: float = 0.0

    def validate(self) -> None:
        """Refuse samples that no history comes to.

        Raises:
            ValueError: they are not in order of time, or too many.
        """
        if len(self.samples) > 2 * _KEPT:
            raise ValueError(f"{len(self.samples)} samples, expected {2 * _KEPT} at most")
        if any(behind.time_ns <= before.time_ns for before, behind in pairwise(self.samples)):
            raise ValueError("samples that are not in order of time")
        if any(sample.seen_ns > sample.time_ns for sample in self.samples):
            raise ValueError("samples whose velocity is of later")


class MotionHistory:
    """Samples of ego motion in order of time, bounded, and the pose between and after them.

    Args:
        age_limit: s after the last sample from which ego motion counts as dead reckoning.
        dead_reckoning: s after the last sample from which it counts as lost.
        unseen_acceleration: m/s², by which the velocity may have changed since the last sample.
        speed_variance: of a fresh sample, (m/s)².
        smoothing: s, time constant of the acceleration.
        heading_variance: of a sample's heading, rad².

    Attributes:
        state: the samples.
    """

    def __init__(
        self,
        *,
        age_limit: float,
        dead_reckoning: float,
        unseen_acceleration: float,
        speed_variance: float,
        smoothing: float,
        heading_variance: float = 0.0,
    ) -> None:
        self._age_limit = age_limit
        self._dead_reckoning = dead_reckoning
        self._unseen_acceleration = unseen_acceleration
        self._speed_variance, self._heading_variance = speed_variance, heading_variance
        self._standing = 2 * sqrt(speed_variance)
        self._smoothing = smoothing
        self.state = MotionHistoryState()

    @property
    def latest_ns(self) -> int:
        """Time of the newest sample, 0 before the first."""
        samples = self.state.samples
        return samples[-1].time_ns if samples else 0

    @property
    def latest(self) -> Sample | None:
        """The newest sample."""
        samples = self.state.samples
        return samples[-1] if samples else None

    @property
    def unseen(self) -> float:
        """All gaps between samples together over which positions were extrapolated, s."""
        return self.state.unseen

    def add(
        self,
        time_ns: int,
        heading: float,
        ve: float,
        vn: float,
        yaw_rate: float,
        acceleration: tuple[float, float] | None = None,
    ) -> None:
        """Add a sample; one that is not newer than the newest is ignored.

        Args:
            time_ns: when.
            heading: continuous, not wrapped, rad from the frame's x axis, positive to the left.
            ve: velocity over ground of the rear axle's centre, east, m/s.
            vn: the same, north.
            yaw_rate: rad/s, positive to the left.
            acceleration: east and north, m/s²; None: derived from the velocities.
        """
        last = self.latest
        if last is None:
            ae, an = acceleration or (0.0, 0.0)
            self._keep(Sample(time_ns, 0.0, 0.0, heading, ve, vn, yaw_rate, ae, an, time_ns))
            return
        dt = (time_ns - last.time_ns) * 1e-9
        if dt <= 0.0:
            return
        unseen = (time_ns - last.seen_ns) * 1e-9
        if unseen > self._age_limit:
            self.state.unseen += unseen
            pose = self._extrapolated(last, time_ns)
            east, north, ae, an = pose.east, pose.north, 0.0, 0.0
        else:
            share = dt / (dt + self._smoothing)
            east = last.east + dt * (last.ve + ve) / 2
            north = last.north + dt * (last.vn + vn) / 2
            ae = last.ae + share * ((ve - last.ve) / dt - last.ae)
            an = last.an + share * ((vn - last.vn) / dt - last.an)
        if acceleration is not None:
            ae, an = acceleration
        self._keep(Sample(time_ns, east, north, heading, ve, vn, yaw_rate, ae, an, time_ns))

    def coast(self, time_ns: int, heading: float, yaw_rate: float) -> None:
        """Go on at the last speed along a heading that is known while the velocity is silent, until that is lost.

        Args:
            time_ns: when; nothing happens until the velocity is older than the age limit.
            heading: as in `add`.
            yaw_rate: rad/s, positive to the left.
        """
        last = self.latest
        if last is None or time_ns <= last.time_ns:
            return
        if not self._age_limit < (time_ns - last.seen_ns) * 1e-9 < self._dead_reckoning:
            return
        pose, dt = self._extrapolated(last, time_ns), (time_ns - last.time_ns) * 1e-9
        speed, before = hypot(pose.ve, pose.vn), hypot(last.ve, last.vn)
        share = speed / before if before > self._standing else 0.0
        c, s = cos(heading - last.heading), sin(heading - last.heading)
        ve, vn = share * (c * last.ve - s * last.vn), share * (s * last.ve + c * last.vn)
        east, north = last.east + dt * (last.ve + ve) / 2, last.north + dt * (last.vn + vn) / 2
        self._keep(Sample(time_ns, east, north, heading, ve, vn, yaw_rate, 0.0, 0.0, last.seen_ns))

    def _keep(self, sample: Sample) -> None:
        self.extend((sample,))

    def extend(self, made: Iterable[Sample]) -> None:
        """Take samples that are newer than the newest, each made of the one before as `add` does."""
        samples = self.state.samples
        samples.extend(made)
        while len(samples) > 2 * _KEPT:
            del samples[:_KEPT]

    def pose(self, time_ns: int) -> EgoPose | None:
        """Return the pose at an instant, interpolated between samples or extrapolated from the nearest one."""
        samples = self.state.samples
        if not samples:
            return None
        after = bisect_right(samples, (time_ns, inf))  # the first one that is younger
        if 0 < after < len(samples):
            before, behind = samples[after - 1], samples[after]
            if behind.time_ns - before.time_ns <= self._age_limit * 1e9 or behind.seen_ns < behind.time_ns:
                return self._interpolated(before, behind, time_ns)
        return self._extrapolated(samples[max(after - 1, 0)], time_ns)

    def course(self, begin_ns: int, step_ns: int, count: int) -> tuple[ComplexPlane, Floats] | None:
        """Return places, east + i north, m, and headings, not wrapped, rad, at even steps (count,).

        None where one of them would be dead reckoning, or less.
        """
        samples, limit_ns = self.state.samples, self._age_limit * 1e9
        if not samples:
            return None
        after, newest = bisect_right(samples, (begin_ns, inf)), len(samples) - 1
        if compiled.in_use:
            known = compiled.kernels.course(samples, after, begin_ns, step_ns, count, limit_ns)
            if known is not None:
                return known
        places, headings = [], []
        for time_ns in range(begin_ns, begin_ns + count * step_ns, step_ns):
            while after < newest and samples[after].time_ns <= time_ns:
                after += 1
            a, b = samples[after - 1], samples[min(after, newest)]
            if a.seen_ns == a.time_ns <= time_ns < b.time_ns == b.seen_ns and b.time_ns - a.time_ns <= limit_ns:
                share, east, north, _, _ = _between(a, b, time_ns)
                heading = a.heading + share * (b.heading - a.heading)
            else:
                pose = self.pose(time_ns)
                if pose is None or pose.status is not EgoStatus.VALID:
                    return None
                east, north, heading = pose.east, pose.north, pose.heading
            places.append(complex(east, north))
            headings.append(heading)
        return np.array(places), np.array(headings)

    def _interpolated(self, a: Sample, b: Sample, time_ns: int) -> EgoPose:
        share, east, north, ve, vn = _between(a, b, time_ns)
        variance, status = self._speed_variance, EgoStatus.VALID
        if a.seen_ns < a.time_ns or b.seen_ns < b.time_ns:
            variance, status = self._reliability((time_ns - a.seen_ns) * 1e-9)
        return EgoPose(
            time_ns,
            east,
            north,
            a.heading + share * (b.heading - a.heading),
            ve,
            vn,
            a.yaw_rate + share * (b.yaw_rate - a.yaw_rate),
            variance,
            status,
            self._heading_variance,
        )

    def _extrapolated(self, last: Sample, time_ns: int) -> EgoPose:
        """Go on from a sample: with its acceleration and yaw rate while it is fresh, straight on afterwards.

        Who stood, or came to stand while the sample was fresh, stands.
        """
        age = (time_ns - last.time_ns) * 1e-9
        fresh = max(min(age, self._age_limit), -self._age_limit)
        turn = last.yaw_rate * fresh
        c, s = cos(turn), sin(turn)
        ve, vn = c * last.ve - s * last.vn, s * last.ve + c * last.vn
        speed = hypot(ve, vn)
        along = max(self._along(last) * fresh, -speed)  # who brakes unseen stops, and does not reverse
        if speed > 1e-3:
            ve, vn = ve + along * ve / speed, vn + along * vn / speed
        east = last.east + fresh * (last.ve + ve) / 2
        north = last.north + fresh * (last.vn + vn) / 2
        if age != fresh and speed + along > self._standing:
            east, north = east + (age - fresh) * ve, north + (age - fresh) * vn
        variance, status = self._reliability((time_ns - last.seen_ns) * 1e-9)
        return EgoPose(
            time_ns,
            east,
            north,
            last.heading + turn,
            ve,
            vn,
            last.yaw_rate if age == fresh else 0.0,
            variance,
            status,
            self._heading_variance,
        )

    def _reliability(self, age: float) -> tuple[float, EgoStatus]:
        """Return variance of the velocity, (m/s)², and status, by the age of the velocity, s."""
        unseen = abs(age) - self._age_limit
        if unseen <= 0.0:
            return self._speed_variance, EgoStatus.VALID
        status = EgoStatus.DEAD_RECKONING if age < self._dead_reckoning else EgoStatus.LOST
        return self._speed_variance + (self._unseen_acceleration * unseen) ** 2, status

    @staticmethod
    def _along(sample: Sample) -> float:
        """Acceleration along the velocity, m/s²."""
        speed = hypot(sample.ve, sample.vn)
        return (sample.ae * sample.ve + sample.an * sample.vn) / speed if speed > 0.1 else 0.0


def _between(a: Sample, b: Sample, time_ns: int) -> tuple[float, float, float, float, float]:
    """Return which share of the time from a sample to the next is over, and place and velocity, east and north."""
    dt = (time_ns - a.time_ns) * 1e-9
    share = dt / ((b.time_ns - a.time_ns) * 1e-9)
    ve, vn = a.ve + share * (b.ve - a.ve), a.vn + share * (b.vn - a.vn)
    return share, a.east + dt * (a.ve + ve) / 2, a.north + dt * (a.vn + vn) / 2, ve, vn
