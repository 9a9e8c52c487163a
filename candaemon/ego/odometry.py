"""Ego motion from the vehicle's speed and yaw rate, and of a vehicle that stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import cos, sin

from candaemon.config.ego import BiasSettings, OdometrySettings
from candaemon.ego.bias import MotionBias, MotionBiasState
from candaemon.ego.motion import MotionHistory, MotionHistoryState, StationaryReturns
from candaemon.ego.pose import EgoPose, EgoStatus


@dataclass(slots=True)
class OdometryState:
    """What is remembered of the odometry.

    Attributes:
        bias: estimate of what the sensors read wrongly.
        history: the samples.
        yaw_rate: the latest, as the sensor read it, rad/s; None before the first.
        yaw_rate_ns: its time.
        wheel_speed: the latest, m/s.
        sides: mean speeds of the wheels of one side that wait for the other, m/s.
        heading: integrated, rad.
        turned_to_ns: time of the heading; None before the first yaw rate.
        first_ns: time of the first sample; None before it.
        initialising: whether the biases are still being learnt.
    """

    bias: MotionBiasState
    history: MotionHistoryState
    yaw_rate: float | None = None
    yaw_rate_ns: int = 0
    wheel_speed: float = 0.0
    sides: dict[str, float] = field(default_factory=dict)
    heading: float = 0.0
    turned_to_ns: int | None = None
    first_ns: int | None = None
    initialising: bool = True


class OdometryMotion:
    """Ego motion from wheel speeds or a speedometer and a yaw rate sensor, biases estimated on the way.

    A sample is made with each speed, once a yaw rate is known. The local frame's x axis is the first heading.

    Args:
        settings: of the odometry.

    Attributes:
        bias: what estimates the biases.
        history: the samples.
    """

    def __init__(self, settings: OdometrySettings) -> None:
        self.teaching: BiasSettings | None = settings.bias
        self.wanted = frozenset({"speed", "left_wheels", "right_wheels", "yaw_rate"})
        self._track_width = settings.track_width
        self._latency_ns = round(settings.latency * 1e9)
        self.bias = MotionBias(settings.bias)
        self._age_limit_ns = round(settings.age_limit * 1e9)
        self.history = MotionHistory(
            age_limit=settings.age_limit,
            dead_reckoning=settings.dead_reckoning,
            unseen_acceleration=settings.unseen_acceleration,
            speed_variance=settings.noise.speed**2,
            smoothing=settings.smoothing,
        )
        self._longest_step = settings.age_limit
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
        if not state.sides.keys() < {"left_wheels", "right_wheels"}:
            raise ValueError("wheels of other sides than left or right")
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
        mean = {name: total / number for name, (total, number) in sums.items()}
        if "yaw_rate" in mean:
            self._turn(time_ns)
            state.yaw_rate, state.yaw_rate_ns = mean.pop("yaw_rate"), time_ns
        speed = mean.pop("speed", None)
        state.sides.update(mean)
        if len(state.sides) == 2:  # both sides are fresh, be it from one message or from two
            left, right = state.sides["left_wheels"], state.sides["right_wheels"]
            state.sides.clear()
            speed = (left + right) / 2
            self._compare(right - left)
        # without a fresh yaw rate there is no sample: ego motion becomes dead reckoning, and says so
        if speed is not None and state.yaw_rate is not None and time_ns - state.yaw_rate_ns <= self._age_limit_ns:
            self._add_sample(time_ns, speed)

    def _compare(self, difference: float) -> None:
        """Let the wheels' difference of speed, right less left, correct the yaw rate."""
        if self._state.yaw_rate is not None:
            self.bias.learn_from_wheels(difference / self._track_width - self._state.yaw_rate)

    def _turn(self, time_ns: int) -> None:
        """Integrate the heading up to an instant with the latest yaw rate."""
        state = self._state
        if state.yaw_rate is not None and state.turned_to_ns is not None and time_ns > state.turned_to_ns:
            dt = min((time_ns - state.turned_to_ns) * 1e-9, self._longest_step)
            state.heading += dt * (state.yaw_rate - self.bias.yaw_rate)
            self.bias.age(dt)
        if state.turned_to_ns is None or time_ns > state.turned_to_ns:
            state.turned_to_ns = time_ns

    def _add_sample(self, time_ns: int, wheel_speed: float) -> None:
        state = self._state
        self._turn(time_ns)
        state.wheel_speed = wheel_speed
        speed = self.bias.scale * wheel_speed
        yaw_rate = (state.yaw_rate or 0.0) - self.bias.yaw_rate
        self.history.add(time_ns, state.heading, speed * cos(state.heading), speed * sin(state.heading), yaw_rate)
        if state.initialising:
            state.first_ns = time_ns if state.first_ns is None else state.first_ns
            state.initialising = time_ns - state.first_ns < self._learning_ns and not self.bias.learnt

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

    def learn(self, returns: StationaryReturns) -> None:
        """Correct the speed's factor and the yaw rate's bias by what stands still."""
        self.bias.learn_from_returns(returns, self._state.wheel_speed)


class StandingStill:
    """Ego motion of a vehicle, or a mast, that never moves: it remembers nothing."""

    state: None = None
    teaching: BiasSettings | None = None
    wanted: frozenset[str] = frozenset()
    known_until_ns = 1 << 62

    def update(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> None:
        """Take nothing: no signal is bound."""

    def pose(self, time_ns: int) -> EgoPose:
        """Return the origin, at rest."""
        return EgoPose(time_ns, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, EgoStatus.VALID)

    def learn(self, returns: StationaryReturns) -> None:
        """Ignore what stands still: nothing can be learnt at rest."""
