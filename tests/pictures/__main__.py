"""`python -m tests.pictures`: make the pictures of the documentation anew; needs Chromium at /usr/bin/chromium."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from playwright.sync_api import Browser, sync_playwright

from tests.pictures.drawn import CONFIG, DIGESTS, FOLDER, REPORT, SCENARIO, SCENE, SEED, digest, report, scene
from tests.support.paths import ROOT
from tests.support.view_pictures import take

CHROMIUM: Final = "/usr/bin/chromium"
CANDAEMON: Final = (sys.executable, "-m", "candaemon")


def run(folder: Path, *words: str) -> None:
    """Run a command in a folder."""
    subprocess.run(words, cwd=folder, check=True, stdout=subprocess.DEVNULL, env=environment())


def environment() -> dict[str, str]:
    """Return the environment in which this checkout is what runs."""
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def picture_of_report(folder: Path, browser: Browser) -> None:
    """Draw the top of the report."""
    page = browser.new_page(viewport={"width": 1040, "height": 1400}, color_scheme="light")
    page.goto((folder / "report.html").as_uri())
    page.screenshot(path=FOLDER / REPORT)


def main() -> None:
    """Make all of them, and keep the digests of what they show."""
    argparse.ArgumentParser(prog="python -m tests.pictures", description=__doc__).parse_args()
    with TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        run(folder, *CANDAEMON, "simulate", SCENARIO, CONFIG, "-o", "drive.log", "--seed", str(SEED))
        run(folder, sys.executable, str(ROOT / "examples" / "replay_and_plot.py"))
        shutil.copy(folder / SCENE, FOLDER / SCENE)
        run(folder, *CANDAEMON, "report", CONFIG, "drive.log", "--summary", "summary.json")
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        picture_of_report(folder, browser)
        browser.close()
        figures = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        drawn = {SCENE: digest(scene()), REPORT: digest(report(figures))}
    take(FOLDER)  # the view, whose digest lies beside its pictures
    DIGESTS.write_text(f"{json.dumps(drawn, indent=2)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
