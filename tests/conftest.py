"""What test files of any folder may ask for: the real data, and logging as it was."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from candaemon.dbc.database import load_database
from candaemon.dbc.database_bytes import LONGEST_FILE
from candaemon.dbc.types import Database
from candaemon.files.bounded import FileReader
from tests.support.paths import DATA

if TYPE_CHECKING:
    from xdist.remote import Producer
    from xdist.scheduler import WorkStealingScheduling


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> WorkStealingScheduling:
    """Let a worker without work take from the others: the one that has the beds' tests is busy for long."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)


@pytest.fixture(scope="session", autouse=True)
def _no_folder_of_the_user_is_written_to(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let the commands that tests start have a cache of this run, all workers the same."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp().parent / "cache"))
        yield


@pytest.fixture(scope="session", autouse=True)
def _each_dbc_is_parsed_once() -> Iterator[None]:
    """Let `bind` load a DBC file of the same path and content once: parsing is most of what many tests would do."""
    loaded: dict[tuple[Path, bytes], Database] = {}

    def load_once(path: Path, read: FileReader, _folder: Path | None) -> Database:
        try:
            content = read(path, LONGEST_FILE)
        except OSError:
            return load_database(path, read)  # which says what is wrong
        key = (path, sha256(content).digest())
        if key not in loaded:
            loaded[key] = load_database(path)
        return loaded[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("candaemon.binding.bind.load_cached", load_once)
        yield


@pytest.fixture(scope="session")
def drive() -> Path:
    """Return the folder of the recorded drive, or skip."""
    folder = DATA / "rav4_drive"
    if not folder.is_dir():
        pytest.skip(f"the recorded drive is not at {folder}")
    return folder


@pytest.fixture(scope="session")
def vendor_dbc() -> Path:
    """Return the folder of public vendor DBC files, or skip."""
    folder = DATA / "dbc"
    if not folder.is_dir():
        pytest.skip(f"the vendors' DBC files are not at {folder}")
    return folder


@pytest.fixture
def logging_as_it_was(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Leave logging as it was, of faults too: each command sets it up."""
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    root.handlers[:] = handlers
    root.setLevel(level)
