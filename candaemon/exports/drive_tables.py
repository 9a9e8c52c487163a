"""The tables of a drive: their columns with kind, unit and meaning, and a cycle as rows of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from candaemon.ego.pose import EgoStatus
from candaemon.evaluation.detection_columns import DETECTION_COLUMNS, FATES, detection_columns
from candaemon.evaluation.tables import STATES, track_columns
from candaemon.frames.bodies import CLASSES
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.tracking.obstacles import STATE_NAMES

Kind: TypeAlias = Literal["integer", "number", "flag", "text"]
Values: TypeAlias = NDArray[Any] | Sequence[Any] | str | float | None
"""A value for each row, one for all of them, or None: unknown."""

UNKNOWN: Final = int(np.iinfo(np.int64).min)
"""Stands for an integer that is not known; it is written as null."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    Attributes:
        name: of the column.
        kind: `integer` (64 bits), `number` (double precision), `flag` or `text` (UTF-8).
        unit: of the values; empty where they have none.
        meaning: what it is, in a sentence.
        names: of a text's codes, where it is given by codes.
    """

    name: str
    kind: Kind
    unit: str
    meaning: str
    names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TableForm:
    """A table: its name, what a row is, and its columns."""

    name: str
    row: str
    columns: tuple[Column, ...]


def _numbers(*described: tuple[str, str, str]) -> tuple[Column, ...]:
    return tuple(Column(name, "number", unit, meaning) for name, unit, meaning in described)


_TIME: Final = (
    Column("time_ns", "integer", "ns", "the instant that the row holds for, in the log's clock, exact"),
    Column("time", "number", "s", "the same, as near as a double comes"),
)

TRACKS: Final = TableForm(
    "tracks",
    "an obstacle in a cycle",
    (
        *_TIME,
        Column("id", "integer", "", "identity of the obstacle, never used again in a run"),
        Column("state", "text", "", f"one of {', '.join(STATE_NAMES)}", STATES),
        *_numbers(
            ("x", "m", "forward, vehicle axes, of the reference point"),
            ("y", "m", "to the left, vehicle axes"),
            ("vx", "m/s", "over ground, along the vehicle's x axis"),
            ("vy", "m/s", "over ground, along the vehicle's y axis"),
            ("ax", "m/s²", "over ground, along the vehicle's x axis"),
            ("ay", "m/s²", "over ground, along the vehicle's y axis"),
            ("east", "m", "local frame"),
            ("north", "m", "local frame"),
            ("ve", "m/s", "over ground, local frame"),
            ("vn", "m/s", "over ground, local frame"),
            ("sx", "m", "one standard deviation of x"),
            ("sy", "m", "one standard deviation of y"),
            ("svx", "m/s", "one standard deviation of vx"),
            ("svy", "m/s", "one standard deviation of vy"),
            ("age", "s", "since its first detection"),
        ),
        Column("objects", "text", "", "detections used in the cycle, sensor:object with ; between"),
        *_numbers(
            ("latitude", "deg", "WGS 84; null where the local frame has no known place on earth"),
            ("longitude", "deg", "WGS 84"),
            ("heading", "rad", "of its front, vehicle axes, positive to the left; null where unknown"),
            ("yaw_rate", "rad/s", "over ground, positive to the left; null where unknown"),
            ("length", "m", "of its box; null where unknown"),
            ("width", "m", "of its box; null where unknown"),
            ("center_x", "m", "of its box, vehicle axes"),
            ("center_y", "m", "of its box, vehicle axes"),
            ("existence", "", "0 to 1"),
        ),
        Column("class", "text", "", f"one of {', '.join(CLASSES)}", CLASSES),
        *_numbers(("class_likelihood", "", "of that class, 0 to 1; null where unknown")),
    ),
)

DETECTIONS: Final = TableForm(
    "detections",
    "an object of a scan that was valid and plausible",
    (
        *_TIME,
        *(
            Column(each.name, each.kind, each.unit, each.meaning, FATES if each.name == "fate" else ())
            for each in DETECTION_COLUMNS
        ),
    ),
)

_EGO_STATES: Final = tuple(status.name.lower() for status in EgoStatus)

CYCLES: Final = TableForm(
    "cycles",
    "a cycle: a scan, or an instant at which obstacles coast",
    (
        *_TIME,
        Column("closed_ns", "integer", "ns", "time of the frame that closed the scan, or of the instant of coasting"),
        Column("sensor", "text", "", "whose scan it is; null without one"),
        Column("detections", "integer", "", "in the scan; null without one"),
        Column("used", "integer", "", "detections that updated or initiated a reflection; null without a scan"),
        Column("tentative", "integer", "", "obstacles in that state"),
        Column("confirmed", "integer", "", "obstacles in that state"),
        Column("coasting", "integer", "", "obstacles in that state"),
        Column("frames", "integer", "", "sent on the output bus"),
        Column("lost", "integer", "", "frames of sensors and own motion lost or refused since the start"),
        *_numbers(
            ("nis", "", "mean normalised innovation squared of the scan's updates; null without any"),
            ("nis_expected", "", "its expectation: mean degrees of freedom"),
        ),
        Column("ego", "text", "", f"own motion is one of {', '.join(_EGO_STATES)}", _EGO_STATES),
        *_numbers(
            ("east", "m", "of the rear axle's centre, local frame; null where own motion is unknown"),
            ("north", "m", "likewise"),
            ("heading", "rad", "from east, positive to the left"),
            ("speed", "m/s", "over ground, along the vehicle's x axis"),
            ("yaw_rate", "rad/s", "positive to the left"),
            ("latitude", "deg", "WGS 84, of the rear axle's centre; null where unknown"),
            ("longitude", "deg", "WGS 84"),
        ),
    ),
)

SUMMARIES: Final = TableForm(
    "summaries",
    "a figure of `--summary`",
    (
        Column("key", "text", "", "its path, such as sensors.front.scans"),
        Column("value", "number", "", "the figure; null where it is none, or a text"),
        Column("text", "text", "", "where it is a text"),
    ),
)

TABLES: Final = {form.name: form for form in (TRACKS, DETECTIONS, CYCLES, SUMMARIES)}
"""The tables by name."""


def track_rows(cycle: Cycle, sensors: Sequence[str]) -> tuple[int, dict[str, Values]]:
    """Return the obstacles of a cycle as rows of `TRACKS`: their number and the columns."""
    obstacles = cycle.obstacles
    columns: dict[str, Values] = dict(track_columns(obstacles, sensors, cycle.georeference))
    return len(obstacles), {**_time(obstacles.time_ns), **columns}


def detection_rows(cycle: Cycle, sensors: Sequence[str]) -> tuple[int, dict[str, Values]]:
    """Return the detections of a cycle as rows of `DETECTIONS`."""
    if cycle.detections is None:
        return 0, {}
    columns: dict[str, Values] = dict(detection_columns(cycle, sensors))
    return len(cycle.detections), {**_time(cycle.detections.time_ns), **columns}


def cycle_row(cycle: Cycle, pipeline: Pipeline, sensors: Sequence[str]) -> dict[str, Values]:
    """Return a cycle as one row of `CYCLES`; it must be the trackers' latest step."""
    obstacles, pose, detections = cycle.obstacles, cycle.pose, cycle.detections
    states = np.bincount(obstacles.state, minlength=len(STATE_NAMES)).tolist()
    row: dict[str, Values] = {
        **_time(obstacles.time_ns),
        "closed_ns": cycle.time_ns,
        "sensor": None if detections is None else sensors[detections.sensor],
        "detections": None if detections is None else len(detections),
        "used": None if detections is None else len(obstacles.used_row),
        **dict(zip(STATE_NAMES, states, strict=True)),
        "frames": len(cycle.frames),
        "lost": pipeline.drops,
        "ego": _EGO_STATES[pose.status],
    }
    update = cycle.update
    if update is not None:
        known = np.isfinite(update.nis)
        if known.any():
            row |= {
                "nis": float(update.nis[known].mean()),
                "nis_expected": float(update.degrees_of_freedom[known].mean()),
            }
    if pose.status is not EgoStatus.LOST:
        row |= {
            "east": pose.east,
            "north": pose.north,
            "heading": pose.heading,
            "speed": pose.velocity_in_vehicle_axes()[0],
            "yaw_rate": pose.yaw_rate,
        }
        if cycle.georeference is not None:
            latitude, longitude = cycle.georeference.to_earth(np.array([pose.east]), np.array([pose.north]))
            row |= {"latitude": float(np.degrees(latitude[0])), "longitude": float(np.degrees(longitude[0]))}
    return row


def summary_rows(figures: Mapping[str, Any]) -> tuple[int, dict[str, Values]]:
    """Return the figures of a summary as rows of `SUMMARIES`: their number and the columns."""
    flat = list(_leaves("", figures))
    numbers = [float(value) if isinstance(value, (int, float)) else np.nan for _, value in flat]
    texts = [value if isinstance(value, str) else None for _, value in flat]
    return len(flat), {"key": [key for key, _ in flat], "value": np.array(numbers), "text": texts}


def _leaves(path: str, branch: Any) -> Sequence[tuple[str, Any]]:
    """Return the leaves of a tree of figures with their paths; members of a list are numbered from 0."""
    match branch:
        case Mapping():
            parts = branch.items()
        case list():
            parts = dict(zip(map(str, range(len(branch))), branch, strict=True)).items()
        case _:
            return [(path, branch)]
    return list(chain.from_iterable(_leaves(f"{path}.{key}" if path else str(key), each) for key, each in parts))


def _time(time_ns: int) -> dict[str, Values]:
    return {"time_ns": time_ns, "time": time_ns / 10**9}


def repeated(values: Values, rows: int) -> NDArray[Any] | Sequence[Any]:
    """Return a value for each row."""
    if values is None or isinstance(values, (str, int, float)):
        return list(repeat(values, rows))
    return values
