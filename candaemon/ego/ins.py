"""Ego motion from a GPS/INS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, field
from math import asin, atan2, copysign, cos, hypot, pi, radians, remainder, sin, tau
from typing import Final

import numpy as np

from candaemon import compiled
from candaemon.arrays import ComplexPlane, Floats, Indices, Integers
from candaemon.config.ego import BiasSettings, InsSettings
from candaemon.ego.motion import MotionHistory, MotionHistoryState, Sample, SampleCounts, StationaryReturns
from candaemon.ego.motion_epoch import EARLY, LATE, SHORTEST_PERIOD_NS, MotionEpoch, MotionEpochState
from candaemon.ego.pose import EgoPose
from candaemon.ego.turn_bias import STANDING_SPEED, GivenTurn, TurnBias, TurnBiasState
from candaemon.frames.times import LONG_AGO_NS

LEAST_COURSE_SPEED: Final = 2.0
"""m/s; the course of a vehicle that is faster tells its heading while none comes."""
FASTEST_TURN: Final = 2.0
"""rad/s; a heading that turns faster has been set, and tells nothing of the yaw rate."""
_COURSE_SMOOTHING = 2.0
"""Times the smoothing of headings: a course is as much noisier."""
_SIDEWAYS_SHARE = 0.05
"""Of a sample in the smoothed velocity sideways."""


@dataclass(slots=True)
class InsMotionState:
    """What is remembered of an INS.

    Attributes:
        epoch: the quantities of the current instant.
        history: the samples.
        heading: the latest, not wrapped, rad from east, positive to the left; None before the first.
        heading_ns: its time.
        yaw_rate: derivative of the heading, smoothed, rad/s.
        heard_ns: when the INS sent it last.
        bridged: s driven since without another measure of it.
        curvature: of the path, 1/m, while the vehicle was last fast enough to show it.
        sideways: velocity of the rear axle to the left, m/s, smoothed: an error of the INS, for an axle does not slip.
        turn_bias: of the yaw rate as it is given.
        counts: of samples, and what was derived in them.
    """

    epoch: MotionEpochState
    history: MotionHistoryState
    heading: float | None = None
    heading_ns: int = 0
    yaw_rate: float = 0.0
    heard_ns: int = LONG_AGO_NS
    bridged: float = 0.0
    curvature: float = 0.0
    sideways: float = 0.0
    turn_bias: TurnBiasState = field(default_factory=TurnBiasState)
    counts: SampleCounts = field(default_factory=SampleCounts)


class InsMotion:
    """Ego motion from velocity and heading over ground; GNSS positions are left to the georeferencer.

    A sample is made with each velocity, at its time. The heading comes with it, or from the yaw rate, the course or
    standing still since the last one. Yaw rate, curvature, slip and accelerations are used while they come; otherwise
    they are derived. The bias of a yaw rate that comes with headings is told by them.

    Args:
        settings: of the INS.

    Attributes:
        history: the samples.
    """

    def __init__(self, settings: InsSettings) -> None:
        self._settings = settings
        self.teaching: BiasSettings | None = None
        given = {name for name, signal in settings.signals if signal is not None} - {"latitude", "longitude"}
        self._components = "velocity_north" in given
        if self._components:
            given.discard("speed")
        self._clock = "velocity_north" if self._components else "speed"
        self._epoch = MotionEpoch(self._clock, given - {self._clock, "valid"}, settings.age_limit)
        self._gives_yaw_rate, self._gives_curvature = "yaw_rate" in given, "curvature" in given
        self._gives_acceleration, self._is_gated = "ax" in given, "valid" in given
        self._latency_ns = round(settings.latency * 1e9)
        self._age_limit_ns = round(settings.age_limit * 1e9)
        self._turn_bias = TurnBias(settings)
        self.wanted = frozenset(given)
        self.history = MotionHistory(
            age_limit=settings.age_limit,
            dead_reckoning=settings.dead_reckoning,
            unseen_acceleration=settings.unseen_acceleration,
            speed_variance=settings.noise.velocity**2,
            smoothing=settings.smoothing,
            heading_variance=radians(settings.noise.heading_deg) ** 2,
        )
        self._state = InsMotionState(self._epoch.state, self.history.state, turn_bias=self._turn_bias.state)
        # for many frames at once
        self._numbers: dict[str, int] = {}
        roles = (self._clock, "velocity_east", "heading", "yaw_rate", "curvature", "slip", "ax", "ay", "valid")
        self._roles = tuple(self._number(name) if name in given else -1 for name in roles)
        self._waits = sum(1 << self._number(name) for name in given - {self._clock, "valid"})
        arm = settings.lever_arm
        self._limits = (
            round(settings.age_limit * 1e9),
            self._latency_ns,
            self._age_limit_ns,
            settings.age_limit,
            settings.smoothing,
            arm.x,
            arm.y,
            SHORTEST_PERIOD_NS,
            EARLY,
            LATE,
            FASTEST_TURN,
            LEAST_COURSE_SPEED,
            _SIDEWAYS_SHARE,
            *self._turn_bias.limits,
        )
        self._steady: compiled.kernels.InsEpochs | None = None
        self._is_ahead = False

    @property
    def state(self) -> InsMotionState:
        """What it remembers.

        Raises:
            ValueError: a state that is set does not fit the configuration.
        """
        self._take_back()
        return self._state

    @state.setter
    def state(self, state: InsMotionState) -> None:
        self._is_ahead = False
        self._state, self._epoch.state, self.history.state = state, state.epoch, state.history
        self._turn_bias.state = state.turn_bias

    @property
    def counts(self) -> SampleCounts:
        """Samples, and what was derived in them."""
        self._take_back()
        return self._state.counts

    def update(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> None:
        """Take the quantities of one frame."""
        if self._is_ahead:
            self._take_back()
        if self._state.epoch.is_open and self._clock in names:  # what has not come until now was lost or is silent
            self._add_sample()
        if self._epoch.take(time_ns, names, values):
            self._add_sample()
        elif "heading" in names and time_ns - self._state.epoch.time_ns > self._age_limit_ns:
            self._coast(time_ns)

    @property
    def takes_many(self) -> bool:
        """Whether `update_together` can be used."""
        return compiled.in_use and len(type(self._settings.signals).model_fields) <= compiled.QUANTITIES

    def columns(self, messages: Sequence[Sequence[str]]) -> Indices:
        """Return which quantity each value of some messages is, for `keep`; −1 after the last of a message.

        Messages without a quantity that is wanted have none.
        """
        columns = np.full((len(messages), max(map(len, messages), default=0) + 1), -1)
        for row, names in zip(columns, messages, strict=True):
            if not self.wanted.isdisjoint(names):
                row[: len(names)] = [self._number(name) for name in names]
        return columns

    def keep(self, times_ns: Integers, message: Indices, values: Floats, columns: Indices) -> None:
        """Keep frames for `update_together`.

        Args:
            times_ns: time stamps (n,).
            message: which message each is (n,).
            values: of their quantities (n, values).
            columns: of these messages.
        """
        if self._steady is None:
            self._steady = compiled.kernels.InsEpochs(self._roles, self._waits, self._limits)
        self._steady.keep(times_ns, message, values, columns)

    def update_together(self, begin: int, end: int) -> int:
        """Take kept frames, as `update` does, up to the first that asks for more than a steady drive; return which.

        Args:
            begin: the first frame meant.
            end: after the last.
        """
        steady, samples = self._steady, self.history.state.samples
        if steady is None or not samples:
            return begin
        if not self._is_ahead:
            self._is_ahead = True
            self._hand_over(steady, samples[-1])
        reached, made = steady.take(begin, end, Sample)
        self.history.extend(made)
        return reached

    def _hand_over(self, steady: compiled.kernels.InsEpochs, last: Sample) -> None:
        """Let what takes kept frames go on from what is remembered."""
        state, epoch = self._state, self._state.epoch
        signals = [epoch.signals.get(name) for name in self._numbers]
        steady.load(
            [None if each is None else (each.value, each.arrived_ns, each.period_ns) for each in signals],
            sum(1 << self._numbers[name] for name in epoch.waiting),
            (
                epoch.time_ns,
                epoch.is_open,
                state.heading,
                state.heading_ns,
                state.yaw_rate,
                state.heard_ns,
                state.bridged,
                state.curvature,
                state.sideways,
                astuple(state.turn_bias),
            ),
            last,
        )

    def _take_back(self) -> None:
        """Remember what the kept frames have changed."""
        if not self._is_ahead or self._steady is None:
            return
        self._is_ahead = False
        state, epoch, counts = self._state, self._state.epoch, self._state.counts
        heard, waiting, memory, counted = self._steady.memory()
        for name, known in zip(self._numbers, heard, strict=False):
            if known is not None:
                signal = epoch.signals[name]
                signal.value, signal.arrived_ns, signal.period_ns = known
        epoch.waiting = {name for name, number in self._numbers.items() if waiting >> number & 1}
        (
            epoch.time_ns,
            epoch.is_open,
            state.heading,
            state.heading_ns,
            state.yaw_rate,
            state.heard_ns,
            state.bridged,
            state.curvature,
            state.sideways,
            bias,
        ) = memory
        self._turn_bias.state = state.turn_bias = TurnBiasState(*bias)
        counts.samples += counted[0]
        counts.yaw_rate_from_curvature += counted[1]
        counts.yaw_rate_from_heading += counted[2]
        counts.acceleration_given += counted[3]

    def _number(self, name: str) -> int:
        """Return the number of a quantity, which the first that asks gives it."""
        return self._numbers.setdefault(name, len(self._numbers))

    def _add_sample(self) -> None:
        """Make a sample of an epoch that is complete, or as complete as it becomes."""
        epoch, state = self._epoch, self._state
        signals = state.epoch.signals
        if (self._is_gated and not self._is_valid()) or (self._components and not epoch.belongs("velocity_east")):
            return
        time_ns = state.epoch.time_ns - self._latency_ns
        ve = vn = 0.0
        if self._components:
            ve, vn = signals["velocity_east"].value, signals["velocity_north"].value
            speed = hypot(ve, vn)
        else:
            speed = signals["speed"].value
        given = self._given_turn(speed)
        heard_ns = state.heard_ns
        heading = self._heading(time_ns, (ve, vn), speed, given)
        if heading is None:
            return
        state.counts.samples += 1
        turn = self._turn_bias.unbiased(given)
        if turn is None:
            turn = state.yaw_rate
            state.counts.yaw_rate_from_heading += 1
        if not self._components:
            course = heading + self._slip(speed, turn)
            ve, vn = speed * cos(course), speed * sin(course)
        arm = self._settings.lever_arm
        c, s = cos(heading), sin(heading)
        ve += turn * (s * arm.x + c * arm.y)
        vn -= turn * (c * arm.x - s * arm.y)
        if abs(speed) >= LEAST_COURSE_SPEED:
            state.curvature = turn / speed
            if state.heard_ns != heard_ns:
                state.sideways += _SIDEWAYS_SHARE * (vn * c - ve * s - state.sideways)
        acceleration = self._acceleration(c, s, speed * turn) if self._gives_acceleration else None
        self.history.add(time_ns, heading, ve, vn, turn, acceleration)

    def _is_valid(self) -> bool:
        valid = self._state.epoch.signals.get("valid")
        return valid is None or valid.value != 0.0

    def _given_turn(self, speed: float) -> GivenTurn | None:
        """Return the yaw rate that is given, as such or as the path's curvature; None while neither comes."""
        turn = self._epoch.fresh("yaw_rate") if self._gives_yaw_rate else None
        if turn is not None:
            return GivenTurn(turn, speed, by_curvature=False, is_usual=True)
        curvature = self._epoch.fresh("curvature") if self._gives_curvature else None
        if curvature is None:
            return None
        self._state.counts.yaw_rate_from_curvature += 1
        return GivenTurn(curvature * speed, speed, by_curvature=True, is_usual=not self._gives_yaw_rate)

    def _slip(self, speed: float, turn: float) -> float:
        """Return the angle from heading to velocity where the INS is; the rear axle does not slip."""
        slip = self._epoch.fresh("slip")
        if slip is not None:
            return slip
        across = turn * self._settings.lever_arm.x
        return asin(across / speed) if abs(across) < abs(speed) else 0.0

    def _acceleration(self, c: float, s: float, centripetal: float) -> tuple[float, float] | None:
        """Return the acceleration that is given, east and north, m/s²; None while none comes."""
        ahead = self._epoch.fresh("ax")
        if ahead is None:
            return None
        left = self._epoch.fresh("ay")
        left = centripetal if left is None else left
        self._state.counts.acceleration_given += 1
        return c * ahead - s * left, s * ahead + c * left

    def _heading(
        self, time_ns: int, velocity: tuple[float, float], speed: float, given: GivenTurn | None
    ) -> float | None:
        """Return the heading at a sample's time, not wrapped; None where it is not known.

        Args:
            time_ns: of the sample.
            velocity: over ground, east and north, m/s.
            speed: m/s.
            given: yaw rate; None while none comes.
        """
        state, signal = self._state, self._state.epoch.signals.get("heading")
        if signal is not None and signal.arrived_ns != state.heard_ns:
            together = self._epoch.belongs("heading")
            self._hear_heading(signal.value, signal.arrived_ns, time_ns if together else None, given)
        elif state.heading is not None and self._epoch.fresh("heading") is None:
            return self._bridge(state.heading, time_ns, velocity, abs(speed), self._turn_bias.unbiased(given))
        if state.heading is None:
            return None
        turn = self._turn_bias.unbiased(given)
        return state.heading + (state.yaw_rate if turn is None else turn) * ((time_ns - state.heading_ns) * 1e-9)

    def _hear_heading(self, compass: float, arrived_ns: int, time_ns: int | None, given: GivenTurn | None) -> None:
        """Take a heading as it is sent, of a sample's time or else of its own; derivative and bias follow."""
        state = self._state
        state.heard_ns, state.bridged = arrived_ns, 0.0
        time_ns = arrived_ns - self._latency_ns if time_ns is None else time_ns
        heading = pi / 2 - compass
        if state.heading is not None:
            change = remainder(heading - state.heading, tau)
            heading = state.heading + change
            dt = (time_ns - state.heading_ns) * 1e-9
            self._derive_turn(change, dt)
            if given is not None and given.is_usual and 0.0 < dt <= self._settings.age_limit:
                self._turn_bias.follow(given, change, dt)
        state.heading, state.heading_ns = heading, time_ns
        self._turn_bias.note(given)

    def _derive_turn(self, change: float, dt: float) -> None:
        """Let the yaw rate follow a change of the heading; begin anew after a pause, leave out one that was set."""
        state = self._state
        if dt > self._settings.age_limit:
            state.yaw_rate = 0.0
        elif dt > 0.0 and abs(change) <= FASTEST_TURN * dt:
            share = dt / (dt + self._settings.smoothing)
            state.yaw_rate += share * (change / dt - state.yaw_rate)

    def _bridge(
        self, heading: float, time_ns: int, velocity: tuple[float, float], speed: float, turn: float | None
    ) -> float | None:
        """Return the heading while none comes: turned on by the yaw rate, else that of the course.

        Who stands keeps it; who is too slow for a course goes on in the curve, or straight on, as before.
        """
        state, counts = self._state, self._state.counts
        dt = max(time_ns - state.heading_ns, 0) * 1e-9
        if speed > STANDING_SPEED:
            state.bridged += dt
        known = state.bridged <= self._settings.dead_reckoning
        if turn is not None and known:
            heading += turn * dt if speed > STANDING_SPEED else 0.0
            counts.heading_from_yaw_rate += 1
        elif self._components and speed >= LEAST_COURSE_SPEED:
            heading = self._follow_course(heading, velocity, speed, dt)
            counts.heading_from_course += 1
        elif known:
            state.yaw_rate = state.curvature * speed if speed > STANDING_SPEED else 0.0
            heading += state.yaw_rate * dt
            counts.heading_kept += 1
        else:
            return None
        state.heading, state.heading_ns = heading, time_ns
        self._turn_bias.note(None)
        return heading

    def _follow_course(self, heading: float, velocity: tuple[float, float], speed: float, dt: float) -> float:
        """Return the heading of a vehicle by where it goes, be it ahead or back: an α-β filter."""
        state = self._state
        ve, vn = velocity
        across = state.sideways + state.yaw_rate * self._settings.lever_arm.x
        ahead = copysign(speed, ve * cos(heading) + vn * sin(heading))
        slip = asin(across / ahead) if abs(across) < speed else 0.0
        rest = remainder(atan2(vn, ve) - slip - heading - state.yaw_rate * dt, pi)
        share = dt / (dt + _COURSE_SMOOTHING * self._settings.smoothing) if dt > 0.0 else 0.0
        heading += state.yaw_rate * dt + share * rest
        if 0.0 < dt <= self._settings.age_limit:
            state.yaw_rate += share**2 / (2.0 - share) * rest / dt
        state.bridged = 0.0
        return heading

    def _coast(self, time_ns: int) -> None:
        """Go on along the heading that comes while the velocity is silent."""
        state = self._state
        latest = self.history.latest
        if latest is None or time_ns - self._latency_ns - latest.seen_ns <= self._age_limit_ns or not self._is_valid():
            return
        signal = state.epoch.signals["heading"]
        if signal.arrived_ns == time_ns:
            self._hear_heading(signal.value, time_ns, None, None)
            if state.heading is not None:
                self.history.coast(state.heading_ns, state.heading, state.yaw_rate)

    @property
    def known_until_ns(self) -> int:
        """Time of the latest sample."""
        return self.history.latest_ns

    def pose(self, time_ns: int) -> EgoPose | None:
        """Return the ego pose at an instant; None before the first complete sample."""
        return self.history.pose(time_ns)

    def course(self, begin_ns: int, step_ns: int, count: int) -> tuple[ComplexPlane, Floats] | None:
        """Return places, east + i north, m, and unwrapped headings, rad, at even steps (count,), if all are known."""
        return self.history.course(begin_ns, step_ns, count)

    @property
    def corrections(self) -> tuple[float, float]:
        """None that is learnt from what stands: the headings tell the bias of the yaw rate."""
        return 1.0, 0.0

    def learn(self, returns: StationaryReturns) -> None:
        """Ignore what stands still: the INS knows better."""

    def correct(self, scale: float, yaw_rate: float, scale_sd: float, yaw_rate_sd: float) -> None:
        """Ignore what a calibration found: the INS knows better."""
