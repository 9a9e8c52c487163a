"""Sensor model: visible reflections, missed detections, noise and clutter, as quantities in sensor axes."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from itertools import cycle

import numpy as np

from candaemon.arrays import Booleans, ComplexPlane, Floats, Indices
from candaemon.config.sensors import SensorSettings
from candaemon.simulation.ghosts import Ghosts
from candaemon.simulation.lfm_fsk import LfmFskReceiver
from candaemon.simulation.living_reflections import LivingReflections
from candaemon.simulation.random_streams import stream
from candaemon.simulation.reflection_errors import POSITIONS, ReflectionErrors, ScanErrors
from candaemon.simulation.scenario import MeasurementEffects
from candaemon.simulation.scene import Points, Pose, Scene, SceneState
from candaemon.simulation.visibility import VisibleReflections, hidden, in_view, seen_from

NOISY = ("x", "y", "range", "azimuth", "range_rate", "vx", "vy", "ax")
"""Quantities with measurement noise."""
SIZES = ("width", "length")
QUANTITIES = (*NOISY, *SIZES, "score", "heading")
"""Quantities an object can have, as `ObjectSignals` names them; no noise is drawn for the last."""

FALSE = -1
"""Owner of a false object."""

_DRIFT_TIME = 2.0
"""s, correlation time of a fixed reflection's movement along its actor's outline."""
_CLUTTER_SPEED = 30.0
"""m/s, bound of a false object's range rate."""
_GHOST_SCORE = 0.6
_STATIONARY_OFFSET, _CLUTTER_OFFSET = 60.0, 30.0
"""m added to the distance of stationary and false objects, which lowers their priority when slots run short."""


@dataclass(frozen=True, slots=True)
class RelativeMotion:
    """Motion of n points relative to a sensor, in its axes, m, m/s, m/s²; velocity as the sensor's `rates` says."""

    position: ComplexPlane
    velocity: ComplexPlane
    acceleration: ComplexPlane

    def take(self, rows: Indices) -> RelativeMotion:
        """Return the motion of some of the points."""
        return RelativeMotion(self.position[rows], self.velocity[rows], self.acceleration[rows])

    def times(self, factor: float) -> RelativeMotion:
        """Return the motion of points at a multiple of the distance, in the same direction."""
        return RelativeMotion(factor * self.position, factor * self.velocity, factor * self.acceleration)

    def joined(self, other: RelativeMotion) -> RelativeMotion:
        """Return the motion of these points and others."""
        pairs = ((getattr(self, each.name), getattr(other, each.name)) for each in fields(RelativeMotion))
        return RelativeMotion(*(np.concatenate(pair) for pair in pairs))

    def quantity(self, name: str) -> Floats:
        """Return a motion quantity of each point, shape (n,), SI units, positive to the left and away."""
        z = self.position
        match name:
            case "x":
                return z.real
            case "y":
                return z.imag
            case "range":
                return np.abs(z)
            case "azimuth":
                return np.angle(z)
            case "range_rate":
                # a rotation of the axes changes the velocity only across the line of sight
                return np.real(np.conj(z) * self.velocity) / np.maximum(np.abs(z), 1e-9)
            case "vx":
                return self.velocity.real
            case "vy":
                return self.velocity.imag
            case _:
                raise KeyError(name)


@dataclass(frozen=True, slots=True)
class FalseObjects:
    """False objects of one scan: identity (n,), quantities (quantities, n), place in sensor axes, m (n,)."""

    key: Indices
    values: Floats
    place: ComplexPlane


def relative(points: Points, sensor: Pose, settings: SensorSettings) -> RelativeMotion:
    """Return the motion of points in a sensor's axes.

    With `rates` `of_position`, velocities are time derivatives of the coordinates in the rotating axes; otherwise the
    rotation is left out. Both are relative to the sensor itself, whose velocity includes yaw rate × lever arm.
    """
    turn = np.exp(-1j * sensor.yaw)
    position = (points.position - sensor.position) * turn
    velocity = (points.velocity - sensor.velocity) * turn
    acceleration = (points.acceleration - sensor.acceleration) * turn
    if settings.rates == "of_position":
        velocity = velocity - 1j * sensor.yaw_rate * position
    return RelativeMotion(position, velocity, acceleration)


def _acceleration(motion: RelativeMotion, polar: bool) -> Floats:
    """Return the acceleration along the line of sight (polar sensors) or along x."""
    z = motion.position
    if not polar:
        return motion.acceleration.real
    return np.real(np.conj(z) * motion.acceleration) / np.maximum(np.abs(z), 1e-9)


@dataclass(frozen=True, slots=True)
class SimulatedDetections:
    """The detections of one scan.

    Attributes:
        key: identity of each detected object, constant over the scans, shape (n,).
        values: quantities as `SensorModel.quantities` lists them, shape (quantities, n), SI, sensor axes.
        urgency: m; the objects with the lowest are served first when slots run short, shape (n,).
        detectable: identities of all objects that could have been detected, or are still believed to be there.
        owner: 0-based index of each one's actor, actors + index of the stationary object, or `FALSE`, shape (n,).
        place: position in sensor axes without noise, m, shape (n,).

    """

    key: Indices
    values: Floats
    urgency: Floats
    detectable: frozenset[int]
    owner: Indices
    place: ComplexPlane


class SensorModel:
    """One sensor that observes a scene, scan by scan.

    Args:
        scene: the truth.
        settings: of the sensor: mount, field of view, signals, noise.
        measurement: the scenario's measurement effects.
        seed: of the simulation.
        source: the sensor's index.

    Attributes:
        quantities: names of the rows of `SimulatedDetections.values`: those for which the sensor has a signal.

    """

    def __init__(
        self, scene: Scene, settings: SensorSettings, measurement: MeasurementEffects, *, seed: int, source: int
    ) -> None:
        settings = turned(settings, measurement.turned_deg)
        self._scene, self._settings, self._measurement = scene, settings, measurement
        self._looks = cycle(settings.views.values())
        self._view = settings.field_of_view
        self._own_velocity = 0j
        traffic, step = measurement.traffic, settings.cycle_time
        self._living: LivingReflections | None = None
        if traffic is not None:
            self._living = LivingReflections(scene, traffic.reflections, step, stream(seed, source, "reflections"))
        self._fixed = VisibleReflections(scene)
        self._reflections = self._living or self._fixed
        self.quantities = tuple(name for name in QUANTITIES if getattr(settings.signals, name) is not None)
        self._noise = np.array(
            [[_deviation(name, settings, measurement)] for name in self.quantities if name != "heading"]
        )
        self._detection = stream(seed, source, "detection")
        self._draw = stream(seed, source, "noise")
        self._drift_random = stream(seed, source, "drift")
        self._clutter_random = stream(seed, source, "clutter")
        self._receiver = None if settings.front_end is None else LfmFskReceiver(settings.front_end)
        moving, still = len(self._reflections.actor), len(scene.stationary)
        self._hides = np.concatenate([self._reflections.actor, np.full(still, FALSE, dtype=np.int64)])
        posts = len(scene.actors) + np.arange(still, dtype=np.int64)
        self._owner = np.concatenate([self._reflections.actor, posts])
        self._key = np.arange(moving + still)
        chance, places = measurement.detection_probability, scene.reflectors
        self._chance = np.concatenate([np.full(moving, chance), chance * places.detection])
        self._priority_offset = np.concatenate([np.zeros(moving), np.full(still, _STATIONARY_OFFSET)])
        self._width = np.concatenate([2 * scene.half_width[self._reflections.actor], np.zeros(still)])
        self._length = np.concatenate([2 * scene.half_length[self._reflections.actor], np.zeros(still)])
        self._drift = measurement.drift * self._drift_random.standard_normal(moving)
        self._still = np.zeros(still, dtype=np.complex128)
        self._next_key = moving + still
        self._clutter_key = np.empty(0, dtype=np.int64)
        self._clutter = np.empty((len(self.quantities), 0))
        self._clutter_place = np.empty(0, dtype=np.complex128)
        self._errors: ReflectionErrors | None = None
        self._ghosts: Ghosts | None = None
        if traffic is not None:
            draws = stream(seed, source, "errors")
            noisy = self.quantities[: len(self._noise)]
            self._errors = ReflectionErrors(traffic, noisy, self._noise, moving + still, step, draws)
            self._ghosts = Ghosts(scene, traffic.ghosts, step, stream(seed, source, "ghosts"))
        self._ghost_key = np.zeros((2, len(scene.actors)), dtype=np.int64)
        self._no_birth = np.zeros(still, dtype=bool)

    def observe(self, instant: SceneState) -> SimulatedDetections:
        """Return one scan's detections; call it for each scan in order."""
        sensor = instant.ego.at_mount(self._settings.mount)
        self._own_velocity = complex(sensor.velocity * np.exp(-1j * sensor.yaw))
        self._view = next(self._looks)
        if self._living is not None:
            self._living.advance()
            self._renew_keys(self._living.born)
        motion, detectable = self._motion(instant, sensor)
        chance = self._detection.random(len(self._key))
        errors = self._scan_errors(np.abs(motion.position))
        seen = np.flatnonzero(detectable & (chance < self._chance))
        seen_motion = motion.take(seen)
        heading = np.append(instant.actors.yaw, 0.0)[self._hides[seen]] - sensor.yaw
        values = self._values(seen_motion, self._width[seen], self._length[seen], heading, score=0.95)
        self._err(values, seen_motion, errors, seen)
        if self._receiver is not None:
            strongest, values = self._received(self._receiver, seen, seen_motion, values)
            seen = seen[strongest]
        false = self._false_objects(instant, sensor, motion, detectable)
        place = motion.position[seen]
        return SimulatedDetections(
            np.concatenate([self._key[seen], false.key]),
            np.concatenate([values, false.values], axis=1),
            np.concatenate([np.abs(place) + self._priority_offset[seen], np.abs(false.place) + _CLUTTER_OFFSET]),
            self._believed(detectable),
            np.concatenate([self._owner[seen], np.full(len(false.key), FALSE)]),
            np.concatenate([place, false.place]),
        )

    def _renew_keys(self, born: Booleans) -> None:
        """Give reflections that have become others identities of their own."""
        new = np.flatnonzero(born)
        self._key[new] = self._fresh_keys(len(new))

    def _fresh_keys(self, count: int) -> Indices:
        """Return identities that nothing has had."""
        self._next_key += count
        return np.arange(self._next_key - count, self._next_key)

    def _believed(self, detectable: Booleans) -> frozenset[int]:
        """Return the identities of what keeps its slot for a while without a detection."""
        if self._ghosts is None:
            return frozenset(self._key[detectable].tolist())
        return frozenset([*self._key.tolist(), *self._ghost_key[self._ghosts.present].tolist()])

    def _scan_errors(self, distance: Floats) -> ScanErrors:
        """Return one scan's errors of all points, at these distances, m."""
        count = len(distance)
        if self._errors is not None and self._living is not None:
            return self._errors.next(distance, np.concatenate([self._living.born, self._no_birth]))
        noise = self._draw.standard_normal((len(self._noise), count)) * self._noise
        return ScanErrors(noise, np.zeros(count, dtype=np.complex128), np.ones(count))

    def _err(self, values: Floats, motion: RelativeMotion, errors: ScanErrors, seen: Indices) -> None:
        """Add to exact quantities (quantities, n) of some points the errors of these."""
        if self._errors is not None:
            line = motion.position / np.maximum(np.abs(motion.position), 1e-9)
            apart = RelativeMotion(
                motion.position + line * errors.displacement[seen], motion.velocity, motion.acceleration
            )
            for row, name in zip(values, self.quantities, strict=True):
                if name in POSITIONS:
                    row[:] = apart.quantity(name)
                elif name in SIZES:
                    row *= errors.size[seen]
        values[: len(errors.noise)] += errors.noise[:, seen]

    def _motion(self, instant: SceneState, sensor: Pose) -> tuple[RelativeMotion, Booleans]:
        """Return the motion of every point relative to the sensor, and which can be seen."""
        reflections, measurement, stationary = self._reflections, self._measurement, self._scene.reflectors
        offset = self._offsets(seen_from(instant, sensor.position))
        moving = instant.on_actors(reflections.actor, offset)
        points = Points(
            np.concatenate([moving.position, self._scene.stationary]),
            np.concatenate([moving.velocity, self._still]),
            np.concatenate([moving.acceleration, self._still]),
        )
        motion = relative(points, sensor, self._settings)
        detectable = in_view(motion.position, self._view)
        count = len(reflections.actor)
        distance = np.abs(motion.position)
        detectable[:count] &= distance[:count] <= reflections.reach
        detectable[count:] &= (distance[count:] >= stationary.near) & (distance[count:] <= stationary.far)
        if self._living is not None:
            detectable[:count] &= self._living.present
        if measurement.occlusion:
            candidates = np.flatnonzero(detectable)
            covered = hidden(self._scene, instant, sensor, motion.position[candidates], self._hides[candidates])
            detectable[candidates[covered]] = False
        if self._living is not None:
            self._living.merge(motion.position[:count], detectable[:count])
        return motion, detectable

    def _offsets(self, eye: ComplexPlane) -> ComplexPlane:
        """Return where each reflection lies in its actor's own axes, from where the sensor is in them, m."""
        if self._living is not None:
            return self._living.offsets(eye)
        self._advance_drift()
        return self._fixed.offsets(eye, self._drift)

    def _advance_drift(self) -> None:
        """Advance each reflection's displacement on its outline, a first-order Gauss-Markov process, by one scan."""
        keep = math.exp(-self._settings.cycle_time / _DRIFT_TIME)
        spread = self._measurement.drift * math.sqrt(1 - keep**2)
        self._drift = keep * self._drift + spread * self._drift_random.standard_normal(len(self._drift))

    def _values(
        self, motion: RelativeMotion, width: Floats, length: Floats, heading: Floats, *, score: float
    ) -> Floats:
        """Return exact quantities, shape (quantities, n)."""
        rows = np.empty((len(self.quantities), len(width)))
        for row, name in zip(rows, self.quantities, strict=True):
            match name:
                case "ax":
                    row[:] = _acceleration(motion, self._settings.signals.polar)
                case "width":
                    row[:] = width
                case "length":
                    row[:] = length
                case "score":
                    row[:] = score
                case "heading":
                    row[:] = np.remainder(heading + np.pi, 2 * np.pi) - np.pi
                case _:
                    row[:] = motion.quantity(name) + self.own_part(name, np.angle(motion.position))
        return rows

    def own_part(self, name: str, azimuth: Floats) -> Floats | float:
        """Return what the sensor's own velocity in the latest scan adds to a rate that it reports over ground."""
        match name:
            case "range_rate" if self._settings.range_rates == "absolute":
                along: Floats = np.real(np.exp(-1j * azimuth) * self._own_velocity)
                return along
            case "vx" if self._settings.rates == "absolute":
                return self._own_velocity.real
            case "vy" if self._settings.rates == "absolute":
                return self._own_velocity.imag
            case _:
                return 0.0

    def _received(
        self, receiver: LfmFskReceiver, seen: Indices, motion: RelativeMotion, values: Floats
    ) -> tuple[Indices, Floats]:
        """Return the detections that a radar front end resolves, and their quantities with its ranges and rates.

        Args:
            receiver: the front end.
            seen: index of the reflection of each detection (n,).
            motion: their exact motion (n,).
            values: quantities with noise (quantities, n), of which azimuth
                and the components across the line of sight are kept.
        """
        rows = dict(zip(self.quantities, values, strict=True))
        if "azimuth" in rows:
            azimuth = rows["azimuth"]
        else:
            azimuth = np.arctan2(rows["y"], rows["x"]) if "y" in rows else np.angle(motion.position)
        noise = self._draw.standard_normal((2, len(self._owner)))[:, seen]
        peaks = receiver.receive(np.abs(motion.position), motion.quantity("range_rate"), azimuth, noise)
        velocity = rows.get("vx", motion.velocity.real) + 1j * rows.get("vy", motion.velocity.imag)
        line = np.exp(1j * peaks.azimuth)
        along = np.real(np.conj(line) * velocity[peaks.strongest])
        place, velocity = peaks.distance * line, velocity[peaks.strongest] + (peaks.rate - along) * line
        measured = {"range": peaks.distance, "azimuth": peaks.azimuth, "range_rate": peaks.rate}
        measured |= {"x": place.real, "y": place.imag, "vx": velocity.real, "vy": velocity.imag}
        values = values[:, peaks.strongest]
        for row, name in zip(values, self.quantities, strict=True):
            row[:] = measured.get(name, row)
        return peaks.strongest, values

    def _false_objects(
        self, instant: SceneState, sensor: Pose, motion: RelativeMotion, detectable: Booleans
    ) -> FalseObjects:
        """Return one scan's clutter and ghosts; `motion` and `detectable` are those of all points."""
        self._renew_clutter()
        clutter = FalseObjects(self._clutter_key, self._clutter, self._clutter_place)
        if self._ghosts is None or self._living is None:
            return clutter
        self._ghosts.advance()
        kind, actor = np.nonzero(self._ghosts.born)
        self._ghost_key[kind, actor] = self._fresh_keys(len(actor))
        first = self._living.first
        near = detectable[first] & (np.abs(motion.position[first]) <= self._ghosts.reach)
        double, beside = (np.flatnonzero(present & near) for present in self._ghosts.present)
        centres = instant.on_actors(beside, np.zeros(len(beside), dtype=np.complex128))
        row, images = self._ghosts.mirrored(centres)
        ghost = motion.take(first[double]).times(2.0).joined(relative(images, sensor, self._settings))
        owner = np.concatenate([double, beside[row]])
        key = np.concatenate([self._ghost_key[0, double], self._ghost_key[1, beside[row]]])
        seen = np.flatnonzero(in_view(ghost.position, self._view))
        ghost, owner = ghost.take(seen), owner[seen]
        sizes = 2 * self._scene.half_width[owner], 2 * self._scene.half_length[owner]
        values = self._values(ghost, *sizes, instant.actors.yaw[owner] - sensor.yaw, score=_GHOST_SCORE)
        values[: len(self._noise)] += self._draw.standard_normal((len(self._noise), len(owner))) * self._noise
        return FalseObjects(
            np.concatenate([key[seen], clutter.key]),
            np.concatenate([values, clutter.values], axis=1),
            np.concatenate([ghost.position, clutter.place]),
        )

    def _renew_clutter(self) -> None:
        """Remove most false objects and draw others, uniform over the area of the field of view."""
        view, measurement, random = self._view, self._measurement, self._clutter_random
        stay = random.random(len(self._clutter_key)) < measurement.clutter_persistence
        count = int(random.poisson(measurement.clutter * (1 - measurement.clutter_persistence)))
        distance = np.sqrt(random.uniform(view.min_range**2, view.range**2, count))
        angle = random.uniform(-1.0, 1.0, count) * math.radians(view.azimuth_deg) + math.radians(view.yaw_deg)
        direction: ComplexPlane = np.exp(1j * angle)
        velocity = random.uniform(-_CLUTTER_SPEED, _CLUTTER_SPEED, count) * direction
        motion = RelativeMotion(distance * direction, velocity, np.zeros(count, dtype=np.complex128))
        fresh = self._values(motion, np.zeros(count), np.zeros(count), np.zeros(count), score=0.2)
        self._clutter_key = np.concatenate([self._clutter_key[stay], self._fresh_keys(count)])
        self._clutter = np.concatenate([self._clutter[:, stay], fresh], axis=1)
        self._clutter_place = np.concatenate([self._clutter_place[stay], motion.position])


def turned(settings: SensorSettings, angle_deg: float) -> SensorSettings:
    """Return a sensor as it is mounted: turned to the left of what its configuration says."""
    if not angle_deg:
        return settings
    yaw_deg = math.remainder(settings.mount.yaw_deg + angle_deg, 360.0)
    return settings.model_copy(update={"mount": settings.mount.model_copy(update={"yaw_deg": yaw_deg})})


def _deviation(name: str, settings: SensorSettings, measurement: MeasurementEffects) -> float:
    """Return the standard deviation of a quantity's noise, SI units."""
    if name not in NOISY:
        return 0.0
    if name == "ax":
        return measurement.noise.ax
    field = "azimuth_deg" if name == "azimuth" else name
    override: float | None = getattr(measurement.noise, field)
    chosen: float = getattr(settings.noise, field) if override is None else override
    return math.radians(chosen) if name == "azimuth" else chosen
