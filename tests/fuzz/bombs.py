"""Small texts that are large once they are read; words that targets put into what is sound."""

from __future__ import annotations

import gzip
from functools import cache

LEVELS = 9
DEPTH = 3000
_DIGITS = b"9" * 4400  # more than Python turns into an integer


def _aliases() -> bytes:
    """Return YAML whose last node has a thousand million leaves."""
    lines = [b'a0: &a0 ["x","x","x","x","x","x","x","x","x","x"]']
    lines += [b"a%d: &a%d [%s]" % (k, k, b",".join([b"*a%d" % (k - 1)] * 10)) for k in range(1, LEVELS)]
    return b"\n" + b"\n".join(lines) + b"\n"


def _merges() -> bytes:
    """Return YAML in which each mapping merges the one before it twenty times."""
    lines = [b"m0: &m0 {" + b", ".join(b"k%d: 1" % k for k in range(20)) + b"}"]
    lines += [b"m%d: &m%d {<<: [%s]}" % (k, k, b",".join([b"*m%d" % (k - 1)] * 20)) for k in range(1, 6)]
    return b"\n" + b"\n".join(lines) + b"\n"


YAML_BOMBS = (_aliases(), _merges(), b"[" * DEPTH, b"{a: " * DEPTH, b"- " * DEPTH, b"? " * DEPTH, _DIGITS,
              b"1e" + _DIGITS,
              b"\nbuses: &b {x: *b}\n", b"{slot:999999999d}", b"0x" + b"f" * 4000, b'"\\u2028"', b'"a b"', b'"a\\nb"',
              b'"\\e[31m[/bold]"', b'"\\ud800"')  # fmt: skip
"""Aliases, merges, depth, numbers, and names that no file, unit or terminal should hold."""


def _dbc_lines(line: bytes, count: int) -> bytes:
    return b"\n" + b"\n".join(line % k for k in range(count)) + b"\n"


DBC_BOMBS = (
    b"\nBO_ 900 Overlaps: 8 A" + _dbc_lines(b' SG_ o%d : 0|64@1+ (1,0) [0|0] "" A', 3000),
    b"\nBO_ 901 OneBit: 2048 A" + b"\n".join(b' SG_ b%d : %d|1@1+ (1,0) [0|0] "" A' % (k, k) for k in range(16_384)),
    _dbc_lines(b'BA_ "NoSuch%d" 1;', 2000),
    _dbc_lines(b'BA_ "NoSuch%d" SG_ 100 x 1;', 2000),
    b"\nSG_MUL_VAL_ 100 z y " + b", ".join(b"%d-4294967295" % k for k in range(400)) + b";\n",
    _dbc_lines(b"SG_MUL_VAL_ 100 z y 0-%d;", 200),
    b"\nVAL_ 100 mode " + b" ".join(b'%d "x"' % k for k in range(5000)) + b" ;\n",
    _DIGITS,
    b"1e" + _DIGITS,
    b"." + _DIGITS,
    b'CM_ "' + b"x" * 100_000,
    b'"\x1b[31m"',
)
"""Signals, attributes and ranges without number, and numbers without end."""


@cache
def endless_line(suffix: str, megabytes: int) -> bytes:
    """Return a gzip file of a log whose one line is many megabytes long.

    Args:
        suffix: of the log.
        megabytes: that the line takes.
    """
    head = {".csv": b"timestamp,arbitration_id,extended,remote,error,dlc,data\n", ".trc": b";$FILEVERSION=2.0\n"}
    return gzip.compress(head.get(suffix, b"")) + gzip.compress(b"0" * (1 << 20)) * megabytes
