"""A service killed at the worst moments of its recording: all that was complete replays, and it goes on from there."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from candaemon.binding.bound import Binding
from candaemon.config.recording import RecordingSettings
from candaemon.playback.recording_files import logs_in, number_of
from candaemon.recording.recorder import Recorder
from tests.support.bound import binding
from tests.support.paths import ROOT
from tests.support.recorded import as_log, driven, highway, replayed

SECONDS = 1.4

KILLED = """
import os, signal, sys, time
from pathlib import Path
from candaemon.config.recording import RecordingSettings
from candaemon.files.own_folder import OwnFolder
from candaemon.recording.recorder import Recorder
from candaemon.recording.ring import Ring
from tests.support.bound import binding
from tests.support.recorded import driven, highway

moment, folder, seconds = sys.argv[1], Path(sys.argv[2]), float(sys.argv[3])
write, create, append, remove = OwnFolder.write, OwnFolder.create, Ring.write, OwnFolder.remove

def die():
    os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(60)

def half_a_state(self, name, data, *, sync=False):
    if name.endswith("3.state"):
        os.write(create(self, name), data[: len(data) // 2])
        die()
    write(self, name, data, sync=sync)

def before_the_log(self, name):
    if name.endswith("3.log"):
        die()
    return create(self, name)

def half_a_line(self, text):
    if self.files[-1].log.endswith("3.log"):
        os.write(self._descriptor, text[: len(text) // 2 + 3])
        die()
    append(self, text)

def before_the_state_goes(self, name):
    if name.endswith("1.state"):
        die()
    remove(self, name)

if moment == "a state is half written":
    OwnFolder.write = half_a_state
elif moment == "a state is written, its log not begun":
    OwnFolder.create = before_the_log
elif moment == "a line is half written":
    Ring.write = half_a_line
else:
    OwnFolder.remove = before_the_state_goes
of = binding("demo")
minutes = 0.01 if moment == "the oldest log is gone, its state not" else 5.0
with driven(of, Recorder(RecordingSettings(file_seconds=0.4, minutes=minutes), folder, of)) as run:
    run.feed(highway(of, seconds))
    run.stop()
"""

MOMENTS = (
    "a state is half written",
    "a state is written, its log not begun",
    "a line is half written",
    "the oldest log is gone, its state not",
)


@pytest.fixture(scope="module")
def of() -> Binding:
    return binding("demo")


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_service_killed_when(of: Binding, tmp_path: Path, moment: str) -> None:
    folder = tmp_path / "ring"
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, moment, folder, str(SECONDS)], cwd=ROOT, capture_output=True, check=False
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr.decode()
    with driven(of) as run:
        run.feed(highway(of, SECONDS))
        run.stop()
    whole = as_log(of, run.sent.frames)
    before = replayed(of, folder)
    assert len(before) > len(whole) / 10
    assert before in whole
    if "oldest" not in moment:
        assert whole.startswith(before)
    highest = max(number_of(log) or 0 for log in logs_in(folder))
    recorder = Recorder(RecordingSettings(file_seconds=0.4), folder, of)
    assert {state.stem for state in folder.glob("*.state")} <= {log.stem for log in logs_in(folder)}
    with driven(of, recorder) as run:
        run.feed(highway(of, 0.5))
        run.stop()
    assert recorder.counts()["lost"] == 0
    assert max(number_of(log) or 0 for log in logs_in(folder)) > highest
    assert replayed(of, folder) == before + as_log(of, run.sent.frames)
