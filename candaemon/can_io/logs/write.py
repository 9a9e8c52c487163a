"""Writes logs: the same frames give the same bytes, in every format, on every machine.

`.log` is written by candaemon itself; `.asc`, `.blf`, `.csv` and `.trc` by python-can, whose headers are replaced where
they would hold the wall clock, the time zone or the file's own path. What each format preserves is listed in
`candaemon.can_io.logs.read`. Frames must be written in order of time.
"""

from __future__ import annotations

import gzip
import io
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from types import TracebackType
from typing import BinaryIO, Final, Self, cast

import can

from candaemon.can_io.logs.candump import candump_text
from candaemon.can_io.logs.read import log_suffix
from candaemon.can_io.logs.stream import channel_number
from candaemon.can_io.python_can import to_message
from candaemon.errors import InputError
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import Frame

LARGEST_CHANNEL: Final = 65_534
"""Greatest number of a channel, from 0, in a log without names: a `.blf` has 16 bits for it, from 1."""


class LogWriter(ABC):
    """Writes frames to a log until it is closed.

    Args:
        file: the log; compressed if its name ends in `.gz`.
    """

    def __init__(self, file: OutputFile) -> None:
        self._path = file.path
        self._target = file.stream
        self._closed = False
        if self._path.suffix.lower() == ".gz":
            # no name and no time in the gzip header, so that equal frames give equal bytes
            self._target = cast("BinaryIO", gzip.GzipFile(filename="", mode="wb", fileobj=file.stream, mtime=0))

    def write(self, frames: Sequence[Frame]) -> None:
        """Write frames.

        Args:
            frames: frames of the buses named in `open_log_writer`.

        Raises:
            InputError: the file cannot be written, or the format cannot hold such a frame.
        """
        self._write(frames)

    def close(self) -> None:
        """Finish the log. Calling it again does nothing.

        Raises:
            InputError: the file cannot be written.
        """
        if not self._closed:
            self._closed = True
            self._finish()
            self._target.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @abstractmethod
    def _write(self, frames: Sequence[Frame]) -> None:
        """Write frames to the target."""

    @abstractmethod
    def _finish(self) -> None:
        """Write the end of the log."""


class CandumpWriter(LogWriter):
    """Writes a candump log, `.log`.

    Args:
        file: the log.
        channels: names of the buses, by index.
    """

    def __init__(self, file: OutputFile, channels: Sequence[str]) -> None:
        super().__init__(file)
        self._channels = tuple(channels)

    def _write(self, frames: Sequence[Frame]) -> None:
        self._target.write(candump_text(frames, self._channels))

    def _finish(self) -> None:
        """Write nothing: a candump log has no end mark."""


class PythonCanWriter(LogWriter):
    """Writes a log through one of python-can's writers.

    Args:
        file: the log.
        channels: names of the buses, by index; the file holds the numbers that they end in where these are distinct,
            otherwise the indices.
        start: creates python-can's writer from the target and the first frame's time in s.

    Raises:
        InputError: a channel's number is greater than `LARGEST_CHANNEL`.
    """

    def __init__(
        self,
        file: OutputFile,
        channels: Sequence[str],
        start: Callable[[BinaryIO, float], can.io.generic.MessageWriter],
    ) -> None:
        super().__init__(file)
        named = [channel_number(name) for name in channels]
        distinct = len({number for number in named if number is not None}) == len(named)
        self._numbers = [number for number in named if number is not None] if distinct else [*range(len(named))]
        if max(self._numbers, default=0) > LARGEST_CHANNEL:
            raise InputError(
                f"this format numbers its channels up to {LARGEST_CHANNEL:,}, found {max(self._numbers)}; choose .log, "
                "or give the bus a log_channel that ends in a smaller number",
                file=self._path,
            )
        self._start = start
        self._writer: can.io.generic.MessageWriter | None = None

    def _write(self, frames: Sequence[Frame]) -> None:
        for frame in frames:
            if self._writer is None:
                self._writer = self._start(self._target, frame.time_ns / 1_000_000_000)
            if frame.fd and isinstance(self._writer, can.TRCWriter):
                raise InputError("python-can writes no CAN FD to .trc; choose .log, .asc or .blf", file=self._path)
            self._writer.on_message_received(to_message(frame, self._numbers[frame.bus]))

    def _finish(self) -> None:
        writer = self._writer or self._start(self._target, 0.0)
        writer.stop()


def open_log_writer(file: OutputFile, channels: Sequence[str]) -> LogWriter:
    """Begin a log; the suffix of the file's name determines the format.

    Args:
        file: the log, with one of the readable suffixes; a further `.gz` compresses it (not `.blf`, which is always
            compressed).
        channels: names of the buses, by index.

    Raises:
        InputError: unknown suffix.
    """
    suffix = log_suffix(file.path)
    if suffix == ".log":
        return CandumpWriter(file, channels)
    if suffix == ".blf" and file.path.suffix.lower() == ".gz":
        raise InputError("a .blf is compressed already; expected a name that ends in .blf", file=file.path)
    return PythonCanWriter(file, channels, _STARTERS[suffix])


def _text(target: BinaryIO) -> io.TextIOWrapper:
    """Return a text layer without conversion of line ends."""
    return io.TextIOWrapper(target, encoding="utf-8", newline="")


def _start_asc(target: BinaryIO, first_s: float) -> can.ASCWriter:
    """Start an `.asc` with the first frame's time in UTC, in place of python-can's wall clock time."""
    writer = can.ASCWriter(io.StringIO())
    start = datetime.fromtimestamp(first_s, UTC)
    date = f"{start:%a %b %d %H:%M:%S}.{start.microsecond // 1000:03d} {start:%Y}"
    writer.file = _text(target)
    writer.file.write(f"date {date}\nbase hex  timestamps absolute\ninternal events logged\n")
    writer.file.write(f"Begin Triggerblock {date}\n")
    writer.header_written = True
    writer.started = writer.last_timestamp = first_s
    writer.log_event("Start of measurement", first_s)
    return writer


def _start_trc(target: BinaryIO, first_s: float) -> can.TRCWriter:
    """Start a `.trc` without its own path in the header."""
    writer = can.TRCWriter(_text(target))
    writer.filepath = "candaemon"
    writer.first_timestamp = first_s
    writer.write_header(first_s)
    return writer


_STARTERS: dict[str, Callable[[BinaryIO, float], can.io.generic.MessageWriter]] = {
    ".asc": _start_asc,
    ".blf": lambda target, _: can.BLFWriter(target),
    ".csv": lambda target, _: can.CSVWriter(_text(target)),
    ".trc": _start_trc,
}
