"""Ego motion from a GPS/INS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, hypot, pi, remainder, sin, tau

from candaemon.config.ego import BiasSettings, InsSettings
from candaemon.ego.ins_epoch import InsEpoch, InsEpochState
from candaemon.ego.motion import MotionHistory, MotionHistoryState, StationaryReturns
from candaemon.ego.pose import EgoPose


@dataclass(slots=True)
class InsMotionState:
    """What is remembered of an INS.

    Attributes:
        epoch: the quantities of the current burst.
        history: the samples.
        heading: of the latest sample, not wrapped, rad from east, positive to the left; None before the first.
        heading_ns: its time.
        yaw_rate: derivative of the heading, smoothed, rad/s; only for an INS that gives no yaw rate.
    """

    epoch: InsEpochState
    history: MotionHistoryState
    heading: float | None = None
    heading_ns: int = 0
    yaw_rate: float = 0.0


class InsMotion:
    """Ego motion from velocity and heading over ground; GNSS positions are left to the georeferencer.

    A sample is made when every quantity it needs has arrived afresh, at the time of the velocity.

    Args:
        settings: of the INS.

    Attributes:
        history: the samples.
    """

    def __init__(self, settings: InsSettings) -> None:
        self._settings = settings
        self.teaching: BiasSettings | None = None
        signals = settings.signals
        self._components = signals.velocity_north is not None
        self._turn = (
            "yaw_rate" if signals.yaw_rate is not None else "curvature" if signals.curvature is not None else None
        )
        clock = "velocity_north" if self._components else "speed"
        needed = {"heading", clock} | ({self._turn} if self._turn is not None else set())
        self._epoch = InsEpoch(needed | ({"velocity_east"} if self._components else set()), clock, settings.age_limit)
        self._latency_ns = round(settings.latency * 1e9)
        self.wanted = self._epoch.needed | {"valid"}
        self.history = MotionHistory(
            age_limit=settings.age_limit,
            dead_reckoning=settings.dead_reckoning,
            unseen_acceleration=settings.unseen_acceleration,
            speed_variance=settings.noise.velocity**2,
            smoothing=settings.smoothing,
        )
        self._state = InsMotionState(self._epoch.state, self.history.state)

    @property
    def state(self) -> InsMotionState:
        """What it remembers.

        Raises:
            ValueError: a state that is set does not fit the configuration.
        """
        return self._state

    @state.setter
    def state(self, state: InsMotionState) -> None:
        self._state, self._epoch.state, self.history.state = state, state.epoch, state.history

    def update(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> None:
        """Take the quantities of one frame."""
        epoch = self._state.epoch
        if self._epoch.take(time_ns, names, values) and epoch.value.get("valid", 1.0) != 0.0:
            self._add_sample(epoch.time_ns - self._latency_ns, epoch.value)

    def _add_sample(self, time_ns: int, value: Mapping[str, float]) -> None:
        heading = self._continuous(pi / 2 - value["heading"])
        yaw_rate = self._heading_rate(heading, time_ns)
        if self._components:
            ve, vn = value["velocity_east"], value["velocity_north"]
        else:
            ve, vn = value["speed"] * cos(heading), value["speed"] * sin(heading)
        if self._turn == "curvature":
            yaw_rate = value["curvature"] * hypot(ve, vn)
        elif self._turn == "yaw_rate":
            yaw_rate = value["yaw_rate"]
        arm = self._settings.lever_arm
        c, s = cos(heading), sin(heading)
        ve += yaw_rate * (s * arm.x + c * arm.y)
        vn -= yaw_rate * (c * arm.x - s * arm.y)
        self._state.heading, self._state.heading_ns = heading, time_ns
        self.history.add(time_ns, heading, ve, vn, yaw_rate)

    def _continuous(self, heading: float) -> float:
        """Unwrap the heading."""
        before = self._state.heading
        return heading if before is None else before + remainder(heading - before, tau)

    def _heading_rate(self, heading: float, time_ns: int) -> float:
        """Return the smoothed derivative of the heading, for an INS that gives no yaw rate."""
        state = self._state
        dt = (time_ns - state.heading_ns) * 1e-9
        if state.heading is None or dt <= 0.0:
            return state.yaw_rate
        share = dt / (dt + self._settings.smoothing)
        state.yaw_rate += share * ((heading - state.heading) / dt - state.yaw_rate)
        return state.yaw_rate

    @property
    def known_until_ns(self) -> int:
        """Time of the latest sample."""
        return self.history.latest_ns

    def pose(self, time_ns: int) -> EgoPose | None:
        """Return the ego pose at an instant; None before the first complete sample."""
        return self.history.pose(time_ns)

    def learn(self, returns: StationaryReturns) -> None:
        """Ignore what stands still: the INS knows better."""
