"""Tries inputs on a target within limits of time and memory; the smallest found of each failure is kept as a file."""

from __future__ import annotations

import mmap
import resource
import signal
import struct
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from types import FrameType

import candaemon
from tests.support.memory import peak_bytes

from .targets import Target

LONGEST = 8192
"""Bytes of an input."""
CPU_S = 10.0
"""What an input may take of the processors, s: it does not depend on what else the machine does."""
RISE = 400_000_000
"""Bytes that the process may grow by in one input."""

_PACKAGE = Path(candaemon.__file__).parent
_ROOM = 1 << 30  # bytes of addresses beyond those that the process has: what is asked for is refused, not the machine's
_TRIES = 300
_MINIMISING_S = 10.0
_CURRENT = struct.Struct("<QI")


class TooLong(BaseException):
    """An input takes too much time; not an Exception, so that nothing takes it for an error of its own."""


class Current:
    """The input that is tried, in a file that outlives the process.

    Args:
        path: of the file, made where there is none.
    """

    def __init__(self, path: Path) -> None:
        with path.open("a+b") as file:
            file.truncate(_CURRENT.size + LONGEST)
            self._memory = mmap.mmap(file.fileno(), _CURRENT.size + LONGEST)

    def put(self, number: int, data: bytes) -> None:
        """Note the input of a number."""
        self._memory[_CURRENT.size : _CURRENT.size + len(data)] = data
        _CURRENT.pack_into(self._memory, 0, number, len(data))

    def get(self) -> tuple[int, bytes]:
        """Return the number of the input that was tried last, and the input."""
        number, size = _CURRENT.unpack_from(self._memory)
        return number, self._memory[_CURRENT.size : _CURRENT.size + size]


class Trial:
    """Tries inputs one after another.

    Args:
        target: takes them.
        current: where the input that is tried is noted.
        found: told of each failure: what it is, and the input.

    Attributes:
        inputs: tried so far.
        counts: what became of them, as the target counts.
    """

    def __init__(self, target: Target, current: Current, found: Callable[[str, bytes], None]) -> None:
        self._target = target
        self._current = current
        self._found = found
        self._known: set[str] = set()
        self.inputs = 0
        self.counts: Counter[str] = Counter()

    def take(self, data: bytes) -> None:
        """Try an input; tell of a failure that has not been seen yet."""
        data = data[:LONGEST]
        self.inputs += 1
        self._current.put(self.inputs, data)
        failure = self._failure(data, self.counts)
        if failure and failure not in self._known:
            self._known.add(failure)
            self._found(failure, self._smaller(data, failure))

    def _failure(self, data: bytes, counts: Counter[str]) -> str:
        """Return what goes wrong with an input, and where; empty if nothing does."""
        before = _resident()
        try:
            with _timed():
                counts.update(self._target(data))
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # noqa: BLE001 - whatever it is, it is what is looked for
            return _named(error)
        if _peak() - before > RISE:
            _forget_peak()
            return f"MemoryError: more than {RISE / 1e6:.0f} MB"
        return ""

    def _smaller(self, data: bytes, failure: str) -> bytes:
        """Return a smaller input that fails likewise: pieces are taken out as long as it does."""
        end_s, tries, size = time.monotonic() + _MINIMISING_S, 0, len(data) // 2
        while size and tries < _TRIES and time.monotonic() < end_s:
            for at in range(len(data) - size, -1, -size):
                shorter = data[:at] + data[at + size :]
                tries += 1
                if self._failure(shorter, Counter()) == failure:
                    data = shorter
                if tries >= _TRIES or time.monotonic() >= end_s:
                    break
            size //= 2
        return data


def file_name(failure: str) -> str:
    """Return a name for the input of a failure: its kind and a digest."""
    return f"{failure.partition(':')[0].lower()}-{sha256(failure.encode('utf-8', 'replace')).hexdigest()[:8]}"


def bound_memory() -> None:
    """Let the process have little more memory than it has: what asks for all of it fails by itself."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + _ROOM
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    signal.signal(signal.SIGPROF, _interrupt)


@contextmanager
def _timed() -> Iterator[None]:
    signal.setitimer(signal.ITIMER_PROF, CPU_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise TooLong(f"more than {CPU_S:g} s of processor time")


def _named(error: BaseException) -> str:
    """Return an error's type and the place in this project that it came from."""
    if isinstance(error, TooLong):  # where it was at that moment says nothing
        return f"{type(error).__name__}: {error}"
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if Path(frame.filename).is_relative_to(_PACKAGE)] or frames
    return f"{type(error).__name__}: {Path(own[-1].filename).name} {own[-1].name}"


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize()


def _peak() -> int:
    """Return the most memory that the process held since the peak was forgotten."""
    return peak_bytes()


def _forget_peak() -> None:
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return
