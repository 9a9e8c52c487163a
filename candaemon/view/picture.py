"""A picture: one cycle as it is drawn, and its form as JSON.

Positions are in vehicle axes (x forward, y left, m), velocities over ground in the same axes (m/s), angles in rad.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from candaemon.ego.pose import EgoPose
from candaemon.radar.detections import Detections

Column: TypeAlias = NDArray[Any]

COLUMNS: Final = (
    "id", "state", "x", "y", "vx", "vy", "ax", "ay", "sx", "sy", "sxy", "age", "existence", "heading", "yaw_rate",
    "length", "width", "center_x", "center_y", "class", "nis", "innovation_x", "innovation_y",
)  # fmt: skip
"""Quantities of an obstacle. `nis` is over its degrees of freedom: 1 is expected."""
_DECIMALS: Final = 3


@dataclass(frozen=True, slots=True)
class ScanMarks:
    """The detections of one scan, to be drawn.

    Attributes:
        sensor: index of the sensor.
        object_id: the sensor's own ids (n,).
        x, y: in vehicle axes at the picture's time (n,), m.
    """

    sensor: int
    object_id: Column
    x: Column
    y: Column


@dataclass(frozen=True, slots=True)
class Picture:
    """One cycle as it is drawn.

    Attributes:
        time_ns: the instant the states hold for.
        pose: of the own vehicle.
        columns: quantities of the n obstacles by name, those of `COLUMNS` that are known; NaN where one is not.
        modes: probabilities of the models of motion of each obstacle (n, M); M is 0 where they are not known.
        scans: detections since the picture before.
        heard: whether the obstacles came over a bus; otherwise they were tracked by whoever draws.
        health: how sensors and buses are doing; empty where nothing has changed since.
    """

    time_ns: int
    pose: EgoPose
    columns: dict[str, Column]
    modes: Column
    scans: tuple[ScanMarks, ...] = ()
    heard: bool = False
    health: dict[str, Any] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.columns["id"])

    @property
    def time(self) -> float:
        """The instant the states hold for, s."""
        return self.time_ns * 1e-9

    def rows(self) -> list[dict[str, Any]]:
        """Return the obstacles as one mapping each; None for what is not known."""
        columns = {name: _plain(values) for name, values in self.columns.items()}
        return [{name: values[row] for name, values in columns.items()} for row in range(len(self))]

    def encoded(self) -> bytes:
        """Return it as compact JSON: column names once, null for what is not known."""
        pose = self.pose
        forward, left = pose.velocity_in_vehicle_axes()
        tree: dict[str, Any] = {
            "t": round(self.time, 4),
            "pose": [
                *(round(float(value), 4) for value in (pose.east, pose.north, pose.heading, forward, left)),
                round(float(pose.yaw_rate), 5),
                int(pose.status),
            ],
            "obstacles": {name: _plain(values) for name, values in self.columns.items()},
            "scans": [[scan.sensor, _plain(scan.object_id), _plain(scan.x), _plain(scan.y)] for scan in self.scans],
            "heard": self.heard,
        }
        if self.modes.size:
            tree["modes"] = [_plain(row) for row in self.modes]
        if self.health:
            tree["health"] = self.health
        return json.dumps(tree, separators=(",", ":"), allow_nan=False).encode()


def scan_marks(detections: Detections) -> ScanMarks:
    """Return the detections of a scan, to be drawn."""
    return ScanMarks(detections.sensor, detections.object_id, detections.x, detections.y)


def _plain(values: Column) -> list[Any]:
    """Return numbers as a list: rounded, None for those that are none."""
    if values.dtype.kind in "biu":
        return list(values.tolist())
    rounded = np.round(values, _DECIMALS).tolist()
    if np.isfinite(values).all():
        return list(rounded)
    return [value if abs(value) < np.inf else None for value in rounded]  # NaN is not less either
