"""What the README says is so: its two commands, its ten lines, its figures."""

from __future__ import annotations

import re
import shutil
import stat
import subprocess
import tomllib
from pathlib import Path

import pytest

from candaemon.cli.main import main
from tests.playback.test_recorded_drive import PREDICTED
from tests.support.paths import ROOT

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


def test_the_first_two_blocks_are_the_two_commands() -> None:
    (first_kind, first), (second_kind, second) = BLOCKS[:2]
    assert first_kind == second_kind == "sh"
    for block in (first, second):
        assert block.count("\n") == 1
        assert block.startswith("python3 -m venv .venv && .venv/bin/pip install ")
        subprocess.run(["bash", "-n", "-c", block], check=True)
    assert first.endswith(".venv/bin/candaemon demo\n")
    assert ".venv/bin/python -m pytest" in second


def test_ci_runs_the_second_command_and_every_marker() -> None:
    script = ROOT / ".ci" / "run"
    assert script.stat().st_mode & stat.S_IXUSR
    subprocess.run(["bash", "-n", str(script)], check=True)
    text = script.read_text(encoding="utf-8")
    assert BLOCKS[1][1] in text
    markers = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]["ini_options"][
        "markers"
    ]
    selected = set(re.findall(r"\w+", " ".join(re.findall(r'-m ("[^"]*"|bed|benchmark)', text))))
    assert {marker.partition(":")[0] for marker in markers} <= selected
    for tool in ("ruff check", "ruff format --check", "mypy", "mkdocs build"):
        assert tool in text


def test_what_the_two_commands_install_exists() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "'.[dev]'" in BLOCKS[1][1]
    dev = " ".join(project["optional-dependencies"]["dev"])
    for tool in ("pytest", "pytest-xdist", "hypothesis", "ruff", "mypy"):
        assert tool in dev
    assert project["scripts"]["candaemon"] == "candaemon.cli.main:main"


def test_the_ten_lines_are_a_radar(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (yaml,) = [block for kind, block in BLOCKS if kind == "yaml"]
    assert yaml.count("\n") == 10
    path = tmp_path / "my_car.yaml"
    path.write_text(yaml, encoding="utf-8")
    for name in ("car", "radar"):
        shutil.copy(ROOT / "dbc" / f"toyota_rav4_{name}.dbc", tmp_path / f"{name}.dbc")
    assert main(["check", str(path)]) == 0
    assert "-0.04" in capsys.readouterr().out  # the axis turned round
    scenario = tmp_path / "short.yaml"
    scenario.write_text(
        "duration: 2\nego: {start: {speed: 20}}\nactors: [{name: lead, start: {x: 40, y: 0, vx: 20, vy: 0}}]\n",
        encoding="utf-8",
    )
    assert main(["simulate", str(scenario), str(path), "-o", str(tmp_path / "a.log")]) == 0
    capsys.readouterr()
    assert main(["replay", str(path), str(tmp_path / "a.log")]) == 0
    told = dict(line.split(": ", 1) for line in capsys.readouterr().out.splitlines())
    assert int(told["tracks.confirmed"]) >= 1


def test_the_bounds_are_those_that_the_recorded_drive_is_held_to() -> None:
    (table,) = re.findall(r"<!-- figures: accuracy -->\n(.*?)<!-- /figures -->", TEXT, re.DOTALL)
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in table.splitlines()[2:]]
    bounds = [float(row[1].partition(" ")[0]) for row in rows]
    along, across = zip(*(PREDICTED[horizon] for horizon in (0.5, 1.0)), strict=True)
    assert bounds[:4] == [*along, *across]
    for row, bound in zip(rows, bounds, strict=True):
        assert all(float(figure.partition(" ")[0]) <= bound for figure in row[2:]), row


def test_the_example_of_ones_own_radar_is_these_ten_lines() -> None:
    (yaml,) = [block for kind, block in BLOCKS if kind == "yaml"]
    assert yaml in (ROOT / "examples" / "own_radar.py").read_text(encoding="utf-8")
