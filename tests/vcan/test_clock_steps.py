"""The clock is set while the service records: it goes on as if nothing had happened, and so does its replay."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from candaemon.binding.bind import bind
from candaemon.config.load import load_config
from candaemon.playback.recording_files import logs_in
from tests.beds.can_utils import candump
from tests.beds.fixtures import Start
from tests.beds.links import Link
from tests.beds.own_kernel import OwnClock
from tests.beds.service import config_on
from tests.support.recorded import replayed

from .drives import lap, light
from .heard import Ears
from .traffic import Traffic
from .whole import PLACES, Whole, longest_gap

HOUR_S = 3600.0
YEAR_S = 365.0 * 24.0 * HOUR_S
STEPS_S = [-HOUR_S, 2 * HOUR_S, -20 * YEAR_S, 40 * YEAR_S, -5.0, 9.0]
"""From one to the next; they lead to 2006 and to 2046, none back to where the one before began."""
BETWEEN_S = 2.5


def recording(settings: dict[str, Any]) -> None:
    light(settings)
    settings["service"] = {"recording": {"file_seconds": 4.0, "events": {"faults": []}}}


def frames_of(log: bytes) -> list[str]:
    return [line.split()[2] for line in log.decode("ascii").splitlines()]


@pytest.mark.limit(400)
def test_a_recording_over_steps_of_hours_and_years_replays_to_what_was_sent(
    vcan0: Link,
    vcan1: Link,
    vcan2: Link,
    tmp_path: Path,
    start: Start,
    own_clock: OwnClock,
    record_property: Callable[[str, object], None],
) -> None:
    channels = {"radar": vcan0.name, "ins": vcan1.name, "obstacles": vcan2.name}
    config, ring = config_on("esr_ins", tmp_path, channels, recording), tmp_path / "ring"
    of = bind(load_config(config))
    sensors = {index: bus.settings.channel for index, bus in enumerate(of.buses[:2])}
    with (
        candump(tmp_path / "heard.log", vcan2.name) as capture,
        Ears() as ears,
        Traffic(lap(of, PLACES), sensors) as traffic,
    ):
        service = start(config, "--record", str(ring), RUNTIME_DIRECTORY=str(tmp_path))
        whole = Whole(service, tmp_path, traffic, ears)
        whole.track(120.0)
        before, sent_before = whole.pause(), dict(traffic.sent)  # it played while the service started
        traffic.silent.clear()
        who = whole.track().identities
        told, cycles, gap_s = whole.status()["cycles"]["told"], 0, 0.0
        for seconds in STEPS_S:
            own_clock.step(seconds)
            heard = ears.hear(BETWEEN_S)
            cycles += len(heard)
            assert len(heard) > 2  # of 25; who waits for the old time tells none
            gap_s = max(gap_s, longest_gap(heard))
            assert all(cycle.identities == who for cycle in heard[2:-1] if cycle.whole)
        record_property("benchmark", f"longest gap over steps of the clock {gap_s:.2f} s; goal 1 s")
        after = whole.status()
        assert after["cycles"]["told"] - told < 3 * cycles  # no flood of them for the years
        assert after["clock"]["backward_steps"] == sum(seconds < 0 for seconds in STEPS_S)
        assert after["clock"]["forward_steps"] == sum(seconds > 0 for seconds in STEPS_S)
        assert after["latency"]["max"] < 10.0
        status = whole.pause()
        for name in ("radar", "ins"):
            bus, was = status["buses"][name], before["buses"][name]
            gained = bus["received"] - was["received"]
            lost = bus["dropped"]["kernel_lost"] - was["dropped"]["kernel_lost"]
            assert gained + lost == traffic.sent[channels[name]] - sent_before[channels[name]]
        assert service.stop()[0] == 0
        expected = frames_of(replayed(of, ring))
        sent = [line.frame for line in capture.wait_for(len(expected))]
    assert len(sent) > 1000
    assert sent == expected
    names = [log.name for log in logs_in(ring)]
    assert len(names) >= 4
    assert names == sorted(names)
    # each file goes on from what was known at its beginning
    assert [frame for log in logs_in(ring) for frame in frames_of(replayed(of, log))] == sent
