"""The figures of each drive of a fleet, and which of them are better low or high; read from a dataset or from JSON."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from math import isfinite, log
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Literal, TypeAlias

from candaemon.errors import InputError
from candaemon.exports.extras import import_extra
from candaemon.files.bounded import read_bounded
from candaemon.fleet.dataset import DriveRecordFile, failures_in, records_in
from candaemon.fleet.locations import is_local, local_path
from candaemon.fleet.result_store import FolderStore, ResultStore, store_at
from candaemon.status.losses import EGO_UNUSABLE_CAUSES, UNUSABLE_CAUSES

Better: TypeAlias = Literal["lower", "higher", "neither"]

LARGEST_FIGURES: Final = 1 << 30
"""Longest file of figures, bytes."""
_FORM: Final = "candaemon fleet figures 1"
_KEYS: Final = (
    r"predictions\.\d+\.(x|y|horizon|samples)|nis\.(mean|expected|coverage_95|samples)|stationary\.(vx|speed)"
    r"|duplicates\.share|tracks\.(confirmed|obstacles)|cycles\.(told|without_ego)|log\.(frames|malformed|error_frames)"
    rf"|sensors\.[^.]+\.({'|'.join((*UNUSABLE_CAUSES, 'missing'))})"
    rf"|own_motion\.({'|'.join(('short', *EGO_UNUSABLE_CAUSES))})"
)
"""Figures of `--summary` that what follows is made of."""
_LOSSES: Final = re.compile(r"log\.(malformed|error_frames)|sensors\..*|own_motion\..*")


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


@dataclass(frozen=True, slots=True)
class FleetFigures:
    """The figures of all drives, by name, and the reasons of those that failed."""

    drives: Mapping[str, DriveFigures]
    failed: Mapping[str, str] = field(default_factory=dict)

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
            "it holds no drive; expected the folder of a 'fleet run', or its figures in JSON", file=location
        )
    values: dict[str, dict[str, float]] = {name: {} for name in records}
    for drive, key, value in _summaries(store) if records else ():
        if drive in values:
            values[drive][key] = value
    return FleetFigures({name: _of_drive(records[name], values[name]) for name in sorted(records)}, failed)


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


@contextmanager
def connection(store: ResultStore, table: str) -> Iterator[tuple[Any, str]]:
    """Yield DuckDB and a folder of this machine in which it finds a table of the results: theirs, or a copy."""
    database = import_extra("duckdb", "fleet", "figures over many drives")
    with ExitStack() as files:
        if isinstance(store, FolderStore):
            root = store.path
        else:
            root = Path(files.enter_context(TemporaryDirectory(prefix="candaemon-fleet-")))
            for name in store.sizes(table):
                store.fetch(name, root / name)
        yield files.enter_context(database.connect()), str(root)


def parts(root: str, table: str) -> str:
    """Return a table over all drives, for a query."""
    quoted = root.replace("'", "''")
    return f"read_parquet('{quoted}/{table}/*/*.parquet', hive_partitioning = true, hive_types = {{'drive': varchar}})"


def _summaries(store: ResultStore) -> Iterator[tuple[str, str, float]]:
    with connection(store, "summaries") as (database, root):
        yield from _summary_rows(database, root)


def _summary_rows(database: Any, root: str) -> Iterator[tuple[str, str, float]]:
    query = (  # of our own folder and keys
        f"select drive, key, value from {parts(root, 'summaries')} "  # noqa: S608 - our own folder and keys
        f"where value is not null and regexp_full_match(key, '{_KEYS}') order by all"
    )
    rows = database.execute(query)
    while some := rows.fetchmany(100_000):
        yield from some


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
