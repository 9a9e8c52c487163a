"""What was computed from a file's bytes before, kept as plain data in the user's cache folder.

An entry is JSON behind its own checksum: it cannot run code, one that is damaged is computed anew, and a folder that
others may write to is not used. Without a folder, or on a full disk, nothing is kept.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

from candaemon.errors import InputError
from candaemon.files.own_folder import OwnFolder

logger = logging.getLogger(__name__)

_DIGEST: Final = sha256().digest_size


def cache_folder(kind: str, environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return where entries are kept: in the service's cache directory, else the user's; None without either.

    Args:
        kind: of the entries, the folder's name.
        environment: with systemd's `CACHE_DIRECTORY`, `XDG_CACHE_HOME` or `HOME`.
    """
    first, *_ = environment.get("CACHE_DIRECTORY", "").split(":")
    if first.startswith("/"):
        return Path(first) / kind
    own = environment.get("XDG_CACHE_HOME", "")
    if own.startswith("/"):
        return Path(own) / "candaemon" / kind
    home = environment.get("HOME", "")
    return Path(home) / ".cache" / "candaemon" / kind if home.startswith("/") else None


def entry_name(content: bytes, *versions: str) -> str:
    """Return the name of the entry of a file's bytes, as these versions read it."""
    return sha256("\0".join(versions).encode() + b"\0" + content).hexdigest() + ".json"


@dataclass(frozen=True, slots=True)
class EntryCache:
    """Entries in a folder.

    Attributes:
        folder: where they are; it is made where there is none.
        longest: bytes of an entry, at most; a longer one is not kept.
        most: entries, at most; those that were written first go first.
    """

    folder: Path
    longest: int
    most: int

    def find(self, name: str) -> Any:
        """Return the plain data that were kept under a name; None where none were, or they are damaged."""
        try:
            with OwnFolder.at(self.folder) as own:
                entry = self._read(own, name)
        except (OSError, InputError) as error:
            if not isinstance(error, FileNotFoundError):
                logger.debug("no cache: %s", error)
            return None
        body = entry[_DIGEST:]
        return json.loads(body) if sha256(body).digest() == entry[:_DIGEST] else None

    def keep(self, name: str, plain: Any) -> None:
        """Keep plain data, whole or not at all; where that cannot be, they are computed again at the next start."""
        body = json.dumps(plain, separators=(",", ":")).encode()
        if len(body) > self.longest:
            return
        try:
            with OwnFolder.at(self.folder) as own:
                own.replace(name, sha256(body).digest() + body)
                self._make_room(own)
        except (OSError, InputError) as error:
            logger.debug("no cache: %s", error)

    def _read(self, own: OwnFolder, name: str) -> bytes:
        descriptor = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=own.descriptor)
        with open(descriptor, "rb") as file:  # noqa: PTH123 - a descriptor
            return file.read(_DIGEST + self.longest) if own.is_own_file(os.fstat(descriptor)) else b""

    def _make_room(self, own: OwnFolder) -> None:
        """Remove the entries beyond the limit, those that were written first."""
        entries = sorted(own.entries(), key=lambda entry: entry.stat(follow_symlinks=False).st_mtime_ns)
        for entry in entries[: max(len(entries) - self.most, 0)]:
            own.remove(entry.name)
