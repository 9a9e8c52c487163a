"""Ego motion from the vehicle's speed and yaw rate, and of a vehicle that stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import cos, radians, sin
from typing import Final

import numpy as np

from candaemon.arrays import ComplexPlane, Floats
from candaemon.config.ego import BiasSettings, OdometrySettings
from candaemon.ego.bias import MotionBias, MotionBiasState
from candaemon.ego.motion import MotionHistory, MotionHistoryState, SampleCounts, StationaryReturns
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.frames.times import LONG_AGO_NS
from candaemon.objects.conditions import CompiledCondition

SHARPEST_CURVE: Final = 0.3
"""1/m, of the path of a car's rear axle: who stands does not turn."""
_LEAST_SCALE: Final = 0.1
"""No wheel reads ten times too fast."""
LARGEST_BIAS: Final = radians(3.0)
"""rad/s; a yaw rate beyond the sharpest curve is the sensor's bias up to here, and a turn on the spot above."""


@dataclass(slots=True)
class OdometryState:
    """What is remembered of the odometry.

    Attributes:
        bias: estimate of what the sensors read wrongly.
        history: the samples.
        yaw_rate: the latest, as the sensor read it, rad/s; None before the first.
        yaw_rate_ns: its time.
        wheel_speed: the latest, m/s.
        coming: of speed, left or right wheels that several messages tell and some have told: their sum, m/s, how many
            they are, and in how many messages they came.
        coming_ns: when the latest of these came.
        sides: mean speeds of the wheels of one side that wait for the other, m/s.
        heading: integrated, rad.
        turned_to_ns: time of the heading; None before the first yaw rate.
        first_ns: time of the first sample; None before it.
        initialising: whether the biases are still being learnt.
        begun_ns: time of the first frame; None before it.
        curvature: the latest, 1/m.
        curvature_ns: its time.
        derived: yaw rate of the latest sample for which the sensor was silent, rad/s; None while it comes.
        by_wheels: whether that is the wheels' difference.
        backwards: whether the vehicle drives backwards, as its gear said last.
        gear_ns: when it did.
        counts: of samples, and what was derived in them.
    """

    bias: MotionBiasState
    history: MotionHistoryState
    yaw_rate: float | None = None
    yaw_rate_ns: int = 0
    wheel_speed: float = 0.0
    coming: dict[str, tuple[float, int, int]] = field(default_factory=dict)
    coming_ns: int = LONG_AGO_NS
    sides: dict[str, float] = field(default_factory=dict)
    heading: float = 0.0
    turned_to_ns: int | None = None
    first_ns: int | None = None
    initialising: bool = True
    begun_ns: int | None = None
    curvature: float = 0.0
    curvature_ns: int = LONG_AGO_NS
    derived: float | None = None
    by_wheels: bool = False
    backwards: bool = False
    gear_ns: int = LONG_AGO_NS
    counts: SampleCounts = field(default_factory=SampleCounts)


class OdometryMotion:
    """Ego motion from wheel speeds or a speedometer and a yaw rate sensor, biases estimated on the way.

    A sample is made with each speed for which a yaw rate is known: the sensor's, while it comes; else the curvature's,
    the wheels', or none, of a vehicle that stands. Where several messages tell a speed, as one of the front and one of
    the rear wheels, it is told when as many frames came, of whichever of them: the front ones go faster in a bend. The
    local frame's x axis is the first heading. Wheels and speedometers hardly ever say which way they turn: that is the
    gear's to tell, and ahead where it is silent.

    Args:
        settings: of the odometry.
        reverse: of the quantity of that name, while the vehicle drives backwards; None: it never does, or the speed
            says so.

    Attributes:
        bias: what estimates the biases.
        history: the samples.
    """

    def __init__(self, settings: OdometrySettings, reverse: CompiledCondition | None = None) -> None:
        self.teaching: BiasSettings | None = settings.bias
        self.wanted = frozenset({"speed", "left_wheels", "right_wheels", "yaw_rate", "curvature", "reverse"})
        self._reverse = reverse
        signals = settings.signals
        told = {"speed": signals.speed, "left_wheels": signals.left_wheels, "right_wheels": signals.right_wheels}
        self._messages = {name: len({each.signal.partition(".")[0] for each in refs}) for name, refs in told.items()}
        self._has_sensor = settings.signals.yaw_rate is not None
        self._track_width = settings.track_width
        self._latency_ns = round(settings.latency * 1e9)
        self.bias = MotionBias(settings.bias, radians(settings.noise.yaw_rate_deg))
        self._age_limit_ns = round(settings.age_limit * 1e9)
        self._gear_limit_ns = round(settings.reverse_age_limit * 1e9)
        self.history = MotionHistory(
            age_limit=settings.age_limit,
            dead_reckoning=settings.dead_reckoning,
            unseen_acceleration=settings.unseen_acceleration,
            speed_variance=settings.noise.speed**2,
            smoothing=settings.smoothing,
        )
        self._longest_step = settings.age_limit
        self._still = settings.noise.speed
        self._learning_ns = round(settings.bias.learning_time * 1e9)
        self._state = OdometryState(self.bias.state, self.history.state)

    @property
    def state(self) -> OdometryState:
        """What it remembers.

        Raises:
            ValueError: a state that is set has wheels of no side.
        """
        return self._state

    @state.setter
    def state(self, state: OdometryState) -> None:
        if not state.sides.keys() < {"left_wheels", "right_wheels"} or not state.coming.keys() <= self._messages.keys():
            raise ValueError("wheels of other sides than left or right")
        if any(number < 1 or came < 1 for _, number, came in state.coming.values()):
            raise ValueError("a speed that no message told")
        if not state.bias.mean[0] > 0.0:
            raise ValueError("a factor of the speed that is not above 0")
        self._state, self.bias.state, self.history.state = state, state.bias, state.history

    def update(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> None:
        """Take the quantities of one frame."""
        state = self._state
        time_ns -= self._latency_ns
        sums: dict[str, tuple[float, int]] = {}
        for name, value in zip(names, values, strict=True):
            if value == value:  # NaN: the DBC's multiplexer left it out
                total, number = sums.get(name, (0.0, 0))
                sums[name] = total + value, number + 1
        mean = {name: total / number for name, (total, number) in self._complete(time_ns, sums).items()}
        if state.begun_ns is None:
            state.begun_ns = time_ns
        if "yaw_rate" in mean:
            self._turn(time_ns)
            state.yaw_rate, state.yaw_rate_ns, state.derived = mean.pop("yaw_rate"), time_ns, None
            self.history.coast(time_ns, state.heading, self._rate())
        if "curvature" in mean:
            state.curvature, state.curvature_ns = mean.pop("curvature"), time_ns
        if "reverse" in mean and self._reverse is not None:
            state.backwards, state.gear_ns = bool(self._reverse.passes(mean.pop("reverse"))), time_ns
        speed, difference = mean.pop("speed", None), None
        state.sides.update(mean)
        if len(state.sides) == 2:  # both sides are fresh, be it from one message or from two
            left, right = state.sides["left_wheels"], state.sides["right_wheels"]
            state.sides.clear()
            speed, difference = (left + right) / 2, right - left
        if speed is not None and speed > 0.0 and self._backs(time_ns):
            speed, difference = -speed, None if difference is None else -difference
        if speed is not None and self._knows_turn(time_ns, speed, difference):
            state.counts.direction_assumed += self.lacks_gear(time_ns)
            self._add_sample(time_ns, speed)

    def _complete(self, time_ns: int, sums: dict[str, tuple[float, int]]) -> dict[str, tuple[float, int]]:
        """Return the sums of a frame's values and their numbers; of what several messages tell, once as many came."""
        state, found = self._state, {}
        if time_ns - state.coming_ns > self._age_limit_ns:
            state.coming.clear()
            state.sides.clear()
        for name, (total, number) in sums.items():
            if self._messages.get(name, 1) > 1:
                before, of_before, came = state.coming.pop(name, (0.0, 0, 0))
                total, number = before + total, of_before + number
                if came + 1 < self._messages[name]:
                    state.coming[name] = total, number, came + 1
                    continue
            found[name] = total, number
        if not self._messages.keys().isdisjoint(sums):
            state.coming_ns = time_ns
        return found

    def lacks_gear(self, time_ns: int) -> bool:
        """Return whether the signal that tells reverse is silent at an instant, so that speeds count as ahead."""
        begun_ns = time_ns if self._state.begun_ns is None else self._state.begun_ns
        return self._reverse is not None and time_ns - max(self._state.gear_ns, begun_ns) > self._gear_limit_ns

    def _backs(self, time_ns: int) -> bool:
        """Return whether the gear says that the vehicle drives backwards."""
        return self._state.backwards and not self.lacks_gear(time_ns)

    def _knows_turn(self, time_ns: int, speed: float, difference: float | None) -> bool:
        """Work out the yaw rate at a speed; return whether it is known.

        Without one there is no sample: ego motion becomes dead reckoning, and says so.

        Args:
            time_ns: of the speed.
            speed: m/s.
            difference: of the wheels' speeds, right less left, m/s; None where they are not given.
        """
        state = self._state
        wheels = None if difference is None else difference / self._track_width
        if state.yaw_rate is not None and time_ns - state.yaw_rate_ns <= self._age_limit_ns:
            if wheels is not None:
                self.bias.learn_from_wheels(wheels - state.yaw_rate)
            if abs(speed) <= self._still and abs(state.yaw_rate) <= LARGEST_BIAS:
                self.bias.learn_at_rest(state.yaw_rate)
            return True
        if self._has_sensor and state.begun_ns is not None and time_ns - state.begun_ns <= self._age_limit_ns:
            return False  # it may begin later than the speed
        state.by_wheels = False
        if time_ns - state.curvature_ns <= self._age_limit_ns:
            state.derived = state.curvature * speed
            state.counts.yaw_rate_from_curvature += 1
        elif wheels is not None:
            state.derived, state.by_wheels = wheels - self.bias.mismatch, True
            state.counts.yaw_rate_from_wheels += 1
        elif abs(speed) <= self._still:
            state.derived = 0.0
            state.counts.yaw_rate_at_rest += 1
        else:
            return False
        return True

    def _rate(self) -> float:
        """Return the yaw rate, rad/s, without its bias: who stands does not turn."""
        state = self._state
        rate = (state.yaw_rate or 0.0) - self.bias.yaw_rate if state.derived is None else state.derived
        most = SHARPEST_CURVE * abs(state.wheel_speed)
        is_bias = most < abs(rate) <= LARGEST_BIAS and state.counts.samples > 0
        return max(-most, min(rate, most)) if is_bias else rate

    def _turn(self, time_ns: int) -> None:
        """Integrate the heading up to an instant with the latest yaw rate."""
        state = self._state
        known = state.yaw_rate is not None or state.derived is not None
        if known and state.turned_to_ns is not None and time_ns > state.turned_to_ns:
            dt = min((time_ns - state.turned_to_ns) * 1e-9, self._longest_step)
            state.heading += dt * self._rate()
            self.bias.age(dt)
        if state.turned_to_ns is None or time_ns > state.turned_to_ns:
            state.turned_to_ns = time_ns

    def _add_sample(self, time_ns: int, wheel_speed: float) -> None:
        state = self._state
        self._turn(time_ns)
        state.wheel_speed = wheel_speed
        state.counts.samples += 1
        speed = self.bias.scale * wheel_speed
        self.history.add(time_ns, state.heading, speed * cos(state.heading), speed * sin(state.heading), self._rate())
        if state.initialising:
            state.first_ns = time_ns if state.first_ns is None else state.first_ns
            state.initialising = time_ns - state.first_ns < self._learning_ns and not self.bias.learnt

    @property
    def counts(self) -> SampleCounts:
        """Samples, and what was derived in them."""
        return self._state.counts

    @property
    def known_until_ns(self) -> int:
        """Time of the latest sample."""
        return self.history.latest_ns

    def pose(self, time_ns: int) -> EgoPose | None:
        """Return the ego pose at an instant; None before speed and yaw rate are known."""
        pose = self.history.pose(time_ns)
        if self._state.initialising and pose is not None and pose.status is EgoStatus.VALID:
            return replace(pose, status=EgoStatus.INITIALISING)
        return pose

    def course(self, begin_ns: int, step_ns: int, count: int) -> tuple[ComplexPlane, Floats] | None:
        """Return places, east + i north, m, and unwrapped headings, rad, at even steps (count,), if all are known."""
        return self.history.course(begin_ns, step_ns, count)

    def learn(self, returns: StationaryReturns) -> None:
        """Correct the speed's factor and the bias of what tells the turning, where it has one, by what stands still."""
        by_wheels = self._state.by_wheels
        if self._state.derived is not None and not by_wheels:
            returns = replace(returns, drifts=())  # these are the curvature's error, not that of the silent sensor
        self.bias.learn_from_returns(
            returns, returns.own_speed / max(self.bias.scale, _LEAST_SCALE), by_wheels=by_wheels
        )

    @property
    def corrections(self) -> tuple[float, float]:
        """Factor on the wheels' speed, and what is taken from the yaw rate as read, rad/s."""
        state = self._state
        if state.derived is None:
            return self.bias.scale, self.bias.yaw_rate
        return self.bias.scale, self.bias.mismatch if state.by_wheels else 0.0

    def correct(self, scale: float, yaw_rate: float, scale_sd: float, yaw_rate_sd: float) -> None:
        """Set the speed's factor, and the yaw rate sensor's bias while that is what tells the turning."""
        self.bias.set_scale(scale, scale_sd)
        if self._state.derived is None:
            self.bias.set_yaw_rate(yaw_rate, yaw_rate_sd)


class StandingStill:
    """Ego motion of a vehicle, or a mast, that never moves: it remembers nothing."""

    state: None = None
    teaching: BiasSettings | None = None
    wanted: frozenset[str] = frozenset()
    known_until_ns = 1 << 62
    counts = SampleCounts()

    def update(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> None:
        """Take nothing: no signal is bound."""

    def pose(self, time_ns: int) -> EgoPose:
        """Return the origin, at rest."""
        return EgoPose(time_ns, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, EgoStatus.VALID)

    def course(self, begin_ns: int, step_ns: int, count: int) -> tuple[ComplexPlane, Floats]:
        """Return the origin and 0, count times."""
        del begin_ns, step_ns  # it is there at any time
        return np.zeros(count, np.complex128), np.zeros(count)

    @property
    def corrections(self) -> tuple[float, float]:
        """None: nothing is read."""
        return 1.0, 0.0

    def learn(self, returns: StationaryReturns) -> None:
        """Ignore what stands still: nothing can be learnt at rest."""

    def correct(self, scale: float, yaw_rate: float, scale_sd: float, yaw_rate_sd: float) -> None:
        """Ignore what a calibration found: nothing is read."""
