"""Captures, MDF 4, candump's screen, any compression, and names that tell no format, with any content."""

from __future__ import annotations

import gzip
import lzma
from collections import Counter
from collections.abc import Callable
from functools import cache

import zstandard

from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.can_io.logs.write import open_log_writer
from candaemon.errors import InputError
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import Frame

from .drawn import Drawn
from .fuzz_logs import hold_frames
from .scratch import scratch

_CHANNELS = {"can0": 0, "can1": 1, "0": 0}
_SUFFIXES = (".pcapng", ".pcap", ".log", ".pcapng", ".pcap", ".mf4")
_PACK: dict[str, Callable[[bytes], bytes]] = {
    ".gz": lambda content: gzip.compress(content, 1),
    ".xz": lambda content: lzma.compress(content, preset=0),
    ".zst": lambda content: zstandard.ZstdCompressor(level=1).compress(content),
}
_WORDS = (b"\n", b"\r\n", b" ", b"\x06\0\0\0", b"\x00\x00\x00\x06", b"\x0a\x0d\x0d\x0a", b"\xff\xff\xff\xff",
          b"\x10\0\0\0", b"##DG", b"##CG", b"##DT", b"##DZ", b"##HL", b"\x01\0\0\0\x14\0\0\0\xe3\0\0\0", b"[8]",
          b"  can0  260   [8]  00 01 02 03 04 05 06 07", b" (000.000100)  can0  260   [1]  00\n", b"remote request",
          b"ERRORFRAME", b"(2018-08-02 16:14:48.434434)", b"'", b"99999999999999999999")  # fmt: skip
_SCREEN = b"".join(
    b" (1533226490.%06d)  can%d  2%02X   [%d]  %s\n" % (k, k % 2, k % 32, k % 9, b" ".join([b"%02X" % k] * (k % 9)))
    for k in range(40)
)


def fuzz_captures(data: bytes) -> Counter[str]:
    """Read a log: as it was drawn, or a sound one with changes; plain, packed, or as a broken stream."""
    drawn = Drawn(data)
    suffix, form = drawn.choice(_SUFFIXES), drawn.integer(0, 7)
    edited = drawn.integer(0, 7) > 0
    content = drawn.edited(_sample(suffix), _WORDS) if edited else drawn.rest()
    packing = drawn.choice(tuple(_PACK)) if form % 4 else ""
    # a name without suffixes leaves it to the content
    path = scratch() / ("capture" if form > 5 else f"capture{suffix}{packing}")
    path.write_bytes(_packed(content, form, packing))
    counts = LogCounts()
    try:
        frames = list(read_log(path, _CHANNELS, counts))
    except InputError:
        assert path.name == "capture"
        return Counter(edited=edited, unknown=1)
    hold_frames(frames, counts)
    told = counts.frames + counts.malformed + counts.remote + counts.error_frames + counts.ticks + counts.other_lines
    assert told + sum(counts.other_channels.values()) == counts.lines
    return Counter(edited=edited, frames=counts.frames, malformed=counts.malformed)


@cache
def _sample(suffix: str) -> bytes:
    """Return a sound log."""
    if suffix == ".log":
        return _SCREEN
    path = scratch() / f"sample{suffix}"
    start = 1_533_226_488_000_000_000
    frames = [Frame(start + k, k % 2, 0x260 + k, bytes(8 if k % 5 else 12), k % 5 == 0) for k in range(20)]
    with OutputFile(path) as file, open_log_writer(file, ["can0", "can1"]) as writer:
        writer.write(frames)
    return path.read_bytes()


def _packed(content: bytes, form: int, packing: str) -> bytes:
    """Return content packed, whole or cut short, or as it is though its name says otherwise."""
    match form % 4:
        case 1:
            return _PACK[packing](content)
        case 2:
            return _PACK[packing](content)[: -1 - len(content) % 16]
        case _:
            return content
