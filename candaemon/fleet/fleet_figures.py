"""The figures of each drive of a fleet, and which of them are better low or high; read from a dataset or from JSON."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from itertools import chain
from math import isfinite, log
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any, Final, Literal, TypeAlias

from candaemon.errors import InputError
from candaemon.exports.drive_tables import CYCLES, SUMMARIES
from candaemon.exports.extras import import_extra
from candaemon.files.bounded import read_bounded
from candaemon.fleet.dataset import FAILED, RECORDS, DriveRecordFile, failures_in, records_in, table_file
from candaemon.fleet.locations import is_local, local_path
from candaemon.fleet.result_store import FolderStore, ResultStore, store_at
from candaemon.status.losses import EGO_UNUSABLE_CAUSES, UNUSABLE_CAUSES

Better: TypeAlias = Literal["lower", "higher", "neither"]

LARGEST_FIGURES: Final = 1 << 30
"""Longest file of figures, bytes."""
_ROWS_AT_ONCE: Final = 100_000
_FORM: Final = "candaemon fleet figures 1"
_KEYS: Final = (
    r"predictions\.\d+\.(x|y|horizon|samples)|nis\.(mean|expected|coverage_95|samples)|stationary\.(vx|speed)"
    r"|duplicates\.share|tracks\.(confirmed|obstacles)|cycles\.(told|without_ego)|log\.(frames|malformed)"
    rf"|sensors\.[^.]+\.({'|'.join(UNUSABLE_CAUSES)})"
    rf"|own_motion\.({'|'.join(('short', *EGO_UNUSABLE_CAUSES))})"
)
"""Figures of `--summary` that what follows is made of."""
_LOSSES: Final = re.compile(r"log\.malformed|sensors\..*|own_motion\..*")
PARTS: Final = (  # of the last folder alone: one above may be called drive=… as well
    r"(select *, regexp_extract(filename, 'drive=([^/\\]+)[/\\][^/\\]+$', 1) as drive "
    "from read_parquet($files, hive_partitioning = false, filename = true))"
)
"""A table over all its parts, in a query of `TableParts`."""


@dataclass(frozen=True, slots=True)
class DriveFigure:
    """A figure of a drive.

    Attributes:
        key: in JSON.
        name: for readers.
        unit: of it.
        better: which is.
        ratio: two of a drive are compared by their ratio; else by their difference.
        slack: difference up to which two of a drive are as good, whatever their ratio.
    """

    key: str
    name: str
    unit: str
    better: Better
    ratio: bool = True
    slack: float = 0.0


CONSISTENCY: Final = DriveFigure(
    "nis.off", "NIS off its expectation, |ln(mean / expected)|", "", "lower", ratio=False, slack=0.1
)
COVERAGE: Final = DriveFigure(
    "nis.coverage_off", "share within the 95 % quantile, off 95 %", "", "lower", ratio=False, slack=0.02
)
LOSSES: Final = DriveFigure("losses", "frames lost or refused, of a thousand", "‰", "lower", ratio=False, slack=1.0)
FIGURES: Final = (
    CONSISTENCY,
    COVERAGE,
    DriveFigure("stationary.speed", "speed of what stands, RMS", "m/s", "lower"),
    DriveFigure("duplicates.share", "samples beside another obstacle", "", "lower", ratio=False, slack=0.01),
    LOSSES,
    DriveFigure("cycles.without_ego", "scans without own motion", "", "lower", ratio=False, slack=2.0),
    DriveFigure("tracks.confirmed", "obstacles confirmed", "", "neither"),
    DriveFigure("cycles.told", "cycles", "", "neither"),
)
"""All but the errors of predictions, whose horizons a drive tells."""


@dataclass(frozen=True, slots=True)
class DriveFigures:
    """A drive's figures.

    Attributes:
        drive: its name.
        values: figures by key; one that the drive does not have is missing.
        inputs: hash of its logs' content.
        files: hash of each table; empty where that is not known.
        tags: of the drive.
        duration: s.
        configuration, logs: as they were named.
        effort: s of processor time.
        channels: additional channel names in the logs: channel → bus.
    """

    drive: str
    values: Mapping[str, float]
    inputs: str = ""
    files: Mapping[str, str] = field(default_factory=dict)
    tags: Mapping[str, str] = field(default_factory=dict)
    duration: float = 0.0
    configuration: str = ""
    logs: tuple[str, ...] = ()
    effort: float = 0.0
    channels: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class FleetFigures:
    """The figures of a fleet.

    Attributes:
        drives: by name.
        failed: reasons of the drives that have no figures, by name.
        incomplete: those of the failed whose tables were damaged or removed after their run.
    """

    drives: Mapping[str, DriveFigures]
    failed: Mapping[str, str] = field(default_factory=dict)
    incomplete: tuple[str, ...] = ()

    @property
    def twice(self) -> list[tuple[str, ...]]:
        """Names of drives that are the same logs through the same configuration, as a folder of several runs has them.

        A drive's name tells it from the others of its run: beside other logs, one has another name.
        """
        alike: dict[tuple[str, str], list[str]] = {}
        for name, each in self.drives.items():
            if each.inputs:
                alike.setdefault((each.inputs, each.configuration), []).append(name)
        return [tuple(names) for names in alike.values() if len(names) > 1]

    def figures(self) -> tuple[DriveFigure, ...]:
        """Return what its drives may have, errors of predictions first."""
        keys = {key for drive in self.drives.values() for key in drive.values if key.startswith("predictions.")}
        return (*map(_prediction, sorted(keys, key=_horizon)), *FIGURES)

    def to_json(self) -> dict[str, Any]:
        """Return them for a file."""
        drives = [asdict(each) for each in self.drives.values()]
        return {"form": _FORM, "drives": drives, "failed": dict(self.failed)}


def _horizon(key: str) -> tuple[float, str]:
    _, axis, horizon = key.split(".", 2)
    return float(horizon), axis


def _prediction(key: str) -> DriveFigure:
    horizon, axis = _horizon(key)
    side = "forward" if axis == "x" else "to the left"
    return DriveFigure(key, f"error of predictions {side}, {horizon:g} s ahead", "m", "lower")


def load_figures(location: str) -> FleetFigures:
    """Read the figures of a run's folder, or of a file that `fleet report --json` wrote.

    Raises:
        InputError: there are none.
    """
    if is_local(location) and local_path(location).is_file():
        return _from_file(location)
    store = store_at(location)
    failed = failures_in(store)
    records = {name: each for name, each in records_in(store).items() if name not in failed}
    if not records and not failed:
        raise InputError(
            "it holds no drive; expected the folder of a 'fleet run', or to compare a file of 'fleet report --json'",
            file=location,
        )
    sizes = store.sizes()
    incomplete = {name: lacking for name, each in records.items() if (lacking := each.lacking(sizes))}
    failed |= {name: f"{', '.join(lacking)}: missing or damaged since its run" for name, lacking in incomplete.items()}
    values: dict[str, dict[str, float]] = {name: {} for name in records if name not in incomplete}
    for drive, key, value in _summary_rows(store, values):
        values[drive][key] = value
    drives = {name: _of_drive(records[name], values[name]) for name in sorted(values)}
    return FleetFigures(drives, failed, tuple(sorted(incomplete)))


def files_read(location: str) -> list[Path]:
    """Return the files of this machine that hold the figures of a run; none where it lies elsewhere."""
    if not is_local(location):
        return []
    path = local_path(location)
    if path.is_file():
        return [path]
    store = FolderStore(location)
    folders = (RECORDS, FAILED, SUMMARIES.name, CYCLES.name)
    return [store.path / name for name in chain.from_iterable(map(store.sizes, folders))]


def _from_file(location: str) -> FleetFigures:
    try:
        content = json.loads(read_bounded(local_path(location), LARGEST_FIGURES))
        if content["form"] != _FORM:
            raise KeyError(_FORM)  # noqa: TRY301 - told with what else is wrong
        drives = [DriveFigures(**{**each, "logs": tuple(each["logs"])}) for each in content["drives"]]
        return FleetFigures({each.drive: each for each in drives}, dict(content["failed"]))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=location) from error
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(
            "it holds no figures of a fleet; expected what 'fleet report --json' writes", file=location
        ) from error


@dataclass(frozen=True, slots=True)
class TableParts:
    """A table over several drives.

    Attributes:
        database: connection of DuckDB.
        where: location of the results.
        files: of this machine that hold a drive's part each, and their names in the results.
    """

    database: Any
    where: str
    files: Mapping[str, str]

    def rows(self, query: str, **values: Any) -> Iterator[tuple[Any, ...]]:
        """Yield the rows that a query gives; none where there is no part.

        Args:
            query: of `PARTS`.
            values: of its parameters.

        Raises:
            InputError: the parts cannot be read; names the first that cannot.
        """
        if not self.files:
            return
        try:
            found = self.database.execute(query, {**values, "files": list(self.files)})
            while some := found.fetchmany(_ROWS_AT_ONCE):
                yield from some
        except _duckdb().Error as error:
            reason = str(error).partition("\n")[0]
            for path, name in self.files.items():
                if not self._answers(query, {**values, "files": [path]}):
                    raise InputError(
                        f"cannot be read: {reason}; remove it, and run the same 'fleet run' again",
                        file=f"{self.where}/{name}",
                    ) from error
            raise InputError(
                f"its tables cannot be read together: {reason}; run all drives again into another folder",
                file=self.where,
            ) from error

    def _answers(self, query: str, values: Mapping[str, Any]) -> bool:
        """Return whether a query gives anything."""
        try:
            self.database.execute(query, values).fetchall()
        except _duckdb().Error:
            return False
        return True


def _duckdb() -> ModuleType:
    return import_extra("duckdb", "fleet", "figures over many drives")


@contextmanager
def table_parts(store: ResultStore, table: str, drives: Iterable[str]) -> Iterator[TableParts]:
    """Yield the parts that drives have of a table: the files of the results, or copies of them."""
    with ExitStack() as opened:
        names = [table_file(table, drive) for drive in drives]
        if isinstance(store, FolderStore):
            root = store.path
        else:
            root = Path(opened.enter_context(TemporaryDirectory(prefix="candaemon-fleet-")))
            for name in names:
                store.fetch(name, root / name)
        database = opened.enter_context(_duckdb().connect())
        yield TableParts(database, store.url, {str(root / name): name for name in names})


def _summary_rows(store: ResultStore, drives: Iterable[str]) -> Iterator[tuple[str, str, float]]:
    query = (
        f"select drive, key, value from {PARTS} "  # noqa: S608 - a constant
        "where value is not null and regexp_full_match(key, $keys) order by all"
    )
    with table_parts(store, SUMMARIES.name, drives) as parts:
        yield from parts.rows(query, keys=_KEYS)


def _of_drive(record: DriveRecordFile, summary: Mapping[str, float]) -> DriveFigures:
    """Return a drive's figures by its record and its summary."""
    inputs = hashlib.sha256("\n".join(str(each["sha256"]) for each in record.inputs).encode()).hexdigest()
    return DriveFigures(
        record.drive,
        dict(_derived(summary)),
        inputs,
        {table: str(each["sha256"]) for table, each in record.files.items()},
        record.tags,
        record.duration,
        record.given,
        record.logs,
        record.effort,
        record.options["channels"],
    )


def _derived(summary: Mapping[str, float]) -> Iterator[tuple[str, float]]:
    """Yield the figures of a drive that are known."""
    for key, value in summary.items():
        head, _, rest = key.partition(".")
        if head == "predictions" and rest.endswith((".x", ".y")):
            number, axis = rest.split(".")
            yield f"predictions.{axis}.{summary[f'predictions.{number}.horizon']:g}", value
    mean, expected = summary.get("nis.mean", 0.0), summary.get("nis.expected", 0.0)
    if mean > 0 and expected > 0:
        yield CONSISTENCY.key, abs(log(mean / expected))
    if "nis.coverage_95" in summary:
        yield COVERAGE.key, abs(summary["nis.coverage_95"] - 0.95)
    frames = summary.get("log.frames", 0.0)
    if frames:
        lost = sum(value for key, value in summary.items() if _LOSSES.fullmatch(key))
        yield LOSSES.key, 1e3 * lost / frames
    for each in FIGURES:
        if each.key in summary and isfinite(summary[each.key]):
            yield each.key, summary[each.key]
