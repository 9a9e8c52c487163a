"""Each example runs, as its first lines say how, and prints what they promise."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from tests.support.paths import ROOT

PRINTED = {
    "compare_configurations.py": "imm: position",
    "filter_own_data.py": "filtered:",
    "own_radar.py": "obstacles confirmed",
    "replay_and_plot.py": "scene.svg",
}
"""What each example's output holds."""


def test_every_example_is_tried() -> None:
    assert {path.name for path in (ROOT / "examples").glob("*.py")} == PRINTED.keys()


@pytest.mark.parametrize("name", PRINTED)
def test_an_example_runs_as_its_first_lines_say(name: str, tmp_path: Path) -> None:
    example = ROOT / "examples" / name
    assert f"`python examples/{name}`" in example.read_text(encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-W", "error", str(example)], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert PRINTED[name] in done.stdout
    for drawing in tmp_path.glob("*.svg"):
        assert ET.parse(drawing).getroot().tag == "{http://www.w3.org/2000/svg}svg"  # noqa: S314 - our own file
