"""True motion, in closed form at any instant.

A vector in the plane is one complex number, a rotation a multiplication by e^(i·yaw).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from candaemon.arrays import ComplexPlane, Floats
from candaemon.simulation.scenario import Segment

_SLOW = 0.1
"""Speed below which the direction of a velocity is no measure of the heading, m/s."""


@dataclass(frozen=True, slots=True)
class TrueMotion:
    """Motion at n instants, over ground in local axes (real part east, imaginary part north).

    Attributes:
        position: m.
        velocity: m/s.
        acceleration: m/s².
        yaw: direction of the vehicle's x axis, rad, counter-clockwise from east.
        yaw_rate: rad/s, positive to the left.

    """

    position: ComplexPlane
    velocity: ComplexPlane
    acceleration: ComplexPlane
    yaw: Floats
    yaw_rate: Floats


class MotionPiece(Protocol):
    """A part of a trajectory with a closed form."""

    def at(self, elapsed: Floats) -> TrueMotion:
        """Return the motion at seconds since the piece's start, shape (n,)."""


def _turning_integrals(turn: Floats) -> tuple[ComplexPlane, ComplexPlane]:
    """Return ∫₀¹ e^(i·turn·s) ds and ∫₀¹ s·e^(i·turn·s) ds; by power series where the closed form loses precision."""
    z = 1j * turn
    small = np.abs(turn) < 0.02
    safe = np.where(small, 1.0, z)
    zeroth = (np.exp(z) - 1) / safe
    first = (np.exp(z) - zeroth) / safe
    zeroth_series = 1 + z / 2 * (1 + z / 3 * (1 + z / 4 * (1 + z / 5)))
    first_series = 1 / 2 + z / 3 + z**2 / 8 + z**3 / 30 + z**4 / 144
    return np.where(small, zeroth_series, zeroth), np.where(small, first_series, first)


@dataclass(frozen=True, slots=True)
class TurningMotion:
    """Constant turn rate and constant acceleration along the heading."""

    position: complex
    yaw: float
    speed: float
    acceleration: float
    yaw_rate: float

    def at(self, elapsed: Floats) -> TrueMotion:
        """Return the motion at seconds since the piece's start, shape (n,)."""
        zeroth, first = _turning_integrals(self.yaw_rate * elapsed)
        start = cmath.exp(1j * self.yaw)
        path = elapsed * (self.speed * zeroth + self.acceleration * elapsed * first)
        yaw = self.yaw + self.yaw_rate * elapsed
        heading = np.exp(1j * yaw)
        speed = self.speed + self.acceleration * elapsed
        return TrueMotion(
            self.position + start * path,
            np.asarray(speed * heading),
            np.asarray((self.acceleration + 1j * self.yaw_rate * speed) * heading),
            yaw,
            np.full_like(elapsed, self.yaw_rate),
        )


@dataclass(frozen=True, slots=True)
class StraightMotion:
    """Constant acceleration in fixed axes; the heading is the direction of the velocity, or the opposite backwards."""

    position: complex
    velocity: complex
    acceleration: complex
    yaw: float
    backwards: bool = False

    def at(self, elapsed: Floats) -> TrueMotion:
        """Return the motion at seconds since the piece's start, shape (n,)."""
        velocity = self.velocity + self.acceleration * elapsed
        acceleration = np.full(elapsed.shape, self.acceleration, dtype=np.complex128)
        moving = np.abs(velocity) > _SLOW
        squared = np.where(moving, np.abs(velocity) ** 2, 1.0)
        return TrueMotion(
            self.position + elapsed * (self.velocity + self.acceleration * elapsed / 2),
            np.asarray(velocity, dtype=np.complex128),
            acceleration,
            np.where(moving, np.angle(-velocity if self.backwards else velocity), self.yaw),
            np.where(moving, np.imag(np.conj(velocity) * acceleration) / squared, 0.0),
        )


@dataclass(frozen=True, slots=True)
class LaneChangeMotion:
    """A lane change: constant acceleration along the lane, a fifth-order polynomial across it."""

    position: complex
    yaw: float
    speed: float
    acceleration: float
    offset: float
    duration: float

    def at(self, elapsed: Floats) -> TrueMotion:
        """Return the motion at seconds since the piece's start, shape (n,)."""
        s = np.clip(elapsed / self.duration, 0.0, 1.0)
        across = self.offset * s**3 * (10 - 15 * s + 6 * s**2)
        across_rate = self.offset / self.duration * 30 * s**2 * (1 - s) ** 2
        across_acceleration = self.offset / self.duration**2 * 60 * s * (1 - s) * (1 - 2 * s)
        lane = cmath.exp(1j * self.yaw)
        speed = self.speed + self.acceleration * elapsed
        velocity = speed + 1j * across_rate
        acceleration = self.acceleration + 1j * across_acceleration
        moving = np.abs(velocity) > _SLOW
        squared = np.where(moving, np.abs(velocity) ** 2, 1.0)
        path = elapsed * (self.speed + self.acceleration * elapsed / 2) + 1j * across
        return TrueMotion(
            self.position + lane * path,
            lane * velocity,
            np.asarray(lane * acceleration),
            self.yaw + np.where(moving, np.angle(velocity * np.where(speed < 0.0, -1.0, 1.0)), 0.0),
            np.where(moving, np.imag(np.conj(velocity) * acceleration) / squared, 0.0),
        )


class Trajectory:
    """Motion over the whole scenario: a sequence of pieces in closed form, each valid until the next one starts.

    Before the first piece's start, the first piece is continued backwards.
    """

    __slots__ = ("_pieces", "_starts")

    def __init__(self, starts: Sequence[float], pieces: Sequence[MotionPiece]) -> None:
        self._starts = np.asarray(starts, dtype=np.float64)
        self._pieces = tuple(pieces)

    def at(self, times: Floats) -> TrueMotion:
        """Return the motion at seconds since the scenario's start, shape (n,) in any order."""
        index = np.maximum(np.searchsorted(self._starts, times, side="right") - 1, 0)
        used = np.unique(index)
        if len(used) == 1:
            only = int(used[0])
            return self._pieces[only].at(times - self._starts[only])
        position, velocity, acceleration = (np.empty(times.shape, dtype=np.complex128) for _ in range(3))
        yaw, yaw_rate = np.empty(times.shape), np.empty(times.shape)
        for k in used:
            here = index == k
            motion = self._pieces[k].at(times[here] - self._starts[k])
            position[here], velocity[here], acceleration[here] = motion.position, motion.velocity, motion.acceleration
            yaw[here], yaw_rate[here] = motion.yaw, motion.yaw_rate
        return TrueMotion(position, velocity, acceleration, yaw, yaw_rate)


@dataclass(slots=True)
class _Cursor:
    """End of the trajectory built so far."""

    time: float
    position: complex
    velocity: complex
    yaw: float

    @property
    def speed(self) -> float:
        """Speed along the heading, below 0 backwards; a rounding residue after a stop counts as 0."""
        speed = abs(self.velocity)
        backwards = (self.velocity * cmath.exp(-1j * self.yaw)).real < -0.5 * speed
        return 0.0 if speed <= 1e-9 else -speed if backwards else speed

    def advance(self, piece: MotionPiece, duration: float) -> None:
        """Move to the piece's end."""
        end = piece.at(np.array([duration]))
        self.time += duration
        self.position, self.velocity, self.yaw = complex(end.position[0]), complex(end.velocity[0]), float(end.yaw[0])


def _duration(segment: Segment, cursor: _Cursor) -> float:
    """Return how long a segment lasts, infinite where it has no end."""
    if segment.duration is not None:
        return segment.duration
    if segment.until is not None:
        return max(segment.until - cursor.time, 0.0)
    if segment.lane_change is not None:
        return segment.lane_change.duration
    if segment.speed is not None and segment.acceleration is not None:
        return abs(segment.speed - cursor.speed) / max(abs(segment.acceleration), 1e-6)
    return math.inf


def _acceleration(segment: Segment, cursor: _Cursor, duration: float) -> float:
    """Return the segment's acceleration along the heading, towards its target speed where it has one."""
    if segment.speed is not None and duration > 0.0:
        return (segment.speed - cursor.speed) / duration
    return segment.acceleration or 0.0


def _stop(segment: Segment, speed: float, acceleration: float) -> float:
    """Return after how many s a vehicle has braked to 0 and stands, infinite where it does not."""
    if segment.speed is not None and (segment.speed < 0.0 or speed < 0.0):
        return math.inf  # it comes to that speed, and through 0 where that lies between
    brakes = acceleration < 0.0 if speed >= 0.0 else acceleration > 0.0
    return -speed / acceleration if brakes else math.inf


def _pieces_of(segment: Segment, cursor: _Cursor, duration: float, axes_yaw: float) -> list[tuple[MotionPiece, float]]:
    """Return a segment's pieces and the duration of each."""
    if segment.by_axes:
        acceleration = complex(segment.ax or 0.0, segment.ay or 0.0) * cmath.exp(1j * axes_yaw)
        backwards = cursor.speed < 0.0
        return [(StraightMotion(cursor.position, cursor.velocity, acceleration, cursor.yaw, backwards), duration)]
    speed, acceleration = cursor.speed, _acceleration(segment, cursor, duration)
    stop = _stop(segment, speed, acceleration)
    moving = min(duration, stop)
    piece: MotionPiece
    if segment.lane_change is not None:
        change = segment.lane_change
        piece = LaneChangeMotion(cursor.position, cursor.yaw, speed, acceleration, change.offset, change.duration)
    else:
        piece = TurningMotion(cursor.position, cursor.yaw, speed, acceleration, math.radians(segment.yaw_rate_deg))
    if stop >= duration:
        return [(piece, duration)]
    end = piece.at(np.array([moving]))
    standing = TurningMotion(complex(end.position[0]), float(end.yaw[0]), 0.0, 0.0, 0.0)
    return [(piece, moving), (standing, duration - moving)]


def trajectory(
    position: complex, velocity: complex, yaw: float, segments: Sequence[Segment], *, axes_yaw: float
) -> Trajectory:
    """Return the trajectory of consecutive segments.

    Args:
        position: at time 0, local axes, m.
        velocity: at time 0, local axes, m/s.
        yaw: heading at time 0, rad, counter-clockwise from east.
        segments: in order; after the last one velocity and heading stay constant.
        axes_yaw: direction of the scenario's x axis in the local frame, rad, counter-clockwise from east.

    """
    cursor = _Cursor(0.0, position, velocity, yaw)
    starts: list[float] = []
    pieces: list[MotionPiece] = []
    for segment in segments:
        for piece, duration in _pieces_of(segment, cursor, _duration(segment, cursor), axes_yaw):
            if duration <= 0.0:
                continue
            starts.append(cursor.time)
            pieces.append(piece)
            if math.isinf(duration):
                return Trajectory(starts, pieces)
            cursor.advance(piece, duration)
    starts.append(cursor.time)
    pieces.append(StraightMotion(cursor.position, cursor.velocity, 0j, cursor.yaw, cursor.speed < 0.0))
    return Trajectory(starts, pieces)
