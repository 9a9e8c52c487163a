"""Ways in which radars lay out their objects: each written by the simulation and read back to what was written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.base import MOST_UNKNOWN, ObjectSignalRef
from candaemon.config.load import load_config
from candaemon.config.sensors import MOST_HEADERS, MOST_PAGES, MOST_POINTS, MOST_SLOTS, HeaderScan, ObjectFormat
from candaemon.errors import ConfigError
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline
from candaemon.radar.assembler_factory import make_assembler
from candaemon.radar.scan import Scan, ScanCounts
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate

SCENARIO = {
    "duration": 1,
    "ego": {"start": {"speed": 0}},
    "measurement": {"clutter": 2, "detection_probability": 0.9},
    "actors": [
        {"name": f"car{k}", "reflections": 1, "start": {"x": x, "y": y, "vx": 2.0 * k, "vy": 0}}
        for k, (x, y) in enumerate([(20.0, 3.0), (35.0, -2.0), (60.0, 0.0), (80.0, 4.0), (110.0, -3.0)])
    ],
}
YAML = """\
buses: {{radar: {{channel: can0, fd: true}}}}
ego: {{kind: static}}
sensors:
  front:
    bus: radar
    dbc: radar.dbc
    cycle_time: 0.05
    timeout: 0.04
    field_of_view: {{range: 150, azimuth_deg: 40}}
    noise: {{range: 0.2, azimuth_deg: 0.3, range_rate: 0.1}}
{sensor}
"""
STEP = {"range": 0.0625, "azimuth": np.radians(0.0625), "range_rate": 0.0625}


def message(can_id: int, name: str, *signals: str, length: int = 8) -> str:
    return f"\nBO_ {can_id} {name}: {length} RADAR\n" + "".join(f" SG_ {each} RADAR\n" for each in signals)


def point(suffix: str = "", first: int = 0, mux: str = "", prefix: str = "") -> tuple[str, ...]:
    """Describe the 40 bits of an object: validity, range, angle to the right and range rate, without units."""
    return tuple(
        f'{prefix}{name}{suffix}{mux} : {first + at}|{bits}{kind} [0|0] ""'
        for name, at, bits, kind in (
            ("OK", 0, 2, "@1+ (1,0)"),
            ("RNG", 2, 12, "@1+ (0.0625,0)"),
            ("ANG", 14, 12, "@1- (0.0625,0)"),
            ("SPD", 26, 12, "@1- (0.0625,0)"),
        )
    )


def number(name: str, first: int, bits: int, mux: str = "") -> str:
    return f'{name}{mux} : {first}|{bits}@1+ (1,0) [0|0] ""'


def sensor(objects: str, scan: str, suffix: str = "", prefix: str = "") -> str:
    rng, ang, spd, valid = (f"{prefix}{name}{suffix}" for name in ("RNG", "ANG", "SPD", "OK"))
    return f"""\
    objects: {{{objects}, valid: [{{signal: "{valid}", in: [1]}}]}}
    scan: {scan}
    signals: {{range: "{rng}", azimuth: "-{ang}", range_rate: "{spd}"}}
    units: {{angle: deg}}"""


HEADER = message(100, "HEAD", number("COUNT", 0, 8), number("CYCLE", 8, 8))
HEADED = "{close: header, message: HEAD, count: COUNT, counter: CYCLE}"
LAYOUTS = {
    "slot in every name": (
        "".join(
            message(200 + k, f"DET_{k:03d}", *point(f"_{k:02d}"), number(f"CNT_{k:02d}", 40, 2)) for k in range(1, 33)
        ),
        sensor(
            'messages: ["DET_{slot:03d}"], slots: 32, first: 1',
            '{close: counter, signal: "CNT_{slot:02d}"}',
            "_{slot:02d}",
        ),
    ),
    "hexadecimal numbers": (
        "".join(
            message(k, f"TRACK_{k:X}", *point(f"_{k:x}"), number("CNT", 40, 2)) for k in range(0x3FC, 0x3FC + 0x20)
        ),
        sensor('messages: ["TRACK_{slot:X}"], slots: 32, first: 0x3FC', "{close: counter, signal: CNT}", "_{slot:x}"),
    ),
    "points in a message": (
        "".join(
            message(
                200 + k,
                f"LIST_{k}",
                *(line for p in range(4) for line in point(f"_{p + 1}", 16 + 40 * p)),
                number("CNT", 0, 2),
                length=24,
            )
            for k in range(8)
        ),
        sensor(
            'messages: ["LIST_{slot}"], slots: 32, points: [1, 2, 3, 4]', "{close: counter, signal: CNT}", "_{point}"
        ),
    ),
    "objects numbered through": (
        HEADER
        + "".join(
            message(
                200 + k,
                f"LIST_{k}",
                *point(f"_{3 * k - 2:02d}", 0),
                *point(f"_{3 * k - 1:02d}", 40),
                *point(f"_{3 * k:02d}", 80),
                length=16,
            )
            for k in range(1, 9)
        ),
        sensor('messages: ["LIST_{slot}"], slots: 24, points: 3, first: 1, identity: false', HEADED, "_{object:02d}"),
    ),
    "points with names": (
        message(
            200,
            "LANES",
            *point("_Rng", 0, prefix="Left_"),
            *point("_Rng", 40, prefix="Same_"),
            *point("_Rng", 80, prefix="Right_"),
            *point("_Rng", 120, prefix="Far_"),
            *point("_Rng", 160, prefix="Other_"),
            *point("_Rng", 200, prefix="More_"),
            length=32,
        ),
        sensor(
            "messages: [LANES], slots: 6, points: [Left, Same, Right, Far, Other, More]",
            "{close: timeout}",
            "_Rng",
            "{point}_",
        ),
    ),
    "a multiplexer of slots": (
        message(
            200,
            "OBJECTS",
            number("Index", 48, 4, " M"),
            *(line for k in range(10) for line in point(f"_{k}", 0, f" m{k + 3}")),
        ),
        sensor("messages: [{message: OBJECTS, id_signal: Index}], slots: 10", "{close: timeout}", "_{slot}"),
    ),
    "a multiplexer of lists": (
        HEADER
        + message(
            200,
            "OBJECTS",
            number("Group", 0, 4, " M"),
            *(line for k in range(6) for p in range(3) for line in point(f"_{3 * k + p}", 8 + 40 * p, f" m{k + 1}")),
            length=16,
        ),
        sensor(
            "messages: [{message: OBJECTS, id_signal: Group}], slots: 18, points: 3, identity: false",
            HEADED,
            "_{object}",
        ),
    ),
    "a list without numbers": (
        HEADER + message(200, "OBJECT", *point()),
        sensor("messages: [{message: OBJECT, id_signal: false}], slots: 20, identity: false", HEADED),
    ),
    "a list of lists without numbers": (
        HEADER + message(200, "OBJECT", *point("_0"), *point("_1", 40), *point("_2", 80), length=16),
        sensor(
            "messages: [{message: OBJECT, id_signal: false}], slots: 21, points: 3, identity: false", HEADED, "_{point}"
        ),
    ),
    "parts under one identifier": (
        "".join(
            message(200 + k, f"TRACK_{k}", number("PART", 56, 4, " M"), *point(mux=" m0")[:3], *point(mux=" m5")[3:])
            for k in range(20)
        ),
        sensor(
            'messages: [{message: "TRACK_{slot}", when: {PART: 0}}, {message: "TRACK_{slot}", when: {PART: 5}}], '
            "slots: 20",
            "{close: timeout}",
        ),
    ),
    "headers over two messages": (
        message(99, "HEAD", number("NEAR", 0, 8), number("CYCLE", 8, 8))
        + message(100, "TAIL", number("FAR", 8, 8), number("FARTHEST", 16, 8))
        + message(200, "OBJECT", *point(), number("INDEX", 40, 6)),
        sensor(
            "messages: [{message: OBJECT, id_signal: INDEX}], slots: 20, identity: false",
            "{close: header, message: [HEAD, TAIL], count: [NEAR, TAIL.FAR, FARTHEST], counter: CYCLE}",
        ),
    ),
    "pages of numbered messages": (
        "".join(message(200 + k, f"DET_{k}", *point(), number("PAGE", 40, 3), number("CNT", 44, 2)) for k in range(8)),
        sensor(
            'messages: ["DET_{slot}"], slots: 24, pages: {signal: PAGE, count: 3, first: 1}',
            "{close: counter, signal: CNT}",
        ),
    ),
    "pages by the number of their first object": (
        HEADER + message(200, "OBJECT", *point(), number("INDEX", 40, 3), number("BEGIN", 48, 8)),
        sensor(
            "messages: [{message: OBJECT, id_signal: INDEX}], slots: 24, pages: {signal: BEGIN, count: 4, step: 6}",
            HEADED,
        ),
    ),
    "pages of lists": (
        HEADER
        + "".join(
            message(
                200 + k,
                f"LIST_{k}",
                *point("_0"),
                *point("_1", 40),
                *point("_2", 80),
                number("PAGE", 120, 2),
                length=16,
            )
            for k in range(4)
        ),
        sensor(
            'messages: ["LIST_{slot}"], slots: 24, points: 3, identity: false, pages: {signal: PAGE, count: 2}',
            HEADED,
            "_{point}",
        ),
    ),
    "one message a page": (
        message(200, "OBJECT", *point(), number("PAGE", 40, 5)),
        sensor("messages: [OBJECT], slots: 20, pages: {signal: PAGE, count: 20}", "{close: timeout}"),
    ),
    "a header among the objects": (
        message(
            200,
            "ALL",
            number("KIND", 60, 4, " M"),
            number("COUNT", 0, 8, " m1"),
            number("CYCLE", 8, 8, " m1"),
            *point(mux=" m2"),
            number("INDEX", 40, 6, " m2"),
        ),
        sensor(
            "messages: [{message: ALL, id_signal: INDEX, when: {KIND: 2}}], slots: 20",
            "{close: header, message: ALL, when: {KIND: 1}, count: COUNT, counter: CYCLE}",
        ),
    ),
    "a trigger among the objects": (
        message(200, "ALL", number("KIND", 60, 4, " M"), *point(mux=" m2"), number("INDEX", 40, 6, " m2")),
        sensor(
            "messages: [{message: ALL, id_signal: INDEX, when: {KIND: 2}}], slots: 20",
            "{close: trigger, message: ALL, when: {KIND: 0}}",
        ),
    ),
    "an index from 1": (
        HEADER + message(200, "OBJECT", *point(), number("INDEX", 40, 6)),
        sensor("messages: [{message: OBJECT, id_signal: INDEX}], slots: 20, first: 1", HEADED),
    ),
}


def bound(folder: Path, dbc: str, yaml: str) -> Binding:
    (folder / "radar.dbc").write_text('VERSION ""\nNS_ :\nBS_:\nBU_: RADAR\n' + dbc, encoding="utf-8")
    path = folder / "vehicle.yaml"
    path.write_text(YAML.format(sensor=yaml), encoding="utf-8")
    return bind(load_config(path))


def read(binding: Binding, frames: list[Frame]) -> tuple[list[Scan], ScanCounts]:
    """Return the scans of a sensor's frames."""
    assembler = make_assembler(binding.sensors[0])
    found = []
    for frame in frames:
        found.append(assembler.expire(frame.time_ns))
        receive, part, slot = assembler.routes[frame.can_id]
        found.append(receive(part, slot, frame.data, frame.time_ns))
    found.append(assembler.flush())
    return [scan for scan in found if scan is not None], assembler.counts


def written_and_read(binding: Binding, order: str = "slots") -> None:
    """Simulate, read the frames, and compare each scan with what the sensor reported."""
    drama = Scenario.model_validate({**SCENARIO, "frames": {"order": order}})
    simulation = simulate(drama, binding, seed=1)
    reports = [report for _, report in simulation.reports(0)]
    scans, counts = read(binding, list(simulation.frames()))
    assert counts.dropped == counts.missing == counts.rejected == 0
    # a scan without objects has no frames where nothing else is sent
    reports = [report for report in reports if len(report.slot) or binding.sensors[0].header is not None]
    assert len(scans) == len(reports) >= 15
    quantities = binding.sensors[0].reader.quantities
    for scan, report in zip(scans, reports, strict=True):
        assert len(scan.slot) == len(report.slot)
        ranges = scan.values[quantities.index("range")]
        told = report.values[report.quantities.index("range")]
        for name, row in zip(report.quantities, report.values, strict=True):
            read_back = scan.values[quantities.index(name)][ranges.argsort(kind="stable")]
            assert read_back == pytest.approx(row[told.argsort(kind="stable")], abs=0.51 * STEP[name])
        if binding.sensors[0].settings.identified:
            assert scan.slot.tolist() == report.slot.tolist()


@pytest.mark.parametrize("order", ["slots", "shuffled"])
@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_is_read_as_it_was_written(name: str, order: str, tmp_path: Path) -> None:
    written_and_read(bound(tmp_path, *LAYOUTS[name]), order)


PLAIN = (
    "".join(message(200 + k, f"DET_{k}", *point()) for k in range(20)),
    sensor('messages: ["DET_{slot}"], slots: 20', "{close: timeout}"),
)


def changed(layout: tuple[str, str], *changes: tuple[str, str]) -> tuple[str, str]:
    dbc, yaml = layout
    for old, new in changes:
        assert old in dbc + yaml
        dbc, yaml = dbc.replace(old, new), yaml.replace(old, new)
    return dbc, yaml


@pytest.mark.parametrize(
    ("azimuth", "quantum"),
    [
        ("{signal: -ANG, unit: deg}", 0.0625 * np.pi / 180),
        ("{signal: ANG, unit: deg, scale: -2}", 0.125 * np.pi / 180),
        ("{signal: -ANG, unit: rad, scale: 0.015625}", 0.001),
        ('{signal: "-ANG", form: sine, scale: 0.015625}', 0.0016),
        ("{signal: -ANG, form: slope, scale: 0.015625}", 0.001),
    ],
)
def test_an_angle_is_read_in_the_form_it_has(tmp_path: Path, azimuth: str, quantum: float) -> None:
    binding = bound(tmp_path, *changed(PLAIN, ('azimuth: "-ANG"', f"azimuth: {azimuth}")))
    drama = Scenario.model_validate(SCENARIO)
    simulation = simulate(drama, binding, seed=1)
    scans, _ = read(binding, list(simulation.frames()))
    row = binding.sensors[0].reader.quantities.index("azimuth")
    for scan, (_, report) in zip(scans, simulation.reports(0), strict=True):
        told = report.values[report.quantities.index("azimuth")]
        assert scan.values[row] == pytest.approx(told, abs=quantum)
        assert np.sign(scan.values[row][np.abs(told) > 0.01]).tolist() == np.sign(told[np.abs(told) > 0.01]).tolist()


@pytest.mark.parametrize("unknown", ["unknown: 255.9375", "unknown_raw: 0xFFF", "unknown: [255.9375, 255.875]"])
def test_a_range_that_is_not_known_is_that_of_an_empty_slot(tmp_path: Path, unknown: str) -> None:
    layout = changed(
        PLAIN, (', valid: [{signal: "OK", in: [1]}]', ""), ('range: "RNG"', f"range: {{signal: RNG, {unknown}}}")
    )
    written_and_read(bound(tmp_path, *layout))


@pytest.mark.parametrize(("raw", "known"), [(-2048, False), (-2047, True), (0, True), (2046, True), (2047, False)])
def test_a_speed_at_the_end_of_its_signal_is_a_bound_and_none(tmp_path: Path, raw: int, known: bool) -> None:
    """What is faster than the signal can tell is told as its end: an obstacle would have that speed."""
    binding = bound(tmp_path, *PLAIN)
    payload = (1 | 800 << 2 | (raw & 0xFFF) << 26).to_bytes(8, "little")
    (scan,), counts = read(binding, [Frame(0, 0, 200, payload)])
    rate = scan.values[binding.sensors[0].reader.quantities.index("range_rate")]
    assert np.isfinite(rate).tolist() == [known]
    assert np.isnan(rate[0]) or rate[0] == raw * 0.0625
    assert counts.rejected == 0


@pytest.mark.parametrize(
    ("distance", "angle", "at_end"),
    [(4095, 0, True), (4094, 0, False), (0, 0, False), (800, -2048, True), (800, 2047, True), (800, 2046, False)],
)
def test_a_place_at_the_end_of_its_signal_is_a_bound(tmp_path: Path, distance: int, angle: int, at_end: bool) -> None:
    """It is read as told, and marked: what is farther is told so too."""
    binding = bound(tmp_path, *PLAIN)
    payload = (1 | distance << 2 | (angle & 0xFFF) << 14).to_bytes(8, "little")
    (scan,), counts = read(binding, [Frame(0, 0, 200, payload)])
    assert len(scan.slot) == 1
    assert (scan.at_end is not None) == at_end
    assert counts.not_finite == 0


def test_units_are_of_signals_that_have_none(tmp_path: Path) -> None:
    binding = bound(
        tmp_path,
        *changed(PLAIN, ("units: {angle: deg}", "units: {angle: rad, speed: km/h, length: cm}")),
    )
    gains = {each.quantity: each.gain for each in binding.sensors[0].reader.bindings}
    assert gains == pytest.approx({"range": 0.01, "azimuth": -1.0, "range_rate": 1 / 3.6})
    dbc = PLAIN[0].replace('(0.0625,0) [0|0] ""', '(0.0625,0) [0|0] "mm"')
    with pytest.raises(ConfigError, match="'ANG' has the unit 'mm'"):
        bound(tmp_path, dbc, PLAIN[1])


@pytest.mark.parametrize(
    ("name", "old", "new", "what"),
    [
        ("slot in every name", "RNG_07 :", "RNG_7 :", r"'DET_007' has no signal 'RNG_\{slot:02d\}' for slot 7"),
        ("slot in every name", '"RNG_{slot:02d}"', '"RNG_{slot:03d}"', r"no signal 'RNG_\{slot:03d\}' in 'DET_001'"),
        ("slot in every name", "RNG_07 : 2|12@1+", "RNG_07 : 3|11@1+", r"'DET_007' lays its signals out otherwise"),
        ("points in a message", "RNG_3 : 98|12", "RNG_3 : 98|11", r"no signal 'RNG_\{point\}\[2\]' like that of the"),
        ("points in a message", "slots: 32", "slots: 30", "30 slots are no whole number of messages with 4 points"),
        ("a multiplexer of slots", "RNG_4 m7 : 2|12", "RNG_4 m7 : 2|11", r"'RNG_\{slot\}' is not there for slot|laid"),
        (
            "a list without numbers",
            "close: header, message: HEAD, count: COUNT, counter: CYCLE",
            "close: counter, signal: OK",
            "from a scan's begin",
        ),
        (
            "a list without numbers",
            "id_signal: false",
            "id_signal: false, when: {OK: 4}",
            "'OK' cannot be 4, it holds 0 to 3",
        ),
        ("one message a page", "slots: 20, ", "slots: 30, ", "no whole number on each of 20 pages"),
        ("one message a page", "signal: PAGE", "signal: SIDE", "no signal 'SIDE'"),
        ("one message a page", "close: timeout", "close: trigger, message: OBJECT", "comes with each page"),
        ("a trigger among the objects", "KIND: 0", "KIND: 2", "are the objects' too"),
        ("a trigger among the objects", "KIND: 0", "KIND: 16", "'KIND' cannot be 16, it holds 0 to 15"),
        ("a header among the objects", "when: {KIND: 1}", "when: {KINDS: 1}", "no signal 'KINDS'"),
        ("an index from 1", '"-ANG"', "{signal: ANG, form: sin}", "form"),
        ("an index from 1", 'range: "RNG"', "range: {signal: RNG, form: sine}", "'form: sine' is of an angle"),
    ],
)
def test_a_layout_that_cannot_be_is_refused(name: str, old: str, new: str, what: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=what):
        bound(tmp_path, *changed(LAYOUTS[name], (old, new)))


def test_a_format_has_so_many_slots_points_and_unknown_values() -> None:
    def form(slots: int, points: int) -> ObjectFormat:
        return ObjectFormat.model_validate({"messages": ["A{slot}"], "slots": slots, "points": list(range(points))})

    assert form(MOST_SLOTS, MOST_POINTS).places == MOST_SLOTS // MOST_POINTS
    assert len(ObjectSignalRef.model_validate({"signal": "A", "unknown": [1.0] * MOST_UNKNOWN}).unknown) == MOST_UNKNOWN
    with pytest.raises(ValidationError, match=f"less than or equal to {MOST_SLOTS}"):
        form(MOST_SLOTS + 1, 1)
    with pytest.raises(ValidationError, match=f"at most {MOST_POINTS}"):
        form(65, MOST_POINTS + 1)
    with pytest.raises(ValidationError, match=f"at most {MOST_UNKNOWN}"):
        ObjectSignalRef.model_validate({"signal": "A", "unknown": [1.0] * (MOST_UNKNOWN + 1)})


def test_scans_interleaved_under_the_same_identifiers_are_those_of_two_sensors(tmp_path: Path) -> None:
    entry = 'messages: [{message: "DET_{slot}", when: {FAR: VALUE}}], slots: 20'
    dbc = "".join(message(200 + k, f"DET_{k}", *point(), number("FAR", 40, 2)) for k in range(20))
    binding = bound(tmp_path, dbc, sensor(entry.replace("VALUE", "0"), "{close: timeout}"))
    near = (tmp_path / "vehicle.yaml").read_text(encoding="utf-8")
    far = near[near.index("  front:") :].replace("front", "far").replace("FAR: 0", "FAR: 1")
    both = near.replace("range: 150, azimuth_deg: 40", "range: 50, azimuth_deg: 60") + "\n" + far
    (tmp_path / "vehicle.yaml").write_text(both, encoding="utf-8")
    binding = bind(load_config(tmp_path / "vehicle.yaml"))
    frames = list(simulate(Scenario.model_validate(SCENARIO), binding, seed=2).frames())
    own = frames[0]._replace(data=bytes([*frames[0].data[:5], 3, *frames[0].data[6:]]))  # of neither
    pipeline = Pipeline(binding)
    detections = [cycle.detections for cycle in pipeline.run([own, *frames]) if cycle.detections is not None]
    by_sensor = [[each for each in detections if each.sensor == sensor] for sensor in (0, 1)]
    assert [len(each) for each in by_sensor] == [pytest.approx(20, abs=1)] * 2
    assert max(np.hypot(each.x, each.y).max() for each in by_sensor[0]) < 52 < 100
    assert max(np.hypot(each.x, each.y).max() for each in by_sensor[1]) > 100
    assert [each.counts.dropped for each in pipeline.assemblers] == [0, 0]
    assert pipeline.counts.buses[0].spare == 1
    (tmp_path / "vehicle.yaml").write_text(both.replace("FAR: 1", "FAR: 0"), encoding="utf-8")
    with pytest.raises(ConfigError, match="belongs to sensor 'front' already"):
        bind(load_config(tmp_path / "vehicle.yaml"))


def test_a_scan_has_so_many_headers() -> None:
    def scan(count: int) -> HeaderScan:
        names = [f"A{k}" for k in range(count)]
        return HeaderScan.model_validate({"close": "header", "message": names, "count": names})

    assert len(scan(MOST_HEADERS).message) == MOST_HEADERS
    with pytest.raises(ValidationError, match=f"at most {MOST_HEADERS}"):
        scan(MOST_HEADERS + 1)


@pytest.mark.parametrize("lost", [99, 100])
def test_a_scan_that_lost_one_of_its_headers_is_incomplete(tmp_path: Path, lost: int) -> None:
    binding = bound(tmp_path, *LAYOUTS["headers over two messages"])
    frames = list(simulate(Scenario.model_validate(SCENARIO), binding, seed=1).frames())
    first = next(frame for frame in frames[len(frames) // 2 :] if frame.can_id == lost)
    whole, _ = read(binding, frames)
    scans, counts = read(binding, [frame for frame in frames if frame is not first])
    assert [len(scan.slot) for scan in scans] == [len(scan.slot) for scan in whole]
    assert counts.incomplete == counts.missing == 1
    assert counts.dropped == 0


def test_two_sensors_have_headers_of_one_identifier(tmp_path: Path) -> None:
    dbc = (
        message(100, "HEAD", number("COUNT", 0, 8), number("CYCLE", 8, 8), number("SIDE", 16, 1))
        + message(200, "LEFT", *point(), number("INDEX", 40, 6))
        + message(201, "RIGHT", *point(), number("INDEX", 40, 6))
    )
    header = "{close: header, message: HEAD, when: {SIDE: 0}, count: COUNT, counter: CYCLE}"
    text = sensor("messages: [{message: LEFT, id_signal: INDEX}], slots: 20", header)
    bound(tmp_path, dbc, text)
    one = (tmp_path / "vehicle.yaml").read_text(encoding="utf-8")
    other = one[one.index("  front:") :].replace("front", "rear").replace("LEFT", "RIGHT")
    both = one.replace("range: 150", "range: 50") + "\n" + other.replace("SIDE: 0", "SIDE: 1")
    (tmp_path / "vehicle.yaml").write_text(both, encoding="utf-8")
    binding = bind(load_config(tmp_path / "vehicle.yaml"))
    frames = list(simulate(Scenario.model_validate(SCENARIO), binding, seed=2).frames())
    pipeline = Pipeline(binding)
    scans = [cycle.detections.sensor for cycle in pipeline.run(frames) if cycle.detections is not None]
    assert [scans.count(sensor) for sensor in (0, 1)] == [pytest.approx(20, abs=1)] * 2
    assert all(each.counts.dropped == each.counts.missing == each.counts.skipped == 0 for each in pipeline.assemblers)
    (tmp_path / "vehicle.yaml").write_text(both.replace("SIDE: 1", "SIDE: 0"), encoding="utf-8")
    with pytest.raises(ConfigError, match="belongs to sensor 'front' already"):
        bind(load_config(tmp_path / "vehicle.yaml"))


def test_a_page_that_is_none_is_counted(tmp_path: Path) -> None:
    binding = bound(tmp_path, *LAYOUTS["pages of numbered messages"])
    frames = list(simulate(Scenario.model_validate(SCENARIO), binding, seed=2).frames())
    stray = frames[0]._replace(data=bytes([*frames[0].data[:5], 7 | frames[0].data[5] & 0x30, *frames[0].data[6:]]))
    _, counts = read(binding, [stray, *frames])
    assert counts.surplus == 1
    assert counts.missing == 0


def test_a_list_has_so_many_pages() -> None:
    def form(pages: int) -> ObjectFormat:
        entries = {"messages": ["A{slot}"], "slots": 4 * pages, "pages": {"signal": "P", "count": pages}}
        return ObjectFormat.model_validate(entries)

    assert form(MOST_PAGES).places_on_page == 4
    with pytest.raises(ValidationError, match=f"less than or equal to {MOST_PAGES}"):
        form(MOST_PAGES + 1)
