"""Messages in JSON for what Foxglove has no schema of: CAN frames, obstacles as numbers, cycles."""

from __future__ import annotations

import json
from collections.abc import Mapping
from math import isfinite
from typing import Any, Final

import numpy as np

from candaemon.exports.drive_tables import CYCLES, TRACKS, UNKNOWN, Column, TableForm, Values, repeated
from candaemon.frames.frame import EXTENDED, Frame

_KINDS: Final = {"integer": "integer", "number": "number", "flag": "boolean", "text": "string"}
_STAMP: Final = {
    "type": "object",
    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
    "required": ["sec", "nsec"],
}


def _schema(title: str, about: str, properties: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "title": title,
        "description": about,
        "type": "object",
        "properties": {"timestamp": _STAMP, **properties},
        "required": ["timestamp", *properties],
        "additionalProperties": False,
    }


def _row(form: TableForm) -> dict[str, Any]:
    """Return the properties of a row of a table, those of time left out."""
    return {column.name: _property(column) for column in form.columns if column.name not in {"time", "time_ns"}}


def _property(column: Column) -> dict[str, Any]:
    about = f"{column.meaning} ({column.unit})" if column.unit else column.meaning
    return {"type": [_KINDS[column.kind], "null"], "description": about}


CAN_FRAME: Final = _schema(
    "candaemon.CanFrame",
    "A CAN data frame.",
    {
        "bus": {"type": "string", "description": "its name in the configuration"},
        "id": {"type": "integer", "minimum": 0, "maximum": 0x1FFF_FFFF, "description": "identifier"},
        "extended": {"type": "boolean", "description": "whether the identifier has 29 bits"},
        "fd": {"type": "boolean", "description": "whether it is a CAN FD frame"},
        "data": {"type": "string", "pattern": "^([0-9a-f]{2})*$", "description": "payload in hexadecimal digits"},
    },
)
"""JSON Schema of a frame."""

OBSTACLE_ROWS: Final = _schema(
    "candaemon.Obstacles",
    "The obstacles of a cycle as numbers, for plots: /obstacles/states.obstacles[:]{id==7}.vx",
    {
        "obstacles": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": (_obstacle := _row(TRACKS)),
                "required": list(_obstacle),
                "additionalProperties": False,
            },
        }
    },
)
"""JSON Schema of the obstacles of a cycle."""

CYCLE_ROW: Final = _schema("candaemon.Cycle", "Figures of a cycle.", _row(CYCLES))
"""JSON Schema of a cycle."""


def stamp(time_ns: int) -> dict[str, int]:
    """Return a time as Foxglove has it in JSON."""
    seconds, rest = divmod(time_ns, 1_000_000_000)
    return {"sec": seconds, "nsec": rest}


def can_frame(frame: Frame, bus: str) -> bytes:
    """Return a frame as `CAN_FRAME` says; the bus's name holds nothing that JSON escapes."""
    seconds, rest = divmod(frame.time_ns, 1_000_000_000)
    extended = "true" if frame.can_id & EXTENDED else "false"
    return (
        f'{{"timestamp":{{"sec":{seconds},"nsec":{rest}}},"bus":"{bus}","id":{frame.can_id & ~EXTENDED},'
        f'"extended":{extended},"fd":{"true" if frame.fd else "false"},"data":"{frame.data.hex()}"}}'
    ).encode()


def obstacle_rows(time_ns: int, rows: int, columns: Mapping[str, Values]) -> bytes:
    """Return rows of the table of tracks as `OBSTACLE_ROWS` says."""
    listed = {column.name: _listed(column, columns.get(column.name), rows) for column in TRACKS.columns}
    names = [name for name in listed if name not in {"time", "time_ns"}]
    members = [dict(zip(names, row, strict=True)) for row in zip(*(listed[name] for name in names), strict=True)]
    return _text({"timestamp": stamp(time_ns), "obstacles": members})


def cycle_row(time_ns: int, columns: Mapping[str, Values]) -> bytes:
    """Return a row of the table of cycles as `CYCLE_ROW` says."""
    row = {
        column.name: _listed(column, columns.get(column.name), 1)[0]
        for column in CYCLES.columns
        if column.name not in {"time", "time_ns"}
    }
    return _text({"timestamp": stamp(time_ns), **row})


def _listed(column: Column, given: Values, rows: int) -> list[Any]:
    """Return a column's values as JSON has them: None for what is unknown, names for codes."""
    values = repeated(given, rows)
    plain = values.tolist() if isinstance(values, np.ndarray) else list(values)
    if column.names and isinstance(values, np.ndarray):
        return [column.names[code] for code in plain]
    if column.kind == "number":
        return [value if value is not None and isfinite(value) else None for value in plain]
    return [None if value == UNKNOWN else value for value in plain]


def _text(message: Mapping[str, Any]) -> bytes:
    return json.dumps(message, separators=(",", ":"), allow_nan=False, ensure_ascii=False).encode()
