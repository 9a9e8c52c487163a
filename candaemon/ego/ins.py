"""Own motion from a GPS/INS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import cos, hypot, pi, remainder, sin, tau

from candaemon.config.ego import BiasSettings, InsSettings
from candaemon.ego.ins_epoch import InsEpoch
from candaemon.ego.motion import MotionHistory, StationaryReturns
from candaemon.ego.pose import EgoPose


class InsMotion:
    """Own motion from velocity and heading over ground; GNSS positions are left to the placer.

    A sample is made when every quantity it needs has arrived afresh, at the time of the velocity.

    Args:
        settings: of the INS.
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
        self._burst = InsEpoch(needed | ({"velocity_east"} if self._components else set()), clock, settings.age_limit)
        self._latency_ns = round(settings.latency * 1e9)
        self.wanted = self._burst.needed | {"valid"}
        self._yaw_rate = 0.0
        self._heading: float | None = None
        self._heading_ns = 0
        self.history = MotionHistory(
            age_limit=settings.age_limit,
            dead_reckoning=settings.dead_reckoning,
            unseen_acceleration=settings.unseen_acceleration,
            speed_variance=settings.noise.velocity**2,
            smoothing=settings.smoothing,
        )

    def update(self, time_ns: int, names: Sequence[str], values: Sequence[float]) -> None:
        """Take the quantities of one frame."""
        if self._burst.take(time_ns, names, values) and self._burst.value.get("valid", 1.0) != 0.0:
            self._add_sample(self._burst.time_ns - self._latency_ns, self._burst.value)

    def _add_sample(self, time_ns: int, value: Mapping[str, float]) -> None:
        heading = self._continuous(pi / 2 - value["heading"])
        yaw_rate = self._turned(heading, time_ns)
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
        self._heading, self._heading_ns = heading, time_ns
        self.history.add(time_ns, heading, ve, vn, yaw_rate)

    def _continuous(self, heading: float) -> float:
        """Unwrap the heading."""
        if self._heading is None:
            return heading
        return self._heading + remainder(heading - self._heading, tau)

    def _turned(self, heading: float, time_ns: int) -> float:
        """Return the smoothed derivative of the heading, for an INS that gives no turn."""
        dt = (time_ns - self._heading_ns) * 1e-9
        if self._heading is None or dt <= 0.0:
            return self._yaw_rate
        share = dt / (dt + self._settings.smoothing)
        self._yaw_rate += share * ((heading - self._heading) / dt - self._yaw_rate)
        return self._yaw_rate

    @property
    def known_until_ns(self) -> int:
        """Time of the latest sample."""
        return self.history.latest_ns

    def pose(self, time_ns: int) -> EgoPose | None:
        """Return own pose at an instant; None before the first complete sample."""
        return self.history.pose(time_ns)

    def learn(self, returns: StationaryReturns) -> None:
        """Ignore what stands still: the INS knows better."""
