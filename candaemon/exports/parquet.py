"""Tables as Parquet files: columns are gathered and written some ten thousand rows at a time."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from candaemon.exports.drive_sink import DriveSink
from candaemon.exports.drive_tables import (
    CYCLES,
    DETECTIONS,
    TRACKS,
    UNKNOWN,
    Column,
    TableForm,
    Values,
    cycle_row,
    detection_rows,
    repeated,
    track_rows,
)
from candaemon.exports.extras import import_extra
from candaemon.files.outputs import OutputFile

if TYPE_CHECKING:
    from collections.abc import Sequence

    from candaemon.pipeline.cycle import Cycle
    from candaemon.pipeline.pipeline import Pipeline

ROWS_A_GROUP: Final = 1 << 16
"""Rows that are held in memory and written at once, at least."""
SUFFIX: Final = ".parquet"
"""What the name of a file of this format ends in."""


class ParquetTable:
    """A Parquet file of one table, finished by `close` or a `with` block.

    The schema says the unit and the meaning of each column in the field's metadata (`unit`, `description`), and what a
    row is in its own (`row`). What is not known is null. The same rows give the same bytes with the same pyarrow.

    Args:
        file: where it is written.
        form: of the table.
        constants: further columns of text before the others, with the one value that they have in this file.

    Raises:
        ConfigError: pyarrow is not installed.
    """

    def __init__(self, file: OutputFile, form: TableForm, constants: Mapping[str, str] | None = None) -> None:
        self._arrow = import_extra("pyarrow", "parquet", "a table in Parquet")
        parquet = import_extra("pyarrow.parquet", "parquet", "a table in Parquet")
        self._constants = dict(constants or {})
        further = tuple(Column(name, "text", "", "the same in the whole file") for name in self._constants)
        self._columns = (*further, *form.columns)
        self._schema = self._make_schema(form)
        self._stream = file.stream
        self._writer = parquet.ParquetWriter(self._stream, self._schema, compression="zstd")
        self._waiting: dict[str, list[NDArray[Any]]] = {column.name: [] for column in self._columns}
        self._rows = 0
        self._closed = False

    def add(self, rows: int, columns: Mapping[str, Values]) -> None:
        """Add rows.

        Args:
            rows: their number.
            columns: by name, each with `rows` values, or one for all. Of a text with `names` they may be codes. What is
                left out is null in these rows, as are `UNKNOWN`, None and numbers that are not finite.

        Raises:
            ValueError: a column that the table does not have, or of another length.
        """
        strange = columns.keys() - self._waiting.keys()
        if strange:
            raise ValueError(f"no such columns: {sorted(strange)}")
        if not rows:
            return
        for column in self._columns:
            given = self._constants.get(column.name) if column.name in self._constants else columns.get(column.name)
            values = _values(column, given, rows)
            if len(values) != rows:
                raise ValueError(f"{len(values)} values of {column.name}, expected {rows}")
            self._waiting[column.name].append(values)
        self._rows += rows
        if self._rows >= ROWS_A_GROUP:
            self._write()

    def close(self) -> None:
        """Write what is still held and the file's end; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        self._write()
        self._writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write(self) -> None:
        """Write the rows that are held as one group."""
        if not self._rows:
            return
        arrays = [self._array(column, np.concatenate(self._waiting[column.name])) for column in self._columns]
        self._writer.write_table(self._arrow.Table.from_arrays(arrays, schema=self._schema), row_group_size=self._rows)
        for values in self._waiting.values():
            values.clear()
        self._rows = 0

    def _array(self, column: Column, values: NDArray[Any]) -> Any:
        """Return values as a column of Arrow, null where they are unknown."""
        arrow, form = self._arrow, self._schema.field(column.name).type
        match column.kind:
            case "number":
                return arrow.array(values, form, mask=~np.isfinite(values))
            case "integer":
                return arrow.array(values, form, mask=values == UNKNOWN)
            case "text" if column.names:
                named = arrow.array(column.names, form)
                return named.take(arrow.array(values, arrow.int64(), mask=values == UNKNOWN))
            case _:
                return arrow.array(values, form)

    def _make_schema(self, form: TableForm) -> Any:
        arrow = self._arrow
        kinds = {
            "integer": arrow.int64(),
            "number": arrow.float64(),
            "flag": arrow.bool_(),
            "text": arrow.string(),
        }
        fields = [
            arrow.field(column.name, kinds[column.kind], metadata={"unit": column.unit, "description": column.meaning})
            for column in self._columns
        ]
        return arrow.schema(fields, metadata={"table": form.name, "row": form.row, "candaemon": "1"})


def _values(column: Column, given: Values, rows: int) -> NDArray[Any]:
    """Return a column's values as an array of its kind."""
    single = given is None or isinstance(given, (int, float))
    match column.kind:
        case "number":
            return np.full(rows, np.nan if given is None else given) if single else np.asarray(given, np.float64)
        case "integer":
            return np.full(rows, UNKNOWN if given is None else given) if single else np.asarray(given, np.int64)
        case "text" if column.names:
            return _codes(column.names, repeated(given, rows))
        case _:
            return np.asarray(repeated(given, rows), np.object_)


def _codes(names: tuple[str, ...], given: NDArray[Any] | Sequence[Any]) -> NDArray[Any]:
    """Return codes as they are, names as their codes, None as unknown."""
    if isinstance(given, np.ndarray):
        return given.astype(np.int64)
    return np.array([UNKNOWN if each is None else names.index(each) for each in given], np.int64)


class ParquetDrive(DriveSink):
    """Writes the tables of a drive while it is replayed.

    Args:
        sensors: names by index.
        tracks, detections, cycles: the tables to write; one left out is not written.
    """

    def __init__(
        self,
        sensors: Sequence[str],
        *,
        tracks: ParquetTable | None = None,
        detections: ParquetTable | None = None,
        cycles: ParquetTable | None = None,
    ) -> None:
        self._sensors = tuple(sensors)
        self._tracks, self._detections, self._cycles = tracks, detections, cycles

    @classmethod
    def of_files(
        cls,
        sensors: Sequence[str],
        tracks: OutputFile,
        detections: OutputFile,
        cycles: OutputFile,
        *,
        constants: Mapping[str, str] | None = None,
    ) -> ParquetDrive:
        """Begin all three tables, each with the same constants (see `ParquetTable`)."""
        return cls(
            sensors,
            tracks=ParquetTable(tracks, TRACKS, constants),
            detections=ParquetTable(detections, DETECTIONS, constants),
            cycles=ParquetTable(cycles, CYCLES, constants),
        )

    def add_cycle(self, cycle: Cycle, pipeline: Pipeline) -> None:
        """Add the cycle, and its detections."""
        if self._cycles is not None:
            self._cycles.add(1, cycle_row(cycle, pipeline, self._sensors))
        if self._detections is not None:
            self._detections.add(*detection_rows(cycle, self._sensors))

    def add_obstacles(self, cycle: Cycle) -> None:
        """Add the obstacles of a cycle."""
        if self._tracks is not None:
            self._tracks.add(*track_rows(cycle, self._sensors))

    def finish(self) -> None:
        """Close the tables."""
        for table in (self._tracks, self._detections, self._cycles):
            if table is not None:
                table.close()
