"""Faults of sensors and own motion in the log: when one lasts, and when it is over."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from candaemon.daemon.observer import DaemonView, Observer
from candaemon.frames.frame import Frame
from candaemon.status.fault_log import FaultLogger, _LastingFault
from candaemon.status.health_summary import StatusLogger
from candaemon.status.service_monitor import ServiceMonitor
from tests.support.served import Served, bound, drive


def told(tmp_path: Path, frames: list[Frame], caplog: pytest.LogCaptureFixture) -> list[str]:
    observers: list[Observer] = [FaultLogger()]
    with caplog.at_level("INFO"), Served(bound(tmp_path), observers) as served:
        served.feed(frames)
    return [record.getMessage() for record in caplog.records if record.name.endswith("fault_log")]


@pytest.mark.parametrize(
    ("bus", "lost", "back"),
    [
        (0, "sensor 'front': silent, no scan comes", "sensor 'front': well again, after "),
        (1, "own motion: silent, obstacles are tracked by dead reckoning", "own motion: well again, after "),
    ],
)
def test_what_falls_silent_is_told_once_and_again_when_it_is_back(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, bus: int, lost: str, back: str
) -> None:
    frames = [frame for frame in drive(bound(tmp_path), 6.0) if frame.bus != bus or not 1 < frame.time_ns * 1e-9 < 4]
    lines = told(tmp_path, frames, caplog)
    assert len(lines) == 2
    assert lines[0] == lost
    assert lines[1].startswith(back)
    assert 2.0 < float(lines[1].removeprefix(back).removesuffix(" s")) < 3.2


def test_own_motion_that_is_lost_after_dead_reckoning_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    lines = told(
        tmp_path, [frame for frame in drive(bound(tmp_path), 14.0) if frame.bus != 1 or frame.time_ns < 10**9], caplog
    )
    assert lines == [
        "own motion: silent, obstacles are tracked by dead reckoning",
        "own motion: lost, and nothing is tracked without it",
    ]


def test_what_a_reload_brings_has_time_to_come(tmp_path: Path) -> None:
    logger, binding = FaultLogger(), bound(tmp_path)
    with Served(binding, [logger]) as served:
        served.feed(drive(binding, 2.0))
        logger._begun_ns["sensor 'gone'"] = 1
        logger._lasting["sensor 'gone'"] = _LastingFault(1, told="silent")
        logger.on_reload_end(served.daemon, "")
        assert logger._begun_ns.keys() == {"sensor 'front'"}
        assert not logger._lasting


def test_what_is_away_for_a_moment_is_not_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    frames = [frame for frame in drive(bound(tmp_path), 4.0) if frame.bus or not 1.5 < frame.time_ns * 1e-9 < 2.2]
    assert told(tmp_path, frames, caplog) == []


def test_a_sensor_that_never_comes_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    frames = [frame for frame in drive(bound(tmp_path), 3.0) if frame.bus == 1]
    assert told(tmp_path, frames, caplog) == ["sensor 'front': no scan has come yet"]


def test_a_service_without_an_output_says_so(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    binding = replace(bound(tmp_path), output=None)
    meter = ServiceMonitor(binding.settings.service.metrics)
    with caplog.at_level("INFO"), Served(binding, [meter, StatusLogger(None, meter)]):
        pass
    assert "there is no `output`: obstacles are tracked, and none is sent" in caplog.messages


def test_bad_frames_are_told_once_however_their_share_goes(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    frames = [
        frame._replace(data=frame.data[:2])
        if frame.bus == 0 and number % 20 < 12 + 4 * (frame.time_ns // 10**9 % 2)
        else frame
        for number, frame in enumerate(drive(bound(tmp_path), 6.0))
    ]
    lines = told(tmp_path, frames, caplog)
    assert [line for line in lines if "of its frames are valid" in line] == [
        "sensor 'front': fewer than 50% of its frames are valid"
    ]


def test_a_sensor_of_which_now_this_and_now_that_is_wrong_is_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Neither lasts for long; what is wrong does, and so does what it becomes in the end."""

    def faults(of: FaultLogger, _daemon: DaemonView) -> Iterator[tuple[str, str]]:
        tenths = of._now_ns // 10**8
        yield "sensor 'front'", "silent" if tenths > 35 or tenths % 2 else "bad"

    monkeypatch.setattr(FaultLogger, "_faults", faults)
    lines = told(tmp_path, drive(bound(tmp_path), 5.0), caplog)
    assert len(lines) in {1, 2}
    assert len(set(lines)) == len(lines)
    assert lines[-1].endswith("silent")
