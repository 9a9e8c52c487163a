"""A folder whose files belong to this user alone, worked in through its descriptor."""

from __future__ import annotations

import errno
import logging
import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from candaemon.errors import InputError

logger = logging.getLogger(__name__)

PRIVATE_FOLDER: Final = 0o700
PRIVATE_FILE: Final = 0o600

_OPEN_FOLDER: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_CREATE: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_APPEND | os.O_CLOEXEC
_READ: Final = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
_OTHERS: Final = stat.S_IRWXG | stat.S_IRWXO
_OTHERS_MAY_WRITE: Final = stat.S_IWGRP | stat.S_IWOTH
_NO_LINKS: Final = frozenset({errno.EPERM, errno.EOPNOTSUPP, errno.EMLINK})
_ASIDE: Final = ".damaged"
_MOST_ASIDE: Final = 1000
"""Entries of one name that are set aside."""


class OwnFolder:
    """A folder that only this user, or root, writes to. A context manager: leaving it closes the descriptor.

    Whatever is done in it follows no link and reaches no other place, even if the folder is moved meanwhile: names are
    looked up in the descriptor. Each file is created anew, readable by this user alone.

    Args:
        path: for messages, and to see whether the folder is there still.
        descriptor: of the folder; closed with it.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self.descriptor = descriptor

    @classmethod
    def at(cls, path: Path, mark: str = "") -> OwnFolder:
        """Open a folder; where there is none it is made, with those above it.

        Args:
            path: of the folder.
            mark: an entry that only folders have which this program made use of before; from such a one access is taken
                away that its group, or others to read, have.

        Raises:
            OSError: it cannot be made or opened.
            InputError: something else is in its place, or others may write to it; says what to do.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            path.mkdir(PRIVATE_FOLDER)
        except FileExistsError:
            entry = path.lstat()
            if stat.S_ISLNK(entry.st_mode) and not _is_trusted(entry):
                raise _unusable(path, "it is a link of another user; name the folder itself") from None
        try:
            folder = cls(path, os.open(path, _OPEN_FOLDER))
        except NotADirectoryError as error:
            raise _unusable(path, "it is no folder; choose another path") from error
        try:
            folder._require_own(mark)
        except BaseException:
            folder.close()
            raise
        return folder

    def folder(self, *names: str, make: bool = True) -> OwnFolder:
        """Open a folder below this one, each name one level deeper; others lose the access that they have to it.

        Args:
            names: of the folders on the way.
            make: whether those that are not there are made.

        Raises:
            OSError: it cannot be made or opened; something that is no folder, such as a link, is in its place.
            InputError: it belongs to somebody else.
        """
        found = OwnFolder(self.path, os.dup(self.descriptor))
        for name in names:
            with found as above:
                if make:
                    above._make(name)
                found = OwnFolder(
                    above.path / name, os.open(name, _OPEN_FOLDER | os.O_NOFOLLOW, dir_fd=above.descriptor)
                )
            try:
                found._take_from_others()
            except BaseException:
                found.close()
                raise
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the descriptor."""
        os.close(self.descriptor)

    def is_at_its_path(self) -> bool:
        """Return whether the path still leads to it: it may have been removed or moved."""
        try:
            return os.path.samestat(self.path.stat(), os.fstat(self.descriptor))
        except OSError:
            return False

    def entries(self) -> Iterator[os.DirEntry[str]]:
        """Yield what lies in it, in no order.

        Raises:
            OSError: it cannot be read.
        """
        with os.scandir(self.descriptor) as found:
            yield from found

    def stat(self, name: str) -> os.stat_result:
        """Return what the file system says of an entry, of a link itself.

        Raises:
            OSError: as for `os.stat`.
        """
        return os.stat(name, dir_fd=self.descriptor, follow_symlinks=False)

    def has(self, name: str) -> bool:
        """Return whether there is an entry of a name."""
        try:
            self.stat(name)
        except FileNotFoundError:
            return False
        return True

    def names(self, name: str, descriptor: int) -> bool:
        """Return whether a name stands for an open file."""
        try:
            return os.path.samestat(self.stat(name), os.fstat(descriptor))
        except FileNotFoundError:
            return False

    def create(self, name: str) -> int:
        """Return the descriptor of a file that was not there before, to append to.

        Raises:
            OSError: it cannot be created; EEXIST where anything, a dangling link too, has that name.
        """
        return os.open(name, _CREATE, PRIVATE_FILE, dir_fd=self.descriptor)

    def write(self, name: str, data: bytes, *, sync: bool = False) -> None:
        """Write a file that was not there before.

        Args:
            name: of the file.
            data: what it holds.
            sync: force it onto the disk.

        Raises:
            OSError: it cannot be written; nothing is left of it then.
        """
        descriptor = self.create(name)
        try:
            write_all(descriptor, data)
            if sync:
                os.fsync(descriptor)
        except OSError:
            self.remove(name)
            raise
        finally:
            os.close(descriptor)

    def replace(self, name: str, data: bytes) -> None:
        """Write a file so that whoever reads it finds the former content or this one.

        Raises:
            OSError: it cannot be written; the former content is left.
        """
        part = f".{name}.part"
        self.remove(part)
        self.write(part, data)
        os.rename(part, name, src_dir_fd=self.descriptor, dst_dir_fd=self.descriptor)

    def link(self, name: str, target: OwnFolder) -> bool:
        """Link a file into another folder, unless it is there; False where the file system has no links.

        Raises:
            OSError: it cannot be.
        """
        try:
            os.link(name, name, src_dir_fd=self.descriptor, dst_dir_fd=target.descriptor, follow_symlinks=False)
        except FileExistsError:
            return True
        except OSError as error:
            if error.errno not in _NO_LINKS:
                raise
            return False
        return True

    def copy(self, name: str, target: OwnFolder) -> None:
        """Copy a regular file into another folder, where none is of that name.

        Raises:
            OSError: it cannot be.
        """
        with open(os.open(name, _READ, dir_fd=self.descriptor), "rb") as source:  # noqa: PTH123 - a descriptor
            if not stat.S_ISREG(os.fstat(source.fileno()).st_mode):
                raise OSError(errno.EINVAL, "it is no regular file", name)
            with open(target.create(name), "wb") as copied:  # noqa: PTH123 - a descriptor
                shutil.copyfileobj(source, copied, 1 << 20)

    def keep(self, name: str, target: OwnFolder) -> None:
        """Link a file into another folder, or copy it where the file system has no links, unless it is there.

        Raises:
            OSError: it cannot be.
        """
        if not self.link(name, target) and not target.has(name):
            self.copy(name, target)

    def remove(self, name: str) -> None:
        """Remove a file, or a link itself; one that is not there is no error.

        Raises:
            OSError: it cannot be removed, or is a folder.
        """
        try:
            os.unlink(name, dir_fd=self.descriptor)
        except FileNotFoundError:
            return

    def remove_tree(self, name: str) -> None:
        """Remove a folder with all that is in it; links in it are removed, not followed.

        Raises:
            OSError: something cannot be removed, or it is no folder.
        """
        shutil.rmtree(name, dir_fd=self.descriptor)

    def set_aside(self, name: str) -> str:
        """Give an entry a name that says that it is damaged; return that.

        Raises:
            OSError: it cannot be renamed.
        """
        for number in range(_MOST_ASIDE):
            aside = f"{name}{_ASIDE}{number or ''}"
            if not self.has(aside):
                os.rename(name, aside, src_dir_fd=self.descriptor, dst_dir_fd=self.descriptor)
                return aside
        raise OSError(errno.EEXIST, f"{_MOST_ASIDE} of its name are set aside already", name)

    def is_own_file(self, entry: os.stat_result) -> bool:
        """Return whether an entry is a regular file of this user or root."""
        return stat.S_ISREG(entry.st_mode) and _is_trusted(entry)

    def is_own_folder(self, entry: os.stat_result) -> bool:
        """Return whether an entry is a folder, no link to one, of this user or root."""
        return stat.S_ISDIR(entry.st_mode) and _is_trusted(entry)

    def _make(self, name: str) -> None:
        try:
            os.mkdir(name, PRIVATE_FOLDER, dir_fd=self.descriptor)
        except FileExistsError:
            return

    def _require_own(self, mark: str) -> None:
        """Refuse a folder that others may write to: they could put links and files of their own there."""
        entry = os.fstat(self.descriptor)
        mode = stat.S_IMODE(entry.st_mode)
        if not _is_trusted(entry):
            raise _unusable(
                self.path,
                "it belongs to another user; `chown` it to the user that candaemon runs as, or choose another",
            )
        if mode & _OTHERS and not mode & (stat.S_IWOTH | stat.S_ISVTX) and mark and self.has(mark):
            os.fchmod(self.descriptor, PRIVATE_FOLDER)
            logger.warning("%s: others had access to it, which is taken away", self.path)
        elif mode & _OTHERS_MAY_WRITE:
            raise _unusable(self.path, f"others may write to it; `chmod go-w {self.path}`, or choose another path")

    def _take_from_others(self) -> None:
        entry = os.fstat(self.descriptor)
        if not _is_trusted(entry):
            raise _unusable(self.path, "it belongs to another user; remove it")
        if entry.st_mode & _OTHERS and entry.st_uid == os.geteuid():
            os.fchmod(self.descriptor, PRIVATE_FOLDER)


def write_all(descriptor: int, data: bytes) -> None:
    """Write all of some bytes.

    Raises:
        OSError: as for `os.write`; a part of them may be written then.
    """
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(descriptor, rest) :]


def _is_trusted(entry: os.stat_result) -> bool:
    return entry.st_uid in (0, os.geteuid())


def _unusable(path: Path, reason: str) -> InputError:
    return InputError(f"cannot be written: {reason}", file=path)
