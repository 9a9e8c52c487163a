"""Reflections and obstacles as structures of arrays.

A reflection is one detected point with a filter of its own; an obstacle is one vehicle, the reflections that move
together. Rows keep the order of initiation, so the first row of an obstacle is its oldest reflection.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Integers


class Table:
    """Base of the structures of arrays: rows are appended and dropped in all columns at once."""

    __slots__ = ()

    def append(self, **columns: NDArray[np.generic]) -> None:
        """Append rows; every column is given."""
        for name, values in columns.items():
            setattr(self, name, np.concatenate([getattr(self, name), values]))

    def keep(self, rows: Booleans) -> None:
        """Keep the given rows."""
        for column in fields(self):  # type: ignore[arg-type]  # every table is a dataclass
            setattr(self, column.name, getattr(self, column.name)[rows])


def _integers() -> Integers:
    return np.zeros(0, dtype=np.int64)


@dataclass(slots=True)
class ReflectionTable(Table):
    """Columns of the reflections.

    Attributes:
        sensor: index of the sensor that reported it last.
        object_id: that sensor's own id, −1 where it tells none, or once the id has gone to something else.
        obstacle: row of its obstacle.
        last_ns: when it was last detected.
    """

    sensor: Integers = field(default_factory=_integers)
    object_id: Integers = field(default_factory=_integers)
    obstacle: Integers = field(default_factory=_integers)
    last_ns: Integers = field(default_factory=_integers)

    def __len__(self) -> int:
        return len(self.sensor)


@dataclass(slots=True)
class ObstacleTable(Table):
    """Columns of the obstacles.

    Attributes:
        id: identity.
        first_ns, last_ns: first and latest detection.
        history: bit 0 the latest scan, set where it was detected.
        scans: scans since its initiation.
        confirmed: whether it ever was.
        leader: row of the reflection that carries the reference point.
        offset: reference point minus leader, along and across the travel, m.
        direction: unit vector along which it travels, one way or the other, local frame.
        forward: 1 where it last drove that way, −1 the other way, 0 where it has not driven yet.
        alongside_ns: time for which it has been a merge candidate: alongside of an older obstacle.
        sensors: bit k set where sensor k detected it.
    """

    id: Integers = field(default_factory=_integers)
    first_ns: Integers = field(default_factory=_integers)
    last_ns: Integers = field(default_factory=_integers)
    history: Integers = field(default_factory=_integers)
    scans: Integers = field(default_factory=_integers)
    confirmed: Booleans = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    leader: Integers = field(default_factory=_integers)
    offset: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    direction: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    forward: Floats = field(default_factory=lambda: np.zeros(0))
    alongside_ns: Integers = field(default_factory=_integers)
    sensors: Integers = field(default_factory=_integers)

    def __len__(self) -> int:
        return len(self.id)


def longer_ago(last_ns: Integers, time_ns: int, longest: float) -> Booleans | None:
    """Return of what the latest detection (n,) is longer ago than a time, s; None: of nothing.

    Args:
        last_ns: when that was (n,).
        time_ns: the present.
        longest: the time, s.
    """
    if compiled.in_use:
        return compiled.kernels.longer_ago(last_ns, time_ns, longest)
    if not len(last_ns) or (time_ns - int(last_ns.min())) * 1e-9 <= longest:
        return None
    return np.asarray((time_ns - last_ns) * 1e-9 > longest)
