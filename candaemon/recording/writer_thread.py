"""The thread that writes a recording: the core loop hands over bytes and never waits for the disk.

What waits is bounded. A disk that refuses, or is too slow for it, costs input, which is counted; the recording then
goes on with a file of its own as soon as the disk takes one. So it is from the start: a folder that cannot be made or
read yet is tried again, and keeps no service from starting.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import TypeAlias

from candaemon.binding.bound import Binding
from candaemon.config.recording import RecordingSettings
from candaemon.errors import InputError
from candaemon.playback.recording_files import LOG, stem
from candaemon.recording.counts import RecordingCounts
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


@dataclass(frozen=True, slots=True)
class _Opened:
    """What is used of a folder that is open."""

    ring: Ring
    events: EventArchive


class WriterThread:
    """Writes what it is handed, in that order, in a thread of its own.

    Args:
        folder: of the recording.
        settings: bounds of the ring and of what is kept.


    Raises:
        InputError: the folder cannot be used until somebody changes it, see `Ring`.

    Attributes:
        counts: what is written and lost.
        refusals: times that the disk refused; what was handed over after that is lost until a file is begun.
    """

    def __init__(self, folder: Path, settings: RecordingSettings) -> None:
        self._folder = folder
        self._settings = settings
        self.counts = RecordingCounts()
        self._most_waiting = round(settings.buffer * MEGABYTE)
        self._jobs: SimpleQueue[_Job | None] = SimpleQueue()
        self._waiting = self._waiting_items = 0
        self._given_up = False
        self._lock = Lock()
        self._opened: _Opened | None = None
        self._kept_configuration = ""
        self._full = False
        self._refused = False
        self._warned_s = -_QUIET_S
        self._number = 0
        self.refusals = 0
        self._try_to_open()
        self._thread = Thread(target=self._serve, name="recording", daemon=True)
        self._thread.start()

    @property
    def is_open(self) -> bool:
        """Whether the folder is open, which it is not while the disk refuses that."""
        return self._opened is not None

    @property
    def has_room(self) -> bool:
        """Whether a file can be begun: the folder is open, and at least half of what may wait is free."""
        return self._opened is not None and self._waiting <= self._most_waiting // 2

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
        with self._lock:
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
        with self._lock:
            self._waiting_items += items
        self._put(_Write(text, items))
        return True

    def archive(self, event: Event) -> None:
        """Archive the recording around an event; it is lost, and counted, where too much waits already."""
        if self._waiting + _EVENT_BYTES > self._most_waiting:
            self.counts.lose_event()
        else:
            self._put(_Archive(event))

    def close(self, timeout_s: float) -> None:
        """Write what waits and end; what a disk has not taken after `timeout_s` s is given up, and counted as lost."""
        self._jobs.put(None)
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            with self._lock:
                self._given_up = True
                self.counts.lose(self._waiting_items)
            logger.warning("%s: the disk is too slow; what came last is not recorded", self._folder)

    def _put(self, job: _Job) -> None:
        """Queue a job for the thread; its bytes count as waiting until it is done."""
        with self._lock:
            self._waiting += job.size
        self._jobs.put(job)

    def _serve(self) -> None:
        """Do the jobs in order; the thread's function."""
        while (job := self._next()) is not None:
            match job:
                case _Begin():
                    self._begin(job)
                case _Write():
                    self._write(job)
                case _Archive():
                    self._archive(job.event)
            with self._lock:
                self._waiting -= job.size
        if self._opened is not None:
            try:
                self._opened.events.close()
            except (OSError, InputError) as error:
                self._refuse(error)
            self._opened.ring.close()

    def _next(self) -> _Job | None:
        """Return the next job, None at the end; the folder is tried again meanwhile where it could not be opened."""
        while self._opened is None:
            try:
                return self._jobs.get(timeout=self._settings.retry)
            except Empty:
                try:
                    self._try_to_open()
                except InputError as error:
                    self._refuse(error)
        return self._jobs.get()

    def _try_to_open(self) -> None:
        """Open the folder; where the disk refuses, the recording is off until it does not.

        Raises:
            InputError: the folder cannot be used until somebody changes it.
        """
        try:
            self._open()
        except OSError as error:
            self._refuse(error)

    def _open(self) -> _Opened:
        """Open the folder, and go on with what lies in it.

        Raises:
            OSError, InputError: it cannot be.
        """
        if self._opened is not None:
            opened, self._opened = self._opened, None
            opened.ring.close()
        ring = Ring(self._folder, self._settings)
        with self._lock:
            self._number = max(self._number, ring.highest)
        self._opened = _Opened(ring, EventArchive(ring.folder, self._settings.events))
        self._count_files(ring)
        return self._opened

    def _begin(self, job: _Begin) -> None:
        if job.goes_on and self._refused:
            return
        try:
            opened = self._opened
            if opened is None or not opened.ring.folder.is_at_its_path():
                opened = self._open()  # whoever removes it to free the disk does not end the recording
            if self._full:
                opened.ring.drop_oldest()
            file = opened.ring.begin(job.name, job.time_ns, job.state, job.configuration)
            archive_configuration(opened.ring.folder, job.binding, job.configuration)
            self._kept_configuration = job.configuration
            opened.events.began(file)
            remove_unused_configurations(
                opened.ring.folder, frozenset(each.configuration for each in opened.ring.files)
            )
        except (OSError, InputError) as error:
            self._refuse(error)
            return
        if self._refused:
            logger.info("%s: recorded again, after %d items in all were left out", self._folder, self.counts.lost)
        self._refused = self._full = False
        self._count_files(opened.ring)

    def _write(self, job: _Write) -> None:
        is_written = self._took(job.text)
        with self._lock:
            self._waiting_items -= job.items
            if self._given_up:  # counted as lost already
                return
        if is_written:
            self.counts.items += job.items
        else:
            self.counts.lose(job.items)

    def _took(self, text: bytes) -> bool:
        """Write lines to the file begun last; return whether they are there."""
        if self._opened is None or self._refused:
            return False
        try:
            self._opened.ring.write(text)
        except OSError as error:
            self._refuse(error)
            return False
        self._count_files(self._opened.ring)
        return True

    def _archive(self, event: Event) -> None:
        opened = self._opened
        if opened is None or not opened.ring.files:
            self.counts.lose_event()
            logger.warning("the event %s is not kept: nothing is recorded yet", event)
            return
        if opened.events.prolong(event):
            return
        here_ns = event.time_ns - opened.ring.files[-1].begin_ns
        files = opened.ring.last(max(round(self._settings.events.before * 1e9) - here_ns, 0))
        try:
            opened.events.begin(event, files, self._kept_configuration)
        except (OSError, InputError) as error:
            self.counts.lose_event()
            logger.warning("the event %s is not kept: %s", event, error)
        else:
            self.counts.events += 1

    def _refuse(self, error: OSError | InputError) -> None:
        """Stop writing until a file is begun again; say so at a limited rate."""
        self._refused = True
        self.refusals += 1
        self._full = isinstance(error, OSError) and is_disk_full(error)
        if self._opened is not None:
            self._opened.ring.end()
        if time.monotonic() - self._warned_s >= _QUIET_S:
            self._warned_s = time.monotonic()
            logger.warning(
                "%s: not recorded, the disk refuses: %s; tried again every %g s",
                self._folder,
                error,
                self._settings.retry,
            )

    def _count_files(self, ring: Ring) -> None:
        self.counts.files, self.counts.bytes = len(ring.files), ring.bytes
