"""Short drives for a fleet, and what computes them within the test's own process."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from candaemon.cli.main import main
from candaemon.fleet.dataset import ReplayOptions
from candaemon.fleet.drive_list import drives_of
from candaemon.fleet.drive_task import DriveOrder, DriveOutcome, run_drive
from candaemon.fleet.fleet_run import FleetResult, configurations_of, orders_of, run_fleet
from candaemon.fleet.result_store import store_at
from tests.support.paths import ROOT

CONFIG = ROOT / "config" / "esr_ins.yaml"
SCENARIO = "duration: 4\nego: {start: {speed: 20}}\nactors: [{name: lead, start: {x: 40, y: 0, vx: 20, vy: 0}}]\n"


class Inline:
    """Takes the place of Dask's workers."""

    def __init__(self) -> None:
        self.alone: list[str] = []

    def outcomes(self, orders: Iterable[DriveOrder], *, alone: bool = False) -> Iterator[DriveOutcome]:
        for order in orders:
            if alone:
                self.alone.append(order.drive.name)
            yield run_drive(order)


def simulated(folder: Path, seed: int = 0, scenario: str = SCENARIO, config: str = "esr_ins") -> Path:
    """Return the log of a short drive."""
    path, log = folder / "scenario.yaml", folder / "whole.log"
    path.write_text(scenario, encoding="utf-8")
    assert main(["simulate", str(path), config, "-o", str(log), "--seed", str(seed)]) == 0
    path.unlink()
    return log


def short_drives(folder: Path, count: int, whole: Path) -> list[Path]:
    """Write drives of different content and length: beginnings of a whole one."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = whole.read_text(encoding="ascii").splitlines(keepends=True)
    logs = []
    for number in range(count):
        log = folder / f"d{number:03d}.log"
        log.write_text("".join(lines[: 500 + 40 * number]), encoding="ascii")
        logs.append(log)
    return logs


def run_inline(
    logs: Iterable[Path | str],
    output: Path | str,
    config: Path = CONFIG,
    workers: Inline | None = None,
    manifests: Iterable[Path] = (),
    options: ReplayOptions | None = None,
) -> FleetResult:
    """Run a fleet as `candaemon fleet run` does, in this process."""
    options, result, store = options or ReplayOptions(), FleetResult(), store_at(str(output))
    drives = drives_of([str(log) for log in logs], list(map(str, manifests)), config)
    configurations = configurations_of(drives, options)
    with store.exclusive():
        orders = orders_of(drives, configurations, store, options, result)
        for configuration in configurations.values():
            configuration.keep(store)
        run_fleet(orders, workers or Inline(), store, result)  # type: ignore[arg-type]
    return result


def tables(folder: Path) -> dict[str, bytes]:
    """Return the tables of a run by name."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*.parquet"))}


def candaemon(*words: str | Path, **given: str) -> subprocess.Popen[str]:
    """Start a command of its own."""
    command = [sys.executable, "-m", "candaemon", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=given or None)
