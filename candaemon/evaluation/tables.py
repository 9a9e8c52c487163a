"""The table that `--tracks` and `--truth` share, and those of predictions and origins: read and written as CSV.

One row an obstacle (or a true object) a cycle; a path that ends in `.gz` is compressed. Columns, in this order:

=================  ====================================================================================
`time`             s, decimal, exact to the ns; kept as integer ns. The time the row is valid for.
`id`               integer, never reused in a file.
`state`            tracks: `tentative`, `confirmed`, `coasting`; truth: `actor` (some sensor can see it),
                   `hidden` (an actor outside of every field of view or fully occluded), `stationary`.
`x` `y`            m, vehicle axes (ISO 8855: x forward, y left).
`vx` `vy`          m/s over ground, vehicle axes.
`ax` `ay`          m/s² over ground, vehicle axes.
`east` `north`     m, local frame.
`ve` `vn`          m/s over ground, local frame.
`sx` … `svy`       one standard deviation of x, y, vx, vy; empty in truth.
`age`              s since the first detection; empty in truth.
`objects`          detections used in the cycle, `sensor:object` with `;` between; may be empty in truth.
=================  ====================================================================================

None of the above may be missing. A table may have more of these, after them:

=====================  ================================================================================
`latitude` `longitude` deg, WGS 84: tracks where `ego.gnss` georeferences the local frame; not read.
`heading`              rad, direction of the body's x axis in vehicle axes; empty where it is unknown or there is none.
`yaw_rate`             rad/s over ground, positive to the left.
`length` `width`       m, the body's box; 0 for a point.
`center_x` `center_y`  m, vehicle axes, of the box.
`existence`            0 to 1; empty in truth.
`class`                one of `candaemon.frames.bodies.CLASSES`; empty is the same as `unknown`.
`class_likelihood`     of that class, 0 to 1; empty where it is unknown, and in truth; not read.
`sides`                truth: how many sides of the box sensors see at this instant, 0 to 2.
=====================  ================================================================================

`x`, `y` and what belongs to them are those of the reference point, see `candaemon.estimation.outline`. An empty number
is NaN in memory. Other columns are ignored. Tables are written as a stream, with the same bytes on every run.
"""

from __future__ import annotations

import csv
import gzip
import math
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from decimal import Decimal
from functools import lru_cache
from itertools import chain, groupby
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self, TextIO, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.ego.georeference import Georeference
from candaemon.errors import ConfigError, InputError
from candaemon.evaluation.detection_columns import DETECTION_COLUMNS, FATES, NO_OBSTACLE, DetectionColumn
from candaemon.evaluation.number_text import joined_lines, number_lines, text_lines
from candaemon.files.outputs import OutputFile
from candaemon.frames.bodies import BODY, CLASSES
from candaemon.frames.times import LATEST_NS
from candaemon.tracking.obstacles import MOTION, STATE_NAMES, Obstacles

_OTHER_FORMAT: Final = re.compile(
    r"\.(parquet|xlsx?|ods|json|feather|arrow|mat|h5|hdf5|np[yz]|zst|xz|bz2|zip)(\.gz)?$", re.IGNORECASE
)
"""Names of files that a table in CSV would not be read from."""

ACTOR, HIDDEN, STATIONARY = 3, 4, 5
STATES = (*STATE_NAMES, "actor", "hidden", "stationary")
"""Names of the state codes: 0 to 2 as in `candaemon.tracking.obstacles`, 3 to 5 in truth."""

NUMBERS = ("x", "y", "vx", "vy", "ax", "ay", "east", "north", "ve", "vn", "sx", "sy", "svx", "svy", "age")
COLUMNS = ("time", "id", "state", *NUMBERS, "objects")
"""The columns that every table has."""
EARTH_COLUMNS = ("latitude", "longitude")
"""Further columns of georeferenced tracks."""
TRACK_COLUMNS = (*BODY, "existence", "class", "class_likelihood")
"""Further columns of tracks."""
TRUTH_COLUMNS = (*BODY, "class", "sides")
"""Further columns of truth."""
BODY_NUMBERS = (*BODY, "existence", "sides")
"""Further columns that hold a number and are read where they are there."""

_CELLS = (*COLUMNS, *BODY_NUMBERS, "class")

_TRACK_STATES = frozenset(range(ACTOR))
_TRUTH_STATES = frozenset({ACTOR, HIDDEN, STATIONARY})
_OBJECTS = re.compile(r"(?:[^:;,]+:-?\d+(?:;[^:;,]+:-?\d+)*)?")
LONGEST_ROW: Final = 1 << 16
"""Characters of a row, or of blank lines in a row; a row has some 200."""

_ROWS_AT_ONCE = 4096
_EXACT = 1 << 49
"""Below, numbers and their text are the same as floats."""
_CACHED_TIMES = 1024
_NS_DIGITS = 9
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class TrackTable:
    """Rows of a table as a structure of arrays of length n, ordered by time, then id.

    Attributes:
        time_ns: the time a row is valid for.
        id: identity.
        state: index into `STATES`.
        x, y, vx, vy, ax, ay, east, north, ve, vn, sx, sy, svx, svy, age: as in the module's table; NaN where empty.
        objects: detections used, as text.
        heading, yaw_rate, length, width, center_x, center_y, existence, sides: likewise; NaN where the table has none.
        kind: `class` as index into `CLASSES`.
    """

    time_ns: Integers
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
    objects: NDArray[np.object_]
    heading: Floats
    yaw_rate: Floats
    length: Floats
    width: Floats
    center_x: Floats
    center_y: Floats
    existence: Floats
    sides: Floats
    kind: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.id)

    def take(self, rows: Integers | Booleans) -> TrackTable:
        """Return the rows of an index or mask, in that order."""
        return TrackTable(*(getattr(self, field.name)[rows] for field in fields(self)))


def parse_time(text: str) -> int:
    """Return decimal seconds as integer ns, exact; digits below 1 ns are rounded.

    Raises:
        ValueError: not a finite number of seconds, or more than `LATEST_NS` from 1970.
    """
    try:
        seconds = Decimal(text)
    except ArithmeticError:
        raise ValueError(text) from None
    if not seconds.is_finite() or seconds.adjusted() >= _NS_DIGITS + 1:
        raise ValueError(text)
    time_ns = int(seconds.scaleb(_NS_DIGITS).to_integral_value())
    if abs(time_ns) > LATEST_NS:
        raise ValueError(text)
    return time_ns


def format_time(time_ns: int) -> str:
    """Return integer ns as decimal seconds: six decimals, or nine where six are not exact."""
    seconds, rest = divmod(abs(time_ns), 1_000_000_000)
    sign = "-" if time_ns < 0 else ""
    if rest % 1000:
        return f"{sign}{seconds}.{rest:09d}"
    return f"{sign}{seconds}.{rest // 1000:06d}"


def read_tracks(path: Path | str) -> TrackTable:
    """Read a table of tracks, as `--tracks` writes it.

    Raises:
        InputError: the file cannot be read, lacks a column, or a row violates the table format above.
    """
    return _read(Path(path), _TRACK_STATES)


def read_truth(path: Path | str) -> TrackTable:
    """Read a table of truth, as `--truth` writes it.

    Raises:
        InputError: the file cannot be read, lacks a column, or a row violates the table format above.
    """
    return _read(Path(path), _TRUTH_STATES)


@contextmanager
def _reading(path: Path) -> Iterator[TextIO]:
    """Open a table; raise an `InputError` with the reason where it is unreadable."""
    try:
        with (
            gzip.open(path, "rt", encoding="utf-8-sig", newline="")
            if path.suffix == ".gz"
            else path.open(encoding="utf-8-sig", newline="")
        ) as stream:
            yield stream
    except FileNotFoundError:
        raise InputError("no such file; expected a table in CSV", file=path) from None
    except UnicodeDecodeError:
        raise InputError("not text in UTF-8; expected a table in CSV", file=path) from None
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise InputError(f"damaged or truncated gzip file ({error}); write it again", file=path) from error
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", file=path) from error


class _TableLines:
    """The lines of a table, none of them and no row longer than `LONGEST_ROW`.

    Attributes:
        number: of the latest line, from 1.
        taken: characters since the last row began; set to 0 by the caller.
    """

    def __init__(self, stream: TextIO, path: Path) -> None:
        self._stream = stream
        self._path = path
        self.number = 0
        self.taken = 0

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        line = self._stream.readline(LONGEST_ROW + 1)
        if not line:
            raise StopIteration
        self.number += 1
        self.taken += len(line)
        if self.taken > LONGEST_ROW:
            raise InputError(
                f"a row of more than {LONGEST_ROW:,} characters; expected a table in CSV",
                file=self._path,
                line=self.number,
            )
        return line


def _cells(path: Path) -> Iterator[tuple[list[int], list[list[str]]]]:
    """Yield some rows at a time: the line number and the text of each, the cells in the order of `_CELLS`."""
    lines: list[int] = []
    rows: list[list[str]] = []
    with _reading(path) as stream:
        text = _TableLines(stream, path)
        reader = csv.reader(text)
        try:
            header = [name.strip() for name in next(reader, [])]
            if not header:
                raise InputError(f"empty file; expected a header with {','.join(COLUMNS)}", file=path)
            missing = [name for name in COLUMNS if name not in header]
            if missing:
                word = "column" if len(missing) == 1 else "columns"
                raise InputError(
                    f"{word} {', '.join(missing)} missing; expected {','.join(COLUMNS)}", file=path, line=1
                )
            # the last cell stands for the columns that the table does not have
            order = [header.index(name) if name in header else -1 for name in _CELLS]
            text.taken = 0
            for row in reader:
                if not row:  # blank lines are left out; the limit of a row is that of their number, too
                    continue
                text.taken = 0
                if len(row) != len(header):
                    raise InputError(
                        f"{len(row)} cells; expected {len(header)} as in the header (is the file cut short?)",
                        file=path,
                        line=reader.line_num,
                    )
                lines.append(reader.line_num)
                row.append("")
                rows.append([row[k] for k in order])
                if len(rows) == _ROWS_AT_ONCE:
                    yield lines, rows
                    lines, rows = [], []
        except csv.Error as error:
            raise InputError(f"not CSV: {error}", file=path, line=reader.line_num) from error
    yield lines, rows


def _read(path: Path, states: frozenset[int]) -> TrackTable:
    """Read a table in which only the given states may occur."""
    parse = _RowParser(path, states)
    parts, lines = [], []
    for numbers, rows in _cells(path):
        part = parse.table(numbers, rows)
        # the rows of a cycle are neighbours: what is there twice mostly shows here, before all of it is read
        _ordered(part, np.array(numbers, np.int64), path)
        parts.append(part)
        lines.append(np.array(numbers, np.int64))
    whole = TrackTable(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(TrackTable)))
    return _ordered(whole, np.concatenate(lines), path)


def _ordered(table: TrackTable, lines: Integers, path: Path) -> TrackTable:
    """Return a table ordered by time, then id.

    Args:
        table: in any order.
        lines: the line of each row.
        path: for the error.

    Raises:
        InputError: two rows have the same time and id.
    """
    order = np.lexsort((table.id, table.time_ns))
    ordered = table.take(order)
    twice = np.flatnonzero((np.diff(ordered.time_ns) == 0) & (np.diff(ordered.id) == 0))
    if len(twice):
        first, second = sorted((int(lines[order[twice[0]]]), int(lines[order[twice[0] + 1]])))
        raise InputError(f"same time and id as in line {first}; expected one row an id a cycle", file=path, line=second)
    return ordered


class _RowParser:
    """Turns cells into columns.

    Args:
        path: of the table, for errors.
        states: the states that may occur.
    """

    def __init__(self, path: Path, states: frozenset[int]) -> None:
        self._path = path
        self._states = states
        self._wanted = " or ".join(STATES[code] for code in sorted(states))
        self._other = "the truth" if states == _TRACK_STATES else "a tracks file"
        # the rows of a cycle share their time
        self._time = lru_cache(_CACHED_TIMES)(parse_time)

    def table(self, lines: Sequence[int], rows: Sequence[Sequence[str]]) -> TrackTable:
        """Return rows as a table, in their order.

        Raises:
            InputError: a cell is none of its column; names its line.
        """
        columns: Sequence[Sequence[str]] = list(zip(*rows, strict=True)) if rows else [()] * len(_CELLS)
        cells = dict(zip(_CELLS, columns, strict=True))

        def convert(name: str, parse: Callable[[str], _T], expected: str) -> list[_T]:
            values = []
            for text, line in zip(cells[name], lines, strict=True):
                try:
                    values.append(parse(text))
                except ValueError:
                    raise InputError(f"{name} is {text!r}; expected {expected}", file=self._path, line=line) from None
            return values

        numbers = {
            name: np.array(convert(name, _number, "a number or nothing"), dtype=np.float64)
            for name in (*NUMBERS, *BODY_NUMBERS)
        }
        table = TrackTable(
            time_ns=np.array(convert("time", self._time, "decimal seconds"), dtype=np.int64),
            id=np.array(convert("id", _identity, "an integer"), dtype=np.int64),
            state=np.array(convert("state", self._state, f"{self._wanted} (is this {self._other}?)"), dtype=np.int8),
            objects=np.array(
                convert("objects", _objects, "sensor:object with ; between, or nothing"), dtype=np.object_
            ),
            kind=np.array(convert("class", _class_code, ", ".join(CLASSES)), dtype=np.int8),
            **numbers,
        )
        for name, values in (("x", table.x), ("y", table.y)):
            empty = np.flatnonzero(np.isnan(values))
            if len(empty):
                raise InputError(f"{name} is empty; every row needs a position", file=self._path, line=lines[empty[0]])
        return table

    def _state(self, text: str) -> int:
        """Return the code of a state."""
        code = STATES.index(text)
        if code not in self._states:
            raise ValueError(text)
        return code


def _identity(text: str) -> int:
    """Return a 64-bit id."""
    value = int(text)
    if abs(value) >= 2**63:
        raise ValueError(text)
    return value


def _class_code(text: str) -> int:
    """Return the code of a class; an empty cell is `unknown`."""
    return CLASSES.index(text) if text else 0


def _number(text: str) -> float:
    """Return a finite number, or NaN where the cell is empty."""
    value = float(text) if text else math.nan
    if math.isinf(value):
        raise ValueError(text)
    return value


def _objects(text: str) -> str:
    """Return the detections' text where it is well formed."""
    if _OBJECTS.fullmatch(text) is None:
        raise ValueError(text)
    return text


Columns: TypeAlias = Mapping[str, Sequence[Any] | NDArray[Any]]
"""Columns of a table by their names, each of length n."""
_DECIMALS = 4
_FORMS = {"latitude": 9, "longitude": 9, "sides": 0, "class": -1}
"""Decimals of the columns that have not `_DECIMALS`, 9 being a tenth of a millimetre; −1: the name of a class."""
_ABSENT: Final[Mapping[str, Any]] = {"objects": "", "class": 0}
"""What stands for nothing in columns that are no numbers."""
_STATE_NAMES: Mapping[int | str, str] = {**dict(enumerate(STATES)), **{name: name for name in STATES}}
_CLASS_NAMES: Mapping[int | str, str] = {**dict(enumerate(CLASSES)), **{name: name for name in CLASSES}}
_ORIGIN_COLUMNS = ("time", "measured", "sensor", "object", "source")
_PREDICTION_COLUMNS = ("time", "horizon", "id", "object", "x", "y")


class _TableWriter:
    """A CSV file with a header, compressed if its name ends in `.gz`; finished by `close` or a `with` block."""

    def __init__(self, file: OutputFile, columns: Sequence[str]) -> None:
        # neither name nor time in the gzip header: equal rows give equal bytes
        packed = file.path.suffix == ".gz"
        if _OTHER_FORMAT.search(file.path.name):
            raise ConfigError(
                "its name is of another format than the table that is written: CSV; expected one that ends in .csv or "
                ".csv.gz",
                file=file.path,
            )
        self._target = gzip.GzipFile("", "wb", fileobj=file.stream, mtime=0) if packed else file.stream
        self._target.write(text_lines([",".join(columns)]))

    def close(self) -> None:
        """Write what is still buffered; a second call does nothing."""
        self._target.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class TrackWriter(_TableWriter):
    """Writes a table of tracks or of truth, one call per cycle.

    Args:
        file: the table.
        further: columns after those that every table has: some of `EARTH_COLUMNS`, `TRACK_COLUMNS`, `TRUTH_COLUMNS`.
    """

    def __init__(self, file: OutputFile, further: Sequence[str] = ()) -> None:
        super().__init__(file, (*COLUMNS, *further))
        self._known = frozenset((*COLUMNS, *further)) - {"time"}
        self._parts = [tuple(names) for _, names in groupby(further, key=_FORMS.get)]

    def write_cycle(self, time_ns: int, columns: Columns) -> None:
        """Write the rows of one cycle, as `write_cycles` does."""
        self.write_cycles(((time_ns, columns),))

    def write_cycles(self, cycles: Iterable[tuple[int, Columns]]) -> None:
        """Write the rows of cycles, one after the other, all at once.

        Args:
            cycles: the time that the rows are valid for, and their columns by name, each of length n. `id` and `state`
                (codes or names) are required; a number's column may be absent, and a value that is not finite becomes
                an empty cell. `objects` holds text; `class` codes or names.

        Raises:
            ValueError: a column that the table does not have, or columns of different length.
        """
        some = [(time_ns, columns) for time_ns, columns in cycles if self._rows(columns)]
        if not some:
            return
        columns = _below_one_another([each for _, each in some])
        rows = len(columns["id"])
        parts = [
            b"".join([f"{format_time(time_ns)}\n".encode() * len(each["id"]) for time_ns, each in some]),
            _whole_numbers(columns["id"]),
            text_lines([_STATE_NAMES[state] for state in _listed(columns["state"])]),
            number_lines(_table(columns, NUMBERS), _DECIMALS),
            text_lines(_listed(columns.get("objects", ("",) * rows))),
            *(_further_lines(columns, names) for names in self._parts),
        ]
        self._target.write(joined_lines("", parts, rows))

    def _rows(self, columns: Columns) -> int:
        """Return how many rows some columns are; all must be the table's."""
        if not columns.keys() <= self._known:
            raise ValueError(f"no such columns: {sorted(columns.keys() - self._known)}")
        rows = len(columns["id"])
        if any(len(each) != rows for each in columns.values()):
            raise ValueError("columns of different length")
        return rows


class PredictionWriter(_TableWriter):
    """Writes the table of predictions: `time,horizon,id,object,x,y`.

    `time` is when a prediction was made, `horizon` the s until it is due; `x`, `y` the expected position of
    the detected point in the vehicle axes of `time + horizon`, m; `id` the obstacle, `object` the sensor's object.

    Args:
        file: the table.
    """

    def __init__(self, file: OutputFile) -> None:
        super().__init__(file, _PREDICTION_COLUMNS)

    def write_cycles(self, predictions: Sequence[tuple[int, float, Integers, Integers, Floats]]) -> None:
        """Write predictions, those of one time and horizon after the other, all at once.

        Args:
            predictions: the time that they were made at; s from then until they are due; of each the obstacle (n,), the
                sensor's object (n,), and the expected position in the vehicle axes of the due time, m (n, 2).
        """
        if not predictions:
            return
        times, horizons, ids, objects, places = zip(*predictions, strict=True)
        starts = [f"{format_time(time_ns)},{float(ahead)}\n" for time_ns, ahead in zip(times, horizons, strict=True)]
        parts = [
            b"".join([start.encode() * len(each) for start, each in zip(starts, ids, strict=True)]),
            *(_whole_numbers(np.concatenate(each)) for each in (ids, objects)),
            number_lines(np.concatenate(places), _DECIMALS),
        ]
        self._target.write(joined_lines("", parts, sum(map(len, ids))))


class DetectionWriter(_TableWriter):
    """Writes the table of detections: `time` of the measurement, and the columns of `DETECTION_COLUMNS`.

    Args:
        file: the table.
    """

    def __init__(self, file: OutputFile) -> None:
        super().__init__(file, ("time", *(column.name for column in DETECTION_COLUMNS)))

    def write_cycle(self, time_ns: int, columns: Mapping[str, NDArray[Any] | list[str]]) -> None:
        """Write the detections of one cycle.

        Args:
            time_ns: of the measurement.
            columns: as `detection_columns` returns them; what is not known becomes an empty cell.
        """
        if not len(columns["object"]):
            return
        parts = [_detection_lines(columns[column.name], column) for column in DETECTION_COLUMNS]
        self._target.write(joined_lines(format_time(time_ns) + ",", parts, len(columns["object"])))


def _detection_lines(values: NDArray[Any] | list[str], column: DetectionColumn) -> bytes:
    """Return a column of the table of detections as text, a line a detection."""
    if isinstance(values, list):
        return text_lines(values)
    match column.kind:
        case "flag":
            return text_lines(["1" if value else "0" for value in values.tolist()])
        case "number":
            return number_lines(values.astype(np.float64)[:, None], _DECIMALS)
        case "text":  # codes
            return text_lines([FATES[code] for code in values.tolist()])
    return text_lines(["" if value == NO_OBSTACLE else str(value) for value in values.tolist()])


class OriginWriter(_TableWriter):
    """Writes the table of origins: `time,measured,sensor,object,source`, what a simulated sensor's objects are.

    `time` is the scan's as the frames tell it, `measured` the true instant, to which the truth belongs, s; `sensor` the
    sensor's name, `object` its id as in the tracks' `objects`, `source` an `id` of the truth, 0 for a false object.

    Args:
        file: the table.
    """

    def __init__(self, file: OutputFile) -> None:
        super().__init__(file, _ORIGIN_COLUMNS)

    def write_scan(self, time_ns: int, measured_ns: int, sensor: str, objects: Integers, sources: Integers) -> None:
        """Write the objects of one scan, `objects` and `sources` each of length n."""
        start = f"{format_time(time_ns)},{format_time(measured_ns)},{sensor}"
        parts = [_whole_numbers(objects), _whole_numbers(sources)]
        self._target.write(joined_lines(f"{start},", parts, len(objects)))


def _listed(values: Sequence[Any] | NDArray[Any]) -> Sequence[Any]:
    """Return plain Python values, which format several times faster than numpy's."""
    return values.tolist() if isinstance(values, np.ndarray) else values


def _below_one_another(cycles: Sequence[Columns]) -> Columns:
    """Return the columns of cycles, each below those before it, with what stands for nothing where one has none."""
    if len(cycles) == 1:
        return cycles[0]
    joined: dict[str, Sequence[Any] | NDArray[Any]] = {}
    for name in dict.fromkeys(chain.from_iterable(cycles)):
        column = [each.get(name, (_ABSENT.get(name, math.nan),) * len(each["id"])) for each in cycles]
        arrays = all(isinstance(each, np.ndarray) for each in column)
        joined[name] = np.concatenate(column) if arrays else list(chain.from_iterable(map(_listed, column)))
    return joined


def _table(columns: Columns, names: Sequence[str]) -> Floats:
    """Return the columns of some names side by side, NaN where there is none."""
    table = np.full((len(columns["id"]), len(names)), np.nan)
    for k, name in enumerate(names):
        if name in columns:
            table[:, k] = columns[name]
    return table


def _further_lines(columns: Columns, names: Sequence[str]) -> bytes:
    """Return some of the columns that a table may have, one of texts or several of one form of numbers, as lines."""
    decimals = _FORMS.get(names[0], _DECIMALS)
    if decimals < 0:
        return text_lines([_CLASS_NAMES[kind] for kind in _listed(columns.get(names[0], (0,) * len(columns["id"])))])
    return number_lines(_table(columns, names), decimals)


def _whole_numbers(values: Sequence[int] | Integers) -> bytes:
    """Return whole numbers as lines."""
    if isinstance(values, np.ndarray) and np.abs(values).max(initial=0) < _EXACT:
        return number_lines(values.astype(np.float64)[:, None], 0)
    return text_lines([*map(str, _listed(values))])


def track_columns(
    obstacles: Obstacles, sensors: Sequence[str], georeference: Georeference | None = None
) -> dict[str, Sequence[object] | NDArray[Any]]:
    """Return obstacles as columns of the table of tracks; with latitude and longitude if georeferenced."""
    used = [""] * len(obstacles)
    columns = (obstacles.used_row, obstacles.used_sensor, obstacles.used_object)
    for row, sensor, key in zip(*(column.tolist() for column in columns), strict=True):
        used[row] += f";{sensors[sensor]}:{key}" if used[row] else f"{sensors[sensor]}:{key}"
    earth: dict[str, Floats] = {}
    if georeference is not None:
        places = np.degrees(georeference.to_earth(obstacles.east, obstacles.north))
        earth = dict(zip(EARTH_COLUMNS, places, strict=True))
    return {
        "id": obstacles.id,
        "state": obstacles.state,
        **{name: getattr(obstacles, name) for name in (*MOTION, "age", *BODY, "existence")},
        "class": obstacles.kind,
        "class_likelihood": obstacles.kind_likelihood,
        "objects": used,
        **earth,
    }
