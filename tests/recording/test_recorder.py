"""The recording of a running service: what it holds replays to the same bytes that were sent."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.config.recording import RecordingSettings
from candaemon.daemon.reload import Reloader
from candaemon.errors import InputError
from candaemon.frames.times import NEVER_NS
from candaemon.playback.recording_files import header_beside, logs_in
from candaemon.recording.recorder import Recorder
from tests.support.bound import binding
from tests.support.paths import ROOT
from tests.support.recorded import Driven, as_log, driven, highway, replayed

SECOND = RecordingSettings(file_seconds=1.0)


@pytest.fixture(scope="module")
def of() -> Binding:
    return binding("demo")


def recorded_with(of: Binding, **settings: Any) -> Binding:
    """Return the configuration with other settings of the recording."""
    recording = RecordingSettings.model_validate({"file_seconds": 1.0, **settings})
    service = of.settings.service.model_copy(update={"recording": recording})
    return bind(replace(of.loaded, config=of.settings.model_copy(update={"service": service})))


def note(event: Path) -> Mapping[str, Any]:
    found: Mapping[str, Any] = json.loads((event / "event.json").read_text(encoding="utf-8"))
    return found


def test_a_recording_and_each_of_its_files_replay_to_the_bytes_sent(of: Binding, tmp_path: Path) -> None:
    folder = tmp_path / "ring"
    recording = Recorder(SECOND, folder, of)
    with driven(of, recording) as runs:
        runs.feed(highway(of, 3.0))
        runs.silence(1.2)  # obstacles coast
        runs.stop()
    sent = as_log(of, runs.sent.frames)
    logs = logs_in(folder)
    assert len(logs) == 5
    assert replayed(of, folder) == sent
    parts = [replayed(of, log) for log in logs]
    assert all(parts)
    assert b"".join(parts) == sent
    assert replayed(of, logs[2], fresh=True) != parts[2]
    figures = recording.counts()
    assert (figures["lost"], figures["pauses"], figures["files"]) == (0, 0, 5)
    assert figures["items"] == sum(log.read_bytes().count(b"\n") for log in logs) - 1  # the last line says that it ends


def test_several_starts_replay_one_after_another(of: Binding, tmp_path: Path) -> None:
    folder, sent = tmp_path / "ring", b""
    for seconds in (1.5, 0.8):  # the second drive lies before the end of the first: the clock was set back
        with driven(of, Recorder(SECOND, folder, of)) as runs:
            runs.feed(highway(of, seconds))
            runs.stop()
        sent += as_log(of, runs.sent.frames)
    assert [header.begins for log in logs_in(folder) if (header := header_beside(log))] == [
        "start",
        "rotation",
        "start",
    ]
    assert replayed(of, folder) == sent


def test_a_last_line_cut_short_is_no_problem(of: Binding, tmp_path: Path) -> None:
    with driven(of, Recorder(SECOND, tmp_path / "ring", of)) as runs:
        runs.feed(highway(of, 1.5))
        runs.stop()
    last = logs_in(tmp_path / "ring")[-1]
    text = last.read_bytes()
    last.write_bytes(text[: len(text) // 2 + 5])
    found = replayed(of, tmp_path / "ring")
    sent = as_log(of, runs.sent.frames)
    assert len(sent) / 2 < len(found) < 0.9 * len(sent)
    assert sent.startswith(found)


def test_a_mark_keeps_what_lies_around_it(of: Binding, tmp_path: Path) -> None:
    mine = recorded_with(of, file_seconds=0.5, events={"before": 0.5, "after": 1.0, "faults": []})
    with driven(mine, Recorder(mine.settings.service.recording, tmp_path, mine)) as runs:
        frames = highway(mine, 3.0)
        runs.feed(frames[: len(frames) // 2])
        runs.daemon.mark()
        runs.daemon.run_once()
        marked_ns = runs.now_ns
        runs.feed(frames[len(frames) // 2 :])
        runs.stop()
    (event,) = (tmp_path / "events").iterdir()
    assert note(event)["kind"] == "mark"
    assert note(event)["digest"] in {each.name for each in (tmp_path / "configurations").iterdir()}
    logs = logs_in(event)
    assert note(event)["files"] == [log.name for log in logs]
    begins = [header.time_ns for log in logs if (header := header_beside(log))]
    assert begins[0] <= marked_ns - 0.5e9 < begins[2]
    assert marked_ns + 0.4e9 < begins[-1] < marked_ns + 1.0e9
    kept = bind(load_config(next((event / "configuration").rglob("demo.yaml"))))
    found = replayed(kept, event)
    assert len(found) > 1000
    assert found in as_log(of, runs.sent.frames)


def test_faults_and_chosen_obstacles_are_kept_once(of: Binding, tmp_path: Path) -> None:
    mine = recorded_with(of, events={"obstacles": [2], "faults": ["sensor", "bus", "motion"], "debounce": 30.0})
    with driven(mine, Recorder(mine.settings.service.recording, tmp_path, mine)) as runs:
        frames = highway(mine, 3.0)
        radar = [frame for frame in frames if frame.bus == 0]
        runs.feed(frames[: len(frames) // 2])
        for _ in range(3):  # flapping
            runs.silence(0.5)
        shift_ns = runs.now_ns - radar[len(radar) // 2].time_ns
        runs.feed([frame._replace(time_ns=frame.time_ns + shift_ns) for frame in radar[len(radar) // 2 + 1 :]])
        runs.silence(1.0)
        runs.stop()
    kinds = sorted((note(event)["kind"], note(event)["about"]) for event in (tmp_path / "events").iterdir())
    assert kinds == [("motion", ""), ("obstacle", "2"), ("sensor", "front")]


def test_a_reload_begins_a_file_of_its_own(of: Binding, tmp_path: Path) -> None:
    output = of.settings.output
    assert output is not None
    fewer = output.model_copy(update={"objects": output.objects.model_copy(update={"slots": 8})})
    other = bind(replace(of.loaded, config=of.settings.model_copy(update={"output": fewer})))
    recording = Recorder(SECOND, tmp_path / "ring", of)
    with driven(of, recording) as runs:
        runs.daemon._reloader = Reloader(lambda: other)  # the daemon of these tests has none
        frames = highway(of, 2.4)
        runs.feed(frames[: len(frames) // 2 + 7])
        runs.daemon.reload()
        while runs.daemon.binding is not other:
            runs.daemon.run_once()
        before = len(runs.sent.frames)
        runs.feed(frames[len(frames) // 2 + 7 :])
        runs.stop()
    headers = [header_beside(log) for log in logs_in(tmp_path / "ring")]
    assert "reload" in {header.begins for header in headers if header}
    assert replayed(of, tmp_path / "ring") == as_log(of, runs.sent.frames[:before])
    assert replayed(other, tmp_path / "ring") == as_log(of, runs.sent.frames[before:])
    slower = of.settings.sensors["front"].model_copy(update={"cycle_time": 0.06})
    third = bind(replace(of.loaded, config=of.settings.model_copy(update={"sensors": {"front": slower}})))
    with pytest.raises(InputError, match=r"another configuration.*configurations.*--fresh"):
        replayed(third, tmp_path / "ring")
    assert replayed(third, tmp_path / "ring", fresh=True)


def reloaded(runs: Driven, successor: Binding) -> None:
    """Load a configuration again."""
    runs.daemon._reloader = Reloader(lambda: successor)  # the daemon of these tests has none
    runs.daemon.reload()
    while runs.daemon.binding is not successor:
        runs.daemon.run_once()


@pytest.mark.parametrize("times", [1, 2])
def test_what_a_stop_right_after_a_reload_sends_is_recorded(of: Binding, tmp_path: Path, times: int) -> None:
    recording = Recorder(SECOND, tmp_path / "ring", of)
    with driven(of, recording) as runs:
        frames = highway(of, 1.2)
        runs.feed(frames[: len(frames) // 2])
        while runs.daemon.pipeline.assemblers[0].deadline_ns == NEVER_NS:  # up to where a scan is open
            runs.feed(frames[runs.fed : runs.fed + 1])
        runs.feed(frames[runs.fed : runs.fed + 20])
        for _ in range(times):
            reloaded(runs, bind(of.loaded))
        before = len(runs.sent.frames)
        runs.stop()
    assert len(runs.sent.frames) > before
    assert replayed(of, tmp_path / "ring") == as_log(of, runs.sent.frames)


def test_what_a_reload_no_longer_lets_wait_is_recorded(tmp_path: Path) -> None:
    tree = yaml.safe_load((ROOT / "config" / "radar_lidar.yaml").read_text(encoding="utf-8"))
    tree["groups"] = {"ahead": {"sensors": ["radar", "lidar"], "align": "lagrange"}}
    for bus in tree["buses"].values():
        bus["interface"] = "virtual"
    for part in (tree["ego"], tree["output"], *tree["sensors"].values()):
        part["dbc"] = str(ROOT / "config" / part["dbc"])
    (tmp_path / "aligned.yaml").write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    of = bind(load_config(tmp_path / "aligned.yaml"))
    recording = Recorder(SECOND, tmp_path / "ring", of)
    settled = []
    with driven(of, recording) as runs:
        frames = highway(of, 1.5)
        runs.feed(frames[: len(frames) // 2])
        for _ in range(3):
            runs.feed(frames[runs.fed : runs.fed + 150])
            while runs.daemon.pipeline.alignments[0].deadline_ns == NEVER_NS:  # up to where a scan waits
                runs.feed(frames[runs.fed : runs.fed + 1])
            before = len(runs.sent.frames)
            reloaded(runs, bind(of.loaded))
            settled.append(len(runs.sent.frames) - before)
            times_ns = [frame.time_ns for frame in runs.sent.frames]
            assert times_ns[-1] <= runs.now_ns
        runs.feed(frames[runs.fed :])
        runs.stop()
    assert min(settled) > 0
    assert replayed(of, tmp_path / "ring") == as_log(of, runs.sent.frames)
