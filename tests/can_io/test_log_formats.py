"""python-can's log formats: what each keeps, and what a damaged file of each gives."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from candaemon.can_io.logs.candump import candump_text
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import ChannelMap, EveryChannel, LogCounts
from candaemon.can_io.logs.write import LARGEST_CHANNEL, open_log_writer
from candaemon.errors import InputError
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import EXTENDED, Frame

NAMES = ["can0", "can1"]
CHANNELS = {"can0": 0, "can1": 1}
START = 1_533_226_488_434_433_000
CLASSIC = [
    Frame(START, 0, 0x260, bytes(8)),
    Frame(START + 1_000, 1, 0x123_4567 | EXTENDED, b"\x01\x02\x03"),
    Frame(START + 123_456_000, 0, 0x7FF, b""),
    Frame(START + 10_000_999_000, 1, 0x000, b"\xff" * 8),
    Frame(START + 3_600_000_001_000, 1, 0x12 | EXTENDED, b"\x12"),
]
FD = [
    Frame(START + 3_700_000_000_000, 0, 0x123, bytes(range(64)), True),
    Frame(START + 3_700_000_001_000, 1, 0x123 | EXTENDED, b"\x01", True),
]


def test_candump_text_to_the_letter() -> None:
    frames = [
        Frame(START, 0, 0x26A, bytes.fromhex("08FFFB0000001884")),
        Frame(START, 1, 0x26A, b"\xab"),
        Frame(START + 1_000, 1, 0x26A | EXTENDED, b""),
        Frame(START + 1_001, 1, 0x26A, bytes(range(12)), True),
        Frame(7, 0, 0x1FFF_FFFF | EXTENDED, b"\x00", True),
        Frame(0, 0, 0, b""),
    ]
    assert candump_text(frames, ["can0", "radar"]).decode().splitlines(keepends=True) == [
        "(1533226488.434433) can0 26A#08FFFB0000001884\n",
        "(1533226488.434433) radar 26A#AB\n",
        "(1533226488.434434) radar 0000026A#\n",
        "(1533226488.434434001) radar 26A##1000102030405060708090A0B\n",
        "(0000000000.000000007) can0 1FFFFFFF##100\n",
        "(0000000000.000000) can0 000#\n",
    ]
    assert candump_text([], []) == b""


def round_trip(
    path: Path, frames: list[Frame], channels: dict[str, int] | None = None
) -> tuple[list[Frame], LogCounts]:
    with OutputFile(path) as file, open_log_writer(file, NAMES) as writer:
        writer.write(frames[:2])
        writer.write(frames[2:])
    counts = LogCounts()
    return list(read_log(path, CHANNELS if channels is None else channels, counts)), counts


def relative(frames: list[Frame]) -> list[Frame]:
    return [frame._replace(time_ns=frame.time_ns - frames[0].time_ns) for frame in frames]


@pytest.mark.parametrize("suffix", [".log", ".log.gz", ".blf"])
def test_all_is_kept(tmp_path: Path, suffix: str) -> None:
    found, counts = round_trip(tmp_path / f"a{suffix}", CLASSIC + FD)
    assert found == CLASSIC + FD
    assert (counts.lines, counts.frames) == (7, 7)
    assert counts.bytes_read == counts.bytes_total


@pytest.mark.parametrize("suffix", [".asc", ".asc.gz"])
def test_asc_keeps_all_but_the_epoch(tmp_path: Path, suffix: str) -> None:
    found, _ = round_trip(tmp_path / f"a{suffix}", CLASSIC + FD)
    assert found == relative(CLASSIC + FD)


@pytest.mark.parametrize("suffix", [".trc", ".trc.gz"])
def test_trc_keeps_classic_frames_to_a_microsecond(tmp_path: Path, suffix: str) -> None:
    found, _ = round_trip(tmp_path / f"a{suffix}", CLASSIC)
    assert [frame[1:] for frame in found] == [frame[1:] for frame in CLASSIC]
    assert all(abs(a.time_ns - b.time_ns) <= 2_000 for a, b in zip(found, CLASSIC, strict=True))
    with pytest.raises(InputError, match=r"no CAN FD to \.trc; choose \.log, \.asc or \.blf"):
        round_trip(tmp_path / f"b{suffix}", CLASSIC + FD)


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
def test_csv_keeps_neither_channel_nor_short_can_fd(tmp_path: Path, suffix: str) -> None:
    found, counts = round_trip(tmp_path / f"a{suffix}", CLASSIC + FD)
    assert found == []
    assert counts.other_channels == {"none": 7}
    one_bus = [frame._replace(bus=3, fd=len(frame.data) > 8) for frame in CLASSIC + FD]
    assert round_trip(tmp_path / f"a{suffix}", CLASSIC + FD, {"can0": 3})[0] == one_bus
    assert round_trip(tmp_path / f"a{suffix}", CLASSIC + FD, {"can0": 0, "can1": 1, "*": 3})[0] == one_bus


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc"])
def test_channel_numbers(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    assert [frame.bus for frame in round_trip(path, CLASSIC, {"1": 0, "0": 1})[0]] == [1, 0, 1, 0, 0]
    found, counts = round_trip(path, CLASSIC, {"vcan1": 4})
    assert [frame.bus for frame in found] == [4, 4, 4]
    assert counts.other_channels == {"0": 2}


@pytest.mark.parametrize("suffix", [".asc", ".blf"])
def test_a_time_before_the_first_is_raised_to_it_and_told(tmp_path: Path, suffix: str) -> None:
    path, hour_ns = tmp_path / f"a{suffix}", 3_600_000_000_000
    back = [0, 1_000_000_000, -10_000_000, -hour_ns, 2_000_000_000]
    with OutputFile(path) as file, open_log_writer(file, NAMES) as writer:
        writer.write([Frame(START + after_ns, 0, 0x123, b"1") for after_ns in back])
    assert writer.lost()[0].startswith("2 time stamps before the first one")
    # a .blf begins at a whole millisecond
    began, raised = (START, START // 1_000_000 * 1_000_000) if suffix == ".blf" else (0, 0)
    expected = [began, began + back[1], raised, raised, began + back[4]]
    assert [frame.time_ns for frame in read_log(path, CHANNELS, LogCounts())] == expected
    assert [round(message.timestamp * 1e6) * 1000 for message in can.LogReader(path)] == expected


@pytest.mark.parametrize(("year_s", "told"), [(5.5, True), (631_151_999.0, True), (631_152_000.0, False)])
def test_a_blf_from_before_1990_has_no_date(tmp_path: Path, year_s: float, told: bool) -> None:
    path = tmp_path / "a.blf"
    with OutputFile(path) as file, open_log_writer(file, NAMES) as writer:
        writer.write([Frame(round(year_s * 1e9), 0, 0x123, b"1")])
    assert ["the date" in lost for lost in writer.lost()] == [True] * told
    assert [frame.time_ns for frame in read_log(path, CHANNELS, LogCounts())] == [0 if told else round(year_s * 1e9)]


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".mf4", ".trc"])
@pytest.mark.parametrize("known", [0, 5])
def test_a_can_interface_keeps_its_number(tmp_path: Path, suffix: str, known: int) -> None:
    if suffix == ".mf4":
        pytest.importorskip("asammdf")
    path, names = tmp_path / f"a{suffix}", ["can1", "vcan1", "radar", "vcan3", "can0"]
    channels = names[:known]
    frames = [Frame(START + bus * 1_000_000, bus, 0x100 + bus, b"1") for bus in range(len(names))]
    with OutputFile(path) as file, open_log_writer(file, channels) as writer:
        for frame in frames:
            channels += names[len(channels) : frame.bus + 1]
            writer.write([frame])
    every = EveryChannel()
    found = [every.names[frame.bus] for frame in read_log(path, every, LogCounts())]
    assert found == (
        ["can1", "can2", "can4", "can3", "can0"] if known else ["can1", "can128", "can129", "can130", "can0"]
    )
    renamed = [f"{name} is read as {other}" for name, other in zip(names, found, strict=True) if name != other]
    assert f"names of channels ({', '.join(renamed)})" in writer.lost()


def test_a_number_that_the_log_cannot_hold_is_asked_of_can_interfaces_alone(tmp_path: Path) -> None:
    with OutputFile(tmp_path / "a.asc") as file, open_log_writer(file, ["radar70000"]) as writer:
        writer.write([Frame(START, 0, 0x123, b"1")])
    assert writer.lost()[0] == "names of channels (radar70000 is read as can0)"


def test_no_bus_takes_the_number_of_another(tmp_path: Path) -> None:
    channels: list[str] = []
    with OutputFile(tmp_path / "a.asc") as file, open_log_writer(file, channels) as writer:
        channels.append("radar")
        writer.write([Frame(START, 0, 0x123, b"1")])
        channels.append("can128")
        with pytest.raises(InputError, match=r"the number of channel can128 was given to another.*; choose \.log"):
            writer.write([Frame(START, 1, 0x123, b"1")])


def test_relative_times_of_an_asc_count_from_the_event_before(tmp_path: Path) -> None:
    path = tmp_path / "a.asc"
    path.write_text(
        "date Thu Aug 2 04:14:48.500 pm 2018\nbase hex  timestamps relative\nno internal events logged\n"
        "   0.000000 Start of measurement\n   0.100000 1  123  Rx   d 1 01\n   0.100000 1  ErrorFrame\n"
        "   0.050000 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%\n   0.100000 1  12Q  Rx   d 1 02\n"
        "   0.100001 1  123  Rx   d 1 03\n"
    )
    counts = LogCounts()
    assert [(frame.time_ns, frame.data) for frame in read_log(path, CHANNELS, counts)] == [
        (100_000_000, b"\1"),
        (450_001_000, b"\3"),
    ]
    assert counts.examples == ["line 8: '0.100000 1  12Q  Rx   d 1 02'"]


def test_an_asc_keeps_a_can_fd_frame_without_data(tmp_path: Path) -> None:
    frames = [Frame(0, 0, 0x123, b"", True)]
    path = tmp_path / "a.asc"
    found, counts = round_trip(path, frames)
    assert (found, counts.remote) == (frames, 0)
    remote = f"   0.1 CANFD   1 Rx  123 {'':40} 0 0 4  0 {' '.join('0' * 8)}\n"
    path.write_text(path.read_text().replace("End", remote + "End"))
    counts = LogCounts()
    assert list(read_log(path, CHANNELS, counts)) == frames
    assert (counts.remote, counts.malformed) == (1, 0)


def test_a_number_that_two_buses_end_in_is_nobodys() -> None:
    channels = ChannelMap({"can0": 0, "vcan0": 1, "can1": 2, "radar": 2})
    assert [channels.numbered(number) for number in (0, 1, None)] == [-1, 2, -1]


@pytest.fixture
def another_zone() -> Iterator[None]:
    before = os.environ.get("TZ")
    os.environ["TZ"] = "Asia/Tokyo"
    time.tzset()
    yield
    if before is None:
        del os.environ["TZ"]
    else:
        os.environ["TZ"] = before
    time.tzset()


@pytest.mark.parametrize("suffix", [".log", ".log.gz", ".asc", ".asc.gz", ".blf", ".csv", ".csv.gz", ".trc", ".trc.gz"])
def test_same_frames_same_bytes(tmp_path: Path, suffix: str, request: pytest.FixtureRequest) -> None:
    here, there = tmp_path / f"here{suffix}", tmp_path / f"there{suffix}"
    round_trip(here, CLASSIC)
    time.sleep(0.002)
    request.getfixturevalue("another_zone")
    round_trip(there, CLASSIC)
    assert here.read_bytes() == there.read_bytes()


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv", ".trc", ".trc.gz"])
def test_no_frames_make_a_log_without_frames(tmp_path: Path, suffix: str) -> None:
    found, counts = round_trip(tmp_path / f"a{suffix}", [])
    assert (found, counts.malformed) == ([], 0)


@pytest.mark.parametrize("suffix", [".asc", ".csv", ".trc"])
def test_a_bad_line_loses_no_other(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    round_trip(path, CLASSIC)
    lines = path.read_bytes().splitlines(keepends=True)
    bad = {
        ".asc": b" 0.000001 1  26Q             Rx   d 8 00 00 00 00 00 00 00 00\n",
        ".csv": b"1533226488.4,0x260,0\n",
        ".trc": b"      1         0.001 DT  2  12345Q7 Rx -  3    01 02 03\n",
    }[suffix]
    at = next(i for i, text in enumerate(lines) if b"1234567" in text)
    path.write_bytes(b"".join([*lines[:at], bad, bad, *lines[at:], b"\xff\xfe\n"]))
    counts = LogCounts()
    found = list(read_log(path, CHANNELS | {"*": 0}, counts))
    assert [frame.data for frame in found] == [frame.data for frame in CLASSIC]
    assert counts.malformed >= 2
    assert counts.examples[0] == f"line {at + 1}: {bad.decode().strip()!r}"


@pytest.mark.parametrize(
    "row", ["nan,0x1,0,0,0,0,", "1.0,-0x1,0,0,0,0,", "1.0,0x800,0,0,0,0,", f"1.0,0x1,0,0,0,8,{'AAAA' * 30}"]
)
def test_values_that_no_frame_has(tmp_path: Path, row: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"header\n{row}\n2.0,0x1,0,0,0,1,AQ==\n3.0,0x1,0,1,0,1,\n4.0,0x0,0,0,1,0,\n")
    counts = LogCounts()
    assert list(read_log(path, {"can0": 0}, counts)) == [Frame(2_000_000_000, 0, 1, b"\x01")]
    assert (counts.malformed, counts.remote, counts.error_frames) == (1, 1, 1)


def test_a_damaged_blf(tmp_path: Path) -> None:
    path = tmp_path / "a.blf"
    frames = [CLASSIC[0]._replace(time_ns=START + i * 1_000_000) for i in range(9000)]
    round_trip(path, frames)
    whole = path.read_bytes()
    counts = LogCounts()
    path.write_bytes(whole[: len(whole) - 100])
    assert 0 < len(list(read_log(path, CHANNELS, counts))) < 9000
    assert counts.truncated
    for damaged in (b"", b"garbage", whole[:144] + b"garbage that is no object of a BLF file"):
        path.write_bytes(damaged)
        counts = LogCounts()
        assert list(read_log(path, CHANNELS, counts)) == []
        with pytest.raises(InputError, match="not one usable frame"):
            counts.require_frames(path)


def test_writers_refuse(tmp_path: Path) -> None:
    for name, words in (
        ("a.blf.gz", r"compressed already; expected a name that ends in \.blf"),
        ("a.txt", "expected one of"),
    ):
        with pytest.raises(InputError, match=words), OutputFile(tmp_path / name) as file:
            open_log_writer(file, NAMES)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("suffix", [".log", ".log.gz", ".asc", ".blf", ".csv", ".trc"])
def test_a_full_disk(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.symlink_to("/dev/full")
    for count in (1, 2000):
        with (
            pytest.raises(InputError, match=rf"{path}: cannot be written: No space left"),
            OutputFile(path) as file,
            open_log_writer(file, NAMES) as writer,
        ):
            writer.write(CLASSIC * count)
        writer.close()


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".trc"])
def test_a_channel_has_a_number_that_its_log_can_hold(tmp_path: Path, suffix: str) -> None:
    path, frames = tmp_path / f"a{suffix}", [Frame(1_700_000_000_000_000_000, 0, 0x123, b"12", False)]
    with OutputFile(path) as file, open_log_writer(file, [f"can{LARGEST_CHANNEL}"]) as writer:
        writer.write(frames)
    assert [frame.data for frame in read_log(path, {f"can{LARGEST_CHANNEL}": 0}, LogCounts())] == [b"12"]
    with (
        pytest.raises(
            InputError, match=r"numbers its channels up to 65,534, found 65535; choose \.log, or give the bus"
        ),
        OutputFile(path) as file,
    ):
        open_log_writer(file, [f"can{LARGEST_CHANNEL + 1}"])
