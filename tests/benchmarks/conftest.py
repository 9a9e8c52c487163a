"""Prints what the benchmarks measured below the tests' results."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import pytest

Note: TypeAlias = Callable[[object], None]
"""Keeps a result, as it prints itself, for the summary."""

_KEY = "benchmark"


@pytest.fixture
def note(record_property: Callable[[str, object], None]) -> Note:
    return lambda result: record_property(_KEY, str(result))


def pytest_itemcollected(item: pytest.Item) -> None:
    """Mark the folder's tests, so that a default run leaves them out."""
    item.add_marker(pytest.mark.benchmark)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    reports = terminalreporter.getreports("passed") + terminalreporter.getreports("failed")
    lines = [value for report in reports for key, value in report.user_properties if key == _KEY]
    if lines:
        terminalreporter.write_sep("-", "benchmarks: candaemon, baseline")
        for line in lines:
            terminalreporter.write_line(str(line))
