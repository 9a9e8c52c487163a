"""How a fleet's run scales: `python -m tests.fleet.scaling --drives 200`.

Simulates drives of mixed lengths and radars, runs them with one and with two workers, and compares every table with
that of `candaemon replay --parquet` of the drive alone.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
import psutil

from tests.support.bound import binding
from tests.support.recorded import as_log, highway

RADARS: Final = ("esr_ins", "ars408", "toyota_rav4", "gm_lrr")
WORKERS: Final = (1, 2)
LONGEST: Final = 12.0
"""s of the longest drive."""


def prepare(folder: Path, drives: int, longest: float) -> Path:
    """Write drives and their manifest; return it."""
    chance, rows = np.random.default_rng(5), ["drive,log,configuration"]
    lines = {
        radar: as_log(binding(radar), highway(binding(radar), longest)).splitlines(keepends=True) for radar in RADARS
    }
    for number in range(drives):
        radar = RADARS[number % len(RADARS)]
        log = folder / f"d{number:04d}.log"
        log.write_bytes(b"".join(lines[radar][: int(len(lines[radar]) * chance.uniform(0.1, 1.0))]))
        rows.append(f"{log.stem},{log.name},{radar}")
    manifest = folder / "drives.csv"
    manifest.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return manifest


def run(manifest: Path, results: Path, workers: int) -> tuple[float, float]:
    """Run the fleet; return s from the first drive's end to the last one's, and MiB of the client and its scheduler."""
    words = ["fleet", "run", RADARS[0], "--manifest", str(manifest), "-o", str(results), "--workers", str(workers)]
    process, most = psutil.Popen([sys.executable, "-m", "candaemon", *words], stdout=subprocess.DEVNULL), 0
    while process.poll() is None:
        most = max(most, process.memory_info().rss)
        time.sleep(0.5)
    assert process.returncode == 0
    ended = [record.stat().st_mtime for record in (results / "records").glob("*.json")]
    return max(ended) - min(ended), most / 2**20


def compare(manifest: Path, folder: Path, results: Sequence[Path]) -> tuple[int, int]:
    """Return how many tables of the runs were compared with those of a replay alone, and how many differ."""
    compared = different = 0
    for row in manifest.read_text(encoding="utf-8").splitlines()[1:]:
        drive, log, radar = row.split(",")
        words = ["replay", radar, str(manifest.parent / log), "--parquet", str(folder / drive)]
        subprocess.run([sys.executable, "-m", "candaemon", *words], check=True, capture_output=True)
        for alone in (folder / drive).glob("*.parquet"):
            for each in results:
                compared += 1
                part = each / alone.stem / f"drive={drive}" / "part-0.parquet"
                different += part.read_bytes() != alone.read_bytes()
    return compared, different


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=200, help="how many")
    parser.add_argument("--longest", type=float, default=LONGEST, metavar="S", help="s of the longest drive")
    parser.add_argument("--quick", action="store_true", help="two workers alone, and no comparison")
    told = parser.parse_args()
    with TemporaryDirectory() as name:
        folder, took = Path(name), []
        manifest = prepare(folder, told.drives, told.longest)
        chosen = WORKERS[-1:] if told.quick else WORKERS
        results = [folder / f"results_{workers}" for workers in chosen]
        for workers, result in zip(chosen, results, strict=True):
            seconds, memory = run(manifest, result, workers)
            took.append(seconds)
            records = [json.loads(record.read_text()) for record in (result / "records").glob("*.json")]
            overhead = np.percentile([1e3 * record["overhead"] for record in records], [50, 95, 100])
            print(
                f"{told.drives} drives, {workers} workers: {seconds:.1f} s; overhead of a drive {overhead[0]:.1f} ms, "
                f"95 % {overhead[1]:.1f}, most {overhead[2]:.1f}; client and scheduler {memory:.0f} MiB",
                flush=True,
            )
        if not told.quick:
            print(f"two workers: {took[0] / took[1]:.2f} x one")
            print(
                "{} tables compared with those of a replay alone, {} differ".format(*compare(manifest, folder, results))
            )


if __name__ == "__main__":
    main()
