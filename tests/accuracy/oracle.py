"""Reference O: the project's tracker of vehicles, given which object each detection is of.

Only the association is replaced, and what follows from it: false detections are left out, obstacles neither merge nor
split. Estimation, confirmation and deletion are the project's own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from candaemon.arrays import Floats, Indices, Integers
from candaemon.binding.bound import Binding
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.pipeline.cycle import Cycle
from candaemon.radar.detections import Detections
from candaemon.simulation.simulate import Simulation
from candaemon.tracking.body_association import Association
from candaemon.tracking.groups import TrackerGroups
from candaemon.tracking.obstacles import Obstacles, concatenated, no_obstacles
from candaemon.tracking.vehicle_tracker import VehicleTracker

Sources = Mapping[tuple[int, int], Mapping[int, int]]
"""(Sensor, time of the scan in ns) → the sensor's id of an object → its id in the truth, 0 for a false one."""


def sources(simulation: Simulation) -> Sources:
    """Return what every detection of a simulation is of."""
    return {
        (scan.sensor, scan.time_ns): dict(zip(scan.object_id.tolist(), scan.source.tolist(), strict=True))
        for scan in simulation.origins()
    }


def informed(binding: Binding, cycles: Sequence[Cycle], truth: Sources) -> list[Obstacles] | None:
    """Return the obstacles of trackers that are told the truth; None where some tracker cannot be told.

    Args:
        binding: the configuration.
        cycles: of a pipeline: they have the detections and poses.
        truth: what the detections are of.
    """
    groups = TrackerGroups(binding.settings, {sensor.name: sensor.settings for sensor in binding.sensors})
    if not all(isinstance(tracker, VehicleTracker) for tracker in groups.trackers):
        return None
    told = {id(tracker): OracleTracker.in_place_of(tracker, truth) for tracker in groups.trackers}
    by_sensor = [told[id(tracker)] for tracker in groups.by_sensor]
    return [_advanced(list(told.values()), by_sensor, cycle) for cycle in cycles]


def _advanced(trackers: Sequence[OracleTracker], by_sensor: Sequence[OracleTracker], cycle: Cycle) -> Obstacles:
    """Return the obstacles of one more cycle, as the pipeline does it."""
    detections = cycle.detections
    if detections is None and cycle.pose.status is EgoStatus.LOST:
        return no_obstacles(cycle.obstacles.time_ns)
    mine = None if detections is None else by_sensor[detections.sensor]
    return concatenated([each.step(detections if each is mine else None, cycle.pose) for each in trackers])


class OracleTracker(VehicleTracker):
    """A tracker of vehicles to which the truth tells the association."""

    _truth: Sources
    _obstacle_of: dict[int, int]
    _source: Integers

    @classmethod
    def in_place_of(cls, tracker: object, truth: Sources) -> OracleTracker:
        """Return a tracker that has all that another one has."""
        informed = cls.__new__(cls)
        vars(informed).update(vars(tracker))
        informed._truth = truth
        informed._obstacle_of = {}
        return informed

    def step(self, detections: Detections | None, pose: EgoPose) -> Obstacles:
        """Advance with the true detections of a scan."""
        if detections is not None:
            told = self._truth.get((detections.sensor, detections.time_ns), {})
            source = np.array([told.get(key, 0) for key in detections.object_id.tolist()], dtype=np.int64)
            rows = np.flatnonzero(source > 0)
            self._source = source[rows]
            detections = _taken(detections, rows)
        return super().step(detections, pose)

    def _associate(self, detections: Detections) -> Association:
        """Return the body that each detection is of, and the reflection that its slot last showed, or the nearest."""
        body = np.array([self._body_of(source) for source in self._source.tolist()], dtype=np.intp)
        reflection = np.full(len(detections), -1, dtype=np.intp)
        if len(self) and not detections.identified:
            for one in np.unique(body[body >= 0]).tolist():
                mine = np.flatnonzero(body == one)
                reflection[mine] = self._nearest_of(one, detections.measurement.position[mine])
        elif len(self):
            row, _ = self._bodies.rows_of(detections.sensor, detections.object_id)
            known = np.flatnonzero(row >= 0)
            mine = self._bodies.reflections.body[row[known]] == body[known]
            # an id that comes twice in a scan names the first one
            first = np.unique(row[known], return_index=True)[1]
            only = np.zeros(len(known), dtype=bool)
            only[first] = True
            reflection[known[mine & only]] = row[known[mine & only]]
        return Association(body, reflection, np.where(reflection >= 0, 0.0, np.nan))  # each is surely of it

    def _nearest_of(self, body: int, places: Floats) -> Indices:
        """Return which reflections of a body places (m, 2) are of, −1 where too few are known."""
        known = np.flatnonzero(self._bodies.reflections.body == body)
        expected = self._bodies.moments().mean[body, :2] + self._bodies.offsets(known)
        chosen, nearest = linear_sum_assignment(np.hypot(*np.moveaxis(places[:, None] - expected, -1, 0)))
        of = np.full(len(places), -1, dtype=np.intp)
        of[chosen] = known[nearest]
        return of

    def _initiate(self, association: Association, detections: Detections, pose: EgoPose) -> None:
        """Initiate reflections and bodies one after another: none of them looks for its like."""
        before = len(self)
        for row in np.flatnonzero(association.reflection < 0).tolist():
            source = int(self._source[row])
            association.body[row] = self._body_of(source)
            self._initiation.initiate(np.array([row]), association, detections, pose, self._bodies)
            self._obstacle_of[source] = int(self._bodies.obstacles.id[association.body[row]])
        self.counts.obstacles += len(self) - before

    def _merge_and_split(self, pose: EgoPose) -> None:
        """Leave the obstacles as they are."""

    def _body_of(self, source: int) -> int:
        """Return the row of the obstacle of an object of the truth, or −1."""
        rows = np.flatnonzero(self._bodies.obstacles.id == self._obstacle_of.get(source, -1))
        return int(rows[0]) if len(rows) else -1


def _taken(detections: Detections, rows: Indices) -> Detections:
    """Return some of the detections of a scan."""
    columns = {each.name: getattr(detections, each.name) for each in fields(Detections)}
    taken: dict[str, Any] = {name: column[rows] for name, column in columns.items() if isinstance(column, np.ndarray)}
    return replace(detections, **taken, measurement=detections.measurement.take(rows))
