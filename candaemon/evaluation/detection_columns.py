"""What the sensors said and what became of it: the detections of a cycle as columns.

Positions, velocities and directions are in vehicle axes (ISO 8855), speeds over ground unless said otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Floats
from candaemon.pipeline.cycle import Cycle
from candaemon.radar.detections import Detections

NO_OBSTACLE: Final = int(np.iinfo(np.int64).min)
"""`id` of a detection that no obstacle used; written as an empty cell."""

FATES: Final = ("updated", "initiated", "unused")
"""What can become of a detection, each with its index as code."""
UPDATED, INITIATED, UNUSED = range(3)


@dataclass(frozen=True, slots=True)
class DetectionColumn:
    """A column: its name, kind (as in a table of Parquet), unit and meaning."""

    name: str
    kind: Literal["integer", "number", "flag", "text"]
    unit: str
    meaning: str


DETECTION_COLUMNS: Final = (
    DetectionColumn("sensor", "text", "", "name of the sensor"),
    DetectionColumn("object", "integer", "", "the sensor's own id of the object; its slot where there is none"),
    DetectionColumn("new", "flag", "", "the sensor says that the id names another object than before"),
    DetectionColumn("x", "number", "m", "forward, vehicle axes"),
    DetectionColumn("y", "number", "m", "to the left, vehicle axes"),
    DetectionColumn("range_rate", "number", "m/s", "along the line of sight, positive away; null where not measured"),
    DetectionColumn("vx", "number", "m/s", "over ground, along the vehicle's x axis; null unless both are measured"),
    DetectionColumn("vy", "number", "m/s", "over ground, along the vehicle's y axis; likewise"),
    DetectionColumn("length", "number", "m", "as the sensor says; null where it does not"),
    DetectionColumn("width", "number", "m", "likewise"),
    DetectionColumn("heading", "number", "rad", "of the front, vehicle axes, positive to the left; likewise"),
    DetectionColumn("fate", "text", "", "updated a reflection, initiated one, or unused"),
    DetectionColumn("id", "integer", "", "the obstacle whose reflection that is; null where unused"),
    DetectionColumn("nis", "number", "", "normalised innovation squared; null unless it updated"),
    DetectionColumn("degrees_of_freedom", "integer", "", "expectation of the NIS: quantities measured"),
)
"""The columns of a table of detections, after those of time."""


def detection_columns(cycle: Cycle, sensors: Sequence[str]) -> dict[str, NDArray[Any] | list[str]]:
    """Return the detections of a cycle as columns, each of length n.

    Args:
        cycle: one with detections.
        sensors: names by index.

    Returns:
        The columns of `DETECTION_COLUMNS`; `fate` holds codes, an unknown number is NaN, no obstacle `NO_OBSTACLE`.
    """
    detections, obstacles = cycle.detections, cycle.obstacles
    if detections is None:
        raise ValueError("a cycle without detections")
    n, measurement = len(detections), detections.measurement
    fate, identity = np.full(n, UNUSED, np.int8), np.full(n, NO_OBSTACLE)
    nis, degrees = np.full(n, np.nan), measurement.measured
    update = cycle.update
    if update is not None:
        identity[update.detection] = obstacles.id[obstacles.used_row]
        fate[update.detection] = np.where(np.isnan(update.nis), INITIATED, UPDATED)
        nis[update.detection] = update.nis
    unknown = np.full(n, np.nan)
    vx, vy = _velocity(detections, cycle.pose.heading)
    heading = unknown
    if detections.heading is not None:
        heading = np.remainder(detections.heading - cycle.pose.heading + np.pi, 2 * np.pi) - np.pi
    return {
        "sensor": [sensors[detections.sensor]] * n,
        "object": detections.object_id,
        "new": detections.new,
        "x": detections.x,
        "y": detections.y,
        "range_rate": unknown if measurement.range_rate is None else measurement.range_rate,
        "vx": vx,
        "vy": vy,
        "length": unknown if detections.length is None else detections.length,
        "width": unknown if detections.width is None else detections.width,
        "heading": heading,
        "fate": fate,
        "id": identity,
        "nis": nis,
        "degrees_of_freedom": degrees,
    }


def _velocity(detections: Detections, heading: float) -> tuple[Floats, Floats]:
    """Return the measured velocity along the vehicle's axes (n,) each; NaN unless two components are measured."""
    parts = detections.measurement.projections
    if len(parts) != 2:
        unknown = np.full(len(detections), np.nan)
        return unknown, unknown
    along, across = parts  # of perpendicular directions: the sensor's axes
    velocity = along.direction * along.value[:, None] + across.direction * across.value[:, None]
    c, s = np.cos(heading), np.sin(heading)
    return c * velocity[:, 0] + s * velocity[:, 1], c * velocity[:, 1] - s * velocity[:, 0]
