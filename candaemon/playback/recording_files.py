"""Recordings of the service as they lie on the disk: which files there are, and what replays as one piece.

A folder holds logs of candump, each with the state of the pipeline at its beginning beside it::

    2026-11-21T22-12-52.123Z-000041.log      what the pipeline took, ticks of the clock too
    2026-11-21T22-12-52.123Z-000041.state    what it knew before that
    configurations/3f8a0c11d2e4/             YAML and DBC files that were in force
    events/2026-11-21T22-14-07.501Z-mark/    the same kind of files again, kept, with event.json

The number counts on over restarts of the service and tells the order: the clock may have been set back in between.
Logs are read in *runs*. A file that goes on where the one before ended belongs to its run; a start of the service, a
reload, or input that was left out begins another one, with the state stored there. What is open at the end of a run is
told only where the service told it: where it was stopped, which its last line says, `(1533226488.434433) tick 001#`.
"""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from candaemon._version import __version__
from candaemon.errors import InputError
from candaemon.pipeline.saved_state.fingerprint import Fingerprint, differences
from candaemon.pipeline.saved_state.header import LONGEST_HEADER, StateHeader, header_of

logger = logging.getLogger(__name__)

LOG: Final = ".log"
STATE: Final = ".state"
EVENTS: Final = "events"
CONFIGURATIONS: Final = "configurations"

ENDED: Final = 1
"""Identifier of the tick with which a stopped service ends its last log."""

_END = re.compile(rb"\) tick 001#\s*$")
_LONGEST_LINE = 300  # characters
_STEM = re.compile(r"\d{4}-\d\d-\d\dT\d\d-\d\d-\d\d\.\d{3}Z-(\d{6,})")


@dataclass(frozen=True, slots=True)
class Run:
    """Logs that one pipeline takes without a break.

    Attributes:
        logs: in order.
        state: file that the pipeline's state before them is read from; None: it begins with nothing.
        ends: whether what is open behind them is to be told.
    """

    logs: tuple[Path, ...]
    state: Path | None
    ends: bool


def stem(time_ns: int, number: int) -> str:
    """Return the name of a recording's file without its suffix.

    Args:
        time_ns: of its first item.
        number: counts the files.
    """
    return f"{utc(time_ns)}-{number:06d}"


def utc(time_ns: int) -> str:
    """Return a time as it is written in names: these sort by time, and every file system takes them."""
    moment = datetime.fromtimestamp(time_ns // 1_000_000_000, UTC)
    return f"{moment:%Y-%m-%dT%H-%M-%S}.{time_ns // 1_000_000 % 1000:03d}Z"


def number_of(path: Path) -> int | None:
    """Return the number of a recording's file; None for another one."""
    match = _STEM.fullmatch(path.stem)
    return None if match is None else int(match[1])


def logs_in(folder: Path) -> list[Path]:
    """Return a folder's logs in their order: a recording's by their numbers, others by their names before them."""
    return sorted(folder.glob(f"*{LOG}"), key=lambda path: (number_of(path) or 0, path.name))


def header_beside(log: Path) -> StateHeader | None:
    """Return the header of the state that a log begins with; None where there is none.

    Raises:
        InputError: it is damaged.
    """
    path = log.with_suffix(STATE)
    try:
        with path.open("rb") as file:
            return header_of(file.readline(LONGEST_HEADER))
    except FileNotFoundError:
        return None
    except InputError as error:
        raise InputError(error.message, file=path) from error
    except OSError as error:
        raise InputError(f"the state cannot be read: {error.strerror}", file=path) from error


def runs(log: Path, fingerprint: Fingerprint, *, fresh: bool = False) -> list[Run]:
    """Return what is to be replayed, in order.

    Args:
        log: a log, or a folder of logs.
        fingerprint: of the configuration it is replayed with. Files of a folder that were recorded with another one, or
            by another version, are left out and named in the log, unless all were.
        fresh: states are ignored: all logs are one run that begins with nothing.

    Raises:
        InputError: there is no log, or none of this configuration; says what differs.
    """
    logs = logs_in(log) if log.is_dir() else [log]
    if not logs:
        raise InputError(f"no log in this folder; expected files of a recording, *{LOG}", file=log)
    if fresh:
        return [Run(tuple(logs), None, ends=True)]
    if not log.is_dir():
        header = header_beside(log)
        return [_run([(log, header)])]
    return _joined(_usable(logs, fingerprint))


def _usable(logs: Sequence[Path], fingerprint: Fingerprint) -> list[tuple[Path, StateHeader | None]]:
    """Return the logs of this configuration and version with their headers; name the others.

    Raises:
        InputError: there is none.
    """
    found: list[tuple[Path, StateHeader | None]] = []
    reasons: dict[Path, str] = {}
    for log in logs:
        try:
            header = header_beside(log)
        except InputError as error:
            reasons[log] = error.message
            continue
        reason = "" if header is None else _other(header, fingerprint)
        if reason:
            reasons[log] = reason
        else:
            found.append((log, header))
    if not found:
        raise InputError(
            f"{reasons[logs[-1]]}; use the configuration kept in '{CONFIGURATIONS}' beside the recording and the"
            " version that recorded it, or --fresh",
            file=logs[-1],
        )
    for log, reason in reasons.items():
        logger.warning("%s: left out: %s", log, reason)
    return found


def _other(header: StateHeader, fingerprint: Fingerprint) -> str:
    """Say what a log was recorded with that is not what it is to be replayed with; nothing where all is alike."""
    if header.version != __version__:
        return f"recorded by candaemon {header.version}, this is {__version__}"
    differs = differences(header.fingerprint, fingerprint)
    return f"recorded with another configuration ({differs})" if differs else ""


def _joined(pieces: Sequence[tuple[Path, StateHeader | None]]) -> list[Run]:
    """Join the logs that go on where the one before ended."""
    groups: list[list[tuple[Path, StateHeader | None]]] = []
    for log, header in pieces:
        before = groups[-1][-1][0].name if groups else ""
        if groups and (header is None or (header.begins == "rotation" and header.follows == before)):
            groups[-1].append((log, header))
        else:
            groups.append([(log, header)])
    return [_run(group) for group in groups]


def _run(pieces: Sequence[tuple[Path, StateHeader | None]]) -> Run:
    """Return the run of logs that go on in each other."""
    logs = tuple(log for log, _ in pieces)
    plain = pieces[0][1] is None
    return Run(logs, None if plain else logs[0].with_suffix(STATE), ends=plain or _was_stopped(logs[-1]))


def _was_stopped(log: Path) -> bool:
    """Tell whether a log ends where the service was stopped."""
    try:
        with log.open("rb") as file:
            file.seek(0, os.SEEK_END)
            file.seek(max(file.tell() - _LONGEST_LINE, 0))
            return _END.search(file.read()) is not None
    except OSError as error:
        raise InputError(f"the log cannot be read: {error.strerror}", file=log) from error
