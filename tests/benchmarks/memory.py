"""Memory of a replay, minute by minute of the drive: `python -m tests.benchmarks.memory` replays an hour.

The drive is the motorway scenario over and over, with time going on.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from candaemon.simulation.scenario import load_scenario

from .chains import ROOT

CONFIG: Final = ROOT / "config/toyota_rav4_ins.yaml"
SCENARIO: Final = ROOT / "config/scenarios/highway.yaml"
LIMIT: Final = 5.0
"""MB by which memory may grow after the first minute."""
_LOOK_S: Final = 0.1


def long_log(path: Path, minutes: float) -> None:
    """Write a drive of so many minutes."""
    simulate = [sys.executable, "-m", "candaemon", "simulate", str(SCENARIO), str(CONFIG), "-o", f"{path}.once.log"]
    subprocess.run(simulate, check=True, cwd=ROOT, capture_output=True)
    lines = Path(f"{path}.once.log").read_text(encoding="ascii").splitlines()
    stamped = [(float(line[1 : line.index(")")]), line[line.index(")") :]) for line in lines]
    seconds = load_scenario(SCENARIO).duration
    with path.open("w", encoding="ascii") as log:
        for turn in range(round(minutes * 60.0 / seconds)):
            log.writelines(f"({time_s + turn * seconds:.6f}{rest}\n" for time_s, rest in stamped)


def resident_by_minute(path: Path, minutes: float) -> list[float]:
    """Replay a drive with output and tracks; return the memory in use at the end of each minute of it, in MB."""
    replay = ["replay", str(CONFIG), str(path), "-o", f"{path}.out.log", "--tracks", f"{path}.tracks.csv"]
    size, found = path.stat().st_size, [0.0]
    with subprocess.Popen(
        [sys.executable, "-m", "candaemon", *replay], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        while process.poll() is None:
            at, resident = _position(process.pid, path), _resident(process.pid)
            minute = int(at / size * minutes)
            if resident:
                found += [found[-1]] * (minute + 1 - len(found))
                found[-1] = resident
            time.sleep(_LOOK_S)
    if process.returncode:
        raise RuntimeError(f"the replay ended with {process.returncode}")
    return found[: round(minutes)]


def _position(pid: int, path: Path) -> int:
    """Return how far a process has read a file; 0 where it is not open."""
    try:
        for each in Path(f"/proc/{pid}/fd").iterdir():
            if each.readlink() == path:
                return int(Path(f"/proc/{pid}/fdinfo/{each.name}").read_text(encoding="ascii").split()[1])
    except FileNotFoundError:  # closed meanwhile
        pass
    return 0


def _resident(pid: int) -> float:
    """Return a process's memory in MB; 0 of one that has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    except (FileNotFoundError, ProcessLookupError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.memory", description=__doc__)
    parser.add_argument("--minutes", type=int, default=60, help="of the drive; default: 60")
    minutes = parser.parse_args().minutes
    with TemporaryDirectory() as folder:
        path = Path(folder).resolve() / "drive.log"
        long_log(path, minutes)
        resident = resident_by_minute(path, minutes)
    print("resident memory by minute of the drive, MB:", " ".join(f"{each:.1f}" for each in resident))
    growth = max(resident[1:]) - resident[0]
    print(f"{minutes} minutes: {growth:.1f} MB more than after the first, goal {LIMIT:g}")


if __name__ == "__main__":
    main()
