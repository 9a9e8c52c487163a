"""Tests that run in a bed are told as if they had run here, by a bed that is just another pytest."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.beds.inside import REPORTS
from tests.beds.outside import REQUIRE
from tests.support.paths import ROOT

CONFTEST = f"""
import subprocess, sys
from pathlib import Path

sys.path.insert(0, {str(ROOT)!r})
from tests.beds import register
from tests.beds.task import BedMissingError

HERE = Path(__file__).parent

def run(task):
    if (HERE / "missing").exists():
        raise BedMissingError("nothing to lie on")
    with (HERE / "boots").open("a") as file:
        file.write("one\\n")
    task.console.write_text("the kernel's word")
    subprocess.run(["sh", task.command])

def pytest_configure(config):
    register(config, "trial", HERE, run)
"""

TESTS = """
import os, time
import pytest

def test_good():
    assert "CANDAEMON_REPORTS" in os.environ

def test_bad():
    print("what it said")
    assert 1 + 1 == 3

@pytest.mark.skip(reason="not today")
def test_skipped():
    pass

@pytest.mark.xfail(reason="known")
def test_known():
    assert False

@pytest.fixture
def untidy():
    yield
    raise OSError("left open")

def test_untidy(untidy):
    pass

@pytest.mark.limit(0.1)
def test_slow():
    time.sleep(10)

@pytest.mark.parametrize("name", ["a b", "c::d"])
def test_named(name):
    pass

def test_deadly():
    os._exit(7)

def test_behind():
    pass
"""

PLAIN = "import pytest\n\n@pytest.mark.parametrize('number', range(20))\ndef test_plain(number):\n    pass\n"


@pytest.fixture
def project(tmp_path: Path) -> Path:
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "__init__.py").touch()
    (inner / "conftest.py").write_text(CONFTEST, encoding="utf-8")
    (inner / "test_it.py").write_text(TESTS, encoding="utf-8")
    (tmp_path / "test_plain.py").write_text(PLAIN, encoding="utf-8")
    (tmp_path / "pytest.ini").touch()
    return tmp_path


def told(project: Path, *arguments: str, **environment: str) -> tuple[dict[str, str], str]:
    """Return what pytest tells of each test, and all that it says."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", "CANDAEMON_"))}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-rA", "-p", "no:cacheprovider", f"--basetemp={project / 'tmp'}", *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=project,
        env=variables | {"PYTHONDONTWRITEBYTECODE": "1", **environment},
    )
    outcomes = re.findall(
        r"^([A-Z]+) (?:\[\d+\] )?\S*?test_it\.py(?:::|:\d+: )(.*?)(?: - .*)?$", done.stdout, re.MULTILINE
    )
    return {test: outcome for outcome, test in outcomes}, done.stdout + done.stderr


def test_outcomes_are_those_of_the_bed(project: Path) -> None:
    outcomes, text = told(project, "inner")
    assert outcomes == {
        "test_good": "PASSED",
        "test_bad": "FAILED",
        "not today": "SKIPPED",
        "test_known": "XFAIL",
        "test_untidy": "ERROR",  # after it passed
        "test_slow": "FAILED",
        "test_named[a b]": "PASSED",
        "test_named[c::d]": "PASSED",
        "test_deadly": "ERROR",
        "test_behind": "ERROR",
    }
    for words in ("what it said", "assert (1 + 1) == 3", "left open", "longer than 0.1 s", "the kernel's word"):
        assert words in text


def test_workers_share_one_boot_and_only_what_is_asked_for_runs(project: Path) -> None:
    outcomes, text = told(project, "-n", "2", "-k", "good or named or plain")
    assert set(outcomes.values()) == {"PASSED"}
    assert len(outcomes) == 3
    assert "23 passed" in text
    assert (project / "inner" / "boots").read_text(encoding="utf-8") == "one\n"
    (asked,) = project.glob("tmp/bed-trial/tests")
    assert "bad" not in asked.read_text(encoding="utf-8")


@pytest.mark.parametrize(("required", "expected"), [("0", "10 skipped"), ("1", "10 errors")])
def test_a_missing_bed_skips_or_fails(project: Path, required: str, expected: str) -> None:
    (project / "inner" / "missing").touch()
    _, text = told(project, **{REQUIRE: required})
    assert "nothing to lie on" in text
    assert expected in text
    assert "20 passed" in text


def test_in_the_bed_the_tests_just_run(project: Path) -> None:
    outcomes, _ = told(project, "inner", "-k", "good", **{REPORTS: str(project / "reports")})
    assert outcomes == {"test_good": "PASSED"}
    assert not (project / "inner" / "boots").exists()
    assert (project / "reports").read_text(encoding="utf-8").count('"outcome": "passed"') == 3
