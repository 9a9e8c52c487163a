"""The process in which a target is tried: `python -m tests.fuzz.worker`, started by `farm`.

It prints a line of JSON for each finding, now and then its counts, and ends with its last. atheris writes what it
reaches to standard error.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import random
import sys
import time
import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import TextIO

from . import trial
from .targets import load
from .trial import LONGEST, Current, Trial, bound_memory, file_name

CORPUS = Path(__file__).resolve().parent / "corpus"
_TOLD_S = 0.5
_SLOWED = 4
"""How many times as long code takes that atheris watches."""
_ODD = (
    b"\0",
    b"\xff",
    b"\x7f",
    b"\x80",
    b"\0\0\0\0",
    b"\xff\xff\xff\xff",
    b"\x01\0\0\0\0\0\0\0",
    b"\0\0\0\0\0\0\xf0\x7f",
)
_LENGTHS = (8, 30, 60, 200, 600, 2000)


class Worker:
    """Tries inputs until their number or the time is reached; then the process ends.

    Args:
        name: of the target.
        folder: of this worker, for the current input.
        findings: folder in which a finding becomes a file.
        runs: inputs to try; None: as many as the time allows.
        seconds: to try them; None: as long as it takes.
    """

    def __init__(self, name: str, folder: Path, findings: Path, runs: int | None, seconds: float | None) -> None:
        self._findings = findings
        self._runs = runs
        self._seconds = seconds
        self._began_s: float | None = None
        self._told_s = 0.0
        self._trial = Trial(load(name), Current(folder / "current"), self._keep)
        bound_memory()

    def take(self, data: bytes) -> None:
        """Try an input; end the process after the last."""
        if self._began_s is None:
            self._began_s = time.monotonic()
        self._trial.take(data)
        now_s = time.monotonic()
        over = self._seconds is not None and now_s >= self._began_s + self._seconds
        done = over or self._trial.inputs == self._runs
        if done or now_s >= self._told_s + _TOLD_S:
            self._told_s = now_s
            _tell(inputs=self._trial.inputs, counts=self._trial.counts, done=done)
        if done:
            os._exit(0)  # whatever libFuzzer makes of that: it has no other end

    def _keep(self, failure: str, data: bytes) -> None:
        self._findings.mkdir(parents=True, exist_ok=True)
        path = self._findings / file_name(failure)
        path.write_bytes(data)
        _tell(failure=failure, path=str(path))


def inputs(name: str, seed: int) -> Iterator[bytes]:
    """Yield inputs without end: those that are kept, then random ones and kept ones with changes.

    Args:
        name: of the target.
        seed: of chance.
    """
    chance = random.Random(f"{name} {seed}")  # noqa: S311 - no secret
    kept = [path.read_bytes() for path in sorted((CORPUS / name).glob("*"))] or [b""]
    yield from kept
    while True:
        if chance.random() < 0.5:
            yield chance.randbytes(chance.choice(_LENGTHS))
        else:
            yield _changed(bytearray(chance.choice(kept)), chance, kept)


def _changed(data: bytearray, chance: random.Random, kept: list[bytes]) -> bytes:
    """Return an input with some bytes changed, taken out, put in, or swapped for a piece of another one."""
    for _ in range(chance.randint(1, 6)):
        at, size = chance.randint(0, len(data)), chance.choice((1, 1, 2, 4, 16, 64))
        match chance.randint(0, 5):
            case 0:
                del data[at : at + size]
            case 1:
                data[at:at] = chance.randbytes(size)
            case 2:
                data[at : at + size] = chance.randbytes(size)
            case 3:
                data[at:at] = chance.choice(_ODD)
            case 4:
                other = chance.choice(kept)
                start = chance.randint(0, len(other))
                data[at:] = other[start:]
            case _:
                if at < len(data):
                    data[at] ^= 1 << chance.randint(0, 7)
    return bytes(data[:LONGEST])


def has_atheris() -> bool:
    """Tell whether atheris is installed."""
    from importlib.util import find_spec

    return find_spec("atheris") is not None


def _guided(arguments: argparse.Namespace) -> None:
    import atheris  # type: ignore[import-untyped, unused-ignore] # it ships no types, and few have it

    with atheris.instrument_imports(include=["candaemon", "cantools", "can"], enable_loader_override=False):
        worker = _worker(arguments)
    reached = arguments.corpus or arguments.folder / "reached"
    reached.mkdir(parents=True, exist_ok=True)
    trial.CPU_S *= _SLOWED
    # limits of libFuzzer's own are off: Trial has them, and goes on after a failure
    options = [
        f"-seed={arguments.seed}",
        f"-max_len={LONGEST}",
        "-timeout=86400",
        "-rss_limit_mb=0",
        "-malloc_limit_mb=0",
    ]
    options.append(f"-artifact_prefix={arguments.folder}/")
    kept = CORPUS / arguments.target
    atheris.Setup([sys.argv[0], *options, str(reached), *([str(kept)] if kept.is_dir() else [])], worker.take)
    atheris.Fuzz()


def _worker(arguments: argparse.Namespace) -> Worker:
    return Worker(arguments.target, arguments.folder, arguments.findings, arguments.runs, arguments.seconds)


@cache
def _messages() -> TextIO:
    """Return what was standard output; what a target or atheris prints goes to standard error from then on."""
    messages = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    return messages


def _tell(**message: object) -> None:
    _messages().write(json.dumps(message) + "\n")
    _messages().flush()


def main() -> None:
    """Try inputs as the arguments say."""
    parser = argparse.ArgumentParser()
    parser.add_argument("target")
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--findings", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--runs", type=int)
    parser.add_argument("--seconds", type=float)
    parser.add_argument("--corpus", type=Path)
    parser.add_argument("--guided", action="store_true")
    arguments = parser.parse_args()
    logging.disable(logging.CRITICAL)
    _messages()
    if arguments.guided:
        warnings.simplefilter("ignore")  # what atheris itself imports warns
        _guided(arguments)
    worker = _worker(arguments)
    warnings.simplefilter("error")
    for data in inputs(arguments.target, arguments.seed):
        worker.take(data)


if __name__ == "__main__":
    main()
