"""Files that a command writes: each beside its final name until it is whole, and never over what is read."""

from __future__ import annotations

import errno
import fcntl
import io
import os
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, BinaryIO, Final, Self, TypeAlias

from candaemon.errors import ConfigError, InputError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

PART: Final = ".part"
"""What the name of a file ends in until the file is whole."""

_BUFFER = 1 << 14  # bytes
_MOST_LINKS = 40  # as Linux

_Identity: TypeAlias = str | tuple[int, int]
"""What tells a file from others: its path without links, or device and inode."""


class OutputFile:
    """A file being written: `NAME.part` beside its final name, which it gets when it is whole.

    A context manager. Left without an error, the file is forced onto the disk and put in the place of what had its
    name; a link goes on pointing to its file, which keeps its owner and mode. Left with an error, what was there stays
    as it is, and `NAME.part` is removed. After an interruption (Ctrl-C, a signal that ends the process) `NAME.part`
    stays, and a note of the exception names it.

    Pipes, devices and the process's own descriptors, such as `/dev/stdout`, are written straight; they are opened when
    the first byte is written. Once the reader of standard output has gone, it has what it wanted: what else is written
    there is dropped as long as there is other work, and ends with a `BrokenPipeError` where there is none.

    Args:
        path: the file.
        is_alone: whether nothing else is written.

    Raises:
        InputError: it cannot be written there, or another process is writing it; names the path.

    Attributes:
        path: as given.
    """

    def __init__(self, path: Path | str, is_alone: Callable[[], bool] = lambda: True) -> None:
        self.path = Path(path)
        self._is_alone = is_alone
        self._stream: io.BufferedWriter | None = None
        self._part: _Part | None = None
        with _named(self.path):
            if not _is_special(self.path):
                self._part = _Part(self.path)

    @property
    def stream(self) -> BinaryIO:
        """Takes the content; raises an `InputError` with the path where that fails. Whoever writes may close it."""
        if self._stream is None:
            with _named(self.path):
                opened = _opened(self.path) if self._part is None else os.dup(self._part.descriptor)
            self._stream = io.BufferedWriter(_RawOutput(opened, self.path, self._is_alone), _BUFFER)
        return self._stream

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        _leave([self], error)

    def finish(self) -> None:
        """Write what is still buffered and force it onto the disk; the file has its temporary name still.

        Raises:
            InputError: the disk refuses.
        """
        if self._stream is not None:
            self._stream.close()
        if self._part is not None:
            with _named(self.path):
                os.fsync(self._part.descriptor)

    def place(self) -> None:
        """Give the file its final name.

        Raises:
            InputError: that is refused; the message names where the whole content is.
        """
        part, self._part = self._part, None
        if part is None:
            return
        try:
            part.path.replace(part.target)
        except OSError as error:
            raise InputError(
                f"cannot be replaced: {error.strerror}; its new content is in {part.path}", file=self.path
            ) from error
        finally:
            part.close()

    def abandon(self, *, keep: bool) -> str:
        """End before the content is whole.

        Args:
            keep: whether what was written stays under its temporary name.

        Returns:
            A sentence on where that is; empty where nothing is.
        """
        if self._stream is not None:
            with suppress(InputError, BrokenPipeError):
                self._stream.close()
        part, self._part = self._part, None
        if part is None:
            return ""
        keep = keep and os.fstat(part.descriptor).st_size > 0
        if not keep:
            part.path.unlink(missing_ok=True)
        part.close()
        return f"what was written until then is in {part.path}" if keep else ""


class Outputs:
    """All files that a command writes, each an `OutputFile`: they appear together when the command has succeeded.

    A context manager; on an error or an interruption nothing that was there before is touched. A file that is read too,
    or is written twice, is refused, whatever links lead to it.

    Args:
        inputs: files that the command reads.
    """

    def __init__(self, inputs: Iterable[Path] = ()) -> None:
        self._inputs: dict[_Identity, Path] = {}
        self._written: dict[_Identity, Path] = {}
        self._files: list[OutputFile] = []
        for path in inputs:
            with suppress(OSError):  # whoever reads it will say so
                self._inputs |= dict.fromkeys(_identities(path), path)

    def open(self, path: Path) -> OutputFile:
        """Begin a file.

        Raises:
            ConfigError: it is read too, or written already.
            InputError: it cannot be written; names the path.
        """
        with _named(path):
            identities = _identities(path)
            if not _is_special(path):
                identities.append(os.path.realpath(path) + PART)
        for identity in identities:
            if identity in self._inputs:
                raise _refused(path, "read", self._inputs[identity])
            if identity in self._written:
                raise _refused(path, "written", self._written[identity])
        file = OutputFile(path, lambda: len(self._files) == 1)
        self._files.append(file)
        self._written |= dict.fromkeys(identities, path)
        return file

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        _leave(self._files, error)


def write_file(path: Path, content: str | bytes) -> None:
    """Write a file whole or not at all; see `OutputFile`.

    Args:
        path: the file.
        content: text is written as UTF-8.

    Raises:
        InputError: it cannot be written; names the path.
    """
    with OutputFile(path) as file:
        file.stream.write(content.encode() if isinstance(content, str) else content)


def make_folder(path: Path) -> None:
    """Create a folder, and those above it, unless it is there.

    Raises:
        InputError: it cannot be created or written to, or a file is in its place; names the path.
    """
    with _named(path):
        path.mkdir(parents=True, exist_ok=True)
        if not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, "there is no right to write to it")


def _leave(files: list[OutputFile], error: BaseException | None) -> None:
    """End files that belong together: all get their names, or none does.

    Args:
        files: those.
        error: what ended the work; None: it is done. Notes on what is kept are added to an interruption.
    """
    if error is None:
        try:
            for file in files:
                file.finish()
            _place(files)
        except BaseException as failure:
            _leave(files, failure)
            raise
        return
    interrupted = not isinstance(error, Exception)
    for note in filter(None, [file.abandon(keep=interrupted) for file in files]):
        error.add_note(note)


def _place(files: list[OutputFile]) -> None:
    """Give files their final names.

    Raises:
        InputError: that of the first that was refused its name, with the others.
    """
    refused: list[InputError] = []
    for file in files:
        try:
            file.place()
        except InputError as error:
            refused.append(error)
    if refused:
        first, *others = refused
        raise InputError(first.message, file=first.file, others=others)


class _Part:
    """The file with a temporary name beside its target: created anew, and locked against other processes.

    Args:
        path: of the output.

    Raises:
        OSError: it cannot be created, or the target could not be written.

    Attributes:
        target: the file that the path leads to, which may be missing yet.
        path: of the part.
        descriptor: open for writing.
    """

    def __init__(self, path: Path) -> None:
        there = _status(path)
        if there is None and path.is_symlink() and path.lstat().st_uid != os.geteuid():
            raise PermissionError(errno.EACCES, "it is another user's link, to no file")
        if there is not None:
            if stat.S_ISDIR(there.st_mode):
                raise IsADirectoryError(errno.EISDIR, "it is a folder")
            # renaming asks for no right to the file itself, and follows links where the system would not
            os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_CLOEXEC))
        self.target = Path(os.path.realpath(path))
        self.path = self.target.with_name(self.target.name + PART)
        _remove_stale(self.path)
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        self.descriptor = os.open(self.path, flags, 0o666 if there is None else 0o600)
        _lock(self.descriptor)
        if there is not None:
            with suppress(PermissionError):
                os.fchown(self.descriptor, there.st_uid, there.st_gid)
            os.fchmod(self.descriptor, stat.S_IMODE(there.st_mode))

    def close(self) -> None:
        """Close it, which unlocks it."""
        os.close(self.descriptor)


def _remove_stale(part: Path) -> None:
    """Remove a part that an ended process left.

    Raises:
        OSError: a process is writing it, or it is no regular file.
    """
    while True:
        try:
            descriptor = os.open(part, os.O_WRONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except FileNotFoundError:
            return
        except OSError as error:
            raise OSError(error.errno, f"{part} is in the way; remove it") from error
        try:
            _lock(descriptor)
            # unless another process has removed the same one and begun its own
            about, named = os.fstat(descriptor), _status(part)
            if not stat.S_ISREG(about.st_mode):
                raise OSError(errno.EEXIST, f"{part} is in the way; remove it")
            if named is not None and os.path.samestat(about, named):
                part.unlink()
        finally:
            os.close(descriptor)


def _lock(descriptor: int) -> None:
    """Lock a part for as long as it is open.

    Raises:
        OSError: another process has it.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OSError(errno.EBUSY, "it is being written already") from None
    except OSError:
        return  # a file system without locks


class _RawOutput(io.FileIO):
    """A descriptor whose errors name the file.

    Args:
        descriptor: open for writing; closed with it.
        path: for the message.
        is_alone: whether nothing else is written.
    """

    def __init__(self, descriptor: int, path: Path, is_alone: Callable[[], bool]) -> None:
        super().__init__(descriptor, "wb")
        self.name = str(path)  # python-can asks for it
        self._path, self._is_alone, self._has_reader = path, is_alone, True

    def write(self, data: ReadableBuffer, /) -> int:
        """Write bytes; return how many were taken."""
        with _named(self._path):
            try:
                if self._has_reader:
                    return super().write(data)
            except BrokenPipeError:
                if not is_standard_output(self._path):
                    raise
                self._has_reader = False
        if self._is_alone():
            raise BrokenPipeError
        return memoryview(data).nbytes


def is_standard_output(path: Path) -> bool:
    """Return whether a path leads to the process's standard output."""
    return _own_descriptor(path) == 1


def _opened(path: Path) -> int:
    """Open what is written straight."""
    own = _own_descriptor(path)
    # a copy shares its place in the file with whatever else the process writes to it
    return os.open(path, os.O_WRONLY | os.O_CLOEXEC) if own is None else os.dup(own)


def _is_special(path: Path) -> bool:
    """Return whether something other than a regular file is there, or the way to it is one of our own descriptors."""
    if _own_descriptor(path) is not None:
        return True
    there = _status(path)
    return there is not None and not (stat.S_ISREG(there.st_mode) or stat.S_ISDIR(there.st_mode))


def _own_descriptor(path: Path) -> int | None:
    """Return the descriptor of this process that a path such as `/dev/stdout` leads to; None: none."""
    descriptors = f"/proc/{os.getpid()}/fd"
    for _ in range(_MOST_LINKS):
        if path.name.isdecimal() and os.path.realpath(path.parent) == descriptors:
            return int(path.name)
        if not path.is_symlink():
            return None
        path = path.parent / path.readlink()
    return None


def _identities(path: Path) -> list[_Identity]:
    """Return by what a file can be told from others; nothing for the null device, which may be named many times."""
    own = _own_descriptor(path)
    there = _status(path) if own is None else os.fstat(own)
    if there is None:
        return [os.path.realpath(path)]
    if os.path.samestat(there, Path(os.devnull).stat()):
        return []
    identity = (there.st_dev, there.st_ino)
    return [identity] if own is not None else [os.path.realpath(path), identity]


def _status(path: Path) -> os.stat_result | None:
    """Return what a path leads to; None: nothing."""
    try:
        return path.stat()
    except FileNotFoundError:
        return None


def _refused(path: Path, how: str, other: Path) -> ConfigError:
    """Return the error of a file that is named twice."""
    names = "it" if path == other else f"the same file as {other}, which"
    return ConfigError(f"{names} is {how} too: the file is named twice; give what is written its own", file=path)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Let an error of the system say that a file cannot be written."""
    try:
        yield
    except OSError as error:
        reason = "there is no such folder" if isinstance(error, FileNotFoundError) else error.strerror
        raise InputError(f"cannot be written: {reason}; choose another path", file=path) from error
