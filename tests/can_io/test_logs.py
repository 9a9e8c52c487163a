"""Log readers and writers: exact, tolerant, counted, deterministic."""

from __future__ import annotations

import gzip
import logging
from itertools import islice
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.can_io.logs.candump import candump_text, read_candump_blocks
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import ChannelMap, LogCounts
from candaemon.can_io.logs.write import open_log_writer
from candaemon.errors import InputError
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import EXTENDED, Frame
from candaemon.frames.times import LATEST_NS
from tests.support.effort import examples

CHANNELS = {"can0": 0, "can1": 1}
START = 1_533_226_488_434_433_000
S = 1_000_000_000
FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)

ids = st.integers(0, 0x7FF) | st.integers(0, 0x1FFF_FFFF).map(lambda i: i | EXTENDED)
times = st.integers(0, LATEST_NS - S)
classic = st.builds(Frame, times, st.integers(0, 1), ids, st.binary(max_size=8))
can_fd = st.sampled_from(FD_LENGTHS).flatmap(
    lambda n: st.builds(Frame, times, st.integers(0, 1), ids, st.binary(min_size=n, max_size=n), st.just(True))
)


def read(path: Path, text: bytes | str, channels: dict[str, int] | None = None) -> tuple[list[Frame], LogCounts]:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    counts = LogCounts()
    return list(read_log(path, CHANNELS if channels is None else channels, counts)), counts


def line(data: str, time: str = "1533226488.434433", channel: str = "can0") -> str:
    return f"({time}) {channel} {data}\n"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "a.log"


@settings(deadline=None, max_examples=examples(60))
@given(frames=st.lists(classic | can_fd, max_size=60), repeat=st.integers(1, 30))
def test_candump_text_comes_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, frames: list[Frame], repeat: int
) -> None:
    # repeated, most lines take the vectorised way; once, most are read one by one
    text = candump_text(frames * repeat, ["can0", "can1"])
    found, counts = read(tmp_path_factory.getbasetemp() / "a.log", text)
    assert found == frames * repeat
    assert counts.lines == counts.frames == len(frames) * repeat
    assert counts.malformed == 0


@settings(deadline=None, max_examples=examples(60))
@given(
    lines=st.lists(
        st.sampled_from(
            [
                line("123#1122"),
                line("123#112"),
                line("123#11ZZ"),
                line("7FF#11AA"),
                line("800#11AA"),
                line("123#R"),
                line("123#R4"),
                line("20000088#0000000000000000"),
                line("10000088#0000000000000000"),
                line("123##1112233"),
                line("123##1112233445566778899"),
                line("123#1122 R"),
                line("123#1122", channel="can7"),
                line("123#1122", time="99999999999.434433"),
                line("123#1122", time="9999999999.434433"),
                line("123#1122", time="15332264x8.434433"),
                line("123#112233445566778899"),
                line("123#1122_9"),
                "\n",
                "  (1533226488.434433)  can0  123   [8]  11 22\n",
                "\x00\x01\x02 garbage\n",
            ]
        ),
        max_size=40,
    ),
    repeat=st.integers(2, 20),
)
def test_vectorised_and_single_lines_agree(
    tmp_path_factory: pytest.TempPathFactory, lines: list[str], repeat: int
) -> None:
    folder = tmp_path_factory.getbasetemp()
    together, counts = read(folder / "a.log", "".join(lines * repeat))
    one_by_one, single = read(folder / "a.log", "".join(lines))
    assert together == one_by_one * repeat
    assert counts.malformed == single.malformed * repeat
    assert counts.remote == single.remote * repeat
    assert counts.error_frames == single.error_frames * repeat
    assert sum(counts.other_channels.values()) == repeat * sum(single.other_channels.values())
    assert counts.frames == len(together)


@pytest.mark.parametrize("times", [1, 40])
@pytest.mark.parametrize(
    ("text", "frame"),
    [
        (line("260#08FFFB0000001884"), Frame(START, 0, 0x260, bytes.fromhex("08FFFB0000001884"))),
        (line("260#08fffb", "1533226488.434433017"), Frame(START + 17, 0, 0x260, b"\x08\xff\xfb")),
        (line("260#", "7.5"), Frame(7_500_000_000, 0, 0x260, b"")),
        (line("00000260#08"), Frame(START, 0, 0x260 | EXTENDED, b"\x08")),
        (line("260##50102"), Frame(START, 0, 0x260, b"\x01\x02", True)),
        (line("260#0102").replace("\n", "\r\n"), Frame(START, 0, 0x260, b"\x01\x02")),
        (line("260#0102 R"), Frame(START, 0, 0x260, b"\x01\x02")),
        (line("260#0102", channel="can1").replace("\n", " T\n"), Frame(START, 1, 0x260, b"\x01\x02")),
    ],
)
def test_each_kind_of_data_line(log: Path, text: str, frame: Frame, times: int) -> None:
    found, counts = read(log, text * times)
    assert found == [frame] * times
    assert counts.malformed == 0


@pytest.mark.parametrize("times", [1, 40])
@pytest.mark.parametrize("data", ["260#R", "260#R4", "260#r8 R", "00000260#R0"])
def test_remote_frames_are_counted(log: Path, data: str, times: int) -> None:
    found, counts = read(log, line(data) * times)
    assert (found, counts.remote, counts.malformed) == ([], times, 0)


@pytest.mark.parametrize(
    "data",
    [
        "260#012",
        "260#" + "00" * 9,
        "260##1" + "00" * 9,
        "260##1" + "00" * 65,
        "FFF#00",
        "2600#00",
        "260",
        "260#0G",
        "260###",
    ],
)
def test_what_can_cannot_hold_is_malformed(log: Path, data: str, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        found, counts = read(log, line("100#00") + "\n" + line(data) * 40)
    assert len(found) == 1
    assert (counts.lines, counts.malformed) == (42, 40)
    assert counts.examples[0].startswith("line 3: ")
    assert len(counts.examples) == len(caplog.records) == 5


def test_channels(log: Path) -> None:
    text = line("100#00", channel="vcan0") + line("101#00", channel="can7") * 40
    found, counts = read(log, text, {"vcan0": 2})
    assert [frame.bus for frame in found] == [2]
    assert counts.other_channels == {"can7": 40}
    found, counts = read(log, text, {"vcan0": 2, "*": 5})
    assert {frame.bus for frame in found} == {2, 5}


def test_chunks_keep_order(log: Path) -> None:
    frames = [Frame(START + i * 1000, i % 2, i % 0x700, bytes([i % 251]) * (i % 9)) for i in range(3000)]
    log.write_bytes(candump_text(frames, ["can0", "can1"]).replace(b"\n", b"\n\n"))
    blocks = list(read_candump_blocks(log, ChannelMap(CHANNELS), LogCounts(), chunk=1000))
    assert len(blocks) > 20
    assert [frame for block in blocks for frame in block.frames()] == frames
    assert all(block.payload.shape == (len(block), 8) for block in blocks)


def test_a_last_line_cut_short(log: Path) -> None:
    found, counts = read(log, line("260#01") * 3 + "(1533226488.434433) can0 26")
    assert len(found) == 3
    assert (counts.malformed, counts.truncated) == (1, True)
    found, counts = read(log, (line("260#01") * 3).rstrip("\n"))
    assert len(found) == 3
    assert not counts.truncated


@pytest.mark.parametrize("times", [1, 20])
def test_times_end_in_2116(log: Path, times: int) -> None:
    last = LATEST_NS // S - 1
    text = "".join(f"({second:010d}.999999999) can0 260#01\n" for second in (last, last + 1, 9_223_372_035))
    found, counts = read(log, text * times)
    assert (len(found), counts.malformed) == (times, 2 * times)
    assert found[0].time_ns == last * S + 999_999_999 <= LATEST_NS


@pytest.mark.parametrize("chunk", [1000, 1 << 19])
@pytest.mark.parametrize("end", [b"\n" + line("260#01").encode(), b""])
def test_a_line_without_end_is_one_malformed_line(log: Path, chunk: int, end: bytes) -> None:
    log.write_bytes(line("260#02").encode() + b"x" * 100_000 + end)
    counts = LogCounts()
    blocks = list(read_candump_blocks(log, ChannelMap(CHANNELS), counts, chunk=chunk))
    assert sum(map(len, blocks)) == counts.frames == 1 + bool(end)
    assert (counts.lines, counts.malformed) == (counts.frames + 1, 1)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".csv"])
def test_a_gzip_stream_cut_short(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}.gz"
    rng = np.random.default_rng(1)
    frames = [Frame(START + i * 1_000_000, 0, 0x123, rng.bytes(8)) for i in range(5000)]
    with OutputFile(path) as file, open_log_writer(file, ["can0"]) as writer:
        writer.write(frames)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    counts = LogCounts()
    found = list(read_log(path, {"can0": 0}, counts))
    assert [frame.data for frame in found] == [frame.data for frame in frames[: len(found)]]
    assert len(found) > 2000
    assert counts.truncated
    assert counts.stream_error


def test_a_file_that_is_not_gzip(tmp_path: Path) -> None:
    path = tmp_path / "a.log.gz"
    found, counts = read(path, line("260#01"))
    assert found == []
    with pytest.raises(InputError, match="Not a gzipped file"):
        counts.require_frames(path)


def test_progress(log: Path) -> None:
    _, counts = read(log, line("260#01") * 10)
    assert counts.bytes_read == counts.bytes_total == log.stat().st_size


def test_errors_say_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.log: there is no such log"):
        read_log(tmp_path / "nothing.log", CHANNELS, LogCounts())
    for name in ("a.txt", "a.txt.gz", "a", "a.gz"):
        with pytest.raises(InputError, match=r"one of \.log, \.asc, \.blf, \.csv, \.mf4, \.pcap, \.pcapng, \.trc"):
            read_log(tmp_path / name, CHANNELS, LogCounts())
    with pytest.raises(InputError, match="cannot be opened: Is a directory"):
        read_log(tmp_path.rename(tmp_path.with_suffix(".log")), CHANNELS, LogCounts())


def test_a_log_without_a_usable_frame(log: Path) -> None:
    _, counts = read(log, "")
    with pytest.raises(InputError, match="not one usable frame in 0 lines; expected"):
        counts.require_frames(log)
    _, counts = read(log, "garbage\n" + line("260#R"))
    with pytest.raises(InputError, match=r"1 malformed, 1 remote; first, line 1: 'garbage'"):
        counts.require_frames(log)
    _, counts = read(log, line("260#00", channel="can9"))
    with pytest.raises(InputError, match=r"1 of channel 'can9'; .*--map CHANNEL=BUS"):
        counts.require_frames(log)
    _, counts = read(log, line("260#00"))
    counts.require_frames(log)


def test_python_can_reads_what_is_written(log: Path) -> None:
    frames = [
        Frame(START, 0, 0x123, b"\x01"),
        Frame(START, 0, 0x123 | EXTENDED, b"\x02" * 8),
        Frame(START, 0, 0x7FF, bytes(64), True),
    ]
    log.write_bytes(candump_text(frames, ["can0"]))
    with can.LogReader(log) as reader:
        found = list(reader)
    assert [(m.arbitration_id | m.is_extended_id << 31, bytes(m.data), m.is_fd) for m in found] == [
        f[2:] for f in frames
    ]


def test_the_real_drive_as_python_can_reads_it(drive: Path) -> None:
    path = drive / "drive.log.gz"
    counts = LogCounts()
    frames = list(read_log(path, CHANNELS, counts))
    assert len(frames) == counts.lines == counts.frames
    assert (counts.malformed, counts.other_channels) == (0, {})
    with gzip.open(path, "rt") as text, can.CanutilsLogReader(text) as reader:
        for message, frame in zip(islice(reader, 20_000), frames, strict=False):
            assert message.channel == f"can{frame.bus}"
            assert (message.arbitration_id, bytes(message.data)) == (frame.can_id, frame.data)
            assert abs(message.timestamp - frame.time_ns / 1e9) < 1e-6
