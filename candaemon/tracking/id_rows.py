"""What the object ids of sensors stand for, looked up for a scan at once."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from candaemon import compiled
from candaemon.arrays import Indices, Integers

_LARGEST_ID = 4096  # up to which the rows of a sensor's ids stand in a table


class IdRows:
    """Rows by a sensor's object ids, in tables that follow from what is remembered; to be cleared when that changes."""

    def __init__(self) -> None:
        self._tables: dict[int, tuple[Indices, bool]] = {}  # of a sensor: at 1 + id the row, −1 at both ends

    def of(self, row_of: Mapping[tuple[int, int], int], sensor: int, object_id: Integers) -> tuple[Indices, bool]:
        """Return the rows that a sensor's ids stand for, −1: for nothing; and whether no id and no row comes twice.

        Args:
            row_of: row that an object id stands for, by the sensor's number and the id.
            sensor: its number.
            object_id: of a scan (n,).
        """
        table, apart = self._tables.get(sensor) or self._table(row_of, sensor)
        if compiled.in_use and len(table):
            rows, distinct = compiled.kernels.look_up(table, object_id)
        else:
            if len(table):
                rows = table.take(object_id + 1, mode="clip")
            else:
                rows = np.array([row_of.get((sensor, key), -1) for key in object_id.tolist()], dtype=np.intp)
            distinct = bool((object_id[1:] > object_id[:-1]).all())
        distinct = distinct or len(set(object_id.tolist())) == len(object_id)
        if distinct and not apart:
            found = rows[rows >= 0].tolist()
            distinct = len(set(found)) == len(found)
        return rows, distinct

    def clear(self) -> None:
        """Forget the tables."""
        self._tables.clear()

    def _table(self, row_of: Mapping[tuple[int, int], int], sensor: int) -> tuple[Indices, bool]:
        """Return the rows of a sensor's ids, none where an id is too large; and whether no row comes twice."""
        rows = {key: row for (of, key), row in row_of.items() if of == sensor}
        apart = len(set(rows.values())) == len(rows)
        if max(rows, default=0) >= _LARGEST_ID or min(rows, default=0) < 0:
            table = np.empty(0, dtype=np.intp)
        else:
            table = np.full(max(rows, default=0) + 3, -1, dtype=np.intp)
            table[np.fromiter(rows, np.intp, len(rows)) + 1] = np.fromiter(rows.values(), np.intp, len(rows))
        self._tables[sensor] = table, apart
        return table, apart
