"""DBC files that were parsed before, kept as plain data in the user's cache folder.

To parse a DBC takes most of the time that a command needs before it begins: importing the parser, then reading the
file. What comes of it depends on the file's bytes and on the versions of the parsers alone, which together name the
entry. An entry is JSON behind its own checksum: it cannot run code, one that is damaged is parsed anew, and a folder
that others may write to is not used. Without a folder, or on a full disk, every file is parsed.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Mapping
from dataclasses import fields
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from candaemon._version import __version__
from candaemon.dbc.database_bytes import read_database
from candaemon.dbc.types import Database, Diagnostic, MessageSpec, SignalSpec
from candaemon.errors import InputError
from candaemon.files.bounded import FileReader, read_bounded
from candaemon.files.own_folder import OwnFolder

logger = logging.getLogger(__name__)

LONGEST_ENTRY: Final = 32 << 20
"""Bytes of an entry, at most; of a DBC that makes more, none is kept."""

MOST_ENTRIES: Final = 64
"""Entries of the folder, at most; those that were written first go first."""

_FORM: Final = "1"
"""Of an entry; another one's entries are not read."""
_SUFFIX: Final = ".json"
_DIGEST: Final = sha256().digest_size
_SIGNAL: Final = tuple(each.name for each in fields(SignalSpec))
_MESSAGE: Final = ("name", "can_id", "length", "is_fd", "cycle_time", "comment", "line")


def cache_folder(environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return where parsed DBC files are kept: the service's cache directory, else the user's; None without either.

    Args:
        environment: with systemd's `CACHE_DIRECTORY`, `XDG_CACHE_HOME` or `HOME`.
    """
    first, *_ = environment.get("CACHE_DIRECTORY", "").split(":")
    if first.startswith("/"):
        return Path(first) / "dbc"
    own = environment.get("XDG_CACHE_HOME", "")
    if own.startswith("/"):
        return Path(own) / "candaemon" / "dbc"
    home = environment.get("HOME", "")
    return Path(home) / ".cache" / "candaemon" / "dbc" if home.startswith("/") else None


def load_cached(path: Path, read: FileReader = read_bounded, folder: Path | None = None) -> Database:
    """Load a DBC file as `load_database` does, by the cache where it was parsed before.

    Args:
        path: the file.
        read: reads it.
        folder: of the cache; None: every file is parsed.

    Returns:
        Its messages, and each repair and oddity as a warning.

    Raises:
        DatabaseError: the file cannot be read, or no message is left in it.
    """
    content = read_database(path, read)
    if folder is None:
        return _parsed(content, path)
    name = entry_name(content)
    known = _find(folder, name, path)
    if known is not None:
        return known
    database = _parsed(content, path)
    _keep(folder, name, database)
    return database


def entry_name(content: bytes) -> str:
    """Return the name of the entry of a DBC file's bytes, as these versions parse it."""
    parsers = "\0".join((_FORM, __version__, version("cantools")))
    return sha256(parsers.encode() + b"\0" + content).hexdigest() + _SUFFIX


def _parsed(content: bytes, path: Path) -> Database:
    """Return what a file's bytes hold."""
    from candaemon.dbc.database import parse_database  # noqa: PLC0415  # its patterns take longer than reading an entry

    return parse_database(content, path)


def _find(folder: Path, name: str, path: Path) -> Database | None:
    """Return what was kept of a file; None where nothing was, or it is damaged."""
    try:
        with OwnFolder.at(folder) as own:
            entry = _read(own, name)
    except (OSError, InputError) as error:
        if not isinstance(error, FileNotFoundError):
            logger.debug("no cache of DBC files: %s", error)
        return None
    body = entry[_DIGEST:]
    if sha256(body).digest() != entry[:_DIGEST]:
        return None
    return from_plain(json.loads(body), path)


def _read(own: OwnFolder, name: str) -> bytes:
    descriptor = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=own.descriptor)
    with open(descriptor, "rb") as file:  # noqa: PTH123 - a descriptor
        return file.read(_DIGEST + LONGEST_ENTRY) if own.is_own_file(os.fstat(descriptor)) else b""


def _keep(folder: Path, name: str, database: Database) -> None:
    """Keep what a file was parsed to, whole or not at all; where that cannot be, the next start parses it again."""
    body = json.dumps(to_plain(database), separators=(",", ":")).encode()
    if len(body) > LONGEST_ENTRY:
        return
    try:
        with OwnFolder.at(folder) as own:
            own.replace(name, sha256(body).digest() + body)
            _make_room(own)
    except (OSError, InputError) as error:
        logger.debug("no cache of DBC files: %s", error)


def _make_room(own: OwnFolder) -> None:
    """Remove the entries beyond the limit, those that were written first."""
    entries = sorted(own.entries(), key=lambda entry: entry.stat(follow_symlinks=False).st_mtime_ns)
    for entry in entries[: max(len(entries) - MOST_ENTRIES, 0)]:
        own.remove(entry.name)


def to_plain(database: Database) -> dict[str, Any]:
    """Return a database as lists, numbers and text, without the file's path."""
    messages = {id(message): message for message in (*database.messages.values(), *database.by_id.values())}
    return {
        "messages": [_plain_message(each) for each in sorted(messages.values(), key=lambda message: message.line)],
        "warnings": [[warning.line, warning.text] for warning in database.warnings],
    }


def from_plain(plain: Mapping[str, Any], path: Path) -> Database:
    """Return the database of what `to_plain` gave.

    Args:
        plain: the lists.
        path: the file that it is of.
    """
    messages: dict[str, MessageSpec] = {}
    by_id: dict[int, MessageSpec] = {}
    for row, signals in plain["messages"]:
        message = MessageSpec(
            **dict(zip(_MESSAGE, row, strict=True)), signals=tuple(_signal(each) for each in signals), file=path
        )
        messages.setdefault(message.name, message)
        by_id.setdefault(message.can_id, message)
    return Database(path, messages, by_id, tuple(Diagnostic(path, line, text) for line, text in plain["warnings"]))


def _plain_message(message: MessageSpec) -> list[Any]:
    return [[getattr(message, name) for name in _MESSAGE], [_plain_signal(each) for each in message.signals]]


def _plain_signal(signal: SignalSpec) -> list[Any]:
    row = [getattr(signal, name) for name in _SIGNAL]
    row[_CHOICES] = None if signal.choices is None else list(signal.choices.items())
    row[_IDS] = sorted(signal.multiplexer_ids)
    return row


def _signal(row: list[Any]) -> SignalSpec:
    if row[_CHOICES] is not None:
        row[_CHOICES] = dict(row[_CHOICES])
    row[_IDS] = frozenset(row[_IDS])
    return SignalSpec(*row)


_CHOICES: Final = _SIGNAL.index("choices")
_IDS: Final = _SIGNAL.index("multiplexer_ids")
