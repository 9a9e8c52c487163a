"""Files at any location that fsspec knows: a path of this machine, `file://`, `s3://`, `gs://`, `abfs://` and so on.

Paths of this machine are worked with directly; all others through fsspec.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from glob import glob, has_magic
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from candaemon.can_io.logs.compression import COMPRESSIONS
from candaemon.can_io.logs.formats import LOG_SUFFIXES
from candaemon.errors import ConfigError, InputError
from candaemon.exports.extras import import_extra
from candaemon.playback.recording_files import STATE, files_of, logs_in, number_of
from candaemon.printable import printable

_LOCAL: Final = ("file://", "local://")
_STAMPS: Final = ("ETag", "etag", "md5Hash", "content_settings", "generation", "mtime", "LastModified", "last_modified")
"""What file systems say of a file that changes when its content does."""
_STAMPS_OF_FTP: Final = ("modify",)
_PACKED: Final = 6
"""About how many times as long a log is without its compression."""


@dataclass(frozen=True, slots=True)
class LogFile:
    """A file of a drive, as it was found.

    Attributes:
        location: of the file.
        size: bytes.
        stamp: equal as long as nobody has written to the file; empty where the file system says nothing of that.
    """

    location: str
    size: int
    stamp: str


@dataclass(frozen=True, slots=True)
class FetchedLog:
    """A file of a drive, on this machine.

    Attributes:
        found: where it comes from.
        path: of the file, or of its copy.
        sha256: of its content, hexadecimal.
    """

    found: LogFile
    path: Path
    sha256: str


def is_local(location: str) -> bool:
    """Return whether a location is a path of this machine."""
    return "://" not in location or location.startswith(_LOCAL)


def local_path(location: str) -> Path:
    """Return the path of a location of this machine."""
    for prefix in _LOCAL:
        location = location.removeprefix(prefix)
    return Path(location)


def absolute(location: str) -> str:
    """Return a location that means the same in every folder."""
    return str(Path.cwd() / local_path(location)) if is_local(location) else location


def require_utf8(location: str) -> None:
    """Refuse a location whose name is bytes that are not UTF-8: the JSON of records and DuckDB cannot hold it.

    Raises:
        InputError: it is such a location.
    """
    try:
        location.encode()
    except UnicodeEncodeError:
        why = "its name is not UTF-8, as a fleet's records are; give it another name"
        raise InputError(why, file=location) from None


def beside(location: str, relative: str) -> str:
    """Return a location that is written relative to the folder of another one."""
    if not is_local(relative) or Path(relative).is_absolute():
        return relative
    folder, _, _ = location.rpartition("/")
    return f"{folder}/{relative}" if folder else relative


def file_system(location: str) -> tuple[Any, str]:
    """Return fsspec's file system of a location and the path in it.

    Raises:
        ConfigError: the protocol is unknown, or its library is not installed.
    """
    core = import_extra("fsspec.core", "fleet", "a location that is no path")
    try:
        # others write there too: what a folder holds is asked each time
        system, path = core.url_to_fs(location, use_listings_cache=False)
    except ImportError as error:
        raise ConfigError(f"{printable(location)}: its file system needs a library: {error}") from None
    except ValueError as error:
        raise ConfigError(f"{printable(location)}: no such kind of location: {error}") from None
    except Exception as error:
        raise InputError(f"cannot be reached: {_said(error)}", file=location) from error
    return system, str(path)


@contextmanager
def asked(location: str) -> Iterator[None]:
    """Let whatever a file system raises name the location: each library has errors of its own."""
    try:
        yield
    except (ConfigError, InputError):
        raise
    except FileNotFoundError as error:
        raise InputError("there is no such file or folder", file=location) from error
    except Exception as error:
        raise InputError(f"the file system refuses: {_said(error)}", file=location) from error


def _said(error: Exception) -> str:
    return printable(str(error) or type(error).__name__)


def is_log(name: str) -> bool:
    """Return whether a name is that of a log, by its suffixes."""
    name = name.lower()
    for packed in COMPRESSIONS:
        name = name.removesuffix(packed)
    return name.endswith(LOG_SUFFIXES)


def drives_at(location: str) -> list[str]:
    """Return the logs that a location stands for: a file, a pattern, or a folder with all below it.

    Links to folders are followed; a folder counts once, however many links lead to it.
    The folder of a recording of the service is one drive, and is returned itself.

    Raises:
        InputError: there is nothing; or the file system refuses.
    """
    found = _local_drives(local_path(location)) if is_local(location) else _remote_drives(location)
    if not found:
        raise InputError("no log is found there; expected a log, a pattern, or a folder of logs", file=location)
    return found


def _local_drives(path: Path) -> list[str]:
    if has_magic(str(path)) and not path.exists():
        matches = [Path(each) for each in sorted(glob(str(path), recursive=True))]  # noqa: PTH207 - with its root
        return [each for match in matches for each in (_local_drives(match) if match.is_dir() else [str(match)])]
    if not path.is_dir():
        return [str(path)]  # one that is missing is told with the drives that fail
    found, seen, linked = [], set[tuple[int, int]](), deque([path])
    while linked:
        for folder, below, names in os.walk(linked.popleft()):
            here = Path(folder)
            entry = here.stat()
            if (entry.st_dev, entry.st_ino) in seen:  # a link may lead back, or to what another one leads to
                below.clear()
                continue
            seen.add((entry.st_dev, entry.st_ino))
            if _is_recording(here):
                below.clear()
                found.append(str(here))
                continue
            found += [str(here / name) for name in names if is_log(name)]
            below.sort()  # in whatever order a file system tells them, the same link counts
            linked += [here / name for name in below if (here / name).is_symlink()]
    return sorted(found)


def _is_recording(folder: Path) -> bool:
    return any(number_of(log) is not None for log in logs_in(folder))


def _remote_drives(location: str) -> list[str]:
    system, path = file_system(location)
    with asked(location):
        if has_magic(path):
            names = system.glob(path)
        elif system.isdir(path):
            names = system.find(path)
        else:
            return [location]
    drives = set()
    for name in names:
        folder, _, last = str(name).rpartition("/")
        if is_log(last):
            drives.add(folder if number_of(Path(last)) is not None else str(name))
    return sorted(_located(location, path, name) for name in drives)


def _located(location: str, path: str, name: str) -> str:
    """Return the location of a file that a file system named.

    Args:
        location: that was asked for.
        path: of that in the file system; `s3://bucket/folder` is `bucket/folder` there, `ftp://host/folder` `/folder`.
        name: of the file in the file system.
    """
    return location.rstrip("/").removesuffix(path.strip("/")) + name.lstrip("/")


def files_at(logs: Sequence[str]) -> list[LogFile]:
    """Return the files of a drive; the states beside a recording's logs are among them.

    Raises:
        InputError: one is missing, or is no file.
    """
    found = []
    for location in logs:
        found += _local_files(local_path(location)) if is_local(location) else _remote_files(location)
    return found


def _local_files(path: Path) -> list[LogFile]:
    found = []
    for each in files_of(path):
        try:
            entry = each.stat()
        except FileNotFoundError:
            if each.suffix == STATE:
                continue
            raise InputError("there is no such log", file=each) from None
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}", file=each) from error
        if not stat.S_ISREG(entry.st_mode):
            raise InputError("it is no regular file", file=each)
        found.append(LogFile(str(each), entry.st_size, f"{entry.st_size}-{entry.st_mtime_ns}"))
    return found


def _remote_files(location: str) -> list[LogFile]:
    system, path = file_system(location)
    with asked(location):
        about = system.info(path)
        entries = [about] if about["type"] == "file" else system.ls(path, detail=True)
        return [
            LogFile(_located(location, path, str(each["name"])), int(each["size"] or 0), _stamp(each))
            for each in sorted(entries, key=lambda entry: str(entry["name"]))
            if each["type"] == "file" and (is_log(each["name"]) or each["name"].endswith(STATE) or len(entries) == 1)
        ]


def _stamp(about: dict[str, Any]) -> str:
    said = [f"{key}={about[key]}" for key in (*_STAMPS, *_STAMPS_OF_FTP) if about.get(key)]
    return "-".join([str(about["size"]), *said]) if said else ""


def weight(file: LogFile) -> int:
    """Return about how much work a file is: its bytes without compression."""
    return file.size * (_PACKED if file.location.lower().endswith(COMPRESSIONS) else 1)


@contextmanager
def fetched(logs: Sequence[str]) -> Iterator[tuple[list[Path], list[FetchedLog]]]:
    """Have a drive's files on this machine, for as long as the context lasts.

    Yields:
        What `replay` is to read, and every file with the hash of its content.

    Raises:
        InputError: one is missing, or cannot be read.
    """
    with TemporaryDirectory(prefix="candaemon-fleet-") as folder:
        paths, files = [], []
        for number, location in enumerate(logs):
            found = files_at([location])
            if is_local(location):
                paths.append(local_path(location))
                here = [local_path(each.location) for each in found]
            else:
                target = Path(folder) / str(number)
                here = [_copied(each, target) for each in found]
                is_folder = [each.location for each in found] != [location] and len(found) != 1
                paths.append(target if is_folder else here[0])
            for each, path in zip(found, here, strict=True):
                files.append(FetchedLog(each, path, sha256_of(path)))
        yield paths, files


def require_unchanged(logs: Sequence[str], inputs: Sequence[FetchedLog]) -> None:
    """Refuse a drive of which a file was written to, came or went since its content was hashed.

    Args:
        logs: locations of the drive.
        inputs: what `fetched` yielded of them.

    Raises:
        InputError: names the first that differs.
    """
    noted = {each.found.location: each.found for each in inputs}
    found = {each.location: each for each in files_at(logs)}
    for location in (*noted, *found):
        if noted.get(location) != found.get(location):
            raise InputError("it changed while it was read; wait until it is written, and run again", file=location)


def _copied(file: LogFile, folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    target = folder / Path(file.location).name
    system, path = file_system(file.location)
    with asked(file.location):
        system.get_file(path, str(target))
    return target


def sha256_of(path: Path) -> str:
    """Return the hash of a file's content.

    Raises:
        InputError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from error
