"""Names from outside on a terminal: brackets, colons and escape sequences in them are shown, never obeyed."""

from __future__ import annotations

import json
import os
import pty
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import Final

import pytest

from candaemon.config.metrics import MetricsSettings
from candaemon.daemon.daemon import Daemon
from candaemon.status.service_monitor import ServiceMonitor
from tests.support.paths import ROOT
from tests.support.served import bound

MARKUP: Final = "[/bold][red]:car:"
HOSTILE: Final = "[red]:car:\x1b]0;x\x07\x1b[5m\u202e\n"
SHOWN: Final = r"[red]:car:\x1b]0;x\x07\x1b[5m\u202e\n"
_COLOURS = re.compile(rb"\x1b\[[\d;?]*[A-Za-z]")

_MAIN = """
import json, sys
from candaemon.cli.main import main
for argv in json.loads(sys.argv[1]):
    try:
        main(argv)
    except SystemExit:
        pass
"""


def on_terminal(*commands: Sequence[object]) -> str:
    """Return all that commands write on a wide terminal, without what rich moves the cursor and colours by."""
    ours, theirs = pty.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "400", "LINES": "60", "PYTHONUTF8": "1"}
    line = [sys.executable, "-c", _MAIN, json.dumps([[str(word) for word in command] for command in commands])]
    with subprocess.Popen(line, stdout=theirs, stderr=theirs, env=environment) as process:
        os.close(theirs)
        written = b""
        with os.fdopen(ours, "rb", buffering=0) as screen, suppress(OSError):  # it ends with its last user
            while piece := screen.read(65_536):
                written += piece
        process.wait(30)
    assert b"\x1b]" not in written
    assert b"\x1b[5m" not in written
    text = _COLOURS.sub(b"", written).decode()
    assert "Traceback" not in text, text
    assert all(each.isprintable() for each in text.replace("\r", "").replace("\n", "")), text
    return text


def configuration(folder: Path, name: str = "front.yaml") -> Path:
    """Write a configuration with a DBC that has hostile texts wherever it has any."""
    (folder / "dbc").mkdir(exist_ok=True)
    for each in (ROOT / "dbc").glob("*.dbc"):
        shutil.copy(each, folder / "dbc")
    dbc = folder / "dbc" / "esr.dbc"
    text = dbc.read_text(encoding="utf-8")
    hostile = MARKUP + HOSTILE.replace("\n", "")
    assert '"m/s^2"' in text
    text = text.replace('"m/s^2"', f'"{hostile}"')
    text += f'\nCM_ "{hostile}";\nCM_ BO_ 1280 "{hostile}";\n'
    dbc.write_text(text, encoding="utf-8")
    path = folder / name
    shipped = (ROOT / "config" / "esr_ins.yaml").read_text(encoding="utf-8").replace("../dbc", "dbc")
    shipped = shipped.replace("ax: CAN_TX_TRACK_RANGE_ACCEL", "ax: {signal: CAN_TX_TRACK_RANGE_ACCEL, unit: m/s^2}")
    path.write_text(re.sub(r"(?m)^name:.*$", f"name: '{MARKUP}'", shipped), encoding="utf-8")
    return path


def test_check_shows_them(tmp_path: Path) -> None:
    folder = tmp_path / HOSTILE
    folder.mkdir()
    text = on_terminal(["check", configuration(folder)])
    assert f"{SHOWN}/front.yaml" in text
    assert MARKUP + SHOWN.removesuffix(r"\n") in text  # the unit
    assert f"│ {MARKUP} " in text


def test_simulate_replay_and_evaluate_show_them(tmp_path: Path) -> None:
    config = configuration(tmp_path)
    scenario = (ROOT / "config" / "scenarios" / "highway.yaml").read_text(encoding="utf-8")
    scenario_path = tmp_path / "short.yaml"
    scenario = re.sub(r"duration: \d+", "duration: 1", scenario, count=1)
    scenario_path.write_text(scenario, encoding="utf-8")
    assert "name: lead" in scenario
    (tmp_path / "bad.yaml").write_text(scenario.replace("name: lead", f"name: '{MARKUP}'"), encoding="utf-8")
    log, truth, tracks = (tmp_path / f"{HOSTILE}{suffix}" for suffix in (".log", ".csv", "2.csv"))
    made = on_terminal(["simulate", scenario_path, config, "-o", log, "--truth", truth])
    assert f"{SHOWN}.log" in made.replace("\r\n", "")  # a title is as wide as its table
    with log.open("a", encoding="utf-8") as file:
        file.writelines(f"(1700000001.000000) {MARKUP}\x1b]0;x\x07 123#00\n{HOSTILE}\n" for _ in range(3))
    text = on_terminal(
        ["replay", config, log, "--tracks", tracks],
        ["evaluate", tracks, truth],
        ["evaluate", tracks, tmp_path / HOSTILE],
        ["replay", config, tmp_path / f"no{HOSTILE}.log"],
        ["replay", config, log, "--map", f"a=b{HOSTILE}"],
        ["evaluate", tracks, truth, HOSTILE],
        ["simulate", HOSTILE, config, "-o", log],
        ["simulate", tmp_path / "bad.yaml", config, "-o", log],
    )
    assert rf"{MARKUP}\x1b]0;x\x07 3" in text  # the other channel
    assert "GOSPA" in text
    assert f"actors[0].name: found '{MARKUP}', expected a name of letters" in text
    assert f"unrecognized arguments: {SHOWN}" in text
    assert text.count(SHOWN) >= 6


def test_a_table_with_hostile_ids_is_refused_in_words(tmp_path: Path) -> None:
    table = tmp_path / "tracks.csv"
    columns = "time,id,state,x,y,vx,vy,ax,ay,east,north,ve,vn,sx,sy,svx,svy,age,objects"
    hostile = HOSTILE.replace("\n", "")
    table.write_text(f"{columns}\n0.0,{hostile},confirmed,{',' * 15}\n", encoding="utf-8")
    text = on_terminal(["evaluate", table, table])
    assert SHOWN.removesuffix(r"\n") in text


def test_papers_and_demo_show_what_is_asked_for(tmp_path: Path) -> None:
    text = on_terminal(
        ["papers", HOSTILE],
        ["papers", "--list"],
        ["demo", "--scenario", tmp_path / HOSTILE],
        ["check", tmp_path / HOSTILE],
        ["install-service", tmp_path / HOSTILE],
        ["run", tmp_path / HOSTILE],
        ["status", HOSTILE],
        ["status", "--socket", tmp_path / HOSTILE],
    )
    assert text.count(SHOWN) >= 7
    assert "000-table-1" in text


def _status_of_a_foreign_service(folder: Path) -> Callable[[Path], Thread]:
    """Return what serves, at a socket, the status of a service with hostile names, once."""
    binding = bound(folder)
    monitor, daemon = ServiceMonitor(MetricsSettings()), Daemon(binding)
    monitor.on_start(daemon)
    tree = json.loads(json.dumps(monitor.snapshot(daemon).tree(), allow_nan=False))
    tree["service"] |= {"name": HOSTILE, "config": HOSTILE, "refused": 1, "reload_error": HOSTILE}
    tree["buses"] = {HOSTILE: tree["buses"]["radar"] | {"error": HOSTILE}}
    tree["sensors"] = {HOSTILE: tree["sensors"]["front"]}
    line = json.dumps(tree).encode() + b"\n"

    def serve(path: Path) -> Thread:
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        listener.bind(str(path))
        listener.listen()

        def answer() -> None:
            with listener:
                for _ in range(3):
                    client, _ = listener.accept()
                    with client:
                        client.sendall(line)

        thread = Thread(target=answer, daemon=True)
        thread.start()
        return thread

    return serve


def test_status_shows_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    path = tmp_path / "s"
    thread = _status_of_a_foreign_service(tmp_path)(path)
    text = on_terminal(*(["status", "--socket", path, *how] for how in ([], ["--once"], ["--json"])))
    thread.join(10)
    assert text.count(SHOWN) >= 8
