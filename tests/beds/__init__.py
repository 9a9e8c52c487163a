"""Tests that need another kernel or another init than this machine's: run in a bed, told here."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from . import fixtures
from .inside import LIMIT_S, REPORTS, Inside
from .outside import Bed, Outside


def register(config: pytest.Config, name: str, here: Path, bed: Bed) -> None:
    """Have a folder's tests run by a bed; in the bed itself, have them write their reports down.

    Args:
        config: pytest's, of the folder's `pytest_configure`.
        name: of the bed.
        here: the folder.
        bed: runs the tests.
    """
    config.addinivalue_line(
        "markers", f"limit(seconds): time that a test may take in its bed, by default {LIMIT_S:g} s"
    )
    reports = os.environ.get(REPORTS)
    if reports is None:
        config.pluginmanager.register(Outside(name, here, bed), f"bed-{name}")
    else:
        config.pluginmanager.register(Inside(config, Path(reports)), f"bed-{name}")
        config.pluginmanager.register(fixtures, "bed-fixtures")
