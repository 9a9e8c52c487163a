"""Which format a log has: by the suffixes of its name, or where these do not tell, by what it begins with."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final

from candaemon.can_io.logs.compression import COMPRESSIONS, compression_by_name
from candaemon.can_io.logs.stream import STANDARD_INPUT, LogBytes, LogCounts
from candaemon.errors import InputError

TEXT_SUFFIXES: Final = (".asc", ".csv", ".log", ".trc")
"""Suffixes of the formats that are text, a frame a line."""
LOG_SUFFIXES: Final = (".log", ".asc", ".blf", ".csv", ".mf4", ".pcap", ".pcapng", ".trc")
"""Suffixes of the formats, each but those of `NOT_COMPRESSED` also followed by one of `COMPRESSIONS`."""
WITH_NAMES: Final = (".log", ".pcapng")
"""Formats that hold the names of channels."""
NOT_COMPRESSED: Final = {
    ".blf": "a .blf is compressed already",
    ".mf4": "a .mf4 is read from place to place, and may be compressed by itself",
}
"""Formats whose files are not compressed any further, and why."""

_HEADS = (
    (re.compile(rb"LOGG"), ".blf"),
    (re.compile(rb"(MDF     |UnFinMF )"), ".mf4"),
    (re.compile(rb"\x0a\x0d\x0d\x0a"), ".pcapng"),
    (re.compile(rb"\xa1\xb2\xc3\xd4|\xd4\xc3\xb2\xa1|\xa1\xb2\x3c\x4d|\x4d\x3c\xb2\xa1"), ".pcap"),
    (re.compile(rb"\s*(date |base (hex|dec)|// version )", re.IGNORECASE), ".asc"),
    (re.compile(rb"timestamp,arbitration_id,"), ".csv"),
    (re.compile(rb"\s*;"), ".trc"),
    (re.compile(rb"\s*\([\d .:-]+\)\s+\S+\s+\S|\s*\w+\s+(?:[RT]X [B-] [E-]\s+)?[0-9A-F]{3,8}\s+\["), ".log"),
)


def log_suffix(path: Path) -> str:
    """Return the suffix that determines a log's format, without that of its compression, in lower case.

    Raises:
        InputError: unknown suffix; the message lists the known ones.
    """
    name = path.with_suffix("") if compression_by_name(path) else path
    suffix = name.suffix.lower()
    if suffix not in LOG_SUFFIXES:
        known, packed = ", ".join(LOG_SUFFIXES), ", ".join(COMPRESSIONS)
        hint = "; a configuration is named before the logs" if suffix in {".yaml", ".yml"} else ""
        raise InputError(
            f"found the suffix '{suffix}', expected one of {known}, each also with {packed} after it{hint}", file=path
        )
    return suffix


def written_suffix(path: Path) -> str:
    """Return the suffix that determines the format of a log to be written: of a pipe or a device, that of `candump`.

    Raises:
        InputError: as of `log_suffix`.
    """
    flows = path.exists() and (Path("/dev") in path.parents or not path.is_file())
    return ".log" if flows and not path.suffix else log_suffix(path)


def open_log(path: Path, counts: LogCounts) -> tuple[str, LogBytes]:
    """Open a log; return the suffix of its format with its bytes.

    Raises:
        InputError: it does not exist, cannot be opened, or neither name nor content tell its format.
    """
    try:
        suffix = log_suffix(path)
    except InputError:
        if is_named_file(path):
            _check_content(path)
        stream = LogBytes(path, counts, by_content=True)
        suffix = _suffix_of(stream.peek()) or ".log"  # what flows is most likely from `candump`
        return suffix, stream
    return suffix, LogBytes(path, counts)


def check_log(path: Path) -> None:
    """Refuse a log that cannot be read, before anything is done; a pipe is not opened.

    Raises:
        InputError: it does not exist, may not be read, or neither name nor content tell its format.
    """
    try:
        log_suffix(path)
    except InputError:
        if is_named_file(path):
            _check_content(path)
    if not path.exists():
        raise InputError("there is no such log; check the path", file=path)
    if not os.access(path, os.R_OK):
        raise InputError("the log cannot be opened: there is no right to read it", file=path)


def is_named_file(path: Path) -> bool:
    """Return whether a log can be opened once more: what was read of a pipe, or of standard input, is gone."""
    return path != STANDARD_INPUT and (path.is_file() or not path.exists())


def _check_content(path: Path) -> None:
    """Refuse a file, whose name does not tell its format, if its content does not either.

    Raises:
        InputError: the message lists the suffixes that tell.
    """
    found = ""
    if path.is_file():
        with LogBytes(path, LogCounts(), by_content=True) as stream:
            found = _suffix_of(stream.peek())
    if not found:
        log_suffix(path)


def _suffix_of(head: bytes) -> str:
    """Return the suffix of the format that a log's first bytes show; empty where they show none."""
    return next((suffix for begin, suffix in _HEADS if begin.match(head)), "")
