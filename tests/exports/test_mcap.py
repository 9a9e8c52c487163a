"""A drive in MCAP, read back by that format's library: each message by its schema, in order, as the tables have it."""

from __future__ import annotations

import json
import re
import sys
from collections import Counter, defaultdict
from dataclasses import dataclass
from math import hypot
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pyarrow.parquet as pq
import pytest
from google.protobuf import unknown_fields
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.cli.main import main
from candaemon.errors import InputError
from candaemon.evaluation.detection_columns import FATES
from candaemon.exports.foxglove_layout import layout
from candaemon.exports.mcap_drive import CHUNK_BYTES, McapDrive, topics
from candaemon.exports.scene_messages import ellipses
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import EXTENDED
from candaemon.playback.replay import ReplayRequest, replay
from tests.support.bound import binding
from tests.support.paths import ROOT

SHORT = (
    "duration: 4\nego: {start: {speed: 20}}\nactors: [{name: lead, start: {x: 40, y: 0, vx: 20, vy: 0}},"
    "{name: van, start: {x: 25, y: 3.5, vx: 22, vy: 0}}]\n"
)
CONFIG = "esr_ins_fd"
RECORDED = ROOT.parent / "shared" / "data" / "rav4_drive" / "drive.log.gz"


@dataclass(frozen=True)
class Message:
    """A message that was read back."""

    topic: str
    schema: str
    log_ns: int
    content: Any


@dataclass(frozen=True)
class Drive:
    """A folder with a replayed drive, and its messages in the file's order."""

    folder: Path
    messages: list[Message]

    def on(self, topic: str) -> list[Message]:
        return [message for message in self.messages if message.topic == topic]


def read_back(path: Path) -> list[Message]:
    """Read every message by its schema: a protobuf must parse without a field left over, JSON must be valid."""
    found, checks = [], {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if schema.encoding == "jsonschema":
                if schema.id not in checks:
                    form = json.loads(schema.data)
                    jsonschema.Draft202012Validator.check_schema(form)
                    checks[schema.id] = jsonschema.Draft202012Validator(form)
                content = json.loads(message.data)
                checks[schema.id].validate(content)
            else:
                decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
                assert decode is not None
                content = decode(message.data)
                assert content.DESCRIPTOR.full_name == schema.name
                assert not len(unknown_fields.UnknownFieldSet(content))
            found.append(Message(channel.topic, schema.name, message.log_time, content))
    return found


def outputs(folder: Path) -> list[str]:
    return ["--mcap", str(folder / "d.mcap"), "--layout", str(folder / "l.json"), "--parquet", str(folder / "tables")]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    folder = tmp_path_factory.mktemp("drive")
    (folder / "short.yaml").write_text(SHORT, encoding="utf-8")
    assert main(["simulate", str(folder / "short.yaml"), CONFIG, "-o", str(folder / "drive.log")]) == 0
    assert main(["replay", CONFIG, str(folder / "drive.log"), *outputs(folder)]) == 0
    return Drive(folder, read_back(folder / "d.mcap"))


def time_ns(stamp: Any) -> int:
    """Return the time of a message: in JSON, or as protobuf has it."""
    if isinstance(stamp, dict):
        return int(stamp["sec"] * 10**9 + stamp["nsec"])
    return int(stamp.seconds * 10**9 + stamp.nanos)


def test_messages_are_in_order_and_on_the_topics_that_are_told(drive: Drive) -> None:
    times = [message.log_ns for message in drive.messages]
    assert times == sorted(times)
    told = topics(binding(CONFIG))
    sent = next(topic.removeprefix("/sent/") for topic in told if topic.startswith("/sent/"))
    assert told.keys() - {message.topic for message in drive.messages} == {f"/can/{sent}"}
    for message in drive.messages:
        form = told[message.topic]
        assert message.schema == (f"foxglove.{form}" if isinstance(form, str) else form["title"])


def test_every_frame_is_there_as_it_came(drive: Drive) -> None:
    channels = {name: bus.index for bus in binding(CONFIG).buses for name in bus.settings.names_in_logs}
    names = [bus.name for bus in binding(CONFIG).buses]
    frames = list(read_log(drive.folder / "drive.log", channels, LogCounts()))
    found = [message for message in drive.messages if message.topic.startswith("/can/")]
    assert len(found) == len(frames) > 1000
    for frame, message in zip(frames, found, strict=True):
        said = message.content
        assert message.topic == f"/can/{names[frame.bus]}"
        assert message.log_ns == time_ns(said["timestamp"]) == frame.time_ns
        assert (said["bus"], said["id"]) == (names[frame.bus], frame.can_id & ~EXTENDED)
        assert (said["extended"], said["fd"]) == (bool(frame.can_id & EXTENDED), frame.fd)
        assert bytes.fromhex(said["data"]) == frame.data


def test_obstacles_are_those_of_the_table(drive: Drive) -> None:
    rows: defaultdict[int, dict[str, Any]] = defaultdict(dict)
    for row in pq.read_table(drive.folder / "tables" / "tracks.parquet").to_pylist():
        rows[row["time_ns"]][str(row["id"])] = row
    compared, arrows = 0, 0
    alive: set[str] = set()
    for message in drive.on("/obstacles"):
        update = message.content
        for deleted in update.deletions:
            alive.remove(deleted.id)
        for entity in update.entities:
            alive.add(entity.id)
            row = rows[time_ns(entity.timestamp)][entity.id]
            (cube,), (text,) = entity.cubes, entity.texts
            assert entity.frame_id == "vehicle"
            assert cube.pose.position.x == pytest.approx(row["center_x"])
            assert cube.pose.position.y == pytest.approx(row["center_y"])
            assert (cube.size.x, cube.size.y) == pytest.approx(
                (row["length"] or 0.6, row["width"] or 0.6) if row["length"] and row["width"] else (0.6, 0.6)
            )
            assert text.text.startswith(f"{entity.id}: ")
            speed = hypot(row["vx"], row["vy"])
            assert len(entity.arrows) == (speed > 0.5)
            for arrow in entity.arrows:
                assert arrow.shaft_length == pytest.approx(speed)
                half = np.arctan2(row["vy"], row["vx"]) / 2
                assert (arrow.pose.orientation.z, arrow.pose.orientation.w) == pytest.approx(
                    (np.sin(half), np.cos(half))
                )
                arrows += 1
            assert {pair.key: pair.value for pair in entity.metadata}["state"] == row["state"]
            compared += 1
        now = {entity.id for entity in update.entities}
        assert alive == now, "what is not there is deleted"
    assert compared == sum(map(len, rows.values())) > 50
    assert arrows > 50


def test_numbers_for_plots_are_those_of_the_table(drive: Drive) -> None:
    table = pq.read_table(drive.folder / "tables" / "tracks.parquet").drop_columns(["time", "time_ns"]).to_pylist()
    assert [row for message in drive.on("/obstacles/states") for row in message.content["obstacles"]] == table
    cycles = pq.read_table(drive.folder / "tables" / "cycles.parquet").to_pylist()
    told = [{**message.content} for message in drive.on("/cycles")]
    assert [time_ns(cycle.pop("timestamp")) for cycle in told] == [cycle.pop("time_ns") for cycle in cycles]
    for cycle in cycles:
        del cycle["time"]
    assert told == cycles


def test_detections_are_those_of_the_table(drive: Drive) -> None:
    rows = pq.read_table(drive.folder / "tables" / "detections.parquet").to_pylist()
    found: list[Any] = []
    for message in drive.on("/detections/front"):
        cloud = message.content
        kinds = {1: "u1", 6: "<i4", 7: "<f4", 8: "<f8"}
        form = np.dtype(
            {
                "names": [field.name for field in cloud.fields],
                "formats": [kinds[field.type] for field in cloud.fields],
                "offsets": [field.offset for field in cloud.fields],
                "itemsize": cloud.point_stride,
            }
        )
        found += [(time_ns(cloud.timestamp), each) for each in np.frombuffer(cloud.data, form)]
    assert len(found) == len(rows) > 50
    for row, (time, point) in zip(rows, found, strict=True):
        assert time == row["time_ns"]
        assert (point["x"], point["y"]) == pytest.approx((row["x"], row["y"]), rel=1e-6, abs=1e-6)
        assert point["object"] == row["object"]
        assert point["obstacle"] == (-1 if row["id"] is None else row["id"])
        assert FATES[point["fate"]] == row["fate"]


def test_the_own_vehicle_is_where_the_cycles_say(drive: Drive) -> None:
    cycles = {row["time_ns"]: row for row in pq.read_table(drive.folder / "tables" / "cycles.parquet").to_pylist()}
    poses = drive.on("/pose")
    assert len(poses) > 50
    for message in poses:
        row, place = cycles[time_ns(message.content.timestamp)], message.content.pose.position
        assert (place.x, place.y) == (row["east"], row["north"])
    fixes = drive.on("/location")
    assert len(fixes) > 30
    for message in fixes:
        row = cycles[time_ns(message.content.timestamp)]
        assert (message.content.latitude, message.content.longitude) == (row["latitude"], row["longitude"])
    assert any(message.content.fixes for message in drive.on("/obstacles/locations"))
    for message in drive.on("/tf"):
        children = {each.child_frame_id: each.parent_frame_id for each in message.content.transforms}
        assert children == {"vehicle": "local", "sensor/front": "vehicle"}


def test_the_own_vehicle_and_what_its_sensors_see_is_told_once(drive: Drive) -> None:
    (message,) = drive.on("/own_vehicle")
    (entity,) = message.content.entities
    (line,) = entity.lines
    settings = binding(CONFIG).sensors[0].settings
    (field,) = settings.views.values()
    far = [hypot(point.x - settings.mount.x, point.y - settings.mount.y) for point in line.points]
    assert far[0] == 0
    assert far[1:] == pytest.approx([field.range] * (len(far) - 1))


def test_what_is_lost_is_told(drive: Drive, tmp_path: Path) -> None:
    lines = (drive.folder / "drive.log").read_text(encoding="utf-8").splitlines(keepends=True)
    radar = re.compile(r" 5[0-3][0-9A-F]#| 4E[0-3]#")
    damaged = [line for k, line in enumerate(lines) if not (radar.search(line) and 2000 <= k < 3500)]
    assert len(damaged) < len(lines)
    (tmp_path / "drive.log").write_text("".join(damaged), encoding="utf-8")
    assert main(["replay", CONFIG, str(tmp_path / "drive.log"), *outputs(tmp_path)]) == 0
    told = [each.content.message for each in read_back(tmp_path / "d.mcap") if each.topic == "/diagnostics"]
    assert "every sensor is silent, obstacles coast" in told
    assert told.index("scans come again") > told.index("every sensor is silent, obstacles coast")
    assert not any("silent" in each.content.message for each in drive.on("/diagnostics"))


def test_the_same_drive_gives_the_same_bytes(drive: Drive, tmp_path: Path) -> None:
    assert main(["replay", CONFIG, str(drive.folder / "drive.log"), *outputs(tmp_path)]) == 0
    assert (tmp_path / "d.mcap").read_bytes() == (drive.folder / "d.mcap").read_bytes()
    assert (tmp_path / "l.json").read_bytes() == (drive.folder / "l.json").read_bytes()


@pytest.mark.slow
def test_a_pace_gives_the_same_messages(drive: Drive, tmp_path: Path) -> None:
    arguments = ["replay", CONFIG, str(drive.folder / "drive.log"), "--mcap", str(tmp_path / "d.mcap")]
    assert main([*arguments, "--speed", "1000"]) == 0
    assert Counter(each.topic for each in read_back(tmp_path / "d.mcap")) == Counter(
        each.topic for each in drive.messages
    )


def test_the_layout_shows_topics_that_are_there(drive: Drive) -> None:
    text = (drive.folder / "l.json").read_text(encoding="utf-8")
    assert text == layout(binding(CONFIG))
    named = set(re.findall(r'"(/[\w/]+)', text))
    assert named
    assert named <= topics(binding(CONFIG)).keys()
    for topic, field in re.findall(r'"(/cycles)\.(\w+)"', text):
        assert field in drive.on(topic)[0].content
    assert {"ThreeDee", "Log", "Plot", "Map", "RawMessages"} <= set(re.findall(r'"panelType":"(\w+)"', text))


def test_a_chunk_is_as_long_as_its_limit(drive: Drive) -> None:
    with (drive.folder / "d.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    sizes = [chunk.uncompressed_size for chunk in summary.chunk_indexes]
    assert len(sizes) > 1
    # a message that does not fit any more ends the chunk
    assert all(CHUNK_BYTES / 2 < size < CHUNK_BYTES * 1.1 for size in sizes[:-1])


def test_a_full_disk_is_an_error_and_no_crash(drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full:
        def write(self, _data: bytes) -> int:
            raise InputError("cannot be written: no space left", file=tmp_path / "d.mcap")

    monkeypatch.setattr(OutputFile, "stream", Full())
    with OutputFile(tmp_path / "d.mcap") as file:
        sink = McapDrive(binding(CONFIG), file)
        with pytest.raises(InputError, match="no space left"):
            replay(binding(CONFIG), ReplayRequest(drive.folder / "drive.log"), sinks=[sink])


def test_a_missing_library_is_named_with_its_extra(
    drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "foxglove"]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, "foxglove", None)
    for option in ("--mcap", "--layout"):
        assert main(["replay", CONFIG, str(drive.folder / "drive.log"), option, str(tmp_path / "new")]) == 2
        assert "pip install 'candaemon[foxglove]'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_ellipses_are_the_covariances() -> None:
    rng = np.random.default_rng(7)
    root = rng.normal(size=(50, 2, 2))
    covariance = root @ np.swapaxes(root, 1, 2)
    major, minor, turn = ellipses(covariance).T
    axes = np.stack([np.stack([np.cos(turn), -np.sin(turn)], -1), np.stack([np.sin(turn), np.cos(turn)], -1)], -2)
    spread = np.zeros((50, 2, 2))
    spread[:, 0, 0], spread[:, 1, 1] = major**2, minor**2
    assert axes @ spread @ np.swapaxes(axes, 1, 2) == pytest.approx(covariance)
    assert (major >= minor).all()


@pytest.mark.slow
@pytest.mark.skipif(not RECORDED.exists(), reason="the recorded drive is not there")
def test_the_recorded_drive_is_read_back_whole(tmp_path: Path) -> None:
    assert main(["replay", "toyota_rav4", str(RECORDED), *outputs(tmp_path)]) == 0
    whole = Drive(tmp_path, read_back(tmp_path / "d.mcap"))
    times = [message.log_ns for message in whole.messages]
    assert times == sorted(times)
    assert len(whole.on("/can/car")) + len(whole.on("/can/radar")) == 135468
    test_obstacles_are_those_of_the_table(whole)
