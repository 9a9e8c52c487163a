"""What the README says is so: its commands run, its YAML is good, its files are there."""

from __future__ import annotations

import re
import shlex
import shutil
import stat
import subprocess
import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from pydantic import TypeAdapter

from candaemon.cli.main import main
from candaemon.config.estimators import EstimatorSettings
from candaemon.config.load import load_config
from tests.beds.waiting import wait_until
from tests.support.paths import ROOT

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


def commands(name: str) -> list[list[str]]:
    """Return the arguments of every `candaemon NAME` in the code blocks."""
    lines = [line for kind, block in BLOCKS if kind == "sh" for line in block.splitlines()]
    return [words[1:] for words in map(shlex.split, lines) if words[:2] == ["candaemon", name]]


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
    for marker in markers:
        assert f"-m {marker.partition(':')[0]}" in text
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


@pytest.mark.slow
def test_simulate_replay_evaluate_run_as_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (simulation,), (judgement,) = commands("simulate"), commands("evaluate")
    (replay,) = [words for words in commands("replay") if "highway.log" in words]
    for words in (simulation, replay, judgement):
        assert main(words) == 0
    assert "GOSPA" in capsys.readouterr().out


@pytest.mark.slow
def test_the_recorded_drive_is_replayed_as_written(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(drive / "drive.log.gz", tmp_path)
    (replay,) = [words for words in commands("replay") if "drive.log.gz" in words]
    assert main(replay) == 0
    assert {"obstacles.log", "tracks.csv", "predictions.csv", "summary.json"} <= {
        path.name for path in tmp_path.iterdir()
    }
    assert "sensors.front.used: 38400" in capsys.readouterr().out


def test_the_service_runs_as_written(tmp_path: Path) -> None:
    (words,) = commands("run")
    where = {"my_car.yaml": str(ROOT / "config" / "demo.yaml"), "/var/tmp/drive": str(tmp_path / "drive")}  # noqa: S108 - to be replaced
    assert where.keys() <= set(words)
    arguments = [where.get(word, word) for word in words]
    with subprocess.Popen(
        [sys.executable, "-m", "candaemon", *arguments], stderr=subprocess.PIPE, text=True
    ) as service:
        assert service.stderr is not None
        assert any("serving" in line for line in service.stderr)
        wait_until(lambda: any((tmp_path / "drive").glob("*.log")), 20, "a file of the ring")
        service.terminate()
        assert service.wait(10) == 0


def test_the_unit_is_shown_as_written(capsys: pytest.CaptureFixture[str]) -> None:
    (words,) = commands("install-service")
    shown = [str(ROOT / "config" / "esr_ins.yaml") if word == "/etc/candaemon/front.yaml" else word for word in words]
    assert shown != words
    assert main(shown) == 0
    assert "Type=notify" in capsys.readouterr().out


def test_papers_run_as_written(capsys: pytest.CaptureFixture[str]) -> None:
    (words,) = commands("papers")
    assert main([*words, "003", "--runs", "2"]) == 0  # all of them and 100 runs take minutes
    assert "CSM" in capsys.readouterr().out


def test_filters_that_are_named_exist() -> None:
    """And all that exist are named."""
    (table,) = [part for part in TEXT.split("\n\n") if part.startswith("| kind | filter |")]
    named = {kind for row in table.splitlines()[2:] for kind in re.findall(r"`(\w+)`", row.split("|")[1])}
    schema = TypeAdapter(EstimatorSettings).json_schema()
    assert named == set(schema["discriminator"]["mapping"])


def test_other_commands_are_known(capsys: pytest.CaptureFixture[str]) -> None:
    named = set(re.findall(r"candaemon ([\w-]+)", " ".join(re.findall(r"`([^`]+)`", TEXT) + [b for _, b in BLOCKS])))
    for name in sorted(named):
        with pytest.raises(SystemExit) as stop:
            main([name, "--help"])
        assert stop.value.code == 0
    capsys.readouterr()


def test_files_that_are_named_exist() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", TEXT):
        assert (ROOT / target).exists(), target
    for path in re.findall(r"`((?:config|dbc|candaemon|tests)/[\w./@]*)`", TEXT):
        assert (ROOT / path).exists(), path


def test_configurations_that_are_named_exist() -> None:
    (paragraph,) = [part for part in TEXT.split("\n\n") if part.startswith("Ready to use")]
    names = list(re.findall(r"`(\w+)`", paragraph))
    assert len(names) >= 7
    for name in names:
        load_config(ROOT / "config" / f"{name}.yaml")


def test_the_image_is_a_picture_for_light_and_dark() -> None:
    path = ROOT / ".github" / "flow.svg"
    root = ET.parse(path).getroot()  # noqa: S314 - our own file
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert "prefers-color-scheme: dark" in path.read_text(encoding="utf-8")


def test_the_return_time_is_the_default() -> None:
    described = TEXT.partition("with a time constant of ")[2].partition(" s")[0]
    assert load_config(ROOT / "config" / "demo.yaml").config.tracker.reflections.return_time == float(described)
