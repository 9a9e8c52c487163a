"""Loading the configuration: every problem with its file, line, what was found and what was expected."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import jsonschema
import pytest
import yaml

from candaemon.config.base import Settings
from candaemon.config.buses import BusSettings
from candaemon.config.load import LoadedConfig, json_schema, load_config
from candaemon.config.settings import MOST_SENSORS, Config
from candaemon.config.yaml_text import read_yaml
from candaemon.errors import ConfigError
from tests.support.paths import ROOT

CONFIGS = sorted((ROOT / "config").glob("*.yaml"))

MINIMAL = """\
buses: {radar: {channel: can0}}
ego: {kind: static}
sensors:
  front:
    bus: radar
    dbc: my_radar.dbc
    cycle_time: 0.05
    objects: {messages: ["Object_{slot}"], slots: 16, valid: [{signal: Valid, in: [1]}]}
    scan: {close: timeout}
    signals: {x: DistX, y: -DistRight, range_rate: Speed}
    noise: {x: 0.2, y: 0.3, range_rate: 0.1}
"""


def loaded(folder: Path, text: str) -> LoadedConfig:
    path = folder / "vehicle.yaml"
    path.write_text(text, encoding="utf-8")
    return load_config(path)


def problems(folder: Path, text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        loaded(folder, text)
    assert caught.value.exit_code == 2
    lines = str(caught.value).splitlines()
    prefix = f"{folder / 'vehicle.yaml'}"
    assert all(line.startswith(prefix) for line in lines), lines
    return [line.removeprefix(prefix) for line in lines]


def test_a_radar_takes_some_ten_lines(tmp_path: Path) -> None:
    config = loaded(tmp_path, MINIMAL).config
    assert len(MINIMAL.splitlines()) <= 12
    front = config.sensors["front"]
    assert front.signals.y is not None
    assert (front.signals.y.signal, front.signals.y.scale) == ("DistRight", -1.0)
    assert front.objects.messages[0].named(3) == "Object_3"
    assert config.output is None


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("cycle_time: 0.05", "cycle_tme: 0.05", ":7: sensors.front.cycle_tme: found an unknown key"),
        ("slots: 16", 'slots: "16"', ":8: sensors.front.objects.slots: found '16', expected a valid integer"),
        ("cycle_time: 0.05", "cycle_time: fast", ":7: sensors.front.cycle_time: found 'fast', expected a valid number"),
        (
            "cycle_time: 0.05",
            "cycle_time: -1",
            ":7: sensors.front.cycle_time: found -1, expected greater than or equal to 0.001",
        ),
        ("channel: can0", "channel: 0", ":1: buses.radar.channel: found 0, expected text; write it in quotes"),
        ("channel: can0", "channel: can0, fd: yes", ":1: buses.radar.fd: found 'yes', expected true or false"),
        ("bus: radar", "bus: radr", ":5: sensors.front.bus: found bus 'radr', expected one of radar; did you mean"),
        ("kind: static", "kind: statik", "; did you mean 'static'?"),
        ("{kind: static}", "{}", ":2: ego.kind: missing"),
        ("close: timeout", "close: timeout, signal: A", ":9: sensors.front.scan.signal: found an unknown key 'signal'"),
        ("Object_{slot}", "Object_{slt}", "has braces that are not {slot}"),
        ("Object_{slot}", "Object", "put {slot} into its name or give its id_signal"),
        (
            "noise: {x: 0.2, y",
            "noise: {y",
            ":11: sensors.front.noise.x: missing, for signals.x is measured; expected one standard deviation",
        ),
        (
            "noise: {",
            "noise: {azimuth_deg: 1, ",
            ":11: sensors.front.noise.azimuth_deg: given, but no signal gives signals.azimuth",
        ),
        (
            "noise: {x",
            "noise: {xx",
            ":11: sensors.front.noise.xx: found an unknown key 'xx', expected one of azimuth_deg, correlation, range, ",
        ),
        ("range_rate: 0", "rate: 0", ":11: sensors.front.noise.rate: found an unknown key"),
        ("range_rate: 0", "rate: 0", "; did you mean 'range_rate'?"),
        ("noise: {", "noise: 0.2 # {", ":11: sensors.front.noise: found 0.2, expected a mapping of azimuth_deg, "),
        (
            "scan: {close: timeout}",
            "scan: timout",
            "mapping with close, one of counter, trigger, header, timeout; did you mean '{close: timeout}'?",
        ),
        (
            "scan: {close: timeout}",
            "scan: {clos: timeout}",
            "expected one of counter, trigger, header, timeout; found 'clos', did you mean 'close'?",
        ),
        ("scan: {close: timeout}", "scan:", ":9: sensors.front.scan: found nothing, expected a mapping with close, "),
        ("close: timeout", "close: headr", ":9: sensors.front.scan.close: found 'headr', expected one of counter, "),
        (
            "ego: {kind: static}",
            "ego: odometry",
            ":2: ego: found 'odometry', expected a mapping with kind, one of ins, odometry, static; did you mean",
        ),
        ("ego: ", "tracker: {estimator: imm}\nego: ", "tracker.estimator: found 'imm', expected a mapping with kind, "),
        (
            "ego: ",
            "tracker: {estimator: {kind: imm, models: [ca]}}\nego: ",
            "models[0]: found 'ca', expected a mapping with kind, ",
        ),
        ("in: [1]", "in: 1", "valid[0].in: found 1, expected a list; write [a, b], also of one (numbers"),
        ("in: [1]", "in: [new]", "valid[0].in[0]: found 'new', expected a valid number (numbers that pass; the DBC's "),
        ("[{signal: Valid, in: [1]}]", "{signal: Valid}", "found a mapping, expected a list; write [a, b], also"),
        ("time: 0.05", "time: 50ms", "cycle_time: found '50ms', expected a valid number (s between scans)"),
        ('["Object_{slot}"]', "[Object_{slot}]", '; a name with {…} is text in quotes, such as "TRACK_{slot}"'),
        ('["Object_{slot}"]', '"Object_{slot}"', "found 'Object_{slot}', expected a list; write [a, b], also of one"),
        ("in: [1]", "on: [1]", ":8: sensors.front.objects.valid[0].on: found an unknown key 'on'"),
        ("{signal: Valid, in: [1]}", "{signal: Valid}", "the condition tests nothing"),
        ("x: DistX", "x: {signal: DistX, unit: furlong}", ":10: sensors.front.signals.x.unit: found 'furlong'"),
        ("{x: DistX, y", "{y", "no position; give x and y, or range and azimuth"),
        ("range_rate: Speed", "range_rate: {signal: Speed, scale: 0}", "scale 0 makes the signal a constant"),
        ("{channel: can0}", "{channel: can0}, b: {channel: can0}", ":1: buses.b.channel: channel 'can0' is bus"),
        ("ego: ", "groups: {g: {sensors: [rear]}}\nego: ", ":2: groups.g.sensors[0]: found sensor 'rear'"),
        (
            "ego: ",
            "groups: {g: {sensors: [front]}, h: {sensors: [front]}}\nego: ",
            ":2: groups.h.sensors[0]: sensor 'front' is in group 'g' already",
        ),
    ],
)  # fmt: skip
def test_problem_is_told_with_its_line(tmp_path: Path, old: str, new: str, expected: str) -> None:
    text = MINIMAL.replace(old, new, 1)
    assert text != MINIMAL
    assert any(expected in line for line in problems(tmp_path, text))


def test_a_scan_takes_a_millisecond(tmp_path: Path) -> None:
    shortest = loaded(tmp_path, MINIMAL.replace("cycle_time: 0.05", "cycle_time: 0.001"))
    assert shortest.config.sensors["front"].cycle_time == 0.001
    assert problems(tmp_path, MINIMAL.replace("cycle_time: 0.05", "cycle_time: 0.0009"))


def test_a_configuration_has_63_sensors_at_most(tmp_path: Path) -> None:
    """A bit each of a number with a sign tells who saw an obstacle; the log of the 64th could not be tracked."""
    told = yaml.safe_load(MINIMAL)
    front = told["sensors"]["front"]
    told["sensors"] = {f"radar {k}": front for k in range(MOST_SENSORS)}
    assert len(loaded(tmp_path, yaml.safe_dump(told)).config.sensors) == MOST_SENSORS
    told["sensors"]["one more"] = front
    (problem,) = problems(tmp_path, yaml.safe_dump(told))
    assert "63" in problem


def test_unknown_key_suggests_the_near_one(tmp_path: Path) -> None:
    lines = problems(tmp_path, MINIMAL.replace("cycle_time", "cycle_tme"))
    assert any(line.endswith("did you mean 'cycle_time'?") for line in lines)
    assert ":7: sensors.front.cycle_time: missing; expected: s between scans" not in lines  # its line is the sensor's
    assert ":4: sensors.front.cycle_time: missing; expected: s between scans" in lines


def test_all_problems_are_told_at_once_in_order(tmp_path: Path) -> None:
    text = MINIMAL.replace("can0", "0").replace("slots: 16", "slots: 0").replace("bus: radar", "bus: 5")
    assert [line.split(":")[1] for line in problems(tmp_path, text)] == ["1", "5", "8"]


@pytest.mark.parametrize(
    ("text", "line", "expected"),
    [
        ("buses: {a: [1}\n", 1, "not valid YAML"),
        ("a: 1\nb:\n\t- 2\n", 3, "not valid YAML"),
        ("a: 1\nb: 2\na: 3\n", 3, "key 'a' is there twice, first in line 1"),
        ("- 1\n- 2\n", 1, "expected a mapping"),
        ("", 1, "expected a mapping"),
        ("a: &x [*x]\n", 1, "alias"),
        ("a: !!python/object:os.system {}\n", 1, "plain values only"),
        ("a: !point 3\n", 1, "tag '!point'"),
        ("? [1, 2]\n: 3\n", 1, "as a key"),
    ],
)
def test_what_is_not_a_plain_mapping_is_told(tmp_path: Path, text: str, line: int, expected: str) -> None:
    path = tmp_path / "vehicle.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert caught.value.line == line
    assert caught.value.file == str(path)
    assert expected in caught.value.message


def test_scalars_are_read_as_yaml_1_2(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(
        "on: no\nrate: 1e-3\ntime: 12:30\nid: 010\nhex: 0x1F\nless: -0x10\nmore: +0xa\nnot: -0x2g\n"
        "flag: true\nnone: ~\ntext: '5'\n"
    )
    values, lines = read_yaml(path)
    assert values == {
        "on": "no", "rate": 1e-3, "time": "12:30", "id": 10, "hex": 31, "less": -16, "more": 10, "not": "-0x2g",
        "flag": True, "none": None, "text": "5"
    }  # fmt: skip
    assert lines["hex",] == 5


def test_merge_keys_never_override(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("base: &base {x: 1, y: 2}\nmore:\n  x: 3\n  <<: *base\n")
    assert read_yaml(path)[0]["more"] == {"x": 3, "y": 2}


def test_missing_file_and_wrong_encoding(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such configuration file"):
        load_config(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="folder"):
        load_config(tmp_path)
    latin = tmp_path / "latin.yaml"
    latin.write_bytes(b"a: 1\nb: \xe4\n")
    with pytest.raises(ConfigError, match="UTF-8") as caught:
        load_config(latin)
    assert caught.value.line == 2


def test_location_skips_what_the_file_lacks(tmp_path: Path) -> None:
    config = loaded(tmp_path, MINIMAL)
    assert config.line_of(("sensors", "front", "scan", "timeout", "close")) == 9
    assert config.line_of(("sensors", "front", "latency")) == 4
    assert config.line_of(("output",)) == 1
    assert config.resolve("../a.dbc") == tmp_path / "../a.dbc"


def test_settings_are_frozen_and_compared_without_a_file() -> None:
    config = Config.model_validate(yaml.safe_load(MINIMAL))
    with pytest.raises(ValueError, match="frozen"):
        config.name = "other"  # type: ignore[misc]  # what must fail at run time too
    broken = yaml.safe_load(MINIMAL.replace("bus: radar", "bus: x"))
    with pytest.raises(ValueError, match=r"sensors\.front\.bus: found bus 'x'"):
        Config.model_validate(broken)


def test_schema_file_is_up_to_date() -> None:
    stored = (ROOT / "config" / "candaemon.schema.json").read_text(encoding="utf-8")
    assert json.loads(stored) == json_schema(), (
        "write it again: python -c 'import json; from candaemon.config.load import json_schema; "
        "print(json.dumps(json_schema(), indent=2, ensure_ascii=False))' > config/candaemon.schema.json"
    )


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_configurations_load_and_fit_the_schema(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# yaml-language-server: $schema=candaemon.schema.json\n")
    assert load_config(path).config.name
    values, _ = read_yaml(path)
    jsonschema.validate(json.loads(json.dumps(values)), json_schema())


def test_schema_refuses_what_loading_refuses() -> None:
    wrong = yaml.safe_load(MINIMAL.replace("cycle_time", "cycle_tme"))
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(wrong, json_schema())
    jsonschema.validate(yaml.safe_load(MINIMAL), json_schema())


@pytest.mark.parametrize("key", ["channel", "log_channel"])
def test_no_bus_is_called_as_ticks_are(key: str) -> None:
    with pytest.raises(ValueError, match="tick"):
        BusSettings.model_validate({"channel": "can0", key: "tick"})


def all_settings(base: type[Settings] = Settings) -> Iterator[type[Settings]]:
    for each in base.__subclasses__():
        yield each
        yield from all_settings(each)


def test_defaults_that_are_not_checked_are_what_checking_them_gives() -> None:
    found = 0
    for settings in all_settings():
        for name, field in settings.model_fields.items():
            if field.default_factory is None:
                continue
            value = field.get_default(call_default_factory=True, validated_data={})
            for each in value if isinstance(value, tuple) else (value,):
                if isinstance(each, Settings):
                    given = each.model_dump(exclude_unset=True, by_alias=True)
                    checked = type(each).model_validate(given)
                    assert repr(each) == repr(checked), f"{settings.__name__}.{name}"
                    assert each == checked
                    found += 1
    assert found > 40
