"""Frames that fail are counted and not used: within a scan, of own motion, on the road from one daemon to another."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pytest

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.config.load import load_config
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.ego.motion_plausibility import MotionFaults
from candaemon.errors import ConfigError
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline
from candaemon.protection.checksums import Protector
from candaemon.protection.monitor import FrameMonitorSettings
from candaemon.radar.assembler_factory import make_assembler
from candaemon.radar.assembly import ScanAssembler
from candaemon.radar.scan import ScanCounts
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate
from tests.pipeline.test_pipeline import drive as simulated
from tests.pipeline.test_pipeline import status
from tests.support.bound import binding
from tests.support.paths import ROOT
from tests.support.scan_frames import cycle, run, sensor, timed

Frames = list[tuple[int, bytes]]


def damaged(frames: Iterable[tuple[int, bytes]], which: Callable[[int], bool]) -> Frames:
    """Turn one bit of those frames."""
    return [(can_id, bytes((data[0] ^ 1, *data[1:])) if which(k) else data) for k, (can_id, data) in enumerate(frames)]


def sent(assembler: ScanAssembler, number: int, which: Callable[[int], bool]) -> int:
    """Send a cycle, some frames of it damaged; return how many scans came of it."""
    return len(run(assembler, timed("toyota_rav4", number, damaged(cycle("toyota_rav4", number), which))))


def test_a_scan_with_too_many_failed_frames_is_discarded_whole() -> None:
    assembler = make_assembler(sensor("toyota_rav4"))
    assert sent(assembler, 0, lambda k: k % 2 == 0) == 1  # half of 32: as many as may fail
    assert sent(assembler, 1, lambda k: k % 2 == 0 or k == 1) == 0
    assert sent(assembler, 2, lambda _: False) == 1
    counts = assembler.counts
    assert (counts.scans, counts.distrusted) == (2, 1)
    assert (counts.used, counts.checksum, counts.discarded) == (16 + 32, 16 + 17, 15)
    assert counts.frames == 3 * 32
    assert assembler.valid_share < 1.0


def test_trust_is_the_share_of_frames_used_of_late() -> None:
    assembler = make_assembler(sensor("toyota_rav4"))
    for number in range(20):
        sent(assembler, number, lambda _: False)
    assert assembler.valid_share == 1.0
    for number in range(20, 140):
        sent(assembler, number, lambda k: k < 8)
    assert assembler.valid_share == pytest.approx(0.75, abs=0.01)


def test_where_no_scan_closes_any_more_the_trust_falls_too() -> None:
    assembler = make_assembler(sensor("toyota_rav4"))
    sent(assembler, 0, lambda _: False)
    for number in range(1, 60):
        assert sent(assembler, number, lambda _: True) == 0
    assert assembler.counts.scans == 1
    assert assembler.valid_share < 0.06


def test_a_header_that_fails_opens_nothing() -> None:
    bound = sensor("gm_lrr")
    assert bound.header is not None
    frames = list(cycle("gm_lrr", 0))
    header, length = bound.header.can_id, len(frames[0][1])
    spec = MessageSpec("H", header, length, (SignalSpec(name="Sum", start=8 * (length - 1), length=8),))
    protector = Protector("xor", [spec], "Sum")
    assembler = make_assembler(replace(bound, mark_monitor=FrameMonitorSettings(protector)))
    for number, sealed in ((0, True), (1, False)):
        now = [(i, protector.seal(i, data) if i == header and sealed else data) for i, data in frames]
        now[0] = now[0] if sealed else (header, bytes((*now[0][1][:-1], protector.checksum(*now[0]) ^ 1)))
        run(assembler, timed("gm_lrr", number, now))
    assert assembler.counts.checksum == 1
    assert assembler.counts.missing >= 1
    assert assembler.counts.used == 2 * len(frames) - 1


def configured(tmp_path: Path, config: str, *changes: tuple[str, str]) -> Binding:
    """Bind a configuration with something in it replaced."""
    text = (ROOT / "config" / f"{config}.yaml").read_text()
    for old, new in (*changes, ("../dbc", str(ROOT / "dbc"))):
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "changed.yaml"
    path.write_text(text)
    return bind(load_config(path))


def test_a_checksum_that_counts_the_scans_too_is_told_with_its_place(tmp_path: Path) -> None:
    bound = configured(tmp_path, "toyota_rav4", ("signal: COUNTER}", "signal: CHECKSUM}"))
    assert any("changed.yaml:21: sensors.front: 'CHECKSUM' counts the scans" in each for each in bound.warnings)


WHEELS = """    left_wheels: [WHEEL_SPEEDS.WHEEL_SPEED_FL, WHEEL_SPEEDS.WHEEL_SPEED_RL]
    right_wheels: [WHEEL_SPEEDS.WHEEL_SPEED_FR, WHEEL_SPEEDS.WHEEL_SPEED_RR]
"""
SPEED = (WHEELS, "    speed: [SPEED.SPEED]\n")
SUMMED = ("  track_width", "  protection: {SPEED: {checksum: CHECKSUM, kind: toyota, timeout: 0.2}}\n  track_width")


def test_own_motion_s_frames_are_verified(tmp_path: Path, drive: Path) -> None:
    """On the recorded car, whose speeds carry Toyota's checksum: none fails, and a damaged one does."""
    bound = configured(tmp_path, "toyota_rav4", SPEED, SUMMED)
    channels = {bus.settings.channel: bus.index for bus in bound.buses}
    frames = list(islice(read_log(drive / "drive.log.gz", channels, LogCounts()), 30_000))
    speeds = [k for k, frame in enumerate(frames) if frame.can_id == 0xB4 and frame.bus == 0]
    assert len(speeds) > 500
    for k in speeds[99::100]:
        data = frames[k].data
        frames[k] = frames[k]._replace(data=bytes((data[0] ^ 4, *data[1:])))
    pipeline = Pipeline(bound)
    for _ in pipeline.run(frames):
        pass
    assert pipeline.counts.ego_motion == MotionFaults(checksum=len(speeds) // 100)
    assert pipeline.drops == len(speeds) // 100


def test_simulated_own_motion_is_protected_as_configured(tmp_path: Path) -> None:
    bound = configured(tmp_path, "toyota_rav4", SPEED, SUMMED)
    scenario = load_scenario(ROOT / "config" / "scenarios" / "highway.yaml").model_copy(update={"duration": 4.0})
    frames = list(simulate(scenario, bound).frames())
    assert sum(frame.can_id == 0xB4 for frame in frames) > 100
    pipeline = Pipeline(bound)
    list(pipeline.run(frames))
    assert pipeline.counts.ego_motion == MotionFaults()


@pytest.mark.parametrize(
    ("protection", "message"),
    [
        ("{SPED: {checksum: CHECKSUM, kind: toyota}}", "no message 'SPED'; did you mean 'SPEED'"),
        ("{EPS_STATUS: {checksum: CHECKSUM, kind: toyota}}", "nothing is taken from message 'EPS_STATUS'"),
        ("{SPEED: {checksum: SUM, kind: toyota}}", "has no signal 'SUM'"),
        ("{SPEED: {max_step: 1}}", "max_step watches a counter"),
    ],
)
def test_what_does_not_fit_own_motion_is_said(protection: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        configured(tmp_path, "toyota_rav4", SPEED, ("  track_width", f"  protection: {protection}\n  track_width"))
    assert "changed.yaml:" in str(caught.value)


E2E = (
    "protection: {counter: Counter, checksum: Crc, kind: crc8_sae_j1850}",
    "protection: {counter: Counter, checksum: Crc, e2e: {profile: 5, data_id: 0x1000, step: 1}}",
)
LISTENER = """
buses: {{other: {{channel: can0}}}}
ego: {{kind: static}}
sensors:
  other:
    bus: other
    dbc: {dbc}
    cycle_time: 0.05
    objects:
      messages:
        ["OBSTACLE_{{slot:02d}}_A", "OBSTACLE_{{slot:02d}}_B", "OBSTACLE_{{slot:02d}}_C", "OBSTACLE_{{slot:02d}}_D"]
      slots: 32
      valid: [{{signal: State, in: [1, 2, 3]}}]
    scan: {{close: timeout}}
    signals: {{x: X, y: Y, vx: Vx, heading: {{signal: Heading, unknown: -192}}, length: {{signal: Length, unknown: 0}}}}
    noise: {{x: 0.3, y: 0.3, vx: 0.3}}
    protection: {{e2e: {{profile: 5, data_id: {data_id}, step: 1}}, max_step: 1, max_failed: 1}}
"""


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> list[Frame]:
    """Return the obstacle frames that a daemon sends with E2E profile 5, without its status."""
    bound = configured(tmp_path_factory.mktemp("sender"), "toyota_rav4_ins", E2E)
    assert bound.output is not None
    assert bound.output.status is not None
    told = [frame for cycle in Pipeline(bound).run(simulated("toyota_rav4_ins")) for frame in cycle.frames]
    return [frame._replace(bus=0) for frame in told if frame.can_id != bound.output.status.message.can_id]


def listener(tmp_path: Path, data_id: int = 0x1000) -> Pipeline:
    path = tmp_path / "listener.yaml"
    path.write_text(LISTENER.format(dbc=ROOT / "dbc" / "obstacles.dbc", data_id=data_id))
    return Pipeline(bind(load_config(path)))


def heard(pipeline: Pipeline, frames: Iterable[Frame]) -> ScanCounts:
    for _ in (*pipeline.run(frames), *pipeline.finish()):
        pass
    return pipeline.assemblers[0].counts


def test_one_daemon_s_obstacles_are_another_s_objects(told: list[Frame], tmp_path: Path) -> None:
    counts = heard(listener(tmp_path), told)
    assert counts.used == counts.frames == len(told) > 500
    assert counts.failed == counts.lost == counts.odd_sizes == 0


def test_a_frame_lost_is_seen_and_one_sent_twice_not_used(told: list[Frame], tmp_path: Path) -> None:
    lost, twice = told[300], told[450]
    frames = [frame for frame in told for _ in range(1 + (frame is twice)) if frame is not lost]
    counts = heard(listener(tmp_path), frames)
    # a step of two is a jump here: the frame after the lost one is not used either
    assert (counts.repeated, counts.jumped) == (1, 1)
    assert counts.used == len(told) - 2


def test_another_s_data_id_is_another_s_message(told: list[Frame], tmp_path: Path) -> None:
    counts = heard(listener(tmp_path, 0x1001), told)
    assert (counts.used, counts.checksum) == (0, len(told))


def test_health_says_when_nothing_can_be_relied_on(tmp_path: Path) -> None:
    """Two radars: one whose frames all fail is a sensor lost, both are a fault; own motion lost is one too."""
    text = (ROOT / "config" / "toyota_rav4_ins.yaml").read_text()
    start, end = text.index("  front:\n"), text.index("output:\n")
    second = text[start:end].replace("front:", "rear:").replace("bus: radar", "bus: radar2")
    buses = ("  ins: {channel: can2}\n", "  ins: {channel: can2}\n  radar2: {channel: can7}\n")
    bound = configured(tmp_path, "toyota_rav4_ins", (text[start:end], text[start:end] + second), buses)
    names = [bus.name for bus in bound.buses]
    front, rear, ins = names.index("radar"), names.index("radar2"), names.index("ins")
    of = binding("toyota_rav4_ins")
    radar, own = of.sensors[0].bus, of.ego.bus if of.ego is not None else -1
    frames = simulated("toyota_rav4_ins")
    start_ns = frames[0].time_ns

    def fails(frame: Frame, which: int) -> Frame:
        seconds = (frame.time_ns - start_ns) * 1e-9
        spoilt = (seconds > 1.5 and which == front) or (seconds > 3.0 and which == rear)
        return frame._replace(bus=which, data=bytes((frame.data[0] ^ 1, *frame.data[1:])) if spoilt else frame.data)

    both: list[Frame] = []
    for frame in frames:
        if frame.bus == radar:
            both += [fails(frame, front), fails(frame, rear)]
        elif frame.bus == own:
            both.append(frame._replace(bus=ins))
    at = {round((each.time_ns - start_ns) * 1e-9, 1): each for each in Pipeline(bound).run(both) if each.frames}
    assert [status(at[seconds])["Health"] for seconds in (1.2, 2.8, 5.0)] == [0, 2, 3]
