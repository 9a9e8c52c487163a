"""DBC files with anything in them: refused by name and line, or they decode any payload."""

from __future__ import annotations

from collections import Counter
from functools import cache
from pathlib import Path

from candaemon.dbc.database import load_database
from candaemon.dbc.single_codec import compile_decoder, compile_encoder
from candaemon.errors import ConfigError, DatabaseError

from .bombs import DBC_BOMBS
from .drawn import Drawn
from .invariants import hold_place
from .scratch import scratch

_ROOT = Path(__file__).resolve().parents[2]
_WORDS = (b"0", b"1", b"-1", b"65", b"4294967295", b"1e309", b"0.1", b"@0-", b"@1+", b"M", b"m0", b"m1M", b'"',
              b";", b"\nBO_ 1 X: 8 A\n", b'\n SG_ a : 0|8@1+ (1,0) [0|0] "" A\n', b"\nSIG_VALTYPE_ 1 a : 1;\n",
              b'\nVAL_ 1 a 0 "x" ;\n', b"\nSG_MUL_VAL_ 1 a b 0-9;\n", b"//", b"\\", b"(0,0)", b"[1|0]", b"|", b":",
              b'BA_ "GenMsgCycleTime" BO_ 1 x;\n', b"CM_ ", b"\xff", b"\0", b"\n\n",
              b"1e999999999", b'\nBA_DEF_ BO_ "VFrameFormat" INT 0 9;\nBA_ "VFrameFormat" BO_ 100 14;\n',
              b'\nBA_DEF_ SG_ "SystemSignalLongSymbol" STRING ;\nBA_ "SystemSignalLongSymbol" SG_ 100 x "long";\n',
              b"\nSG_MUL_VAL_ 100 mode y 0-9;\n", *DBC_BOMBS)  # fmt: skip


def fuzz_dbc(data: bytes) -> Counter[str]:
    """Load a DBC file; what is accepted decodes any payload, and is encoded or refused by name."""
    drawn = Drawn(data)
    edited = drawn.integer(0, 7) > 0
    text = drawn.edited(drawn.choice(_databases()), _WORDS) if edited else drawn.rest()
    path = scratch() / "file.dbc"
    path.write_bytes(text)
    try:
        database = load_database(path)
    except DatabaseError as error:
        hold_place(error)
        return Counter(edited=edited, refused=1)
    lines = text.count(b"\n") + text.count(b"\r") + 1
    assert all(0 <= warning.line <= lines for warning in database.warnings)
    payload = (drawn.rest() or b"\x5a").ljust(64, b"\xc3")
    for message in database.messages.values():
        if message.length > 64:
            continue  # no frame of CAN
        values = compile_decoder(message)(payload[: message.length])
        assert values is None or len(values) == len(message.signals)
        try:
            encoder = compile_encoder(message)
        except ConfigError:
            continue
        sent, _ = encoder([1.5] * len(message.signals))
        assert len(sent) == message.length
    return Counter(edited=edited, accepted=1, messages=len(database.messages))


@cache
def _databases() -> tuple[bytes, ...]:
    """Return the heads of the shipped DBC files and one with all that is odd."""
    heads = [path.read_bytes()[:3000] for path in sorted((_ROOT / "dbc").glob("*.dbc"))]
    return (_ODD, *heads)


_ODD = b"""VERSION ""
BU_: A B
BO_ 100 Mux: 8 A
 SG_ mode M : 0|4@1+ (1,0) [0|15] "" B
 SG_ x m0 : 8|16@1- (0.01,-5) [-300|300] "m" B
 SG_ y m1M : 15|12@0+ (1,0) [0|0] "" B
 SG_ z m2 : 32|32@1- (1,0) [0|0] "" B
BO_ 2147483748 Long: 64 A
 SG_ f : 0|32@1- (1,0) [-10|10] "m" B
 SG_ far : 480|32@1+ (1,0) [0|0] "" B
CM_ SG_ 100 x "a ; comment // with \\"all\\"
over two lines";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_ SG_ "GenSigStartValue" FLOAT 0 1e9;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_ "GenMsgCycleTime" BO_ 100 50;
BA_ "GenSigStartValue" SG_ 100 x 7;
VAL_ 100 mode 0 "near" 1 "far" ;
SIG_VALTYPE_ 2147483748 f : 1;
SG_MUL_VAL_ 100 z y 2-3, 5-5;
"""
