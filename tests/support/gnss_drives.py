"""What the tests of the placement share: drives with turns and braking, and an INS that tells them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np

from candaemon.arrays import Floats
from candaemon.config.ego import InsSettings
from candaemon.ego.geodesy import TangentPlane
from candaemon.ego.georeference import Georeferencer
from candaemon.ego.ins import InsMotion
from tests.support.builders import known, ns

HOME = np.radians(48.1), np.radians(11.6)
MOTION = ("velocity_east", "velocity_north", "heading", "yaw_rate")
PLACE = ("latitude", "longitude")
STEP = 0.05
"""s between the INS's bursts."""


@dataclass(frozen=True, slots=True)
class Drive:
    """Where the rear axle's centre is: arrays (n,) every `STEP`, level axes from the start, SI."""

    time: Floats
    position: Floats
    velocity: Floats
    heading: Floats
    yaw_rate: Floats

    def arm(self, x: float, y: float) -> Floats:
        """Return where a point fixed to the vehicle is, from the rear axle's centre, (n, 2)."""
        c, s = np.cos(self.heading), np.sin(self.heading)
        return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def city(seconds: float) -> Drive:
    """Return a drive of 10 to 22 m/s with braking, and turns of up to 2.6 m/s² across."""
    time = np.linspace(0.0, seconds, round(seconds / STEP), endpoint=False)
    thrust, turn = np.zeros(len(time)), np.zeros(len(time))
    for start, end, value in ((20, 28, 1.2), (36, 40, -2.8), (60, 66, 1.5), (68, 71, -2.5), (90, 100, 1.0)):
        thrust[(time > start) & (time < end)] = value
    for start, end, value in ((41, 46, 0.25), (75, 83, -0.2), (110, 130, 0.1)):
        turn[(time > start) & (time < end)] = value
    speed, heading = 12.0 + np.cumsum(thrust) * STEP, 0.4 + np.cumsum(turn) * STEP
    velocity = np.stack([speed * np.cos(heading), speed * np.sin(heading)], axis=-1)
    position = np.zeros_like(velocity)
    position[1:] = np.cumsum((velocity[1:] + velocity[:-1]) / 2 * STEP, axis=0)
    return Drive(time, position, velocity, heading, turn)


class Ins:
    """An INS that tells a drive, and what the daemon makes of its fixes.

    Args:
        gnss: the settings of `ego.gnss`.
        arm: where it measures, vehicle axes, m.
        gated: whether it tells that its solution is valid.
        more: further settings of own motion.
    """

    def __init__(
        self,
        gnss: dict[str, Any] | None = None,
        arm: tuple[float, float] = (0.0, 0.0),
        *,
        gated: bool = False,
        **more: Any,
    ) -> None:
        names = (*MOTION, *PLACE, *(("valid",) if gated else ()))
        told = {"kind": "ins", "bus": "b", "dbc": "d", "signals": {name: f"M.{name}" for name in names}}
        told |= {"gnss": gnss or {}, "lever_arm": {"x": arm[0], "y": arm[1]}}
        self.settings = InsSettings.model_validate(told | more)
        self.motion = InsMotion(self.settings)
        assert self.settings.gnss is not None
        self.placer = Georeferencer(self.settings, self.settings.gnss, self.motion.history)
        self.home = TangentPlane(*HOME)

    def tell(self, time: float, names: Sequence[str], values: Sequence[float]) -> None:
        """Tell the quantities of one frame, as the pipeline does."""
        self.motion.update(ns(time), names, values)
        self.placer.update(ns(time), names, values)

    def fix(self, time: float, position: Floats) -> None:
        """Tell a fix at a point of the plane that touches the earth at `HOME`."""
        latitude, longitude = self.home.to_earth(position[:1], position[1:])
        self.tell(time, PLACE, (float(latitude[0]), float(longitude[0])))

    def move(self, time: float, velocity: Floats, heading: float = 0.0, yaw_rate: float = 0.0) -> None:
        """Tell own motion of where it measures."""
        self.tell(time, MOTION, (velocity[0], velocity[1], pi / 2 - heading, yaw_rate))

    def place(self, time: float) -> Floats:
        """Return where the rear axle's centre is taken to be, in the plane of `HOME`; it has to be known."""
        placement, pose = self.placer.at(ns(time)), known(self.motion.pose(ns(time)))
        assert placement is not None
        found = placement.to_earth(np.array([pose.east]), np.array([pose.north]))
        return np.array(self.home.project(*found)).reshape(2)

    def drive(
        self, drive: Drive, *, period: float, noise: float = 0.0, speed_noise: float = 0.0, seed: int = 0
    ) -> Iterator[tuple[int, Floats]]:
        """Tell a drive; yield for each fix the step it came with, and where the vehicle is then taken to be."""
        random = np.random.default_rng(seed)
        arm = self.settings.lever_arm
        offset = drive.arm(arm.x, arm.y)
        every = round(period / STEP)
        turning = drive.yaw_rate[:, None] * np.stack([-offset[:, 1], offset[:, 0]], axis=-1)
        fixes = drive.position + offset + noise * random.normal(size=offset.shape)
        velocities = drive.velocity + turning + speed_noise * random.normal(size=offset.shape)
        for k, time in enumerate(drive.time.tolist()):
            if k % every == 0:
                self.fix(time, fixes[k])
            self.move(time, velocities[k], float(drive.heading[k]), float(drive.yaw_rate[k]))
            if k % every == 0:
                yield k, self.place(time)
