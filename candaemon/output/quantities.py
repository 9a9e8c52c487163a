"""Obstacles as the quantities of an output's signals, in the axes of its mount.

Plane vectors are complex numbers, x + iy: a rotation is a multiplication.
"""

from __future__ import annotations

from cmath import exp, phase
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import radians
from operator import methodcaller
from typing import Final, Generic, TypeVar

import numpy as np

from candaemon.arrays import ComplexPlane, Floats, Indices
from candaemon.config.sensors import Mount
from candaemon.ego.georeference import Georeference
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.frames.times import LONG_AGO_NS
from candaemon.tracking.obstacles import Obstacles

Value = TypeVar("Value")

ACCELERATION_TIME: Final = 0.3
"""s, time constant of the ego acceleration, which is derived from the velocities of successive cycles."""
LONGEST_GAP: Final = 1.0
"""s between two cycles; no acceleration is derived over a longer gap."""
LEAST_SPEED: Final = 1.0
"""m/s, below which the own path bends as at this speed."""
NEAREST: Final = 1e-3
"""m, least distance from which a direction is derived."""


@dataclass(slots=True)
class EgoAccelerationState:
    """State of the derivation of the ego acceleration, axes east + i·north.

    Attributes:
        time_ns: of the latest cycle in which ego motion was known; `LONG_AGO_NS` before the first.
        velocity: in that cycle, m/s.
        acceleration: smoothed, m/s².
    """

    time_ns: int = LONG_AGO_NS
    velocity: complex = 0j
    acceleration: complex = 0j


class EgoAcceleration:
    """Acceleration of the vehicle over ground, from its velocity in successive cycles.

    Attributes:
        state: of the previous cycle.
    """

    def __init__(self) -> None:
        self.state = EgoAccelerationState()

    def update(self, pose: EgoPose) -> complex:
        """Update with a cycle's pose; return the acceleration in vehicle axes, m/s²; 0 while it is not known."""
        state, velocity = self.state, complex(pose.ve, pose.vn)
        if pose.status is EgoStatus.LOST:
            state.time_ns, state.acceleration = LONG_AGO_NS, 0j
            return 0j
        dt = (pose.time_ns - state.time_ns) * 1e-9
        if 0.0 < dt <= LONGEST_GAP:
            share = dt / (dt + ACCELERATION_TIME)
            state.acceleration += share * ((velocity - state.velocity) / dt - state.acceleration)
        elif dt:
            state.acceleration = 0j
        state.time_ns, state.velocity = pose.time_ns, velocity
        return state.acceleration * exp(-1j * pose.heading)


class _CachedProperty(Generic[Value]):
    """A property computed on first use; `functools.cached_property` acquires a lock for it until Python 3.12."""

    def __init__(self, find: Callable[[MountView], Value]) -> None:
        self._find, self._name = find, find.__name__
        self.__doc__ = find.__doc__

    def __get__(self, view: MountView, owner: type[MountView]) -> Value:
        value = view.__dict__[self._name] = self._find(view)
        return value


@dataclass(slots=True)  # made each cycle, and never changed: freezing takes four times as long as filling
class SeenCycle:
    """Obstacles of one cycle, and the vehicle then.

    Attributes:
        obstacles: of the cycle.
        rows: the obstacles to include, (n,) or a slice.
        pose: ego pose at the obstacles' time.
        acceleration: of the vehicle over ground, in vehicle axes, m/s².
        georeference: of the local frame on earth; None: not known.
    """

    obstacles: Obstacles
    rows: Indices | slice
    pose: EgoPose
    acceleration: complex = 0j
    georeference: Georeference | None = None


class MountView:
    """Obstacles of one or more cycles, one after the other, as a sensor at the mount would see them.

    Args:
        cycles: the obstacles.
        mount: of the output's axes in vehicle axes.
        half_width: half the width of the own path, m.
    """

    def __init__(self, cycles: Sequence[SeenCycle], mount: Mount, half_width: float = 1.8) -> None:
        self._half_width = half_width
        self._cycles = cycles
        self._mount = complex(mount.x, mount.y)
        self._rotation = exp(-1j * radians(mount.yaw_deg))

    def quantity(self, name: str, *, polar: bool) -> Floats:
        """Return a quantity of each obstacle (n,), SI, as `candaemon.config.output.Quantity` names it.

        `vx`, `vy`, `ax` and `ay` are over ground, rotated into the mount's axes. `rel_vx` and `rel_vy` are the rates of
        x and y in the mount's rotating axes. Relative quantities refer to the motion of the mount, which includes yaw
        rate × lever arm.

        Args:
            name: the quantity.
            polar: `rel_ax` is along the line of sight, not along x.
        """
        return finder(name, polar=polar)(self)

    @_CachedProperty
    def position(self) -> ComplexPlane:
        """Positions in the mount's axes, m."""
        position = self._plane("x", "y")
        position -= self._mount
        return self._rotated(position)

    @_CachedProperty
    def center(self) -> ComplexPlane:
        """Centres of the bodies' boxes in the mount's axes, m."""
        center = self._plane("center_x", "center_y")
        center -= self._mount
        return self._rotated(center)

    @_CachedProperty
    def distance(self) -> Floats:
        """Distances from the mount, m."""
        return np.abs(self.position)

    @_CachedProperty
    def velocity(self) -> ComplexPlane:
        """Velocities over ground in the mount's axes, m/s."""
        return self._rotated(self._plane("vx", "vy"))

    @_CachedProperty
    def acceleration(self) -> ComplexPlane:
        """Accelerations over ground in the mount's axes, m/s²."""
        return self._rotated(self._plane("ax", "ay"))

    @_CachedProperty
    def relative_acceleration(self) -> ComplexPlane:
        """Accelerations relative to the vehicle in the mount's axes, m/s²."""
        return self.acceleration - self._of_each([each.acceleration * self._rotation for each in self._cycles])

    @_CachedProperty
    def relative_velocity(self) -> ComplexPlane:
        """Velocities relative to the mount, m/s."""
        own = [complex(*each.pose.velocity_in_vehicle_axes()) for each in self._cycles]
        turning = [1j * each.pose.yaw_rate * self._mount for each in self._cycles]
        return self.velocity - self._of_each([(a + b) * self._rotation for a, b in zip(own, turning, strict=True)])

    @_CachedProperty
    def rate(self) -> ComplexPlane:
        """Rates of the positions in the mount's axes, which rotate with the vehicle, m/s."""
        return (
            self.relative_velocity - self._of_each([1j * each.pose.yaw_rate for each in self._cycles]) * self.position
        )

    @_CachedProperty
    def earth(self) -> tuple[Floats, Floats]:
        """Latitudes and longitudes, rad; NaN without a georeference."""
        found = [_on_earth(each) for each in self._cycles]
        return np.concatenate([latitude for latitude, _ in found]), np.concatenate(
            [longitude for _, longitude in found]
        )

    def heading(self) -> Floats:
        """Return the headings in the mount's axes, −π to π rad."""
        heading = self.column("heading")
        if self._rotation == 1:
            return heading
        return np.asarray(np.remainder(heading - phase(self._rotation.conjugate()) + np.pi, 2 * np.pi) - np.pi)

    def lead(self) -> Floats:
        """Return 1 for the obstacle that is the next one in the own path, which bends as the vehicle turns; else 0."""
        return np.concatenate([_lead(each, self._half_width) for each in self._cycles])

    def time_to_collision(self) -> Floats:
        """Return the time until an obstacle in the own path is reached at the present speeds, s; NaN if it never is."""
        position, rate = self.position, self.relative_velocity
        with np.errstate(divide="ignore", invalid="ignore"):
            time = np.where((rate.real < 0.0) & (position.real > 0.0), -position.real / rate.real, np.nan)
            beside = np.abs(position.imag + rate.imag * time)
        reach = self._half_width + 0.5 * np.nan_to_num(self.column("width"))
        return np.where(beside <= reach, time, np.nan)

    def column(self, name: str) -> Floats:
        """Return a column of the obstacles as it is."""
        columns = [_column(each, name) for each in self._cycles]
        return columns[0] if len(columns) == 1 else np.concatenate(columns)

    @_CachedProperty
    def _counts(self) -> Indices:
        """How many obstacles each cycle has."""
        return np.array([len(_column(each, "x")) for each in self._cycles])

    def _of_each(self, values: list[complex]) -> ComplexPlane:
        """Return a value of each cycle for each of its obstacles."""
        return np.repeat(np.array(values, np.complex128), self._counts)

    def _plane(self, x: str, y: str) -> ComplexPlane:
        real, imaginary = self.column(x), self.column(y)
        plane = np.empty(len(real), np.complex128)
        plane.real, plane.imag = real, imaginary
        return plane

    def _rotated(self, vector: ComplexPlane) -> ComplexPlane:
        """Rotate from vehicle axes into the mount's."""
        return vector if self._rotation == 1 else vector * self._rotation

    def along(self, vector: ComplexPlane) -> Floats:
        """Return the component along the line of sight, positive away."""
        product: ComplexPlane = np.conj(self.position) * vector
        return product.real / np.maximum(self.distance, NEAREST)

    def deviation(self, name: str) -> Floats:
        """Return a standard deviation along one of the mount's axes, x and y assumed uncorrelated."""
        kind, axis = name[:-1], name[-1]
        if self._rotation == 1:
            return self.column(name)
        c, s = (self._rotation.real, self._rotation.imag) if axis == "x" else (self._rotation.imag, self._rotation.real)
        return np.hypot(c * self.column(f"{kind}x"), s * self.column(f"{kind}y"))


def _column(cycle: SeenCycle, name: str) -> Floats:
    column: Floats = getattr(cycle.obstacles, name)[cycle.rows]
    return column


def _on_earth(cycle: SeenCycle) -> tuple[Floats, Floats]:
    east, north = _column(cycle, "east"), _column(cycle, "north")
    if cycle.georeference is None:
        return np.full_like(east, np.nan), np.full_like(north, np.nan)
    return cycle.georeference.to_earth(east, north)


def _lead(cycle: SeenCycle, half_width: float) -> Floats:
    speed = abs(complex(*cycle.pose.velocity_in_vehicle_axes()))
    curvature = cycle.pose.yaw_rate / max(speed, LEAST_SPEED)
    x, y = _column(cycle, "x"), _column(cycle, "y")
    in_path = (x > 0.0) & (np.abs(y - 0.5 * curvature * x * x) <= half_width)
    lead = np.zeros(len(x))
    if in_path.any():
        lead[np.where(in_path, x, np.inf).argmin()] = 1.0
    return lead


def finder(name: str, *, polar: bool) -> Callable[[MountView], Floats]:
    """Return what finds a quantity in a view, to be looked up once; arguments as `MountView.quantity`."""
    if name == "rel_ax":
        return _relative_acceleration_along if polar else _relative_acceleration
    return _FINDERS.get(name) or methodcaller("column", name)


def _relative_acceleration(view: MountView) -> Floats:
    return view.relative_acceleration.real


def _relative_acceleration_along(view: MountView) -> Floats:
    return view.along(view.relative_acceleration)


_FINDERS: Final[Mapping[str, Callable[[MountView], Floats]]] = {
    "x": lambda view: view.position.real,
    "y": lambda view: view.position.imag,
    "vx": lambda view: view.velocity.real,
    "vy": lambda view: view.velocity.imag,
    "ax": lambda view: view.acceleration.real,
    "ay": lambda view: view.acceleration.imag,
    "range": lambda view: view.distance,
    "azimuth": lambda view: np.arctan2(view.position.imag, view.position.real),
    "range_rate": lambda view: view.along(view.relative_velocity),
    "rel_vx": lambda view: view.rate.real,
    "rel_vy": lambda view: view.rate.imag,
    "sx": methodcaller("deviation", "sx"),
    "sy": methodcaller("deviation", "sy"),
    "svx": methodcaller("deviation", "svx"),
    "svy": methodcaller("deviation", "svy"),
    "latitude": lambda view: view.earth[0],
    "longitude": lambda view: view.earth[1],
    "heading": MountView.heading,
    "center_x": lambda view: view.center.real,
    "center_y": lambda view: view.center.imag,
    "center_dx": lambda view: view.center.real - view.position.real,
    "center_dy": lambda view: view.center.imag - view.position.imag,
    "class": methodcaller("column", "kind"),
    "class_likelihood": methodcaller("column", "kind_likelihood"),
    "lead": MountView.lead,
    "time_to_collision": MountView.time_to_collision,
    "state": lambda view: view.column("state") + 1,  # 0 on the wire is an empty slot
}
"""Those that are not columns of the obstacles as they are."""
