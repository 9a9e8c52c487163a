"""Keeps encoded pictures in order of time, on disk, within limits; one thread appends, others read."""

from __future__ import annotations

import os
import tempfile
import weakref
from array import array
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass, field
from threading import Lock
from typing import IO, Any, Final

from candaemon.errors import InputError

LARGEST_DRIVE: Final = 4 << 30
"""Bytes of the pictures of a log that can be looked at; four hours with 64 obstacles at 20 Hz."""
LARGEST_LIVE: Final = 128 << 20
"""Bytes of the pictures of live buses that can be looked back at; some minutes with 64 obstacles, else an hour."""

_SEGMENTS: Final = 8
"""Of equal size that the pictures are kept in; the oldest is given up whole."""


@dataclass(slots=True, weakref_slot=True)
class _Segment:
    """Consecutive pictures in one unnamed file; of picture k the bytes from `ends[k]` to `ends[k + 1]`."""

    file: IO[Any]
    times: array[float] = field(default_factory=lambda: array("d"))
    ends: array[int] = field(default_factory=lambda: array("Q", [0]))


def _segment() -> _Segment:
    """Return an empty segment, whose file is closed when nobody refers to it any more."""
    file = tempfile.TemporaryFile(prefix="candaemon-view-", buffering=0)  # noqa: SIM115 - closed as said
    segment = _Segment(file)
    weakref.finalize(segment, file.close)
    return segment


def _write(descriptor: int, picture: bytes, at: int) -> None:
    """Write a picture whole: a disk that is nearly full takes a part of it without an error.

    Raises:
        InputError: the disk has no room for it.
    """
    try:
        while picture:
            written = os.pwrite(descriptor, picture, at)
            picture, at = picture[written:], at + written
    except OSError as error:
        raise InputError(
            f"pictures cannot be kept there: {error.strerror}; make room, or set TMPDIR to another folder",
            file=tempfile.gettempdir(),
        ) from error


@dataclass(frozen=True, slots=True)
class Extent:
    """What a store holds.

    Attributes:
        first, after: numbers of the first picture and of the one after the last; numbers never change.
        first_s, last_s: their times, s; 0 where there is none.
        complete: whether no more will come.
        cut: whether the drive goes on behind the last picture that there was room for.
    """

    first: int
    after: int
    first_s: float
    last_s: float
    complete: bool
    cut: bool


class PictureStore:
    """Pictures by number and by time.

    Args:
        largest: bytes that it may hold.
        forgets: whether the oldest make room; otherwise no more are taken.
    """

    def __init__(self, largest: int = LARGEST_DRIVE, *, forgets: bool = False) -> None:
        self._segment_size = max(largest // _SEGMENTS, 1)
        self._forgets = forgets
        self._lock = Lock()
        self._segments: deque[_Segment] = deque()
        self._first = self._after = 0
        self._last_s = 0.0
        self._complete = self._cut = False

    def append(self, time_s: float, picture: bytes) -> bool:
        """Take a picture; return whether there was room.

        Args:
            time_s: its time, s; one before the latest picture's counts as that.
            picture: its bytes.

        Raises:
            InputError: the disk has no room for it.
        """
        with self._lock:
            if not self._segments or self._segments[-1].ends[-1] + len(picture) > self._segment_size:
                if len(self._segments) == _SEGMENTS and not self._make_room():
                    return False
                self._segments.append(_segment())
            segment = self._segments[-1]
            _write(segment.file.fileno(), picture, segment.ends[-1])
            self._last_s = max(time_s, self._last_s) if self._after > self._first else time_s
            segment.times.append(self._last_s)
            segment.ends.append(segment.ends[-1] + len(picture))
            self._after += 1
            return True

    def complete(self) -> None:
        """Say that no more will come."""
        with self._lock:
            self._complete = True

    def extent(self) -> Extent:
        """Return what it holds."""
        with self._lock:
            first_s = self._segments[0].times[0] if self._after > self._first else 0.0
            return Extent(self._first, self._after, first_s, self._last_s, self._complete, self._cut)

    def number_at(self, time_s: float) -> int:
        """Return the number of the first picture later than a time: those before it are of that time or earlier."""
        with self._lock:
            number = self._first
            for segment in self._segments:
                if segment.times[-1] > time_s:
                    return number + bisect_right(segment.times, time_s)
                number += len(segment.times)
            return number

    def time_of(self, number: int) -> float:
        """Return the time of a picture, s; of one that is not there, that of the nearest."""
        with self._lock:
            at = min(max(number, self._first), self._after - 1) - self._first
            for segment in self._segments:
                if at < len(segment.times):
                    return segment.times[at]
                at -= len(segment.times)
            return 0.0

    def read(self, first: int, after: int) -> list[bytes]:
        """Return the pictures of these numbers, those left out that are not there."""
        found: list[bytes] = []
        with self._lock:
            begin = self._first
            for segment in self._segments:
                low, high = max(first - begin, 0), min(after - begin, len(segment.times))
                begin += len(segment.times)
                if low >= high:
                    continue
                start, ends = segment.ends[low], segment.ends
                data = os.pread(segment.file.fileno(), ends[high] - start, start)
                found += [data[ends[k] - start : ends[k + 1] - start] for k in range(low, high)]
        return found

    def close(self) -> None:
        """Give all of it up."""
        with self._lock:
            for segment in self._segments:
                segment.file.close()
            self._segments.clear()
            self._first = self._after

    def _make_room(self) -> bool:
        """Give up the oldest segment, if it forgets; return whether there is room."""
        if not self._forgets:
            self._cut = True
            return False
        oldest = self._segments.popleft()
        self._first += len(oldest.times)
        oldest.file.close()
        return True
