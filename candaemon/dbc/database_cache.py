"""DBC files that were parsed before, kept in the user's cache folder.

To parse a DBC takes most of the time that a command needs before it begins: importing the parser, then reading the
file. What comes of it depends on the file's bytes and on the versions of the parsers alone, which together name the
entry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from candaemon._version import __version__
from candaemon.dbc.database_bytes import read_database
from candaemon.dbc.types import Database, Diagnostic, MessageSpec, SignalSpec
from candaemon.files import entry_cache
from candaemon.files.bounded import FileReader, read_bounded
from candaemon.files.entry_cache import EntryCache

LONGEST_ENTRY: Final = 32 << 20
"""Bytes of an entry, at most; of a DBC that makes more, none is kept."""

MOST_ENTRIES: Final = 64
"""Entries of the folder, at most; those that were written first go first."""

_FORM: Final = "2"
"""Of an entry; another one's entries are not read."""
_SIGNAL: Final = tuple(each.name for each in fields(SignalSpec))
_MESSAGE: Final = ("name", "can_id", "length", "is_fd", "cycle_time", "comment", "line")


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
    cache, name = EntryCache(folder, LONGEST_ENTRY, MOST_ENTRIES), entry_name(content)
    known = cache.find(name)
    if known is not None:
        return from_plain(known, path)
    database = _parsed(content, path)
    cache.keep(name, to_plain(database))
    return database


def entry_name(content: bytes) -> str:
    """Return the name of the entry of a DBC file's bytes, as these versions parse it."""
    return entry_cache.entry_name(content, _FORM, __version__, version("cantools"))


def _parsed(content: bytes, path: Path) -> Database:
    """Return what a file's bytes hold."""
    from candaemon.dbc.database import parse_database  # noqa: PLC0415  # its patterns take longer than reading an entry

    return parse_database(content, path)


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
