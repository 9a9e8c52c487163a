"""Reads and writes `.pcap` and `.pcapng` of SocketCAN, as tcpdump and Wireshark record them.

Packets of the link types CAN_SOCKETCAN (227), and LINUX_SLL (113) and LINUX_SLL2 (276) as of `tcpdump -i any`, hold
frames; those of other link types are counted. The names of a `.pcapng`'s interfaces are its channels; a `.pcap` has
none.
The layouts follow https://www.tcpdump.org/linktypes/, and the IETF drafts of both file formats.

What is damaged is skipped to the next header that can be one, and counted as malformed with its place.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from struct import Struct
from typing import BinaryIO, Final, NamedTuple

from candaemon.can_io.logs.stream import MOST_IN_VAIN, NO_CHANNEL, UNCLAIMED, ChannelMap, LogBytes, LogCounts
from candaemon.frames.frame import EXTENDED, Frame
from candaemon.frames.frame_block import FD_LENGTHS
from candaemon.frames.times import LATEST_NS

LONGEST_PACKET: Final = 256 << 10
"""Bytes of a packet; tcpdump records so many, a frame has 72 at most, or 2,064 where it is CAN XL."""
LONGEST_BLOCK: Final = 1 << 20
"""Bytes of a block of a `.pcapng`."""
MOST_INTERFACES: Final = 1024
"""Interfaces of a section of a `.pcapng`."""
LONGEST_DAMAGE: Final = 4 << 20
"""Bytes in a row that are no packet, after which a capture is not looked at any further."""
LATEST_PCAP_S: Final = (1 << 32) - 1
"""Latest time that a `.pcap` holds, s: its seconds have 32 bits."""

_PIECE = 1 << 16
_BATCH = 1024  # frames
_SECOND_NS = 1_000_000_000

_CAN, _SLL, _SLL2 = 227, 113, 276
_LINK_TYPE = 0x0FFF_FFFF  # the bits above tell of checksums
_CAN_PROTOCOLS = frozenset((0x000C, 0x000D))  # classic and FD, in a cooked header
_SLL_HEADER = Struct(">14xH")  # …, protocol
_SLL2_HEADER = Struct(">H2xL12x")  # protocol, …, index of the interface, …

_FRAME = Struct(">LBBxx")  # identifier with flags, length, flags of CAN FD
_REMOTE, _ERROR, _ID_29, _ID_11 = 0x4000_0000, 0x2000_0000, 0x1FFF_FFFF, 0x7FF
_BIT_RATE_SWITCH, _IS_FD, _IS_XL = 0x01, 0x04, 0x80
_CLASSIC_BYTES, _FD_BYTES = 8, 64
_FD_PACKET = _FRAME.size + _FD_BYTES

_NO_END = f"more than {LONGEST_DAMAGE >> 20} MiB in a row are no packet"
_FAR_S = 3600  # s from one packet to the next, behind damage
_MAGIC = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""Order of bytes, and ns a unit of time, by what a `.pcap` begins with."""
_FILE_BEHIND_MAGIC = "HHlLLL"  # version, zone, accuracy, longest packet, link type
_RECORD = "LLLL"  # seconds, fraction, bytes recorded, bytes sent

_SECTION, _INTERFACE, _OLD_PACKET, _SIMPLE_PACKET, _PACKET = 0x0A0D_0D0A, 1, 2, 3, 6
_ORDERS = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_LEAST_BLOCK = 12  # bytes: type, size, size
_OPTION_NAME, _OPTION_RESOLUTION, _OPTION_OFFSET = 2, 9, 14
_MOST_DIGITS = 30  # of a decimal resolution; as bits, 63


class _Packet(NamedTuple):
    """A packet of a capture.

    Attributes:
        time_ns: in ns; may be out of range.
        link: its link type.
        channel: the name of its interface, the number of one without name, None in a format without interfaces.
        content: its bytes.
    """

    time_ns: int
    link: int
    channel: str | int | None
    content: bytes


def read_pcap(stream: LogBytes, channels: ChannelMap, counts: LogCounts) -> Iterator[list[Frame]]:
    """Yield the data frames of a capture, in the order of the file; which of both formats it is, it says itself.

    Args:
        stream: the log.
        channels: which bus a channel belongs to.
        counts: filled while reading; `lines` counts packets, and the other blocks of a `.pcapng`.
    """
    with stream:
        window = _Window(stream)
        window.fill(4)
        magic = bytes(window.buffer[:4])
        if magic in _MAGIC:
            packets = _pcap_packets(window, counts)
        elif magic == b"\x0a\x0d\x0d\x0a":
            packets = _pcapng_packets(window, counts)
        else:
            counts.note_bad_line(f"no PCAP header: it begins with {magic!r}")
            return
        taker = _PacketFrames(channels, counts)
        frames: list[Frame] = []
        for packet in packets:
            frame = taker.frame(packet)
            if frame is not None:
                frames.append(frame)
                if len(frames) >= _BATCH:
                    yield frames
                    frames = []
            elif taker.in_vain > MOST_IN_VAIN:
                counts.note_end(f"{taker.in_vain:,} packets in a row without a frame: this is no CAN log")
                break
        if frames:
            yield frames


class _PacketFrames:
    """Takes the frames from packets, and counts what is none.

    Attributes:
        in_vain: packets since the last frame.
    """

    def __init__(self, channels: ChannelMap, counts: LogCounts) -> None:
        self._channels = channels
        self._counts = counts
        self.in_vain = 0

    def frame(self, packet: _Packet) -> Frame | None:
        """Return a packet's frame; None, and counted, where it is no data frame of a bus."""
        counts = self._counts
        counts.lines += 1
        self.in_vain += 1
        found = self._content(packet)
        if found is None:
            counts.other_lines += 1
            counts.note_advice(f"packets of link type {packet.link} hold no CAN frames; expected {_CAN}, SocketCAN")
            return None
        content, channel = found
        if len(content) < _FRAME.size:
            return self._malformed(f"a packet of {len(content)} bytes")
        can_id, size, flags = _FRAME.unpack_from(content)
        if size & _IS_XL:
            counts.other_lines += 1
            return None
        self.in_vain = 0
        bus = self._channels.named(channel) if isinstance(channel, str) else self._channels.numbered(channel)
        if bus < 0:
            name = NO_CHANNEL if channel is None else str(channel)
            if bus == UNCLAIMED:
                counts.note_other_channel(name)
                return None
            return self._malformed(f"channel '{name}' holds no frames")
        if can_id & _ERROR:
            counts.error_frames += 1
            return None
        if can_id & _REMOTE:
            counts.remote += 1
            return None
        fd = bool(flags & _IS_FD) or size > _CLASSIC_BYTES or len(content) == _FD_PACKET
        identifier = can_id & _ID_29
        if not can_id & EXTENDED and identifier > _ID_11:
            return self._malformed(f"identifier {identifier:#x} is out of range")
        if size not in FD_LENGTHS or len(content) < _FRAME.size + size:
            return self._malformed(f"{len(content) - _FRAME.size} data bytes, where the length is {size}")
        if not 0 <= packet.time_ns <= LATEST_NS:
            return self._malformed(f"time stamp {packet.time_ns} ns is out of range")
        counts.frames += 1
        data = content[_FRAME.size : _FRAME.size + size]
        return Frame(packet.time_ns, bus, identifier | can_id & EXTENDED, data, fd)

    def _content(self, packet: _Packet) -> tuple[bytes, str | int | None] | None:
        """Return the frame in a packet, and its channel; None where there can be none."""
        content = packet.content
        if packet.link == _CAN:
            return content, packet.channel
        if packet.link == _SLL and len(content) >= _SLL_HEADER.size:
            (protocol,) = _SLL_HEADER.unpack_from(content)
            return (content[_SLL_HEADER.size :], None) if protocol in _CAN_PROTOCOLS else None
        if packet.link == _SLL2 and len(content) >= _SLL2_HEADER.size:
            protocol, interface = _SLL2_HEADER.unpack_from(content)
            return (content[_SLL2_HEADER.size :], str(interface)) if protocol in _CAN_PROTOCOLS else None
        return None

    def _malformed(self, reason: str) -> Frame | None:
        """Count what is counted as a line already; return no frame."""
        self._counts.note_malformed(self._counts.lines, reason)
        return None


class _Window:
    """The part of a stream that is looked at.

    Attributes:
        buffer: its bytes.
        place: offset of the first one in the file.
    """

    def __init__(self, stream: LogBytes) -> None:
        self._stream = stream
        self.buffer = bytearray()
        self.place = 0

    def fill(self, size: int) -> bool:
        """Look at `size` bytes; return whether there are so many."""
        while len(self.buffer) < size:  # ends: no piece is empty
            piece = self._stream.read1(_PIECE)
            if not piece:
                return False
            self.buffer += piece
        return True

    def drop(self, size: int) -> None:
        """Go on behind the first `size` bytes."""
        size = min(size, len(self.buffer))
        del self.buffer[:size]
        self.place += size


def _pcap_packets(window: _Window, counts: LogCounts) -> Iterator[_Packet]:
    """Yield the packets of a `.pcap`."""
    order, unit_ns = _MAGIC[bytes(window.buffer[:4])]
    head, record = Struct(f"{order}4x{_FILE_BEHIND_MAGIC}"), Struct(f"{order}{_RECORD}")
    if not window.fill(head.size):
        counts.note_end("its header is cut short")
        return
    link = head.unpack_from(window.buffer)[-1] & _LINK_TYPE
    window.drop(head.size)
    finder, before_s = _RecordFinder(window, record, _SECOND_NS // unit_ns), 0
    while window.fill(record.size):  # ends: each round drops bytes
        seconds, fraction, size, _ = record.unpack_from(window.buffer)
        if size > LONGEST_PACKET or fraction >= _SECOND_NS // unit_ns:
            place = window.place
            finder.drop_to_next(before_s)
            counts.note_bad_line(f"{window.place - place} bytes at byte {place} are no packet")
            if window.place - place >= LONGEST_DAMAGE:
                counts.note_end(_NO_END)
                return
            continue
        if not window.fill(record.size + size):
            break
        content = bytes(window.buffer[record.size : record.size + size])
        window.drop(record.size + size)
        before_s = seconds
        yield _Packet(seconds * _SECOND_NS + fraction * unit_ns, link, None, content)
    if window.buffer:
        counts.note_end("its last packet is cut short")


class _RecordFinder:
    """Finds the next packet of a `.pcap` behind damage: a header that can be one, with another one behind its packet.

    Args:
        window: of the file.
        record: the header's layout.
        units: of time in a second.
    """

    def __init__(self, window: _Window, record: Struct, units: int) -> None:
        self._window, self._record, self._units = window, record, units
        self._little = record.format.startswith("<")

    def drop_to_next(self, before_s: int) -> None:
        """Go on at the next packet; behind `LONGEST_DAMAGE` or at the file's end where there is none.

        Args:
            before_s: time of the last good packet; 0: there was none.
        """
        window, begin, last = self._window, 1, self._window.place + LONGEST_DAMAGE
        while window.fill(begin + self._record.size) and window.place < last:  # ends: each round drops bytes
            for at in self._candidates(before_s, begin):
                if self._can_be(at, before_s):
                    window.drop(at)
                    return
            window.drop(len(window.buffer) - self._record.size + 1)
            begin = 0
        window.drop(len(window.buffer))

    def _candidates(self, before_s: int, begin: int) -> Iterator[int]:
        """Yield places whose time is near the last good packet's: all but the lowest byte of its seconds agree."""
        end = len(self._window.buffer) - self._record.size + 1
        if not before_s:
            yield from range(begin, end)
            return
        for high in range(before_s >> 8, min((before_s >> 8) + 2, 1 << 24)):  # after the last second comes none
            pattern = high.to_bytes(3, "little" if self._little else "big")
            offset = 1 if self._little else 0
            at = self._window.buffer.find(pattern, begin + offset)
            while 0 <= at - offset < end and at >= 0:
                yield at - offset
                at = self._window.buffer.find(pattern, at + 1)

    def _can_be(self, at: int, before_s: int) -> bool:
        """Return whether two packets, or one and the file's end, can follow at a place."""
        seconds, fraction, size, sent = self._read(at)
        if not (self._is_header(fraction, size, sent) and (not before_s or abs(seconds - before_s) <= _FAR_S)):
            return False
        behind = at + self._record.size + size
        if not self._window.fill(behind + self._record.size):
            return len(self._window.buffer) >= behind
        following, fraction, size, sent = self._read(behind)
        return self._is_header(fraction, size, sent) and abs(following - seconds) <= _FAR_S

    def _read(self, at: int) -> tuple[int, int, int, int]:
        """Return the fields of a header: seconds, fraction, bytes recorded, bytes sent."""
        seconds, fraction, size, sent = self._record.unpack_from(self._window.buffer, at)
        return seconds, fraction, size, sent

    def _is_header(self, fraction: int, size: int, sent: int) -> bool:
        return fraction < self._units and _FRAME.size <= size <= _PIECE and sent >= size


@dataclass(frozen=True, slots=True)
class _Interface:
    """An interface of a `.pcapng`.

    Attributes:
        link: its link type.
        channel: its name, or its number where it has none.
        numerator, denominator: ns a unit of time.
        offset_ns: added to its times.
    """

    link: int
    channel: str | int
    numerator: int
    denominator: int
    offset_ns: int


def _pcapng_packets(window: _Window, counts: LogCounts) -> Iterator[_Packet]:
    """Yield the packets of a `.pcapng`."""
    order, interfaces = "<", list[_Interface]()
    while window.fill(_LEAST_BLOCK):  # ends: each round drops bytes
        order = _order(window, order)
        kind, size = _block_at(window, 0, order)
        if not size or not window.fill(size):
            if size and _is_cut_short(window, size, order):
                break
            place = window.place
            _drop_to_block(window, order)
            counts.note_bad_line(f"{window.place - place} bytes at byte {place} are no block")
            if window.place - place >= LONGEST_DAMAGE:
                counts.note_end(_NO_END)
                return
            continue
        body = bytes(window.buffer[8 : size - 4])
        window.drop(size)
        if kind in (_PACKET, _OLD_PACKET):
            packet = _packet(body, kind, order, interfaces)
            if packet is None:
                counts.note_bad_line(f"a packet of {len(body)} bytes of none of {len(interfaces)} interfaces")
            else:
                yield packet
            continue
        if kind == _SIMPLE_PACKET:
            counts.note_bad_line("a packet without a time (simple packet block)")
            continue
        if kind == _SECTION:
            interfaces = []
        elif kind == _INTERFACE and len(interfaces) < MOST_INTERFACES:
            interfaces.append(_interface(body, order, len(interfaces)))
        counts.lines += 1
        counts.other_lines += 1
    if window.buffer:
        counts.note_end("its last block is cut short")


_layout = lru_cache(Struct)
"""Makes layouts once."""


def _order(window: _Window, order: str) -> str:
    """Return the order of bytes of a section that begins here; as it was where none does."""
    if window.buffer[:4] != b"\x0a\x0d\x0d\x0a":
        return order
    return _ORDERS.get(bytes(window.buffer[8:12]), order)


def _block_at(window: _Window, at: int, order: str) -> tuple[int, int]:
    """Return type and size of the block at a place; size 0 where none can be there, or it does not end as it begins."""
    kind, size = _layout(f"{order}LL").unpack_from(window.buffer, at)
    if not _LEAST_BLOCK <= size <= LONGEST_BLOCK or size % 4:
        return kind, 0
    if window.fill(at + size):
        (again,) = _layout(f"{order}L").unpack_from(window.buffer, at + size - 4)
        return kind, size if again == size else 0
    return kind, size


def _is_cut_short(window: _Window, size: int, order: str) -> bool:
    """Return whether the file ends in the block that begins here, and no other begins in it."""
    return len(window.buffer) < size and not any(_whole_block(window, at, order) for at in _marks(window, 1, order))


def _drop_to_block(window: _Window, order: str) -> None:
    """Go on at the next packet or section; behind `LONGEST_DAMAGE` or at the file's end where there is none."""
    begin, last = 1, window.place + LONGEST_DAMAGE
    while window.fill(begin + _LEAST_BLOCK) and window.place < last:  # ends: each round drops bytes
        for at in sorted(_marks(window, begin, order)):
            if _whole_block(window, at, order):
                window.drop(at)
                return
        window.drop(len(window.buffer) - _LEAST_BLOCK + 1)
        begin = 0
    window.drop(len(window.buffer))


def _marks(window: _Window, begin: int, order: str) -> list[int]:
    """Return where a packet's or a section's block can begin, as far as the window goes."""
    found, end = [], len(window.buffer) - _LEAST_BLOCK
    for mark in (Struct(f"{order}L").pack(_PACKET), b"\x0a\x0d\x0d\x0a"):
        at = window.buffer.find(mark, begin)
        while 0 <= at <= end:
            found.append(at)
            at = window.buffer.find(mark, at + 1)
    return found


def _whole_block(window: _Window, at: int, order: str) -> bool:
    """Return whether a whole block is at a place."""
    size = _block_at(window, at, order)[1]
    return bool(size) and len(window.buffer) >= at + size


def _packet(body: bytes, kind: int, order: str, interfaces: Sequence[_Interface]) -> _Packet | None:
    """Return the packet of a block; None where it is too short or of no interface."""
    layout = _layout(f"{order}LLLLL" if kind == _PACKET else f"{order}HHLLLL")
    if len(body) < layout.size:
        return None
    fields = layout.unpack_from(body)
    index, (high, low, size, _) = fields[0], fields[-4:]
    if index >= len(interfaces) or layout.size + size > len(body):
        return None
    interface = interfaces[index]
    ticks = high << 32 | low
    time_ns = ticks * interface.numerator // interface.denominator + interface.offset_ns
    return _Packet(time_ns, interface.link, interface.channel, body[layout.size : layout.size + size])


def _interface(body: bytes, order: str, index: int) -> _Interface:
    """Return an interface as its block describes it; without what is missing."""
    if len(body) < 8:
        return _Interface(-1, index, 1000, 1, 0)
    (link,) = Struct(f"{order}H").unpack_from(body)
    name, resolution, offset_s = "", 6, 0
    for code, value in _options(body[8:], order):
        if code == _OPTION_NAME:
            name = value.decode(errors="replace")
        elif code == _OPTION_RESOLUTION and len(value) == 1:
            resolution = value[0]
        elif code == _OPTION_OFFSET and len(value) == 8:
            (offset_s,) = Struct(f"{order}q").unpack(value)
    if resolution & 0x80:
        numerator, denominator = _SECOND_NS, 1 << min(resolution & 0x7F, 63)
    else:
        numerator, denominator = _SECOND_NS, 10 ** min(resolution, _MOST_DIGITS)
    return _Interface(link, name or index, numerator, denominator, offset_s * _SECOND_NS)


def _options(body: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield code and value of each option of a block."""
    header, at = Struct(f"{order}HH"), 0
    while at + header.size <= len(body):  # ends: `at` increases
        code, size = header.unpack_from(body, at)
        at += header.size
        if not code:
            return
        yield code, body[at : at + size]
        at += size + -size % 4


def pcap_header() -> bytes:
    """Return the begin of a `.pcap` of SocketCAN with times in ns."""
    return b"\x4d\x3c\xb2\xa1" + Struct(f"<{_FILE_BEHIND_MAGIC}").pack(2, 4, 0, 0, LONGEST_PACKET, _CAN)


class PcapPackets:
    """Writes packets of a `.pcap`.

    Args:
        target: where to.
    """

    def __init__(self, target: BinaryIO) -> None:
        self._target = target
        self._record = Struct(f"<{_RECORD}")
        target.write(pcap_header())

    def write(self, frames: Sequence[Frame]) -> None:
        """Write frames; their buses are lost.

        Raises:
            ValueError: a time is later than the format holds.
        """
        pack = self._record.pack
        pieces: list[bytes] = []
        for frame in frames:
            content = packet_of(frame)
            seconds, fraction = divmod(frame.time_ns, _SECOND_NS)
            if seconds > LATEST_PCAP_S:
                raise ValueError(f"its times end {LATEST_PCAP_S:,} s after 1970, found {seconds:,}")
            pieces += pack(seconds, fraction, len(content), len(content)), content
        self._target.write(b"".join(pieces))


class PcapngPackets:
    """Writes packets of a `.pcapng`, and an interface for each bus where its first frame comes.

    Args:
        target: where to.
        channels: names of the buses, by index.
    """

    def __init__(self, target: BinaryIO, channels: Sequence[str]) -> None:
        self._target, self._channels = target, channels
        self._interfaces: dict[int, int] = {}
        target.write(_block(_SECTION, Struct("<LHHq").pack(0x1A2B_3C4D, 1, 0, -1)))

    def write(self, frames: Sequence[Frame]) -> None:
        """Write frames."""
        pieces = []
        for frame in frames:
            if frame.bus not in self._interfaces:
                self._interfaces[frame.bus] = len(self._interfaces)
                pieces.append(_described(self._channels[frame.bus]))
            content = packet_of(frame)
            head = Struct("<LLLLL").pack(
                self._interfaces[frame.bus],
                frame.time_ns >> 32,
                frame.time_ns & 0xFFFF_FFFF,
                len(content),
                len(content),
            )
            pieces.append(_block(_PACKET, head + content))
        self._target.write(b"".join(pieces))


def packet_of(frame: Frame) -> bytes:
    """Return a frame as the kernel hands it to a capture: 16 bytes, or 72 of CAN FD."""
    flags = _IS_FD | _BIT_RATE_SWITCH if frame.fd else 0
    return _FRAME.pack(frame.can_id, len(frame.data), flags) + frame.data.ljust(
        _FD_BYTES if frame.fd else _CLASSIC_BYTES, b"\0"
    )


def _described(channel: str) -> bytes:
    """Return the block of an interface whose times are in ns."""
    name = channel.encode()
    options = Struct("<HH").pack(_OPTION_NAME, len(name)) + name + b"\0" * (-len(name) % 4)
    options += Struct("<HHB3x").pack(_OPTION_RESOLUTION, 1, 9) + bytes(4)
    return _block(_INTERFACE, Struct("<HHL").pack(_CAN, 0, 0) + options)


def _block(kind: int, body: bytes) -> bytes:
    """Return a block of a `.pcapng`."""
    size = Struct("<L").pack(_LEAST_BLOCK + len(body))
    return Struct("<L").pack(kind) + size + body + size
