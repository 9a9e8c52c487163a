"""The commands as a user calls them: results, talk, files, exit codes."""

from __future__ import annotations

import gzip
import io
import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from rich.console import Console

from candaemon.cli.demo import LinePrinter, obstacles_table
from candaemon.cli.main import main
from candaemon.config.load import json_schema
from candaemon.output.decoder import DecodedCycle
from candaemon.playback.summary import doubts
from tests.beds.waiting import wait_until
from tests.support.paths import ROOT

CONFIGS = sorted(path.stem for path in (ROOT / "config").glob("*.yaml"))
COMMAND = [sys.executable, "-m", "candaemon"]

pytestmark = pytest.mark.usefixtures("logging_as_it_was")


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a simulated drive of a few seconds: `drive.log` and `truth.csv`."""
    folder = tmp_path_factory.mktemp("drive")
    scenario = (ROOT / "config" / "scenarios" / "highway.yaml").read_text(encoding="utf-8")
    (folder / "short.yaml").write_text(scenario.replace("duration: 40", "duration: 4"), encoding="utf-8")
    made = main(
        simulation(folder / "short.yaml", folder / "drive.log", "--seed", "3", "--truth", str(folder / "truth.csv"))
    )
    assert made == 0
    return folder


def simulation(scenario: Path, log: Path, *options: str) -> list[str]:
    return ["simulate", str(scenario), "esr_ins", "-o", str(log), *options]


def figures(text: str) -> dict[str, str]:
    return dict(line.split(": ", 1) for line in text.splitlines() if ": " in line)


@pytest.mark.parametrize("arguments", [["--help"], ["replay", "--help"], ["--version"]])
def test_help_and_version(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 0
    assert "candaemon" in capsys.readouterr().out


@pytest.mark.parametrize(("in_use", "said"), [(True, "(compiled kernels)"), (False, "without compiled kernels)")])
def test_the_version_says_what_computes(
    in_use: bool, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("candaemon.compiled.in_use", in_use)
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out.strip().endswith(said)


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["fly"],
        ["replay", "demo"],
        ["replay", "demo", "a.log", "--speed", "0"],
        ["replay", "demo", "a.log", "--speed", "nan"],
        ["replay", "demo", "a.log", "--horizons", "0.5,x"],
        ["replay", "demo", "a.log", "--map", "can1"],
        ["simulate", "highway", "demo"],
    ],
)
def test_wrong_usage_is_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("name", CONFIGS)
def test_check_passes_our_configurations(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", name]) == 0
    told = capsys.readouterr()
    assert "load in" in told.out
    assert told.err == ""


def test_check_tells_all_there_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(ROOT / "config" / "demo.yaml")]) == 0
    out = capsys.readouterr().out
    for words in (
        "interface", "output adds", "OBSTACLE_00_A … OBSTACLE_31_A", "Target1 … Target64", "0x500 … 0x53F",
        "by counter CAN_TX_TRACK_ROLLING_COUNT", "IMM of a vehicle's motion", "-0.00174533",
        "crc8_sae_j1850", "warnings",
    ):  # fmt: skip
        assert words in out


def test_check_names_the_filter_along_the_line_of_sight(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (ROOT / "config" / "demo.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    tree = yaml.safe_load(text) | {"tracker": {"estimator": {"kind": "mlkf"}}}
    path = tmp_path / "mlkf.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    assert main(["check", str(path)]) == 0
    assert "modified linear Kalman filter along the line of sight" in capsys.readouterr().out


def test_check_lists_every_error_with_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (ROOT / "config" / "demo.yaml").read_text(encoding="utf-8")
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace("cycle_time: 0.05", "cycle_tim: fast").replace("range: 0.25", "range: much"))
    assert main(["check", str(path)]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count(f"{path}:") == 3
    assert "cycle_tim" in told.err
    assert "Traceback" not in told.err


def test_a_configuration_that_is_not_there_names_ours(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "nosuch"]) == 2
    assert "toyota_rav4_ins" in capsys.readouterr().err
    assert main(["simulate", "nosuch", "demo", "-o", "x.log"]) == 2
    assert "highway" in capsys.readouterr().err


def test_simulate_replay_evaluate(short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written = []
    for run in ("a", "b"):
        out, tracks, predictions, summary = (
            tmp_path / f"{run}{name}" for name in ("o.log", "t.csv", "p.csv", "s.json")
        )
        files = ["-o", str(out), "--tracks", str(tracks), "--predictions", str(predictions), "--summary", str(summary)]
        assert main(["replay", "esr_ins", str(short / "drive.log"), *files, "--horizons", "1.0,0.25"]) == 0
        written.append([path.read_bytes() for path in (out, tracks, predictions, summary)])
    assert written[0] == written[1]
    told = figures(capsys.readouterr().out)
    stored = json.loads(summary.read_text(encoding="utf-8"))
    assert stored["cycles"]["told"] == 80
    assert told["cycles.told"] == "80"
    assert [row["horizon"] for row in stored["predictions"]] == [0.25, 1.0]
    assert main(["evaluate", str(tracks), str(short / "truth.csv"), "--json", str(tmp_path / "e.json")]) == 0
    judged = json.loads((tmp_path / "e.json").read_text(encoding="utf-8"))
    assert judged["errors"]["position"] < 0.6
    assert judged["time_to_confirm"]["unconfirmed"] == 0
    assert "GOSPA" in capsys.readouterr().out


def test_a_truncated_log_is_used_as_far_as_it_goes(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    packed = gzip.compress((short / "drive.log").read_bytes())
    log, tracks = tmp_path / "cut.log.gz", tmp_path / "t.csv"
    log.write_bytes(packed[: len(packed) // 2])
    assert main(["replay", "esr_ins", str(log), "--tracks", str(tracks)]) == 0
    told = capsys.readouterr()
    assert "ends early" in told.err
    assert figures(told.out)["log.truncated"] == "yes"
    assert tracks.read_text(encoding="utf-8").endswith("\n")
    assert 20 < int(figures(told.out)["cycles.told"]) < 60


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not one usable frame"),
        ("no frame at all\n" * 20, "malformed"),
        ("(1.0) can7 123#00\n", "--map"),
        ("(1.0) can1 7FF#00\n", "not one usable frame"),
    ],
)
def test_a_log_without_a_usable_frame_is_1(
    text: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "bad.log"
    log.write_text(text, encoding="utf-8")
    assert main(["replay", "esr_ins", str(log), "-o", str(tmp_path / "o.log")]) == 1
    assert said in capsys.readouterr().err


def test_a_log_without_own_motion_costs_no_result_that_is_there(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, tracks, page = tmp_path / "radar.log", tmp_path / "tracks.csv", tmp_path / "page.html"
    lines = (short / "drive.log").read_text(encoding="utf-8").splitlines(keepends=True)
    log.write_text("".join(line for line in lines if " can2 " not in line), encoding="utf-8")
    tracks.write_text("earlier", encoding="utf-8")
    assert main(["replay", "esr_ins", str(log), "--tracks", str(tracks)]) == 1
    told = capsys.readouterr().err
    assert "own motion was not known in any of" in told
    assert "without it: latitude, longitude, velocity_north" in told
    assert " never came; log channels no bus takes: " in told
    assert "--map" in told
    assert tracks.read_text(encoding="utf-8") == "earlier"
    assert main(["report", "esr_ins", str(log), "-o", str(page)]) == 1
    assert not page.exists()
    assert main(["check", "esr_ins", str(log)]) == 0
    assert "1 warning\n" in (checked := capsys.readouterr().out)
    assert "own motion was never known: lat" in checked[checked.index("1 warning") :]


def test_what_is_left_out_in_bulk_is_told(short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, summary = tmp_path / "drive.log", tmp_path / "summary.json"
    lines = (short / "drive.log").read_text(encoding="utf-8").splitlines(keepends=True)
    first = float(lines[0].split(")")[0][1:])
    kept = (line for line in lines if " can2 " not in line or float(line.split(")")[0][1:]) > first + 2.0)
    log.write_text("".join(kept), encoding="utf-8")
    assert main(["replay", "esr_ins", str(log), "--summary", str(summary)]) == 0
    assert re.search(r"warning: own motion was not known in \d+ of \d+ scans", capsys.readouterr().err)
    kept = (line for line in lines if " can2 " not in line or float(line.split(")")[0][1:]) < first + 2.0)
    log.write_text("".join(kept), encoding="utf-8")
    assert main(["replay", "esr_ins", str(log), "--summary", str(summary)]) == 0
    assert re.search(r"warning: in \d+ of \d+ cycles own motion was dead reckoning", capsys.readouterr().err)
    assert main(["check", "esr_ins", "--log", str(log)]) == 0
    assert re.search(r"ego: for \d+ of \d+ cycles no velocity of the vehicle came", capsys.readouterr().out)
    assert main(["replay", "esr_ins", str(short / "drive.log"), "--summary", str(summary)]) == 0
    assert "warning" not in capsys.readouterr().err
    figures = json.loads(summary.read_text(encoding="utf-8"))
    assert doubts(figures) == []
    figures["sensors"]["front"] |= {"used": 900, "surplus": 101, "out_of_range": 99, "impossible": 101}
    figures["own_motion"]["out_of_range"] = taken = max(figures["ego_signals"].values())
    assert doubts(figures) == [
        "sensor 'front': 101 frames of more objects than `slots`, beside 900 frames used",
        "sensor 'front': 101 objects that moved as nothing can; 900 frames were used",
        f"own motion: {taken:,} frames outside of the DBC's ranges, beside {taken:,} taken",
    ]
    figures["sensors"]["front"] |= {"surplus": 0, "out_of_range": 0, "impossible": 0, "late": 2000, "scans": 50}
    figures["sensors"]["front"] |= {"incomplete": 60, "distrusted": 50, "checksum": 200, "duplicate": 1}
    figures["cycles"] |= {"told": 1000, "coasting": 101, "dead_reckoning": 99, "ego_lost": 900}
    figures["own_motion"] |= {"out_of_range": 0, "jumped": taken}
    assert [each.partition(":")[0] or each for each in doubts(figures)] == ["sensor 'front'"] * 4 + [
        "own motion",
        "in 101 of 1,000 cycles every sensor was silent",
        "in 900 of 1,000 cycles own motion was lost",
    ]
    assert "60 of 100 scans lacked frames" in " ".join(doubts(figures))
    figures["sensors"]["front"]["used"] = 0
    assert doubts(figures)[0] == "sensor 'front': not one usable frame in this log"


def test_fd_frames_on_a_bus_without_fd_are_told(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, config = (short / "drive.log").read_text(encoding="utf-8"), tmp_path / "mine.yaml"
    log, summary = tmp_path / "drive.log", tmp_path / "summary.json"
    number = len(re.findall(r" can1 [0-9A-F]+#", text))
    log.write_text(re.sub(r"( can1 [0-9A-F]+#)", r"\1#0", text), encoding="utf-8")
    assert main(["replay", "esr_ins", str(log), "--summary", str(summary)]) == 0
    cure = f"bus 'radar': {number:,} CAN FD frames, which `run` would not read; give buses.radar fd: true"
    assert f"warning: {cure}" in capsys.readouterr().err
    buses = json.loads(summary.read_text(encoding="utf-8"))["buses"]
    assert [buses[name]["fd_unset"] for name in ("radar", "ins")] == [number, 0]
    assert main(["check", "esr_ins", str(log)]) == 0
    assert cure in capsys.readouterr().out
    shipped = (ROOT / "config" / "esr_ins.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    config.write_text(shipped, encoding="utf-8")
    assert main(["check", str(config), "--log", str(log)]) == 0
    assert re.search(r"mine\.yaml:5 +buses\.radar\.fd: [\d,]+ CAN FD frames came", capsys.readouterr().out)
    config.write_text(shipped.replace("channel: can1", "channel: can1, fd: true"), encoding="utf-8")
    assert main(["check", str(config), str(log), "--log", str(log)]) == 0
    assert "CAN FD frames" not in capsys.readouterr().out


def test_files_that_are_not_there_or_cannot_be_written(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, nowhere = str(short / "drive.log"), str(tmp_path / "no" / "x.log")
    assert main(["replay", "esr_ins", nowhere]) == 1
    assert main(["replay", "esr_ins", drive, "-o", nowhere]) == 1
    assert main(["replay", "esr_ins", drive, "--summary", nowhere]) == 1
    assert main(["simulate", "highway", "esr_ins", "-o", nowhere]) == 1
    assert main(["evaluate", nowhere, nowhere]) == 1
    assert capsys.readouterr().err.count("error: ") == 5


def test_map_gives_a_channel_to_a_bus(short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "renamed.log"
    log.write_text((short / "drive.log").read_text(encoding="utf-8").replace(" can1 ", " front "), encoding="utf-8")
    assert main(["replay", "esr_ins", str(log)]) == 1
    assert figures(capsys.readouterr().out)["tracks.detections"] == "0"
    assert main(["replay", "esr_ins", str(log), "--map", "front=radar"]) == 0
    assert figures(capsys.readouterr().out)["cycles.told"] == "80"
    assert main(["replay", "esr_ins", str(log), "--map", "front=rader"]) == 2
    assert "expected one of" in capsys.readouterr().err


def test_scores_that_cost_time_are_made_only_where_asked_for(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, outputs, printed = str(short / "drive.log"), [tmp_path / "brief.log", tmp_path / "scored.log"], []
    for output, asked in zip(outputs, ([], ["--summary", str(tmp_path / "s.json")]), strict=True):
        assert main(["replay", "esr_ins", log, "-o", str(output), *asked]) == 0
        printed.append(set(capsys.readouterr().out.splitlines()))
    brief, scored = printed
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    assert brief < scored
    assert {line.partition(".")[0] for line in scored - brief} == {"predictions", "stationary", "duplicates"}


def test_speed_holds_a_replay_back(short: Path) -> None:
    started = time.monotonic()
    assert main(["replay", "esr_ins", str(short / "drive.log"), "--speed", "4"]) == 0
    assert 0.9 < time.monotonic() - started < 8.0


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_replay_keeps_what_it_has(short: Path, tmp_path: Path, ending: signal.Signals) -> None:
    tracks, part = tmp_path / "t.csv", tmp_path / "t.csv.part"
    tracks.write_text("former\n", encoding="utf-8")
    arguments = ["replay", "esr_ins", str(short / "drive.log"), "--tracks", str(tracks), "--speed", "0.5"]

    def heed() -> None:  # what runs the tests may ignore SIGINT, and so would the process
        signal.signal(ending, signal.SIG_DFL)

    command = [*COMMAND, *arguments]
    with subprocess.Popen(command, stderr=subprocess.PIPE, preexec_fn=heed) as process:  # noqa: PLW1509 - no threads here
        # Not before it has rows: an interrupt while libraries are still being imported is none of a replay.
        wait_until(lambda: part.exists() and part.read_bytes().count(b"\n") > 5, 60, "rows")
        process.send_signal(ending)
        assert process.wait(10) == 128 + ending
        assert process.stderr is not None
        said = process.stderr.read().decode()
    assert said.count("\n") == 1
    assert f"ended by {ending.name}; what was written until then is in {part}" in said
    rows = part.read_text(encoding="utf-8")
    assert rows.count("\n") > 5
    assert rows.endswith("\n")
    assert tracks.read_text(encoding="utf-8") == "former\n"


def test_a_reader_that_goes_away_is_no_failure() -> None:
    with subprocess.Popen([*COMMAND, "schema"], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(30) == 0


def test_schema_is_that_of_the_settings(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == json_schema()


def test_demo_is_the_same_at_any_speed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--duration", "3"]) == 0
    fast = capsys.readouterr().out
    assert main(["demo", "--duration", "3", "--speed", "3"]) == 0
    assert capsys.readouterr().out == fast
    assert "confirmed at" in fast
    assert "errors (RMSE" in fast


def test_demo_tells_the_speed_of_who_crosses(capsys: pytest.CaptureFixture[str]) -> None:
    told = {"id": 4.0, "state": 2.0, "x": 20.0, "y": -3.0, "vx": 0.0, "vy": 9.0, "ax": 0.0, "age": 12.5}
    cycle = DecodedCycle(0, 0, {name: np.array([value]) for name, value in told.items()})
    with LinePrinter() as printer:
        printer.cycle(cycle)
    assert "(20.0, -3.0) m 9.0 m/s" in capsys.readouterr().out
    for columns in (80, 40):
        screen = Console(width=columns, record=True, file=io.StringIO())
        screen.print(obstacles_table(cycle, 1.0))
        assert re.search(r"age.*12\.5", screen.export_text(), re.DOTALL)


def test_demo_draws_on_a_terminal() -> None:
    terminal, side = pty.openpty()
    with subprocess.Popen(
        [*COMMAND, "demo", "--duration", "2", "--speed", "4"],
        stdout=side, stderr=subprocess.PIPE, env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "120"},
    ) as process:  # fmt: skip
        os.close(side)
        seen = bytearray()
        while True:
            try:
                piece = os.read(terminal, 65536)
            except OSError:  # what a terminal without another side gives
                break
            if not piece:
                break
            seen += piece
        assert process.wait(30) == 0
    os.close(terminal)
    assert b"x ahead" in seen
    assert "│".encode() in seen


def test_an_installed_candaemon_finds_its_configurations(tmp_path: Path) -> None:
    pytest.importorskip("hatchling", reason="a wheel is built with hatchling")
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "--wheel-dir", str(tmp_path), str(ROOT)], check=True, capture_output=True)
    wheel = next(tmp_path.glob("*.whl"))
    place = tmp_path / "place"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(place)
    done = subprocess.run(
        [*COMMAND, "check", "toyota_rav4"],
        cwd=place, env={**os.environ, "PYTHONPATH": str(place)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert str(place / "candaemon" / "share" / "config" / "toyota_rav4.yaml") in done.stdout


def test_check_tells_short_frames_that_nothing_asks_for_from_those_that_are_missed(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, log = (short / "drive.log").read_text(encoding="utf-8"), tmp_path / "drive.log"
    own = next(line for line in whole.splitlines() if " 603#" in line)
    before, _, payload = own.partition("#")
    lines = [f"{before}#{payload[:8]}", *(f"{before.removesuffix('603')}604#00" for _ in range(2))]
    log.write_text("\n".join([*lines, whole]), encoding="utf-8")
    assert main(["check", "esr_ins", str(log)]) == 0
    out = capsys.readouterr().out
    header = r"frames +used +not asked for +of them short +in no DBC +too short for own motion"
    assert re.search(header, out)
    assert re.search(r"\n  ins +1727 +1724 +0 +0 +2 +1 +0\n", out), out


def test_check_says_what_came_of_own_motion(short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "esr_ins", str(short / "drive.log")]) == 0
    out = capsys.readouterr().out
    came = out[out.index("own motion in the log") : out.index("warnings")]
    assert re.search(r"curvature +TrackSlipCurvature.Curvature +[1-9]\d+ +100", came)
    assert re.search(r"yaw rate from curvature +[1-9]", came)
    assert out.index("yaw rate  ") < out.index("own motion in the log")
    assert main(["check", "esr_ins", "nosuch.log"]) == 1
