"""Texts in a configuration: what a format cannot carry is refused, whatever is accepted goes through all of them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily
from prometheus_client.parser import text_string_to_metric_families
from pydantic import TypeAdapter, ValidationError

from candaemon.can_io.logs.candump import candump_text
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import TICK_CHANNEL, LogCounts
from candaemon.cli.arguments import channel_of_bus
from candaemon.config.buses import BusSettings
from candaemon.config.load import json_schema, load_config
from candaemon.config.names import (
    LONGEST_CHANNEL,
    LONGEST_DBC_NAME,
    LONGEST_INTERFACE,
    LONGEST_LINE,
    LONGEST_NAME,
    LONGEST_PATH,
    LONGEST_PROSE,
    Channel,
    DbcName,
    FilePath,
    Line,
    LogChannel,
    Name,
    Prose,
)
from candaemon.config.sensors import ObjectMessage
from candaemon.config.settings import Config
from candaemon.config.yaml_text import read_yaml
from candaemon.errors import LONGEST_MESSAGE, ConfigError
from candaemon.evaluation.tables import NUMBERS, TrackWriter, read_tracks
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import Frame
from candaemon.simulation.scenario import Scenario
from tests.config.test_load import MINIMAL, loaded, problems
from tests.support.effort import examples

HOSTILE = [
    "\n", "\r", "\t", "\x0b", "\x1b", "\x7f", "\x85", "\u2028", "\u2029", "\udcff", "\x00", ":", ";", ",", '"', "'",
    "\\", "#", "/", "=", "*", "%", "$", "[", "\u202e", "\u200b",
]  # fmt: skip
LETTERS = st.one_of(st.sampled_from("aZ0_ .+-äß漢"), st.characters(exclude_categories=()))

names = st.text(LETTERS, min_size=1, max_size=LONGEST_NAME).filter(lambda text: accepts(Name, text))
channels = st.text(LETTERS | st.sampled_from("()[]{}=*%@/:"), min_size=1, max_size=LONGEST_CHANNEL).filter(
    lambda text: accepts(LogChannel, text)
)


def accepts(kind: Any, text: str) -> bool:
    try:
        TypeAdapter(kind).validate_python(text, strict=True)
    except ValidationError:
        return False
    return True


@settings(deadline=None, max_examples=examples(200))
@given(st.lists(channels, min_size=1, max_size=4, unique=True))
def test_a_recording_of_any_channels_reads_back_whole(found: list[str]) -> None:
    buses = [BusSettings(channel="can0", log_channel=each) for each in found]
    frames = [Frame(1_000 * k, k % (len(found) + 1), 0x123, bytes([k]), False) for k in range(100)]
    text = candump_text(frames, [*(bus.names_in_logs[-1] for bus in buses), TICK_CHANNEL])
    folder = Path(_scratch.name)
    (folder / "a.log").write_bytes(text)
    counts = LogCounts()
    read = list(read_log(folder / "a.log", {name: k for k, name in enumerate(found)}, counts))
    assert (counts.malformed, counts.other_channels) == (0, {})
    assert [frame.data for frame in read if frame.bus >= 0] == [f.data for f in frames if f.bus < len(found)]
    assert counts.ticks == sum(frame.bus == len(found) for frame in frames)


@settings(deadline=None, max_examples=examples(100))
@given(st.lists(names, min_size=1, max_size=3, unique=True), channels)
def test_any_names_go_through_tables_metrics_and_arguments(found: list[str], channel: str) -> None:
    folder = Path(_scratch.name)
    one: dict[str, list[Any]] = {
        "id": [1],
        "state": [1],
        "objects": [";".join(f"{name}:7" for name in found)],
        **{column: [0.0] for column in NUMBERS},
    }
    with OutputFile(folder / "t.csv") as file, TrackWriter(file) as table:
        table.write_cycle(0, one)
    assert read_tracks(folder / "t.csv").objects.tolist() == [";".join(f"{name}:7" for name in found)]
    family = CounterMetricFamily("frames", "frames", labels=["bus"])
    for name in found:
        family.add_metric([name], 1.0)
    registry = CollectorRegistry()
    registry.register(_Collected(family))
    (read,) = text_string_to_metric_families(generate_latest(registry).decode())
    assert [sample.labels["bus"] for sample in read.samples] == found
    assert channel_of_bus(f"{channel}={found[0]}") == (channel, found[0])
    assert json.loads(json.dumps(found)) == found
    for name in found:
        (folder / name).touch()
        (folder / name).unlink()


class _Collected:
    """Gives a registry one family."""

    def __init__(self, family: CounterMetricFamily) -> None:
        self._family = family

    def collect(self) -> Iterator[CounterMetricFamily]:
        yield self._family


@pytest.fixture(scope="module", autouse=True)
def _files(tmp_path_factory: pytest.TempPathFactory) -> None:
    _scratch.name = str(tmp_path_factory.mktemp("names"))


class _scratch:  # noqa: N801
    name = ""


@pytest.mark.parametrize("mark", HOSTILE)
def test_a_name_that_a_format_cannot_carry_is_refused_with_its_line(tmp_path: Path, mark: str) -> None:
    name = json.dumps(f"a{mark}b")
    for text, line, key in (
        (MINIMAL.replace("front:", f"{name}:"), 4, "sensors"),
        (MINIMAL.replace("{radar: {channel: can0}}", f"{{{name}: {{channel: can0}}}}"), 1, "buses"),
        (MINIMAL + f"groups: {{{name}: {{sensors: [front]}}}}\n", 12, "groups"),
    ):
        line = line - 1 if mark == "\udcff" and line == 4 else line  # not even a key: told with what it is a key of
        assert any(told.startswith(f":{line}: {key}") and "found" in told for told in problems(tmp_path, text))


@pytest.mark.parametrize(
    "channel", ["a b", " a", "a\nb", "a\x1bb", "a\u2028b", "a#b", "", "tick", "*", "\udcff", "\u200b"]
)
def test_a_channel_that_a_log_cannot_hold_is_refused_with_its_line(tmp_path: Path, channel: str) -> None:
    text = f"interface: pcan, channel: {json.dumps(channel)}"
    (told,) = problems(tmp_path, MINIMAL.replace("channel: can0", text))
    assert told.startswith(":1: buses.radar")
    (told,) = problems(tmp_path, MINIMAL.replace("channel: can0", f"channel: can0, log_channel: {json.dumps(channel)}"))
    assert told.startswith(":1: buses.radar.log_channel: ")


def test_a_channel_with_a_blank_needs_another_name_in_logs(tmp_path: Path) -> None:
    (told,) = problems(tmp_path, MINIMAL.replace("channel: can0", "interface: vector, channel: '0, 1'"))
    assert "found '0, 1', which has a blank or '#', where a log's channel ends; give the bus a log_channel" in told
    bus = loaded(
        tmp_path, MINIMAL.replace("channel: can0", "interface: vector, channel: '0, 1', log_channel: can0")
    ).config.buses["radar"]
    assert bus.names_in_logs == ("0, 1", "can0")


@pytest.mark.parametrize("channel", ["c" * (LONGEST_INTERFACE + 1), "ä" * 8, "a/b", "a:b", ".."])
def test_a_socketcan_channel_is_a_network_interface(tmp_path: Path, channel: str) -> None:
    loaded(tmp_path, MINIMAL.replace("can0", "c" * LONGEST_INTERFACE))
    (told,) = problems(tmp_path, MINIMAL.replace("can0", f"'{channel}'"))
    assert told.startswith(":1: buses.radar: channel: found ")
    assert "a network interface has" in told


@pytest.mark.parametrize(
    ("kind", "longest"),
    [(Name, LONGEST_NAME), (Channel, LONGEST_CHANNEL), (LogChannel, LONGEST_CHANNEL), (DbcName, LONGEST_DBC_NAME),
     (FilePath, LONGEST_PATH), (Line, LONGEST_LINE), (Prose, LONGEST_PROSE)],
)  # fmt: skip
def test_a_text_is_as_long_as_its_limit_and_no_longer(kind: Any, longest: int) -> None:
    assert accepts(kind, "a" * longest)
    assert not accepts(kind, "a" * (longest + 1))


@pytest.mark.parametrize(
    ("name", "third"),
    [
        ("A{slot}", "A3"),
        ("A{slot:02d}_{slot}", "A03_3"),
        ("A{slot:x}", "A3"),
        ("A{slot:09d}", "A000000003"),
        ("A", "A"),
    ],
)
def test_a_slots_number_takes_nine_digits_at_most(name: str, third: str) -> None:
    assert ObjectMessage(message=name).named(3) == third


@pytest.mark.parametrize(
    "name",
    ["A{slot:999999999d}", "A{slot:10d}", "A{slot:>9}", "A{slot.real}", "A{slot!r}", "A{slot[0]}", "A{}", "A{0}",
     "A{slot", "A}", "{{slot}}", "A{slot:{slot}}"],
)  # fmt: skip
def test_any_other_form_of_a_slots_number_is_refused(tmp_path: Path, name: str) -> None:
    told = problems(tmp_path, MINIMAL.replace("Object_{slot}", name))
    assert any(line.startswith(":8: sensors.front.objects.messages[0]") and "has braces that" in line for line in told)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("{foo: 1}", "options: found foo, expected one of port, hop_limit"),
        ("{port: 65536}", "options.port: found 65536, expected a whole number from 1 to 65535"),
        ("{port: 1.5}", "options.port: found 1.5, expected a whole number"),
        ("{hop_limit: true}", "options.hop_limit: found True, expected a whole number"),
        ("{channel: x}", "options: found channel, which candaemon sets itself; remove it here"),
    ],
)
def test_an_option_that_no_bus_takes_is_refused_with_its_line(tmp_path: Path, options: str, told: str) -> None:
    bus = f"interface: udp_multicast, options: {options}, channel: 239.0.0.1"
    assert f":1: buses.radar: {told}" in problems(tmp_path, MINIMAL.replace("channel: can0", bus))[0]


def _strings(schema: Any, place: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield each form of a text in a schema, and of the keys of a mapping, with its place."""
    if isinstance(schema, list):
        for each in schema:
            yield from _strings(each, place)
    elif isinstance(schema, dict):
        if schema.get("type") == "string":
            yield place, schema
        if "additionalProperties" in schema and schema["additionalProperties"] is not False:
            yield f"{place}, key", {"type": "string"} | schema.get("propertyNames", {})
        for key, each in schema.items():
            if key not in {"propertyNames", "default"}:
                yield from _strings(each, f"{place}.{key}")


@pytest.mark.parametrize("schema", [json_schema(), Scenario.model_json_schema()], ids=["configuration", "scenario"])
def test_every_text_is_bounded_or_one_of_a_few(schema: dict[str, Any]) -> None:
    found = list(_strings(schema))
    assert len(found) >= 3
    free = [place for place, form in found if not form.keys() & {"enum", "const", "maxLength", "$ref"}]
    assert free == []


def test_a_message_about_a_long_text_is_short(tmp_path: Path) -> None:
    (told,) = problems(tmp_path, MINIMAL.replace("channel: can0", f"channel: {'a' * 100_000}"))
    assert len(told) < 1000
    assert told.endswith("expected at most 128 characters")


def test_a_long_message_loses_its_middle() -> None:
    assert ConfigError("a" * LONGEST_MESSAGE).message == "a" * LONGEST_MESSAGE
    text = f"found {'a' * 30_000_000}; choose a shorter one"
    message = ConfigError(text).message
    assert len(message) == LONGEST_MESSAGE + 3
    assert message.startswith("found a")
    assert message.endswith("a; choose a shorter one")


def test_what_a_yaml_file_escapes_is_refused_too(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text('name: "\\u001b[31m"\n', encoding="utf-8")
    assert read_yaml(path)[0] == {"name": "\x1b[31m"}
    with pytest.raises(ConfigError, match=r"a\.yaml:1: name: found '\\x1b\[31m', expected text on one line"):
        load_config(path)


def test_shown_texts_may_have_any_letters() -> None:
    config = Config.model_fields
    assert config["name"].default == ""
    assert accepts(Line, "A\u00a0b")  # a no-break space
    assert accepts(Prose, "one\n\ttwo\n")
    assert not accepts(Line, "one\ntwo")
    assert not accepts(Prose, "one\rtwo")
