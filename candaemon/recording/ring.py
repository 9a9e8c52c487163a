"""The ring on the disk: files of what the pipeline took, the oldest giving way to the newest.

Whatever comes, the ring takes no more than its share of the disk. It counts input, not hours: what was recorded before
a restart of the service stays until as much has been recorded after it.

What lies in the folder at the start is from outside: an earlier version, a backup, a damaged disk. Of a file no more
than its name, its kind and its size is looked at, and what cannot be a part of the ring is set aside.
"""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import re
import stat
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from candaemon.config.recording import RecordingSettings
from candaemon.errors import InputError
from candaemon.files.own_folder import OwnFolder, write_all
from candaemon.playback.recording_files import CONFIGURATIONS, LOG, STATE, number_in, time_in

logger = logging.getLogger(__name__)

MEGABYTE = 1_000_000
SHARE_OF_A_FILE = 1 / 8
"""Of the ring's share of the disk: so much of it goes at once when the oldest file does."""
MOST_FILES: Final = 100_000
"""Files of the ring, each with its state."""
HIGHEST_NUMBER: Final = 990_000_000_000
"""Of a file that an earlier run left: so that further ones have the same count of digits."""
MOST_TOLD: Final = 10
"""Files set aside at a start of which each has a message of its own."""

_PART = re.compile(r"\.(.+)\.state\.part")
_STUCK = frozenset({errno.EISDIR, errno.EPERM})
"""Why an entry cannot be removed though the disk takes orders."""


@dataclass(slots=True)
class RingFile:
    """One file of the ring.

    Attributes:
        stem: its name without suffix.
        begin_ns: time of its first item.
        end_ns: time of the item behind its last.
        size: bytes, those of the state too.
        configuration: digest of the one in force; empty for a file of an earlier run.
    """

    stem: str
    begin_ns: int
    end_ns: int
    size: int
    configuration: str

    @property
    def log(self) -> str:
        """Name of the log."""
        return f"{self.stem}{LOG}"

    @property
    def state(self) -> str:
        """Name of the state before it."""
        return f"{self.stem}{STATE}"

    @property
    def span_ns(self) -> int:
        """How much input it holds, ns."""
        return max(self.end_ns - self.begin_ns, 0)


class Ring:
    """Writes the ring; used by one thread. No other process writes into its folder while it is open.

    Args:
        path: where it lies; what an earlier run of the service left there is a part of it.
        settings: its bounds.

    Raises:
        OSError: the folder cannot be made or read.
        InputError: the folder cannot be used, see `OwnFolder`; or another service records into it.

    Attributes:
        folder: that it lies in.
        files: the oldest first; the last one is the one being written, if one is.
        bytes: that they take.
        highest: number of the file with the highest.
    """

    def __init__(self, path: Path, settings: RecordingSettings) -> None:
        self._most_bytes = round(settings.disk * MEGABYTE)
        self._most_ns = round(settings.minutes * 60e9)
        self._longest_ns = round(settings.file_seconds * 1e9)
        self._sync = settings.sync
        self._descriptor = -1
        self.files: deque[RingFile] = deque()
        self.bytes = self._span_ns = self.highest = 0
        self.folder = OwnFolder.at(path, CONFIGURATIONS)
        try:
            _claim(self.folder)
            self._scan()
        except BaseException:
            self.folder.close()
            raise

    def begin(self, name: str, time_ns: int, state: bytes, configuration: str) -> RingFile:
        """Begin a file.

        Args:
            name: without suffix.
            time_ns: of its first item.
            state: of the pipeline before it.
            configuration: digest of the one in force.

        Raises:
            OSError: the disk refuses.
        """
        self.end()
        if self.files:
            self._span_ns -= self.files[-1].span_ns
            self.files[-1].end_ns = max(time_ns, self.files[-1].begin_ns)
            self._span_ns += self.files[-1].span_ns
        self._make_room(len(state))
        file = RingFile(name, time_ns, time_ns, len(state), configuration)
        # the state first: a log has one at any time, and a kill leaves at most a state of no log
        self.folder.write(file.state, state, sync=self._sync)
        try:
            self._descriptor = self.folder.create(file.log)
        except OSError:
            self.folder.remove(file.state)
            raise
        if self._sync:
            os.fsync(self.folder.descriptor)
        self._add(file)
        return file

    def write(self, text: bytes) -> None:
        """Append whole lines to the file that was begun.

        Raises:
            OSError: the disk refuses; nothing of them is left in the file then. Or somebody removed the file.
        """
        self._make_room(len(text))
        before = os.lseek(self._descriptor, 0, os.SEEK_END)
        try:
            write_all(self._descriptor, text)
            if self._sync:
                os.fdatasync(self._descriptor)
        except OSError:
            os.ftruncate(self._descriptor, before)
            raise
        if not self.folder.names(self.files[-1].log, self._descriptor):
            self._forget(self.files.pop())
            raise OSError(errno.ENOENT, "the file being written was removed")
        self.files[-1].size += len(text)
        self.bytes += len(text)

    def end(self) -> None:
        """Close the file being written, if one is."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def close(self) -> None:
        """Close the file being written, and leave the folder to others."""
        self.end()
        self.folder.close()

    def drop_oldest(self) -> None:
        """Make room on a disk that is full."""
        if len(self.files) > 1:
            self._drop()

    def last(self, span_ns: int) -> list[RingFile]:
        """Return the file being written and those before it that hold so much input together, the oldest first."""
        found: deque[RingFile] = deque()
        held_ns = 0
        for file in reversed(self.files):
            if found and held_ns >= span_ns:
                break
            found.appendleft(file)
            held_ns += file.span_ns
        return list(found)

    def _make_room(self, size: int) -> None:
        """Let the oldest files go until the bounds hold with `size` bytes more."""
        open_ = self._descriptor >= 0
        while len(self.files) > open_ and (
            self.bytes + size > self._most_bytes
            or self._span_ns - self.files[0].span_ns > self._most_ns
            or len(self.files) >= MOST_FILES
        ):
            self._drop()

    def _drop(self) -> None:
        """Remove the oldest file; its state last, so that no log is replayed from nothing by mistake."""
        file = self.files[0]
        for name in (file.log, file.state):
            try:
                self.folder.remove(name)
            except OSError as error:
                if error.errno not in _STUCK:
                    raise
                logger.warning("%s: '%s' cannot be removed: %s", self.folder.path, name, error.strerror)
        self._forget(self.files.popleft())

    def _add(self, file: RingFile) -> None:
        self.files.append(file)
        self.bytes += file.size
        self._span_ns += file.span_ns

    def _forget(self, file: RingFile) -> None:
        """Take a file that is no longer in the ring out of its sums."""
        self.bytes -= file.size
        self._span_ns -= file.span_ns

    def _scan(self) -> None:
        """Find the files that an earlier run left, and remove what a kill left half done."""
        logs: dict[str, int] = {}
        states: set[str] = set()
        for entry in self.folder.entries():
            name = entry.name
            if name.endswith(STATE):
                states.add(name[: -len(STATE)])
            elif name.endswith(LOG):
                number = number_in(name[: -len(LOG)])
                if number is not None:
                    logs[name[: -len(LOG)]] = number
            elif (part := _PART.fullmatch(name)) and number_in(part[1]) is not None:
                self._remove_leftover(name)
        aside = _Aside(self.folder)
        in_order = sorted(sorted(logs), key=logs.__getitem__)
        surplus = max(len(in_order) - MOST_FILES, 0)
        for stem in in_order[:surplus]:  # they go with the next file; to look at each takes its time
            self.files.append(RingFile(stem, 0, 0, 0, ""))
            states.discard(stem)
        for stem in in_order[surplus:]:
            if logs[stem] > HIGHEST_NUMBER:
                aside.put(f"{stem}{LOG}", "its number leaves none for further files")
                continue
            file = self._found(stem, aside, has_state=stem in states)
            if file is not None:
                self._add(file)
                self.highest = logs[stem]
                states.discard(stem)
        for stem in states - logs.keys():
            if number_in(stem) is not None:
                self._remove_leftover(f"{stem}{STATE}")
        for stem in states & logs.keys():  # of a log that was set aside
            aside.put(f"{stem}{STATE}", "its log is damaged")
        aside.tell()

    def _found(self, stem: str, aside: _Aside, *, has_state: bool) -> RingFile | None:
        """Return a file that an earlier run left; None where it is none."""
        about = aside.own_file(f"{stem}{LOG}")
        if about is None:
            return None
        size = _taken(about)
        if has_state and (state := aside.own_file(f"{stem}{STATE}")) is not None:
            size += _taken(state)
        begin_ns = time_in(stem)
        if begin_ns is None:
            begin_ns = about.st_mtime_ns
        end_ns = min(max(about.st_mtime_ns, begin_ns), begin_ns + self._longest_ns)
        return RingFile(stem, begin_ns, end_ns, size, "")

    def _remove_leftover(self, name: str) -> None:
        """Remove what a kill left half done, unless it is something else that has its name."""
        try:
            if self.folder.is_own_file(self.folder.stat(name)):
                self.folder.remove(name)
        except OSError as error:
            logger.warning("%s: '%s' cannot be removed: %s", self.folder.path, name, error.strerror)


class _Aside:
    """Sets aside what has the name of a file of the ring and is none; nothing of it is removed.

    Args:
        folder: of the ring.
    """

    def __init__(self, folder: OwnFolder) -> None:
        self._folder = folder
        self._count = 0

    def own_file(self, name: str) -> os.stat_result | None:
        """Return what the file system says of a file; None where it is none of this user, and is set aside."""
        try:
            about = self._folder.stat(name)
        except OSError as error:
            self.put(name, error.strerror or "it cannot be read")
            return None
        if not self._folder.is_own_file(about):
            self.put(name, "it belongs to another user" if stat.S_ISREG(about.st_mode) else "it is no regular file")
            return None
        return about

    def put(self, name: str, reason: str) -> None:
        """Rename an entry to what the ring does not look at; where that is refused it stays, and is left out."""
        self._count += 1
        try:
            became = f"set aside as '{self._folder.set_aside(name)}'"
        except OSError as error:
            became = f"left out, it cannot be renamed: {error.strerror}"
        if self._count <= MOST_TOLD:
            logger.warning("%s: '%s' is no file of a recording (%s): %s", self._folder.path, name, reason, became)

    def tell(self) -> None:
        """Say how many more there were."""
        if self._count > MOST_TOLD:
            logger.warning("%s: %d more such files", self._folder.path, self._count - MOST_TOLD)


def _taken(about: os.stat_result) -> int:
    """Return the bytes that a file takes of the disk: holes take none."""
    return min(about.st_size, about.st_blocks * 512)


def _claim(folder: OwnFolder) -> None:
    """Keep other services away from a folder for as long as it is open.

    Raises:
        InputError: one of them has it.
    """
    try:
        fcntl.flock(folder.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(
            "another service records into it; expected a folder of its own for each", file=folder.path
        ) from error
    except OSError:  # a file system without locks
        logger.debug("%s: the file system has no locks", folder.path)


def is_disk_full(error: OSError) -> bool:
    """Return whether a disk refuses because nothing fits any more."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT)
