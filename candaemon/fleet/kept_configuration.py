"""A configuration with its DBC files, kept beside results: workers need nothing else, and a run can be repeated."""

from __future__ import annotations

import atexit
import hashlib
import os
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.errors import InputError
from candaemon.files.bounded import read_anything, read_bounded
from candaemon.files.outputs import write_file
from candaemon.fleet.locations import require_utf8
from candaemon.fleet.result_store import FolderStore, ResultStore, store_at

FOLDER: Final = "configurations"
"""Folder of the results where configurations are kept, each in one of its own, named by its digest."""
MOST_BOUND: Final = 16
"""Configurations that a process keeps bound."""
_COPIES: Final = ExitStack()
atexit.register(_COPIES.close)


@dataclass(frozen=True, slots=True)
class KeptConfiguration:
    """A configuration as files.

    Attributes:
        given: path of the YAML that was named.
        digest: of all files.
        yaml: name of the YAML among them.
        base: folder from which the names of the files start.
        files: contents by name, laid out as they lie to one another.
        warnings: of the configuration.
        buses: their names.
    """

    given: str
    digest: str
    yaml: str
    base: str
    files: Mapping[str, bytes]
    warnings: tuple[str, ...]
    buses: frozenset[str]

    @classmethod
    def load(cls, path: Path) -> KeptConfiguration:
        """Load, bind and keep what was read.

        Raises:
            ConfigError: it cannot be used.
            InputError: its name is not UTF-8.
        """
        require_utf8(str(path))
        contents: dict[Path, bytes] = {}

        def read(file: Path, longest: int) -> bytes:
            contents[file] = read_anything(file, longest)
            return contents[file]

        binding = bind(load_config(path, read))
        here = Path.cwd()
        places = {Path(os.path.normpath(here / file)): content for file, content in contents.items()}
        base = os.path.commonpath([file.parent for file in places])
        files = {file.relative_to(base).as_posix(): content for file, content in sorted(places.items())}
        whole = hashlib.sha256()
        for name, content in files.items():
            whole.update(f"{name} {len(content)}\n".encode() + content)
        yaml = Path(os.path.normpath(here / path)).relative_to(base).as_posix()
        buses = frozenset(bus.name for bus in binding.buses)
        return cls(str(path), whole.hexdigest()[:16], yaml, base, files, binding.warnings, buses)

    def keep(self, store: ResultStore) -> None:
        """Write its files beside results, unless they are there with the same content."""
        folder = f"{FOLDER}/{self.digest}"
        there = store.sizes(folder)
        for name, content in self.files.items():
            kept = f"{folder}/{name}"
            if there.get(kept) != len(content) or store.read(kept) != content:
                store.write(kept, content)


@lru_cache(maxsize=MOST_BOUND)
def kept_binding(url: str, digest: str, yaml: str, base: str) -> Binding:
    """Return a configuration that is kept beside results, bound; once for all drives of a process.

    Args:
        url: of the results.
        digest: of the configuration.
        yaml: name of the YAML among its files.
        base: folder from which the names of its files start, where it was kept; files that the YAML names by whole
            paths are those kept of them.

    Raises:
        ConfigError, InputError: it is not there, or cannot be used.
    """
    store, name = store_at(url), f"{FOLDER}/{digest}"
    folder = store.path / name if isinstance(store, FolderStore) else _copied(store, name)

    def read(file: Path, longest: int) -> bytes:
        if not file.is_relative_to(folder) and file.is_relative_to(base):
            file = folder / file.relative_to(base)
        return read_bounded(file, longest)

    return bind(load_config(folder / yaml, read))


def _copied(store: ResultStore, name: str) -> Path:
    """Return a copy of a folder of results, which stays until the process ends: a binding's files are read again."""
    copy = Path(_COPIES.enter_context(TemporaryDirectory(prefix="candaemon-fleet-")))
    for each in store.sizes(name):
        content = store.read(each)
        if content is None:
            raise InputError("a file of the configuration is missing", file=f"{store.url}/{each}")
        path = copy / each
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, content)
    return copy / name
