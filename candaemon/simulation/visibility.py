"""Which points of an actor a sensor sees, and which of them another actor hides.

An actor is a rectangle in its own axes (x along its length), or a point. A radar sees the sides that face it: an
end (front or rear), and of a flank the part next to that end, where wheels and corners reflect.

The first reflection lies on the side from which the observer is farther away: in the middle of an end (the rear of a
preceding vehicle, the front of an oncoming one) or of a car's flank; of a long vehicle's flank at the point nearest to
the observer, but not nearer to the end than the middle of a car's.
"""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Booleans, ComplexPlane, Floats, Integers
from candaemon.config.sensors import FieldOfView
from candaemon.simulation.scenario import Actor
from candaemon.simulation.scene import Pose, Scene, SceneState

_FLANK_REACH = 3.0
"""m of a flank that reflect, from the end that faces the sensor."""
_FLANK_MARGIN = 2.25
"""m from the end of a flank to its first reflection, half a car's length."""
_GRAZING = np.sin(np.radians(5.0))
"""Sine of the angle to a side below which its extent cannot be judged."""
_ALONG_SIDE = np.linspace(-0.8, 0.8, 5)
"""Where a side is tried, from its middle, in half its extent; it is seen where most of these points are."""
_USUAL = 2
"""Reflections of an actor that does not say how many it has."""
_CORNERS = np.array([1 + 1j, 1 - 1j, -1 - 1j, -1 + 1j])


def seen_from(instant: SceneState, eye: complex) -> ComplexPlane:
    """Return an observer's position (local axes, m) in each actor's own axes, shape (actors,)."""
    return np.asarray((eye - instant.actors.position) * np.exp(-1j * instant.actors.yaw))


def _along_flank(eye: ComplexPlane, half_length: Floats) -> Floats:
    """Return where along its length an actor's flank is seen, m from its middle."""
    reach = np.maximum(half_length - _FLANK_MARGIN, 0.0)
    return np.clip(eye.real, -reach, reach)


def _sees_end(eye: ComplexPlane, half_length: Floats, half_width: Floats) -> Booleans:
    """Return of which actors the observer sees an end rather than a flank."""
    return np.asarray(np.abs(eye.real) - half_length >= np.abs(eye.imag) - half_width)


class VisibleReflections:
    """The reflection points of all actors, numbered actor by actor.

    Attributes:
        actor: index of the actor each belongs to, shape (n,).
        order: number within its actor, from 0, shape (n,).
        reach: greatest range at which it is visible, m, shape (n,).

    """

    def __init__(self, scene: Scene) -> None:
        counts = [_reflections_of(actor) for actor in scene.actors]
        self.actor: Integers = np.repeat(np.arange(len(counts), dtype=np.int64), counts)
        self.order: Integers = np.array([k for count in counts for k in range(count)], dtype=np.int64)
        reach = np.array([actor.reflections_range for actor in scene.actors], dtype=np.float64)
        self.reach: Floats = np.where(self.order == 0, np.inf, reach[self.actor] / np.maximum(self.order, 1))
        self._half_length = scene.half_length
        self._half_width = scene.half_width
        self._side = np.where((self.order + 1) // 2 % 2 == 1, 0.6, -0.6)
        self._depth = np.minimum(0.6 * self.order, np.minimum(2 * scene.half_length[self.actor], _FLANK_REACH))

    def offsets(self, eye: ComplexPlane, drift: Floats) -> ComplexPlane:
        """Return where each reflection lies in its actor's own axes, m, shape (n,).

        Args:
            eye: the observer in each actor's own axes, m, shape (actors,).
            drift: displacement of each along its side, m, shape (n,).

        """
        length, width = self._half_length[self.actor], self._half_width[self.actor]
        at = eye[self.actor]
        faces_end, faces_flank = np.abs(at.real) > length, np.abs(at.imag) > width
        x_side, y_side = np.copysign(length, at.real), np.copysign(width, at.imag)
        first = self.order == 0
        on_end = np.where(first, _sees_end(at, length, width), faces_end & (~faces_flank | (self.order % 2 == 1)))
        across = np.clip(np.where(first, 0.0, self._side * width) + drift, -width, width)
        from_end = x_side - np.copysign(self._depth, at.real)
        beside = _along_flank(at, length) + np.where(
            first, 0.0, np.where(self.order % 2 == 1, self._depth, -self._depth)
        )
        along = np.where(faces_end & ~first, from_end, beside)
        along = np.clip(along + drift, -length, length)
        return np.where(on_end, x_side + 1j * across, along + 1j * y_side)


def _reflections_of(actor: Actor) -> int:
    """Return how many reflections an actor has; a point has one."""
    return (actor.reflections or _USUAL) if actor.size.length > 0.0 else 1


def sides_seen(scene: Scene, instant: SceneState, sensor: Pose, view: FieldOfView, *, occlusion: bool) -> Booleans:
    """Return which sides of each actor a sensor sees: front, left, rear and right, shape (actors, 4); a point has none.

    Args:
        scene: sizes of the actors.
        instant: poses of the actors.
        sensor: the sensor's pose.
        view: its field of view.
        occlusion: whether actors occlude one another.

    """
    half = np.stack([scene.half_length, scene.half_width, scene.half_length, scene.half_width], axis=1)
    normal = np.array([1, 1j, -1, -1j])
    middle = half * normal
    beside = np.roll(half, 1, axis=1) * normal * 1j
    line = seen_from(instant, sensor.position)[:, None] - middle
    faced = np.real(line * np.conj(normal)) > _GRAZING * np.abs(line)
    actor, side = np.nonzero(faced & (half > 0.0))
    tried = middle[actor, side][:, None] + np.multiply.outer(beside[actor, side], _ALONG_SIDE)
    owner = np.repeat(actor, len(_ALONG_SIDE))
    point = (instant.on_actors(owner, tried.ravel()).position - sensor.position) * np.exp(-1j * sensor.yaw)
    clear = in_view(point, view)
    if occlusion:
        clear &= ~hidden(scene, instant, sensor, point, owner)
    seen = np.zeros(faced.shape, dtype=bool)
    seen[actor, side] = np.count_nonzero(clear.reshape(tried.shape), axis=1) > len(_ALONG_SIDE) / 2
    return seen


def in_view(point: ComplexPlane, view: FieldOfView) -> Booleans:
    """Return which points (sensor axes, m, shape (n,)) lie in a field of view."""
    distance = np.abs(point)
    direction = np.abs(np.angle(point * np.exp(-1j * np.radians(view.yaw_deg))))
    near_enough = (distance >= view.min_range) & (distance <= view.range)
    return np.asarray(near_enough & (direction <= np.radians(view.azimuth_deg)))


def hidden(scene: Scene, instant: SceneState, sensor: Pose, point: ComplexPlane, owner: Integers) -> Booleans:
    """Return which points are occluded: those farther away than another actor's centre, within the angle it subtends.

    Args:
        scene: sizes of the actors; a point-like actor occludes nothing.
        instant: poses of the actors.
        sensor: the sensor's pose.
        point: in sensor axes, m, shape (n,).
        owner: index of the actor that each point belongs to, −1 for none, shape (n,).

    """
    solid = np.flatnonzero(scene.half_length > 0.0)
    if len(solid) == 0 or len(point) == 0:
        return np.zeros(len(point), dtype=bool)
    turn = np.exp(-1j * sensor.yaw)
    centre = (instant.actors.position[solid] - sensor.position) * turn
    box = np.multiply.outer(scene.half_length[solid], _CORNERS.real) + 1j * np.multiply.outer(
        scene.half_width[solid], _CORNERS.imag
    )
    corner = box * (np.exp(1j * instant.actors.yaw[solid]) * turn)[:, None] + centre[:, None]
    spread = np.angle(corner * np.conj(centre)[:, None])
    aside = np.angle(point[:, None] * np.conj(centre))
    behind = np.abs(point)[:, None] > np.abs(centre)
    inside = (aside > spread.min(axis=1)) & (aside < spread.max(axis=1))
    foreign = owner[:, None] != solid
    return np.asarray((behind & inside & foreign).any(axis=1))
