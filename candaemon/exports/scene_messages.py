"""Foxglove's messages of a drive: boxes and arrows, detections, poses, places on earth.

Frames: `local` (the local level frame) → `vehicle` (ISO 8855) → `sensor/NAME` for each sensor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import atan2, cos, hypot, pi, radians, sin
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from candaemon.evaluation.detection_columns import NO_OBSTACLE, detection_columns
from candaemon.evaluation.tables import STATES
from candaemon.exports.extras import import_extra
from candaemon.exports.palette import SERIES, components
from candaemon.exports.palette import STATES as STATE_COLOURS
from candaemon.frames.bodies import CLASSES
from candaemon.radar.mounting import SensorView

if TYPE_CHECKING:
    from candaemon.arrays import Floats
    from candaemon.config.sensors import Mount
    from candaemon.ego.georeference import Georeference
    from candaemon.ego.pose import EgoPose
    from candaemon.pipeline.cycle import Cycle
    from candaemon.tracking.obstacles import Obstacles

LOCAL: Final = "local"
VEHICLE: Final = "vehicle"

_LATEST_NS: Final = 2**32 * 1_000_000_000 - 1
"""Latest time that Foxglove's time stamps can tell."""
_HEIGHT, _POINT = 1.5, 0.6  # m, of boxes; of what has no size
_SLOW = 0.5  # m/s, below which there is no arrow
_ARC_STEPS = 24
_OWN = (4.6, 1.8, -1.0)  # m: length and width of the own vehicle as it is drawn, its rear end's x
_CLOUD: Final = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "range_rate", "nis")),
        ("object", "<f8"),  # a sensor may number its objects with more than 32 bits
        ("obstacle", "<i4"),
        ("fate", "u1"),
    ]
)
"""A detection in a point cloud; `obstacle` is −1 where none used it, `fate` a code."""


class SceneMessages:
    """Makes messages; needs the extra `foxglove`.

    Raises:
        ConfigError: it is not installed.
    """

    def __init__(self) -> None:
        self._m = import_extra("foxglove.messages", "foxglove", "a file in MCAP")
        self._colours = [self._m.Color(**_rgb(colour), a=0.7) for colour in STATE_COLOURS]
        self._shade = self._m.Color(**_rgb(SERIES[0]), a=0.15)
        self._shown: set[int] = set()

    def obstacles(self, obstacles: Obstacles) -> Any:
        """Return a `SceneUpdate`: of each obstacle its box, velocity, uncertainty of place (2 σ) and name."""
        m, time = self._m, self._time(obstacles.time_ns)
        gone = self._shown - set(obstacles.id.tolist())
        self._shown = set(obstacles.id.tolist())
        entities = [self._entity(time, *row) for row in _rows(obstacles)]
        deletions = [
            m.SceneEntityDeletion(timestamp=time, type=m.SceneEntityDeletionType.MatchingId, id=str(identity))
            for identity in sorted(gone)
        ]
        return m.SceneUpdate(deletions=deletions, entities=entities)

    def _entity(
        self, time: Any, identity: int, state: int, kind: int, numbers: Sequence[float], ellipse: Sequence[float]
    ) -> Any:
        m = self._m
        x, y, vx, vy, center_x, center_y, heading, length, width = numbers
        speed, known = hypot(vx, vy), length == length and width == width
        size = (length, width, _HEIGHT) if known else (_POINT, _POINT, _POINT)
        yaw = heading if known and heading == heading else 0.0
        box = m.CubePrimitive(
            pose=self._pose(center_x, center_y, size[2] / 2, yaw),
            size=m.Vector3(x=size[0], y=size[1], z=size[2]),
            color=self._colours[state],
        )
        major, minor, turn = ellipse
        spread = m.CylinderPrimitive(
            pose=self._pose(x, y, 0.02, turn),
            size=m.Vector3(x=4 * major, y=4 * minor, z=0.02),
            bottom_scale=1.0,
            top_scale=1.0,
            color=self._shade,
        )
        arrows = []
        if speed > _SLOW:
            arrow = m.ArrowPrimitive(
                pose=self._pose(x, y, size[2] / 2, atan2(vy, vx)),
                shaft_length=speed,  # where it will be in a second
                shaft_diameter=0.2,
                head_length=0.8,
                head_diameter=0.5,
                color=self._colours[state],
            )
            arrows.append(arrow)
        name = m.TextPrimitive(
            pose=self._pose(x, y, size[2] + 0.8, 0.0),
            billboard=True,
            font_size=12.0,
            scale_invariant=True,
            color=self._colours[state],
            text=f"{identity}: {speed * 3.6:.0f} km/h",
        )
        about = {"state": STATES[state], "class": CLASSES[kind]}
        return m.SceneEntity(
            timestamp=time,
            frame_id=VEHICLE,
            id=str(identity),
            metadata=[m.KeyValuePair(key=key, value=value) for key, value in about.items()],
            cubes=[box],
            cylinders=[spread],
            arrows=arrows,
            texts=[name],
        )

    def detections(self, cycle: Cycle, sensors: Sequence[str]) -> Any:
        """Return the detections of a cycle, which has some, as a `PointCloud` in vehicle axes."""
        m, columns = self._m, detection_columns(cycle, sensors)
        cloud = np.zeros(len(columns["object"]), _CLOUD)
        for name in ("x", "y", "range_rate", "nis", "object", "fate"):
            cloud[name] = columns[name]
        identity = np.asarray(columns["id"])
        cloud["obstacle"] = np.where(identity == NO_OBSTACLE, -1, identity)
        kinds = m.PackedElementFieldNumericType
        numeric = {"<f4": kinds.Float32, "<f8": kinds.Float64, "<i4": kinds.Int32, "|u1": kinds.Uint8}
        fields = [
            m.PackedElementField(name=name, offset=_CLOUD.fields[name][1], type=numeric[_CLOUD[name].str])
            for name in _CLOUD.names or ()
            if _CLOUD.fields is not None
        ]
        return m.PointCloud(
            timestamp=self._time(cycle.obstacles.time_ns),
            frame_id=VEHICLE,
            pose=self._pose(0.0, 0.0, 0.0, 0.0),
            point_stride=_CLOUD.itemsize,
            fields=fields,
            data=cloud.tobytes(),
        )

    def pose(self, pose: EgoPose) -> Any:
        """Return the own vehicle's `PoseInFrame` in the local frame."""
        return self._m.PoseInFrame(
            timestamp=self._time(pose.time_ns),
            frame_id=LOCAL,
            pose=self._pose(pose.east, pose.north, 0.0, pose.heading),
        )

    def transforms(self, pose: EgoPose, mounts: Mapping[str, Mount]) -> Any:
        """Return `FrameTransforms`: the vehicle in the local frame, and each sensor on the vehicle."""
        time = self._time(pose.time_ns)
        places = {VEHICLE: (LOCAL, pose.east, pose.north, 0.0, pose.heading)} | {
            f"sensor/{name}": (VEHICLE, mount.x, mount.y, 0.0, radians(mount.yaw_deg)) for name, mount in mounts.items()
        }
        m = self._m
        return m.FrameTransforms(
            transforms=[
                m.FrameTransform(
                    timestamp=time,
                    parent_frame_id=parent,
                    child_frame_id=child,
                    translation=m.Vector3(x=x, y=y, z=z),
                    rotation=self._turn(yaw),
                )
                for child, (parent, x, y, z, yaw) in places.items()
            ]
        )

    def location(self, pose: EgoPose, georeference: Georeference) -> Any:
        """Return the own vehicle's `LocationFix`."""
        latitude, longitude = georeference.to_earth(np.array([pose.east]), np.array([pose.north]))
        return self._fix(self._time(pose.time_ns), np.degrees(latitude)[0], np.degrees(longitude)[0], {})

    def locations(self, obstacles: Obstacles, georeference: Georeference) -> Any:
        """Return the obstacles' places on earth as `LocationFixes`."""
        time = self._time(obstacles.time_ns)
        latitude, longitude = map(np.degrees, georeference.to_earth(obstacles.east, obstacles.north))
        places = zip(obstacles.id.tolist(), latitude.tolist(), longitude.tolist(), strict=True)
        return self._m.LocationFixes(
            fixes=[self._fix(time, north, east, {"id": str(identity)}) for identity, north, east in places]
        )

    def _fix(self, time: Any, latitude: float, longitude: float, about: Mapping[str, str]) -> Any:
        m = self._m
        return m.LocationFix(
            timestamp=time,
            frame_id=VEHICLE,
            latitude=float(latitude),
            longitude=float(longitude),
            position_covariance_type=m.LocationFixPositionCovarianceType.Unknown,
            metadata=[m.KeyValuePair(key=key, value=value) for key, value in about.items()],
        )

    def own_vehicle(self, time_ns: int, views: Mapping[str, Sequence[SensorView]]) -> Any:
        """Return a `SceneUpdate` that stays: the own vehicle, and the outline of each field of view."""
        m = self._m
        length, width, rear = _OWN
        body = m.CubePrimitive(
            pose=self._pose(rear + length / 2, 0.0, _HEIGHT / 2, 0.0),
            size=m.Vector3(x=length, y=width, z=_HEIGHT),
            color=m.Color(r=0.3, g=0.3, b=0.3, a=0.8),
        )
        lines = [
            m.LinePrimitive(
                type=m.LinePrimitiveLineType.LineLoop,
                pose=self._pose(0.0, 0.0, 0.0, 0.0),
                thickness=1.0,
                scale_invariant=True,
                points=[m.Point3(x=x, y=y, z=0.0) for x, y in outline(view)],
                color=m.Color(**_rgb(SERIES[k % len(SERIES)]), a=0.8),
            )
            for k, of_sensor in enumerate(views.values())
            for view in of_sensor
        ]
        entity = m.SceneEntity(
            timestamp=self._time(time_ns), frame_id=VEHICLE, id="own", frame_locked=True, cubes=[body], lines=lines
        )
        return m.SceneUpdate(entities=[entity])

    def log(self, time_ns: int, source: str, text: str, *, warning: bool) -> Any:
        """Return a `Log`.

        Args:
            time_ns: of what it tells.
            source: who tells it.
            text: what.
            warning: whether something is wrong.
        """
        level = self._m.LogLevel.Warning if warning else self._m.LogLevel.Info
        return self._m.Log(timestamp=self._time(time_ns), level=level, message=text, name=source)

    def _time(self, time_ns: int) -> Any:
        seconds, rest = divmod(min(max(time_ns, 0), _LATEST_NS), 1_000_000_000)
        return self._m.Timestamp(seconds, rest)

    def _pose(self, x: float, y: float, z: float, yaw: float) -> Any:
        return self._m.Pose(position=self._m.Vector3(x=x, y=y, z=z), orientation=self._turn(yaw))

    def _turn(self, yaw: float) -> Any:
        return self._m.Quaternion(x=0.0, y=0.0, z=sin(yaw / 2), w=cos(yaw / 2))


def _rows(obstacles: Obstacles) -> list[tuple[int, int, int, list[float], list[float]]]:
    """Return of each obstacle: id, state, class, numbers of its box and velocity, semi-axes (1 σ) and turn."""
    named = ("x", "y", "vx", "vy", "center_x", "center_y", "heading", "length", "width")
    numbers = np.stack([getattr(obstacles, name) for name in named], axis=-1)
    columns = (obstacles.id, obstacles.state, obstacles.kind, numbers, ellipses(obstacles.covariance[:, :2, :2]))
    return list(zip(*(column.tolist() for column in columns), strict=True))


def ellipses(covariance: Floats) -> Floats:
    """Return semi-axes (1 σ, the longer first) and the longer one's direction, of covariances (n, 2, 2): (n, 3)."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    middle, half = (a + c) / 2, np.hypot((a - c) / 2, b)
    turn = np.arctan2(2 * b, a - c) / 2
    return np.stack([np.sqrt(middle + half), np.sqrt(np.maximum(middle - half, 0.0)), turn], axis=-1)


def outline(view: SensorView) -> list[tuple[float, float]]:
    """Return the corners of a field of view in vehicle axes, m."""
    mount, field, half = view.mount, view.field, radians(view.field.azimuth_deg)
    angles = np.linspace(view.yaw - half, view.yaw + half, _ARC_STEPS + 1).tolist()
    arc = [(mount.x + field.range * cos(angle), mount.y + field.range * sin(angle)) for angle in angles]
    return arc if half >= pi else [(mount.x, mount.y), *arc]


def _rgb(colour: str) -> dict[str, float]:
    return dict(zip("rgb", components(colour), strict=True))
