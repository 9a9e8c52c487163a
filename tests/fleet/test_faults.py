"""Real processes of Dask, and what befalls them: all other drives complete, and going on leads to the same dataset."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import psutil
import pytest

from tests.beds.waiting import wait_until
from tests.support.fleets import candaemon, run_inline, short_drives, simulated, tables
from tests.support.ftp_server import ftp_server
from tests.support.paths import ROOT

pytestmark = pytest.mark.slow
PATIENCE = 120.0
"""s that something may take on a busy machine."""


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives")
    short_drives(folder / "logs", 30, simulated(folder))
    return folder / "logs"


@pytest.fixture(scope="module")
def whole(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of a run in which nothing went wrong."""
    folder = tmp_path_factory.mktemp("whole") / "results"
    assert run_inline([logs], folder).computed == 30
    return folder


def some(results: Path, count: int = 2) -> Callable[[], bool]:
    return lambda: len(list((results / "records").glob("*.json"))) >= count


def ended(process: subprocess.Popen[str], code: int) -> str:
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == code, f"{out}\n{err}"
    return f"{out}\n{err}"


def test_processes_of_this_machine_give_what_replay_gives(logs: Path, whole: Path, tmp_path: Path) -> None:
    hostile = tmp_path / "hostile.log.gz"
    hostile.write_bytes(b"\x1f\x8b\x08\x00" + os.urandom(2000))
    told = ended(candaemon("fleet", "run", "esr_ins", logs, hostile, "-o", tmp_path / "results", "--workers", "2"), 1)
    assert "30" in told
    assert "1 of 31 drives failed" in told
    assert "failed: hostile: " in told
    assert tables(tmp_path / "results") == tables(whole)


def test_a_worker_that_is_killed_costs_nothing(logs: Path, whole: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    running = candaemon("fleet", "run", "esr_ins", logs, "-o", results, "--workers", "2")
    wait_until(some(results), PATIENCE, "first drives")
    workers = [each for each in psutil.Process(running.pid).children() if "spawn_main" in " ".join(each.cmdline())]
    workers[0].kill()
    assert "failed: 0" in ended(running, 0)
    assert tables(results) == tables(whole)


@pytest.mark.parametrize("ending", [signal.SIGKILL, signal.SIGTERM])
def test_a_command_that_dies_leaves_nothing_half_written(
    logs: Path, whole: Path, tmp_path: Path, ending: signal.Signals
) -> None:
    results = tmp_path / "results"
    (tmp_path / "temporary").mkdir()
    environment = os.environ | {"TMPDIR": str(tmp_path / "temporary")}
    running = candaemon("fleet", "run", "esr_ins", logs, "-o", results, "--workers", "1", **environment)
    wait_until(some(results), PATIENCE, "first drives")
    family = psutil.Process(running.pid).children(recursive=True)
    running.send_signal(ending)
    running.communicate(timeout=PATIENCE)
    assert psutil.wait_procs(family, PATIENCE)[1] == []
    assert ending == signal.SIGKILL or not list((tmp_path / "temporary").glob("candaemon-*"))
    found, wanted = tables(results), tables(whole)
    assert 0 < len(found) < len(wanted)
    assert {name: wanted[name] for name in found if ".incoming" not in name}.items() <= found.items()
    told = ended(candaemon("fleet", "run", "esr_ins", logs, "-o", results, "--workers", "1"), 0)
    assert "computed: 30" not in told
    assert tables(results) == wanted


@contextmanager
def dask(*words: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run one of Dask's commands as the documentation does."""
    command = [str(Path(sys.executable).with_name("dask")), *words]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONWARNINGS": ""}
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=environment)
    try:
        yield process
    finally:
        below = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
        process.terminate()
        process.wait(PATIENCE)
        for each in psutil.wait_procs(below, 20)[1]:
            each.kill()


def test_a_cluster_and_another_file_system_and_a_scheduler_that_is_restarted(
    logs: Path, whole: Path, tmp_path: Path
) -> None:
    (tmp_path / "logs").symlink_to(logs)
    port = str(20000 + os.getpid() % 20000)
    address = f"tcp://127.0.0.1:{port}"
    scheduler = ("scheduler", "--host", "127.0.0.1", "--port", port, "--dashboard-address", "127.0.0.1:0")
    worker = ("worker", address, "--nthreads", "1", "--no-dashboard", "--local-directory", str(tmp_path))
    with ExitStack() as processes:
        url = processes.enter_context(ftp_server(tmp_path))
        first = processes.enter_context(dask(*scheduler))
        for _ in range(2):
            processes.enter_context(dask(*worker))
        command = ("fleet", "run", "esr_ins", f"{url}/logs", "-o", f"{url}/results", "--scheduler", address)
        running = candaemon(*command)
        wait_until(some(tmp_path / "results"), PATIENCE, "first drives")
        first.kill()
        processes.enter_context(dask(*scheduler))
        for _ in range(2):  # they end with their scheduler; whatever supervises them starts them again
            processes.enter_context(dask(*worker))
        assert "failed: 0" in ended(running, 0)
        assert tables(tmp_path / "results") == tables(whole)
        assert "kept: 30" in ended(candaemon(*command), 0)
        assert ended(candaemon("fleet", "report", f"{url}/results", "-o", tmp_path / "report.html"), 0)
        compared = ended(candaemon("fleet", "compare", f"{url}/results", whole, "--fail-on", "difference"), 0)
    assert "30 drives the same to the byte" in compared
    assert not list(tmp_path.glob("results/**/*.part"))
