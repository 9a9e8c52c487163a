"""The event archive: the ring's files around an event, and the configurations that were in force.

An archived file is a hard link to the ring's own: that costs no copy, and a kill in the middle loses nothing of it.
Where the file system has no links, it is copied once it is complete.
"""

from __future__ import annotations

import json
import logging
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from candaemon.binding.bound import Binding
from candaemon.config.recording import EventSettings
from candaemon.errors import InputError
from candaemon.files.bounded import read_bounded
from candaemon.files.own_folder import OwnFolder
from candaemon.playback.recording_files import CONFIGURATIONS, EVENTS, LOG, number_in, utc
from candaemon.recording.ring import MEGABYTE, RingFile

logger = logging.getLogger(__name__)

LARGEST_SOURCE: Final = 1 << 26
"""Bytes of a configuration or DBC file that is kept beside a recording."""
LONGEST_EVENT_S: Final = 300.0
"""How much later than the first an event of the same kind may come and be a part of it, s."""

_NOTE = "event.json"
_CONFIGURATION = "configuration"
_EVENT = re.compile(r"\d{4}-\d\d-\d\dT\d\d-\d\d-\d\d\.\d{3}Z-.*", re.ASCII)
_DIGEST = re.compile("[0-9a-f]{12}")
_LONGEST_ABOUT = 50  # characters of four bytes at most, in a name of 255 bytes


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

    def __str__(self) -> str:
        return f"{self.kind} {self.about}" if self.about else self.kind


@dataclass(slots=True)
class _Open:
    """An event whose last files are yet to come."""

    event: Event
    name: str
    until_ns: int
    files: list[str]
    to_copy: str = ""


class EventArchive:
    """Keeps the files around events; used by one thread.

    Args:
        folder: of the recording.
        settings: how much before and after, how many, how large.
    """

    def __init__(self, folder: OwnFolder, settings: EventSettings) -> None:
        self._folder = folder
        self._settings = settings
        self._after_ns = round(settings.after * 1e9)
        self._open: list[_Open] = []

    def prolong(self, event: Event) -> bool:
        """Keep as much after this event as after the first one, if one of its kind is being kept; say whether one is.

        However often one is asked for, others do not have to go to make room for it.
        """
        for kept in self._open:
            of_same_kind = (kept.event.kind, kept.event.about) == (event.kind, event.about)
            if of_same_kind and kept.event.time_ns <= event.time_ns < min(
                kept.until_ns, kept.event.time_ns + round(LONGEST_EVENT_S * 1e9)
            ):
                kept.until_ns = event.time_ns + self._after_ns
                return True
        return False

    def begin(self, event: Event, ring: Iterable[RingFile], configuration: str) -> None:
        """Keep what the ring holds of the time before an event.

        Args:
            event: what happened.
            ring: the files to keep, the oldest first; the last one is being written.
            configuration: digest of the one in force; empty where it could not be kept.

        Raises:
            OSError, InputError: the disk refuses.
        """
        name = "-".join(filter(None, (utc(event.time_ns), event.kind, _plain(event.about))))
        kept = _Open(event, name, event.time_ns + self._after_ns, [])
        *complete, current = ring
        with self._folder.folder(EVENTS, name) as folder:
            for file in complete:
                self._folder.keep(file.log, folder)
                self._keep_state(file, folder)
                kept.files.append(file.log)
            self._keep_current(kept, current, folder)
            if configuration:
                with (
                    self._folder.folder(CONFIGURATIONS, configuration, make=False) as source,
                    folder.folder(_CONFIGURATION) as target,
                ):
                    _keep_tree(source, target)
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
                with self._folder.folder(EVENTS, kept.name, make=False) as folder:
                    self._finish_copy(kept, folder)
                    if file.begin_ns < kept.until_ns:
                        self._keep_current(kept, file, folder)
                        self._open.append(kept)
            except (OSError, InputError) as error:
                logger.warning(
                    "%s: the event is not kept any further: %s", self._folder.path / EVENTS / kept.name, error
                )
        if were_open:
            self._drop_old()

    def close(self) -> None:
        """Complete the events that are open.

        Raises:
            OSError, InputError: the disk refuses.
        """
        for kept in self._open:
            if kept.to_copy:
                with self._folder.folder(EVENTS, kept.name, make=False) as folder:
                    self._finish_copy(kept, folder)
        self._open.clear()

    def _keep_current(self, kept: _Open, file: RingFile, folder: OwnFolder) -> None:
        """Keep the file being written, and say so in the event's note."""
        if not self._folder.link(file.log, folder):
            kept.to_copy = file.log
        self._keep_state(file, folder)
        kept.files.append(file.log)
        event = kept.event
        about = {"kind": event.kind, "about": event.about, "time": utc(event.time_ns), "time_ns": event.time_ns}
        note = {**about, "before": self._settings.before, "after": self._settings.after, "files": kept.files}
        folder.replace(_NOTE, (json.dumps({**note, **event.note}, indent=2) + "\n").encode())

    def _finish_copy(self, kept: _Open, folder: OwnFolder) -> None:
        """Copy the file that could not be linked, which is complete."""
        if kept.to_copy:
            self._folder.keep(kept.to_copy, folder)
            kept.to_copy = ""

    def _keep_state(self, file: RingFile, folder: OwnFolder) -> None:
        """Keep the state that a log begins with."""
        if self._folder.has(file.state):
            self._folder.keep(file.state, folder)

    def _drop_old(self) -> None:
        """Let the oldest events go until the bounds hold, one that is open too; the newest one stays."""
        with self._folder.folder(EVENTS) as events:
            names = sorted(_events_in(events), key=lambda name: (_newest(events, name), name))
            while len(names) > max(self._settings.kept, 1) or (
                len(names) > 1 and _size(events, names) > self._settings.disk * MEGABYTE
            ):
                oldest = names.pop(0)
                logger.info("%s: the event goes, to make room for younger ones", events.path / oldest)
                try:
                    events.remove_tree(oldest)
                except OSError as error:
                    logger.warning("%s: cannot be removed: %s", events.path / oldest, error.strerror)
                self._open = [kept for kept in self._open if kept.name != oldest]


def archive_configuration(folder: OwnFolder, binding: Binding, name: str) -> None:
    """Keep a configuration and its DBC files beside a recording, laid out so that it can be replayed with them.

    What cannot be read any more is left out, with a message: what is recorded does not depend on it.

    Args:
        folder: of the recording.
        binding: the configuration.
        name: its digest.

    Raises:
        OSError, InputError: the disk refuses.
    """
    here = Path.cwd()
    files = [Path(os.path.normpath(here / path)) for path in (binding.loaded.path, *map(Path, binding.databases))]
    base = os.path.commonpath([file.parent for file in files])
    for file in files:
        *above, last = file.relative_to(base).parts
        with folder.folder(CONFIGURATIONS, name, *above) as kept:
            if not kept.has(last):
                try:
                    content = read_bounded(file, LARGEST_SOURCE)
                except OSError as error:
                    logger.warning("%s: not kept beside the recording: %s", file, error.strerror)
                    continue
                kept.replace(last, content)


def remove_unused_configurations(folder: OwnFolder, used: frozenset[str]) -> None:
    """Let the configurations go that no file of the ring needs.

    Args:
        folder: of the recording.
        used: digests of those that the files need; one that is empty may be any.

    Raises:
        OSError, InputError: the disk refuses.
    """
    if "" in used:
        return
    with folder.folder(CONFIGURATIONS) as configurations:
        for entry in list(configurations.entries()):
            is_own = configurations.is_own_folder(entry.stat(follow_symlinks=False))
            if is_own and _DIGEST.fullmatch(entry.name) and entry.name not in used:
                configurations.remove_tree(entry.name)


def _keep_tree(source: OwnFolder, target: OwnFolder) -> None:
    """Keep a folder with all that is in it, but for links and the like."""
    for entry in source.entries():
        if entry.is_dir(follow_symlinks=False):
            with source.folder(entry.name, make=False) as below, target.folder(entry.name) as place:
                _keep_tree(below, place)
        elif entry.is_file(follow_symlinks=False):
            source.keep(entry.name, target)


def _events_in(events: OwnFolder) -> Iterator[str]:
    """Yield the names of the events that are kept; what else is there is somebody else's."""
    for entry in events.entries():
        if _EVENT.match(entry.name) and events.is_own_folder(entry.stat(follow_symlinks=False)):
            yield entry.name


def _newest(events: OwnFolder, name: str) -> int:
    """Return what sorts events by when they happened, whatever the clock said: the number of the last file."""
    with events.folder(name, make=False) as event:
        stems = (entry.name.removesuffix(LOG) for entry in event.entries() if entry.name.endswith(LOG))
        return max((number_in(stem) or 0 for stem in stems), default=0)


def _size(events: OwnFolder, names: Iterable[str]) -> int:
    """Return the bytes that events take together, a file in two of them once."""
    sizes: dict[int, int] = {}
    for name in names:
        for _, _, files, descriptor in os.fwalk(name, dir_fd=events.descriptor):
            for file in files:
                about = os.stat(file, dir_fd=descriptor, follow_symlinks=False)
                sizes[about.st_ino] = about.st_size
    return sum(sizes.values())


def _plain(text: str) -> str:
    """Return a text as a part of a file's name."""
    return "".join(letter if letter.isalnum() or letter == "_" else "_" for letter in text[:_LONGEST_ABOUT])
