"""`candaemon status`: beside a service that runs, and where none does."""

from __future__ import annotations

import io
import json
import math
import os
import pty
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread
from typing import Any

import pytest
from rich.console import Console

from candaemon.cli.status import LiveView, sheets, watch
from candaemon.config.metrics import MetricsSettings
from candaemon.errors import InputError
from candaemon.status import status_client
from candaemon.status.service_monitor import ServiceMonitor
from candaemon.status.socket_paths import is_listening
from tests.support.memory import PEAK_MIB
from tests.support.served import Served, bound, demo_config, drive, wait_until


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of the instances that this user runs."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    return tmp_path / "run" / "candaemon"


@contextmanager
def service(config: Path, home: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a service until it can be asked."""
    command = [sys.executable, "-m", "candaemon", "run", "--status", "0", str(config)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            wait_until(lambda: is_listening(home / config.stem / "status.sock"), 20.0)
            yield process
        finally:
            process.kill()


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    whole = [sys.executable, "-m", "candaemon", "status", *arguments]
    return subprocess.run(whole, capture_output=True, text=True, timeout=20, check=False)


def test_on_a_terminal_it_lives_until_the_service_ends(tmp_path: Path, home: Path) -> None:
    with service(demo_config(tmp_path), home) as process:
        ours, theirs = pty.openpty()
        with os.fdopen(ours, "rb", buffering=0) as screen:
            watching = subprocess.Popen(
                [sys.executable, "-m", "candaemon", "status", "mine"],
                stdout=theirs,
                stderr=subprocess.PIPE,
                text=True,
                env=os.environ | {"TERM": "xterm", "COLUMNS": "160"},
            )
            os.close(theirs)
            with watching:
                drawn = b""
                while drawn.count(b"Demo") < 2:
                    drawn += screen.read(4096)
                process.send_signal(signal.SIGTERM)
                with suppress(OSError):  # the terminal ends with its last user
                    while screen.read(4096):
                        pass
                _, said = watching.communicate(timeout=10)
    assert watching.returncode == 1
    assert "the instance has ended" in said
    assert "Traceback" not in said


def test_an_instance_with_too_many_clients_is_no_success(tmp_path: Path) -> None:
    path = tmp_path / "busy.sock"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(str(path))
        listener.listen()

        def refuse() -> None:
            client, _ = listener.accept()
            with client:
                client.sendall(b'{"error":"8 clients are served already"}\n')

        thread = Thread(target=refuse)
        thread.start()
        with pytest.raises(InputError, match="no figures came: 8 clients are served already"):
            watch(None, path, once=True, as_json=True)
        thread.join(5.0)


def test_beside_a_service_that_runs(tmp_path: Path, home: Path) -> None:
    with service(demo_config(tmp_path), home) as process:
        plain = command("--once")
        named = command("mine", "--json")
        placed = command("--socket", str(home / "mine" / "status.sock"))
        other = command("yours")
        process.send_signal(signal.SIGTERM)
        assert process.wait(5.0) == 0
    assert [each.returncode for each in (plain, named, placed)] == [0, 0, 0], plain.stderr
    assert plain.stdout.startswith("Demo\n")
    assert re.search(r"^  radar +up +0 ", plain.stdout, re.MULTILINE)
    assert re.search(r"^  front +lost ", plain.stdout, re.MULTILINE)
    assert json.loads(named.stdout)["service"]["pid"] == process.pid
    assert "sensors" in placed.stdout
    assert other.returncode == 1
    assert "no instance 'yours' runs; running: mine; start" in other.stderr


def test_a_killed_service_is_not_running_and_the_next_takes_its_place(tmp_path: Path, home: Path) -> None:
    config = demo_config(tmp_path)
    with service(config, home) as process:
        process.kill()
        process.wait(5.0)
    assert (home / "mine" / "status.sock").is_socket()
    gone = command()
    assert gone.returncode == 1
    assert "no instance runs; start one with `systemctl start candaemon@NAME`" in gone.stderr
    with service(config, home):
        assert command("--once").returncode == 0


@contextmanager
def saying(path: Path, *lines: bytes) -> Iterator[Path]:
    """Play an instance that sends lines and ends."""

    def play() -> None:
        client, _ = listener.accept()
        with client:
            client.sendall(b"".join(lines))

    path.parent.mkdir(parents=True, exist_ok=True)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        thread = Thread(target=play)
        thread.start()
        yield path
        thread.join(5.0)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (b"", "has ended"),
        (b'{"error": "8 clients are served already"}\n', "no figures came: 8 clients are served already"),
        (b"[1]\n", "no status socket of candaemon"),
        (b"HTTP/1.1 400\n", "found 'HTTP/1.1 400', expected the figures"),
        (b"[" * 100_000 + b"\n", "found '[[[["),
        (b"\x1b[2J\xff\n", r"found '\x1b[2J"),
        (b'{"error": "\\u001b[2J"}\n', r"no figures came: \x1b[2J"),
    ],
)
def test_what_is_no_status_is_said(line: bytes, said: str, tmp_path: Path) -> None:
    with saying(tmp_path / "s", line) as path, pytest.raises(InputError, match=re.escape(said)):
        watch(None, path, once=True, as_json=False)


def test_a_socket_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.sock: cannot connect: No such file"):
        watch(None, tmp_path / "nothing.sock", once=True, as_json=False)


def test_an_instance_that_hangs_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("candaemon.status.status_client.LINE_S", 0.1)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "s"))
        listener.listen()
        with pytest.raises(InputError, match="its core loop hangs"):
            watch(None, tmp_path / "s", once=True, as_json=False)


@contextmanager
def sending(path: Path, chunk: bytes, pause_s: float = 0.0) -> Iterator[Path]:
    """Have a socket that sends the same to whoever connects, over and over."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()

        def send() -> None:
            connection, _ = listener.accept()
            with connection, suppress(OSError):
                while True:
                    connection.sendall(chunk)
                    time.sleep(pause_s)

        thread = Thread(target=send)
        thread.start()
        yield path
        thread.join(10.0)
        assert not thread.is_alive()


def test_a_socket_that_sends_without_end_takes_little_memory_and_time(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom candaemon.cli.main import main\n"
        "try: status = main()\nexcept SystemExit as end: status = end.code\n"
        f"print({PEAK_MIB})\nsys.exit(status)"
    )
    with sending(tmp_path / "s", bytes(1 << 16).replace(b"\0", b"x")) as path:
        arguments = [sys.executable, "-c", code, "status", "--socket", str(path)]
        done = subprocess.run(arguments, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "found a line of more than 4 MiB, expected the status socket" in done.stderr
    assert float(done.stdout) < 100  # MiB


def test_a_socket_that_drips_is_given_up_in_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("candaemon.status.status_client.LINE_S", 0.5)
    began_s = time.monotonic()
    with sending(tmp_path / "s", b" ", 0.02) as path, pytest.raises(InputError, match=r"says nothing for 0\.5 s"):
        watch(None, path, once=True, as_json=False)
    assert time.monotonic() - began_s < 20.0


@pytest.mark.parametrize("over", [0, 1])
def test_a_line_as_long_as_its_limit_is_read(over: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = b'{"service":"%s"}' % (b"x" * (status_client.LONGEST_LINE - 14 + over * (1 << 16)))
    with saying(tmp_path / "s", line + b"\n") as path:
        if over:
            with pytest.raises(InputError, match="more than 4 MiB"):
                watch(None, path, once=True, as_json=True)
        else:
            watch(None, path, once=True, as_json=True)
            assert len(capsys.readouterr().out) == len(line) + 1


def test_figures_of_something_else_are_said(figures: dict[str, Any], tmp_path: Path) -> None:
    endless = figures | {"service": figures["service"] | {"uptime": math.inf}}
    figures = figures | {"cycles": {"rate": 20.0}}
    for number, each in enumerate((figures, {"service": 1}, {"service": {"uptime": "long"}}, endless)):
        line = json.dumps(each).encode() + b"\n"
        with (
            saying(tmp_path / f"s{number}", line) as path,
            pytest.raises(InputError, match=rf"s{number}: the figures are not those of candaemon .*--json"),
        ):
            watch(None, path, once=True, as_json=False)


def test_several_instances_are_listed(home: Path) -> None:
    with socket.socket(socket.AF_UNIX) as van, socket.socket(socket.AF_UNIX) as car:
        for name, listener in (("van", van), ("car", car)):
            (home / name).mkdir(parents=True)
            listener.bind(os.fspath(home / name / "status.sock"))
            listener.listen()
        with pytest.raises(InputError, match="several instances run: car, van; name one"):
            watch(None, None, once=True, as_json=False)


@pytest.fixture
def figures(tmp_path: Path) -> dict[str, Any]:
    """Return those of a second of a drive."""
    binding = bound(tmp_path)
    meter = ServiceMonitor(MetricsSettings(), lambda: {"files": 3})
    with Served(binding, [meter]) as served:
        served.feed(drive(binding, 1.0))
        return meter.wait_for_snapshot(5.0).tree()


def test_the_sheets_tell_what_matters(figures: dict[str, Any]) -> None:
    told = {sheet.title: dict(zip(sheet.header, sheet.rows[0], strict=True)) for sheet in sheets(figures)}
    assert set(told) == {"Demo", "obstacles", "times in ms", "buses", "sensors", "recording"}
    assert told["obstacles"]["own motion"] == "valid"
    assert told["sensors"]["state"] == "ok"
    assert told["buses"]["dropped"] == "0"
    assert float(told["times in ms"]["p99"]) > 0.0
    assert told["recording"] == {"files": "3"}


def test_the_sheets_tell_what_is_wrong(figures: dict[str, Any]) -> None:
    figures["buses"]["radar"] |= {"up": False, "error": "no such device", "dropped": {"kernel_lost": 7, "short": 2}}
    figures["buses"]["ins"]["controller"] = "passive"
    figures["clock"]["backward_steps"] = 1
    figures["service"] |= {"refused": 2, "reload_error": "mine.yaml:3: no", "uptime": 90_061.0, "memory": None}
    text = "\n".join(" ".join(row) for sheet in sheets(figures) for row in sheet.rows)
    for said in ("down: no such device", "kernel lost 7, short 2", "up, passive", "mine.yaml:3: no", "1 d 1 h"):
        assert said in text


def test_the_live_view_draws_each_set(figures: dict[str, Any]) -> None:
    page = io.StringIO()
    with LiveView(Console(file=page, force_terminal=True, width=160, height=60)) as view:
        view.show(figures)
        figures["own_motion"]["status"] = "dead reckoning"
        view.show(figures)
    assert "valid" in page.getvalue()
    assert "dead reckoning" in page.getvalue()
    assert "front" in page.getvalue()


@pytest.mark.parametrize(
    ("columns", "rows", "shown"), [(80, 24, True), (160, 60, True), (40, 24, True), (80, 12, False)]
)
def test_the_live_view_of_a_low_terminal_tells_what_matters(
    columns: int, rows: int, shown: bool, figures: dict[str, Any]
) -> None:
    figures["losses"] |= {"late": 1234567}
    page = io.StringIO()
    with LiveView(Console(file=page, force_terminal=True, width=columns, height=rows, color_system=None)) as view:
        view.show(figures)
        lines = [line.rstrip() for line in page.getvalue().splitlines()]
    assert len(lines) <= rows
    assert max(map(len, lines)) <= columns
    text = " ".join(lines)
    assert re.search(r"front +(· state: )?ok", text)
    assert ("1234567" in text) == shown
    assert ("--once shows all" in lines[-1]) == ("yaw deg" not in text and "latency" not in text)


def test_a_dumb_terminal_is_shown_the_figures_once(
    figures: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "dumb")
    with saying(tmp_path / "s", json.dumps(figures).encode() + b"\n") as path:
        watch(None, path, once=False, as_json=False)
    assert "front" in capsys.readouterr().out
