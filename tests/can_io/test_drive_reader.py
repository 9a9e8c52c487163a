"""Several logs as one drive, parts of a drive, and logs whose name does not tell their format."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

from candaemon.can_io.drive_reader import DriveReader
from candaemon.can_io.logs.candump import candump_text
from candaemon.can_io.logs.read import frames_of, read_log
from candaemon.can_io.logs.stream import MOST_CHANNELS, UNCLAIMED, EveryChannel, LogCounts
from candaemon.can_io.logs.write import open_log_writer
from candaemon.can_io.time_range import LONGEST_DRIVE_S, WHOLE_DRIVE, DriveMoment, TimeRange, moment
from candaemon.errors import InputError
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import Frame

START = 1_533_226_488_000_000_000
CHANNELS = {"can0": 0, "can1": 1}
FRAMES = [Frame(START + k * 1_000_000, k % 2, 0x200 + k % 16, bytes([k % 256, k // 256])) for k in range(20_000)]


def write(path: Path, frames: list[Frame]) -> Path:
    with OutputFile(path) as file, open_log_writer(file, ["can0", "can1"]) as writer:
        writer.write(frames)
    return path


def read(*logs: Path, within: TimeRange = WHOLE_DRIVE) -> tuple[list[Frame], LogCounts]:
    counts = LogCounts()
    found = list(frames_of(DriveReader(CHANNELS, counts, within).by_time(logs)))
    told = counts.frames + counts.malformed + counts.other_lines + counts.outside + counts.ticks
    assert told == counts.lines
    assert len(found) == counts.frames
    return found, counts


def test_logs_that_follow_one_another_may_be_named_in_any_order(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    parts = [write(tmp_path / f"{k}.log", FRAMES[k * 5000 : (k + 1) * 5000]) for k in range(4)]
    assert read(*parts)[0] == FRAMES
    assert not caplog.messages
    assert read(parts[2], parts[0], parts[3], parts[1])[0] == FRAMES
    assert caplog.messages == ["the logs are read in order of time: 0.log, 1.log, 2.log, 3.log"]


@pytest.mark.parametrize("suffixes", [(".log", ".log"), (".log.gz", ".pcapng"), (".blf", ".log.xz")])
def test_logs_that_overlap_are_merged(tmp_path: Path, suffixes: tuple[str, str]) -> None:
    buses = [write(tmp_path / f"{k}{suffix}", FRAMES[k::2]) for k, suffix in enumerate(suffixes)]
    assert read(*buses)[0] == FRAMES


def test_a_log_keeps_its_own_order_among_others(tmp_path: Path) -> None:
    late = [*FRAMES[:100:2], FRAMES[0]._replace(data=b"late"), *FRAMES[100::2]]
    first, second = write(tmp_path / "a.log", late), write(tmp_path / "b.log", FRAMES[1::2])
    found, _ = read(first, second)
    assert [frame for frame in found if frame.bus == 0] == late
    assert [frame for frame in found if frame.bus == 1] == FRAMES[1::2]
    far = [frame._replace(time_ns=frame.time_ns + 10**18) if k == 70 else frame for k, frame in enumerate(FRAMES[::2])]
    found, _ = read(write(tmp_path / "c.log", far), second)
    assert found[1000:] == FRAMES[1000:]  # one stray stamp holds nothing up


def test_logs_without_a_date_follow_one_another_as_named(tmp_path: Path) -> None:
    parts = [write(tmp_path / f"{k}.asc", FRAMES[k * 100 : (k + 1) * 100]) for k in range(2)]
    found, _ = read(parts[1], parts[0])
    assert [frame.data for frame in found] == [frame.data for frame in (*FRAMES[100:200], *FRAMES[:100])]
    assert [frame.time_ns for frame in found] == [k * 1_000_000 - (k > 99) * 1_000_000 for k in range(200)]
    dated = write(tmp_path / "a.log", FRAMES[:10])
    assert [frame.time_ns - START for frame in read(dated, parts[1])[0]][9:12] == [9_000_000, 9_000_000, 10_000_000]
    assert read(parts[1], dated)[0][100:] == FRAMES[:10]
    early = [
        write(tmp_path / f"up{k}.log", [Frame(k * 10**9, 0, 1, b"")]) for k in range(2)
    ]  # of one clock, since power-on
    assert [frame.time_ns for frame in read(*early)[0]] == [0, 10**9]
    within = TimeRange(DriveMoment(150_000_000, since_begin=True), None)
    assert [frame.data for frame in read(*parts, within=within)[0]] == [frame.data for frame in FRAMES[151:200]]


def test_a_log_without_frames_costs_the_others_nothing(tmp_path: Path) -> None:
    (tmp_path / "empty.log").write_bytes(b"garbage\n")
    found, counts = read(tmp_path / "empty.log", write(tmp_path / "a.log", FRAMES[:10]))
    assert (found, counts.malformed) == (FRAMES[:10], 1)
    os.mkfifo(tmp_path / "pipe.log")
    with pytest.raises(InputError, match="it is no file, and is read alone"):
        read(tmp_path / "a.log", tmp_path / "pipe.log")


def test_of_several_logs_messages_name_theirs_and_count_its_lines(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    first, second = write(tmp_path / "a.log", FRAMES[:10]), write(tmp_path / "b.log", FRAMES[10:20])
    second.write_bytes(second.read_bytes() + b"garbage\ncut")
    found, counts = read(first, second)
    assert (found, counts.malformed, counts.truncated) == (FRAMES[:20], 2, True)
    assert counts.bytes_read == counts.bytes_total == first.stat().st_size + second.stat().st_size
    assert counts.examples == [f"{second}, line 11: 'garbage'", f"{second}, line 12: 'cut'"]
    assert f"{second} ends early: its last line is cut short; what came before it is used" in caplog.messages
    assert read(second)[1].examples[0] == "line 11: 'garbage'"


def test_a_log_is_named_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    first, copy = write(tmp_path / "a.log", FRAMES[:10]), write(tmp_path / "copy.pcapng", FRAMES[:10])
    with pytest.raises(
        InputError, match=r"copy\.pcapng: it is the same log as .*a\.log, or begins with the same frame"
    ):
        read(first, copy)
    relative = write(tmp_path / "r.asc", FRAMES[:10])
    with pytest.raises(InputError, match=r"r\.asc: it is the same log as"):
        read(relative, relative)
    for name in ("k", "l"):
        (tmp_path / f"{name}.log").write_text(f"(1533226487.9) tick 000#\n{first.read_text()}", encoding="utf-8")
    with pytest.raises(InputError, match=r"l\.log: it is the same log as"):
        read(tmp_path / "k.log", tmp_path / "l.log")
    later = [frame._replace(time_ns=frame.time_ns + 3 * 86400 * 10**9) for frame in FRAMES[:10]]
    assert len(read(first, write(tmp_path / "later.log", later))[0]) == 20
    assert caplog.messages == ["a.log begins 3.0 days before later.log: they are read as one drive"]


def test_a_part_of_a_drive(tmp_path: Path) -> None:
    log = write(tmp_path / "a.log", FRAMES)
    since = TimeRange(DriveMoment(2_000_000_000, since_begin=True), DriveMoment(3_000_000_000, since_begin=True))
    found, counts = read(log, within=since)
    assert found == FRAMES[2000:3000]
    assert counts.outside > 0
    absolute = TimeRange(DriveMoment(START + 19_999_000_000, since_begin=False), None)
    found, counts = read(log, within=absolute)
    assert (found, counts.outside) == (FRAMES[19_999:], 19_999)
    parts = [read(log, within=TimeRange(moment(f"{k * 4}"), moment(f"{k * 4 + 4}")))[0] for k in range(5)]
    assert [frame for part in parts for frame in part] == FRAMES
    buses = [write(tmp_path / f"bus{k}.log", FRAMES[k::2]) for k in range(2)]
    assert read(*buses, within=since)[0] == FRAMES[2000:3000]
    _, counts = read(log, within=TimeRange(moment("1000")))
    with pytest.raises(InputError, match="20000 outside of the range of time; check the range of time"):
        counts.require_frames(log)


def test_a_moment_is_read_up_to_its_limits() -> None:
    assert moment("12.5") == DriveMoment(12_500_000_000, since_begin=True)
    assert moment("@1533226488.5") == DriveMoment(START + 500_000_000, since_begin=False)
    assert moment("@1533226488") == moment("2018-08-02T16:14:48Z") == moment("2018-08-02 16:14:48")
    assert moment("2018-08-02T18:14:48.000001+02:00") == DriveMoment(START + 1_000, since_begin=False)
    assert moment(f"{LONGEST_DRIVE_S:.0f}").time_ns == 10**18
    for wrong in ("1000000000.1", "-1", "nan", "@-1", "@9999999999", "1960-01-01", "1e3", "", "12:00"):
        with pytest.raises(ValueError):  # noqa: PT011 - Python's own message or this one
            moment(wrong)


def test_so_many_channels_get_a_bus_each() -> None:
    every = EveryChannel()
    assert [every.named(f"c{k}") for k in range(MOST_CHANNELS)] == list(range(MOST_CHANNELS))
    assert every.named("one more") == UNCLAIMED
    assert (every.named("c5"), every.numbered(5)) == (5, UNCLAIMED)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv", ".mf4", ".pcap", ".pcapng", ".trc", ".log.xz"])
def test_a_name_that_tells_no_format_leaves_it_to_the_content(tmp_path: Path, suffix: str) -> None:
    if suffix == ".mf4":
        pytest.importorskip("asammdf")
    log = write(tmp_path / f"a{suffix}", FRAMES[:50])
    found = list(read_log(log.rename(tmp_path / "a.txt"), {"*": 0}, LogCounts()))
    assert [frame.data for frame in found] == [frame.data for frame in FRAMES[:50]]
    (tmp_path / "b.txt").write_text("Dear diary, today I drove.")
    with pytest.raises(InputError, match=r"found the suffix '\.txt', expected one of \.log"):
        read_log(tmp_path / "b.txt", {"*": 0}, LogCounts())


def test_a_pipe_gives_what_is_there_without_waiting_for_more(tmp_path: Path) -> None:
    os.mkfifo(path := tmp_path / "pipe")
    came, counts, more = threading.Event(), LogCounts(), threading.Event()

    def record() -> None:
        with path.open("wb", buffering=0) as pipe:
            pipe.write(candump_text(FRAMES[:3], ["can0", "can1"]))
            assert came.wait(60)
            pipe.write(candump_text(FRAMES[3:5], ["can0", "can1"]))
        more.set()

    threading.Thread(target=record, daemon=True).start()
    frames = read_log(path, CHANNELS, counts)
    assert [next(frames) for _ in range(3)] == FRAMES[:3]
    came.set()
    assert list(frames) == FRAMES[3:5]
    assert more.wait(60)
    assert (counts.bytes_total, counts.frames) == (0, 5)
