"""Obstacles as the quantities that an output's signals ask for, in the axes of its mount.

Plane vectors are complex numbers, x + iy: a turn is a product.
"""

from __future__ import annotations

from cmath import exp
from collections.abc import Callable
from dataclasses import dataclass
from math import radians
from typing import Final, Generic, TypeVar

import numpy as np

from candaemon.arrays import ComplexPlane, Floats, Indices
from candaemon.config.sensors import Mount
from candaemon.ego.georeference import Georeference
from candaemon.ego.pose import EgoPose
from candaemon.tracking.obstacles import Obstacles

Value = TypeVar("Value")

ACCELERATION_TIME: Final = 0.3
"""s, time constant of the ego acceleration, which is derived from the velocities of successive cycles."""
LONGEST_GAP: Final = 1.0
"""s between two cycles, over which no acceleration is derived."""
NEAREST: Final = 1e-3
"""m, least distance that a direction is derived from."""


@dataclass(slots=True)
class EgoAccelerationState:
    """What the ego acceleration is derived from, axes east + i north.

    Attributes:
        time_ns: of the latest cycle.
        velocity: in it, m/s.
        acceleration: smoothed, m/s².
    """

    time_ns: int = 0
    velocity: complex = 0j
    acceleration: complex = 0j


class EgoAcceleration:
    """Acceleration of the vehicle over ground, from its velocity in successive cycles.

    Attributes:
        state: what it remembers.
    """

    def __init__(self) -> None:
        self.state = EgoAccelerationState()

    def update(self, pose: EgoPose) -> complex:
        """Take a cycle's pose; return the acceleration in vehicle axes, m/s²; 0 while it is not known."""
        state, velocity = self.state, complex(pose.ve, pose.vn)
        dt = (pose.time_ns - state.time_ns) * 1e-9
        if 0.0 < dt <= LONGEST_GAP:
            share = dt / (dt + ACCELERATION_TIME)
            state.acceleration += share * ((velocity - state.velocity) / dt - state.acceleration)
        elif dt:
            state.acceleration = 0j
        state.time_ns, state.velocity = pose.time_ns, velocity
        return state.acceleration * exp(-1j * pose.heading)


class _Once(Generic[Value]):
    """A property worked out on first use; `functools.cached_property` takes a lock for it until Python 3.12."""

    def __init__(self, find: Callable[[MountView], Value]) -> None:
        self._find, self._name = find, find.__name__
        self.__doc__ = find.__doc__

    def __get__(self, view: MountView, owner: type[MountView]) -> Value:
        value = view.__dict__[self._name] = self._find(view)
        return value


class MountView:
    """Obstacles of one cycle as a sensor at the mount would see them.

    Args:
        obstacles: of the cycle.
        rows: those to show, (n,) or a slice.
        mount: of the output's axes in vehicle axes.
        pose: ego pose at the obstacles' time.
        acceleration: of the vehicle over ground, in vehicle axes, m/s².
        georeference: of the local frame on earth; None: not known.
    """

    def __init__(
        self,
        obstacles: Obstacles,
        rows: Indices | slice,
        mount: Mount,
        pose: EgoPose,
        acceleration: complex = 0j,
        georeference: Georeference | None = None,
    ) -> None:
        self._obstacles, self._rows = obstacles, rows
        self._mount = complex(mount.x, mount.y)
        self._turn = exp(-1j * radians(mount.yaw_deg))
        self._pose, self._acceleration, self._georeference = pose, acceleration, georeference

    def quantity(self, name: str, *, polar: bool) -> Floats:
        """Return a quantity of each obstacle (n,), SI, as `candaemon.config.output.Quantity` names it.

        `vx`, `vy`, `ax` and `ay` are over ground, turned into the mount's axes. `rel_vx` and `rel_vy` are the rates of
        x and y in the mount's own, turning axes. All relative ones are to the mount, its share of the vehicle's
        turning included.

        Args:
            name: the quantity.
            polar: `rel_ax` is along the line of sight, not along x.
        """
        match name:
            case "x":
                return self.position.real
            case "y":
                return self.position.imag
            case "vx":
                return self.velocity.real
            case "vy":
                return self.velocity.imag
            case "ax":
                return self.acceleration.real
            case "ay":
                return self.acceleration.imag
            case "range":
                return self.distance
            case "azimuth":
                return np.arctan2(self.position.imag, self.position.real)
            case "range_rate":
                return self._along(self.relative_velocity)
            case "rel_vx":
                return self.rate.real
            case "rel_vy":
                return self.rate.imag
            case "rel_ax":
                relative = self.acceleration - self._acceleration * self._turn
                return self._along(relative) if polar else relative.real
            case "sx" | "sy" | "svx" | "svy":
                return self._deviation(name)
            case "latitude":
                return self.earth[0]
            case "longitude":
                return self.earth[1]
            case "state":
                return self._take("state") + 1  # 0 on the wire is an empty slot
            case _:
                return self._take(name)

    @_Once
    def position(self) -> ComplexPlane:
        """Positions in the mount's axes, m."""
        position = self._plane("x", "y")
        position -= self._mount
        return self._turned(position)

    @_Once
    def distance(self) -> Floats:
        """Distances from the mount, m."""
        return np.abs(self.position)

    @_Once
    def velocity(self) -> ComplexPlane:
        """Velocities over ground in the mount's axes, m/s."""
        return self._turned(self._plane("vx", "vy"))

    @_Once
    def acceleration(self) -> ComplexPlane:
        """Accelerations over ground in the mount's axes, m/s²."""
        return self._turned(self._plane("ax", "ay"))

    @_Once
    def relative_velocity(self) -> ComplexPlane:
        """Velocities less the mount's own, m/s."""
        mount = complex(*self._pose.velocity_in_vehicle_axes()) + 1j * self._pose.yaw_rate * self._mount
        return self.velocity - mount * self._turn

    @_Once
    def rate(self) -> ComplexPlane:
        """Rates of the positions in the mount's axes, which turn with the vehicle, m/s."""
        return self.relative_velocity - 1j * self._pose.yaw_rate * self.position

    @_Once
    def earth(self) -> tuple[Floats, Floats]:
        """Latitudes and longitudes, rad; NaN while the local frame's place is not known."""
        east, north = self._take("east"), self._take("north")
        if self._georeference is None:
            return np.full_like(east, np.nan), np.full_like(north, np.nan)
        return self._georeference.to_earth(east, north)

    def _take(self, name: str) -> Floats:
        column: Floats = getattr(self._obstacles, name)[self._rows]
        return column

    def _plane(self, x: str, y: str) -> ComplexPlane:
        real, imaginary = self._take(x), self._take(y)
        plane = np.empty(len(real), np.complex128)
        plane.real, plane.imag = real, imaginary
        return plane

    def _turned(self, vector: ComplexPlane) -> ComplexPlane:
        """Turn from vehicle axes into the mount's."""
        return vector if self._turn == 1 else vector * self._turn

    def _along(self, vector: ComplexPlane) -> Floats:
        """Return the component away along the line of sight."""
        product: ComplexPlane = np.conj(self.position) * vector
        return product.real / np.maximum(self.distance, NEAREST)

    def _deviation(self, name: str) -> Floats:
        """Return a standard deviation along one of the mount's axes, x and y assumed uncorrelated."""
        kind, axis = name[:-1], name[-1]
        if self._turn == 1:
            return self._take(name)
        c, s = (self._turn.real, self._turn.imag) if axis == "x" else (self._turn.imag, self._turn.real)
        return np.hypot(c * self._take(f"{kind}x"), s * self._take(f"{kind}y"))
