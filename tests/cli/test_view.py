"""The commands that show: `view`, `watch`, `demo --view`."""

from __future__ import annotations

import builtins
import json
import re
import socket
import subprocess
import sys
import urllib.request
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from candaemon.binding.bind import bind
from candaemon.cli import view, watch
from candaemon.cli.main import main
from candaemon.config.load import load_config
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.errors import InputError
from candaemon.view.character_radar import drawn
from candaemon.view.drive_pictures import pictures_of_log
from candaemon.view.picture import Picture
from tests.support.paths import ROOT
from tests.support.recorded import as_log, highway
from tests.support.viewing import demo_pictures


def errors(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().err


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a short log."""
    path = tmp_path_factory.mktemp("drive") / "drive.log"
    binding = bind(load_config(ROOT / "config" / "esr_ins.yaml"))
    path.write_bytes(as_log(binding, highway(binding, 1.0)))
    return path


def test_a_log_is_served_and_ends_in_time(log: Path) -> None:
    command = [sys.executable, "-m", "candaemon", "view", "esr_ins", str(log), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        with urllib.request.urlopen(url, timeout=20) as answer:  # noqa: S310 - it is our own
            assert b'<table id="obstacles">' in answer.read()
        process.terminate()
        assert process.wait(20) == 128 + 15
        assert process.stderr is not None
        assert "Traceback" not in process.stderr.read()


def test_view_ends_after_its_duration(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "esr_ins", str(log), "--port", "0", "--duration", "0.01"]) == 0
    assert capsys.readouterr().out.startswith("http://127.0.0.1:")


@pytest.mark.parametrize(("option", "value"), [("--map", "can1=radar"), ("--speed", "3")])
def test_what_is_for_a_log_is_refused_for_live_buses(
    option: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", "esr_ins", option, value, "--port", "0", "--duration", "0.01"]) == 2
    assert f"{option} is for a log; name one, or leave it out" in errors(capsys)


def test_the_demo_can_be_looked_at(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert main(["demo", "--view", "--duration", "1", "--port", "0", "--view-for", "0.01"]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("http://127.0.0.1:")
    assert "no browser of a desktop" in said.err


def test_the_demo_tells_that_its_scenario_is_shorter(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    seen = ["demo", "--view", "--port", "0", "--view-for", "0.01"]
    assert main([*seen, "--duration", "41"]) == 0
    said = capsys.readouterr().err
    assert "warning: --duration: found 41 s, and the scenario ends after 40 s" in said
    assert "40 s of a simulated drive" in said
    assert main(seen) == 0
    said = capsys.readouterr().err
    assert "40 s of a simulated drive" in said
    assert "warning" not in said


def test_a_log_that_is_not_there_is_said_before_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "esr_ins", str(tmp_path / "none.log"), "--port", "0"]) == 1
    assert "none.log" in errors(capsys)


def test_a_log_without_a_usable_frame_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "other.log"
    path.write_text("(1.0) can9 123#00\n", encoding="utf-8")
    assert main(["view", "esr_ins", str(path), "--port", "0"]) == 1
    assert "other.log" in errors(capsys)


def test_a_port_that_is_taken_is_said(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main(["view", "esr_ins", str(log), "--port", str(taken.getsockname()[1])]) == 1
    assert "see --address and --port" in errors(capsys)


def test_virtual_buses_cannot_be_looked_at(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "demo", "--port", "0"]) == 2
    assert "candaemon demo --view" in errors(capsys)


def test_another_address_needs_a_token(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "esr_ins", "--address", "0.0.0.0"]) == 2  # noqa: S104 - that is refused
    said = errors(capsys)
    suggested = said.partition("such as --token ")[2].partition(",")[0]
    assert view.token(suggested) == suggested


@pytest.mark.parametrize(("length", "good"), [(15, False), (16, True), (200, True), (201, False)])
def test_a_token_has_a_length(length: int, good: bool, capsys: pytest.CaptureFixture[str]) -> None:
    text = "a" * length
    assert (view.SHORTEST_TOKEN <= length <= view.LONGEST_TOKEN) == good
    with pytest.raises(SystemExit) as stop:
        main(["view", "esr_ins", "--token", text, *([] if not good else ["--help"])])
    assert stop.value.code == (0 if good else 2)
    assert text not in errors(capsys)


@pytest.mark.parametrize(
    ("words", "good"),
    [
        (["view", "esr_ins", "--port", "65535"], True),
        (["view", "esr_ins", "--port", "65536"], False),
        (["view", "esr_ins", "--duration", "86400"], True),
        (["view", "esr_ins", "--duration", "86401"], False),
        (["watch", "esr_ins", "--duration", "86400"], True),
        (["watch", "esr_ins", "--duration", "86401"], False),
        (["watch", "esr_ins", "--ahead", "1000"], True),
        (["watch", "esr_ins", "--ahead", "1001"], False),
    ],
)
def test_arguments_have_limits(words: list[str], good: bool, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([*words, "--help"] if good else words)
    assert stop.value.code == (0 if good else 2)
    capsys.readouterr()


def test_without_the_extra_it_says_which(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    whole = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name.partition(".")[0] == "aiohttp":
            raise ImportError(name)
        return whole(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    for words in (["view", "esr_ins"], ["demo", "--view"]):
        assert main(words) == 2
        assert errors(capsys).splitlines() == [
            "candaemon: error: the page needs an extra: pip install 'candaemon[view]'"
        ]


def test_watch_needs_no_extra() -> None:
    code = "import sys, candaemon.cli.watch; print('aiohttp' in sys.modules, 'rich' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]


def test_a_pipe_gets_lines(capsys: pytest.CaptureFixture[str]) -> None:
    watch.print_lines(demo_pictures())
    lines = capsys.readouterr().out.splitlines()
    confirmed = {
        int(i)
        for picture in demo_pictures()
        for i, s in zip(picture.columns["id"], picture.columns["state"], strict=True)
        if s
    }
    came = [int(line.split()[2]) for line in lines if " came " in line]
    assert set(came) == confirmed
    last = [line for line in lines if " came " not in line and " gone" not in line][-1]
    assert "confirmed x=" in last
    assert "speed=" in last


def test_characters_lie_where_obstacles_are() -> None:
    picture = demo_pictures()[-1]
    lines = drawn(picture, 81, 40, ahead=100.0)
    assert len(lines) == 40
    assert all(len(line) <= 81 for line in lines)
    metres = (100 + 100 / 6) / 39
    assert lines[round(100 / metres)][40] == "^"
    found = 0
    for x, y, identity in zip(*(picture.columns[name].tolist() for name in ("x", "y", "id")), strict=True):
        row, column = round(100 / metres) - round(x / metres), 40 - round(y / metres * 2)
        if 0 <= row < 40 and 0 <= column < 78:
            found += lines[row][column:].lstrip("?o~").startswith(str(identity))
    assert found >= 2


def obstacles(*told: tuple[int, float, float], heard: bool = False, time_ns: int = 0) -> Picture:
    """Return a picture of confirmed cars, each told by id, x and y."""
    pose = EgoPose(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, EgoStatus.VALID)
    count = len(told)
    columns = {
        **dict(zip(("id", "x", "y"), map(np.array, zip(*told, strict=True)), strict=True)),
        "vx": np.full(count, -12.3), "vy": np.full(count, -1.0),
        "state": np.ones(count, int), "class": np.ones(count, int),
    }  # fmt: skip
    return Picture(time_ns, pose, columns, np.empty((count, 0)), heard=heard)


@pytest.mark.parametrize(
    "told",
    [
        ((17, 60.5, 0.0), (3, 60.0, 0.0)),
        ((117, 60.5, 0.0), (3, 60.0, 0.0)),
        ((12, 60.0, 0.0), (9, 59.9, 0.0)),
        ((21, 60.0, 6.0), (18, 60.0, 0.0)),
        ((11, 60.0, -48.0), (12, 60.0, -44.0)),
        ((6, 60.0, 48.0), (1, 80.0, 46.0)),
    ],
)
def test_no_id_is_drawn_that_no_obstacle_has(told: tuple[tuple[int, float, float], ...]) -> None:
    lines = drawn(obstacles(*told), 48, 30)
    found = re.findall(r"o\d*", " ".join(lines))
    assert set(found) <= {"o", *(f"o{identity}" for identity, _, _ in told)}
    assert found


def test_a_place_that_is_no_number_is_not_drawn() -> None:
    picture = demo_pictures()[-1]
    picture = type(picture)(
        picture.time_ns, picture.pose, {**picture.columns, "x": np.full(len(picture), np.nan)}, picture.modes
    )
    assert "^" in "".join(drawn(picture, 60, 20))


@pytest.mark.parametrize("size", [(120, 40), (60, 24), (20, 8)])
def test_a_terminal_of_any_size_is_drawn(size: tuple[int, int]) -> None:
    picture = demo_pictures()[-1]
    screen = Console(width=size[0], height=size[1], record=True, file=StringIO())
    health = next(each.health for each in reversed(demo_pictures()) if each.health)
    screen.print(watch.layout(picture, health, size, 100.0))
    text = screen.export_text()
    assert "obstacles" in text
    assert "^" in text
    if size[0] >= 60:
        assert "front 2" in text  # 20 scans/s or so


@pytest.mark.parametrize("columns", [20, 40, 46, 54, 60, 100, 108, 160])
def test_watch_shows_every_number_whole(columns: int) -> None:
    picture = obstacles(*((100 + k, 80.5 + k, -40.5 - k) for k in range(6)))
    screen = Console(width=columns, height=30, record=True, file=StringIO())
    screen.print(watch.layout(picture, {"sensors": {"front": {"rate": 20.0}}}, (columns, 30), 100.0))
    lines = screen.export_text().splitlines()
    assert len(lines) <= 30
    assert max(map(len, lines)) <= columns
    for k in range(6):
        (row,) = [line.split() for line in lines if f"{80.5 + k:.1f}" in line]
        assert {str(100 + k), f"{-40.5 - k:.1f}"} <= set(row)
        assert ({"-12.3", "-1.0"} <= set(row)) == (columns >= 40)
        assert ("confirmed" in row) == (columns >= 54)


def test_a_pipe_is_told_where_obstacles_are_from(capsys: pytest.CaptureFixture[str]) -> None:
    second = 1_000_000_000
    watch.print_lines(
        [obstacles((7, 50.0, 0.0), heard=True, time_ns=second), obstacles((7, 120.0, 0.0), time_ns=2 * second)]
    )
    lines = capsys.readouterr().out.splitlines()
    assert [" ".join(line.split()[:5]) for line in lines] == [
        "1.000 obstacles from the bus", "1.000 obstacle 7 came confirmed", "1.000 obstacle 7 confirmed x=50.00",
        "2.000 obstacles tracked here", "2.000 obstacle 7 came confirmed", "2.000 obstacle 7 confirmed x=120.00",
    ]  # fmt: skip


def test_encoded_pictures_are_small() -> None:
    picture = max(demo_pictures(), key=len)
    assert len(picture.encoded()) < 400 * len(picture) + 4000
    json.loads(picture.encoded())


def test_a_log_without_own_motion_is_told(log: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    of = bind(load_config(ROOT / "config" / "esr_ins.yaml"))
    (ins,) = (bus.settings.channel for bus in of.buses if bus.name == "ins")
    blind, lines = tmp_path / "blind.log", log.read_text(encoding="ascii").splitlines(keepends=True)
    blind.write_text("".join(line for line in lines if line.split()[1] != ins), encoding="ascii")
    pictures = pictures_of_log(of, [blind])
    with pytest.raises(InputError, match=r"own motion was not known in any of .*; nothing can be shown"):
        list(pictures)
    assert "own motion was never known" in caplog.text
