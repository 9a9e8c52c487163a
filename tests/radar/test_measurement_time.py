"""Time stamps of the sensor: whoever carries them, the scan's time is that of the measurement, not of its arrival."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from candaemon.binding.bind import bind
from candaemon.binding.bind_time_stamp import LONGEST_WRAP
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.errors import ConfigError
from candaemon.frames.frame import Frame
from candaemon.frames.frame_block import block_of
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state.codec import decoded, encoded
from candaemon.radar.assembler_factory import make_assembler
from candaemon.radar.assembly import AssemblerState, ScanAssembler
from candaemon.radar.measurement_time import MOST_BLOCKS, TimeStampState, line_below
from candaemon.radar.scan import Scan
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate

MS = 1_000_000
DBC = """\
VERSION ""
NS_ :
BS_:
BU_: RADAR

BO_ 1024 HEAD: 8 RADAR
 SG_ COUNT : 0|5@1+ (1,0) [0|16] "" RADAR
 SG_ AGE : 8|11@1+ (0.1,0) [0|204.7] "ms" RADAR
 SG_ CLOCK : 24|16@1+ (1,0) [0|65535] "" RADAR

BO_ 1025 POINT: 8 RADAR
 SG_ INDEX : 0|4@1+ (1,0) [0|15] "" RADAR
 SG_ VALID : 4|1@1+ (1,0) [0|1] "" RADAR
 SG_ DIST : 8|12@1+ (0.0625,0) [0|255] "m" RADAR
 SG_ LAT : 20|12@1- (0.0625,0) [-90|90] "m" RADAR
 SG_ POINT_AGE : 47|16@0+ (0.1,0) [0|6553.5] "ms" RADAR
 SG_ SUM : 56|8@1+ (1,0) [0|255] "" RADAR

BO_ 1026 TIME: 8 RADAR
 SG_ SINCE : 7|16@0- (0.1,0) [-3276.8|3276.7] "ms" RADAR
 SG_ FLOAT : 32|32@1- (1,0) [0|0] "s" RADAR
SIG_VALTYPE_ 1026 FLOAT : 1;
"""
YAML = """\
buses: {{radar: {{channel: can0}}}}
ego: {{kind: static}}
sensors:
  front:
    bus: radar
    dbc: points.dbc
    cycle_time: 0.05
    timeout: 0.04
    objects:
      messages: [{{message: POINT, id_signal: INDEX}}]
      slots: 16
      valid: [{{signal: VALID, in: [1]}}]
    scan: {scan}
    time_stamp: {stamp}
    signals: {{x: DIST, y: LAT}}
    noise: {{x: 0.2, y: 0.3}}
"""
HEADER, TRIGGER = "{close: header, message: HEAD, count: COUNT}", "{close: trigger, message: HEAD}"
TIMEOUT = "{close: timeout}"
CLOCK = "{signal: CLOCK, unit: ms, kind: clock}"
SCENARIO = {
    "duration": 3,
    "ego": {"start": {"speed": 0}},
    "measurement": {"clutter": 0, "detection_probability": 1},
    "frames": {"jitter": 0.002, "burst": 0.005, "latency": 0.02, "clock_drift": 1e-4},
    "actors": [{"name": "car", "reflections": 1, "start": {"x": 40, "y": 3, "vx": 0, "vy": 0}}],
}


def bound(folder: Path, scan: str, stamp: str, *changes: tuple[str, str]) -> Binding:
    (folder / "points.dbc").write_text(DBC, encoding="utf-8")
    text = YAML.format(scan=scan, stamp=stamp)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "vehicle.yaml"
    path.write_text(text, encoding="utf-8")
    return bind(load_config(path))


def simulated(binding: Binding, **changes: object) -> tuple[list[Frame], np.ndarray]:
    """Return the frames of a drive, and when its scans were measured (ns)."""
    drive = simulate(Scenario.model_validate({**SCENARIO, **changes}), binding, seed=3)
    return list(drive.frames()), np.array([time_ns for time_ns, _ in drive.reports(0)])


def scans(assembler: ScanAssembler, frames: list[Frame]) -> list[Scan]:
    found = []
    for frame in frames:
        found.append(assembler.expire(frame.time_ns))
        receive, part, slot = assembler.routes[frame.can_id]
        found.append(receive(part, slot, frame.data, frame.time_ns))
    return [scan for scan in [*found, assembler.flush()] if scan is not None]


def errors_ms(binding: Binding, frames: list[Frame], measured: np.ndarray) -> np.ndarray:
    """Return by how much the time of each scan differs from the nearest measurement."""
    times = np.array([scan.time_ns for scan in scans(make_assembler(binding.sensors[0]), frames)])
    assert len(times) == len(measured)
    return np.asarray((times - measured) / MS)


@pytest.mark.parametrize(
    ("scan", "stamp"),
    [
        (HEADER, "{signal: AGE, kind: age}"),
        (TRIGGER, "{signal: HEAD.AGE, kind: age}"),
        (HEADER, "{signal: POINT_AGE, kind: age}"),
        (TIMEOUT, "{signal: POINT.POINT_AGE, kind: age}"),
        (HEADER, "{signal: TIME.SINCE, kind: age}"),
        (TIMEOUT, "{signal: TIME.SINCE, kind: age}"),
    ],
)
@pytest.mark.parametrize("latency", ["0.0", "0.03"])
def test_an_age_gives_the_instant_of_the_measurement(tmp_path: Path, scan: str, stamp: str, latency: str) -> None:
    binding = bound(tmp_path, scan, stamp, ("    timeout", f"    latency: {latency}\n    timeout"))
    frames, measured = simulated(binding)
    wrong = errors_ms(binding, frames, measured)
    assert np.abs(wrong).max() <= 0.051  # half a step of the signal
    late = errors_ms(bind(load_config(_without_stamp(tmp_path))), _known(frames, stamp), measured)
    assert late.min() > 15.0  # what the arrival alone would say


def _without_stamp(folder: Path) -> Path:
    lines = (folder / "vehicle.yaml").read_text(encoding="utf-8").splitlines()
    path = folder / "unstamped.yaml"
    path.write_text("\n".join(line for line in lines if "time_stamp" not in line), encoding="utf-8")
    return path


def _known(frames: list[Frame], stamp: str) -> list[Frame]:
    return [frame for frame in frames if frame.can_id != 1026] if "TIME." in stamp else frames


def stamped(clock_ms: float, time_ns: int) -> Frame:
    return Frame(time_ns, 0, 1024, (round(clock_ms) % 65536 << 24).to_bytes(8, "little"), False)


def clocked(count: int, drift: float = 0.0) -> tuple[list[Frame], np.ndarray]:
    """Return headers of a clock's scans, delayed by 20 ms and more, and when they were measured (ns)."""
    measured = 1_700_000_000_000 * MS + np.arange(count) * 50 * MS
    delay_ms = 20.0 + np.random.default_rng(2).exponential(4.0, count)
    clock_ms = 60_000 + np.arange(count) * 50 * (1 + drift)
    times = (measured + delay_ms * MS).astype(np.int64)
    return [stamped(*each) for each in zip(clock_ms.tolist(), times.tolist(), strict=True)], measured


def test_a_simulated_clock_gives_the_instant_but_for_the_least_delay(tmp_path: Path) -> None:
    binding = bound(tmp_path, HEADER, "{signal: CLOCK, unit: ms, kind: clock, wrap: 4.096}")
    frames, measured = simulated(binding, duration=9)
    wrong = errors_ms(binding, frames, measured)
    assert np.abs(wrong[60:] - 20.0).max() < 1.5  # the stamp's step is 1 ms


def test_a_clock_that_wraps_and_drifts_is_followed(tmp_path: Path) -> None:
    binding = bound(tmp_path, HEADER, CLOCK)
    frames, measured = clocked(6000, 1e-4)  # wraps five times, has drifted by 30 ms in the end
    wrong = errors_ms(binding, frames, measured)
    assert np.abs(wrong[400:] - 20.0).max() < 1.5
    assert np.abs(wrong).max() < 26.0  # the arrival's: up to 55 ms
    arrivals = np.array([frame.time_ns for frame in frames]) - measured
    assert arrivals.max() / MS > 50.0


def test_a_clock_that_is_set_is_followed_after_some_scans(tmp_path: Path) -> None:
    frames, measured = clocked(600)
    later = [*frames[:300], *map(set_on, frames[300:])]
    assembler = make_assembler(bound(tmp_path, HEADER, CLOCK).sensors[0])
    found = scans(assembler, later)
    assert assembler.counts.odd_stamps == 4
    wrong = np.array([scan.time_ns for scan in found]) / MS - measured / MS
    assert np.abs(wrong[:300] - 20.0).max() < 6.0
    assert np.abs(wrong[340:] - 20.0).max() < 3.0
    assert np.abs(wrong - 20.0).max() < 40.0


def set_on(frame: Frame) -> Frame:
    """Return a header whose clock was set on by 20 s."""
    clock = (int.from_bytes(frame.data[3:5], "little") + 20_000) % 65536
    return frame._replace(data=frame.data[:3] + clock.to_bytes(2, "little") + frame.data[5:])


def header(age_ms: float, time_ns: int) -> Frame:
    return Frame(time_ns, 0, 1024, (round(age_ms * 10) << 8).to_bytes(8, "little"), False)


def test_stamps_that_cannot_be_are_counted_and_the_arrival_gives_the_time(tmp_path: Path) -> None:
    binding = bound(tmp_path, HEADER, "{signal: AGE, kind: age, longest: 0.15}")
    begin = 1_000_000 * MS
    ages = [20.0] * 30 + [150.0, 150.1, 20.0, 75.0] + [20.0] * 5
    found, counts = [], None
    assembler = make_assembler(binding.sensors[0])
    for index, age in enumerate(ages):
        found += scans(assembler, [header(age, begin + 50 * index * MS)])
    counts = assembler.counts
    times = [round((scan.time_ns - begin) / MS - 50 * index, 1) for index, scan in enumerate(found)]
    # of the 31st the age says that it was before the last one; so it does of the 34th
    assert counts.odd_stamps == 3
    assert counts.unstamped == 0
    assert times[:30] == [-20.0] * 30
    assert times[30:34] == [-20.0, -20.0, -20.0, -20.0]


def test_an_age_at_its_limit_is_taken(tmp_path: Path) -> None:
    for age, odd in ((150.0, 0), (150.1, 1)):
        assembler = make_assembler(bound(tmp_path, HEADER, "{signal: AGE, kind: age, longest: 0.15}").sensors[0])
        scans(assembler, [header(age, 1_000_000 * MS)])
        assert assembler.counts.odd_stamps == odd


def test_a_scan_without_its_stamp_has_the_usual_delay(tmp_path: Path) -> None:
    binding = bound(tmp_path, TIMEOUT, "{signal: TIME.SINCE, kind: age}")
    frames, measured = simulated(binding, duration=5)
    lost = [frame for frame in frames if frame.can_id != 1026 or frame.time_ns // (500 * MS) % 2]
    assembler = make_assembler(binding.sensors[0])
    found = scans(assembler, lost)
    assert assembler.counts.unstamped == pytest.approx(50, abs=5)
    assert len(found) == len(measured)
    wrong = np.array([scan.time_ns for scan in found]) / MS - measured / MS
    assert np.abs(wrong[10:]).max() < 15.0  # the jitter
    assert abs(wrong.mean()) < 5.0
    short = frames[0]._replace(can_id=1026, data=b"\0" * 3)
    scans(assembler, [short])
    assert assembler.counts.short == 1


def test_another_pipeline_goes_on_with_the_state(tmp_path: Path) -> None:
    binding = bound(tmp_path, HEADER, CLOCK)
    frames, _ = clocked(1200, 5e-5)
    half = 620
    whole, first, second = (make_assembler(binding.sensors[0]) for _ in range(3))
    expected = [scan.time_ns for scan in scans(whole, frames)]
    times = [scan.time_ns for scan in scans(first, frames[:half])]
    second.state = decoded(AssemblerState, encoded(first.state), second.state)
    assert times + [scan.time_ns for scan in scans(second, frames[half:])] == expected


def test_a_replay_gives_the_same_times_from_blocks_as_from_frames(tmp_path: Path) -> None:
    counted = TIMEOUT.replace("timeout", "counter, signal: INDEX")
    binding = bound(tmp_path, counted, "{signal: POINT_AGE, kind: age}")
    frames, _ = simulated(binding, duration=3)
    plain = [cycle.obstacles.time_ns for cycle in Pipeline(binding).run(frames)]
    blocks = [cycle.obstacles.time_ns for cycle in Pipeline(binding).run_blocks([block_of(frames)])]
    assert plain == blocks


def test_a_state_of_another_clock_is_refused() -> None:
    for state in (
        TimeStampState(times=[1]),
        TimeStampState(times=[0] * (MOST_BLOCKS + 1), delays=[0] * (MOST_BLOCKS + 1)),
        TimeStampState(drift=0.1),
    ):
        with pytest.raises(ValueError, match="clock"):
            decoded(TimeStampState, encoded(state), TimeStampState())
    largest = TimeStampState(times=[0] * MOST_BLOCKS, delays=[0] * MOST_BLOCKS, drift=1e-3)
    assert decoded(TimeStampState, encoded(largest), TimeStampState()) == largest


def test_the_line_below_delays_has_their_drift(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    times = np.arange(60) * 1000 * MS
    delays = (times * 5e-5 + random.exponential(3 * MS, 60)).astype(np.int64)
    at, low, drift = line_below(times.tolist(), delays.tolist())
    line = low + drift * (times - at)
    assert (line <= delays + 1).all()
    assert drift == pytest.approx(5e-5, abs=2e-5)
    assert line_below(times[:7].tolist(), delays[:7].tolist())[2] == 0.0  # too few to show it
    assert line_below(times.tolist(), (times // 500).tolist())[2] == 0.0  # steeper than a clock's


@pytest.mark.parametrize(
    ("scan", "stamp", "says"),
    [
        (HEADER, "{signal: AGEE, kind: age}", "AGEE"),
        (HEADER, "{signal: CLOCK, kind: clock}", "give unit"),
        (HEADER, "{signal: TIME.FLOAT, kind: age}", "is a float"),
        (HEADER, "{signal: AGE, kind: age, wrap: 3}", "wrap is a clock's"),
        (HEADER, "{signal: AGE, kind: clock}", "more than twice the longest delay"),
        (HEADER, "{signal: CLOCK, kind: clock, unit: ms, wrap: 0.5}", "more than twice the longest delay"),
    ],
)
def test_what_cannot_be_a_stamp_is_refused(tmp_path: Path, scan: str, stamp: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        bound(tmp_path, scan, stamp)


def test_a_clock_counts_so_long(tmp_path: Path) -> None:
    for unit, wrap in (("ms", 65.536), ("s", 65536.0)):
        binding = bound(tmp_path, HEADER, f"{{signal: CLOCK, kind: clock, unit: {unit}}}")
        stamp = binding.sensors[0].stamp
        assert stamp is not None
        assert stamp.wrap_ns == round(wrap * 1e9)
    longer = DBC.replace(" SG_ CLOCK : 24|16@1+ (1,0) [0|65535]", " SG_ CLOCK : 24|33@1+ (1,0) [0|0]")
    (tmp_path / "points.dbc").write_text(longer, encoding="utf-8")
    stamp = bind(load_config(tmp_path / "vehicle.yaml")).sensors[0].stamp
    assert stamp is not None
    assert stamp.wrap_ns == round(LONGEST_WRAP * 1e9) < 2**62
