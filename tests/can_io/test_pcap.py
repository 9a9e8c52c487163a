"""`.pcap` and `.pcapng` of SocketCAN: to the letter, whatever wrote them, and of damaged ones all that is whole."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.can_io.logs.pcap import (
    LATEST_PCAP_S,
    LONGEST_BLOCK,
    LONGEST_DAMAGE,
    LONGEST_PACKET,
    MOST_INTERFACES,
    packet_of,
)
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.can_io.logs.write import open_log_writer
from candaemon.errors import InputError
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import EXTENDED, Frame
from tests.support.effort import examples

START = 1_533_226_488_434_433_001
FRAMES = [
    Frame(START, 0, 0x260, bytes(range(8))),
    Frame(START + 1, 1, 0x123_4567 | EXTENDED, b"\x01\x02\x03"),
    Frame(START + 2_000, 1, 0x7FF, b""),
    Frame(START + 3_000, 0, 0x12, bytes(range(64)), True),
    Frame(START + 4_000, 0, 0x13, b"\x07", True),
]
CHANNELS = {"can0": 0, "can1": 1}
CLASSIC = struct.pack(">LBxxx8s", 0x260, 8, bytes(8))


def written(path: Path, frames: list[Frame]) -> bytes:
    with OutputFile(path) as file, open_log_writer(file, ["can0", "can1"]) as writer:
        writer.write(frames)
    return path.read_bytes()


def read(path: Path, content: bytes, channels: dict[str, int] | None = None) -> tuple[list[Frame], LogCounts]:
    path.write_bytes(content)
    counts = LogCounts()
    found = list(read_log(path, channels or CHANNELS, counts))
    told = counts.frames + counts.malformed + counts.remote + counts.error_frames + counts.other_lines
    assert told + sum(counts.other_channels.values()) == counts.lines
    return found, counts


def head(order: str = "<", magic: int = 0xA1B2_C3D4, link: int = 227) -> bytes:
    return struct.pack(f"{order}LHHlLLL", magic, 2, 4, 0, 0, 65535, link)


def record(content: bytes, order: str = "<", seconds: int = 1_533_226_488, fraction: int = 434_433) -> bytes:
    return struct.pack(f"{order}LLLL", seconds, fraction, len(content), len(content)) + content


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    body += bytes(-len(body) % 4)
    size = struct.pack(f"{order}L", 12 + len(body))
    return struct.pack(f"{order}L", kind) + size + body + size


def section(order: str = "<") -> bytes:
    return block(0x0A0D_0D0A, struct.pack(f"{order}LHHq", 0x1A2B_3C4D, 1, 0, -1), order)


def interface(name: bytes = b"", order: str = "<", link: int = 227, options: bytes = b"") -> bytes:
    named = struct.pack(f"{order}HH", 2, len(name)) + name + bytes(-len(name) % 4) if name else b""
    return block(1, struct.pack(f"{order}HHL", link, 0, 0) + named + options + bytes(4), order)


def packet(content: bytes, index: int = 0, ticks: int = 1_533_226_488_434_433, order: str = "<") -> bytes:
    return block(
        6,
        struct.pack(f"{order}LLLLL", index, ticks >> 32, ticks & 0xFFFF_FFFF, len(content), len(content)) + content,
        order,
    )


def test_what_is_written_comes_back_and_says_whose_it_is(tmp_path: Path) -> None:
    assert read(tmp_path / "a.pcapng", written(tmp_path / "a.pcapng", FRAMES))[0] == FRAMES
    content = written(tmp_path / "a.pcap", FRAMES)
    assert read(tmp_path / "a.pcap", content)[1].other_channels == {"none": len(FRAMES)}
    assert read(tmp_path / "a.pcap", content, {"can7": 3})[0] == [frame._replace(bus=3) for frame in FRAMES]
    # the suffixes may be swapped: the content says which it is
    assert len(read(tmp_path / "a.pcapng", content, {"*": 0})[0]) == len(FRAMES)
    assert content[:24] == head(magic=0xA1B2_3C4D).replace(struct.pack("<L", 65535), struct.pack("<L", LONGEST_PACKET))
    assert content[24:56] == struct.pack("<LLLL", 1_533_226_488, 434_433_001, 16, 16) + packet_of(FRAMES[0])
    assert packet_of(FRAMES[1]).hex() == "8123456703000000" + "0102030000000000"
    assert packet_of(FRAMES[4]).hex() == "0000001301050000" + "07" + "00" * 63


@pytest.mark.parametrize("order", ["<", ">"])
def test_both_orders_of_bytes_and_units_of_time(tmp_path: Path, order: str) -> None:
    for magic, unit in ((0xA1B2_C3D4, 1000), (0xA1B2_3C4D, 1)):
        content = head(order, magic) + record(CLASSIC, order) + record(CLASSIC, order)
        found, _ = read(tmp_path / "a.pcap", content, {"*": 0})
        assert [frame.time_ns for frame in found] == [1_533_226_488 * 10**9 + 434_433 * unit] * 2
    for resolution, ticks, time_ns in (
        (b"", 1_533_226_488_434_433, 1_533_226_488_434_433_000),
        (struct.pack(f"{order}HHB3x", 9, 1, 9), START, START),
        (struct.pack(f"{order}HHB3x", 9, 1, 0x80 | 10), 1_533_226_488 << 10 | 512, 1_533_226_488_500_000_000),
        (struct.pack(f"{order}HHq", 14, 8, 100), 1_000_000, 101_000_000_000),
    ):
        content = section(order) + interface(b"can1", order, options=resolution) + packet(CLASSIC, 0, ticks, order)
        found, _ = read(tmp_path / "a.pcapng", content)
        assert found == [Frame(time_ns, 1, 0x260, bytes(8))]


def test_what_a_packet_can_be(tmp_path: Path) -> None:
    cases = {
        CLASSIC: "frames",
        CLASSIC[:8]: "malformed",  # its data are missing
        CLASSIC[:7]: "malformed",
        struct.pack(">LBxxx8s", 0x800, 8, bytes(8)): "malformed",  # no identifier of 11 bits
        struct.pack(">LBxxx9s", 0x1, 9, bytes(9)): "malformed",  # no length of CAN FD
        struct.pack(">LBxxx8s", 0x4000_0260, 8, bytes(8)): "remote",
        struct.pack(">LBxxx8s", 0x2000_0080, 8, bytes(8)): "error_frames",
        struct.pack(">LBxxx64s", 0x1, 12, bytes(64)): "frames",  # CAN FD of older kernels
        struct.pack(">LB75x", 0x1, 0x80): "other_lines",  # CAN XL
    }
    for content, kind in cases.items():
        found, counts = read(tmp_path / "a.pcap", head() + record(content), {"*": 0})
        assert getattr(counts, kind) == 1, content.hex()
        assert len(found) == (kind == "frames")
    assert read(tmp_path / "a.pcap", head() + record(packet_of(FRAMES[3])), {"*": 0})[0][0].fd


def test_cooked_captures_of_all_interfaces(tmp_path: Path) -> None:
    sll = struct.pack(">HHH8xH", 1, 280, 0, 0x000C) + CLASSIC
    sll2 = struct.pack(">HHLHBB8x", 0x000D, 0, 7, 280, 1, 0) + packet_of(FRAMES[3])
    assert len(read(tmp_path / "a.pcap", head(link=113) + record(sll), {"*": 0})[0]) == 1
    found, _ = read(tmp_path / "a.pcap", head(link=276) + record(sll2), {"7": 1})
    assert (found[0].bus, found[0].data) == (1, FRAMES[3].data)
    other = struct.pack(">HHLHBB8x", 0x0800, 0, 7, 1, 1, 0) + bytes(40)
    _, counts = read(tmp_path / "a.pcap", head(link=276) + record(other))
    assert counts.other_lines == 1
    with pytest.raises(InputError, match="link type 276 hold no CAN frames; expected 227, SocketCAN"):
        counts.require_frames(tmp_path / "a.pcap")


def test_packets_without_interface_or_time_are_malformed(tmp_path: Path) -> None:
    whole = section() + interface(b"can0") + packet(CLASSIC)
    simple = block(3, struct.pack("<L", len(CLASSIC)) + CLASSIC)
    old = block(2, struct.pack("<HHLLLL", 0, 0, 0, 5_000_000, len(CLASSIC), len(CLASSIC)) + CLASSIC)
    found, counts = read(tmp_path / "a.pcapng", whole + packet(CLASSIC, 1) + simple + old + block(5, b"statistics"))
    assert [frame.time_ns for frame in found] == [1_533_226_488_434_433_000, 5_000_000_000]
    assert (counts.malformed, counts.other_lines) == (2, 3)
    # a further section forgets the interfaces of the one before
    assert read(tmp_path / "a.pcapng", whole + section() + packet(CLASSIC))[1].malformed == 1
    assert read(tmp_path / "a.pcapng", section() + interface() + interface() + packet(CLASSIC, 1))[0][0].bus == 1


@pytest.mark.parametrize("suffix", [".pcap", ".pcapng"])
def test_damage_costs_what_it_hits(tmp_path: Path, suffix: str) -> None:
    frames = [FRAMES[0]._replace(time_ns=START + k * 10**6, data=bytes([k] * 8)) for k in range(200)]
    path = tmp_path / f"a{suffix}"
    whole = written(path, frames)
    size = (len(whole) - 24) // 200 if suffix == ".pcap" else 48
    begin = len(whole) - 200 * size
    cut = whole[: begin + 100 * size - 5]
    found, counts = read(path, cut, {"*": 0})
    assert [frame.data for frame in found] == [frame.data for frame in frames[:99]]
    assert "cut short" in counts.stream_error
    at = begin + 50 * size
    wrong_size = bytearray(whole)
    wrong_size[at + (8 if suffix == ".pcap" else 4) :][:4] = b"\xff\xff\xff\xff"
    wrong_size[at + (8 if suffix == ".pcap" else 4) + 3] = 0xFF
    for damaged in (bytes(wrong_size), whole[:at] + b"\xee" * 1000 + whole[at:], whole[:at] + whole[at + 7 :]):
        found, counts = read(path, damaged, {"*": 0})
        assert 198 <= len(found) <= 200
        assert [frame.data for frame in found[-149:]] == [frame.data for frame in frames[-149:]]
        assert counts.malformed >= 1
        assert f"at byte {at}" in counts.examples[0]


@settings(deadline=None, max_examples=examples(60))
@given(
    suffix=st.sampled_from([".pcap", ".pcapng"]),
    changes=st.lists(st.tuples(st.integers(0, 1 << 16), st.binary(max_size=12), st.integers(0, 40)), max_size=4),
)
def test_any_damage_is_counted(
    suffix: str, changes: list[tuple[int, bytes, int]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / f"any{suffix}"
    content = written(path, FRAMES * 10)
    for at, put, gone in changes:
        at %= len(content)
        content = content[:at] + put + content[at + gone :]
    found, counts = read(path, content, {"*": 0})
    assert counts.frames == len(found)


def test_a_packet_has_a_longest(tmp_path: Path) -> None:
    for beyond in (0, 1):
        long = CLASSIC.ljust(LONGEST_PACKET + beyond, b"\0")
        found, counts = read(tmp_path / "a.pcap", head() + record(CLASSIC) + record(long) + record(CLASSIC), {"*": 0})
        assert (len(found), counts.malformed) == (3 - beyond, beyond)


def test_a_block_has_a_longest(tmp_path: Path) -> None:
    begin = section() + interface(b"can0") + packet(CLASSIC)
    for beyond in (0, 4):
        long = block(5, bytes(LONGEST_BLOCK - 12 + beyond))
        found, counts = read(tmp_path / "a.pcapng", begin + long + packet(CLASSIC))
        assert (len(found), counts.malformed) == (2, bool(beyond))


def test_a_section_has_so_many_interfaces(tmp_path: Path) -> None:
    many = section() + interface(b"can0") * (MOST_INTERFACES + 1)
    found, counts = read(tmp_path / "a.pcapng", many + packet(CLASSIC, MOST_INTERFACES - 1))
    assert (len(found), counts.malformed) == (1, 0)
    found, counts = read(tmp_path / "a.pcapng", many + packet(CLASSIC, MOST_INTERFACES))
    assert (len(found), counts.malformed) == (0, 1)


@pytest.mark.parametrize("suffix", [".pcap", ".pcapng"])
def test_damage_has_a_longest(tmp_path: Path, suffix: str) -> None:
    begin = head() + record(CLASSIC) if suffix == ".pcap" else section() + interface(b"can0") + packet(CLASSIC)
    end = record(CLASSIC) if suffix == ".pcap" else packet(CLASSIC)
    for length, ends in ((LONGEST_DAMAGE - 100, False), (LONGEST_DAMAGE + (2 << 16), True)):
        found, counts = read(tmp_path / f"a{suffix}", begin + b"\xee" * length + end, {"*": 0})
        assert (len(found), counts.truncated) == (1 if ends else 2, ends)
    assert "more than 4 MiB in a row are no packet" in counts.stream_error


def test_times_of_a_pcap_end_in_2106(tmp_path: Path) -> None:
    latest = Frame(LATEST_PCAP_S * 10**9 + 999_999_999, 0, 1, b"")
    assert read(tmp_path / "a.pcap", written(tmp_path / "a.pcap", [latest]), {"*": 0})[0] == [latest]
    with pytest.raises(InputError, match=r"times end 4,294,967,295 s after 1970, found 4,294,967,296; choose \.pcapng"):
        written(tmp_path / "b.pcap", [latest._replace(time_ns=latest.time_ns + 1)])
    assert read(tmp_path / "a.pcapng", written(tmp_path / "a.pcapng", [latest]))[0] == [latest]
