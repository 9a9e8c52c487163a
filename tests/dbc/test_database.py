"""DBC files as vendors really write them: each loads, and each repair and oddity is told with its line."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path

import cantools
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from candaemon.dbc.database import load_database
from candaemon.dbc.types import Database
from candaemon.errors import ConfigError, DatabaseError
from candaemon.frames.frame import EXTENDED
from tests.support.effort import examples
from tests.support.paths import DATA, ROOT

FILES = sorted([*(DATA / "dbc").glob("*.dbc"), *(ROOT / "dbc").glob("*.dbc")])

GOOD = """VERSION ""

NS_ :
\tCM_
\tVAL_

BS_:

BU_: RADAR ECU

BO_ 256 TRACK: 8 RADAR
 SG_ RANGE : 0|12@1+ (0.1,0) [0|300] "m" ECU
 SG_ RATE : 12|12@1- (0.05,0) [-102.4|102.35] "m/s" ECU
 SG_ STATE : 31|3@0+ (1,0) [0|0] "" ECU,RADAR

CM_ BO_ 256 "One object;
BO_ 1 is only text here";
CM_ SG_ 256 RANGE "along the line of sight // not a comment";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 256 50;
VAL_ 256 STATE 0 "none" 4 "coasted";
"""


def load(folder: Path, text: str | bytes) -> Database:
    path = folder / "some.dbc"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_database(path)


def told(database: Database) -> list[tuple[int, str]]:
    return [(warning.line, warning.text) for warning in database.warnings]


def line_of(text: str, part: str) -> int:
    return text[: text.index(part)].count("\n") + 1


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_real_files_load_as_cantools_loads_them(path: Path) -> None:
    database = load_database(path)
    oracle = cantools.database.load_file(path, strict=False)
    assert isinstance(oracle, cantools.database.Database)
    assert set(database.messages) == {message.name for message in oracle.messages}
    for message in oracle.messages:
        spec = database.message(message.name)
        assert spec.can_id == message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        assert (spec.length, spec.comment) == (message.length, message.comment or "")
        assert [s.name for s in spec.signals] == [s.name for s in message.signals]
        lines = path.read_text("cp1252").splitlines()
        assert f" {spec.name}:" in lines[spec.line - 1].replace(" :", ":")
        assert all(f"SG_ {s.name} " in lines[s.line - 1] for s in spec.signals)


@pytest.mark.parametrize("path", sorted((ROOT / "dbc").glob("*.dbc")), ids=lambda path: path.name)
def test_own_files_load_without_a_warning(path: Path) -> None:
    assert load_database(path).warnings == ()


def test_overlaps_of_the_real_car_are_told(vendor_dbc: Path) -> None:
    database = load_database(vendor_dbc / "toyota_nodsu_pt_generated.dbc")
    lines = [(w.line, "overlap" in w.text and "PCS_HUD" in w.text) for w in database.warnings]
    assert lines == [(264, True), (264, True), (267, True)]
    assert str(database.warnings[0]).startswith(f"{database.path}:264: signals ")


def test_everything_of_a_good_file(tmp_path: Path) -> None:
    database = load(tmp_path, GOOD)
    assert database.warnings == ()
    message = database.message("TRACK")
    assert database.by_id[256] is message
    assert (message.length, message.is_fd, message.cycle_time) == (8, False, 0.05)
    assert message.comment.startswith("One object;")
    rate, state = message.signal("RATE"), message.signal("STATE")
    assert (rate.start, rate.length, rate.byte_order, rate.signed) == (12, 12, "little", True)
    assert (rate.scale, rate.offset, rate.minimum, rate.maximum, rate.unit) == (0.05, 0, -102.4, 102.35, "m/s")
    assert (state.byte_order, state.minimum, state.maximum, state.choices) == (
        "big",
        None,
        None,
        {0: "none", 4: "coasted"},
    )
    assert message.signal("RANGE").comment.endswith("// not a comment")
    assert [s.line for s in (message.signal("RANGE"), rate, state)] == [12, 13, 14]
    hash(message)


def test_wrong_names_are_answered_with_near_ones(tmp_path: Path) -> None:
    database = load(tmp_path, GOOD)
    with pytest.raises(ConfigError, match=r"some\.dbc: no message 'TRAK'; did you mean 'TRACK'\?"):
        database.message("TRAK")
    with pytest.raises(
        ConfigError, match=r"some\.dbc:11: message 'TRACK' has no signal 'rnge'; did you mean 'RANGE'\?"
    ):
        database.message("TRACK").signal("rnge")
    with pytest.raises(ConfigError, match=r"it has 'RANGE', 'RATE', 'STATE'"):
        database.message("TRACK").signal("voltage")


REPAIRS = {
    "orphan value table": ('VAL_ 256 GONE 0 "none";\n', "'GONE' of message 256, which is not there"),
    "value table of no message": ('VAL_ 999 STATE 0 "none";\n', "of message 999, which is not there"),
    "bad value table": ('VAL_ 256 RATE 0.5 "half";\n', "expected 'VAL_ "),
    "orphan float": ("SIG_VALTYPE_ 256 GONE : 1;\n", "'GONE' of message 256, which is not there"),
    "float of 12 bits": ("SIG_VALTYPE_ 256 RANGE : 1;\n", "'RANGE' of 12 bits cannot be a float"),
    "no semicolon": ('CM_ SG_ 256 RATE "Doppler"\n', "without the ';'"),
    "text after semicolon": ('CM_ SG_ 256 RATE "Doppler"; and more\n', "text after the ';'"),
    "signal outside any message": (' SG_ LOST : 0|8@1+ (1,0) [0|0] "" ECU\n', "SG_ outside of any message"),
    "endless multiplexing": ("SG_MUL_VAL_ 256 RATE STATE 0-4294967295;\n", "65536 ids at most"),
    "attribute without definition": ('BA_ "Nowhere" BO_ 256 3;\n', "which nothing defines"),
    "nonsense": ("BA_DEF_ what is this;\n", "expected 'BA_DEF_ "),
    "open string": ('CM_ SG_ 256 RATE "Doppler ;\nCM_ SG_ 256 STATE "as told";\n', "never closed"),
    "message without a name": ("BO_ 257 : 8 RADAR\n", "expected 'BO_ "),
    "message twice": (
        'BO_ 300 TRACK: 8 RADAR\n SG_ RANGE : 0|8@1+ (1,0) [0|0] "" ECU\n',
        "message 'TRACK' is already at line 11",
    ),
    "identifier twice": (
        'BO_ 256 OTHER: 8 RADAR\n SG_ RANGE : 0|8@1+ (1,0) [0|0] "" ECU\n',
        "has the identifier of line 11",
    ),
    "identifier over 29 bits": ("BO_ 4294967295 HUGE: 8 RADAR\n", "over 29 bits"),
    "extended bit missing": ('BO_ 2048 LONG: 8 RADAR\n SG_ A : 0|8@1+ (1,0) [0|0] "" ECU\n', "taken as extended"),
    "FD not marked": ('BO_ 300 FD: 32 RADAR\n SG_ A : 200|8@1+ (1,0) [0|0] "" ECU\n', "taken as CAN FD"),
    "longer than a frame": (
        'BO_ 300 TP: 90 RADAR\n SG_ A : 600|8@1+ (1,0) [0|0] "" ECU\n',
        "90 bytes, a CAN FD frame 64",
    ),
    "signal outside": (
        'BO_ 300 S: 2 RADAR\n SG_ A : 12|8@1+ (1,0) [0|0] "" ECU\n',
        "lies outside message 'S' of 2 bytes",
    ),
    "range beyond": ('BO_ 300 S: 2 RADAR\n SG_ A : 0|8@1+ (1,0) [-9|-2] "" ECU\n', "beyond its bits"),
    "scale 0": ('BO_ 300 S: 2 RADAR\n SG_ A : 0|8@1+ (0,0) [0|0] "" ECU\n', "scale 0"),
    "indented": ('  BO_ 300 S: 2 RADAR\n SG_ A : 0|8@1+ (1,0) [0|0] "" ECU\n', "is indented"),
    "no such multiplexer": (
        (
            'BO_ 300 S: 2 RADAR\n SG_ A : 0|8@1+ (1,0) [0|0] "" ECU\n SG_ B m1 : 8|8@1+ (1,0) [0|0] "" ECU\n'
            "SG_MUL_VAL_ 300 B A 1-1;\n"
        ),
        "selected by 'A', no multiplexer",
    ),
    "no multiplexer": (
        'BO_ 300 S: 2 RADAR\n SG_ A m1 : 0|8@1+ (1,0) [0|0] "" ECU\n',
        "'A' of message 'S' is marked m1, but there is no multiplexer for it: taken from every frame",
    ),
    "one of two multiplexers": (
        (
            'BO_ 300 S: 3 RADAR\n SG_ A M : 0|8@1+ (1,0) [0|0] "" ECU\n SG_ B M : 8|8@1+ (1,0) [0|0] "" ECU\n'
            ' SG_ C m1 : 16|8@1+ (1,0) [0|0] "" ECU\n'
        ),
        "'C' of message 'S' is marked m1, but no SG_MUL_VAL_ says by which multiplexer: taken from every frame",
    ),
}


@pytest.mark.parametrize("name", REPAIRS)
def test_each_fault_is_told_and_the_rest_loads(tmp_path: Path, name: str) -> None:
    fault, expected = REPAIRS[name]
    text = GOOD + fault
    database = load(tmp_path, text)
    first = line_of(text, fault)
    assert [words for line, words in told(database) if first <= line < first + fault.count("\n") and expected in words]
    assert len(database.warnings) == 1
    assert [replace(s, choices=None, comment="") for s in database.by_id[256].signals] == [
        replace(s, choices=None, comment="") for s in load(tmp_path, GOOD).message("TRACK").signals
    ]
    assert all(message.signals for message in database.messages.values() if message.line >= first)


BAD_SIGNALS = {
    "no bits": ' SG_ BAD : 0|0@1+ (1,0) [0|0] "" ECU',
    "no scale": ' SG_ BAD : 0|8@1+ [0|0] "" ECU',
    "a number cantools does not know": ' SG_ BAD : 0|8@1+ (.5,0) [0|0] "" ECU',
    "an infinite scale": ' SG_ BAD : 0|8@1+ (1e999,0) [0|0] "" ECU',
    "an open unit": ' SG_ BAD : 0|8@1+ (1,0) [0|0] "m ECU',
    "a keyword for a name": ' SG_ FILTER : 0|8@1+ (1,0) [0|0] "" ECU',
    "a strange multiplexer": ' SG_ BAD mX : 0|8@1+ (1,0) [0|0] "" ECU',
    "a name used above": ' SG_ RANGE : 40|8@1+ (1,0) [0|0] "" ECU',
}


@pytest.mark.parametrize("name", BAD_SIGNALS)
def test_a_bad_signal_alone_is_left_out(tmp_path: Path, name: str) -> None:
    text = GOOD.replace(" SG_ STATE", BAD_SIGNALS[name] + "\n SG_ STATE")
    database = load(tmp_path, text)
    assert [(line, words.endswith("left out")) for line, words in told(database)] == [(14, True)]
    assert [s.name for s in database.message("TRACK").signals] == ["RANGE", "RATE", "STATE"]
    assert database.message("TRACK").signal("STATE").choices is not None


def test_blank_line_and_missing_receiver_are_mended(tmp_path: Path) -> None:
    text = GOOD.replace(' SG_ STATE : 31|3@0+ (1,0) [0|0] "" ECU,RADAR', '\n SG_ STATE : 31|3@0+ (1,0) [0|0] ""')
    database = load(tmp_path, text)
    assert [line for line, _ in told(database)] == [15, 15]
    assert len(database.message("TRACK").signals) == 3


def test_references_follow_a_mended_identifier(tmp_path: Path) -> None:
    text = GOOD.replace("256", "218000000")
    database = load(tmp_path, text)
    message = database.by_id[218000000 | EXTENDED]
    assert message.signal("STATE").choices == {0: "none", 4: "coasted"}
    assert (message.cycle_time, message.comment[:3]) == (0.05, "One")
    assert [line for line, _ in told(database)] == [11]


def test_multiplexed_signals_share_bits_without_a_warning(tmp_path: Path) -> None:
    signals = (
        ' SG_ MODE M : 0|8@1+ (1,0) [0|0] "" ECU\n SG_ A m0 : 8|8@1+ (1,0) [0|0] "" ECU\n'
        ' SG_ B m1 : 8|8@1+ (1,0) [0|0] "" ECU\n SG_ C m1 : 12|8@1+ (1,0) [0|0] "" ECU\n'
    )
    database = load(tmp_path, "BO_ 1 MUX: 8 RADAR\n" + signals)
    assert told(database) == [(5, "signals 'B' and 'C' of message 'MUX' overlap: both are read")]
    b = database.message("MUX").signal("B")
    assert (b.multiplexer_signal, b.multiplexer_ids, b.is_multiplexer) == ("MODE", frozenset({1}), False)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    database = load(tmp_path, GOOD.replace('"m/s"', '"°/s"').encode(encoding))
    assert database.message("TRACK").signal("RATE").unit == "°/s"
    assert database.warnings == ()


def test_carriage_returns(tmp_path: Path) -> None:
    database = load(tmp_path, GOOD.replace("\n", "\r\n"))
    assert database.warnings == ()
    assert database.message("TRACK").line == 11


@pytest.mark.parametrize("text", ["", "not a DBC", 'VERSION ""\n', "BO_ what: 8 X\n", "\0\xff"])
def test_a_file_without_messages_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(DatabaseError, match=r"some\.dbc.*expected a DBC file with lines such as 'BO_ "):
        load(tmp_path, text)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DatabaseError, match=r"none\.dbc: cannot be read \(No such file"):
        load_database(tmp_path / "none.dbc")


@settings(deadline=None, max_examples=examples(150), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 1 << 32), edits=st.integers(1, 6))
def test_no_damage_to_a_file_escapes_the_loader(tmp_path: Path, seed: int, edits: int) -> None:
    chance = random.Random(seed)  # noqa: S311 - damage, not secrets
    text = GOOD
    for _ in range(edits):
        at = chance.randrange(len(text))
        junk = chance.choice(['"', ";", "\n", ":", "SG_", "BO_ ", "@", "9", "m1", " ", "|", "//", "-1", "VAL_ "])
        text = text[:at] + junk + text[at + chance.choice([0, 0, 1, 5, 30]) :]
    try:
        database = load(tmp_path, text)
    except DatabaseError:
        pass  # refused whole, with a message
    else:
        assert all(1 <= warning.line <= text.count("\n") + 1 for warning in database.warnings)
        assert database.messages
