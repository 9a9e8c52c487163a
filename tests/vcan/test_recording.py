"""A recorded drive played onto real interfaces: the service's own recording replays to the bytes that went out."""

from __future__ import annotations

import gzip
import signal
from itertools import takewhile
from pathlib import Path
from typing import Any

import pytest

from candaemon.binding.bind import bind
from candaemon.config.load import load_config
from candaemon.playback.recording_files import logs_in
from tests.beds.can_utils import candump, canplayer, cansend
from tests.beds.fixtures import Start
from tests.beds.links import Link
from tests.beds.service import config_on
from tests.beds.waiting import wait_until
from tests.support.paths import DATA
from tests.support.recorded import replayed

SECONDS = 20.0


@pytest.fixture
def first_seconds(tmp_path: Path) -> Path:
    """Return the first 20 s of the recorded drive, or skip."""
    whole = DATA / "rav4_drive" / "drive.log.gz"
    if not whole.is_file():
        pytest.skip(f"the recorded drive is not at {whole}")
    with gzip.open(whole, "rt", encoding="ascii") as lines:
        first = next(lines)
        end = _time(first) + SECONDS
        text = [first, *takewhile(lambda line: _time(line) < end, lines)]
    path = tmp_path / "drive.log"
    path.write_text("".join(text), encoding="ascii")
    return path


def _time(line: str) -> float:
    return float(line[1 : line.index(")")])


def told(log: bytes) -> list[str]:
    return [line.split()[2] for line in log.decode().splitlines()]


def test_what_went_out_is_what_the_recording_replays_to(
    vcan0: Link, vcan1: Link, vcan2: Link, first_seconds: Path, tmp_path: Path, start: Start
) -> None:
    def short_files(settings: dict[str, Any]) -> None:
        settings["service"] = {"recording": {"file_seconds": 5.0, "events": {"after": 2.0, "faults": []}}}

    channels = {"car": vcan0.name, "radar": vcan1.name, "obstacles": vcan2.name}
    config, folder = config_on("toyota_rav4", tmp_path, channels, short_files), tmp_path / "ring"
    with candump(tmp_path / "heard.log", vcan2.name) as capture:
        service = start(config, "--record", str(folder), "--status", "1")
        service.wait_for("frames/s")
        canplayer(first_seconds, {"can0": vcan0.name, "can1": vcan1.name})
        service.signal(signal.SIGUSR1)
        wait_until((folder / "events").is_dir, 60.0, "an event")
        assert service.stop()[0] == 0
        of = bind(load_config(config))
        expected = told(replayed(of, folder))
        heard = [line.frame for line in capture.wait_for(len(expected))]
    assert len(heard) > 2000  # what a machine under load lost before the service took it is in neither
    assert heard == expected
    logs = logs_in(folder)
    assert len(logs) >= 4
    # each file goes on from what was known at its beginning
    assert [frame for log in logs for frame in told(replayed(of, log))] == heard
    (event,) = (folder / "events").iterdir()
    marked = told(replayed(of, event))
    assert marked == heard[len(heard) - len(marked) :]


def test_a_recording_begins_before_the_first_frame_and_survives_a_kill(
    vcan0: Link, vcan1: Link, vcan2: Link, tmp_path: Path, start: Start
) -> None:
    channels = {"car": vcan0.name, "radar": vcan1.name, "obstacles": vcan2.name}
    config, folder = config_on("toyota_rav4", tmp_path, channels), tmp_path / "ring"
    service = start(config, "--record", str(folder), "--status", "1")
    wait_until(lambda: bool(logs_in(folder)), 60.0, "a recording")
    (log,) = logs_in(folder)
    cansend(vcan1.name, "210#0011223344556677")
    wait_until(lambda: b" vcan1 210#0011223344556677\n" in log.read_bytes(), 60.0, "the frame on the disk")
    service.signal(signal.SIGKILL)
    service.process.wait(30.0)
    lines = log.read_bytes().splitlines()
    assert lines[0].endswith(b" tick 000#")
    assert not lines[-1].endswith(b" tick 001#")
