"""A configuration is tried in a process of its own: that is bounded, and only what was tried is loaded."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from candaemon.binding.bound import Binding
from candaemon.daemon import trial_load
from candaemon.daemon.reload import Reloader
from candaemon.daemon.service_config import load_service_config
from candaemon.daemon.trial_load import TriedConfig
from candaemon.errors import CandaemonError, ConfigError
from candaemon.files.bounded import FileReader
from tests.support.paths import ROOT
from tests.support.served import demo_config, wait_until

PATIENCE_S = 40.0


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return demo_config(tmp_path)


@pytest.fixture
def other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Have the other process run a program that a test gives, in the place of ours."""

    def place(program: str) -> None:
        package = tmp_path / "modules" / "candaemon" / "daemon"
        package.mkdir(parents=True)
        (package.parent / "__init__.py").touch()
        (package / "__init__.py").touch()
        (package / "trial_load.py").write_text(program, encoding="utf-8")
        monkeypatch.setattr("sys.path", [str(tmp_path / "modules")])

    return place


def refusal(tried: TriedConfig) -> str:
    with pytest.raises(ConfigError) as caught:
        tried.load()
    return str(caught.value)


def children() -> list[str]:
    """Return the trials under way; other tests of this process may have left children of other kinds."""
    threads = Path("/proc/self/task")
    pids = [pid for thread in threads.iterdir() for pid in told(thread / "children").split()]
    return [pid for pid in pids if "trial_load" in told(Path("/proc", pid, "cmdline"))]


def told(file: Path) -> str:
    """Return what the kernel tells of a thread or process; nothing where it has ended."""
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def test_the_other_process_answers_with_the_digests_of_all_files(config: Path) -> None:
    tried = TriedConfig(config)
    digests = tried._try()
    files = [config, *((ROOT / "dbc" / name) for name in ("oxts.dbc", "esr.dbc", "obstacles.dbc"))]
    assert digests == {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    assert tried.load().settings == load_service_config(config).settings
    assert children() == []


def test_files_that_are_in_no_cache_are_tried_within_the_limits(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "empty"))
    assert len(TriedConfig(config)._try()) == 4


def test_what_is_wrong_is_told_as_the_load_tells_it(config: Path) -> None:
    with config.open("a", encoding="utf-8") as file:
        file.write("more: 1\nstill_more: 2\n")
    with pytest.raises(ConfigError) as caught:
        load_service_config(config)
    assert len(str(caught.value).splitlines()) == 2
    assert refusal(TriedConfig(config)) == str(caught.value)


@pytest.mark.parametrize("of", ["mine.yaml", "esr.dbc"])
def test_other_bytes_than_those_tried_are_not_loaded(tmp_path: Path, of: str, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "esr.dbc").write_bytes((ROOT / "dbc" / "esr.dbc").read_bytes())
    config = demo_config(tmp_path)
    config.write_text(config.read_text("utf-8").replace(f"{ROOT / 'dbc' / 'esr.dbc'}", "esr.dbc"), "utf-8")
    load = load_service_config

    def edited_meanwhile(path: Path, read: FileReader) -> Binding:
        with (tmp_path / of).open("a", encoding="utf-8") as file:
            file.write("\n")
        return load(path, read)

    monkeypatch.setattr(trial_load, "load_service_config", edited_meanwhile)
    assert f"{of}: cannot be read" in (said := refusal(TriedConfig(config)))
    assert "it was changed during the reload; reload again" in said


def test_a_pipe_is_refused_and_nobody_waits_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    assert "pipe.yaml: cannot be read: it is no regular file" in refusal(TriedConfig(tmp_path / "pipe.yaml"))


LIMITED = """
import sys
sys.path[:] = {path!r}
del sys.modules['candaemon'], sys.modules['candaemon.daemon']
from candaemon.daemon import trial_load
def load(path, read):
    {load}
trial_load.load_service_config = load
trial_load.main()
"""


@pytest.mark.parametrize(
    ("load", "expected"),
    [
        ("return bytes(trial_load.LARGEST_LOAD + (64 << 20))", "takes more than 256 MiB of memory"),
        ("bytes(trial_load.LARGEST_LOAD // 2); raise trial_load.ConfigError('within')", "within"),
        ("import time; time.process_time = lambda: -9.0; trial_load._limit()\n    while True: pass", "more than 10 s"),
        ("sys.exit(3)", "ended without a result (status 3)"),
        ("import os; os.kill(os.getpid(), 9)", "ended without a result (status -9)"),
    ],
)
def test_time_and_memory_are_limited(config: Path, other: Callable[[str], None], load: str, expected: str) -> None:

    other(LIMITED.format(path=list(sys.path), load=load))
    assert expected in refusal(TriedConfig(config))
    assert children() == []


@pytest.mark.parametrize(
    "answer", ["", "[]", "{}", '{"refused": []}', '{"refused": [1]}', '{"read": {"a": 1}}', "[" * 100_000, "9" * 5000]
)
def test_an_answer_that_is_none_is_a_refusal(config: Path, other: Callable[[str], None], answer: str) -> None:
    other(f"print({answer!r})")
    assert "ended without a result (status 0)" in refusal(TriedConfig(config))


def test_a_refusal_cannot_forge_lines(config: Path, other: Callable[[str], None]) -> None:
    other(f"print({json.dumps({'refused': ['first' + chr(10) + 'forged' + chr(27)]})!r})")
    assert refusal(TriedConfig(config)) == "first\\nforged\\x1b"


def test_one_that_takes_too_long_is_ended(
    config: Path, other: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trial_load, "LONGEST_TRIAL_S", 0.5)
    other("import time; time.sleep(60)")
    assert "to try it takes more than 0.5 s" in refusal(TriedConfig(config))
    assert children() == []


def test_the_end_of_the_service_ends_a_trial(config: Path, other: Callable[[str], None]) -> None:
    other("import time; time.sleep(60)")
    tried = TriedConfig(config)
    reloader = Reloader(tried.load, tried.cancel)
    reloader.ask()
    assert reloader.begin()
    wait_until(lambda: bool(children()), PATIENCE_S)
    began_s = time.monotonic()
    reloader.close()
    assert time.monotonic() - began_s < 30.0
    wait_until(lambda: not children(), PATIENCE_S)
    assert isinstance(reloader.outcome(), CandaemonError)
    reloader.ask()
    assert reloader.begin()  # one that begins after the end ends at once
    wait_until(lambda: reloader.outcome() is not None, PATIENCE_S)
