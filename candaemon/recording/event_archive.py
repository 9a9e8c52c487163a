"""The event archive: the ring's files around an event, and the configurations that were in force.

An archived file is a hard link to the ring's own: that costs no copy, and a kill in the middle loses nothing of it.
Where the file system has no links, it is copied once it is complete.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import re
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from candaemon.binding.bound import Binding
from candaemon.config.recording import EventSettings
from candaemon.errors import InputError
from candaemon.files.atomic import atomic_write
from candaemon.playback.recording_files import CONFIGURATIONS, EVENTS, STATE, logs_in, number_of, utc
from candaemon.recording.ring import MEGABYTE, RingFile

logger = logging.getLogger(__name__)

_NOTE = "event.json"
_EVENTS_HERE = "????-??-??T??-??-??.???Z-*/"  # other folders are somebody else's
_DIGEST = re.compile("[0-9a-f]{12}")
_NO_LINKS = frozenset({errno.EPERM, errno.EOPNOTSUPP, errno.EMLINK})


@dataclass(frozen=True, slots=True)
class Event:
    """Something after which one wants to know what came before.

    Attributes:
        kind: `mark`, `obstacle` or the kind of a fault.
        about: which bus, sensor or obstacle; empty where the kind says it.
        time_ns: when.
        note: further entries of `event.json`.
    """

    kind: str
    about: str
    time_ns: int
    note: Mapping[str, Any] = field(default_factory=dict)


@dataclass(slots=True)
class _Open:
    """An event whose last files are yet to come."""

    event: Event
    folder: Path
    until_ns: int
    files: list[str]
    to_copy: Path | None = None


class EventArchive:
    """Keeps the files around events; used by one thread.

    Args:
        folder: of the recording.
        settings: how much before and after, how many, how large.
    """

    def __init__(self, folder: Path, settings: EventSettings) -> None:
        self._folder = folder
        self._settings = settings
        self._open: list[_Open] = []

    def begin(self, event: Event, ring: Iterable[RingFile], configuration: Path) -> None:
        """Keep what the ring holds of the time before an event.

        Args:
            event: what happened.
            ring: the files to keep, the oldest first; the last one is being written.
            configuration: folder of the one in force.

        Raises:
            OSError, InputError: the disk refuses.
        """
        name = "-".join(filter(None, (utc(event.time_ns), event.kind, _plain(event.about))))
        folder = self._folder / EVENTS / name
        folder.mkdir(parents=True, exist_ok=True)
        kept = _Open(event, folder, event.time_ns + round(self._settings.after * 1e9), [])
        *complete, current = ring
        for file in complete:
            _linked(file.log, folder) or shutil.copyfile(file.log, folder / file.log.name)
            _keep_state(file.log, folder)
            kept.files.append(file.log.name)
        self._keep_current(kept, current)
        _link_tree(configuration, folder / "configuration")
        self._open.append(kept)
        self._drop_old()

    def began(self, file: RingFile) -> None:
        """Take note of a file that the ring has begun: it belongs to the events that are still open.

        An event that cannot be kept any further, because its folder was removed, is left as it is: the ring goes on.

        Raises:
            OSError: the disk refuses.
        """
        were_open, self._open = self._open, []
        for kept in were_open:
            try:
                self._finish_copy(kept)
                if file.begin_ns < kept.until_ns:
                    self._keep_current(kept, file)
                    self._open.append(kept)
            except (OSError, InputError) as error:
                logger.warning("%s: the event is not kept any further: %s", kept.folder, error)
        if were_open:
            self._drop_old()

    def close(self) -> None:
        """Complete the events that are open.

        Raises:
            OSError: the disk refuses.
        """
        for kept in self._open:
            self._finish_copy(kept)
        self._open.clear()

    def _keep_current(self, kept: _Open, file: RingFile) -> None:
        """Keep the file being written, and say so in the event's note."""
        if not _linked(file.log, kept.folder):
            kept.to_copy = file.log
        _keep_state(file.log, kept.folder)
        kept.files.append(file.log.name)
        event = kept.event
        about = {"kind": event.kind, "about": event.about, "time": utc(event.time_ns), "time_ns": event.time_ns}
        note = {**about, "before": self._settings.before, "after": self._settings.after, "files": kept.files}
        atomic_write(kept.folder / _NOTE, json.dumps({**note, **event.note}, indent=2) + "\n")

    @staticmethod
    def _finish_copy(kept: _Open) -> None:
        """Copy the file that could not be linked, which is complete."""
        if kept.to_copy is not None:
            shutil.copyfile(kept.to_copy, kept.folder / kept.to_copy.name)
            kept.to_copy = None

    def _drop_old(self) -> None:
        """Let the oldest events go until the bounds hold, one that is open too; the newest one stays."""
        folders = sorted((self._folder / EVENTS).glob(_EVENTS_HERE), key=_age)
        while len(folders) > max(self._settings.kept, 1) or (
            len(folders) > 1 and _size(folders) > self._settings.disk * MEGABYTE
        ):
            oldest = folders.pop(0)
            logger.info("%s: the event goes, to make room for younger ones", oldest)
            shutil.rmtree(oldest)
            self._open = [kept for kept in self._open if kept.folder != oldest]


def archive_configuration(folder: Path, binding: Binding, name: str) -> Path:
    """Keep a configuration and its DBC files beside a recording, laid out so that it can be replayed with them.

    Args:
        folder: of the recording.
        binding: the configuration.
        name: its digest.

    Returns:
        The folder it lies in.

    Raises:
        OSError, InputError: the disk refuses.
    """
    kept = folder / CONFIGURATIONS / name
    here = Path.cwd()
    files = [Path(os.path.normpath(here / path)) for path in (binding.loaded.path, *map(Path, binding.databases))]
    base = os.path.commonpath([file.parent for file in files])
    for file in files:
        target = kept / file.relative_to(base)
        target.parent.mkdir(parents=True, exist_ok=True)
        if not target.exists():
            atomic_write(target, file.read_bytes())
    return kept


def remove_unused_configurations(folder: Path, used: frozenset[str]) -> None:
    """Let the configurations go that no file of the ring needs.

    Raises:
        OSError: the disk refuses.
    """
    for kept in (folder / CONFIGURATIONS).iterdir():
        if _DIGEST.fullmatch(kept.name) and kept.name not in used:
            shutil.rmtree(kept)


def _linked(file: Path, folder: Path) -> bool:
    """Link a file into a folder; False where the file system has no links."""
    target = folder / file.name
    if not target.exists():
        try:
            os.link(file, target)
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            return False
    return True


def _keep_state(log: Path, folder: Path) -> None:
    """Keep the state that a log begins with."""
    state = log.with_suffix(STATE)
    if state.exists() and not _linked(state, folder):
        shutil.copyfile(state, folder / state.name)


def _link_tree(tree: Path, target: Path) -> None:
    """Keep a folder with all that is in it."""
    for file in tree.rglob("*"):
        if file.is_file():
            place = target / file.relative_to(tree)
            place.parent.mkdir(parents=True, exist_ok=True)
            if not _linked(file, place.parent):
                shutil.copyfile(file, place)


def _age(folder: Path) -> tuple[int, str]:
    """Return what sorts events by when they happened, whatever the clock said."""
    return max((number_of(log) or 0 for log in logs_in(folder)), default=0), folder.name


def _size(folders: Iterable[Path]) -> int:
    """Return the bytes that folders take together, a file in two of them once."""
    about = (file.stat() for folder in folders for file in folder.rglob("*") if file.is_file())
    return sum({each.st_ino: each.st_size for each in about}.values())


def _plain(text: str) -> str:
    """Return a text as a part of a file's name."""
    return "".join(letter if letter.isalnum() or letter == "_" else "_" for letter in text)
