"""One drive, as a worker computes it: fetch, hash, replay, put in place."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from candaemon.errors import CandaemonError, InputError
from candaemon.exports.drive_tables import SUMMARIES, summary_rows
from candaemon.exports.parquet import SUFFIX, ParquetTable
from candaemon.files.outputs import Outputs, write_file
from candaemon.fleet.dataset import (
    DriveRecordFile,
    ReplayOptions,
    failure_name,
    key_of,
    record_name,
    table_file,
    table_files,
)
from candaemon.fleet.drive_list import FleetDrive
from candaemon.fleet.kept_configuration import kept_binding
from candaemon.fleet.locations import FetchedLog, fetched, require_unchanged, require_utf8, sha256_of
from candaemon.fleet.result_store import ResultStore, store_at
from candaemon.fleet.software import difference, software
from candaemon.playback.replay import ReplayRequest, replay
from candaemon.playback.summary import require_used, summarise
from candaemon.printable import printable


@dataclass(frozen=True, slots=True)
class DriveOrder:
    """What a worker is to compute.

    Attributes:
        drive: the drive.
        results: location of the results.
        configuration: digest of the one that is kept there.
        yaml: name of the YAML among its files.
        base: folder from which the names of its files start.
        options: of the replay.
        software: what it is to be computed by.
        weight: about how much work it is, bytes of text.
    """

    drive: FleetDrive
    results: str
    configuration: str
    yaml: str
    base: str
    options: ReplayOptions
    software: dict[str, str]
    weight: int = 0


@dataclass(frozen=True, slots=True)
class DriveOutcome:
    """How that ended.

    Attributes:
        drive: its name.
        reason: why it failed; empty: it did not.
        computed: whether it was; otherwise what was there is the same.
        duration: of the log, s.
        effort: s of processor time.
    """

    drive: str
    reason: str = ""
    computed: bool = False
    duration: float = 0.0
    effort: float = 0.0


def run_drive(order: DriveOrder) -> DriveOutcome:
    """Compute a drive and put its results in place, unless they are there already."""
    try:
        return _run(order)
    except (CandaemonError, OSError, MemoryError) as error:
        return DriveOutcome(order.drive.name, printable(str(error) or type(error).__name__))


def _run(order: DriveOrder) -> DriveOutcome:
    began = time.process_time()
    name, store = order.drive.name, store_at(order.results)
    differs = difference(software(), order.software)
    if differs:
        raise InputError(f"this worker has {differs}; install the same on all workers")
    for log in order.drive.logs:
        require_utf8(log)
    with fetched(order.drive.logs) as (logs, inputs):
        key = key_of(inputs, order.configuration, asdict(order.options), order.software)
        former = former_record(store, name)
        if former is not None and former.key == key and former.is_complete(_sizes(store, name)):
            noted = replace(former, inputs=_noted(inputs), logs=order.drive.logs, tags=dict(order.drive.tags))
            if noted != former:
                store.write(record_name(name), noted.to_bytes())
            store.remove(failure_name(name))
            return DriveOutcome(name, duration=former.duration)
        with store.attempt() as folder:
            replaying = time.process_time()
            figures = replayed_into(folder, order, logs)
            require_unchanged(order.drive.logs, inputs)
            replay_effort = time.process_time() - replaying
            made = {table: folder / f"{table}{SUFFIX}" for table in table_files(name)}
            files = {table: {"bytes": path.stat().st_size, "sha256": sha256_of(path)} for table, path in made.items()}
            if former is not None:
                store.remove(record_name(name))
            store.place({table_file(table, name): path for table, path in made.items()})
            effort = time.process_time() - began
            record = DriveRecordFile(
                name,
                key,
                order.drive.logs,
                _noted(inputs),
                order.configuration,
                str(order.drive.configuration),
                asdict(order.options),
                order.software,
                dict(order.drive.tags),
                figures["seconds"] or 0.0,
                figures["log"]["frames"],
                round(effort, 4),
                round(effort - replay_effort, 4),
                files,
            )
            written = folder / "record.json"
            write_file(written, record.to_bytes())
            store.place({record_name(name): written})
        store.remove(failure_name(name))
    return DriveOutcome(name, computed=True, duration=record.duration, effort=record.effort)


def former_record(store: ResultStore, drive: str) -> DriveRecordFile | None:
    """Return the record of a drive; None where there is none, or none that can be read."""
    content = store.read(record_name(drive))
    try:
        return None if content is None else DriveRecordFile.from_bytes(content, record_name(drive))
    except InputError:
        return None


def replayed_into(folder: Path, order: DriveOrder, logs: Sequence[Path]) -> dict[str, Any]:
    """Replay a drive into its tables in a folder, as `replay --parquet` does; return the figures.

    Raises:
        InputError: there is no usable frame in it, or a file cannot be written.
    """
    binding = kept_binding(order.results, order.configuration, order.yaml, order.base)
    first, *further = logs
    request = ReplayRequest(
        first,
        parquet=folder,
        further=tuple(further),
        channels=dict(order.options.channels),
        smooth=order.options.smooth,
    )
    with Outputs() as outputs:
        figures = summarise(replay(binding, request, outputs=outputs))
        require_used(first, figures)
        with ParquetTable(outputs.open(folder / f"{SUMMARIES.name}{SUFFIX}"), SUMMARIES) as table:
            table.add(*summary_rows(figures))
    return figures


def _noted(inputs: Sequence[FetchedLog]) -> tuple[dict[str, Any], ...]:
    return tuple({**asdict(each.found), "sha256": each.sha256} for each in inputs)


def _sizes(store: ResultStore, drive: str) -> dict[str, int]:
    """Return the sizes of a drive's tables."""
    found: dict[str, int] = {}
    for name in table_files(drive).values():
        found |= store.sizes(name.rpartition("/")[0])
    return found
