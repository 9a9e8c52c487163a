"""Where a fleet's results lie: a folder here or on any file system; each file appears whole or not at all."""

from __future__ import annotations

import fcntl
import os
import shutil
import uuid
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from candaemon.dbc.database_bytes import LONGEST_FILE
from candaemon.errors import InputError
from candaemon.files.bounded import read_bounded
from candaemon.files.outputs import make_folder, write_file
from candaemon.fleet.locations import absolute, asked, file_system, is_local, local_path, require_utf8

INCOMING: Final = ".incoming"
"""Folder of what is not whole yet."""
LARGEST_RESULT: Final = LONGEST_FILE
"""Longest file of results that is read whole, bytes: a record of a drive, or a file of its configuration, as a DBC."""
_LOCK: Final = ".lock"
_WHOLE_AT_ONCE: Final = frozenset({"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl"})
"""Protocols of object stores: what is put there appears when it is complete."""


class ResultStore(ABC):
    """A folder of results. Names of files have `/` between folders.

    Args:
        url: of the folder.
    """

    def __init__(self, url: str) -> None:
        self.url = url

    @abstractmethod
    def attempt(self) -> AbstractContextManager[Path]:
        """Return a context with a folder of this machine, where files are made that `place` takes."""

    @abstractmethod
    def place(self, made: Mapping[str, Path]) -> None:
        """Put files under their names, one after another, in the place of what was there.

        Raises:
            InputError: one cannot be written.
        """

    @abstractmethod
    def read(self, name: str) -> bytes | None:
        """Return a file's content; None where there is none."""

    @abstractmethod
    def fetch(self, name: str, path: Path) -> None:
        """Copy a file to a path of this machine, whose folder is made."""

    @abstractmethod
    def remove(self, name: str) -> None:
        """Remove a file; one that is not there is no error."""

    @abstractmethod
    def sizes(self, folder: str = "") -> dict[str, int]:
        """Return all files below a folder with their sizes, bytes; what is not whole is not among them."""

    @abstractmethod
    def exclusive(self) -> AbstractContextManager[None]:
        """Return a context in which no other run of this machine writes here; what broken ones left is removed."""

    def write(self, name: str, content: bytes) -> None:
        """Write a file whole or not at all."""
        with self.attempt() as folder:
            path = folder / Path(name).name
            write_file(path, content)
            self.place({name: path})

    def read_all(self, names: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Yield files that are there with their contents."""
        for name in names:
            content = self.read(name)
            if content is not None:
                yield name, content


class FolderStore(ResultStore):
    """Results in a folder of this machine, or of a file system that is mounted."""

    def __init__(self, url: str) -> None:
        super().__init__(absolute(url))
        self.path = local_path(self.url)

    @contextmanager
    def attempt(self) -> Iterator[Path]:
        """Make a folder on the same file system."""
        folder = self.path / INCOMING / uuid.uuid4().hex
        make_folder(folder)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def place(self, made: Mapping[str, Path]) -> None:
        """Rename files."""
        for name, path in made.items():
            target = self.path / name
            make_folder(target.parent)
            try:
                path.replace(target)
            except OSError as error:
                raise InputError(f"cannot be written: {error.strerror}", file=target) from error

    def read(self, name: str) -> bytes | None:
        """Return a file's content; None where there is none."""
        try:
            return read_bounded(self.path / name, LARGEST_RESULT)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}", file=self.path / name) from error

    def fetch(self, name: str, path: Path) -> None:
        """Copy a file."""
        make_folder(path.parent)
        shutil.copyfile(self.path / name, path)

    def remove(self, name: str) -> None:
        """Remove a file."""
        try:
            (self.path / name).unlink(missing_ok=True)
        except OSError as error:
            raise InputError(f"cannot be removed: {error.strerror}", file=self.path / name) from error

    def sizes(self, folder: str = "") -> dict[str, int]:
        """Walk through the folder."""
        found = {}
        for above, below, names in os.walk(self.path / folder):
            below[:] = [each for each in below if each != INCOMING]
            for name in names:
                path = Path(above) / name
                with suppress(FileNotFoundError):
                    found[path.relative_to(self.path).as_posix()] = path.stat().st_size
        return found

    @contextmanager
    def exclusive(self) -> Iterator[None]:
        """Hold a lock for as long as the context lasts."""
        make_folder(self.path)
        try:
            descriptor = os.open(self.path / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        except OSError as error:
            raise InputError(f"cannot be written to: {error.strerror}", file=self.path) from error
        try:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(
                    "another run writes here; wait for its end, or choose another folder", file=self.path
                ) from None
            except OSError:
                pass  # a file system without locks
            shutil.rmtree(self.path / INCOMING, ignore_errors=True)
            yield
        finally:
            os.close(descriptor)


class FileSystemStore(ResultStore):
    """Results in a file system that fsspec speaks to."""

    def __init__(self, url: str) -> None:
        super().__init__(url.rstrip("/"))
        self.system, self._root = file_system(self.url)
        protocol = self.system.protocol
        self._at_once = not _WHOLE_AT_ONCE.isdisjoint({protocol} if isinstance(protocol, str) else protocol)

    @contextmanager
    def attempt(self) -> Iterator[Path]:
        """Make a folder of this machine."""
        with TemporaryDirectory(prefix="candaemon-fleet-") as folder:
            yield Path(folder)

    def place(self, made: Mapping[str, Path]) -> None:
        """Send files, each under another name first where it would not appear at once."""
        for name, path in made.items():
            target = self._path(name)
            with asked(f"{self.url}/{name}"):
                self.system.makedirs(target.rpartition("/")[0], exist_ok=True)
                if self._at_once:
                    self.system.put_file(str(path), target)
                    continue
                part = f"{target.rpartition('/')[0]}/.{uuid.uuid4().hex}.part"
                self.system.put_file(str(path), part)
                self.system.mv(part, target)

    def read(self, name: str) -> bytes | None:
        """Return a file's content; None where there is none."""
        try:
            with asked(f"{self.url}/{name}"):
                content = bytes(self.system.cat_file(self._path(name)))
        except InputError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                return None
            raise
        if len(content) > LARGEST_RESULT:
            raise InputError(f"it is longer than {LARGEST_RESULT:,} bytes, the most that is read", file=name)
        return content

    def fetch(self, name: str, path: Path) -> None:
        """Copy a file."""
        make_folder(path.parent)
        with asked(f"{self.url}/{name}"):
            self.system.get_file(self._path(name), str(path))

    def remove(self, name: str) -> None:
        """Remove a file."""
        with asked(f"{self.url}/{name}"), suppress(FileNotFoundError):
            if self.system.exists(self._path(name)):
                self.system.rm_file(self._path(name))

    def sizes(self, folder: str = "") -> dict[str, int]:
        """List the folder."""
        with asked(self.url):
            try:
                found = self.system.find(self._path(folder), detail=True)
            except FileNotFoundError:
                return {}
        root = f"{self._root.rstrip('/')}/"
        return {
            str(name).removeprefix(root): int(about["size"] or 0)
            for name, about in found.items()
            if not str(name).endswith(".part")
        }

    @contextmanager
    def exclusive(self) -> Iterator[None]:
        """Make the folder; nothing keeps others out."""
        with asked(self.url):
            self.system.makedirs(self._root, exist_ok=True)
        yield

    def _path(self, name: str) -> str:
        return f"{self._root.rstrip('/')}/{name}".rstrip("/")


def store_at(url: str) -> ResultStore:
    """Return the results at a location.

    Raises:
        ConfigError, InputError: there is no such kind of location, its name is not UTF-8, or it cannot be reached.
    """
    require_utf8(absolute(url))
    return FolderStore(url) if is_local(url) else FileSystemStore(url)
