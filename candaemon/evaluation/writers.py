"""Writers of the tables that `candaemon.evaluation.tables` describes: streaming, deterministic to the byte."""

from __future__ import annotations

import gzip
import io
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Floats, Integers
from candaemon.errors import InputError
from candaemon.evaluation.tables import COLUMNS, EARTH_COLUMNS, NUMBERS, STATES, format_time

_DECIMALS = 4
_DEGREE_DECIMALS = 9  # a tenth of a millimetre
_ROW = "%s,%d,%s," + ",".join([f"%.{_DECIMALS}f"] * len(NUMBERS)) + ",%s"
_EARTH = f",%.{_DEGREE_DECIMALS}f" * len(EARTH_COLUMNS)
_PREDICTION = f"%s,%s,%d,%s,%.{_DECIMALS}f,%.{_DECIMALS}f\n"
_STATE_NAMES: Mapping[int | str, str] = {**dict(enumerate(STATES)), **{name: name for name in STATES}}
_KNOWN = frozenset((*COLUMNS, *EARTH_COLUMNS)) - {"time"}
_PREDICTION_COLUMNS = ("time", "horizon", "id", "object", "x", "y")


class _TableWriter:
    """A CSV file with a header, `.gz` by its name, closed by `close` or at the end of a `with`."""

    def __init__(self, path: Path | str, columns: Sequence[str]) -> None:
        path = Path(path)
        self._files = ExitStack()
        try:
            raw = self._files.enter_context(path.open("wb"))
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror or error}", file=path) from error
        # neither name nor time in the gzip header: equal rows give equal bytes
        packed = gzip.GzipFile("", "wb", fileobj=raw, mtime=0) if path.suffix == ".gz" else raw
        self._text = self._files.enter_context(io.TextIOWrapper(packed, encoding="utf-8", newline="\n"))
        self._text.write(",".join(columns) + "\n")

    def close(self) -> None:
        """Write what is still buffered and close the file; a second call does nothing."""
        self._files.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class TrackWriter(_TableWriter):
    """Writes a table of tracks or of truth, one call a cycle.

    Args:
        path: the file to write; it is replaced.
        earth: whether it has columns for latitude and longitude.

    Raises:
        InputError: the file cannot be opened for writing.
    """

    def __init__(self, path: Path | str, *, earth: bool = False) -> None:
        super().__init__(path, (*COLUMNS, *EARTH_COLUMNS) if earth else COLUMNS)
        self._known = _KNOWN if earth else _KNOWN - set(EARTH_COLUMNS)
        self._earth = earth

    def write_cycle(self, time_ns: int, columns: Mapping[str, Sequence[Any] | NDArray[Any]]) -> None:
        """Write the rows of one cycle.

        Args:
            time_ns: the instant they hold for.
            columns: by column name, each of length n. `id` and `state` (codes or names) must be there; a number's
                column may be absent, and a value that is not finite becomes an empty cell. `objects` holds text
                or, for each row, its (sensor, object) pairs. `latitude` and `longitude`, deg, where the table has them.

        Raises:
            ValueError: a column that the table does not have, or columns of different length.
        """
        if not columns.keys() <= self._known:
            raise ValueError(f"no such columns: {sorted(columns.keys() - self._known)}")
        rows = len(columns["id"])
        if not rows:
            return
        numbers = _rounded(_table(columns, NUMBERS))
        time = format_time(time_ns)
        states = [_STATE_NAMES[state] for state in _listed(columns["state"])]
        objects = [_objects_text(one) for one in columns.get("objects", ("",) * rows)]
        lines = [
            _ROW % (time, identity, state, *row, used)
            for identity, state, row, used in zip(
                _listed(columns["id"]), states, numbers.tolist(), objects, strict=True
            )
        ]
        if self._earth:
            places = _rounded(_table(columns, EARTH_COLUMNS), _DEGREE_DECIMALS)
            lines = [line + _EARTH % tuple(place) for line, place in zip(lines, places.tolist(), strict=True)]
            numbers = np.hstack((numbers, places))
        self._text.write(_without_nan("\n".join((*lines, "")), numbers))


class PredictionWriter(_TableWriter):
    """Writes the table of predictions: `time,horizon,id,object,x,y`.

    `time` is the instant a prediction was made at, `horizon` the s until it is due; `x`, `y` the expected position of
    the detected point in the vehicle axes of `time + horizon`, m; `id` the obstacle, `object` the sensor's object.

    Args:
        path: the file to write; it is replaced.

    Raises:
        InputError: the file cannot be opened for writing.
    """

    def __init__(self, path: Path | str) -> None:
        super().__init__(path, _PREDICTION_COLUMNS)

    def write_cycle(
        self,
        time_ns: int,
        horizon: float,
        ids: Sequence[int] | Integers,
        objects: Sequence[int | str] | Integers,
        x: Sequence[float] | Floats,
        y: Sequence[float] | Floats,
    ) -> None:
        """Write the predictions made at one instant for one horizon, each argument of length n.

        Args:
            time_ns: the instant they were made at.
            horizon: s from then until they are due.
            ids: obstacles.
            objects: the sensor's object, a number or text, written as it is.
            x: expected position, m forward in the vehicle axes of the due instant.
            y: the same, m to the left.
        """
        if not len(ids):
            return
        time, ahead = format_time(time_ns), str(float(horizon))
        places = _rounded(np.column_stack((np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))))
        lines = [
            _PREDICTION % (time, ahead, identity, used, *place)
            for identity, used, place in zip(_listed(ids), _listed(objects), places.tolist(), strict=True)
        ]
        self._text.write(_without_nan("".join(lines), places))


def _listed(values: Sequence[Any] | NDArray[Any]) -> Sequence[Any]:
    """Return plain Python values, which format several times faster than numpy's."""
    return values.tolist() if isinstance(values, np.ndarray) else values


def _table(columns: Mapping[str, Sequence[Any] | NDArray[Any]], names: Sequence[str]) -> Floats:
    """Return the columns of some names side by side, NaN where there is none."""
    table = np.full((len(columns["id"]), len(names)), np.nan)
    for k, name in enumerate(names):
        if name in columns:
            table[:, k] = columns[name]
    return table


def _rounded(values: Floats, decimals: int = _DECIMALS) -> Floats:
    """Round to what is written, with −0 as 0 and what is not finite as NaN."""
    rounded: Floats = values.round(decimals)
    rounded += 0.0
    rounded[~np.isfinite(rounded)] = np.nan
    return rounded


def _without_nan(text: str, values: Floats) -> str:
    """Empty the cells of NaN; neither a state's name nor an object holds those letters."""
    return text.replace("nan", "") if np.isnan(values).any() else text


def _objects_text(used: str | Iterable[tuple[int, int]]) -> str:
    """Return a row's detections as text."""
    return used if isinstance(used, str) else ";".join(f"{sensor}:{number}" for sensor, number in used)
