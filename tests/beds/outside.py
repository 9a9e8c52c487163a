"""pytest here: a folder's tests run in their bed, all in one go, and their reports are told as this session's own."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from .inside import LIMIT_S, limit_s
from .task import BedMissingError, Report, Task

REQUIRE = "CANDAEMON_REQUIRE_BEDS"
"""Environment variable: where it is 1, a bed that is missing fails its tests, which are skipped otherwise."""
LAST_WORDS = 40
"""Lines that are shown of what a bed said."""

Bed = Callable[[Task], None]
"""Runs a task to its end, however that comes; raises BedMissingError."""


@dataclass(frozen=True)
class Told:
    """What came back from a bed.

    Attributes:
        missing: why there is no bed, empty where there is one.
        reports: by node id.
        console, output: the last lines of the bed and of pytest in it.
    """

    missing: str
    reports: dict[str, list[Report]]
    console: str
    output: str


class Outside:
    """A plugin that has a folder's tests run by a bed.

    The first of several pytest-xdist workers to come to such a test has them all run; the others wait for the reports.
    The tests are the session's first, so that they are one worker's, and the others share the rest.

    Args:
        name: of the bed.
        here: the folder.
        bed: runs the tests.
    """

    def __init__(self, name: str, here: Path, bed: Bed) -> None:
        self._name = name
        self._here = here
        self._bed = bed
        self._told: Told | None = None

    def pytest_itemcollected(self, item: pytest.Item) -> None:
        """Mark the folder's tests, so that a default run leaves them out."""
        if self._is_ours(item):
            item.add_marker(pytest.mark.bed)

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Put the folder's tests first."""
        items.sort(key=lambda item: not self._is_ours(item))

    def pytest_runtest_protocol(self, item: pytest.Item) -> bool | None:
        """Tell what became of a test of the folder."""
        if not self._is_ours(item):
            return None
        if self._told is None:
            self._told = self._run(item.session)
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in self._reports(item, self._told):
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def _is_ours(self, item: pytest.Item) -> bool:
        return item.path.is_relative_to(self._here)

    def _run(self, session: pytest.Session) -> Told:
        """Run the folder's tests, or read what another worker's run of them left."""
        items = [item for item in session.items if self._is_ours(item)]
        folder = _shared_folder(session.config) / f"bed-{self._name}"
        folder.mkdir(exist_ok=True)
        patience_s = LIMIT_S + 2 * max(limit_s(item) for item in items)
        task = Task([item.nodeid for item in items], session.config.rootpath, folder, patience_s)
        ended = folder / "ended.json"
        with _alone(folder / "lock"):
            if not ended.exists():
                task.prepare()
                missing = ""
                try:
                    self._bed(task)
                except BedMissingError as error:
                    missing = str(error)
                ended.write_text(json.dumps({"missing": missing}), encoding="utf-8")
        missing = json.loads(ended.read_text(encoding="utf-8"))["missing"]
        return Told(missing, task.read_reports(), last_lines(task.console), last_lines(task.output))

    def _reports(self, item: pytest.Item, told: Told) -> Iterator[pytest.TestReport]:
        """Yield a test's reports."""
        if told.missing:
            required = os.environ.get(REQUIRE) == "1"
            yield _made(item, lambda: _fail(told.missing) if required else pytest.skip(told.missing))
            return
        when: str | None = None
        for each in told.reports.get(item.nodeid, []):
            report: pytest.TestReport = item.config.hook.pytest_report_from_serializable(config=item.config, data=each)
            when = report.when
            yield report
        if when != "teardown":
            text = f"The {self._name} bed ended before this test did.\n\n{told.console}\n\n{told.output}"
            yield _made(item, lambda: _fail(text))


def last_lines(path: Path) -> str:
    """Return the end of a text file without empty lines, nothing where there is none."""
    if not path.exists():
        return ""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return "\n".join([line for line in lines if line.strip()][-LAST_WORDS:])


def _fail(text: str) -> None:
    pytest.fail(text, pytrace=False)


def _made(item: pytest.Item, outcome: Callable[[], object]) -> pytest.TestReport:
    """Return the report of a test that has no other."""
    call = pytest.CallInfo.from_call(outcome, "setup")
    report: pytest.TestReport = item.ihook.pytest_runtest_makereport(item=item, call=call)
    return report


def _shared_folder(config: pytest.Config) -> Path:
    """Return the session's temporary folder, which all its pytest-xdist workers share."""
    factory: pytest.TempPathFactory = config._tmp_path_factory  # type: ignore[attr-defined] # hooks get no fixtures
    base = factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Hold a lock, which the kernel lets go of should this process die."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
