"""The ring on the disk: files of what the pipeline took, the oldest giving way to the newest.

Whatever comes, the ring takes no more than its share of the disk. It counts input, not hours: what was recorded before
a restart of the service stays until as much has been recorded after it.
"""

from __future__ import annotations

import errno
import os
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from candaemon.config.recording import RecordingSettings
from candaemon.errors import InputError
from candaemon.files.atomic import atomic_write, make_folder
from candaemon.pipeline.saved_state.fingerprint import digest
from candaemon.playback.recording_files import LOG, STATE, header_beside, logs_in, number_of

MEGABYTE = 1_000_000
SHARE_OF_A_FILE = 1 / 8
"""Of the ring's share of the disk: so much of it goes at once when the oldest file does."""


@dataclass(slots=True)
class RingFile:
    """One file of the ring.

    Attributes:
        log: the file; its state lies beside it.
        begin_ns: time of its first item.
        end_ns: time of the item behind its last.
        size: bytes, those of the state too.
        configuration: digest of the one in force; empty where it is not known.
    """

    log: Path
    begin_ns: int
    end_ns: int
    size: int
    configuration: str

    @property
    def span_ns(self) -> int:
        """How much input it holds, ns."""
        return max(self.end_ns - self.begin_ns, 0)


class Ring:
    """Writes the ring; used by one thread.

    Args:
        folder: where it lies; what an earlier run of the service left there is a part of it.
        settings: its bounds.

    Attributes:
        files: the oldest first; the last one is the one being written, if one is.
    """

    def __init__(self, folder: Path, settings: RecordingSettings) -> None:
        self._folder = folder
        self._most_bytes = round(settings.disk * MEGABYTE)
        self._most_ns = round(settings.minutes * 60e9)
        self._longest_ns = round(settings.file_seconds * 1e9)
        self._sync = settings.sync
        self._descriptor = -1
        self.files = deque(self._found())

    def begin(self, name: str, time_ns: int, state: bytes, configuration: str) -> RingFile:
        """Begin a file.

        Args:
            name: without suffix.
            time_ns: of its first item.
            state: of the pipeline before it.
            configuration: digest of the one in force.

        Raises:
            OSError, InputError: the disk refuses.
        """
        self.close()
        if self.files:
            self.files[-1].end_ns = max(time_ns, self.files[-1].begin_ns)
        self._make_room(len(state))
        make_folder(self._folder)  # whoever removes it to free the disk does not end the recording
        log = self._folder / f"{name}{LOG}"
        atomic_write(log.with_suffix(STATE), state)
        self._descriptor = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o644)
        if self._sync:
            _force(log.with_suffix(STATE))
            _force(self._folder)
        file = RingFile(log, time_ns, time_ns, len(state), configuration)
        self.files.append(file)
        return file

    def write(self, text: bytes) -> None:
        """Append whole lines to the file that was begun.

        Raises:
            OSError: the disk refuses; nothing of them is left in the file then.
        """
        self._make_room(len(text))
        before = os.lseek(self._descriptor, 0, os.SEEK_END)
        try:
            rest = memoryview(text)
            while rest:
                rest = rest[os.write(self._descriptor, rest) :]
            if self._sync:
                os.fdatasync(self._descriptor)
        except OSError:
            os.ftruncate(self._descriptor, before)
            raise
        self.files[-1].size += len(text)

    def close(self) -> None:
        """Close the file being written, if one is."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def drop_oldest(self) -> None:
        """Make room on a disk that is full."""
        if len(self.files) > 1:
            self._drop()

    def last(self, span_ns: int) -> list[RingFile]:
        """Return the file being written and those before it that hold so much input together, the oldest first."""
        found: deque[RingFile] = deque()
        for file in reversed(self.files):
            if found and sum(each.span_ns for each in found) >= span_ns:
                break
            found.appendleft(file)
        return list(found)

    def _make_room(self, size: int) -> None:
        """Let the oldest files go until the bounds hold with `size` bytes more."""
        open_ = self._descriptor >= 0
        while len(self.files) > open_ and (
            sum(each.size for each in self.files) + size > self._most_bytes
            or sum(each.span_ns for each in self.files) - self.files[0].span_ns > self._most_ns
        ):
            self._drop()

    def _drop(self) -> None:
        """Remove the oldest file; its state last, so that no log is replayed from nothing by mistake."""
        log = self.files[0].log
        log.unlink(missing_ok=True)
        log.with_suffix(STATE).unlink(missing_ok=True)
        self.files.popleft()

    def _found(self) -> Iterator[RingFile]:
        """Yield the files that an earlier run left, and remove what a kill left half done."""
        for part in self._folder.glob(f".*{STATE}.part"):
            part.unlink(missing_ok=True)
        logs = [log for log in logs_in(self._folder) if number_of(log) is not None]
        for state in {*self._folder.glob(f"*{STATE}")} - {log.with_suffix(STATE) for log in logs}:
            if number_of(state) is not None:  # others are somebody else's
                state.unlink(missing_ok=True)
        for log in logs:
            about = log.stat()
            state = log.with_suffix(STATE)
            size = about.st_size + (state.stat().st_size if state.exists() else 0)
            try:
                header = header_beside(log)
            except InputError:
                header = None
            if header is None:
                yield RingFile(log, about.st_mtime_ns, about.st_mtime_ns, size, "")
                continue
            end_ns = min(max(about.st_mtime_ns, header.time_ns), header.time_ns + self._longest_ns)
            yield RingFile(log, header.time_ns, end_ns, size, digest(header.fingerprint))


def _force(path: Path) -> None:
    """Force a file, or the names in a folder, onto the disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def is_disk_full(error: OSError) -> bool:
    """Return whether a disk refuses because nothing fits any more."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT)
