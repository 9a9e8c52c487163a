"""The commands as a user runs them: whole processes by their CPU time, in turns with the naive chain."""

from __future__ import annotations

import atexit
import os
import resource
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import yaml

from .chains import HERE, ROOT, imm_config, simulated_log
from .live_sides import process_cpu
from .live_wire import free_wire, on_wire

SECONDS, NAIVE_SECONDS = 80.0, 8.0
"""Length of the drives, s: a chain that takes ten times as long is given a tenth. A run over a tenth of a second shows
what starting costs, which varies by some 30 ms: little beside the longer drive."""
CYCLES = 20
"""Cycles of a second of the drive."""
NAIVE = """
import sys
from pathlib import Path
from tests.benchmarks import naive
from tests.benchmarks.chains import count, naive_cycles
count(naive_cycles(getattr(naive, sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3])))
"""


@dataclass(frozen=True, slots=True)
class Command:
    """A way of working on a drive, as a process.

    Attributes:
        name: what is printed.
        arguments: of Python; `{log}`, `{scenario}` and `{folder}` stand for the drive, its scenario, and its results.
        against: name of the command whose time is divided by this one's; None: there is none.
        seconds: length of the drive, s.
    """

    name: str
    arguments: tuple[str, ...]
    against: str | None = None
    seconds: float = SECONDS

    def on(self, log: Path) -> list[str]:
        """Return the arguments for a drive, whose scenario and folder are named as it is."""
        meant = {"{log}": log, "{scenario}": log.with_suffix(".yaml"), "{folder}": log.with_suffix("")}
        found = list(self.arguments)
        for name, path in meant.items():
            found = [part.replace(name, str(path)) for part in found]
        return found


def _replay(config: Path | str, *options: str) -> tuple[str, ...]:
    return ("-m", "candaemon", "replay", str(config), "{log}", "-o", "{folder}/out.log", *options)


def _naive(name: str, kind: str) -> Command:
    return Command(name, ("-c", NAIVE, kind, "{log}", "{folder}/naive.log"), seconds=NAIVE_SECONDS)


_SCORED = ("--tracks", "{folder}/t.csv", "--predictions", "{folder}/p.csv", "--summary", "{folder}/s.json")
_SIMULATED = ("-o", "{folder}/simulated.log", "--truth", "{folder}/truth.csv")
_REDUCED, _FULL = HERE / "esr_bench.yaml", ROOT / "config/esr_ins.yaml"
COMMANDS = (
    _naive("naive chain, CS-KF", "CurrentStatistical"),
    _naive("naive chain, filterpy's IMM", "InteractingModels"),
    Command("replay -o, CS-KF", _replay(_REDUCED), "naive chain, CS-KF"),
    Command("replay -o, IMM with its defaults", _replay("{folder}/imm.yaml"), "naive chain, filterpy's IMM"),
    Command("replay -o, all defaults", _replay(_FULL), "replay -o, IMM with its defaults"),
    Command("replay with tables and scores", _replay(_FULL, *_SCORED), "replay -o, all defaults"),
    Command("simulate", ("-m", "candaemon", "simulate", "{scenario}", str(_FULL), *_SIMULATED)),
    Command("evaluate", ("-m", "candaemon", "evaluate", "{folder}/t.csv", "{folder}/truth.csv")),
)
"""What is timed over a drive; what one command reads, one before has written."""
START = ("-m", "candaemon", "check", str(_FULL))
"""What is timed of starting: a configuration that ships, checked."""


@cache
def _byte_code_folder() -> str:
    """Return a folder that is this process's alone: byte code that others could write would run."""
    folder = TemporaryDirectory()
    atexit.register(folder.cleanup)
    return folder.name


def environment() -> dict[str, str]:
    """Return that of a process that finds and keeps byte code as it does where pip has installed candaemon."""
    kept = {"PYTHONPATH": str(ROOT), "PYTHONPYCACHEPREFIX": _byte_code_folder()}
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | kept


def cpu_seconds(arguments: Sequence[str]) -> float:
    """Run Python with arguments; return the CPU time of the process, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], check=True, env=environment(), cwd=ROOT, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def served_config(folder: Path) -> Path:
    """Write a shipped configuration with its buses on local datagrams; return its YAML."""
    return on_wire(_FULL, free_wire(), 1200.0, folder)


def ready_seconds(config: Path, folder: Path) -> tuple[float, float]:
    """Start `candaemon run` of a configuration; return its CPU time and the time until it says READY=1, s."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notified:
        notified.bind(str(folder / "notify"))
        notified.settimeout(60.0)
        told = environment() | {"NOTIFY_SOCKET": str(folder / "notify"), "XDG_RUNTIME_DIR": str(folder)}
        command = [sys.executable, "-m", "candaemon", "run", str(config)]
        began = time.perf_counter()
        with subprocess.Popen(command, env=told, cwd=ROOT, stderr=subprocess.DEVNULL) as service:
            try:
                while b"READY=1" not in notified.recv(4096):
                    pass
                return process_cpu(service.pid), time.perf_counter() - began
            finally:
                (folder / "notify").unlink()
                service.terminate()


def drive(log: Path, seconds: float) -> Path:
    """Simulate a drive, with its scenario and a folder for results beside it, in it the IMM's YAML; return the log."""
    log.with_suffix("").mkdir()
    imm_config(log.with_suffix(""))
    scenario = yaml.safe_load((ROOT / "config/scenarios/dense.yaml").read_text(encoding="utf-8"))
    log.with_suffix(".yaml").write_text(yaml.safe_dump(scenario | {"duration": seconds}), encoding="utf-8")
    return simulated_log(log, seconds)


def timed_commands(folder: Path, repeats: int = 3) -> dict[str, float]:
    """Return the median CPU time of a cycle of each of the commands, µs, without what starting costs."""
    drives = {seconds: drive(folder / f"{seconds:g}.log", seconds) for seconds in (SECONDS, NAIVE_SECONDS)}
    start = drive(folder / "start.log", 1 / CYCLES)
    times: dict[str, list[float]] = {each.name: [] for each in COMMANDS}
    for _ in range(repeats):
        for each in COMMANDS:
            long, short = (cpu_seconds(each.on(log)) for log in (drives[each.seconds], start))
            times[each.name].append((long - short) / (each.seconds * CYCLES - 1) * 1e6)
    return {name: median(found) for name, found in times.items()}


def print_comparisons(folder: Path) -> None:
    """Time the commands and print a table."""
    for line in table(timed_commands(folder)):
        print(line, flush=True)
    print(f"{'check, a shipped configuration':<32}{median(cpu_seconds(START) for _ in range(3)):>9.2f} s", flush=True)
    config = served_config(folder)
    _, *ready = (ready_seconds(config, folder)[0] for _ in range(4))  # at the first, the configuration is not known
    print(f"{'run until ready, the same':<32}{median(ready):>9.2f} s", flush=True)


def table(times: dict[str, float]) -> Iterator[str]:
    """Yield the lines that are printed."""
    for each in COMMANDS:
        ratio = "" if each.against is None else f"{times[each.against] / times[each.name]:>7.1f} x {each.against}"
        yield f"{each.name:<32}{times[each.name]:>9.0f} µs/cycle {ratio}"
