"""DBC files that are meant to do harm: each loads, or is refused, in seconds and in little memory, and says so."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from candaemon.dbc import bits, database, lint
from candaemon.dbc.database import load_database
from candaemon.dbc.database_bytes import LONGEST_FILE
from candaemon.dbc.single_codec import compile_decoder, compile_encoder
from candaemon.dbc.types import Database, MessageSpec, SignalSpec
from candaemon.errors import DatabaseError
from tests.support.dbc_bombs import BOMBS, signal
from tests.support.memory import PEAK_MIB

MESSAGE = "BO_ 256 TRACK: 8 RADAR\n"
RANGE = signal("RANGE", 0, 12)
MOST_SECONDS, MOST_MEBIBYTES = 10.0, 400.0
LOADING = f"""
import pathlib, sys, time
import cantools
from candaemon.dbc.database import load_database
from candaemon.errors import DatabaseError
begin = time.process_time()
for path in sys.argv[1:]:
    try:
        load_database(pathlib.Path(path))
    except DatabaseError:
        pass
print(time.process_time() - begin, {PEAK_MIB})
"""
"""Prints s of CPU time that the files take, beside the import of their parser, and MiB at most."""


def load(folder: Path, text: str | bytes) -> Database:
    path = folder / "some.dbc"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_database(path)


def told(loaded: Database) -> list[str]:
    return [warning.text for warning in loaded.warnings]


def hold_cost(folder: Path, names: Sequence[str]) -> None:
    """Hold that some bombs together take little time and memory."""
    paths = [folder / f"{name}.dbc" for name in names]
    for name, path in zip(names, paths, strict=True):
        path.write_text(BOMBS[name](), encoding="utf-8")
    done = subprocess.run([sys.executable, "-c", LOADING, *paths], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    seconds, mebibytes = map(float, done.stdout.split())
    assert seconds < MOST_SECONDS
    assert mebibytes < MOST_MEBIBYTES


def test_the_worst_together_take_seconds_and_little_memory(tmp_path: Path) -> None:
    hold_cost(
        tmp_path,
        [
            "undefined_attributes",
            "overlapping_signals",
            "one_bit_signals",
            "long_selections",
            "multiplexed_products",
            "deep_multiplexers",
            "exponent_of_an_attribute",
            "digits_of_a_mebibyte",
            "long_comment",
        ],
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", BOMBS)
def test_each_takes_seconds_and_little_memory(tmp_path: Path, name: str) -> None:
    hold_cost(tmp_path, [name])


LEFT_OUT = {
    "undefined_attributes": (1, "BA_ of attribute 'Nowhere7', which nothing defines: left out"),
    "bad_definitions": (1, "expected 'BA_DEF_ BO_ \"attribute\" type …;': left out"),
    "bad_defaults": (1, "BA_ of attribute 'GenMsgCycleTime' with a value that it does not have: left out"),
    "bad_comments": (1, "expected 'CM_ SG_ identifier signal \"text\";': left out"),
    "overlapping_signals": (2048, "952 signals of message 'TRACK' beyond the 2,048 that are read: left out"),
    "one_bit_signals": (2048, "14,336 signals of message 'TRACK' beyond the 2,048 that are read: left out"),
    "long_signals": (0, "signal 'S9' has 16384 bits, 512 at most: left out"),
    "long_selections": (201, "12,805,268 multiplexer values in SG_MUL_VAL_ beyond the 262,144 that are read: left out"),
    "many_ranges": (2, "of 65536 ids at most: left out"),
    "deep_multiplexers": (64, "signal 'S9' is selected by 'S8', within more than 8 others: never read"),
    "multiplexers_in_a_circle": (3, "signal 'C' is selected by 'A', within more than 8 others: never read"),
    "multiplexed_by_itself": (3, "signal 'A' is selected by 'A', within more than 8 others: never read"),
    "number_of_4300_digits": (1, "expected 'SG_ name"),
    "start_of_4300_digits": (1, "expected 'SG_ name"),
    "identifier_of_4300_digits": (1, "expected 'BO_ identifier"),
    "length_of_4300_digits": (1, "expected 'BO_ identifier"),
    "mark_of_4300_digits": (1, "expected 'SG_ name"),
    "reference_of_4300_digits": (1, "expected 'CM_ SG_"),
    "value_of_4300_digits": (1, "expected 'VAL_ identifier"),
    "selection_of_4300_digits": (2, "expected 'SG_MUL_VAL_ identifier"),
    "attribute_of_4300_digits": (1, "expected 'BA_DEF_DEF_ "),
    "exponent_of_an_attribute": (1, "BA_DEF_DEF_ of attribute 'GenMsgCycleTime' with a value that it does not have"),
    "digits_of_a_mebibyte": (1, "expected 'SG_ name"),
    "ambiguous_quotes": (1, "expected 'VAL_ identifier"),
    "long_name": (1, "expected 'SG_ name"),
    "emoji": (1, "CM_ is longer than 1,048,576 characters: left out"),
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_what_is_left_out_is_told(tmp_path: Path, name: str) -> None:
    signals, text = LEFT_OUT[name]
    loaded = load(tmp_path, BOMBS[name]())
    assert any(text in each for each in told(loaded))
    assert sum(len(message.signals) for message in loaded.messages.values()) == signals
    assert len(loaded.warnings) <= 2 * database.MOST_WARNINGS + 1


def test_multiplexers_within_multiplexers_are_read(tmp_path: Path) -> None:
    message = load(tmp_path, BOMBS["multiplexed_products"]()).message("TRACK")
    gates = bits.gates(message, message.signal("S3"))
    assert gates is not None
    assert [(gate.multiplexer, len(gate.ids)) for gate in gates] == [("S0", 256), ("S1", 256), ("S2", 256)]


def test_a_file_may_have_so_many_bytes(tmp_path: Path) -> None:
    text = (MESSAGE + RANGE).encode()
    load(tmp_path, text.ljust(LONGEST_FILE))
    with pytest.raises(DatabaseError, match=r"some\.dbc: cannot be read \(it is longer than 8,388,608 bytes"):
        load(tmp_path, text.ljust(LONGEST_FILE + 1))


def test_a_statement_may_have_so_many_characters(tmp_path: Path) -> None:
    comment = 'CM_ SG_ 256 RANGE "'
    longest = database.LONGEST_STATEMENT - len(comment) - len('";\n')
    loaded = load(tmp_path, MESSAGE + RANGE + comment + "a" * longest + '";\n')
    assert (told(loaded), len(loaded.message("TRACK").signal("RANGE").comment)) == ([], longest)
    loaded = load(tmp_path, MESSAGE + RANGE + comment + "a" * (longest + 1) + '";\n')
    assert told(loaded) == ["CM_ is longer than 1,048,576 characters: left out"]


def test_a_name_may_have_so_many_characters(tmp_path: Path) -> None:
    name = "N" * database.LONGEST_NAME
    assert load(tmp_path, MESSAGE + signal(name)).message("TRACK").signals[0].name == name
    assert load(tmp_path, MESSAGE + signal(name + "N")).message("TRACK").signals == ()


def test_a_number_may_have_so_many_digits(tmp_path: Path) -> None:
    text = MESSAGE + RANGE + signal("FINE", 12, 8, numbers="(0.{},0) [0|0]")
    loaded = load(tmp_path, text.format("1" * database.LONGEST_NUMBER))
    assert loaded.message("TRACK").signal("FINE").scale == pytest.approx(1 / 9)
    loaded = load(tmp_path, text.format("1" * (database.LONGEST_NUMBER + 1)))
    assert [each.name for each in loaded.message("TRACK").signals] == ["RANGE"]


def test_a_message_may_have_so_many_bytes(tmp_path: Path) -> None:
    text = MESSAGE + RANGE + "BO_ 257 LONG: {} RADAR\n" + RANGE
    assert "LONG" in load(tmp_path, text.format(database.LONGEST_MESSAGE)).messages
    assert "LONG" not in load(tmp_path, text.format(database.LONGEST_MESSAGE + 1)).messages


def test_a_signal_may_have_so_many_bits(tmp_path: Path) -> None:
    for beyond in (0, 1):
        text = "BO_ 256 TRACK: 65 RADAR\n" + RANGE + signal("LONG", 0, bits.LONGEST_NUMBER + beyond)
        assert ("LONG" in [each.name for each in load(tmp_path, text).message("TRACK").signals]) is not beyond


def test_a_message_may_have_so_many_signals(tmp_path: Path) -> None:
    most = database.MOST_SIGNALS_A_MESSAGE
    for count, expected in (
        (most, []),
        (most + 1, ["1 signals of message 'TRACK' beyond the 2,048 that are read: left out"]),
    ):
        lines = "".join(signal(f"S{n}", n, 1) for n in range(count))
        loaded = load(tmp_path, f"BO_ 256 TRACK: 300 RADAR\n{lines}")
        assert [text for text in told(loaded) if "left out" in text] == expected
        assert len(loaded.message("TRACK").signals) == most


def test_multiplexers_may_lie_so_deep(tmp_path: Path) -> None:
    lines = "".join(signal(f"S{n}", 4 * n, 4, "M" if n == 0 else "m0M") for n in range(10))
    selections = "".join(f"SG_MUL_VAL_ 256 S{n + 1} S{n} 0-0;\n" for n in range(9))
    message = load(tmp_path, MESSAGE + lines + selections).message("TRACK")
    chains = [bits.gates(message, message.signal(f"S{n}")) for n in range(10)]
    assert [None if chain is None else len(chain) for chain in chains] == [*range(bits.DEEPEST_MULTIPLEXING + 1), None]


def test_a_message_may_have_so_many_multiplexers(tmp_path: Path) -> None:
    most = database.MOST_MULTIPLEXERS
    text = "BO_ 256 TRACK: 33 RADAR\n" + "".join(signal(f"S{n}", 4 * n, 4, "M") for n in range(most))
    assert "left out" not in "".join(told(load(tmp_path, text)))
    loaded = load(tmp_path, text + signal("ONE_MORE", 4 * most, 4, "M") + signal("PLAIN", 4 * most, 4))
    assert [each.name for each in loaded.message("TRACK").signals[most:]] == ["PLAIN"]
    assert "1 multiplexers of message 'TRACK' beyond the 64 that are read: left out" in told(loaded)


def test_a_signal_may_be_selected_by_so_many_values(tmp_path: Path) -> None:
    text = MESSAGE + signal("M", 0, 32, "M") + signal("S", 32, 8, "m0") + "SG_MUL_VAL_ 256 S M 0-{};\n"
    most = database.MOST_IDS_A_SIGNAL
    assert len(load(tmp_path, text.format(most - 1)).message("TRACK").signal("S").multiplexer_ids) == most
    loaded = load(tmp_path, text.format(most))
    assert loaded.message("TRACK").signal("S").multiplexer_ids == {0}
    assert len(loaded.warnings) == 1


def test_equal_selections_count_once(tmp_path: Path) -> None:
    count = database.MOST_IDS // database.MOST_IDS_A_SIGNAL
    lines = "".join(signal(f"S{n}", 32, 8, "m0") for n in range(3 * count))
    for step, most in ((0, 3 * count), (1, count)):
        ranges = "".join(f"SG_MUL_VAL_ 256 S{n} M {n * step}-{n * step + 65535};\n" for n in range(3 * count))
        message = load(tmp_path, MESSAGE + signal("M", 0, 32, "M") + lines + ranges).message("TRACK")
        assert sum(len(each.multiplexer_ids) == 65536 for each in message.signals) == most


LIMITED = {
    "MOST_STATEMENTS": (MESSAGE + RANGE + 'CM_ "1";\n' * 2, "statements"),
    "MOST_MESSAGES": ("".join(f"BO_ {n} M{n}: 8 X\n{RANGE}" for n in range(4)), "messages"),
    "MOST_SIGNALS": ("".join(f"BO_ {n} M{n}: 8 X\n{RANGE}" for n in range(4)), "signals"),
    "MOST_CHOICES": (
        "".join(f'BO_ {n} M{n}: 8 X\n{RANGE}VAL_ {n} RANGE 0 "a" ;\n' for n in range(4)),
        "entries of value tables",
    ),
}


@pytest.mark.parametrize("name", LIMITED)
def test_a_file_may_have_so_many(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    text, what = LIMITED[name]
    monkeypatch.setattr(database, name, 4)
    assert told(load(tmp_path, text)) == []
    monkeypatch.setattr(database, name, 3)
    assert told(load(tmp_path, text)) == [f"1 {what} beyond the 3 that are read: left out"]


def test_so_many_warnings_are_told(tmp_path: Path) -> None:
    most = database.MOST_WARNINGS
    text = MESSAGE + RANGE + "".join(f'BA_ "Nowhere{n}" BO_ 256 1;\n' for n in range(most))
    assert len(told(load(tmp_path, text))) == most
    loaded = load(tmp_path, text + 'BA_ "Nowhere" BO_ 256 1;\n' * 3)
    assert told(loaded)[most:] == ["and 3 more warnings of this file"]
    assert loaded.warnings[-1].line == most + 2


def test_so_many_overlaps_of_a_message_are_told(tmp_path: Path) -> None:
    most = lint.MOST_OVERLAPS
    text = "BO_ 256 TRACK: 80 RADAR\n" + signal("WIDE", 0, 512) + "".join(signal(f"S{n}", n, 1) for n in range(most))
    overlaps = [each for each in told(load(tmp_path, text)) if "overlap" in each]
    assert len(overlaps) == most
    further = [each for each in told(load(tmp_path, text + signal("ONE_MORE", 511, 1))) if "overlap" in each]
    assert further == ["more signals of message 'TRACK' overlap than are told", *overlaps]


def test_overlaps_are_looked_for_so_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "".join(f"BO_ {n} M{n}: 8 X\n{signal('A', 0)}{signal('B', 0)}" for n in range(2))
    assert len(told(load(tmp_path, text))) == 2
    monkeypatch.setattr(lint, "MOST_COMPARISONS", 1)
    assert told(load(tmp_path, text)) == [
        "more signals of message 'M0' overlap than are told",
        "overlaps of signals of message 'M1' are not looked for: too many",
    ]


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_utf_16_needs_its_mark(tmp_path: Path, encoding: str) -> None:
    text = (MESSAGE + RANGE.replace('""', '"°"')).encode(encoding)
    if encoding == "utf-16":
        assert load(tmp_path, text).message("TRACK").signal("RANGE").unit == "°"
    else:
        with pytest.raises(DatabaseError, match="no message found"):
            load(tmp_path, text)


def test_what_is_no_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.dbc")
    for path in (tmp_path / "pipe.dbc", Path("/dev/zero"), tmp_path, Path("/proc/self/mem"), tmp_path / "\0"):
        with pytest.raises(DatabaseError, match="cannot be read"):
            load_database(path)


ODD_SIGNALS = {
    "an infinite limit": (signal("ODD", 12, 8, numbers="(1,0) [-1e400|1e400]"), "range [-1e400|1e400] of signal 'ODD'"),
    "a limit that is no number": (signal("ODD", 12, 8, numbers="(1,0) [nan|nan]"), "expected 'SG_"),
    "an infinite offset": (signal("ODD", 12, 8, numbers="(1,1e400) [0|0]"), "no finite scale and offset"),
    "no bits": (signal("ODD", 12, 0), "has no bits"),
    "65535 bits": (signal("ODD", 12, 65535), "has 65535 bits, 512 at most"),
    "a start far beyond": (signal("ODD", 1 << 32, 8), "ends beyond 2048 bytes"),
    "a negative start": (signal("ODD", -1, 8), "expected 'SG_"),
    "a float of 12 bits": (signal("ODD", 12, 12) + "SIG_VALTYPE_ 256 ODD : 1;\n", "of 12 bits cannot be a float"),
    "an odd type": (signal("ODD", 12, 12) + "SIG_VALTYPE_ 256 ODD : x;\n", "expected 'SIG_VALTYPE_"),
}


@pytest.mark.parametrize("name", ODD_SIGNALS)
def test_an_odd_signal_is_told_and_the_rest_loads(tmp_path: Path, name: str) -> None:
    line, text = ODD_SIGNALS[name]
    loaded = load(tmp_path, MESSAGE + RANGE + line)
    assert len(loaded.warnings) == 1
    assert text in loaded.warnings[0].text
    assert loaded.message("TRACK").find("RANGE") is not None


def test_values_of_one_text_stay_apart(tmp_path: Path) -> None:
    text = MESSAGE + RANGE + 'VAL_ 256 RANGE 0 "same" 1 "same" 1 "last" -2 "a \\"quoted\\" one";\n'
    choices = load(tmp_path, text).message("TRACK").signal("RANGE").choices
    assert choices == {0: "same", 1: "last", -2: 'a "quoted" one'}


DEFINITIONS = 'BA_DEF_ SG_ "SystemSignalLongSymbol" STRING ;\nBA_DEF_ BO_ "SystemMessageLongSymbol" STRING ;\n'


def test_long_names_are_names(tmp_path: Path) -> None:
    text = MESSAGE + RANGE + signal("RATE", 12) + DEFINITIONS
    loaded = load(tmp_path, text + 'BA_ "SystemSignalLongSymbol" SG_ 256 RANGE "RANGE_OF_TRACK";\n'
                  'BA_ "SystemMessageLongSymbol" BO_ 256 "TRACK_OF_RADAR";\n')  # fmt: skip
    assert [each.name for each in loaded.message("TRACK_OF_RADAR").signals] == ["RANGE_OF_TRACK", "RATE"]
    for name in ("RATE", "", "1", "a b", "a\n: 1", "import os", "x" * 257, "é"):
        loaded = load(tmp_path, text + f'BA_ "SystemSignalLongSymbol" SG_ 256 RANGE "{name}";\n')
        assert [each.name for each in loaded.message("TRACK").signals] == ["RANGE", "RATE"]
        assert len(loaded.warnings) == 1


def test_a_multiplexer_is_known_by_its_long_name(tmp_path: Path) -> None:
    text = MESSAGE + signal("M", 0, 8, "M") + signal("S", 8, 8, "m3") + DEFINITIONS
    message = load(tmp_path, text + 'BA_ "SystemSignalLongSymbol" SG_ 256 M "MODE";\n').message("TRACK")
    assert compile_decoder(message, ["S"])(bytes([3, 9, *bytes(6)])) == (9,)


FORMATS = 'BA_DEF_ BO_ "VFrameFormat" {};\n'


@pytest.mark.parametrize(
    ("kind", "value", "is_fd"),
    [
        ('ENUM "StandardCAN","StandardCAN_FD"', "1", True),
        ('ENUM "StandardCAN","StandardCAN_FD"', "2", None),
        ('ENUM "StandardCAN","StandardCAN_FD"', "-1", None),
        ('ENUM "StandardCAN","StandardCAN_FD"', '"StandardCAN_FD"', None),
        ("INT 0 15", "14", True),
        ("INT 0 15", "16", None),
        ("INT 0 15", "1e999999999", None),
        ("STRING", '"StandardCAN_FD"', None),
        ("ENUM", "0", None),
        ("INT 5", "14", True),
    ],
)
def test_a_frame_format_is_one_of_its_values(tmp_path: Path, kind: str, value: str, is_fd: bool | None) -> None:
    loaded = load(tmp_path, MESSAGE + RANGE + FORMATS.format(kind) + f'BA_ "VFrameFormat" BO_ 256 {value};\n')
    assert loaded.message("TRACK").is_fd is bool(is_fd)
    assert len(loaded.warnings) == (is_fd is None)


def test_no_name_gets_into_the_code_of_a_codec() -> None:
    names = ["x): __import__('os').abort(#", "a\nimport os\nos.abort()\n", "", "\0", "data", "nan", "\udc80", "é" * 9]
    signals = tuple(
        SignalSpec(
            name,
            8 * at,
            8,
            is_multiplexer=at == 0,
            multiplexer_signal=names[0] if at else None,
            multiplexer_ids=frozenset({7} if at else ()),
        )
        for at, name in enumerate(names)
    )
    message = MessageSpec("'''\n\0\udc80abort()", 1, 8, signals)
    assert compile_decoder(message)(bytes(range(7, 15))) == tuple(range(7, 15))
    assert compile_encoder(message)(list(range(7, 15))) == (bytes(range(7, 15)), 0)


def test_a_value_far_beyond_a_signal_stays_as_it_is() -> None:
    assert bits.as_decoded(SignalSpec("S", 0, 8, scale=1e-10), 1e308) == 1e308


def test_numbers_beyond_64_bits_do_not_overflow(tmp_path: Path) -> None:
    huge = "1" + "0" * 308
    loaded = load(tmp_path, MESSAGE + signal("S", 0, 64, numbers=f"({huge},{huge}) [-{huge}|{huge}]"))
    message = loaded.message("TRACK")
    assert compile_decoder(message)(b"\xff" * 8) == (float("inf"),)
    assert bits.representable_values(message.signal("S")) == (1e308, float("inf"))
    assert len(compile_encoder(message)([1e308])[0]) == 8
