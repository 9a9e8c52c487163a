"""pytest in a bed: each report is written down at once, and a test that hangs does not keep the others waiting."""

from __future__ import annotations

import json
import signal
from collections.abc import Generator
from pathlib import Path
from types import FrameType

import pytest

REPORTS = "CANDAEMON_REPORTS"
"""Environment variable that tells a run of pytest that it is in a bed, and the file for its reports."""
LIMIT_S = 180.0
"""Time that a test may take, unless `@pytest.mark.limit(seconds)` says otherwise."""


def limit_s(item: pytest.Item) -> float:
    """Return the time that a test may take, s."""
    marker = item.get_closest_marker("limit")
    return LIMIT_S if marker is None else float(marker.args[0])


class Inside:
    """A plugin that writes reports, and lets a test fail where it hangs.

    Args:
        config: pytest's.
        reports: the file, a line of JSON a report.
    """

    def __init__(self, config: pytest.Config, reports: Path) -> None:
        self._config = config
        self._reports = reports

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write a report."""
        data = self._config.hook.pytest_report_to_serializable(config=self._config, report=report)
        with self._reports.open("a", encoding="utf-8") as file:
            file.write(json.dumps(data) + "\n")

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Generator[None, object, object]:
        """Give a test its time."""
        seconds = limit_s(item)

        def too_long(_number: int, _frame: FrameType | None) -> None:
            raise TimeoutError(f"longer than {seconds:g} s; @pytest.mark.limit(seconds) gives a test more")

        before = signal.signal(signal.SIGALRM, too_long)
        signal.setitimer(signal.ITIMER_REAL, seconds)
        try:
            return (yield)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)
