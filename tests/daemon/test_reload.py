"""A reload while frames come: whole or refused, and obstacles live through it."""

from __future__ import annotations

import gc
import io
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import can
import pytest

from candaemon.can_io.python_can import to_message
from candaemon.daemon import reload as service_reload
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.observer import CompletedCycle, DaemonView, Observer
from candaemon.daemon.reload import Reloader
from candaemon.daemon.service_config import load_service_config
from candaemon.daemon.service_log import RepetitionFilter, configure_logging
from candaemon.frames.frame import Frame
from candaemon.pipeline.cycle import Cycle
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate
from tests.support.paths import ROOT

PATIENCE_S = 20.0


class Diary(Observer):
    """Keeps what the daemon tells."""

    def __init__(self) -> None:
        self.cycles: list[Cycle] = []
        self.reloads: list[str] = []
        self.begun = 0
        self.marks = 0
        self.stopped_after = -1

    def on_cycle(self, completed: CompletedCycle) -> None:
        self.cycles.append(completed.cycle)

    def on_reload_begin(self, _daemon: DaemonView) -> None:
        self.begun += 1

    def on_reload_end(self, _daemon: DaemonView, error: str) -> None:
        self.reloads.append(error)

    def on_mark(self, _daemon: DaemonView) -> None:
        self.marks += 1

    def on_stop(self, _daemon: DaemonView) -> None:
        self.stopped_after = len(self.cycles)


class Vehicle:
    """A served configuration file, and a drive on the other side of its buses."""

    def __init__(self, path: Path, closing: ExitStack) -> None:
        self.path = path
        path.write_text(
            (ROOT / "config" / "demo.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
        )
        binding = load_service_config(path)
        self.sides = [
            closing.enter_context(
                can.Bus(channel=bus.settings.channel, interface="virtual", preserve_timestamps=True, ignore_config=True)
            )
            for bus in binding.buses
        ]
        scenario = load_scenario(ROOT / "config" / "scenarios" / "highway.yaml")
        frames = list(simulate(scenario.model_copy(update={"duration": 3.0}), binding, 5).frames())
        self.frames: Iterator[Frame] = iter(frames)
        self.now_ns = frames[0].time_ns
        self.sent = 0
        self.diary = Diary()
        reloader = Reloader(lambda: load_service_config(path))
        self.daemon = Daemon(binding, clock=lambda: self.now_ns, observers=[self.diary], reloader=reloader)
        closing.enter_context(self.daemon)

    def change(self, before: str, after: str) -> None:
        text = self.path.read_text(encoding="utf-8")
        assert before in text
        self.path.write_text(text.replace(before, after), encoding="utf-8")

    def drive(self, seconds: float) -> None:
        end_ns = self.now_ns + round(seconds * 1e9)
        for frame in self.frames:
            self.sides[frame.bus].send(to_message(frame))
            self.now_ns = frame.time_ns
            self.sent += 1
            while self.daemon.received < self.sent:
                self.daemon.run_once()
            if end_ns < self.now_ns:
                break

    def reload(self, times: int = 1) -> None:
        """Reload with frames coming meanwhile."""
        wanted = len(self.diary.reloads) + times
        self.daemon.reload()
        deadline = time.monotonic() + PATIENCE_S
        while len(self.diary.reloads) < wanted:
            assert time.monotonic() < deadline
            self.drive(0.01)
            self.daemon.run_once()

    @property
    def confirmed(self) -> set[int]:
        obstacles = self.diary.cycles[-1].obstacles
        return set(obstacles.id[obstacles.state > 0].tolist())


@pytest.fixture
def vehicle(tmp_path: Path) -> Iterator[Vehicle]:
    with ExitStack() as closing:
        vehicle = Vehicle(tmp_path / "mine.yaml", closing)
        vehicle.drive(1.0)
        assert len(vehicle.confirmed) >= 3
        yield vehicle


def test_obstacles_live_through_a_reload(vehicle: Vehicle, caplog: pytest.LogCaptureFixture) -> None:
    before, scans = vehicle.confirmed, vehicle.daemon.pipeline.assemblers[0].counts.scans
    vehicle.change("name: Demo", "name: Other\nordering_window: 0.01")
    with caplog.at_level("INFO"):
        vehicle.reload()
    vehicle.drive(0.2)
    assert vehicle.daemon.binding.settings.name == "Other"
    assert before <= vehicle.confirmed
    assert vehicle.daemon.pipeline.assemblers[0].counts.scans > scans
    assert vehicle.daemon.pipeline.drops == 0
    assert any("reloaded: unchanged: front, own motion, output; " in message for message in caplog.messages)


def test_what_a_reload_does_not_change_is_told(vehicle: Vehicle, caplog: pytest.LogCaptureFixture) -> None:
    vehicle.change("name: Demo", "name: Demo\nservice: {recording: {events: {late: 0.3}}}")
    vehicle.reload()
    assert not any("service.recording" in message for message in caplog.messages)
    vehicle.change("{events: {late: 0.3}}", "{minutes: 7}")
    vehicle.reload()
    assert any("service.recording is taken at the start: restart" in message for message in caplog.messages)
    caplog.clear()
    vehicle.change("{minutes: 7}", "{minutes: 5}")
    vehicle.reload()
    assert not any("service.recording" in message for message in caplog.messages)


def test_a_bad_file_is_refused_with_its_line_and_nothing_changes(
    vehicle: Vehicle, caplog: pytest.LogCaptureFixture
) -> None:
    pipeline, before = vehicle.daemon.pipeline, vehicle.confirmed
    vehicle.change("cycle_time: 0.05", "cycle_time: soon")
    vehicle.reload()
    vehicle.drive(0.2)
    assert vehicle.daemon.pipeline is pipeline
    assert before <= vehicle.confirmed
    assert "mine.yaml:24: sensors.front.cycle_time: found 'soon'" in vehicle.diary.reloads[0]
    assert "reload refused, the former configuration stays" in caplog.messages[-1]
    vehicle.change("cycle_time: soon", "cycle_time: 0.05")
    vehicle.reload()
    assert vehicle.diary.reloads[1] == ""


def test_a_file_that_has_gone_is_refused(vehicle: Vehicle) -> None:
    vehicle.path.rename(vehicle.path.with_name("elsewhere.yaml"))
    vehicle.reload()
    assert "mine.yaml" in vehicle.diary.reloads[0]


def test_a_reload_asked_for_during_another_comes_after_it(vehicle: Vehicle) -> None:
    vehicle.daemon.reload()
    vehicle.daemon.run_once()
    assert vehicle.diary.begun == 1
    vehicle.reload(times=2)
    assert vehicle.diary.begun == 2
    assert vehicle.diary.reloads == ["", ""]


@pytest.mark.usefixtures("logging_as_it_was")
def test_each_of_many_reloads_is_answered_in_the_log(vehicle: Vehicle) -> None:
    stream = io.StringIO()
    configure_logging("text", stream, repetitions=RepetitionFilter(most=1))
    for _ in range(3):
        vehicle.reload()
    vehicle.change("cycle_time: 0.05", "cycle_time: soon")
    for _ in range(3):
        vehicle.reload()
    lines = stream.getvalue().splitlines()
    assert ["reloaded: " in line for line in lines].count(True) == 3
    assert ["reload refused" in line for line in lines].count(True) == 3


def test_a_changed_bus_is_opened_anew_and_the_others_stay_open(vehicle: Vehicle) -> None:
    radar = vehicle.daemon.buses[0].counts.received
    vehicle.change("channel: obstacles", "channel: elsewhere")
    with can.Bus(channel="elsewhere", interface="virtual", ignore_config=True) as elsewhere:
        vehicle.reload()
        deadline = time.monotonic() + PATIENCE_S
        while elsewhere.recv(0) is None:
            assert time.monotonic() < deadline
            vehicle.drive(0.05)
    assert vehicle.daemon.buses[0].counts.received > radar
    assert vehicle.daemon.buses[0].counts.reconnects == 0
    assert vehicle.confirmed


def test_a_mark_reaches_the_observers_once(vehicle: Vehicle) -> None:
    vehicle.daemon.mark()
    vehicle.daemon.run_once()
    vehicle.daemon.run_once()
    assert vehicle.diary.marks == 1


def test_the_last_cycle_is_sent_before_the_observers_hear_of_the_end(vehicle: Vehicle) -> None:
    vehicle.drive(0.04)  # leaves a scan open
    told = len(vehicle.diary.cycles)
    sent = vehicle.daemon.buses[2].counts.sent
    vehicle.daemon.stop()
    vehicle.daemon.run()
    assert vehicle.diary.stopped_after == told + 1
    assert vehicle.daemon.buses[2].counts.sent > sent


def test_garbage_is_collected_while_it_serves(vehicle: Vehicle) -> None:
    gc.disable()  # as `candaemon run` does until then
    try:
        vehicle.daemon.stop()
        vehicle.daemon.run()
        assert gc.isenabled()
    finally:
        gc.enable()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_load_that_breaks_down_is_refused_too(vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service_reload, "Pipeline", None)  # calling it is what nobody has foreseen
    vehicle.reload()
    monkeypatch.undo()
    vehicle.reload()
    assert vehicle.diary.reloads == ["the load has ended without a result; the log tells where", ""]
