"""The farm: what it tries depends on the seed, what breaks a target becomes a file, and nothing holds it up."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from . import trial
from .farm import ROOT, jobs_for, run_job, table
from .targets import WEIGHTS
from .trial import Current, TooLong, Trial, file_name
from .worker import inputs

DYING = """
import os, signal
from collections import Counter
from tests.fuzz import worker
def target(data):
    if len(data) > 100:
        os.kill(os.getpid(), signal.SIGKILL)
    return Counter(lived=1)
worker.load = lambda name: target
worker.inputs = lambda name, seed: iter([b"", b"x" * (101 if seed == 1 else 1)] + [b""] * 100)
worker.main()
"""
RUNS = {
    "captures": 12_000,
    "codec": 8_000,
    "configuration": 500,
    "datagrams": 20_000,
    "dbc": 500,
    "http": 1_000,
    "logs": 1_500,
    "page": 900,
    "pipeline": 120,
    "protection": 30_000,
    "scenarios": 1_500,
    "signals": 20,
    "state": 600,
    "status": 15_000,
    "tables": 1_500,
}
"""Inputs that take about as long as another target's: the same ones on every machine, however fast it is."""
Found = list[tuple[str, bytes]]


def tried(target: Callable[[bytes], Counter[str]], folder: Path, *data: bytes) -> tuple[Trial, Found]:
    found: Found = []
    one = Trial(target, Current(folder / "current"), lambda failure, input_: found.append((failure, input_)))
    for each in data:
        one.take(each)
    return one, found


def test_a_failure_is_told_once_with_the_smallest_input(tmp_path: Path) -> None:
    def target(data: bytes) -> Counter[str]:
        assert b"!" not in data
        return Counter(quiet=1)

    one, found = tried(target, tmp_path, b"abc", b"some text with ! in it", b"another!", b"def")
    assert found == [("AssertionError: test_farm.py target", b"!")]
    assert (one.inputs, one.counts) == (4, Counter(quiet=2))
    assert file_name(found[0][0]).startswith("assertionerror-")


def test_what_takes_too_long_is_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def target(data: bytes) -> Counter[str]:
        while data:
            with suppress(Exception):
                sum(range(1000))
        return Counter()

    monkeypatch.setattr(trial, "CPU_S", 0.2)
    before = signal.signal(signal.SIGPROF, trial._interrupt)
    try:
        _, found = tried(target, tmp_path, b"x")
    finally:
        signal.signal(signal.SIGPROF, before)
    assert found == [(f"{TooLong.__name__}: more than 0.2 s of processor time", b"x")]


def test_what_takes_much_memory_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "RISE", 30_000_000)
    peak = trial._peak()

    def target(data: bytes) -> Counter[str]:
        return Counter(bytes=len(bytearray(b"x" * (peak + 100_000_000)))) if data else Counter()

    _, found = tried(target, tmp_path, b"", b"x")
    assert [failure for failure, _ in found] == ["MemoryError: more than 30 MB"]


def test_the_input_that_was_tried_last_outlives_the_process(tmp_path: Path) -> None:
    Current(tmp_path / "current").put(7, b"the last")
    assert Current(tmp_path / "current").get() == (7, b"the last")


def test_the_same_seed_tries_the_same_inputs() -> None:
    def first(seed: int) -> list[bytes]:
        coming = inputs("logs", seed)
        return [next(coming) for _ in range(200)]

    assert first(1) == first(1)
    assert first(1) != first(2)
    assert len(set(first(1))) > 150


def test_the_time_and_the_inputs_are_shared_out() -> None:
    every = jobs_for(sorted(WEIGHTS), seed=1, runs=None, seconds=60.0, processes=2)
    assert {job.target for job in every} == set(WEIGHTS)
    assert sum(job.seconds or 0 for job in every) == pytest.approx(120.0)
    one = jobs_for(["logs"], seed=1, runs=101, seconds=None, processes=2)
    assert [job.runs for job in one] == [51, 50]
    assert one[0].seed != one[1].seed


def test_a_process_that_dies_leaves_its_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (job,) = jobs_for(["protection"], seed=1, runs=30, seconds=None, plain=True, findings=tmp_path)
    monkeypatch.setattr("tests.fuzz.farm.WORKER", ("-c", DYING))
    seen = []
    result = run_job(job, lambda inputs, _: seen.append(inputs))
    assert result.inputs == seen[-1] == 30, "the others are tried by a second process"
    ((failure, path),) = result.findings.items()
    assert failure.startswith("Death: exit status -9")
    assert len(path.read_bytes()) > 100
    assert " 1  " in table([result]).splitlines()[1]


def test_a_farm_from_the_command_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.fuzz", "tables", "--runs", "40", "--plain", "--processes", "2"]
    ended = subprocess.run(
        [*command, "--findings", str(tmp_path)], capture_output=True, text=True, check=False, cwd=ROOT, timeout=120
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    head, row = ended.stdout.splitlines()
    assert head.split()[:2] == ["target", "inputs"]
    assert row.split()[:2] == ["tables", "40"]


@pytest.mark.slow
@pytest.mark.parametrize(("target", "runs"), RUNS.items())
def test_a_target_for_a_while(target: str, runs: int, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.fuzz", target, "--runs", str(runs), "--plain", "--findings", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, timeout=900)
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_every_target_is_tried_for_a_while() -> None:
    assert RUNS.keys() == WEIGHTS.keys()
