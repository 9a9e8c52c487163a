"""What test files of any folder may ask for: the real data, and logging as it was."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.support.paths import DATA

if TYPE_CHECKING:
    from xdist.remote import Producer
    from xdist.scheduler import WorkStealingScheduling


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> WorkStealingScheduling:
    """Let a worker without work take from the others: the one that has the beds' tests is busy for long."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)


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
