"""`.blf`: the frames that python-can reads, and of a damaged file all that is whole."""

from __future__ import annotations

import struct
import time
import zlib
from itertools import pairwise
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.can_io.logs.blf import LONGEST_CONTAINER, LONGEST_OBJECT
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.can_io.python_can import to_frame
from candaemon.frames.frame import EXTENDED, Frame
from tests.support.effort import examples

START = 1_533_226_488_434_433_000
ANY = {"*": 0}
HEADER = 144  # bytes of the file's header
FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)

ids = st.integers(0, 0x7FF).map(lambda i: (i, False)) | st.integers(0, 0x1FFF_FFFF).map(lambda i: (i, True))


@st.composite
def messages(draw: st.DrawFn) -> can.Message:
    """Draw a message of any kind."""
    number, extended = draw(ids)
    kind = draw(st.sampled_from(["data", "data", "fd", "remote", "error"]))
    size = draw(st.sampled_from(FD_LENGTHS if kind == "fd" else range(9)))
    return can.Message(
        timestamp=draw(st.integers(0, 10**15)) / 1e6,
        arbitration_id=number,
        is_extended_id=extended,
        channel=draw(st.integers(0, 4)),
        is_fd=kind == "fd",
        is_remote_frame=kind == "remote",
        is_error_frame=kind == "error",
        dlc=size,
        data=None
        if kind == "remote"
        else draw(st.binary(min_size=size, max_size=size) | st.just(b"LOBJ".ljust(size, b"\0")[:size])),
        bitrate_switch=kind == "fd",
    )


def read(path: Path, content: bytes | None = None) -> tuple[list[Frame], LogCounts]:
    if content is not None:
        path.write_bytes(content)
    counts = LogCounts()
    found = list(read_log(path, ANY, counts))
    balance = counts.frames + counts.malformed + counts.remote + counts.error_frames + counts.other_lines
    assert counts.lines == balance + sum(counts.other_channels.values())
    assert counts.frames == len(found)
    return found, counts


def by_python_can(path: Path) -> list[Frame]:
    with can.BLFReader(path) as reader:
        return [to_frame(m, 0) for m in reader if not (m.is_error_frame or m.is_remote_frame)]


def written(path: Path, number: int, *, level: int = -1, size: int = 1 << 17) -> list[Frame]:
    """Write frames into containers of some size; return them."""
    rng = np.random.default_rng(1)
    frames = [Frame(START + k * 1_000_000, k % 2, 0x100 + k % 99, rng.bytes(8)) for k in range(number)]
    with can.BLFWriter(path, compression_level=level) as writer:
        writer.max_container_size = size
        for frame in frames:
            writer.on_message_received(
                can.Message(timestamp=frame.time_ns / 1e9, arbitration_id=frame.can_id, is_extended_id=False,
                            data=frame.data, channel=frame.bus)
            )  # fmt: skip
    return [frame._replace(bus=0) for frame in frames]


def containers(content: bytes) -> list[int]:
    """Return where the containers of a sound file begin."""
    places, at = [], HEADER
    while at < len(content):
        places.append(at)
        (size,) = struct.unpack_from("<L", content, at + 8)
        at += size + size % 4
    return places


@settings(deadline=None, max_examples=examples(200))
@given(
    drawn=st.lists(messages(), max_size=60),
    level=st.sampled_from([0, 1, 9]),
    size=st.sampled_from([200, 1000, 1 << 17]),
)
def test_frames_are_those_that_python_can_reads(
    drawn: list[can.Message], level: int, size: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "drawn.blf"
    with can.BLFWriter(path, compression_level=level) as writer:
        writer.max_container_size = size
        for message in drawn:
            writer.on_message_received(message)
    found, counts = read(path)
    assert found == by_python_can(path)
    assert (counts.lines, counts.malformed, counts.truncated) == (len(drawn), 0, False)
    assert counts.remote == sum(message.is_remote_frame for message in drawn)
    assert counts.error_frames == sum(message.is_error_frame for message in drawn)


def packed(*objects: bytes, method: int = 2, extra: int = 0) -> bytes:
    """Return a container of objects."""
    content = b"".join(objects)
    data = zlib.compress(content) if method == 2 else content
    head = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32 + len(data) + extra, 10, method, len(content))
    return head + data + bytes((32 + len(data)) % 4)


def blf(*parts: bytes) -> bytes:
    """Return a file of containers, with its header."""
    size = HEADER + sum(map(len, parts))
    head = struct.pack("<4sL8xQ16x8H16x", b"LOGG", HEADER, size, 2018, 8, 4, 2, 16, 14, 48, 434)
    return head.ljust(HEADER, b"\0") + b"".join(parts)


def obj(kind: int, body: bytes, *, flags: int = 2, ticks: int = 5_000_000, version: int = 1, size: int = 0) -> bytes:
    """Return an object, padded."""
    header = 32 if version == 1 else 40
    size = size or header + len(body)
    head = struct.pack("<4sHHLLL4xQ", b"LOBJ", header, version, size, kind, flags, ticks)
    return head.ljust(header, b"\0") + body + bytes(size % 4 if size < 1000 else 0)


def classic(channel: int = 1, data: bytes = bytes(8), number: int = 0x123) -> bytes:
    return struct.pack("<HBBL8s", channel, 0, len(data), number, data)


def fd64(channel: int, code: int, size: int, data: bytes, *, flags: int = 0x1000, extension: int = 0) -> bytes:
    return (
        struct.pack("<BBBBLLLLLLLHBBL", channel, code, size, 0, 0x123, 0, flags, 0, 0, 0, 0, 0, 0, extension, 0) + data
    )


def fd(channel: int, code: int, size: int, data: bytes) -> bytes:
    return struct.pack("<HBBLLBBB5x64s", channel, 0, code, 0x123, 0, 0, 1, size, data)


@pytest.mark.parametrize("method", [0, 2])
@pytest.mark.parametrize("version", [1, 2])
def test_every_kind_of_object(tmp_path: Path, method: int, version: int) -> None:
    objects = [
        obj(1, classic(), version=version),
        obj(86, classic(2, b"\x01\x02") + bytes(8), version=version),
        obj(86, classic(), flags=1, ticks=123_456, version=version),
        obj(100, fd(1, 13, 32, bytes(range(32))), version=version),
        obj(101, fd64(1, 15, 64, bytes(range(64))), version=version),
        obj(101, fd64(1, 9, 12, bytes(range(7))), version=version),
        obj(101, fd64(1, 2, 2, b"ab" + bytes(10), extension=(74 if version == 1 else 82)), version=version),
        obj(101, fd64(1, 2, 2, b"", flags=0x1010), version=version),
        obj(73, bytes([1, 0]) + bytes(30), version=version),
        obj(1, classic(number=0x8000_0000 | 0x1234567), version=version),
    ]
    path = tmp_path / "a.blf"
    content = blf(packed(*objects[:4], method=method), packed(*objects[4:], method=method))
    found, counts = read(path, content)
    assert found == by_python_can(path)
    assert (len(found), counts.remote, counts.error_frames, counts.malformed) == (8, 1, 1, 0)
    assert [frame.time_ns % 10**10 for frame in found[:3]] == [8_439_000_000, 8_439_000_000, 9_668_560_000]
    assert found[-1].can_id == EXTENDED | 0x1234567


def test_other_objects_are_counted(tmp_path: Path) -> None:
    other = obj(96, b"a comment that holds LOBJ" + bytes(16))
    beside = obj(96, bytes(4))
    content = blf(packed(other, obj(1, classic())), beside, packed(obj(1, classic()), other))
    found, counts = read(tmp_path / "a.blf", content)
    assert (len(found), counts.other_lines, counts.malformed, counts.truncated) == (2, 3, 0, False)


@pytest.mark.parametrize("channel", [0, 1, 65535])
def test_absurd_channels_are_nobodys(tmp_path: Path, channel: int) -> None:
    path = tmp_path / "a.blf"
    path.write_bytes(blf(packed(obj(1, classic(channel)))))
    counts = LogCounts()
    assert list(read_log(path, {"can7": 0}, counts)) == []
    assert counts.other_channels == {str(channel - 1): 1}


@pytest.mark.parametrize("level", [0, -1])
def test_a_payload_that_looks_like_an_object_cuts_nothing(tmp_path: Path, level: int) -> None:
    path = tmp_path / "a.blf"
    marks = [b"LOBJ\0\0\0\0", b"LOBJ" * 2, b"LOBJ\x10\0\x01\0"]
    with can.BLFWriter(path, compression_level=level) as writer:
        for k in range(300):
            writer.on_message_received(can.Message(timestamp=1.5e9 + k, data=marks[k % 3], channel=0))
    found, counts = read(path)
    assert (len(found), counts.malformed, counts.truncated) == (300, 0, False)


@pytest.mark.parametrize("level", [0, -1])
def test_a_damaged_container_size_loses_nothing(tmp_path: Path, level: int) -> None:
    path = tmp_path / "a.blf"
    frames = written(path, 8000, level=level)
    content = path.read_bytes()
    for place in containers(content):
        for bit in (0, 3, 12, 17, 23, 31):
            damaged = bytearray(content)
            damaged[place + 8 + bit // 8] ^= 1 << bit % 8
            found, counts = read(path, bytes(damaged))
            assert len(found) == 8000, (place, bit)
            assert counts.malformed == 1 or (bit < 4 and place == containers(content)[-1])
            assert set(found) <= set(frames)


def test_a_damaged_container_loses_its_own_frames(tmp_path: Path) -> None:
    path = tmp_path / "a.blf"
    frames = written(path, 2000, size=10_000)
    content = path.read_bytes()
    places = containers(content)
    assert len(places) == 10
    rng = np.random.default_rng(2)
    for begin, end in pairwise(places):
        damaged = bytearray(content)
        damaged[int(rng.integers(begin + 40, end - 8))] ^= 0x10
        found, counts = read(path, bytes(damaged))
        assert 2000 - 10_000 // 48 - 3 <= len(found) < 2000
        assert counts.malformed >= 1
        assert "container" in counts.examples[0]
        assert set(found) <= set(frames)


@settings(deadline=None, max_examples=examples(300))
@given(
    changes=st.lists(st.tuples(st.integers(0, 1 << 20), st.integers(0, 255)), min_size=1, max_size=8),
    cut=st.none() | st.integers(0, 1 << 20),
    level=st.sampled_from([0, 1]),
)
def test_any_damage_is_counted(
    changes: list[tuple[int, int]], cut: int | None, level: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / f"damaged{level}.blf"
    written(path, 300, level=level, size=2_000)
    content = bytearray(path.read_bytes())
    for place, value in changes:
        content[place % len(content)] = value
    read(path, bytes(content if cut is None else content[: cut % len(content)]))


@settings(deadline=None, max_examples=examples(300))
@given(place=st.integers(0, 299), field=st.integers(0, 15), value=st.integers(0, 255))
def test_damage_to_one_object_costs_few_others(
    place: int, field: int, value: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "object.blf"
    frames = written(path, 300, level=0)
    content = bytearray(path.read_bytes())
    at = HEADER + 32 + 48 * place + field
    changed = content[at] != value
    content[at] = value
    found, counts = read(path, bytes(content))
    lost = [frame for frame in frames if frame not in found]
    assert len(lost) <= 2
    assert not lost or (changed and (counts.malformed or counts.other_lines or counts.error_frames or counts.truncated))


def test_a_file_cut_short_gives_what_came_before(tmp_path: Path) -> None:
    path = tmp_path / "a.blf"
    frames = written(path, 2000, size=10_000)
    content = path.read_bytes()
    for end in range(HEADER, len(content) - 1, 997):
        found, counts = read(path, content[:end])
        assert found == frames[: len(found)]
        assert len(found) >= 2000 * (end - HEADER) // len(content) - 300
        assert counts.truncated


@pytest.mark.parametrize("size", [LONGEST_CONTAINER, LONGEST_CONTAINER + 1])
def test_a_container_has_a_longest(tmp_path: Path, size: int) -> None:
    other = obj(1, classic())
    filler = bytes(size - len(other))
    found, counts = read(tmp_path / "a.blf", blf(packed(other, filler), packed(other)))
    assert len(found) == (2 if size == LONGEST_CONTAINER else 1)
    assert counts.malformed == 1


@pytest.mark.parametrize("beyond", [0, 1])
def test_an_object_has_a_longest(tmp_path: Path, beyond: int) -> None:
    size = LONGEST_OBJECT + beyond
    other = obj(5, bytes(size - 32), size=size)
    found, counts = read(tmp_path / "a.blf", blf(packed(obj(1, classic())), packed(other), packed(obj(1, classic()))))
    assert len(found) == 2
    assert (counts.other_lines, counts.malformed) == (1 - beyond, beyond)


def test_objects_without_a_frame_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("candaemon.can_io.logs.blf.MOST_IN_VAIN", 100)
    other, message = obj(5, bytes(4)), obj(1, classic())
    path = tmp_path / "a.blf"
    found, counts = read(path, blf(packed(other * 100), packed(message)))
    assert (len(found), counts.truncated) == (1, False)
    found, counts = read(path, blf(packed(other * 50), packed(other * 51), packed(message)))
    assert (len(found), counts.truncated) == (0, True)
    assert "this is no CAN log" in counts.stream_error


@pytest.mark.benchmark
def test_its_time_beside_python_cans(tmp_path: Path) -> None:
    path = tmp_path / "a.blf"
    written(path, 5_000)

    def seconds(what: object) -> float:
        began = time.process_time()
        assert len(what()) == 5_000  # type: ignore[operator]
        return time.process_time() - began

    times = [(seconds(lambda: read(path)[0]), seconds(lambda: by_python_can(path))) for _ in range(5)]
    ours, theirs = map(min, zip(*times, strict=True))
    print(f"a .blf is read in {ours / theirs:.2f} of python-can's time")
