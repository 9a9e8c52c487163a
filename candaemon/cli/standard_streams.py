"""Standard output and error, be they closed, full, without a reader, or in an encoding that lacks characters."""

from __future__ import annotations

import io
import logging
import os
import signal
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Final, TextIO

from candaemon.files.outputs import is_standard_output

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

logger = logging.getLogger(__name__)

STDOUT: Final = "standard output"
""""File name" of its errors."""


def prepare() -> None:
    """Make the standard streams usable.

    A closed one is the null device from now on, so that no file is opened in its place and no message gets into it.
    Characters that the encoding lacks are written as escapes.
    """
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free, which is this one
    sys.stdout = sys.stdout or _null()
    sys.stderr = sys.stderr or _null()
    if sys.stdout is sys.__stdout__ and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout = _named(sys.stdout)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def use_utf8() -> None:
    """Let standard output be UTF-8 whatever the terminal's encoding is: for what programs read, such as JSON."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(encoding="utf-8")


@contextmanager
def prints_beside(arguments: Iterable[object]) -> Iterator[None]:
    """Let what is printed go to standard error where standard output takes one of a command's files.

    Args:
        arguments: of the command; its files are the paths among them.
    """
    taken = any(isinstance(each, Path) and is_standard_output(each) for each in arguments)
    with redirect_stdout(sys.stderr) if taken else nullcontext():
        yield


@contextmanager
def input_ended_by_interrupt() -> Iterator[None]:
    """Let Ctrl-C end standard input, and so what is read of it, with its results; a second one ends the process."""
    former = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or former is not signal.default_int_handler:
        yield
        return

    def end(_number: int, _frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, former)
        null = os.open(os.devnull, os.O_RDONLY)
        os.dup2(null, 0)  # a read that waits is tried again, and finds the end
        os.close(null)

    signal.signal(signal.SIGINT, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, former)


def finish(code: int) -> int:
    """Write out what the streams still hold, so that nothing fails later.

    Args:
        code: exit code of what was done.

    Returns:
        That exit code; 1 in place of 0 where results were lost. A reader that has gone away has what it wanted.
    """
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        _abandon(sys.stdout)
    except OSError as error:
        logger.error("error: %s: %s", STDOUT, error.strerror)  # noqa: TRY400 - for the user
        _abandon(sys.stdout)
        code = code or 1
    try:
        sys.stderr.flush()
    except OSError:
        _abandon(sys.stderr)
    return code


class _RawStdout(io.FileIO):
    """Standard output, whose errors say that they are its own."""

    def write(self, data: ReadableBuffer, /) -> int:
        """Write bytes; return how many were taken."""
        try:
            return super().write(data)
        except OSError as error:
            error.filename = STDOUT
            raise


def _named(stdout: io.TextIOWrapper) -> io.TextIOWrapper:
    """Return standard output as it is, with errors of its own."""
    return io.TextIOWrapper(
        io.BufferedWriter(_RawStdout(stdout.fileno(), "wb", closefd=False)),
        encoding=stdout.encoding,
        line_buffering=stdout.line_buffering,
        write_through=stdout.write_through,
    )


def _null() -> io.TextIOWrapper:
    """Return a stream that swallows all."""
    return open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123 - open until the process ends


def _abandon(stream: TextIO) -> None:
    """Redirect a stream to the null device: what it still holds cannot fail when the process ends."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, stream.fileno())
    os.close(null)
