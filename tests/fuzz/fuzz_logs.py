"""Recorded logs of every format with any content: no exception, and no frame that CAN does not know."""

from __future__ import annotations

import gzip
from collections import Counter
from functools import cache
from pathlib import Path

import can

from candaemon.can_io.logs.candump import candump_text, read_candump_blocks
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import TICK_BUS, ChannelMap, LogCounts
from candaemon.errors import InputError
from candaemon.frames.frame import EXTENDED, Frame
from candaemon.frames.frame_block import FD_LENGTHS

from .bombs import endless_line
from .drawn import Drawn
from .scratch import scratch

_CHANNELS = {"can0": 0, "can1": 1, "0": 0}
_NAMES = ["can0", "can1"]
_SUFFIXES = (".log", ".asc", ".blf", ".csv", ".trc")
_ENDLESS = 63
_MEGABYTES = (8, 64, 512)
_WORDS = (b"\n", b"\r\n", b" ", b"#", b"##1", b"#R", b"(1533226488.434433) can0 260#08FF\n", b"20000000", b"can1",
          b"tick", b"000#", b"0", b"-1", b"1e9", b"nan", b"99999999999999999999", b"Rx d 8 ", b"x", b"\0")  # fmt: skip
_SAMPLES = {
    ".log": b"(1533226488.434433) can0 260#08FFFB0000001884\n(1533226488.434433) can1 18FF1234##1AABBCCDD\n"
    b"(1533226488.5) tick 000#\n(1533226489.123456789) can0 123#R8\n(1533226489.2) can0 20000080#0000000000000000\n"
    + b"".join(b"(1533226490.%06d) can0 2%02X#%016X\n" % (k, k % 32, k * 0x1234567) for k in range(40)),
    ".asc": b"date Sat Aug 2 10:00:00.000 2018\nbase hex  timestamps absolute\ninternal events logged\n"
    b"Begin Triggerblock\n0.000000 Start of measurement\n0.010000 1  260             Rx   d 8 08 FF FB 00 00 00 18 84\n"
    b"0.020000 1  18FF1234x       Rx   d 2 01 02\n0.030000 2  123 Rx r 8\n"
    b"0.040000 CANFD   1 Rx        123                                   1 0 a 16 00 01 02 03 04 05 06 07 08 09 0a 0b "
    b"0c 0d 0e 0f 0 0 0 0 0 0 0\n0.050000 1 ErrorFrame\nEnd TriggerBlock\n",
    ".csv": b"timestamp,arbitration_id,extended,remote,error,dlc,data\n1533226488.434433,0x260,0,0,0,8,CP/7AAAAGIQ=\n"
    b"1533226488.5,0x18FF1234,1,0,0,2,AQI=\n",
    ".trc": b";$FILEVERSION=2.0\n;$STARTTIME=43314.4\n;$COLUMNS=N,O,T,I,d,l,D\n;\n"
    b"      1         1.000 DT     0260 Rx 8  08 FF FB 00 00 00 18 84\n"
    b"      2         2.500 DT 18FF1234 Rx 2  01 02\n",
}


def fuzz_logs(data: bytes) -> Counter[str]:
    """Read a log: as it was drawn, or a sound one with changes; plain, compressed, or as a broken gzip stream."""
    drawn = Drawn(data)
    suffix = drawn.choice(_SUFFIXES)
    form = drawn.integer(0, 63)
    edited = drawn.integer(0, 7) > 0
    content = drawn.edited(_sample(suffix), _WORDS) if edited else drawn.rest()
    path = scratch() / (f"log{suffix}.gz" if form % 4 else f"log{suffix}")
    path.write_bytes(endless_line(suffix, drawn.choice(_MEGABYTES)) if form == _ENDLESS else _compressed(content, form))
    counts = LogCounts()
    frames = list(read_log(path, _CHANNELS, counts))
    hold_frames(frames, counts)
    try:
        counts.require_frames(path)
    except InputError:
        assert not counts.frames
    if suffix == ".log" and form != _ENDLESS:
        _hold_candump(path, frames, counts)
    return Counter(edited=edited, frames=counts.frames, malformed=counts.malformed)


@cache
def _sample(suffix: str) -> bytes:
    """Return a sound log."""
    if suffix != ".blf":
        return _SAMPLES[suffix]
    path = scratch() / "sample.blf"
    with can.BLFWriter(path, compression_level=0) as writer:
        for k in range(20):
            writer.on_message_received(
                can.Message(timestamp=1533226488.0 + k, arbitration_id=0x260 + k, data=bytes(8), channel=0)
            )
    return path.read_bytes()


def _compressed(content: bytes, form: int) -> bytes:
    match form % 4:
        case 1:
            return gzip.compress(content, 1)
        case 2:  # cut short
            return gzip.compress(content, 1)[: -1 - len(content) % 16]
        case _:
            return content


def hold_frames(frames: list[Frame], counts: LogCounts) -> None:
    ticks = [frame for frame in frames if frame.bus == TICK_BUS]
    assert (counts.frames, counts.ticks) == (len(frames) - len(ticks), len(ticks))
    for time_ns, bus, can_id, payload, fd in frames:
        assert bus in (0, 1, TICK_BUS)
        assert can_id <= (EXTENDED | 0x1FFF_FFFF if can_id & EXTENDED else 0x7FF), hex(can_id)
        assert len(payload) <= 8 or (fd and len(payload) in FD_LENGTHS), payload.hex()
        assert isinstance(time_ns, int)
        assert abs(time_ns) < 2**63, time_ns


def _hold_candump(path: Path, frames: list[Frame], counts: LogCounts) -> None:
    """Hold that small chunks give the same frames, and that what is written is read again."""
    again = LogCounts()
    blocks = read_candump_blocks(path, ChannelMap(_CHANNELS), again, chunk=512)
    assert [frame for block in blocks for frame in block.frames()] == frames
    assert (again.frames, again.malformed, again.lines) == (counts.frames, counts.malformed, counts.lines)
    real = [frame for frame in frames if frame.bus != TICK_BUS]
    copy = scratch() / "copy.log"
    copy.write_bytes(candump_text(real, _NAMES))
    assert list(read_log(copy, _CHANNELS, LogCounts())) == real
