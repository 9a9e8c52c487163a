"""The thread that writes a recording: the core loop hands over bytes and never waits for the disk.

What waits is bounded. A disk that refuses, or is too slow for it, costs input, which is counted; the recording then
goes on with a file of its own as soon as the disk takes one.
"""

from __future__ import annotations

import fcntl
import logging
import os
import time
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from threading import Lock, Thread
from typing import TypeAlias

from candaemon.binding.bound import Binding
from candaemon.config.recording import RecordingSettings
from candaemon.errors import InputError
from candaemon.playback.recording_files import LOG, number_of, stem
from candaemon.recording.event_archive import Event, EventArchive, archive_configuration, remove_unused_configurations
from candaemon.recording.ring import MEGABYTE, Ring, is_disk_full

logger = logging.getLogger(__name__)

_QUIET_S = 60.0  # between two warnings of a disk that refuses
_EVENT_BYTES = 1000  # what an event takes of the memory while it waits, about


@dataclass(frozen=True, slots=True)
class _Begin:
    """Begin a file; the arguments of `WriterThread.begin`, and the name of the file."""

    name: str
    time_ns: int
    state: bytes
    binding: Binding
    configuration: str
    goes_on: bool

    @property
    def size(self) -> int:
        """Bytes held until it is done."""
        return len(self.state)


@dataclass(frozen=True, slots=True)
class _Write:
    """Append lines to the file begun last."""

    text: bytes
    items: int

    @property
    def size(self) -> int:
        """Bytes held until it is done."""
        return len(self.text)


@dataclass(frozen=True, slots=True)
class _Archive:
    """Archive an event."""

    event: Event

    @property
    def size(self) -> int:
        """Bytes held until it is done, about."""
        return _EVENT_BYTES


_Job: TypeAlias = _Begin | _Write | _Archive


class WriterThread:
    """Writes what it is handed, in that order, in a thread of its own.

    Args:
        folder: of the recording.
        settings: bounds of the ring and of what is kept.

    Raises:
        InputError: another service records into the folder.

    Attributes:
        refusals: times that the disk refused; what was handed over after that is lost until a file is begun.
        lost: items that could not be written.
        written: items written.
        files, bytes: of the ring.
        events_archived: events archived since the start.
        events_lost: events that could not be.
    """

    def __init__(self, folder: Path, settings: RecordingSettings) -> None:
        self._folder = folder
        self._claim = _claimed(folder)
        self._settings = settings
        self._most_waiting = round(settings.buffer * MEGABYTE)
        self._jobs: SimpleQueue[_Job | None] = SimpleQueue()
        self._waiting = 0
        self._lock = Lock()
        self._ring = Ring(folder, settings)
        self._events = EventArchive(folder, settings.events)
        self._kept_configuration = folder
        self._full = False
        self._refused = False
        self._warned_s = -_QUIET_S
        self._number = max((number_of(each.log) or 0 for each in self._ring.files), default=0)
        self.refusals = self.lost = self.written = self.events_archived = self.events_lost = 0
        self.files, self.bytes = self._size()
        self._thread = Thread(target=self._serve, name="recording", daemon=True)
        self._thread.start()

    @property
    def has_room(self) -> bool:
        """Whether at least half of what may wait is free."""
        return self._waiting <= self._most_waiting // 2

    def begin(self, time_ns: int, state: bytes, binding: Binding, configuration: str, *, goes_on: bool = False) -> str:
        """Begin a file.

        One that goes on where the file before ends is not begun where the end of that was refused meanwhile: read as
        one, they would lead to something else.

        Args:
            time_ns: of its first item.
            state: of the pipeline before it.
            binding: the configuration in force.
            configuration: its digest.
            goes_on: whether the two are read as one.

        Returns:
            The name of its log.
        """
        self._number += 1
        name = stem(time_ns, self._number)
        self._put(_Begin(name, time_ns, state, binding, configuration, goes_on))
        return f"{name}{LOG}"

    def write(self, text: bytes, items: int) -> bool:
        """Append lines to the file begun last; False where too much waits already.

        Args:
            text: whole lines.
            items: how many.
        """
        if self._waiting + len(text) > self._most_waiting:
            return False
        self._put(_Write(text, items))
        return True

    def archive(self, event: Event) -> None:
        """Archive the recording around an event; it is lost, and counted, where too much waits already."""
        if self._waiting + _EVENT_BYTES > self._most_waiting:
            self.events_lost += 1
        else:
            self._put(_Archive(event))

    def close(self, timeout_s: float) -> None:
        """Write what waits and end; what a disk has not taken after `timeout_s` s is given up."""
        self._jobs.put(None)
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            logger.warning("%s: the disk is too slow; what came last is not recorded", self._folder)

    def _put(self, job: _Job) -> None:
        """Queue a job for the thread; its bytes count as waiting until it is done."""
        with self._lock:
            self._waiting += job.size
        self._jobs.put(job)

    def _serve(self) -> None:
        """Do the jobs in order; the thread's function."""
        while (job := self._jobs.get()) is not None:
            match job:
                case _Begin():
                    self._begin(job)
                case _Write():
                    self._write(job.text, job.items)
                case _Archive():
                    self._archive(job.event)
            with self._lock:
                self._waiting -= job.size
        try:
            self._ring.close()
            self._events.close()
        except OSError as error:
            self._refuse(error)
        os.close(self._claim)

    def _begin(self, job: _Begin) -> None:
        if job.goes_on and self._refused:
            return
        try:
            if self._full:
                self._ring.drop_oldest()
            file = self._ring.begin(job.name, job.time_ns, job.state, job.configuration)
            self._kept_configuration = archive_configuration(self._folder, job.binding, job.configuration)
            self._events.began(file)
            remove_unused_configurations(self._folder, frozenset(each.configuration for each in self._ring.files))
        except (OSError, InputError) as error:
            self._refuse(error)
            return
        if self._refused:
            logger.info("%s: recorded again, after %d items in all were left out", self._folder, self.lost)
        self._refused = self._full = False
        self.files, self.bytes = self._size()

    def _write(self, text: bytes, items: int) -> None:
        if self._refused:
            self.lost += items
            return
        try:
            self._ring.write(text)
        except OSError as error:
            self.lost += items
            self._refuse(error)
        else:
            self.written += items
            self.files, self.bytes = self._size()

    def _archive(self, event: Event) -> None:
        if not self._ring.files:
            return
        here_ns = event.time_ns - self._ring.files[-1].begin_ns
        files = self._ring.last(max(round(self._settings.events.before * 1e9) - here_ns, 0))
        try:
            self._events.begin(event, files, self._kept_configuration)
        except (OSError, InputError) as error:
            self.events_lost += 1
            logger.warning("the event %s %s is not kept: %s", event.kind, event.about, error)
        else:
            self.events_archived += 1

    def _refuse(self, error: OSError | InputError) -> None:
        """Stop writing until a file is begun again; say so at a limited rate."""
        self._refused = True
        self.refusals += 1
        cause = error if isinstance(error, OSError) else error.__cause__
        self._full = isinstance(cause, OSError) and is_disk_full(cause)
        self._ring.close()
        if time.monotonic() - self._warned_s >= _QUIET_S:
            self._warned_s = time.monotonic()
            logger.warning(
                "%s: not recorded, the disk refuses: %s; tried again every %g s",
                self._folder,
                error,
                self._settings.retry,
            )

    def _size(self) -> tuple[int, int]:
        """Return how many files the ring has, and their bytes."""
        return len(self._ring.files), sum(file.size for file in self._ring.files)


def _claimed(folder: Path) -> int:
    """Return a descriptor that keeps other services away from a folder for as long as it is open.

    Raises:
        InputError: one of them has it.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(descriptor)
        raise InputError(
            "another service records into it; expected a folder of its own for each", file=folder
        ) from error
    except OSError:  # a file system without locks
        logger.debug("%s: the file system has no locks", folder)
    return descriptor
