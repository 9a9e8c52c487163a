"""Writes logs: the same frames give the same bytes, in every format, on every machine.

`.log`, `.pcap` and `.pcapng` are written by candaemon itself, `.mf4` by asammdf; `.asc`, `.blf`, `.csv` and `.trc` by
python-can, whose headers are replaced where they would hold the wall clock, the time zone or the file's own path. What
each format preserves is listed in `candaemon.can_io.logs.read`. Frames must be written in order of time.
"""

from __future__ import annotations

import io
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, BinaryIO, Final, Self

from candaemon.can_io.logs.candump import candump_text
from candaemon.can_io.logs.compression import compression_by_name, packed
from candaemon.can_io.logs.formats import NOT_COMPRESSED, log_suffix, written_suffix
from candaemon.can_io.logs.mf4 import LARGEST_MF4_CHANNEL, Mf4Frames
from candaemon.can_io.logs.pcap import PcapngPackets, PcapPackets
from candaemon.can_io.logs.stream import can_number, channel_number
from candaemon.errors import InputError
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import Frame

if TYPE_CHECKING:
    import can

LARGEST_CHANNEL: Final = 65_534
"""Greatest number of a channel, from 0, in a log without names: a `.blf` has 16 bits for it, from 1."""

NUMBERED: Final = (".asc", ".blf", ".mf4", ".trc")
"""Formats that hold the numbers of channels, and no names."""

_MF4_ROWS = 8192  # frames that are written at once
_FOR_OTHERS = 128
"""Least number, from 0, of a bus that comes later and is not `canN`: above those that CAN interfaces have."""
_BLF_EPOCH_S = 631_152_000.0
"""s since 1970: python-can writes no earlier date into a `.blf`."""
_TOLD = 8  # channels in a message


class LogWriter(ABC):
    """Writes frames to a log until it is closed.

    Args:
        file: the log; compressed as its name says.
    """

    def __init__(self, file: OutputFile) -> None:
        self._path = file.path
        self._target = packed(file.stream, file.path)
        self._closed = False

    def write(self, frames: Sequence[Frame]) -> None:
        """Write frames.

        Args:
            frames: frames of the buses named in `open_log_writer`.

        Raises:
            InputError: the file cannot be written, or the format cannot hold such a frame.
        """
        self._write(frames)

    def lost(self) -> list[str]:
        """Return what of the frames written so far the format does not hold, in words."""
        return []

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
        self._channels = channels

    def _write(self, frames: Sequence[Frame]) -> None:
        self._target.write(candump_text(frames, self._channels))

    def _finish(self) -> None:
        """Write nothing: a candump log has no end mark."""


class PcapWriter(LogWriter):
    """Writes a capture, `.pcap` or `.pcapng`.

    Args:
        file: the log.
        channels: names of the buses, by index; a `.pcap` holds none.
    """

    def __init__(self, file: OutputFile, channels: Sequence[str]) -> None:
        super().__init__(file)
        with_names = log_suffix(file.path) == ".pcapng"
        self._packets = PcapngPackets(self._target, channels) if with_names else PcapPackets(self._target)

    def _write(self, frames: Sequence[Frame]) -> None:
        try:
            self._packets.write(frames)
        except ValueError as error:
            raise InputError(f"{error}; choose .pcapng", file=self._path) from None

    def _finish(self) -> None:
        """Write nothing: a capture has no end mark."""


class _ChannelNumbers:
    """Numbers of the buses in a format without names of channels.

    `can3` has the number 3, as which it is read. Of the buses known at first, another has the number that its name ends
    in where that is free, otherwise the least that is. One that comes later has a number that no `canN` is expected to
    have, since those that have not come yet are not known.

    Args:
        file: the log, for messages.
        channels: names of the buses, by index; may grow.
        largest: number that the format can hold.

    Raises:
        InputError: a number is greater.
    """

    def __init__(self, file: Path, channels: Sequence[str], largest: int) -> None:
        self._path, self._channels, self._largest = file, channels, largest
        self._numbers: dict[int, int] = {}
        self._used: set[int] = set()
        for wanted in (can_number, self._trailing):
            for bus, name in enumerate(channels):
                number = wanted(name)
                if bus not in self._numbers and number is not None and number not in self._numbers.values():
                    self._give(bus, number)
        for bus in range(len(channels)):
            if bus not in self._numbers:
                self._give(bus, self._free_from(0))

    def __getitem__(self, bus: int) -> int:
        if bus not in self._numbers:
            number = can_number(self._channels[bus])
            self._give(bus, self._free_from(_FOR_OTHERS) if number is None else number)
        self._used.add(bus)
        return self._numbers[bus]

    def renamed(self) -> dict[str, str]:
        """Return the names, of buses that were asked for, that are read as another, with that one."""
        read = {self._channels[bus]: f"can{self._numbers[bus]}" for bus in sorted(self._used)}
        return {name: other for name, other in read.items() if name != other}

    def _trailing(self, name: str) -> int | None:
        """Return the number that a name ends in; None where it has none that the format can hold."""
        number = channel_number(name)
        return number if number is not None and number <= self._largest else None

    def _free_from(self, least: int) -> int:
        """Return the least number from one on that no bus has."""
        return next(number for number in count(least) if number not in self._numbers.values())

    def _give(self, bus: int, number: int) -> None:
        if number > self._largest:
            raise InputError(
                f"this format numbers its channels up to {self._largest:,}, found {number}; choose .log, "
                "or give the bus a log_channel that ends in a smaller number",
                file=self._path,
            )
        if number in self._numbers.values():
            raise InputError(
                f"the number of channel {self._channels[bus]} was given to another, which came before it; choose .log, "
                "or save the log first: of a file the channels are known before it is written",
                file=self._path,
            )
        self._numbers[bus] = number


class Mf4Writer(LogWriter):
    """Writes an `.mf4`.

    Args:
        file: the log.
        channels: names of the buses, by index; the file holds their numbers.

    Raises:
        InputError: a channel's number is greater than `LARGEST_MF4_CHANNEL`, or asammdf is not installed.
    """

    def __init__(self, file: OutputFile, channels: Sequence[str]) -> None:
        super().__init__(file)
        self._numbers = _ChannelNumbers(file.path, channels, LARGEST_MF4_CHANNEL)
        self._frames: Mf4Frames | None = None
        self._waiting: list[Frame] = []

    def lost(self) -> list[str]:
        """Return what of the frames written so far the format does not hold, in words."""
        return _renamed(self._numbers)

    def _write(self, frames: Sequence[Frame]) -> None:
        self._waiting += frames
        if len(self._waiting) >= _MF4_ROWS:
            self._pass_on()

    def _pass_on(self) -> None:
        """Write what waits."""
        first_ns = self._waiting[0].time_ns if self._waiting else 0
        self._frames = self._frames or Mf4Frames(first_ns, self._path)
        if self._waiting:
            self._frames.write(self._waiting, [self._numbers[frame.bus] for frame in self._waiting])
        self._waiting = []

    def _finish(self) -> None:
        self._pass_on()
        if self._frames is not None:
            self._frames.finish(self._target)


class PythonCanWriter(LogWriter):
    """Writes a log through one of python-can's writers.

    Where the format counts up from the first frame, as `.asc` and `.blf` do, an earlier time is raised to that.

    Args:
        file: the log.
        channels: names of the buses, by index; the file holds their numbers.
        suffix: of the format.

    Raises:
        InputError: a channel's number is greater than `LARGEST_CHANNEL`.
    """

    def __init__(self, file: OutputFile, channels: Sequence[str], suffix: str) -> None:
        from candaemon.can_io.python_can import to_message  # noqa: PLC0415 - python-can, which takes long to import

        super().__init__(file)
        self._to_message = to_message
        self._numbers = _ChannelNumbers(file.path, channels, LARGEST_CHANNEL)
        self._suffix = suffix
        self._writer: can.io.generic.MessageWriter | None = None
        self._first_s = 0.0
        self._earliest_ns = self._raised = 0

    def lost(self) -> list[str]:
        """Return what of the frames written so far the format does not hold, in words."""
        lost = _renamed(self._numbers) if self._suffix in NUMBERED else []
        if self._raised:
            lost.append(
                f"{self._raised:,} time stamps before the first one, raised to it ({self._suffix} begins there)"
            )
        if self._suffix == ".asc":
            lost.append("the date (.asc counts from the first frame)")
        elif self._suffix == ".blf" and self._writer is not None and self._first_s < _BLF_EPOCH_S:
            lost.append("the date (.blf has none before 1990, and then counts from the first frame)")
        return lost

    def _write(self, frames: Sequence[Frame]) -> None:
        for frame in frames:
            writer = self._writer or self._begin(frame.time_ns)
            if frame.fd and self._suffix == ".trc":
                raise InputError("python-can writes no CAN FD to .trc; choose .log, .asc or .blf", file=self._path)
            message = self._to_message(frame, self._numbers[frame.bus])
            if frame.time_ns < self._earliest_ns:
                message.timestamp = self._earliest_ns / 1_000_000_000
                self._raised += 1
            writer.on_message_received(message)

    def _begin(self, first_ns: int) -> can.io.generic.MessageWriter:
        """Begin with a first frame's time."""
        self._first_s = first_ns / 1_000_000_000
        if self._suffix == ".asc":
            self._earliest_ns = first_ns
        elif self._suffix == ".blf":  # python-can begins it at a whole millisecond
            self._earliest_ns = int(self._first_s * 1000) * 1_000_000
        self._writer = _STARTERS[self._suffix](self._target, self._first_s)
        return self._writer

    def _finish(self) -> None:
        writer = self._writer or _STARTERS[self._suffix](self._target, 0.0)
        writer.stop()


def _renamed(numbers: _ChannelNumbers) -> list[str]:
    """Return which channels are read under another name, in words."""
    renamed = [f"{name} is read as {other}" for name, other in numbers.renamed().items()]
    more = [f"{len(renamed) - _TOLD:,} more"] if len(renamed) > _TOLD else []
    return [f"names of channels ({', '.join(renamed[:_TOLD] + more)})"] if renamed else []


def open_log_writer(file: OutputFile, channels: Sequence[str]) -> LogWriter:
    """Begin a log; the suffix of the file's name determines the format.

    Args:
        file: the log, with one of the readable suffixes; a further `.gz`, `.xz` or `.zst` compresses it. A pipe or a
            device needs none.
        channels: names of the buses, by index.

    Raises:
        InputError: unknown suffix.
    """
    suffix = written_suffix(file.path)
    if suffix in NOT_COMPRESSED and compression_by_name(file.path):
        raise InputError(f"{NOT_COMPRESSED[suffix]}; expected a name that ends in {suffix}", file=file.path)
    match suffix:
        case ".log":
            return CandumpWriter(file, channels)
        case ".pcap" | ".pcapng":
            return PcapWriter(file, channels)
        case ".mf4":
            return Mf4Writer(file, channels)
    return PythonCanWriter(file, channels, suffix)


def _text(target: BinaryIO) -> io.TextIOWrapper:
    """Return a text layer without conversion of line ends."""
    return io.TextIOWrapper(target, encoding="utf-8", newline="")


def _start_asc(target: BinaryIO, first_s: float) -> can.ASCWriter:
    """Start an `.asc` with the first frame's time in UTC, in place of python-can's wall clock time."""
    import can  # noqa: PLC0415 - it takes long to import

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
    import can  # noqa: PLC0415 - it takes long to import

    writer = can.TRCWriter(_text(target))
    writer.filepath = "candaemon"
    writer.first_timestamp = first_s
    writer.write_header(first_s)
    return writer


def _start_blf(target: BinaryIO, _first_s: float) -> can.BLFWriter:
    """Start a `.blf`."""
    import can  # noqa: PLC0415 - it takes long to import

    return can.BLFWriter(target)


def _start_csv(target: BinaryIO, _first_s: float) -> can.CSVWriter:
    """Start a `.csv`."""
    import can  # noqa: PLC0415 - it takes long to import

    return can.CSVWriter(_text(target))


_STARTERS: dict[str, Callable[[BinaryIO, float], can.io.generic.MessageWriter]] = {
    ".asc": _start_asc,
    ".blf": _start_blf,
    ".csv": _start_csv,
    ".trc": _start_trc,
}
