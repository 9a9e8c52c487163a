"""DBC files that are small and meant to take for ever, to fill the memory or to end in a traceback.

`python -m tests.support.dbc_bombs FOLDER` writes each as FOLDER/NAME.dbc beside a configuration FOLDER/NAME.yaml whose
bus names it, for `candaemon check`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final

from candaemon.frames.frame import EXTENDED
from tests.support.paths import ROOT

_MESSAGE: Final = "BO_ 256 TRACK: 8 RADAR\n"
_MIB: Final = 1 << 20


def signal(name: str, start: int = 0, length: int = 8, mark: str = "", numbers: str = "(1,0) [0|0]") -> str:
    """Return the line of a little-endian unsigned signal."""
    return f' SG_ {name} {mark}: {start}|{length}@1+ {numbers} "" ECU\n'


_RANGE: Final = signal("RANGE", 0, 12)
_ESCAPED: Final = '\\"'
_VALUES: Final = "".join(f'{n} "" ' for n in range(2000))


def _numbered(count: int, line: Callable[[int], str]) -> str:
    return "".join(map(line, range(count)))


def _message(signals: Iterable[str], length: int = 8) -> str:
    return f"BO_ 256 TRACK: {length} RADAR\n" + "".join(signals)


def _nested(depth: int, ids: int) -> str:
    """Return a message of multiplexers within multiplexers, each selected by many values of the one above."""
    marks = ["M", *("m0M" for _ in range(depth - 1))]
    lines = [signal(f"S{n}", 8 * n % 56, 8, mark) for n, mark in enumerate(marks)]
    ranges = [f"SG_MUL_VAL_ 256 S{n + 1} S{n} 0-{ids - 1};\n" for n in range(depth - 1)]
    return _message(lines) + "".join(ranges)


def _attribute(kind: str, default: str) -> str:
    return f'BA_DEF_ BO_ "GenMsgCycleTime" {kind};\nBA_DEF_DEF_ "GenMsgCycleTime" {default};\n'


def _full() -> str:
    """Return as much as is read of everything at once: signals, selections, start values, value tables, comments."""
    lines = ['BA_DEF_ SG_ "GenSigStartValue" FLOAT 0 9;\n']
    for message in range(10):
        lines.append(f"BO_ {message} M{message}: 64 RADAR\n" + signal("MODE", 0, 16, "M"))
        lines += [signal(f"S{n}", 16 + n % 400, 8, f"m{n}") for n in range(1990)]
        for n in range(1990):
            of = f"{message} S{n}"
            lines.append(f'BA_ "GenSigStartValue" SG_ {of} 1;\nSG_MUL_VAL_ {of} MODE {n}-{n + 12};\n')
            lines.append(f'CM_ SG_ {of} "{"text" * 20}";\nVAL_ {of} {_VALUES[:50]} ;\n')
    return "".join(lines)


def _with_number(number: str) -> str:
    return _message([_RANGE, signal("LONG", 12, 8, numbers=f"({number},0) [0|0]")])


BOMBS: Final[dict[str, Callable[[], str]]] = {
    # refused by cantools one by one
    "undefined_attributes": lambda: _MESSAGE + _RANGE + _numbered(2000, lambda n: f'BA_ "Nowhere{n}" BO_ 256 {n};\n'),
    "bad_definitions": lambda: _MESSAGE + _RANGE + _numbered(2000, lambda n: f'BA_DEF_ what "is{n}";\n'),
    "bad_defaults": lambda: (
        _MESSAGE
        + _RANGE
        + _attribute("INT 0 10", "0")
        + _numbered(2000, lambda _: 'BA_ "GenMsgCycleTime" BO_ 256 "x";\n')
    ),
    "bad_comments": lambda: _MESSAGE + _RANGE + _numbered(2000, lambda n: f"CM_ SG_ 256 RANGE {n} {n};\n"),
    "bad_messages": lambda: _MESSAGE + _RANGE + _numbered(2000, lambda n: f"BO_ {n} M{n}: 8 1X\n SG_ s\n"),
    # bits
    "overlapping_signals": lambda: _message(signal(f"S{n}", 0, 64) for n in range(3000)),
    "one_bit_signals": lambda: _message((signal(f"S{n}", n, 1) for n in range(16384)), 2048),
    "long_signals": lambda: _message((signal(f"S{n}", 0, 16384) for n in range(4000)), 2048),
    "overlapping_multiplexed": lambda: _message(
        [signal("MODE", 0, 8, "M"), *(signal(f"S{n}", 8, 8, f"m{n % 7}") for n in range(3000))]
    ),
    # multiplexers
    "long_selections": lambda: (
        _message([signal("MODE", 0, 16, "M"), *(signal(f"S{n}", 16, 8, "m0") for n in range(200))])
        + _numbered(200, lambda n: f"SG_MUL_VAL_ 256 S{n} MODE {n}-{65535 - n};\n")
    ),
    "many_ranges": lambda: (
        _message([signal("MODE", 0, 16, "M"), signal("S0", 16, 8, "m0")])
        + f"SG_MUL_VAL_ 256 S0 MODE {', '.join('0-65535' for _ in range(2000))};\n"
    ),
    "multiplexed_products": lambda: _nested(4, 256),
    "deep_multiplexers": lambda: _nested(1500, 1),
    "multiplexed_by_itself": lambda: (
        _message([signal("A", 0, 8, "m0M"), signal("B", 8, 8, "m0M"), signal("C", 16, 8, "m0")])
        + "SG_MUL_VAL_ 256 A A 0-0;\nSG_MUL_VAL_ 256 C A 0-0;\n"
    ),
    "multiplexers_in_a_circle": lambda: (
        _message([signal("A", 0, 8, "m0M"), signal("B", 8, 8, "m0M"), signal("C", 16, 8, "m0")])
        + "SG_MUL_VAL_ 256 A B 0-0;\nSG_MUL_VAL_ 256 B A 0-0;\nSG_MUL_VAL_ 256 C A 0-0;\n"
    ),
    # numbers
    "number_of_4300_digits": lambda: _with_number("1" * 4301),
    "start_of_4300_digits": lambda: _message([_RANGE, f' SG_ S : {"1" * 4301}|8@1+ (1,0) [0|0] "" ECU\n']),
    "identifier_of_4300_digits": lambda: _message([_RANGE]) + f"BO_ {'1' * 4301} X: 8 RADAR\n{_RANGE}",
    "length_of_4300_digits": lambda: _message([_RANGE]) + f"BO_ 257 X: {'1' * 4301} RADAR\n{_RANGE}",
    "mark_of_4300_digits": lambda: _message([signal("M", 0, 8, "M"), signal("S", 8, 8, f"m{'1' * 4301}")]),
    "reference_of_4300_digits": lambda: _message([_RANGE]) + f'CM_ SG_ {"1" * 4301} RANGE "text";\n',
    "value_of_4300_digits": lambda: _message([_RANGE]) + f'VAL_ 256 RANGE {"1" * 4301} "text";\n',
    "selection_of_4300_digits": lambda: (
        _message([signal("M", 0, 8, "M"), signal("S", 8, 8, "m0")]) + f"SG_MUL_VAL_ 256 S M 0-{'1' * 4301};\n"
    ),
    "attribute_of_4300_digits": lambda: _message([_RANGE]) + _attribute("INT 0 10", "1" * 4301),
    "digits_of_a_mebibyte": lambda: _with_number("1" * _MIB + "x"),
    "exponent_of_an_attribute": lambda: _message([_RANGE]) + _attribute("INT 0 10", "1e999999999"),
    "exponent_of_a_limit": lambda: _message([_RANGE]) + _attribute("INT 0 1e999999999", "0"),
    # numbers of things
    "empty_messages": lambda: _numbered(360_000, lambda n: f"BO_ {n} M{n:x}: 8 X\n"),
    "one_identifier": lambda: _numbered(100_000, lambda n: f"BO_ 256 M{n:x}: 8 X\n{_RANGE}"),
    "one_name": lambda: f"BO_ 256 M: 8 X\n{_RANGE}" * 100_000,
    "many_signals": lambda: _numbered(
        5000, lambda n: f"BO_ {EXTENDED + n} M{n}: 64 X\n" + _numbered(60, lambda k: signal(f"S{k}", k, 1))
    )[: 8 * _MIB],
    "signals_of_one_name": lambda: _message(signal("S", 0, 8) for _ in range(100_000)),
    "large_value_table": lambda: (
        _message([_RANGE]) + "VAL_ 256 RANGE " + _numbered(800_000, lambda n: f'{n} "" ') + ";\n"
    ),
    "many_value_tables": lambda: (
        _message(signal(f"S{n}", 0, 8) for n in range(500)) + _numbered(500, lambda n: f"VAL_ 256 S{n} {_VALUES};\n")
    ),
    "many_comments": lambda: _message([_RANGE]) + _numbered(250_001, lambda n: f'CM_ SG_ 256 RANGE "{n}";\n'),
    "everything": _full,
    # texts
    "long_comment": lambda: _message([_RANGE]) + f'CM_ SG_ 256 RANGE "{"a" * 8_388_000}";\n',
    "escaped_quotes": lambda: _message([_RANGE]) + f'CM_ SG_ 256 RANGE "{_ESCAPED * 4_194_000}";\n',
    "ambiguous_quotes": lambda: _message([_RANGE]) + "VAL_ 256 RANGE " + '0 "\\" 0 "\\"0" ' * 5000 + "x;\n",
    "open_strings": lambda: _message([_RANGE]) + 'CM_ "\n' * 300_001,
    "blanks": lambda: _message([_RANGE]) + " SG_" + " " * 4_194_000 + "\nCM_" + "\t" * 4_194_000 + "x\n",
    "slashes": lambda: _message([_RANGE]) + "//" * 4_194_000,
    "long_name": lambda: _message([_RANGE, signal("N" * _MIB, 12)]),
    "emoji": lambda: _message([_RANGE]) + f'CM_ SG_ 256 RANGE "{"😀" * 2_097_000}";\n',
    "nodes": lambda: "BU_: " + _numbered(1_000_000, lambda n: f"N{n} ") + "\n" + _message([_RANGE]),
    "receivers": lambda: _message([f' SG_ S : 0|8@1+ (1,0) [0|0] "" {_numbered(1_000_000, lambda n: f"N{n},")}N\n']),
}
"""Text of each bomb, by name."""


def _main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    settings = (ROOT / "config" / "esr_ins.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    for name, text in BOMBS.items():
        (folder / f"{name}.dbc").write_text(text(), encoding="utf-8")
        (folder / f"{name}.yaml").write_text(
            settings.replace("buses:\n", f"buses:\n  bomb: {{channel: bomb, dbc: [{name}.dbc]}}\n", 1), encoding="utf-8"
        )


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
