"""`.mf4`: the frames that python-can reads, all that is written, and a clear word on what is damaged."""

from __future__ import annotations

import sys
import tracemalloc
from pathlib import Path

import can
import pytest

from candaemon.can_io.logs import mf4
from candaemon.can_io.logs.mf4 import LARGEST_BLOCK, LARGEST_COPY, LARGEST_MF4_CHANNEL, LONGEST_RECORD
from candaemon.can_io.logs.read import read_log, read_log_blocks
from candaemon.can_io.logs.stream import LogCounts
from candaemon.can_io.logs.write import open_log_writer
from candaemon.can_io.python_can import to_frame
from candaemon.errors import InputError
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import EXTENDED, Frame

pytest.importorskip("asammdf")

START = 1_533_226_488_434_433_001
CHANNELS = {"can0": 0, "can1": 1}
FRAMES = [
    Frame(START + k * 1_000_003, k % 2, 0x100 + k % 9 | EXTENDED * (k % 3 == 0), bytes([k % 256] * (k % 9)), k % 5 == 0)
    for k in range(9000)
] + [Frame(START + 10**13, 1, 0x7FF, bytes(range(64)), True)]


def written(path: Path, frames: list[Frame], names: tuple[str, ...] = ("can0", "can1")) -> bytes:
    with OutputFile(path) as file, open_log_writer(file, names) as writer:
        for begin in range(0, len(frames), 1000):
            writer.write(frames[begin : begin + 1000])
    return path.read_bytes()


def read(path: Path, channels: dict[str, int] | None = None) -> tuple[list[Frame], LogCounts]:
    counts = LogCounts()
    found = list(read_log(path, channels or CHANNELS, counts))
    told = counts.frames + counts.malformed + counts.remote + counts.error_frames + counts.other_lines
    assert told + sum(counts.other_channels.values()) == counts.lines
    return found, counts


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mf4") / "whole.mf4"
    written(path, FRAMES)
    return path


def test_what_is_written_comes_back_to_the_nanosecond(whole: Path, tmp_path: Path) -> None:
    found, counts = read(whole)
    assert found == FRAMES
    assert (counts.lines, counts.bytes_read) == (len(FRAMES), counts.bytes_total)
    assert written(tmp_path / "again.mf4", FRAMES) == whole.read_bytes()
    assert read(whole, {"can1": 3})[1].other_channels == {"0": 4500}
    written(tmp_path / "none.mf4", [])
    found, counts = read(tmp_path / "none.mf4")
    assert (found, counts.lines, counts.truncated) == ([], 0, False)


def test_python_can_reads_the_same(whole: Path) -> None:
    with can.LogReader(whole) as reader:
        messages = list(reader)
    assert len(messages) == len(FRAMES)
    for message, frame in zip(messages, FRAMES, strict=True):
        again = to_frame(message, frame.bus)
        assert again[2:] == frame[2:]
        assert abs(again.time_ns - frame.time_ns) <= 1000
        assert message.channel == frame.bus + 1


def test_what_python_can_writes(tmp_path: Path) -> None:
    path = tmp_path / "a.mf4"
    with can.MF4Writer(path) as writer:
        for k in range(40):
            remote, error = k % 8 == 1, k % 8 == 2
            message = can.Message(timestamp=1_533_226_488.25 + k, arbitration_id=0x260 + k, is_extended_id=False)
            message.channel, message.is_remote_frame, message.is_error_frame = k % 2, remote, error
            message.data, message.dlc = bytearray(b"" if remote else b"12"), 2
            writer.on_message_received(message)
    found, counts = read(path)
    kept = [k for k in range(40) if k % 8 not in (1, 2)]
    assert found == [Frame(1_533_226_488_250_000_000 + k * 10**9, k % 2, 0x260 + k, b"12") for k in kept]
    assert (counts.remote, counts.error_frames, counts.lines) == (5, 5, 40)


def test_signals_are_no_frames(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    path = tmp_path / "a.mf4"
    with asammdf.MDF(version="4.10") as file:
        file.append(asammdf.Signal(samples=[1.0, 2.0], timestamps=[0.0, 1.0], name="speed"))
        file.save(path)
    _, counts = read(path)
    with pytest.raises(InputError, match="no group of CAN bus events; measured signals are no frames"):
        counts.require_frames(path)


def test_a_damaged_file_ends_with_a_word_and_nothing_else(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = whole.read_bytes()
    damaged = [content[:size] for size in (0, 7, 64, 100, 300, len(content) // 2, len(content) - 50)]
    damaged += [content[:at] + b"\xff" * 16 + content[at + 16 :] for at in range(60, len(content), len(content) // 12)]
    damaged.append(content[:112] + b"9" + content[113:])  # an attachment that some versions believe larger than memory
    for number, each in enumerate(damaged):
        path = tmp_path / f"{number}.mf4"
        path.write_bytes(each)
        found, counts = read(path)
        assert counts.truncated or len(found) + counts.malformed > 0 or counts.advice
        if not found:
            with pytest.raises(InputError, match="not one usable frame"):
                counts.require_frames(path)
    assert "Exception ignored" not in capsys.readouterr().err


def test_a_channel_has_a_number_of_8_bits(tmp_path: Path) -> None:
    path = tmp_path / "a.mf4"
    written(path, FRAMES[:1], (f"can{LARGEST_MF4_CHANNEL}",))
    assert len(read(path, {f"can{LARGEST_MF4_CHANNEL}": 0})[0]) == 1
    with pytest.raises(InputError, match=r"numbers its channels up to 254, found 255; choose \.log"):
        written(path, FRAMES[:1], (f"can{LARGEST_MF4_CHANNEL + 1}",))


@pytest.mark.parametrize("beyond", [0, 1])
def test_a_copy_has_a_largest(whole: Path, tmp_path: Path, beyond: int, monkeypatch: pytest.MonkeyPatch) -> None:
    assert LARGEST_COPY == 8 << 30
    import gzip

    path = tmp_path / "a.mf4.gz"
    path.write_bytes(gzip.compress(whole.read_bytes()))
    monkeypatch.setattr(mf4, "LARGEST_COPY", whole.stat().st_size - beyond)
    found, counts = read(path)
    assert counts.truncated == bool(beyond)
    assert beyond or found == FRAMES
    with pytest.raises(InputError, match="read from place to place"):
        written(path, FRAMES[:1])


@pytest.mark.parametrize("beyond", [0, 1])
def test_a_record_has_a_longest(whole: Path, tmp_path: Path, beyond: int) -> None:
    assert LONGEST_RECORD == 4096
    content = bytearray(whole.read_bytes())
    group = content.index(b"##CG")
    sizes = group + 24 + 8 * content[group + 16] + 24  # behind head, links, record id, cycles, flags and reserve
    content[sizes : sizes + 4] = (LONGEST_RECORD + beyond).to_bytes(4, "little")
    path = tmp_path / "a.mf4"
    path.write_bytes(content)
    _, counts = read(path)
    assert ("records of 4097 bytes" in counts.stream_error) == bool(beyond)


def test_records_without_a_payload_are_no_lines(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.mf4"
    path.write_bytes(whole.read_bytes().replace(b"DataBytes", b"DataBytez"))
    found, counts = read(path)
    assert (found, counts.lines, counts.frames, counts.malformed) == ([], 0, 0, 0)
    assert "DataBytes" in counts.stream_error


def test_a_channel_ends_within_the_record(whole: Path, tmp_path: Path) -> None:
    """Beyond it asammdf would read what is not the file's, and end the process."""
    content = bytearray(whole.read_bytes())
    place = content.rindex(b"##CN")
    offset = place + 24 + 8 * content[place + 16] + 4  # behind head, links, types
    content[offset + 2] = 0x80
    path = tmp_path / "a.mf4"
    path.write_bytes(content)
    found, counts = read(path)
    assert (found, counts.frames) == ([], 0)
    assert "of a record of 84" in counts.stream_error


@pytest.mark.parametrize("beyond", [0, 1])
def test_a_compressed_block_has_a_largest(whole: Path, tmp_path: Path, beyond: int) -> None:
    assert LARGEST_BLOCK == 64 << 20
    content = bytearray(whole.read_bytes())
    place = content.index(b"##DZ")
    content[place + 32 : place + 40] = (LARGEST_BLOCK + beyond).to_bytes(8, "little")
    path = tmp_path / "a.mf4"
    path.write_bytes(content)
    _, counts = read(path)
    assert (f"unpacks to {LARGEST_BLOCK + 1} bytes" in counts.stream_error) == bool(beyond)


def test_without_its_extra_it_says_what_to_install(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "asammdf", None)
    for use in (lambda: read(whole), lambda: written(tmp_path / "b.mf4", FRAMES[:1])):
        with pytest.raises(InputError, match=r"extra 'mdf': pip install 'candaemon\[mdf\]'"):
            use()


@pytest.mark.slow
def test_memory_does_not_grow_with_the_log(tmp_path: Path) -> None:
    path, count = tmp_path / "long.mf4", 400_000
    with OutputFile(path) as file, open_log_writer(file, ["can0"]) as writer:
        for begin in range(0, count, 1000):
            writer.write([Frame(START + k * 10**6, 0, 0x260, bytes(8)) for k in range(begin, begin + 1000)])
    tracemalloc.start()
    try:
        assert sum(len(block) for block in read_log_blocks(path, CHANNELS, LogCounts())) == count
        assert tracemalloc.get_traced_memory()[1] < 15 << 20  # all records take 35 MB
    finally:
        tracemalloc.stop()
