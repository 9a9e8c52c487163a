"""How results lie in a fleet's folder, and what is noted of each drive.

::

    tracks/drive=NAME/part-0.parquet     likewise detections, cycles, summaries
    records/NAME.json                    of a drive that is whole: inputs, their hashes, files, effort
    failed/NAME.json                     of a drive that is not: the reason
    configurations/DIGEST/               YAML and DBC files

A drive's record is written after its tables and removed before they are replaced: what has one is whole.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from candaemon.errors import InputError
from candaemon.exports.drive_tables import TABLES
from candaemon.exports.parquet import SUFFIX
from candaemon.fleet.locations import FetchedLog, LogFile
from candaemon.fleet.result_store import ResultStore
from candaemon.printable import printable

RECORDS: Final = "records"
FAILED: Final = "failed"
_FORM: Final = 1
"""Of the records; another one is not read."""


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """How each drive is replayed.

    Attributes:
        channels: additional channel names in the logs: channel → bus.
        smooth: lag of the smoothing of the table of tracks, s; None: it holds the causal estimates.
    """

    channels: Mapping[str, str] = field(default_factory=dict)
    smooth: float | None = None


@dataclass(frozen=True, slots=True)
class DriveRecordFile:
    """What is noted of a drive that is whole.

    Attributes:
        drive: its name.
        key: hash of all that its results depend on.
        logs: locations as they were named.
        inputs: its files with size, stamp and hash.
        configuration: digest of the one that is kept.
        given: path of the YAML as it was named.
        options: of the replay.
        software: versions.
        tags: of the drive.
        duration: of the log, s.
        frames: in the log.
        effort: s of processor time that the drive took.
        overhead: s of these that were not the replay itself.
        files: of each table bytes and hash.
    """

    drive: str
    key: str
    logs: tuple[str, ...]
    inputs: tuple[dict[str, Any], ...]
    configuration: str
    given: str
    options: dict[str, Any]
    software: dict[str, str]
    tags: dict[str, str]
    duration: float
    frames: int
    effort: float
    overhead: float
    files: dict[str, dict[str, Any]]

    def to_bytes(self) -> bytes:
        """Return it as JSON."""
        return f"{json.dumps({'form': _FORM, **asdict(self)}, indent=1, ensure_ascii=False)}\n".encode()

    @classmethod
    def from_bytes(cls, content: bytes, name: str) -> DriveRecordFile:
        """Read it.

        Raises:
            InputError: it is no record.
        """
        try:
            values = json.loads(content)
            is_known = values.pop("form") == _FORM
            values["logs"], values["inputs"] = tuple(values["logs"]), tuple(values["inputs"])
            values["options"] |= {"channels": dict(values["options"]["channels"])}
            record = cls(**values)
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise InputError(
                "it is no record of a drive; remove it, and the drive is computed again", file=name
            ) from error
        if not is_known:
            raise InputError("it is a record of another version; choose another folder", file=name)
        return record

    def is_of(self, files: Sequence[LogFile]) -> bool:
        """Return whether files are, by their stamps, those that it was computed from."""
        return [(each["location"], each["stamp"]) for each in self.inputs] == [
            (each.location, each.stamp) for each in files
        ] and all(each.stamp for each in files)

    def is_complete(self, sizes: Mapping[str, int]) -> bool:
        """Return whether all its tables are there.

        Args:
            sizes: of files in the folder, bytes.
        """
        return not self.lacking(sizes)

    def lacking(self, sizes: Mapping[str, int]) -> list[str]:
        """Return the names of its tables that are missing or of another size than when they were written.

        Args:
            sizes: of files in the folder, bytes.
        """
        names = {table_file(name, self.drive): each["bytes"] for name, each in self.files.items()}
        return [name for name, size in names.items() if sizes.get(name) != size]


def table_file(table: str, drive: str) -> str:
    """Return the name of a drive's part of a table."""
    return f"{table}/drive={drive}/part-0{SUFFIX}"


def table_files(drive: str) -> dict[str, str]:
    """Return the names of a drive's parts of all tables, by table."""
    return {table: table_file(table, drive) for table in TABLES}


def record_name(drive: str) -> str:
    """Return the name of a drive's record."""
    return f"{RECORDS}/{drive}.json"


def failure_name(drive: str) -> str:
    """Return the name of the note that a drive failed."""
    return f"{FAILED}/{drive}.json"


def noted_drives(names: Iterable[str]) -> set[str]:
    """Return the drives that have a record or a note that they failed.

    Args:
        names: of files in the folder.
    """
    notes = (name.removesuffix(".json").partition("/") for name in names if name.endswith(".json"))
    return {drive for folder, _, drive in notes if folder in (RECORDS, FAILED)}


def key_of(
    inputs: Sequence[FetchedLog], configuration: str, options: Mapping[str, Any], software: Mapping[str, str]
) -> str:
    """Return the hash of all that a drive's results depend on."""
    whole = {
        "logs": [[each.path.name, each.sha256] for each in inputs],
        "configuration": configuration,
        "options": dict(options),
        "software": dict(software),
    }
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()


def records_in(store: ResultStore) -> dict[str, DriveRecordFile]:
    """Return the records of all drives that are whole, by name.

    Raises:
        InputError: one is damaged.
    """
    names = sorted(name for name in store.sizes(RECORDS) if name.endswith(".json"))
    found = (DriveRecordFile.from_bytes(content, f"{store.url}/{name}") for name, content in store.read_all(names))
    return {record.drive: record for record in found}


def failures_in(store: ResultStore) -> dict[str, str]:
    """Return the reasons of all drives that failed, by name."""
    return dict(_failures(store))


def _failures(store: ResultStore) -> Iterator[tuple[str, str]]:
    names = sorted(name for name in store.sizes(FAILED) if name.endswith(".json"))
    for name, content in store.read_all(names):
        try:
            values = json.loads(content)
            yield str(values["drive"]), str(values["reason"])
        except (ValueError, TypeError, KeyError) as error:
            raise InputError("it is no note of a failed drive; remove it", file=f"{store.url}/{name}") from error


def write_failure(store: ResultStore, drive: str, logs: Sequence[str], reason: str) -> None:
    """Note that a drive failed."""
    content = {"drive": drive, "logs": list(map(printable, logs)), "reason": reason}
    store.write(failure_name(drive), f"{json.dumps(content, indent=1, ensure_ascii=False)}\n".encode())
