"""A scenario's settings and their YAML file: trajectories, stationary objects, measurement and transmission effects.

A scenario is given in *its own axes*: the vehicle axes of the ego at time 0 (x forward, y left, at rest over
ground). `ego.start` places them on earth. Speeds and accelerations are over ground.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from candaemon.config.base import Location, Settings
from candaemon.config.load import join_problems
from candaemon.config.names import Name
from candaemon.config.yaml_text import read_yaml
from candaemon.printable import LONGEST_SHOWN, printable
from candaemon.simulation.effects import OwnMotionFaults, SensorFault, TrafficEffects, TransmissionFaults

LONGEST_DRIVE: Final = 86_400.0
"""s, a day."""
MOST_ACTORS: Final = 1000
"""Other road users in a scenario."""
MOST_POSTS: Final = 10_000
"""Stationary points in a scenario, those of rails, parked cars and bridges among them."""
MOST_SILENCES: Final = 1000
"""Times in which a source of ego motion is silent, in a scenario."""
MOST_SENSOR_FAULTS: Final = 1000
"""Times in which a sensor fails, in a scenario."""

_NARROW, _SHORT, _LONG = 1.2, 1.2, 6.5
"""m: a two-wheeler is narrower, a pedestrian also shorter, a car is shorter than a truck."""

Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]
"""m in the scenario's axes."""


class LaneChange(Settings):
    """A lateral move along a fifth-order polynomial, with zero lateral velocity and acceleration at both ends."""

    offset: float = Field(ge=-20, le=20, description="m, to the left of the heading at its start")
    duration: float = Field(gt=0.2, le=60, description="s")


class Segment(Settings):
    """A section of a trajectory: along the heading (speed, acceleration, yaw rate, lane change) or by axes (ax, ay).

    It ends after `duration`, at `until`, with its lane change, or, with both a `speed` and an `acceleration`, when that
    speed is reached. Without an end it lasts as long as the scenario. A vehicle that brakes to 0 along its heading
    stands still for the rest of its segment; only a `speed` below 0 makes it drive backwards.
    """

    duration: float | None = Field(None, gt=0, le=LONGEST_DRIVE, description="s")
    until: float | None = Field(None, gt=0, le=LONGEST_DRIVE, description="s since the scenario's start")
    speed: float | None = Field(None, ge=-20, le=100, description="m/s, reached by an even ramp; below 0: backwards")
    acceleration: float | None = Field(None, ge=-15, le=15, description="m/s² along the heading")
    yaw_rate_deg: float = Field(0.0, ge=-90, le=90, description="deg/s, positive to the left")
    lane_change: LaneChange | None = None
    ax: float | None = Field(None, ge=-20, le=20, description="m/s² along the scenario's x axis")
    ay: float | None = Field(None, ge=-20, le=20, description="m/s² along the scenario's y axis")

    @model_validator(mode="after")
    def _is_one_kind_of_motion(self) -> Segment:
        along = self.speed is not None or self.acceleration is not None or self.yaw_rate_deg != 0.0
        if self.by_axes and (along or self.lane_change is not None):
            raise ValueError("ax and ay stand alone; leave out speed, acceleration, yaw_rate_deg and lane_change")
        if self.lane_change is not None and (self.yaw_rate_deg != 0.0 or self.speed is not None):
            raise ValueError(
                "a lane change goes with acceleration only; give speed or yaw_rate_deg a segment of its own"
            )
        ends = [self.duration is not None, self.until is not None, self.lane_change is not None]
        if sum(ends) > 1:
            raise ValueError("one end only; give one of: duration, until, lane_change")
        if self.speed is not None and any(ends) == (self.acceleration is not None):
            raise ValueError("to reach a speed give either duration (or until) or acceleration")
        return self

    @property
    def by_axes(self) -> bool:
        """Whether the motion is given along fixed axes rather than along the heading."""
        return self.ax is not None or self.ay is not None

    @property
    def open_ended(self) -> bool:
        """Whether the segment has no defined end."""
        timed = self.duration is not None or self.until is not None
        return not timed and self.lane_change is None and self.speed is None


def _checked(segments: tuple[Segment, ...]) -> None:
    """Raise a ValueError where a segment could never begin."""
    reached = 0.0
    for number, segment in enumerate(segments):
        if segment.open_ended and number + 1 < len(segments):
            raise ValueError(f"segment {number + 1} has no end but is not the last; give it a duration or until")
        if segment.until is not None:
            if segment.until <= reached:
                raise ValueError(f"segment {number + 1} ends at {segment.until:g} s, before it begins at {reached:g} s")
            reached = segment.until


class EgoStart(Settings):
    """Initial position, heading and speed of the ego; the scenario's axes start there."""

    latitude: float = Field(48.0, ge=-89, le=89, description="deg, of the level frame's origin")
    longitude: float = Field(11.0, ge=-180, le=180, description="deg, of the level frame's origin")
    east: float = Field(0.0, ge=-1e5, le=1e5, description="m from the origin")
    north: float = Field(0.0, ge=-1e5, le=1e5, description="m from the origin")
    heading_deg: float = Field(90.0, ge=-360, le=360, description="deg clockwise from north")
    speed: float = Field(0.0, ge=-20, le=100, description="m/s; below 0: backwards")


MotionQuantity = Literal[
    "latitude", "longitude", "velocity_north", "velocity_east", "speed", "heading", "yaw_rate", "curvature", "slip",
    "ax", "ay", "valid", "left_wheels", "right_wheels",
]  # fmt: skip
"""What a source of ego motion sends, by the names of its signals in a configuration."""


class Silence(Settings):
    """A time in which a source of ego motion does not send a quantity."""

    quantity: MotionQuantity
    begin: float = Field(ge=-10, le=1e5, description="s")
    end: float = Field(ge=-10, le=1e5, description="s")

    @model_validator(mode="after")
    def _ends_after_it_began(self) -> Silence:
        if self.end <= self.begin:
            raise ValueError(f"end {self.end:g} is not after begin {self.begin:g}")
        return self


class EgoMotionSensors(Settings):
    """Rate and errors of the sensors that measure the ego motion, and when they are silent.

    A message is not sent where one of its quantities is silent.
    """

    rate: float = Field(100.0, ge=1, le=1000, description="Hz")
    noise: float = Field(1.0, ge=0, le=10, description="times the standard deviations of the configuration's ego")
    drift_time: float = Field(10.0, gt=0, le=1000, description="s, correlation time of an INS's errors")
    yaw_rate_bias_deg: float = Field(0.0, ge=-5, le=5, description="deg/s, of odometry")
    speed_offset: float = Field(0.0, ge=-2, le=2, description="m/s, of the speedometer, not of the wheels")
    speed_factor: float = Field(1.0, ge=0.8, le=1.2, description="of wheels and speedometer")
    silent_below: dict[MotionQuantity, Annotated[float, Field(gt=0, le=100)]] = Field(
        default_factory=dict, description="m/s, by quantity: not sent by a vehicle that is slower; default: always sent"
    )
    silent: tuple[Silence, ...] = Field(
        (), max_length=MOST_SILENCES, description="times in which a quantity is not sent"
    )
    faults: OwnMotionFaults | None = Field(None, description="default: none")


class Ego(Settings):
    """The vehicle that carries the sensors."""

    start: EgoStart = Field(default_factory=EgoStart)
    segments: tuple[Segment, ...] = ()
    own_motion: EgoMotionSensors = Field(default_factory=EgoMotionSensors)

    @model_validator(mode="after")
    def _segments_follow(self) -> Ego:
        _checked(self.segments)
        return self


class Start(Settings):
    """An actor's centre and velocity at time 0, in the scenario's axes, over ground."""

    x: Coordinate = Field(description="m")
    y: Coordinate = Field(description="m")
    vx: float | None = Field(None, ge=-100, le=100, description="m/s")
    vy: float | None = Field(None, ge=-100, le=100, description="m/s")
    speed: float | None = Field(None, ge=-20, le=100, description="m/s along the heading; below 0: backwards")
    heading_deg: float = Field(0.0, ge=-360, le=360, description="deg to the left of the scenario's x axis")

    @model_validator(mode="after")
    def _has_one_velocity(self) -> Start:
        by_axes = self.vx is not None or self.vy is not None
        if by_axes and (self.speed is not None or self.heading_deg != 0.0):
            raise ValueError("give a velocity either as vx and vy or as speed and heading_deg")
        return self


class Size(Settings):
    """An actor's outline; 0 × 0 is a point."""

    length: float = Field(4.5, ge=0, le=30, description="m")
    width: float = Field(1.8, ge=0, le=5, description="m")

    @model_validator(mode="after")
    def _both_or_neither(self) -> Size:
        if (self.length == 0.0) != (self.width == 0.0):
            raise ValueError("a point has length 0 and width 0; an outline has both above 0")
        return self


RoadUser = Literal["car", "truck", "two-wheeler", "pedestrian"]


class Actor(Settings):
    """Another road user."""

    name: Name
    start: Start
    segments: tuple[Segment, ...] = ()
    size: Size = Field(default_factory=Size)
    road_user: RoadUser | None = Field(None, description="its class in the truth; default: what its size suggests")
    reflections: int | None = Field(
        None, ge=1, le=8, description="objects it can be reported as; a point is always one; default: 2, or as drawn"
    )
    reflections_range: float = Field(
        70.0,
        gt=0,
        le=500,
        description="m up to which the second one is seen; the third half as far, with traffic two thirds, …",
    )

    @model_validator(mode="after")
    def _segments_follow(self) -> Actor:
        _checked(self.segments)
        return self

    @property
    def kind(self) -> str:
        """Its class, as in `candaemon.frames.bodies.CLASSES`: that of its settings, or what its size suggests."""
        if self.road_user is not None:
            return self.road_user
        if self.size.length == 0.0:
            return "unknown"
        if self.size.width < _NARROW:
            return "pedestrian" if self.size.length < _SHORT else "two-wheeler"
        return "car" if self.size.length < _LONG else "truck"


class Post(Settings):
    """A sign, pole or other stationary point, in the scenario's axes."""

    x: Coordinate = Field(description="m")
    y: Coordinate = Field(description="m")


class PostRow(Settings):
    """Things at even distances, in the scenario's axes."""

    begin: Post
    end: Post
    spacing: float = Field(4.0, gt=0.5, le=100, description="m between them")

    @property
    def spans(self) -> int:
        """How many times two of them are neighbours."""
        return max(round(math.hypot(self.end.x - self.begin.x, self.end.y - self.begin.y) / self.spacing), 1)


class Rail(PostRow):
    """A guard rail: posts at even distances."""


class ParkedRow(PostRow):
    """Parked cars, along the sides that face the road: both ends and the middle of each reflect, and hide nothing."""

    spacing: float = Field(6.5, gt=0.5, le=100, description="m from car to car")


class Bridge(PostRow):
    """A bridge across the road: seen from afar, and passed under."""

    spacing: float = Field(3.0, gt=0.5, le=100, description="m between its reflections")
    near: float = Field(40.0, ge=0, le=1000, description="m from which on it is above what the sensor sees")
    far: float = Field(150.0, ge=0, le=1000, description="m up to which it is seen")


class Drain(Post):
    """A drain or an expansion joint: flat and weak, seen from near by and not in every scan."""

    far: float = Field(40.0, ge=0, le=1000, description="m up to which it is seen")
    detection: float = Field(0.5, ge=0, le=1, description="times the probability of detection")


class Stationary(Settings):
    """Stationary objects. Each is a point reflector, or several, and occludes nothing."""

    posts: tuple[Post, ...] = ()
    rails: tuple[Rail, ...] = ()
    parked: tuple[ParkedRow, ...] = ()
    bridges: tuple[Bridge, ...] = ()
    drains: tuple[Drain, ...] = ()

    @model_validator(mode="after")
    def _are_not_too_many(self) -> Stationary:
        rows = sum(row.spans + 1 for row in (*self.rails, *self.bridges)) + sum(3 * (r.spans + 1) for r in self.parked)
        count = len(self.posts) + len(self.drains) + rows
        if count > MOST_POSTS:
            raise ValueError(f"found {count:,} posts in all, expected {MOST_POSTS:,} at most; space the rails wider")
        return self


class NoiseOverride(Settings):
    """Standard deviations of the simulated noise, in place of those in the sensor's configuration."""

    x: float | None = Field(None, ge=0, le=100, description="m")
    y: float | None = Field(None, ge=0, le=100, description="m")
    range: float | None = Field(None, ge=0, le=100, description="m")
    azimuth_deg: float | None = Field(None, ge=0, le=90, description="deg")
    range_rate: float | None = Field(None, ge=0, le=100, description="m/s")
    vx: float | None = Field(None, ge=0, le=100, description="m/s")
    vy: float | None = Field(None, ge=0, le=100, description="m/s")
    ax: float = Field(0.3, ge=0, le=100, description="m/s²; the configuration names none")


class MeasurementEffects(Settings):
    """Detection, clutter, noise, occlusion and slot behaviour of the sensors."""

    detection_probability: float = Field(0.95, gt=0, le=1, description="of each visible reflection in each scan")
    clutter: float = Field(0.5, ge=0, le=50, description="mean false objects a scan, uniform over the field of view")
    clutter_persistence: float = Field(
        0.05, ge=0, lt=1, description="probability that a false object is there in the next scan too"
    )
    noise: NoiseOverride = Field(default_factory=NoiseOverride)
    occlusion: bool = Field(True, description="nearer actors hide what is behind them")
    drift: float = Field(
        0.15, ge=0, le=1, description="m, how far a reflection wanders on its outline (standard deviation)"
    )
    missing: Literal["invalid", "coast"] = Field(
        "invalid", description="a missed object: an invalid slot, or one moved on"
    )
    hold: int = Field(3, ge=0, le=50, description="scans a visible but missed object keeps its slot")
    slot_reuse: float = Field(
        0.4, ge=0, le=1, description="probability that a new object takes a slot freed in the same scan"
    )
    turned_deg: float = Field(
        0.0, ge=-45, le=45, description="deg to the left, by which sensors are turned beyond their configured mounting"
    )
    cycle_jitter: float = Field(0.001, ge=0, le=0.02, description="s, standard deviation of the measurement's instant")
    traffic: TrafficEffects | None = Field(
        None, description="what measurements of traffic show beyond that; default: fixed reflections with white noise"
    )


class Transmission(Settings):
    """Timing, order and loss of the frames on their way to the log."""

    burst: float = Field(
        0.017, ge=0, le=0.5, description="s from a scan's first frame to its last; at most 40 % of its cycle"
    )
    order: Literal["shuffled", "slots"] = Field("shuffled", description="order of a scan's object frames")
    loss: float = Field(0.0, ge=0, lt=1, description="probability that a frame is lost")
    jitter: float = Field(0.0, ge=0, le=0.05, description="s, mean delay of a frame's time stamp")
    latency: float = Field(0.0, ge=0, le=0.5, description="s of a sensor's latency that its configuration does not say")
    clock_drift: float = Field(
        2e-5, ge=-1e-3, le=1e-3, description="by which the clocks that sensors stamp their scans with go fast"
    )
    faults: TransmissionFaults | None = Field(None, description="default: none")


class Scenario(Settings):
    """A drive to simulate."""

    duration: float = Field(gt=0, le=LONGEST_DRIVE, description="s")
    seed: int = Field(1, ge=0, lt=2**63, description="default seed")
    start_time: float = Field(1_700_000_000.0, ge=0, le=4e9, description="s since 1970, the log's time of time 0")
    ego: Ego = Field(default_factory=Ego)
    actors: tuple[Actor, ...] = Field((), max_length=MOST_ACTORS)
    stationary: Stationary = Field(default_factory=Stationary)
    measurement: MeasurementEffects = Field(default_factory=MeasurementEffects)
    frames: Transmission = Field(default_factory=Transmission)
    sensor_faults: tuple[SensorFault, ...] = Field(
        (), max_length=MOST_SENSOR_FAULTS, description="times in which sensors fail"
    )

    @model_validator(mode="after")
    def _names_differ(self) -> Scenario:
        names = [actor.name for actor in self.actors]
        twice = sorted(name for name, count in Counter(names).items() if count > 1)
        if twice:
            raise ValueError(f"two actors are named '{twice[0]}'; give each a name of its own")
        return self


def load_scenario(path: Path) -> Scenario:
    """Load and check a scenario.

    Args:
        path: the YAML file.

    Raises:
        ConfigError: names every problem with file, line, key, what was found and what was expected.

    """
    path = Path(path)
    data, lines = read_yaml(path)
    try:
        return Scenario.model_validate(data, strict=True)
    except ValidationError as error:
        raise join_problems(path, error, lines, _problem) from None


def _problem(details: ErrorDetails, _lines: Mapping[Location, int]) -> Iterator[tuple[Location, str]]:
    """Convert one of pydantic's errors to its location and text."""
    given = details["input"]
    value_error = details["type"] == "value_error"
    what = str(details["ctx"]["error"]) if value_error else _expected(details["type"], details["msg"])
    shown = isinstance(given, str | int | float) and not what.startswith("found ")
    found = f"; found {printable(repr(given), LONGEST_SHOWN)}" if shown else ""
    yield details["loc"], f"{what}{found}"


def _expected(kind: str, message: str) -> str:
    """Return what was expected instead, as text."""
    match kind:
        case "missing":
            return "missing; add it"
        case "extra_forbidden":
            return "a scenario has no such key here; check its spelling, or remove it"
        case _:
            return re.sub("^(Input|String|Tuple) should (be|have)", "expected", message)
