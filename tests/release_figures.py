"""The figures of the recorded drive and of scenarios, beside those of the last release.

python -m tests.release_figures            compares; exit code 1 where a drive is worse by more than the tolerance
python -m tests.release_figures --renew    writes them anew, for a release
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from candaemon.cli.main import main as command
from candaemon.fleet.comparison import Comparison, compare, markdown
from candaemon.fleet.fleet_figures import FleetFigures, load_figures
from tests.support.fleets import run_inline
from tests.support.paths import DATA, ROOT

FIGURES: Final = ROOT / "tests" / "fleet" / "release_figures.json"
TOLERANCE: Final = 0.05
"""Relative change by which an error of a drive may be worse."""
SEED: Final = 7
SCENARIOS: Final = {"overtake": "esr_ins", "automotive_brake": "toyota_rav4_ins"}
"""Scenarios, and the configurations whose sensors see them."""
RECORDED: Final = {"drive_with_ins.log.gz": "toyota_rav4_ins"}


def computed(folder: Path) -> FleetFigures:
    """Simulate, replay, and return the figures; the recorded drive is among them where it is there."""
    drives = {}
    for scenario, config in SCENARIOS.items():
        log = folder / f"{scenario}.log"
        if command(["simulate", scenario, config, "-o", str(log), "--seed", str(SEED)]):
            raise RuntimeError(scenario)
        drives[log] = config
    for name, config in RECORDED.items():
        if (DATA / "rav4_drive" / name).is_file():
            drives[DATA / "rav4_drive" / name] = config
    for config in sorted(set(drives.values())):
        logs = [log for log, each in drives.items() if each == config]
        ended = run_inline(logs, folder / "results", ROOT / "config" / f"{config}.yaml")
        if ended.failed:
            raise RuntimeError(str(ended.failed))
    return plain(load_figures(str(folder / "results")))


def plain(figures: FleetFigures) -> FleetFigures:
    """Return figures without what is of one machine; simulated logs may differ there in their last bits."""
    return FleetFigures(
        {
            name: replace(each, inputs="", files={}, configuration="", logs=(), effort=0.0)
            for name, each in figures.drives.items()
        }
    )


def compared(folder: Path) -> Comparison:
    """Compare with the last release what is there to compare."""
    after, before = computed(folder), load_figures(str(FIGURES))
    there = {name: each for name, each in before.drives.items() if name in after.drives}
    return compare(FleetFigures(there), after, tolerance=TOLERANCE)


def main() -> int:
    """Compare or renew."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--renew", action="store_true", help="write the figures of the release")
    with TemporaryDirectory() as folder:
        if parser.parse_args().renew:
            text = json.dumps(computed(Path(folder)).to_json(), indent=1, allow_nan=False)
            FIGURES.write_text(f"{text}\n", encoding="utf-8")
            return 0
        found = compared(Path(folder))
    print(markdown(found, "the last release", "this"))
    return 1 if found.worse_drives else 0


if __name__ == "__main__":
    sys.exit(main())
