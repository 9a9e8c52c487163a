"""Own motion from the vehicle's own speed and yaw rate, and of a vehicle that stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import cos, sin

from candaemon.config.ego import BiasSettings, OdometrySettings
from candaemon.ego.bias import MotionBias
from candaemon.ego.motion import MotionHistory, StationaryReturns
from candaemon.ego.pose import EgoPose, EgoStatus


class OdometryMotion:
    """Own motion from wheel speeds or a speedometer and a yaw rate sensor, biases estimated on the way.

    A sample is made with each speed, once a yaw rate is known. The level frame's x axis is the first heading.

    Args:
        settings: of the odometry.
    """

    def __init__(self, settings: OdometrySettings) -> None:
        self.teaching: BiasSettings | None = settings.bias
        self.wanted = frozenset({"speed", "left_wheels", "right_wheels", "yaw_rate"})
        self._track_width = settings.track_width
        self._latency_ns = round(settings.latency * 1e9)
        self.bias = MotionBias(settings.bias)
        self._yaw_rate: float | None = None
        self._yaw_rate_ns = 0
        self._age_limit_ns = round(settings.age_limit * 1e9)
        self._wheel_speed = 0.0
        self._sides: dict[str, float] = {}
        self._heading = 0.0
        self._turned_to_ns: int | None = None
        self.history = MotionHistory(
            age_limit=settings.age_limit,
            dead_reckoning=settings.dead_reckoning,
            unseen_acceleration=settings.unseen_acceleration,
            speed_variance=settings.noise.speed**2,
            smoothing=settings.smoothing,
        )
        self._longest_step = settings.age_limit
        self._first_ns: int | None = None
        self._learning_ns = round(settings.bias.learning_time * 1e9)
        self._initialising = True

    def update(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> None:
        """Take the quantities of one frame."""
        time_ns -= self._latency_ns
        sums: dict[str, tuple[float, int]] = {}
        for name, value in zip(names, values, strict=True):
            if value == value:  # NaN: the DBC's multiplexer left it out
                total, number = sums.get(name, (0.0, 0))
                sums[name] = total + value, number + 1
        mean = {name: total / number for name, (total, number) in sums.items()}
        if "yaw_rate" in mean:
            self._turn(time_ns)
            self._yaw_rate, self._yaw_rate_ns = mean.pop("yaw_rate"), time_ns
        speed = mean.pop("speed", None)
        self._sides.update(mean)
        if len(self._sides) == 2:  # both sides are fresh, be it from one message or from two
            left, right = self._sides["left_wheels"], self._sides["right_wheels"]
            self._sides.clear()
            speed = (left + right) / 2
            self._compare(right - left)
        # without a fresh yaw rate there is no sample: own motion becomes dead reckoning, and says so
        if speed is not None and self._yaw_rate is not None and time_ns - self._yaw_rate_ns <= self._age_limit_ns:
            self._add_sample(time_ns, speed)

    def _compare(self, difference: float) -> None:
        """Let the wheels' difference of speed, right less left, correct the yaw rate."""
        if self._yaw_rate is not None:
            self.bias.learn_from_wheels(difference / self._track_width - self._yaw_rate)

    def _turn(self, time_ns: int) -> None:
        """Integrate the heading up to an instant with the latest yaw rate."""
        if self._yaw_rate is not None and self._turned_to_ns is not None and time_ns > self._turned_to_ns:
            dt = min((time_ns - self._turned_to_ns) * 1e-9, self._longest_step)
            self._heading += dt * (self._yaw_rate - self.bias.yaw_rate)
            self.bias.age(dt)
        if self._turned_to_ns is None or time_ns > self._turned_to_ns:
            self._turned_to_ns = time_ns

    def _add_sample(self, time_ns: int, wheel_speed: float) -> None:
        self._turn(time_ns)
        self._wheel_speed = wheel_speed
        speed = self.bias.scale * wheel_speed
        yaw_rate = (self._yaw_rate or 0.0) - self.bias.yaw_rate
        self.history.add(time_ns, self._heading, speed * cos(self._heading), speed * sin(self._heading), yaw_rate)
        if self._initialising:
            self._first_ns = time_ns if self._first_ns is None else self._first_ns
            self._initialising = time_ns - self._first_ns < self._learning_ns and not self.bias.learnt

    @property
    def known_until_ns(self) -> int:
        """Time of the latest sample."""
        return self.history.latest_ns

    def pose(self, time_ns: int) -> EgoPose | None:
        """Return own pose at an instant; None before speed and yaw rate are known."""
        pose = self.history.pose(time_ns)
        if self._initialising and pose is not None and pose.status is EgoStatus.VALID:
            return replace(pose, status=EgoStatus.INITIALISING)
        return pose

    def learn(self, returns: StationaryReturns) -> None:
        """Correct the speed's factor and the yaw rate's bias by what stands still."""
        self.bias.learn_from_returns(returns, self._wheel_speed)


class StandingStill:
    """Own motion of a vehicle, or a mast, that never moves."""

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
