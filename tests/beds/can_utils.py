"""Debian's can-utils as functions."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from .waiting import wait_until

LISTENERS = Path("/proc/net/can/rcvlist_all")
BUFFER = 8_000_000
"""Bytes of candump's receive buffer, so that it misses nothing."""
END_S = 5.0


class Line(NamedTuple):
    """A line of candump's log format: time in s, interface, and the frame as ID#DATA."""

    time: str
    interface: str
    frame: str


class Capture:
    """What candump hears.

    Args:
        path: of its log.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def lines(self, interface: str | None = None) -> list[Line]:
        """Return what has been heard so far, of one interface in order, or of all, of each in order."""
        whole = [text for text in self.path.read_text(encoding="ascii").splitlines(keepends=True) if text[-1] == "\n"]
        lines = [Line(time[1:-1], name, frame) for time, name, frame in map(str.split, whole)]
        return [line for line in lines if interface in (None, line.interface)]

    def wait_for(self, count: int, timeout_s: float = 10.0) -> list[Line]:
        """Return what has been heard as soon as it is so many frames."""
        wait_until(lambda: len(self.lines()) >= count, timeout_s, lambda: f"{count} frames, {len(self.lines())} came")
        return self.lines()


@contextmanager
def background(*words: str, output: Path | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """Run a command, and end it with the context if it has not ended by itself.

    Args:
        words: the command.
        output: a file for what it writes.
    """
    with (output or Path("/dev/null")).open("wb") as file, subprocess.Popen(words, stdout=file) as process:
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()


@contextmanager
def candump(path: Path, *interfaces: str) -> Iterator[Capture]:
    """Log all frames of some interfaces while the context lasts; it listens when the context begins.

    Args:
        path: of the log.
        interfaces: their names, with candump's filters if wanted: `vcan0,500:700`.
    """
    before = _listeners()
    with background("candump", "-L", "-r", str(BUFFER), *interfaces, output=path):
        filtered = sum("," in each for each in interfaces)
        wait_until(lambda: _listeners() >= before + len(interfaces) - filtered, END_S, "candump listens")
        yield Capture(path)


def cansend(interface: str, frame: str) -> None:
    """Send a frame given as ID#DATA."""
    subprocess.run(["cansend", interface, frame], check=True)


def canplayer(log: Path, onto: Mapping[str, str], *options: str) -> None:
    """Play a candump log at its own speed to its end; other interfaces of the log are left out.

    Args:
        log: the file, not compressed.
        onto: interface to send on, by that of the log.
        options: canplayer's own; `-t` plays as fast as it goes.
    """
    subprocess.run(["canplayer", *options, "-I", str(log), *(f"{to}={of}" for of, to in onto.items())], check=True)


def cangen(interface: str, *options: str) -> None:
    """Send generated frames until `-n` of them are sent."""
    subprocess.run(["cangen", interface, *options], check=True)


def _listeners() -> int:
    """Return how many sockets take all frames of an interface."""
    return LISTENERS.read_text(encoding="ascii").count(" raw") if LISTENERS.exists() else 0
