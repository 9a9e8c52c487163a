"""Sensor model: visible reflections, missed detections, noise and clutter, as quantities in sensor axes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import cycle

import numpy as np

from candaemon.arrays import Booleans, ComplexPlane, Floats, Indices
from candaemon.config.sensors import SensorSettings
from candaemon.simulation.lfm_fsk import LfmFskReceiver
from candaemon.simulation.random_streams import stream
from candaemon.simulation.scenario import MeasurementEffects
from candaemon.simulation.scene import Points, Pose, Scene, SceneState
from candaemon.simulation.visibility import VisibleReflections, hidden, in_view, seen_from

NOISY = ("x", "y", "range", "azimuth", "range_rate", "vx", "vy", "ax")
"""Quantities with measurement noise."""
QUANTITIES = (*NOISY, "width", "length", "score", "heading")
"""Quantities an object can have, as `ObjectSignals` names them; no noise is drawn for the last."""

_DRIFT_TIME = 2.0
"""s, correlation time of a reflection's movement along its actor's outline."""
_CLUTTER_SPEED = 30.0
"""m/s, bound of a false object's range rate."""
_STATIONARY_OFFSET, _CLUTTER_OFFSET = 60.0, 30.0
"""m added to the distance of stationary and false objects, which lowers their priority when slots run short."""


@dataclass(frozen=True, slots=True)
class RelativeMotion:
    """Motion of n points relative to a sensor, in its axes, m, m/s, m/s²; velocity as the sensor's `rates` says."""

    position: ComplexPlane
    velocity: ComplexPlane
    acceleration: ComplexPlane

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
        detectable: identities of all objects that could have been detected.

    """

    key: Indices
    values: Floats
    urgency: Floats
    detectable: frozenset[int]


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
        self._scene, self._settings, self._measurement = scene, settings, measurement
        self._looks = cycle(settings.views.values())
        self._view = settings.field_of_view
        self._reflections = VisibleReflections(scene)
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
        self._owner = np.concatenate([self._reflections.actor, np.full(still, -1, dtype=np.int64)])
        posts = len(scene.actors) + np.arange(still, dtype=np.int64)
        self._source = np.concatenate([self._reflections.actor, posts, [-1]])  # never empty
        self._priority_offset = np.concatenate([np.zeros(moving), np.full(still, _STATIONARY_OFFSET)])
        self._width = np.concatenate([2 * scene.half_width[self._reflections.actor], np.zeros(still)])
        self._length = np.concatenate([2 * scene.half_length[self._reflections.actor], np.zeros(still)])
        self._drift = measurement.drift * self._drift_random.standard_normal(moving)
        self._still = np.zeros(still, dtype=np.complex128)
        self._next_false = moving + still
        self._clutter_key = np.empty(0, dtype=np.int64)
        self._clutter = np.empty((len(self.quantities), 0))
        self._clutter_range = np.empty(0)

    def observe(self, instant: SceneState) -> SimulatedDetections:
        """Return one scan's detections; call it for each scan in order."""
        sensor = instant.ego.at_mount(self._settings.mount)
        self._view = next(self._looks)
        motion, detectable = self._motion(instant, sensor)
        chance = self._detection.random(len(self._owner))
        noise = self._draw.standard_normal((len(self._noise), len(self._owner))) * self._noise
        seen = np.flatnonzero(detectable & (chance < self._measurement.detection_probability))
        seen_motion = RelativeMotion(motion.position[seen], motion.velocity[seen], motion.acceleration[seen])
        heading = np.append(instant.actors.yaw, 0.0)[self._owner[seen]] - sensor.yaw
        values = self._values(seen_motion, self._width[seen], self._length[seen], heading, score=0.95)
        values[: len(noise)] += noise[:, seen]
        if self._receiver is not None:
            strongest, values = self._received(self._receiver, seen, seen_motion, values)
            seen = seen[strongest]
        self._renew_clutter()
        distance = np.abs(motion.position[seen])
        return SimulatedDetections(
            np.concatenate([seen, self._clutter_key]),
            np.concatenate([values, self._clutter], axis=1),
            np.concatenate([distance + self._priority_offset[seen], self._clutter_range + _CLUTTER_OFFSET]),
            frozenset(np.flatnonzero(detectable).tolist()),
        )

    def owner(self, key: Indices) -> Indices:
        """Return each detection's source: the actor's index, actors + the stationary object's index, −1 for clutter."""
        return np.where(key < len(self._source), self._source[np.minimum(key, len(self._source) - 1)], -1)

    def _motion(self, instant: SceneState, sensor: Pose) -> tuple[RelativeMotion, Booleans]:
        """Return the motion of every point relative to the sensor, and which can be seen."""
        reflections, measurement = self._reflections, self._measurement
        self._advance_drift()
        offset = reflections.offsets(seen_from(instant, sensor.position), self._drift)
        moving = instant.on_actors(reflections.actor, offset)
        points = Points(
            np.concatenate([moving.position, self._scene.stationary]),
            np.concatenate([moving.velocity, self._still]),
            np.concatenate([moving.acceleration, self._still]),
        )
        motion = relative(points, sensor, self._settings)
        detectable = in_view(motion.position, self._view)
        detectable[: len(reflections.actor)] &= np.abs(motion.position[: len(reflections.actor)]) <= reflections.reach
        if measurement.occlusion:
            candidates = np.flatnonzero(detectable)
            covered = hidden(self._scene, instant, sensor, motion.position[candidates], self._owner[candidates])
            detectable[candidates[covered]] = False
        return motion, detectable

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
                    row[:] = motion.quantity(name)
        return rows

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
        azimuth = rows["azimuth"] if "azimuth" in rows else np.arctan2(rows["y"], rows["x"])
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
        keys = np.arange(self._next_false, self._next_false + count)
        self._next_false += count
        self._clutter_key = np.concatenate([self._clutter_key[stay], keys])
        self._clutter = np.concatenate([self._clutter[:, stay], fresh], axis=1)
        self._clutter_range = np.concatenate([self._clutter_range[stay], distance])


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
