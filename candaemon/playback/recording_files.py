"""Recordings of the service on disk: names of the files, and which of them replay as one run.

A folder holds candump logs, each with a file of the pipeline's state at its beginning::

    2026-11-21T22-12-52.123Z-000041.log      input of the pipeline, ticks included
    2026-11-21T22-12-52.123Z-000041.state    state of the pipeline before it
    configurations/3f8a0c11d2e4/             YAML and DBC files of the configuration in use
    events/2026-11-21T22-14-07.501Z-mark/    the same kinds of files, retained, with event.json

The number increases over restarts of the service and determines the order, since the clock may have been set back.
Logs are read in *runs*. A file that continues where the previous one ended belongs to the same run; a start of the
service, a reload, or input that was left out begins another run, with the state stored there. Open cycles at the end of
a run are reported only where the service reported them: all where it was stopped, those that wait for other sensors
before a reload. The last line of such a log is `(1533226488.434433) tick 001#`, or `002#`.
"""

from __future__ import annotations

import logging
import os
import re
import stat
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from candaemon._version import __version__
from candaemon.errors import InputError
from candaemon.pipeline.saved_state.fingerprint import Fingerprint, differences
from candaemon.pipeline.saved_state.header import LONGEST_HEADER, StateHeader, header_of
from candaemon.printable import printable

logger = logging.getLogger(__name__)

LOG: Final = ".log"
STATE: Final = ".state"
EVENTS: Final = "events"
CONFIGURATIONS: Final = "configurations"

ENDED: Final = 1
"""Identifier of the tick with which a stopped service ends its last log."""

SETTLED: Final = 2
"""Identifier of the tick with which a log ends before a reload."""

_END = re.compile(rb"\((\d{1,12})\.(\d{6,9})\) tick 00([12])#\s*$")
_LONGEST_LINE = 300  # characters
_LONGEST_VERSION = 40  # characters
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_STEM = re.compile(r"(\d{4}-\d\d-\d\dT\d\d)-(\d\d)-(\d\d\.\d{3})Z-(\d{6,12})", re.ASCII)


@dataclass(frozen=True, slots=True)
class Run:
    """Logs that one pipeline replays without interruption.

    Attributes:
        logs: in order.
        state: file with the pipeline's state before the first log; None: the pipeline starts empty.
        ends: whether open cycles at the end are reported.
        by_time: whether the logs may overlap, or be in another order than in time.
        settled_ns: time of the reload at its end, before which the cycles that waited for other sensors are reported;
            None: there was none.
    """

    logs: tuple[Path, ...]
    state: Path | None
    ends: bool
    by_time: bool = False
    settled_ns: int | None = None

    def without_first(self) -> Run | None:
        """Return what is left of a run without its first log, begun with the next state; None where there is none."""
        for k, log in enumerate(self.logs[1:], 1):
            if log.with_suffix(STATE).exists():
                return Run(self.logs[k:], log.with_suffix(STATE), self.ends, settled_ns=self.settled_ns)
        return None


def stem(time_ns: int, number: int) -> str:
    """Return the name of a recording's file without its suffix.

    Args:
        time_ns: of its first item.
        number: running number of the file.
    """
    return f"{utc(time_ns)}-{number:06d}"


def utc(time_ns: int) -> str:
    """Return a time as written in file names: sortable, and valid on every file system."""
    moment = datetime.fromtimestamp(time_ns // 1_000_000_000, UTC)
    return f"{moment:%Y-%m-%dT%H-%M-%S}.{time_ns // 1_000_000 % 1000:03d}Z"


def number_in(stem: str) -> int | None:
    """Return the number in the name, without suffix, of a recording's file; None for any other name."""
    match = _STEM.fullmatch(stem)
    return None if match is None else int(match[4])


def time_in(stem: str) -> int | None:
    """Return the time in the name of a recording's file, to the ms, in ns; None where there is none."""
    match = _STEM.fullmatch(stem)
    try:
        moment = None if match is None else datetime.fromisoformat(f"{match[1]}:{match[2]}:{match[3]}+00:00")
    except ValueError:  # such as month 13
        return None
    return None if moment is None else (moment - _EPOCH) // timedelta(milliseconds=1) * 1_000_000


def number_of(path: Path) -> int | None:
    """Return the number of a recording's file; None for any other file."""
    return number_in(path.stem)


def logs_in(folder: Path) -> list[Path]:
    """Return a folder's logs in order: those of a recording by number, preceded by others by name."""
    return sorted(folder.glob(f"*{LOG}"), key=lambda path: (number_of(path) or 0, path.name))


def unfolded(logs: Iterable[Path]) -> list[Path]:
    """Return logs with those of each folder in its place.

    Raises:
        InputError: a folder has none.
    """
    found = []
    for log in logs:
        inside = logs_in(log) if log.is_dir() else [log]
        if not inside:
            raise _no_log(log)
        found += inside
    return found


def _no_log(folder: Path) -> InputError:
    return InputError(f"no log in this folder; expected files of a recording, *{LOG}", file=folder)


def files_of(*logs: Path) -> list[Path]:
    """Return all files that logs, or folders of logs, consist of: the logs, and the states beside them."""
    logs = tuple(each for log in logs for each in (logs_in(log) if log.is_dir() else [log]))
    return [path for each in logs for path in (each, each.with_suffix(STATE))]


def header_beside(log: Path) -> StateHeader | None:
    """Return the header of the state file that belongs to a log; None where there is none.

    Raises:
        InputError: it is damaged.
    """
    path = log.with_suffix(STATE)
    try:
        # no pipe: one would wait for somebody to write to it
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:  # noqa: PTH123 - a descriptor
            is_file = stat.S_ISREG(os.fstat(file.fileno()).st_mode)
            return header_of(file.readline(LONGEST_HEADER) if is_file else b"")
    except FileNotFoundError:
        if not path.is_symlink():
            return None
        raise InputError("the state is a link to nothing; use --fresh to do without", file=path) from None
    except InputError as error:
        raise InputError(error.message, file=path) from error
    except OSError as error:
        raise InputError(f"the state cannot be read: {error.strerror}; use --fresh to do without", file=path) from error


def runs_of(logs: Sequence[Path], fingerprint: Fingerprint, *, fresh: bool = False) -> list[Run]:
    """Return the runs to replay of one log, of a folder, or of several logs of one drive; see `runs`.

    Raises:
        InputError: as for `runs`; or a folder is among several.
    """
    if len(logs) == 1:
        return runs(logs[0], fingerprint, fresh=fresh)
    for log in logs:
        if log.is_dir():
            raise InputError("a folder is read alone; expected logs", file=log)
    if not fresh and any(header_beside(log) is not None for log in logs):
        return _grouped(_usable(logs, fingerprint))
    return [Run(tuple(logs), None, ends=True, by_time=True)]


def runs(log: Path, fingerprint: Fingerprint, *, fresh: bool = False) -> list[Run]:
    """Return the runs to replay, in order.

    Args:
        log: a log, or a folder of logs.
        fingerprint: of the configuration it is replayed with. Files of a folder that were recorded with another one, or
            by another version, are left out and named in the log, unless all were.
        fresh: states are ignored: all logs are one run, and the pipeline starts empty.

    Raises:
        InputError: there is no log, or none of this configuration; the message says what differs.
    """
    logs = _files_in(log) if log.is_dir() else [log]
    if not logs:
        raise _no_log(log)
    if fresh:
        return [Run(tuple(logs), None, ends=True)]
    if not log.is_dir():
        header = header_beside(log)
        return [_run([(log, header)])]
    return _grouped(_usable(logs, fingerprint))


def _files_in(folder: Path) -> list[Path]:
    """Return a folder's logs; log a warning for each that is no file, such as a pipe, which nobody may write to."""
    logs = logs_in(folder)
    for log in logs:
        if not log.is_file():
            logger.warning("%s: left out: it is no file", printable(str(log)))
    return [log for log in logs if log.is_file()]


def _usable(logs: Sequence[Path], fingerprint: Fingerprint) -> list[tuple[Path, StateHeader | None]]:
    """Return the logs of this configuration and version with their headers; log a warning for each other one.

    Raises:
        InputError: there is none.
    """
    found: list[tuple[Path, StateHeader | None]] = []
    reasons: dict[Path, str] = {}
    is_recording = any(number_of(log) is not None and log.with_suffix(STATE).exists() for log in logs)
    for log in logs:
        try:
            header = header_beside(log)
        except InputError as error:
            reasons[log] = error.message
            continue
        if header is not None:
            reason = _difference(header, fingerprint)
        else:
            reason = "its state is missing" if is_recording and number_of(log) is not None else ""
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
        logger.warning("%s: left out: %s", printable(str(log)), reason)
    return found


def _difference(header: StateHeader, fingerprint: Fingerprint) -> str:
    """Return how version or configuration of a recording differ from the present ones; empty where they are equal."""
    if header.version != __version__:
        return f"recorded by candaemon {printable(header.version, _LONGEST_VERSION)}, this is {__version__}"
    differs = differences(header.fingerprint, fingerprint)
    return f"recorded with another configuration ({differs})" if differs else ""


def _grouped(pieces: Sequence[tuple[Path, StateHeader | None]]) -> list[Run]:
    """Group logs into runs: a log joins the run that ended where it begins."""
    groups: list[list[tuple[Path, StateHeader | None]]] = []
    for log, header in pieces:
        before = groups[-1][-1][0].name if groups else ""
        if groups and (header is None or (header.begins == "rotation" and header.follows == before)):
            groups[-1].append((log, header))
        else:
            groups.append([(log, header)])
    return [_run(group) for group in groups]


def _run(pieces: Sequence[tuple[Path, StateHeader | None]]) -> Run:
    """Return the run of consecutive logs."""
    logs = tuple(log for log, _ in pieces)
    if pieces[0][1] is None:
        return Run(logs, None, ends=True)
    mark, time_ns = _end_of(logs[-1])
    state = logs[0].with_suffix(STATE)
    return Run(logs, state, ends=mark == ENDED, settled_ns=time_ns if mark == SETTLED else None)


def _end_of(log: Path) -> tuple[int, int]:
    """Return identifier and time, ns, of the tick that marks a log's end; zeros where none does.

    Raises:
        InputError: the log cannot be read.
    """
    try:
        with log.open("rb") as file:
            file.seek(0, os.SEEK_END)
            file.seek(max(file.tell() - _LONGEST_LINE, 0))
            found = _END.search(file.read())
    except OSError as error:
        raise InputError(f"the log cannot be read: {error.strerror}", file=log) from error
    return (0, 0) if found is None else (int(found[3]), int(found[1]) * 1_000_000_000 + int(found[2].ljust(9, b"0")))
