"""Many targets, each in processes of its own: what they tried, reached and found."""

from __future__ import annotations

import json
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from .progress import ProgressLines
from .targets import UNGUIDED, WEIGHTS
from .trial import Current, file_name
from .worker import CORPUS, has_atheris

WORKER = ("-m", "tests.fuzz.worker")
ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 120.0
"""After which an input that is still tried is taken as one without an end, s."""

_COVERAGE = re.compile(rb"(INITED)?\s+cov: (\d+)")


@dataclass(frozen=True, slots=True)
class Job:
    """A target that is to be tried.

    Attributes:
        target: its name.
        seed: of chance.
        runs: inputs; None: as many as the time allows.
        seconds: for all inputs; None: as long as it takes.
        guided: whether atheris steers them.
        findings: folder in which findings become files.
        corpus: folder that atheris keeps in what reached new code; None: nowhere.
    """

    target: str
    seed: int
    runs: int | None
    seconds: float | None
    guided: bool
    findings: Path
    corpus: Path | None = None


@dataclass(slots=True)
class Yield:
    """What a job came to.

    Attributes:
        target: its name.
        inputs: tried.
        seconds: that they took.
        counts: what became of them, as the target counts.
        covered: edges reached by the kept inputs, and by all; none where nothing steered.
        findings: what is wrong, and the input's file.
    """

    target: str
    inputs: int = 0
    seconds: float = 0.0
    counts: Counter[str] = field(default_factory=Counter)
    covered: tuple[int, int] | None = None
    findings: dict[str, Path] = field(default_factory=dict)

    def add(self, other: Yield) -> None:
        """Add another job of the same target, which ran beside this one."""
        self.inputs += other.inputs
        self.seconds = max(self.seconds, other.seconds)
        self.counts.update(other.counts)
        pairs = [pair for pair in (self.covered, other.covered) if pair]
        self.covered = (min(pair[0] for pair in pairs), max(pair[1] for pair in pairs)) if pairs else None
        self.findings |= other.findings


def jobs_for(
    targets: Sequence[str],
    *,
    seed: int,
    runs: int | None,
    seconds: float | None,
    plain: bool = False,
    processes: int = 1,
    findings: Path | None = None,
    corpus: Path | None = None,
) -> list[Job]:
    """Return what is to be tried.

    Args:
        targets: names.
        seed: of chance.
        runs: inputs of each target; None: as many as the time allows.
        seconds: until all have ended; each target has a share of them. None: as long as it takes.
        plain: whether atheris stays away, so that the same seed tries the same inputs on every machine.
        processes: that try them; the inputs of a single target are shared among them.
        findings: folder of folders in which findings become files; None: the kept inputs, which the tests try.
        corpus: folder of folders that atheris keeps in what reached new code; None: nowhere.
    """
    atheris = not plain and has_atheris()

    def job(name: str, seed: int, runs: int | None, seconds: float | None) -> Job:
        guided = atheris and name not in UNGUIDED
        return Job(name, seed, runs, seconds, guided, (findings or CORPUS) / name, corpus and corpus / name)

    if len(targets) == 1:
        shares = [None if runs is None else runs // processes + (k < runs % processes) for k in range(processes)]
        return [job(targets[0], seed + 1_000_000 * k, share, seconds) for k, share in enumerate(shares) if share != 0]
    whole = sum(WEIGHTS[name] for name in targets)
    each = {name: None if seconds is None else seconds * processes * WEIGHTS[name] / whole for name in targets}
    longest_first = sorted(targets, key=lambda name: -WEIGHTS[name])
    return [job(name, seed, runs, each[name]) for name in longest_first]


def run_farm(jobs: Sequence[Job], processes: int) -> list[Yield]:
    """Run jobs, and print a table of what they came to, in the order of their names.

    Args:
        jobs: what is to be tried.
        processes: at a time.
    """
    by_target: dict[str, Yield] = {}
    by_runs = jobs[0].seconds is None
    total = sum(job.runs or 0 for job in jobs) if by_runs else sum(job.seconds or 0 for job in jobs)
    with ProgressLines("inputs" if by_runs else "seconds", round(total)) as bar, ThreadPoolExecutor(processes) as pool:

        def work(job: Job) -> Yield:
            done = 0.0

            def progress(inputs: int, seconds: float) -> None:
                nonlocal done
                there = inputs if by_runs else min(seconds, job.seconds or 0)
                bar.advance(max(there - done, 0))
                done = max(there, done)

            return run_job(job, progress)

        for result in pool.map(work, jobs):
            for failure, path in result.findings.items():
                bar.line(f"{result.target}: {failure}\n  again: python -m tests.fuzz {result.target} --input {path}")
            if result.target in by_target:
                by_target[result.target].add(result)
            else:
                by_target[result.target] = result
    return [by_target[name] for name in sorted(by_target)]


def run_job(job: Job, progress: Callable[[int, float], None]) -> Yield:
    """Try a target until its inputs or its time are used up, in as many processes as it ends.

    Args:
        job: what is to be tried.
        progress: told of inputs tried and seconds gone by.
    """
    began_s = time.monotonic()
    result = Yield(job.target)
    attempt = 0
    while (job.runs is None or result.inputs < job.runs) and not _over(job, began_s):
        left = None if job.seconds is None else job.seconds - (time.monotonic() - began_s)
        runs = None if job.runs is None else job.runs - result.inputs
        with TemporaryDirectory(prefix="candaemon-farm-") as folder:
            part = replace(job, seed=job.seed + attempt, runs=runs, seconds=left)
            before = result.inputs

            def counted(inputs: int, before: int = before) -> None:
                progress(before + inputs, time.monotonic() - began_s)

            one = _run_worker(part, Path(folder), counted)
        one.seconds = 0.0
        result.add(one)
        attempt += 1
        if result.inputs == before:  # it does not even begin
            break
    result.seconds = time.monotonic() - began_s
    return result


def _over(job: Job, began_s: float) -> bool:
    return job.seconds is not None and time.monotonic() - began_s >= job.seconds


def _run_worker(job: Job, folder: Path, progress: Callable[[int], None]) -> Yield:
    """Run one process; where it dies or hangs, its last input is a finding."""
    result = Yield(job.target)
    command = [sys.executable, *WORKER, job.target, f"--folder={folder}"]
    command += [f"--findings={job.findings}", f"--seed={job.seed}"]
    command += [f"--runs={job.runs}"] if job.runs is not None else []
    command += [f"--seconds={job.seconds}"] if job.seconds is not None else []
    command += [f"--corpus={job.corpus}"] if job.corpus is not None else []
    command += ["--guided"] if job.guided else []
    current, ended = Current(folder / "current"), False
    with (folder / "said").open("wb") as said:
        worker = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=said, cwd=ROOT, start_new_session=True)
        for line in _lines(worker, current):
            message = json.loads(line)
            if "failure" in message:
                result.findings[message["failure"]] = Path(message["path"])
            else:
                result.inputs, result.counts = message["inputs"], Counter(message["counts"])
                ended = message["done"]
                progress(result.inputs)
        with_hang = not ended and worker.poll() is None
        with suppress(ProcessLookupError):
            os.killpg(worker.pid, signal.SIGKILL)  # with all that it started
        status = worker.wait()
    text = (folder / "said").read_bytes()
    result.covered = _covered(text)
    if not ended:
        number, data = current.get()
        what = f"no end within {PATIENCE_S:g} s" if with_hang else f"exit status {status}"
        failure = f"{'Hang' if with_hang else 'Death'}: {what}: {_last(text)}"
        if number == 0:
            raise RuntimeError(f"the target {job.target} cannot be tried: {text.decode(errors='replace')}")
        job.findings.mkdir(parents=True, exist_ok=True)
        path = job.findings / file_name(failure)
        path.write_bytes(data)
        result.findings[failure] = path
        result.inputs = number
    return result


def _lines(worker: subprocess.Popen[bytes], current: Current) -> Iterator[bytes]:
    """Yield what a worker prints until it ends, or tries one input for too long."""
    assert worker.stdout is not None
    with worker.stdout as stream:
        number, since_s, rest = 0, time.monotonic(), b""
        while True:
            if select.select([stream], [], [], 1.0)[0]:
                part = os.read(stream.fileno(), 65_536)
                if not part:
                    worker.wait()
                    return
                *lines, rest = (rest + part).split(b"\n")
                yield from lines
            now, _ = current.get()
            if now != number:
                number, since_s = now, time.monotonic()
            elif time.monotonic() - since_s > PATIENCE_S:
                return


def _covered(text: bytes) -> tuple[int, int] | None:
    """Return the edges that libFuzzer says the kept inputs reached, and all."""
    found = _COVERAGE.findall(text)
    first = next((int(count) for inited, count in found if inited), None)
    return None if first is None else (first, max(int(count) for _, count in found))


def _last(text: bytes) -> str:
    lines = [line for line in text.decode(errors="replace").splitlines() if line.strip()]
    return lines[-1][:200] if lines else ""


def table(results: Sequence[Yield]) -> str:
    """Return what the jobs came to as a table in text."""
    rows = [("target", "inputs", "inputs/s", "new coverage", "findings", "of which")]
    for each in results:
        new = "-" if each.covered is None else f"{each.covered[1] - each.covered[0]} of {each.covered[1]}"
        counts = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in sorted(each.counts.items()) if count)
        speed = each.inputs / max(each.seconds, 1e-3)
        rows.append((each.target, f"{each.inputs}", f"{speed:.1f}", new, f"{len(each.findings)}", counts))
    widths = [max(len(row[k]) for row in rows) for k in range(5)]
    return "\n".join(
        "  ".join((row[0].ljust(widths[0]), *(row[k].rjust(widths[k]) for k in range(1, 5)), row[5])).rstrip()
        for row in rows
    )
