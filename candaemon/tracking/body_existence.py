"""How surely bodies exist: evidence of scans that detected them, or should have, and what nothing could see.

Successive detections of a radar that tracks by itself are no independent evidence, nor are successive misses: one scan
changes the odds by a limited factor, that with which as many detections in succession confirm as the settings say.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import cos, log, sin, sqrt

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.config.sensors import SensorSettings
from candaemon.config.tracker import LifecycleSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.body_filter import POSITION
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import SensorView, seen_by_any
from candaemon.tracking import existence
from candaemon.tracking.body_association import Association, Detecting
from candaemon.tracking.body_modes import STANDING
from candaemon.tracking.body_store import Bodies, BodyTable
from candaemon.tracking.reflections import to_travel_axes
from candaemon.tracking.sensor_visibility import Visibility, VisibilityState

_UNKNOWN_PROBABILITY = 0.9  # of detection, by a sensor whose settings are not known
_SURE = 0.9  # probability of existence from which on detection rates are learnt
_POST = 0.3  # m, size of what is not confirmed, or never moved and has no known size, as far as it hides others
_MOVED = 2.0  # m/s
_MARGIN = 1.2  # for what leaves in the time between scans, and for a miss among the detections that confirm
_LEAST_LIMIT = 1.05  # factor by which a scan can change the odds at least


class BodyExistence:
    """Evidence of existence.

    Args:
        settings: of the life cycle.
        sensors: settings of the sensors by their number; of others nothing is learnt.
        views: what they see.
    """

    def __init__(
        self, settings: LifecycleSettings, sensors: Mapping[int, SensorSettings], views: Sequence[SensorView]
    ) -> None:
        self._settings = settings
        self._views = views
        self._visibility = Visibility(sensors)
        sure, first = settings.sure, settings.first_existence
        self._odds = sure / (1.0 - sure) * (1.0 - first) / first
        self._limit = self._limit_for(settings.confirm)
        self._minutes = {number: each.cycle_time / 60.0 for number, each in sensors.items()}
        self.first = sure if settings.confirm == 1 else first

    @property
    def state(self) -> VisibilityState:
        """What was learnt of the sensors.

        Raises:
            ValueError: a state that is set is of other sensors, or holds what cannot be.
        """
        return self._visibility.state

    @state.setter
    def state(self, state: VisibilityState) -> None:
        self._visibility.state = state

    def renumber_sensors(self, sensors: Mapping[int, int]) -> None:
        """Give what was learnt to the sensors' other numbers, and forget those left out."""
        self._visibility.renumber_sensors(sensors)
        self._minutes = {sensors[old]: each for old, each in self._minutes.items() if old in sensors}

    def predict(self, bodies: Bodies, dt: float) -> None:
        """Let a time pass: what exists leaves some day, and what could be seen and was not waits longer."""
        obstacles = bodies.obstacles
        if compiled.in_use:
            kept = existence.kept(dt, self._settings.mean_life)
            compiled.kernels.let_time_pass(
                obstacles.existence, obstacles.unseen, obstacles.in_sight, kept, dt, existence.LEAST
            )
            return
        obstacles.existence = existence.predicted(obstacles.existence, dt, self._settings.mean_life)
        obstacles.unseen += dt * obstacles.in_sight

    def observe(self, bodies: Bodies, association: Association, detections: Detections, pose: EgoPose) -> Floats:
        """Weigh what a scan shows, before it updates the bodies.

        Args:
            bodies: predicted to the time of the scan.
            association: of its detections.
            detections: the scan.
            pose: ego pose.

        Returns:
            The share of each body that the sensor could see (k,): 1 where its field of view is not known.
        """
        if not len(bodies):
            return np.empty(0)
        obstacles, sensor = bodies.obstacles, detections.sensor
        (place, centre, axis), size = _boxes(bodies, pose)
        is_known = sensor in self._visibility.state.sensors
        density = self._visibility.clutter_density(sensor) if is_known else 0.0
        seen, ratio = _likelihood_ratios(bodies, association, detections, density)
        missed, surely, unseen = _experience(obstacles, seen, sensor)
        if is_known:
            share, distance = self._visibility.in_sight(centre, place, axis, size[0], size[1], sensor, detections.look)
            room = self._visibility.room(sensor, detections.time_ns, detections.x, detections.y, distance)
            if room is not None:
                share = np.where(seen, share, share * room)
            probability = self._visibility.detection_probability(sensor, share, distance, missed)
            self._visibility.learn(sensor, share, seen, distance, missed, surely)
            in_sight = share
        else:
            in_sight = np.ones(len(obstacles))
            share = self._looked_at(detections, place).astype(np.float64)
            probability = _UNKNOWN_PROBABILITY * share
        expected = np.zeros(len(obstacles), dtype=np.bool_)
        if len(unseen):
            expected[unseen] = self._looked_at(detections, place[unseen])
        self._weigh(obstacles, seen, expected, share, probability, ratio, sensor)
        return in_sight

    def _weigh(
        self,
        obstacles: BodyTable,
        seen: Booleans,
        expected: Booleans,
        share: Floats,
        probability: Floats,
        ratio: Floats,
        sensor: int,
    ) -> None:
        """Weigh what is seen or expected, by a limited factor, and note what the scan could see.

        What is not confirmed loses half as much by a miss: what comes into view at its edge is missed now and then.
        What was given up for lost and is detected again exists as surely as what is detected for the first time.
        """
        limit, careful, most = self._limit, sqrt(self._limit), self._limit_for(self.confirming(sensor))
        if compiled.in_use:
            compiled.kernels.weigh_existence(
                obstacles.existence,
                obstacles.in_sight,
                obstacles.unseen,
                obstacles.confirmed,
                seen,
                expected,
                share,
                probability,
                ratio,
                limit,
                careful,
                most,
                self._settings.first_existence,
                existence.LEAST,
                existence.LARGEST_RATIO,
            )
            return
        found = seen & obstacles.confirmed & (obstacles.existence < self._settings.first_existence)
        obstacles.existence[found] = self._settings.first_existence
        raised = existence.detected(obstacles.existence, probability, ratio)
        raised = np.where(seen, np.maximum(raised, obstacles.existence), raised)
        odds = obstacles.existence / (1.0 - obstacles.existence)
        least = odds / np.where(obstacles.confirmed, limit, careful)
        odds = np.clip(raised / (1.0 - raised), least, odds * most)
        raised = existence.bounded(odds / (1.0 + odds))
        obstacles.existence = np.where(seen | expected, raised, obstacles.existence)
        obstacles.in_sight = np.where(seen, 1.0, np.where(expected, share, obstacles.in_sight))
        obstacles.unseen[seen] = 0.0

    def leave(self, bodies: Bodies, in_view: Booleans) -> None:
        """Note what has left all fields of view: nothing can see it."""
        bodies.obstacles.in_sight = np.where(in_view, bodies.obstacles.in_sight, 0.0)

    def detecting(self, sensor: int) -> Detecting | None:
        """Return how a sensor detects, by all that is known of it; None: nothing is."""
        if sensor not in self._visibility.state.sensors:
            return None
        return Detecting(self._visibility.mean_probability(sensor), self._visibility.clutter_density(sensor))

    def learn_clutter(self, sensor: int, ended: Integers) -> None:
        """Learn from a scan how many detections belonged to nothing.

        Args:
            sensor: its number.
            ended: histories of the bodies that have ended unconfirmed (m,).
        """
        if sensor in self._visibility.state.sensors:
            hits = int(np.bitwise_count(ended).sum()) if len(ended) else 0
            self._visibility.learn_clutter(sensor, len(ended), again=max(hits - len(ended), 0))

    def confirming(self, sensor: int) -> float:
        """Return how many detections in succession confirm: as many as let few false obstacles a minute through.

        The sensors that have shown false detections share those: each on its own, twelve would let through twelve times
        as many.
        """
        least, most = self._settings.earliest, self._settings.confirm
        if least >= most or sensor not in self._visibility.state.sensors:
            return float(most)
        false, persistence = self._visibility.false_beginnings(sensor)
        allowed = self._settings.false_rate * self._minutes[sensor] / self._visibility.sensors_with_clutter()
        needed = 1.0 + log(max(false / allowed, 1.0)) / -log(persistence)
        return min(max(needed, float(least)), float(most))

    def _limit_for(self, detections: float) -> float:
        """Return by how much a scan may raise the odds where so many detections in succession are to confirm."""
        return float(max(self._odds ** (1.0 / max(detections - 1.0, 1.0)) * _MARGIN, _LEAST_LIMIT))

    def _looked_at(self, detections: Detections, place: Floats) -> Booleans:
        """Return which places in vehicle axes (n, 2) lie in the field of view of the scan."""
        views = [each for each in self._views if each.sensor == detections.sensor]
        if detections.look >= 0:
            views = [each for each in views if each.look == detections.look]
        if not views:
            return np.ones(len(place), dtype=np.bool_)
        return seen_by_any(views, place)


def _boxes(bodies: Bodies, pose: EgoPose) -> tuple[Floats, Floats]:
    """Return reference points, centres and axes of bodies in vehicle axes (3, k, 2); lengths and widths (2, k), m.

    Those are as far as they hide others: what may be a post is no larger than one.
    """
    obstacles, mean = bodies.obstacles, bodies.moments().mean
    standing, c, s = bodies.filter.probability[:, STANDING], cos(pose.heading), sin(pose.heading)
    if compiled.in_use:
        return compiled.kernels.boxes_in_vehicle_axes(
            mean,
            obstacles.facing,
            obstacles.axis,
            obstacles.length,
            obstacles.width,
            obstacles.length_variance,
            obstacles.fastest,
            obstacles.confirmed,
            standing,
            pose.east,
            pose.north,
            c,
            s,
            _SURE,
            _MOVED,
            _POST,
        )
    own, heading = np.array([pose.east, pose.north]), np.array([c, s])
    place = to_travel_axes(mean[:, POSITION] - own, heading)
    centre, axis = place - to_travel_axes(obstacles.facing, heading), to_travel_axes(obstacles.axis, heading)
    stood = (standing > _SURE) & (obstacles.length_variance > 1.0) & (obstacles.fastest < _MOVED)
    size = np.stack([obstacles.length, obstacles.width])
    return np.stack([place, centre, axis]), np.where(~obstacles.confirmed | stood, _POST, size)


def _experience(obstacles: BodyTable, seen: Booleans, sensor: int) -> tuple[Booleans, Booleans, Indices]:
    """Return what a sensor's detections of bodies were before.

    Args:
        obstacles: the bodies.
        seen: which are detected now (k,).
        sensor: its number.

    Returns:
        Which bodies the scan before missed; which surely exist and have been detected by this sensor, as another may
        not see things of their kind; and the rows of those detected by it before and not now.
    """
    bit = 1 << sensor
    if compiled.in_use:
        return compiled.kernels.experience_of_bodies(
            obstacles.sensors, obstacles.history, obstacles.existence, obstacles.confirmed, seen, bit, _SURE
        )
    familiar = obstacles.sensors & bit != 0
    surely = obstacles.confirmed & (obstacles.existence > _SURE) & familiar
    return obstacles.history & 1 == 0, surely, (familiar & ~seen).nonzero()[0]


def _likelihood_ratios(
    bodies: Bodies, association: Association, detections: Detections, density: float
) -> tuple[Booleans, Floats]:
    """Return which bodies are detected (k,), and the likelihoods of their detections over the density of clutter (k,).

    Without a detection that is 0, of several it is that of the last one.
    """
    spread, variance = bodies.moments().shown_covariance, bodies.reflections.variance
    fit, scale, noise = np.exp(-0.5 * association.nis), 2 * np.pi * max(density, 1e-9), detections.measurement.noise
    if compiled.in_use:
        return compiled.kernels.likelihood_ratios(
            spread, variance, noise, association.body, association.reflection, fit, scale
        )
    seen, ratio = np.zeros(len(bodies), dtype=np.bool_), np.zeros(len(bodies))
    rows = np.flatnonzero(association.reflection >= 0)
    body, more = association.body[rows], variance[association.reflection[rows]]
    a = spread[body, 0, 0] + more + noise[rows, 0, 0]
    b = spread[body, 0, 1] + noise[rows, 0, 1]
    d = spread[body, 1, 1] + more + noise[rows, 1, 1]
    seen[body] = True
    ratio[body] = fit[rows] / (scale * np.sqrt(np.maximum(a * d - b * b, 1e-12)))
    return seen, ratio
