"""Dask's workers: drives are handed out a few at a time, and what is lost is handed out again."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from candaemon.errors import ConfigError, InputError
from candaemon.fleet.drive_task import DriveOrder, DriveOutcome
from candaemon.fleet.workers import LEAST_MEMORY, WAITING_A_WORKER, Workers


class LostError(Exception):
    pass


class KilledWorker(Exception):  # noqa: N818 - as Dask calls it
    pass


class Task:
    def __init__(self, key: str, order: DriveOrder, dask: Dask) -> None:
        self.key, self.order, self.dask, self.status = key, order, dask, "finished"

    def exception(self) -> Exception:
        return KilledWorker("killed")

    def result(self) -> DriveOutcome:
        if self.order.drive.name in self.dask.lost:
            self.dask.lost.remove(self.order.drive.name)
            self.dask.client.status = self.dask.status_when_lost
            raise LostError
        return DriveOutcome(self.order.drive.name, computed=True)


class Dask:
    """Stands for the module `distributed`, with a client of four threads."""

    CancelledError = LostError

    def __init__(self) -> None:
        self.threads = {"a": 1, "b": 3}
        self.client = SimpleNamespace(
            submit=self.submit, nthreads=lambda: self.threads, wait_for_workers=self.wait_for_workers, status="running"
        )
        self.waiting: list[Task] = []
        self.most = 0
        self.keys: list[str] = []
        self.lost: list[str] = []
        self.killed: list[str] = []
        self.status_when_lost = "running"

    def wait_for_workers(self, count: int, timeout: float) -> None:
        if len(self.threads) < count:
            raise TimeoutError(timeout)

    def submit(self, _function: Any, order: DriveOrder, *, key: str, pure: bool) -> Task:
        assert not pure
        self.keys.append(key)
        return Task(key, order, self)

    def as_completed(self, _futures: list[Task]) -> Dask:
        return self

    def add(self, task: Task) -> None:
        task.status = "error" if task.order.drive.name in self.killed else "finished"
        self.waiting.append(task)
        self.most = max(self.most, len(self.waiting))

    def next_batch(self, *, block: bool) -> list[Task]:
        assert not block
        return [self.waiting.pop(0)] if self.threads else []


def workers(dask: Dask, patience: float = 300.0) -> Workers:
    made = Workers.__new__(Workers)
    vars(made).update(
        _dask=dask, _client=dask.client, _patience=patience, _scheduler=None, _threads=1, _asked=-1e9, _manned=0.0
    )
    return made


def orders(count: int) -> list[DriveOrder]:
    return [SimpleNamespace(drive=SimpleNamespace(name=f"d{k}")) for k in range(count)]  # type: ignore[misc]


def test_few_drives_are_on_their_way_at_a_time() -> None:
    dask = Dask()
    assert [each.drive for each in workers(dask).outcomes(orders(50))] == [f"d{k}" for k in range(50)]
    assert dask.most == 4 * WAITING_A_WORKER
    dask.most = 0
    assert len(list(workers(dask).outcomes(orders(5), alone=True))) == 5
    assert dask.most == 1


def test_what_was_lost_with_the_scheduler_is_handed_out_again() -> None:
    dask = Dask()
    dask.lost = ["d1", "d3", "d3"]
    assert sorted(each.drive for each in workers(dask).outcomes(orders(5))) == [f"d{k}" for k in range(5)]


def test_a_drive_that_takes_its_workers_with_it_is_told() -> None:
    dask = Dask()
    dask.killed = ["d1"]
    outcomes = {each.drive: each.reason for each in workers(dask).outcomes(orders(3))}
    assert "its worker was killed" in outcomes["d1"]
    assert outcomes["d0"] == outcomes["d2"] == ""


def test_a_scheduler_that_does_not_come_back_ends_the_run() -> None:
    dask = Dask()
    dask.lost, dask.status_when_lost = ["d1"], "connecting"
    with pytest.raises(InputError, match="run the command again to go on"):
        list(workers(dask, patience=0.0).outcomes(orders(3)))


def test_a_scheduler_without_a_worker_is_given_up() -> None:
    dask = Dask()
    workers(dask).await_worker()
    dask.threads = {}
    for wait in (Workers.await_worker, lambda found: list(found.outcomes(orders(3)))):
        with pytest.raises(InputError, match=r"no worker for .* s; start some, each by: dask worker"):
            wait(workers(dask, patience=0.001))


@pytest.mark.parametrize("memory", ["-5", "0", "0.5", "much", "1e400", f"{LEAST_MEMORY - 1}"])
def test_a_worker_has_a_least_memory(memory: str) -> None:
    pytest.importorskip("dask", reason="needs Dask: pip install 'candaemon[fleet]'")
    with pytest.raises(ConfigError, match=f"--memory: found '{memory}', expected an amount such as 4GiB, at least 512"):
        Workers(None, 1, memory)


@pytest.mark.parametrize("error", [RuntimeError("Nanny failed to start."), OSError("in <TCP (closed)>")])
def test_workers_that_end_at_the_start_are_told(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    pytest.importorskip("dask", reason="needs Dask: pip install 'candaemon[fleet]'")

    def refused(**given: object) -> None:
        assert given["memory_limit"] == LEAST_MEMORY
        raise error

    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(LocalCluster=refused))
    with pytest.raises(InputError, match=f"workers end as they start: {re.escape(str(error))}; give each more by"):
        Workers(None, 1, f"{LEAST_MEMORY}")


def test_temporary_files_of_workers_go_with_the_folder_of_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    found: dict[str, Any] = {}

    def started(**given: Any) -> None:
        found.update(given)
        assert Path(given["local_directory"]).is_dir()
        raise RuntimeError

    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(LocalCluster=started))
    with pytest.raises(InputError):
        Workers(None, 1)
    assert found["env"] == {"TMPDIR": found["local_directory"]}
    assert not Path(found["local_directory"]).exists()


def test_all_drives_are_one_kind_of_task() -> None:
    # a scheduler remembers each kind for as long as it runs
    key_split = pytest.importorskip("dask.utils", reason="needs Dask: pip install 'candaemon[fleet]'").key_split
    dask = Dask()
    assert len(list(workers(dask).outcomes(orders(20)))) == 20
    assert len(set(dask.keys)) == 20
    assert {key_split(key) for key in dask.keys} == {"drive"}
