"""Makes the pictures of the page that the documentation shows, anew: `python -m tests.support.view_pictures`.

What they show is a simulated drive at one instant. Pixels depend on fonts; so a test compares a digest of the data
drawn, which lies beside the pictures.
"""

from __future__ import annotations

import hashlib
import json
from functools import cache
from itertools import takewhile
from pathlib import Path
from typing import Final

from candaemon.config.shipped import find_scenario
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate
from candaemon.view.drive_pictures import pictures_of_frames
from candaemon.view.picture import Picture
from tests.support.chromium import chromium, tab
from tests.support.paths import ROOT
from tests.support.viewing import demo_binding, served_page, show_of

FOLDER: Final = ROOT / "docs" / "images"
DIGEST: Final = FOLDER / "view.digest"
SCENARIO: Final = "highway"
INSTANT_S: Final = 14.0
SIZE: Final = (1280, 800)


@cache
def drawn_pictures() -> tuple[Picture, ...]:
    """Return what leads to the instant that is shown."""
    scenario = load_scenario(find_scenario(Path(SCENARIO)))
    stream = pictures_of_frames(demo_binding(), simulate(scenario, demo_binding(), 1).frames())
    first = next(stream)
    return first, *takewhile(lambda picture: picture.time < first.time + INSTANT_S, stream)


def digest() -> str:
    """Return a digest of the data drawn: obstacles to 0.1 m, detections by their number."""
    told = [
        [
            picture.columns["id"].tolist(),
            picture.columns["state"].tolist(),
            picture.columns["x"].round(1).tolist(),
            picture.columns["y"].round(1).tolist(),
            [len(scan.x) for scan in picture.scans],
        ]
        for picture in drawn_pictures()
    ]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def take(folder: Path) -> None:
    """Write the pictures and the digest.

    Args:
        folder: for them.
    """
    pictures = drawn_pictures()
    last = pictures[-1]
    identity = int(last.columns["id"][last.columns["age"].argmax()])
    show = show_of(pictures)
    show.title = f"simulated: {SCENARIO}"
    with served_page(show) as server, chromium() as browser:
        for name, dark in (("view", False), ("view-dark", True)):
            url = f"{server.url}#t={INSTANT_S}&id={identity}"
            with tab(browser, url, width=SIZE[0], height=SIZE[1], dark=dark) as page:
                page.wait("t => document.getElementById('road').dataset.time >= t - 1e-3", last.time)
                page.page.wait_for_timeout(1500)  # plots and health follow a little later
                page.page.screenshot(path=folder / f"{name}.png")
    (folder / DIGEST.name).write_text(f"{digest()}\n", encoding="ascii")


if __name__ == "__main__":
    take(FOLDER)
