"""Each loss has one count, and journal, status, metrics and the last line give the same number."""

from __future__ import annotations

import json
import logging
import re
from dataclasses import fields, replace
from pathlib import Path
from threading import Event

import can
import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.can_io import threaded_port
from candaemon.config.load import load_config
from candaemon.config.metrics import MetricsSettings
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.observer import DaemonView, Observer
from candaemon.daemon.service_log import RepetitionFilter
from candaemon.pipeline.handover import hand_over
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.spare_frames import SpareFrames
from candaemon.status.health_summary import HealthSummary, StatusLogger
from candaemon.status.losses import (
    EGO_UNUSABLE_CAUSES,
    LOSS_CAUSES,
    OBJECT_CAUSES,
    UNSENT_CAUSES,
    UNUSABLE_CAUSES,
    Losses,
)
from candaemon.status.prometheus_metrics import SnapshotCollector
from candaemon.status.service_monitor import ServiceMonitor
from candaemon.status.snapshot import StatusSnapshot
from tests.support.bound import binding
from tests.support.live_buses import message
from tests.support.paths import ROOT
from tests.support.served import Served, bound, demo_config, drive, wait_until

KINDS = [each.name for each in fields(Losses)]
FIRST, SECOND = 10_007, 20
"""Counted before the line that comes at its rate, and after it."""


class Watched:
    """A daemon whose losses are caused by hand, and all that tells of them."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.daemon = Daemon(binding("demo"))
        self.recorded = {"lost": 0, "events_lost": 0}
        self.repetitions = RepetitionFilter(most=1)
        self.meter = ServiceMonitor(MetricsSettings(), lambda: self.recorded, log=self.repetitions)
        self.line = StatusLogger(1.0, self.meter, lambda: self.now_s)
        self.summary = HealthSummary(self.meter, lambda: self.now_s)
        self.meter.on_start(self.daemon)
        self.line.on_start(self.daemon)
        self._repeated = logging.LogRecord("x", logging.INFO, "", 0, "again and again", (), None)
        self.repetitions.filter(self._repeated)  # which goes through

    def lose(self, kind: str, count: int) -> None:
        """Count a loss where it happens; what happens at each bus or sensor, partly at one and partly at another."""
        pipeline, part = self.daemon.pipeline, count // 3
        if kind in (*LOSS_CAUSES, *UNSENT_CAUSES):
            raise_by(self.daemon.buses[0].counts, kind, part)
            raise_by(self.daemon.buses[1].counts, kind, count - part)
        elif kind == "short":
            raise_by(pipeline.counts.buses[1], kind, part)
            raise_by(pipeline.assemblers[0].counts, kind, count - part)
        elif kind in UNUSABLE_CAUSES:
            if kind in EGO_UNUSABLE_CAUSES:
                raise_by(pipeline.counts.ego_motion, kind, part)
                count -= part
            raise_by(pipeline.assemblers[0].counts, kind, count)
        elif kind in EGO_UNUSABLE_CAUSES:
            raise_by(pipeline.counts.ego_motion, kind, count)
        elif kind.removeprefix("objects_") in OBJECT_CAUSES:
            raise_by(pipeline.assemblers[0].counts, kind.removeprefix("objects_"), count)
        else:
            self._lose_else(kind, count)

    def _lose_else(self, kind: str, count: int) -> None:
        match kind:
            case "scans_without_ego":
                self.daemon.pipeline.counts.without_ego += count
            case "detections_crowded":
                self.daemon.pipeline.trackers[0].counts.crowded += count
            case "recording_items":
                self.recorded["lost"] += count
            case "recording_events":
                self.recorded["events_lost"] += count
            case "log_lines":
                for _ in range(count):
                    self.repetitions.filter(self._repeated)
            case _:
                raise_by(self.meter.clients, kind, count)


def raise_by(counts: object, name: str, count: int) -> None:
    setattr(counts, name, getattr(counts, name) + count)


def in_metrics(snapshot: StatusSnapshot) -> dict[str, int]:
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(snapshot))
    (family,) = [
        each
        for each in text_string_to_metric_families(generate_latest(registry).decode())
        if each.name == "candaemon_losses"
    ]
    return {sample.labels["kind"]: int(sample.value) for sample in family.samples}


def in_line(line: str) -> dict[str, int]:
    """Return the losses that a line of the log tells."""
    found = re.search(r" unsent(?: \((.*?)\))?(?:,|;|$)", line)
    assert found is not None, line
    told = [each.rpartition(" ") for each in (found[1] or "").split(", ") if each]
    return dict.fromkeys(KINDS, 0) | {name.replace(" ", "_"): int(count) for name, _, count in told}


@pytest.mark.parametrize("kind", KINDS)
def test_a_loss_is_the_same_number_everywhere(kind: str, caplog: pytest.LogCaptureFixture) -> None:
    watched = Watched()
    for count, total in ((FIRST, FIRST), (SECOND, FIRST + SECOND)):
        watched.lose(kind, count)
        expected = dict.fromkeys(KINDS, 0) | {kind: total}
        caplog.clear()
        with caplog.at_level(logging.INFO):
            watched.now_s += 1.0
            watched.line.on_iteration(watched.daemon)
            watched.line.on_stop(watched.daemon)
        snapshot = watched.meter.snapshot(watched.daemon)
        assert json.loads(json.dumps(snapshot.tree()))["losses"] == expected
        assert in_metrics(snapshot) == expected
        assert [in_line(line) for line in caplog.messages] == [expected, expected]
        frames = expected[kind] if kind in (*LOSS_CAUSES, *UNUSABLE_CAUSES, *EGO_UNUSABLE_CAUSES, *UNSENT_CAUSES) else 0
        assert f", {frames} lost" in watched.summary.brief(watched.daemon)


def test_short_frames_that_nothing_asks_for_are_spare_and_neither_a_loss_nor_an_event() -> None:
    watched = Watched()
    spare = SpareFrames(8, watched.daemon.pipeline.counts.buses[0])
    for data in (bytes(8), bytes(5), b""):
        spare.receive(0, 0, data, 0)
    snapshot = watched.meter.snapshot(watched.daemon)
    (bus, *_) = snapshot.buses.values()
    assert (bus.taken["spare"], watched.daemon.pipeline.counts.buses[0].spare_short) == (3, 2)
    assert not any(bus.events.values())
    registry = CollectorRegistry()
    registry.register(SnapshotCollector(snapshot))
    assert "spare_short" not in generate_latest(registry).decode()
    assert not any(bus.dropped.values())
    assert watched.meter.losses(watched.daemon).frames == 0


@pytest.mark.parametrize("kind", KINDS)
def test_the_documentation_says_what_each_loss_is(kind: str) -> None:
    text = (ROOT / "docs/operating.md").read_text(encoding="utf-8")
    _, _, table = text.partition("## What can be lost")
    assert re.search(rf"^\| .*`{kind}`", table.partition("\n## ")[0], re.MULTILINE)
    assert re.search(rf"^        {kind}: \w", str(Losses.__doc__), re.MULTILINE)


def test_what_a_reload_takes_away_stays_in_the_sums(tmp_path: Path) -> None:
    watched = Watched()
    for kind in ("kernel_lost", "short", "checksum", "impossible", "objects_unpaired", "detections_crowded"):
        watched.lose(kind, 9)
    before = watched.meter.losses(watched.daemon)
    path = demo_config(tmp_path)
    text = path.read_text(encoding="utf-8").replace("ins, ", "other, ").replace("cycle_time: 0.05", "cycle_time: 0.06")
    path.write_text(text, encoding="utf-8")
    for _ in range(2):
        successor = Pipeline(bind(load_config(path)))
        hand_over(watched.daemon.pipeline, successor)
        watched.daemon.buses.change({"radar": successor.binding.settings.buses["radar"]})
        watched.daemon.pipeline = successor
        watched.meter.on_reload_end(watched.daemon, "")
        assert watched.meter.losses(watched.daemon) == before
    raise_by(watched.daemon.buses[0].counts, "unread", 4)
    assert watched.meter.losses(watched.daemon) == replace(before, unread=4)


class Held(Observer):
    """Holds the core loop up while it is asked to."""

    def __init__(self) -> None:
        self.go = Event()
        self.go.set()
        self.stands = Event()

    def on_iteration(self, daemon: DaemonView) -> None:  # noqa: ARG002  # the hook's signature
        if not self.go.is_set():
            self.stands.set()
            assert self.go.wait(30.0)


def test_what_was_sent_is_received_or_lost_in_a_service_that_falls_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(threaded_port.ThreadedPort.__init__, "__defaults__", (100,))
    served_binding = bound(tmp_path)
    meter, held = ServiceMonitor(served_binding.settings.service.metrics), Held()
    observers = [meter, StatusLogger(0.0, meter), held]
    with caplog.at_level(logging.INFO), Served(served_binding, observers) as served:
        served.feed(drive(served_binding, 0.5))
        held.go.clear()
        assert held.stands.wait(30.0)
        other = flood(served_binding, served)
        counts = served.daemon.buses[0].counts
        wait_until(lambda: counts.queue_full == 150, 30.0)
        served.daemon.stop()
        held.go.set()
    received = served.daemon.received
    losses = meter.losses(served.daemon)
    assert (losses.queue_full, losses.unread, losses.malformed) == (150, 100, 2)
    assert served.sent + other == received + losses.lost
    assert in_line(caplog.messages[-1])["unread"] == 100
    assert f"{received} frames received, {losses.lost} lost" in caplog.messages[-1]


def flood(served_binding: Binding, served: Served) -> int:
    """Send 250 frames and two that are none on the radar's bus; return how many that is."""
    channel = served_binding.buses[0].settings.channel
    with can.Bus(channel=channel, interface="virtual", preserve_timestamps=True, ignore_config=True) as side:
        odd = can.Message(arbitration_id=0x100, is_extended_id=False, data=bytes(9), check=False)
        for each in (odd, odd, *(message(0x100, served.now_ns * 1e-9) for _ in range(250))):
            side.send(each)
    return 252
