"""Recorded logs of any content: every line is counted as something, and neither memory nor time runs away."""

from __future__ import annotations

import gzip
import resource
import subprocess
import sys
import zlib
from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.can_io.logs.candump import candump_text
from candaemon.can_io.logs.formats import LOG_SUFFIXES, TEXT_SUFFIXES
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import FURTHER_CHANNELS, LONGEST_LINE, MOST_OTHER_CHANNELS, LogCounts
from candaemon.can_io.logs.write import open_log_writer
from candaemon.errors import InputError
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import EXTENDED, Frame
from tests.can_io.test_blf import blf, classic, obj, packed
from tests.support.effort import examples
from tests.support.memory import PEAK_MIB
from tests.support.paths import ROOT

START = 1_533_226_488_434_433_000
NAMES = ["can0", "can1", "can2"]
CHANNELS = {"can0": 0, "can1": 1}
TEXT = list(TEXT_SUFFIXES)
HEADS = {
    ".log": b"",
    ".asc": b"date Sat Aug 2 10:00:00.000 2018\nbase hex  timestamps absolute\ninternal events logged\n",
    ".csv": b"timestamp,arbitration_id,extended,remote,error,dlc,data\n",
    ".trc": b";$FILEVERSION=2.0\n;$STARTTIME=43314.4\n;$COLUMNS=N,O,T,I,d,l,D\n",
}
LINES = {
    ".log": b"(1533226488.434433) can0 260#08FFFB0000001884\n",
    ".asc": b"0.010000 1  260             Rx   d 8 08 FF FB 00 00 00 18 84\n",
    ".csv": b"1533226488.434433,0x260,0,0,0,8,CP/7AAAAGIQ=\n",
    ".trc": b"      1         1.000 DT     0260 Rx 8  08 FF FB 00 00 00 18 84\n",
}


def balanced(path: Path, channels: dict[str, int] | None = None) -> tuple[list[Frame], LogCounts]:
    """Read a log; hold that each line is counted as one thing."""
    counts = LogCounts()
    found = list(read_log(path, channels or CHANNELS, counts))
    told = counts.frames + counts.malformed + counts.remote + counts.error_frames + counts.ticks + counts.other_lines
    assert told + sum(counts.other_channels.values()) == counts.lines
    assert counts.frames + counts.ticks == len(found)
    return found, counts


@settings(deadline=None, max_examples=examples(300))
@given(
    suffix=st.sampled_from(LOG_SUFFIXES),
    changes=st.lists(
        st.tuples(
            st.integers(0, 1 << 20), st.sampled_from([b"", b"\n", b"\r", b" ", b"R", b"9", b"x", b"#", b"\xff", b"\0"])
        ),
        max_size=12,
    ),
    cut=st.none() | st.integers(0, 1 << 20),
    packed=st.booleans(),
)
def test_every_line_is_counted_as_one_thing(
    suffix: str,
    changes: list[tuple[int, bytes]],
    cut: int | None,
    packed: bool,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    path = tmp_path_factory.getbasetemp() / f"damaged{suffix}"
    with OutputFile(path) as file, open_log_writer(file, NAMES) as writer:
        writer.write(
            [Frame(START + k * 10**6, k % 3, 0x100 + k | EXTENDED * (k % 2), bytes([k, 255])) for k in range(60)]
        )
    content = path.read_bytes()
    for place, text in changes:
        place %= len(content)
        content = content[:place] + text + content[place + 1 :]
    content = content if cut is None else content[: cut % len(content)]
    if packed:
        path = path.with_name(f"{path.name}.gz")
        content = gzip.compress(content, 1)
    path.write_bytes(content)
    _, counts = balanced(path)
    if suffix in TEXT and not packed:
        # a carriage return ends a line for python-can's readers
        text = content if suffix == ".log" else content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        assert counts.lines == text.count(b"\n") + (not text.endswith(b"\n") and bool(text))


@pytest.mark.parametrize("suffix", TEXT)
def test_headers_blank_lines_and_comments_are_other_lines(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    comments = {".asc": b"// a comment\n0.1 log trigger event\n", ".trc": b"; a comment\n"}.get(suffix, b"")
    blank = b"" if suffix == ".csv" else b"\n \n"
    path.write_bytes(HEADS[suffix] + comments + blank + LINES[suffix] * 20 + blank * 20)
    _, counts = balanced(path, {"*": 0})
    assert (counts.frames, counts.malformed) == (20, 0)
    assert counts.other_lines == counts.lines - 20


@pytest.mark.parametrize("beyond", [0, 1])
@pytest.mark.parametrize("suffix", TEXT)
def test_a_line_has_a_longest(tmp_path: Path, suffix: str, beyond: int) -> None:
    path = tmp_path / f"a{suffix}"
    # blanks that the formats allow between fields, or a comment's
    long = LINES[suffix].strip()
    long = (b" " * (LONGEST_LINE + beyond - len(long)) + long) + b"\n"
    path.write_bytes(HEADS[suffix] + LINES[suffix] + long + LINES[suffix])
    _, counts = balanced(path, {"*": 0})
    assert counts.malformed == beyond
    assert counts.frames == 3 - beyond


@pytest.mark.parametrize("suffix", TEXT)
@pytest.mark.parametrize("last", [b"", b"\n"])
def test_a_line_without_end_costs_no_other(tmp_path: Path, suffix: str, last: bytes) -> None:
    path = tmp_path / f"a{suffix}"
    endless = b"x" * 3_000_000
    path.write_bytes(HEADS[suffix] + LINES[suffix] + endless + b"\n" + LINES[suffix] * 2 + endless + last)
    _, counts = balanced(path, {"*": 0})
    assert (counts.frames, counts.malformed) == (3, 2)
    assert all(len(example) < 120 for example in counts.examples)


@pytest.mark.parametrize("suffix", TEXT)
def test_a_file_without_frames_ends(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("candump", "read"):
        monkeypatch.setattr(f"candaemon.can_io.logs.{module}.MOST_IN_VAIN", 20_000)
    path = tmp_path / f"a{suffix}"
    path.write_bytes(HEADS[suffix] + b"\n" * 19_000 + LINES[suffix])
    assert balanced(path, {"*": 0})[1].frames == 1
    path.write_bytes(HEADS[suffix] + LINES[suffix] + b"\n" * 2_000_000 + LINES[suffix])
    _, counts = balanced(path, {"*": 0})
    assert (counts.frames, counts.truncated) == (1, True)
    assert "this is no CAN log" in counts.stream_error


def test_channels_are_counted_by_name_up_to_a_limit(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    frames = [Frame(START, k, 0x100, b"") for k in range(1000)]
    path.write_bytes(candump_text(frames * 2, [f"x{k}" for k in range(1000)]))
    _, counts = balanced(path)
    assert len(counts.other_channels) == MOST_OTHER_CHANNELS + 1
    assert counts.other_channels[FURTHER_CHANNELS] == 2 * (1000 - MOST_OTHER_CHANNELS)
    with pytest.raises(InputError) as caught:
        counts.require_frames(path)
    assert len(str(caught.value)) < 1000
    path.write_bytes(candump_text(frames[:MOST_OTHER_CHANNELS], [f"x{k}" for k in range(1000)]))
    assert FURTHER_CHANNELS not in balanced(path)[1].other_channels


@pytest.mark.parametrize("suffix", [".log", ".csv"])
def test_what_follows_a_gzip_member(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}.gz"
    one = gzip.compress(HEADS[suffix] + LINES[suffix])
    path.write_bytes(one + gzip.compress(LINES[suffix]) + bytes(100))
    _, counts = balanced(path, {"*": 0})
    assert (counts.frames, counts.truncated) == (2, False)
    path.write_bytes(one + b"garbage" * 100)
    _, counts = balanced(path, {"*": 0})
    assert (counts.frames, counts.truncated) == (1, True)


def bomb(content: Iterable[bytes], head: bytes = b"") -> bytes:
    """Return a gzip file that unpacks to content of any length."""
    packer = zlib.compressobj(9, zlib.DEFLATED, 31)
    return b"".join([packer.compress(head), *map(packer.compress, content), packer.flush()])


MEASURED = f"""
import sys, time
from pathlib import Path
from candaemon.can_io.logs.read import read_log_blocks
from candaemon.can_io.logs.stream import LogCounts
counts = LogCounts()
began = time.process_time()
for _ in read_log_blocks(Path(sys.argv[1]), {{"*": 0}}, counts):
    pass
print({PEAK_MIB}, time.process_time() - began, counts.frames)
"""


def measured(path: Path) -> tuple[float, float, int]:
    """Read a log in a process of its own; return its most MiB, its CPU time in s, and the frames."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, str(path)],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30)),
        timeout=300,
    )
    megabytes, seconds, frames = done.stdout.split()
    return float(megabytes), float(seconds), int(frames)


SLOW = [pytest.param(filler, marks=pytest.mark.slow) for filler in (b"\n", b"x\n", b"x" * 15 + b"\n", b"7,")]


@pytest.mark.parametrize("suffix", TEXT)
@pytest.mark.parametrize("filler", [b"\0", *SLOW])
def test_a_small_file_that_unpacks_to_much_takes_little(tmp_path: Path, suffix: str, filler: bytes) -> None:
    path = tmp_path / f"a{suffix}.gz"
    path.write_bytes(bomb([filler * ((16 << 20) // len(filler))] * 6, HEADS[suffix] + LINES[suffix]))
    assert path.stat().st_size < 200_000
    megabytes, seconds, frames = measured(path)
    assert frames == 1
    assert megabytes < 150  # reached: 75
    assert seconds < 20  # reached: 0.3 to 6


@pytest.mark.parametrize("method", [0, 2])
def test_a_small_blf_that_unpacks_to_much_takes_little(tmp_path: Path, method: int) -> None:
    packer = zlib.compressobj(9)
    zeros = b"".join([packer.compress(bytes(16 << 20)) for _ in range(6)] + [packer.flush()])
    container = packed(obj(1, classic()))
    huge = container[:8] + (32 + len(zeros)).to_bytes(4, "little") + container[12:16] + method.to_bytes(2, "little")
    path = tmp_path / "a.blf"
    path.write_bytes(blf(container, huge + container[18:32] + zeros, container))
    megabytes, seconds, frames = measured(path)
    assert frames == 2
    assert megabytes < 250
    assert seconds < 20


def test_a_line_that_python_can_skips_is_counted_and_not_told_by_it(tmp_path: Path) -> None:
    path = tmp_path / "a.trc"
    path.write_bytes(HEADS[".trc"] + LINES[".trc"] + b"x\n" * 100)
    code = MEASURED.replace("print(", "print(counts.lines, counts.frames + counts.malformed + counts.other_lines) or (")
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True, cwd=ROOT)
    assert len(set(done.stdout.split())) == 1
    assert len(done.stderr.splitlines()) < 10
