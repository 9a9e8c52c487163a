"""What the fuzzers found, told by itself: inputs that took for ever, all memory, or a time that nothing can hold."""

from __future__ import annotations

from pathlib import Path

import can
import pytest

from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.dbc.database import load_database
from candaemon.frames.frame import Frame

SECOND_NS = 1_000_000_000


def frames(path: Path) -> tuple[list[Frame], LogCounts]:
    counts = LogCounts()
    return list(read_log(path, {"*": 0}, counts)), counts


def test_a_trc_cut_in_its_header_has_an_end(tmp_path: Path) -> None:
    path = tmp_path / "cut.trc"
    path.write_text(";$FILEVERSION=2.0\n;\n")
    found, counts = frames(path)
    assert not found
    assert (counts.lines, counts.malformed) == (2, 1)


def test_a_blf_object_of_no_bytes_costs_no_other(tmp_path: Path) -> None:
    path = tmp_path / "zero.blf"
    with can.BLFWriter(path, compression_level=0) as writer:
        for k in range(3):
            writer.on_message_received(can.Message(timestamp=1.5e9 + k, arbitration_id=k, data=bytes(8), channel=0))
    assert len(frames(path)[0]) == 3
    content = path.read_bytes()
    second = content.index(b"LOBJ", content.index(b"LOBJ", content.index(b"LOBJ") + 4) + 4)
    path.write_bytes(content[: second + 8] + bytes(4) + content[second + 12 :])
    found, counts = frames(path)
    assert (len(found), counts.malformed) == (2, 1)


@pytest.mark.parametrize(
    ("seconds", "held"), [("4611686017", True), ("9199999999", False), ("1e30", False), ("-1", False)]
)
def test_a_time_stamp_is_in_range(seconds: str, held: bool, tmp_path: Path) -> None:
    path = tmp_path / "far.csv"
    path.write_text(f"timestamp,arbitration_id,extended,remote,error,dlc,data\n{seconds},0x260,0,0,0,1,AA==\n")
    found, counts = frames(path)
    assert (len(found), counts.malformed) == ((1, 0) if held else (0, 1))
    assert all(frame.time_ns == int(seconds) * SECOND_NS for frame in found)


@pytest.mark.parametrize("line", [' SG_ far : 4294967295|1@0+ (1,0) [0|1] "" A', "BO_ 2 Vast: 4294967295 A"])
def test_a_dbc_of_absurd_size_is_loaded_without_it(line: str, tmp_path: Path) -> None:
    path = tmp_path / "far.dbc"
    path.write_text(f'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ near : 0|8@1+ (1,0) [0|0] "" A\n{line}\n')
    database = load_database(path)
    assert [signal.name for signal in database.message("M").signals] == ["near"]
    assert [(warning.line, "left out" in warning.text) for warning in database.warnings] == [(5, True)]
