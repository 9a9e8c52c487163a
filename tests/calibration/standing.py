"""A vehicle that drives past standing points, as a sensor of a configuration reports them, without CAN between."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import radians

import numpy as np

from candaemon.arrays import ComplexPlane, Floats
from candaemon.binding.bound import BoundSensor
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.radar.scan import Scan

BEGIN_NS = 1_700_000_000_000_000_000


@dataclass
class Drive:
    """Ego motion with changes of speed and curves, as a source of ego motion reads it: an `EgoMotion`.

    Attributes:
        scale: speed over ground divided by the speed as read.
        bias: of the yaw rate as read, rad/s.
        corrections: what is in the pose: factor of the speed, yaw rate taken out.
        corrected: what `correct` was called with last.
        abrupt: whether curves begin and end at once, as if the steering wheel jumped.
    """

    scale: float = 1.0
    bias: float = 0.0
    corrections: tuple[float, float] = (1.0, 0.0)
    corrected: tuple[float, ...] | None = None
    abrupt: bool = False
    time: Floats = field(default_factory=lambda: np.arange(-2.0, 80.0, 0.01))

    def __post_init__(self) -> None:
        t = self.time
        speed = 18.0 + 3.0 * np.sin(0.7 * t) + 2.0 * np.sin(0.23 * t + 1.0)
        turn = radians(7.0) * np.sin(0.5 * t) + radians(3.0) * np.sin(1.3 * t)
        if self.abrupt:
            turn = radians(7.0) * np.sign(np.sin(0.7 * t))
        self._true = self._integrated(speed, turn)
        scale, bias = self.corrections
        self._read = self._integrated(speed / self.scale * scale, turn + self.bias - bias)

    def _integrated(self, speed: Floats, turn: Floats) -> tuple[Floats, ...]:
        step = self.time[1] - self.time[0]
        heading = np.cumsum(turn) * step
        velocity = speed * np.exp(1j * heading)
        place = np.cumsum(velocity) * step
        return heading, turn, velocity.real, velocity.imag, place.real, place.imag

    def _at(self, values: tuple[Floats, ...], seconds: float) -> list[float]:
        return [float(np.interp(seconds, self.time, each)) for each in values]

    def true(self, seconds: float) -> tuple[float, float, complex, complex]:
        """Return heading, yaw rate, velocity and place."""
        heading, turn, ve, vn, east, north = self._at(self._true, seconds)
        return heading, turn, complex(ve, vn), complex(east, north)

    def pose(self, time_ns: int) -> EgoPose:
        """Return the pose as read."""
        heading, turn, ve, vn, east, north = self._at(self._read, (time_ns - BEGIN_NS) * 1e-9)
        return EgoPose(time_ns, east, north, heading, ve, vn, turn, 0.01, EgoStatus.VALID)

    def course(self, begin_ns: int, step_ns: int, count: int) -> tuple[ComplexPlane, Floats]:
        """Return places and headings as read."""
        poses = [self.pose(begin_ns + k * step_ns) for k in range(count)]
        return np.array([complex(each.east, each.north) for each in poses]), np.array([each.heading for each in poses])

    def correct(self, *found: float) -> None:
        """Remember what is to be corrected."""
        self.corrected = found


def scans(
    sensor: BoundSensor, drive: Drive, seconds: float, *, latency: float = 0.0, yaw_deg: float = 0.0, noise: float = 1.0
) -> Iterator[Scan]:
    """Yield what a sensor sees of posts by the road, later and turned more than configured.

    A polar one measures range rates, any other velocities in axes that turn with it.
    """
    settings, names = sensor.settings, sensor.reader.quantities
    random = np.random.default_rng(7)
    along = np.arange(0.0, 30.0 * seconds, 17.0)
    way = np.array([drive.true(t)[3] for t in np.linspace(0.0, seconds + 8.0, len(along))])
    ahead = np.array([drive.true(t)[0] for t in np.linspace(0.0, seconds + 8.0, len(along))])
    posts = np.concatenate([way + 6j * np.exp(1j * ahead), way - 8j * np.exp(1j * ahead)])
    mount = complex(settings.mount.x, settings.mount.y)
    names_of = ("range", "azimuth", "range_rate") if settings.signals.polar else ("x", "y", "vx", "vy")
    of = settings.noise.model_dump() | {"azimuth": radians(settings.noise.azimuth_deg or 0.0)}
    deviations = np.array([[of[name] or 0.0] for name in names_of])
    for k in range(int(seconds / settings.cycle_time)):
        stamped = k * settings.cycle_time
        heading, turn, velocity, place = drive.true(stamped - latency)
        origin = place + mount * np.exp(1j * heading)
        moving = velocity + 1j * turn * mount * np.exp(1j * heading)
        sight = posts - origin
        unit = sight / np.abs(sight)
        axis = np.exp(-1j * (heading + radians(yaw_deg)))
        angle = np.angle(unit * axis)
        seen = np.flatnonzero((np.abs(sight) < 100.0) & (np.abs(angle) < radians(40.0)))[:60]
        if settings.signals.polar:
            exact = [np.abs(sight[seen]), angle[seen], -np.real(unit[seen].conj() * moving)]
        else:
            point = sight[seen] * axis
            rate = -moving * axis - 1j * turn * point  # in axes that turn with the vehicle
            exact = [point.real, point.imag, rate.real, rate.imag]
        drawn = noise * random.standard_normal((len(names_of), len(seen))) * deviations
        rows = dict(zip(names_of, np.array(exact) + drawn, strict=True))
        values = np.array([rows.get(name, np.zeros(len(seen))) for name in names])
        yield Scan(
            BEGIN_NS + round(stamped * 1e9), sensor.index, seen.astype(np.int64), seen.astype(np.int64),
            np.zeros(len(seen), np.bool_), values,
        )  # fmt: skip
