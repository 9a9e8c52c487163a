"""What `candump` shows without `-L`: the same frames as its log, with a time stamp of any kind that tells the time."""

from __future__ import annotations

from pathlib import Path

import pytest

from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.errors import InputError
from candaemon.frames.frame import EXTENDED, Frame

START = 1_533_226_488_434_433_000


def read(path: Path, text: str) -> tuple[list[Frame], LogCounts]:
    path.write_text(text)
    counts = LogCounts()
    found = list(read_log(path, {"can0": 0, "can1": 1}, counts))
    told = counts.frames + counts.malformed + counts.remote + counts.error_frames + counts.other_lines
    assert told + sum(counts.other_channels.values()) == counts.lines == text.count("\n") + (text[-1:] != "\n")
    return found, counts


def test_lines_of_the_screen_to_the_letter(tmp_path: Path) -> None:
    text = """\
 (1533226488.434433)  can0  260   [8]  08 FF FB 00 00 00 18 84
 (2018-08-02 16:14:48.434434)  can1  18FF1234   [2]  AB CD
 (1533226488.434435)  can0       123   [0]
 (1533226488.434436)  can0  RX B -  123  [12]  00 01 02 03 04 05 06 07 08 09 0A 0B
 (1533226488.434437)  can0  TX - -  123  [01]  07   '.'
 (1533226488.434438)  can0  260   [4]  31 32 5D 27   '12]''
 (1533226488.434439)  can1  123   [8]  remote request
 (1533226488.434440)  can1  20000088   [8]  00 00 80 19 00 00 00 00   ERRORFRAME
\tbus-error
(1533226488.434441) can1 260#01
"""
    found, counts = read(tmp_path / "screen.txt", text)
    assert found == [
        Frame(START, 0, 0x260, bytes.fromhex("08FFFB0000001884")),
        Frame(START + 1_000, 1, 0x18FF1234 | EXTENDED, b"\xab\xcd"),
        Frame(START + 2_000, 0, 0x123, b""),
        Frame(START + 3_000, 0, 0x123, bytes(range(12)), True),
        Frame(START + 4_000, 0, 0x123, b"\x07", True),
        Frame(START + 5_000, 0, 0x260, b"12]'"),
        Frame(START + 8_000, 1, 0x260, b"\x01"),
    ]
    assert (counts.remote, counts.error_frames, counts.other_lines, counts.malformed) == (1, 1, 1, 0)


@pytest.mark.parametrize(
    "line",
    [
        " (1533226488.434433)  can0  260   [8]  08 FF FB 00 00 00 18",
        " (1533226488.434433)  can0  260   [1]  00001000",
        " (2018-13-02 16:14:48.434434)  can0  260   [0]",
        " (1533226488.434433)  can0  2600   [0]",
        " (1533226488.434433)  can0  260   [9]  08 FF FB 00 00 00 18 84 00",
    ],
)
def test_what_does_not_add_up_is_malformed_and_told_as_it_is(tmp_path: Path, line: str) -> None:
    found, counts = read(tmp_path / "a.log", f"{line}\n (1533226489.000000)  can0  260   [0]\n")
    assert [frame.time_ns for frame in found] == [1_533_226_489_000_000_000]
    assert counts.malformed == 1


def test_without_times_it_says_how_to_record(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "a.log"
    found, counts = read(path, "  can0  260   [8]  08 FF FB 00 00 00 18 84\n" * 3)
    assert (found, counts.malformed) == ([], 3)
    with pytest.raises(InputError, match="no time stamps; record with `candump -L`, or `-t a`"):
        counts.require_frames(path)
    assert sum("no time stamps" in message for message in caplog.messages) == 1


def test_differences_are_told_from_times(tmp_path: Path) -> None:
    line = " (000.%06d)  can0  260   [1]  00\n"
    times = "".join(line % (k * 100 - (k % 20 == 0) * 150) for k in range(3, 403))
    assert len(read(tmp_path / "a.log", times)[0]) == 400
    path = tmp_path / "b.log"
    path.write_text("".join(line % (k % 3) for k in range(400)))
    counts = LogCounts()
    assert list(read_log(path, {"*": 0}, counts)) == []
    with pytest.raises(InputError, match=r"differences \(`candump -t d`\); record with `candump -L`"):
        counts.require_frames(path)
