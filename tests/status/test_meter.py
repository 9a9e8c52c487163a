"""What the service measures and gathers of itself."""

from __future__ import annotations

import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.can_io.port import PortCounts
from candaemon.config.metrics import MetricsSettings
from candaemon.daemon.observer import CompletedCycle, Observer
from candaemon.ego.motion_plausibility import MotionFaults
from candaemon.errors import ConfigError
from candaemon.pipeline.cycle import Cycle
from candaemon.radar.scan import ScanCounts
from candaemon.status.histogram import Histogram
from candaemon.status.losses import EGO_UNUSABLE_CAUSES, LOSS_CAUSES, UNSENT_CAUSES, UNUSABLE_CAUSES
from candaemon.status.measurements import CounterRates, NisAccumulator
from candaemon.status.service_monitor import ServiceMonitor
from candaemon.status.snapshot import StatusSnapshot
from candaemon.tracking.update import Update
from tests.support.served import Served, bound, drive

BOUNDS = (0.001, 0.01, 0.1)


class Kept(Observer):
    """Keeps what was told."""

    def __init__(self) -> None:
        self.told_all: list[CompletedCycle] = []

    def on_cycle(self, completed: CompletedCycle) -> None:
        self.told_all.append(completed)

    @property
    def last(self) -> Cycle:
        return self.told_all[-1].cycle


@settings(deadline=None)
@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=200), st.floats(0.01, 1.0))
def test_a_quantile_is_right_to_its_bucket(seconds: list[float], share: float) -> None:
    histogram = Histogram(BOUNDS)
    for each in seconds:
        histogram.add(each)
    spread = histogram.spread()
    assert spread.count == len(seconds)
    assert spread.sum == pytest.approx(sum(seconds))
    true = sorted(seconds)[math.ceil(share * len(seconds)) - 1]
    quantile = spread.quantile(share)
    assert quantile is not None
    assert quantile <= max(seconds)
    assert np.searchsorted(BOUNDS, quantile) == np.searchsorted(BOUNDS, true) or quantile == pytest.approx(true)


def test_a_histogram_of_nothing_has_no_quantile() -> None:
    assert Histogram(BOUNDS).spread().quantile(0.5) is None


def test_rates_are_those_of_late() -> None:
    rates = CounterRates()
    for second in range(4):
        assert rates.due(float(second))
        rates.note(float(second), {"frames": 100 * second**2})
        assert not rates.due(second + 0.9)
    assert rates.of(3.5, {"frames": 1100, "further": 7}) == {"frames": pytest.approx(700 / 1.5), "further": 0.0}


def test_nis_of_late_follows_what_changed_and_a_birth_has_none() -> None:
    generator = np.random.default_rng(1)
    sums = NisAccumulator(50)
    for factor in (1.0, 4.0):
        for _ in range(500):
            nis = factor * generator.chisquare(2, 20)
            nis[0] = math.nan
            sums.add(Update(np.arange(20), np.arange(20), nis, np.full(20, 2)))
        assert sums.status().ratio == pytest.approx(factor, rel=0.1)
    figures = sums.status()
    assert figures.samples == 2 * 500 * 19
    assert figures.freedom == 2 * figures.samples
    assert figures.sum / figures.freedom == pytest.approx(2.5, rel=0.05)


def test_the_figures_are_those_of_the_daemon(tmp_path: Path) -> None:
    binding = bound(tmp_path)
    meter, kept = ServiceMonitor(MetricsSettings(), lambda: {"files": 3, "paused": False}), Kept()
    with Served(binding, [meter, kept]) as served:
        served.feed(drive(binding, 2.0))
        figures = meter.wait_for_snapshot(5.0)
    pipeline = served.daemon.pipeline
    radar, ins, obstacles = (figures.buses[name] for name in ("radar", "ins", "obstacles"))
    assert radar.received + ins.received == served.sent
    assert radar.taken["used"] == figures.sensors["front"].frames["used"] == 40 * 64
    assert obstacles.sent == figures.cycles.frames == pipeline.counts.sent
    assert figures.cycles.told == len(kept.told_all) == figures.cycle_time.count == figures.latency.count
    assert figures.cycle_time.sum == pytest.approx(sum(told.seconds for told in kept.told_all))
    assert figures.own_motion.status == "valid"
    assert sum(figures.tracks.values()) == len(kept.last.obstacles)
    assert figures.tracks["confirmed"] >= 3
    sensor = figures.sensors["front"]
    assert (sensor.lost, sensor.counts["scans"]) == (False, 40)
    assert sensor.trust == pytest.approx(1.0)
    assert sensor.age is not None
    assert 0.0 <= sensor.age < 0.05
    assert sensor.nis.ratio is not None
    assert 0.3 < sensor.nis.ratio < 2.0
    assert figures.recording == {"files": 3, "paused": False}


def test_a_sensor_that_falls_silent_is_lost(tmp_path: Path) -> None:
    binding = bound(tmp_path)
    meter = ServiceMonitor(MetricsSettings())
    frames = drive(binding, 2.0)
    half_ns = frames[-1].time_ns - 1_000_000_000
    with Served(binding, [meter]) as served:
        before = meter.wait_for_snapshot(5.0).sensors["front"]
        served.feed([frame for frame in frames if frame.bus == 1 or frame.time_ns < half_ns])
        after = meter.wait_for_snapshot(5.0)
    assert (before.lost, before.age) == (True, None)
    assert after.sensors["front"].lost
    assert after.sensors["front"].age == pytest.approx(1.0, abs=0.1)
    assert after.cycles.coasting > 10


def test_every_frame_is_under_one_cause(tmp_path: Path) -> None:
    binding = bound(tmp_path)
    meter = ServiceMonitor(MetricsSettings())
    frames = drive(binding, 1.0)
    short = [frame._replace(data=frame.data[:3]) if k % 7 == 0 else frame for k, frame in enumerate(frames)]
    unknown = [frame._replace(can_id=0x7FF, time_ns=short[-65].time_ns) for frame in frames[:5]]
    with Served(binding, [meter]) as served:
        served.feed(short[:-64] + unknown)
        figures = meter.wait_for_snapshot(5.0)
        taken = served.daemon.pipeline.assemblers[0].counts.frames
    sensor, radar = figures.sensors["front"], figures.buses["radar"]
    assert sum(sensor.frames.values()) == taken
    assert radar.dropped["short"] == sensor.frames["short"] > 100
    assert sum(bus.taken["unknown"] for bus in figures.buses.values()) == 5


@pytest.mark.parametrize("name", [field.name for field in fields(ScanCounts)])
def test_a_sensors_counts_are_either_frames_or_not(name: str) -> None:
    counts = ScanCounts(**{name: 1})
    assert counts.frames == (name in {"used", *UNUSABLE_CAUSES})


@pytest.mark.parametrize("name", [field.name for field in fields(MotionFaults)])
def test_own_motions_counts_are_either_frames_or_not(name: str) -> None:
    assert MotionFaults(**{name: 1}).refused == (name in EGO_UNUSABLE_CAUSES)


@pytest.mark.parametrize("name", [field.name for field in fields(PortCounts)])
def test_a_buss_counts_are_either_losses_or_not(name: str) -> None:
    counts = PortCounts(**{name: 1})
    assert counts.lost == (name in LOSS_CAUSES)
    assert counts.unsent == (name in UNSENT_CAUSES)


def test_a_query_of_a_hanging_loop_returns_within_its_time_limit() -> None:
    meter = ServiceMonitor(MetricsSettings())
    with pytest.raises(TimeoutError):
        meter.wait_for_snapshot(0.05)


def test_many_who_ask_at_once_are_all_answered(tmp_path: Path) -> None:
    meter = ServiceMonitor(MetricsSettings())
    with Served(bound(tmp_path), [meter]), ThreadPoolExecutor(8) as askers:
        answers = list(askers.map(meter.wait_for_snapshot, [5.0] * 32))
    assert len(answers) == 32
    assert all(isinstance(answer, StatusSnapshot) for answer in answers)


def test_a_reload_is_counted_and_keeps_what_was_measured(tmp_path: Path) -> None:
    binding = bound(tmp_path)
    meter = ServiceMonitor(MetricsSettings())
    with Served(binding, [meter]) as served:
        served.feed(drive(binding, 1.0))
        before = meter.wait_for_snapshot(5.0)
        meter.on_reload_end(served.daemon, "mine.yaml:3: no such bus")
        refused = meter.wait_for_snapshot(5.0).service
        meter.on_reload_end(served.daemon, "")
        after = meter.wait_for_snapshot(5.0)
    assert (refused.reloads, refused.refused, refused.reload_error) == (0, 1, "mine.yaml:3: no such bus")
    assert (after.service.reloads, after.service.refused, after.service.reload_error) == (1, 1, "")
    assert after.sensors["front"].nis == before.sensors["front"].nis
    assert after.cycle_time.count == before.cycle_time.count


def test_the_tree_is_json_and_its_keys_stay(tmp_path: Path) -> None:
    meter = ServiceMonitor(MetricsSettings(), lambda: {"share": math.nan})
    with Served(bound(tmp_path), [meter]):
        tree = json.loads(json.dumps(meter.wait_for_snapshot(5.0).tree(), allow_nan=False))
    assert tree["recording"] == {"share": None}
    assert tree["cycle_time"]["p99"] is None
    keys = "service own_motion tracks tracking cycles cycle_time latency clock buses sensors losses recording"
    assert set(keys.split()) == tree.keys()
    assert {"bounds", "counts", "sum", "max", "count", "p50", "p90", "p99"} == tree["latency"].keys()
    assert tree["service"]["instance"] == "mine"
    assert tree["service"]["name"] == "Demo"
    assert tree["service"]["memory"] > 10e6


@pytest.mark.parametrize("buckets", ["[0.1, 0.1]", "[0.2, 0.1]", "[0, 1]", "[]"])
def test_buckets_that_do_not_ascend_are_refused(buckets: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"mine\.yaml:\d+: service\.metrics\.buckets"):
        bound(tmp_path, f"  metrics: {{buckets: {buckets}}}\n")
