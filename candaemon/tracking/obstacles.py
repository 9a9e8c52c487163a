"""What the tracker reports: the obstacles of one cycle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Floats, Integers
from candaemon.frames.bodies import CLASSES

TENTATIVE, CONFIRMED, COASTING = 0, 1, 2
STATE_NAMES = ("tentative", "confirmed", "coasting")
UNKNOWN, CAR, TRUCK, TWO_WHEELER, PEDESTRIAN, STANDING = range(6)
CLASS_NAMES = CLASSES


@dataclass(slots=True)  # made each cycle, and never changed: freezing takes four times as long as filling
class Obstacles:
    """Obstacles of one cycle, a structure of arrays of length n.

    Vehicle axes are ISO 8855 (x forward, y left); velocity and acceleration are over ground.

    Attributes:
        time_ns: the instant the states hold for.
        id: identity, never reused in a run.
        state: `TENTATIVE`, `CONFIRMED` or `COASTING`.
        x, y: position of the reference point in vehicle axes, m.
        vx, vy: velocity over ground in vehicle axes, m/s.
        ax, ay: acceleration over ground in vehicle axes, m/s².
        east, north: position in the local frame, m.
        ve, vn: velocity over ground in the local frame, m/s.
        sx, sy, svx, svy: one standard deviation each, vehicle axes.
        age: s since the first detection.
        existence: 0 to 1; of the point tracker the share of recent scans in which it was seen.
        sensors: bit k set where sensor k has ever contributed.
        heading: of its front, in vehicle axes, positive to the left, −π to π rad; NaN where unknown.
        yaw_rate: over ground, positive to the left, rad/s; NaN where unknown.
        length, width: of its box, m; NaN where unknown.
        center_x, center_y: centre of its box in vehicle axes, m; the reference point where the size is unknown.
        kind: its class, an index into `CLASS_NAMES`.
        kind_likelihood: of its class, 0 to 1; NaN where unknown.
        covariance: of [x, y, vx, vy] in vehicle axes (n, 4, 4).
        used_row, used_sensor, used_object: the detections used in this cycle, (m,): row of the obstacle, index of the
            sensor, object id of the sensor.
    """

    time_ns: int
    id: Integers
    state: NDArray[np.int8]
    x: Floats
    y: Floats
    vx: Floats
    vy: Floats
    ax: Floats
    ay: Floats
    east: Floats
    north: Floats
    ve: Floats
    vn: Floats
    sx: Floats
    sy: Floats
    svx: Floats
    svy: Floats
    age: Floats
    existence: Floats
    sensors: Integers
    heading: Floats
    yaw_rate: Floats
    length: Floats
    width: Floats
    center_x: Floats
    center_y: Floats
    kind: NDArray[np.int8]
    kind_likelihood: Floats
    covariance: Floats
    used_row: Integers
    used_sensor: Integers
    used_object: Integers

    def __len__(self) -> int:
        return len(self.id)


MOTION = ("x", "y", "vx", "vy", "ax", "ay", "east", "north", "ve", "vn", "sx", "sy", "svx", "svy")


def concatenated(parts: Sequence[Obstacles]) -> Obstacles:
    """Return the obstacles of several trackers as one; all hold for the same instant."""
    first_rows = np.cumsum([0, *(len(part) for part in parts[:-1])])
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in (field.name for field in fields(Obstacles))
        if name not in {"time_ns", "used_row"}
    }
    used_row = np.concatenate([part.used_row + row for part, row in zip(parts, first_rows, strict=True)])
    return Obstacles(time_ns=parts[0].time_ns, used_row=used_row, **columns)


def no_obstacles(time_ns: int) -> Obstacles:
    """Return no obstacles, at an instant."""
    empty: dict[str, Any] = dict.fromkeys((field.name for field in fields(Obstacles)), np.empty(0))
    for name in ("id", "sensors", "used_row", "used_sensor", "used_object"):
        empty[name] = np.empty(0, dtype=np.int64)
    codes = np.empty(0, dtype=np.int8)
    return Obstacles(**empty | {"time_ns": time_ns, "state": codes, "kind": codes, "covariance": np.empty((0, 4, 4))})
