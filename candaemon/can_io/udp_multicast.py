"""CAN over UDP multicast as python-can's `udp_multicast` has it: benches and simulations without a CAN interface.

At 8,000 frames/s it takes half of the CPU time that python-can's takes a frame, and counts what the kernel drops, which
python-can's loses without a trace.

A frame is a datagram: a msgpack map of what python-can's `Message` holds. The kernel stamps each when it comes, and
reports how many found no room in the receive buffer.
"""

from __future__ import annotations

import errno
import socket
import struct
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from typing import Any

from candaemon.can_io.multicast_group import GroupMembership
from candaemon.can_io.port import Controller, PortRequest
from candaemon.can_io.receive_buffer import SO_RXQ_OVFL, ReceiveDrops, size_receive_buffer
from candaemon.can_io.recvmmsg import DatagramBatch
from candaemon.frames.frame import EXTENDED, Frame, make_frame
from candaemon.frames.frame_block import FD_LENGTHS

PORT = 43_113
"""UDP port where the options give none, as python-can has it."""

_SO_TIMESTAMPNS = 35  # Linux; the socket module does not name it
_HEADER = f"{struct.calcsize('@Nii')}x"
_CONTROL = struct.calcsize("@Nii2l0NNiiI0N")
_LONGEST = 512
"""Bytes of a datagram; a CAN FD frame's has 230."""
_RECORD = f"@{_LONGEST}s {_HEADER}2l0N {_HEADER}I0N"
"""A datagram, when it came in s and ns, and SO_RXQ_OVFL's count; its sender follows."""
_BATCH = 64
_DATAGRAM_BYTES = 1280
"""What a datagram takes of a receive buffer: a classic frame 832 with the kernel's book-keeping, CAN FD more."""
_FULL = (errno.EAGAIN, errno.ENOBUFS)
_ID_29, _ID_11, _CLASSIC = 0x1FFF_FFFF, 0x7FF, 8
_TIME = b"\x8b\xa9timestamp\xcb"
"""How python-can's datagrams begin; eight bytes of time follow."""
_DATA = b"\xa4data\xc4"
"""What stands before the payload's length and the payload."""
_MOST_KINDS = 4096


class UdpMulticastPort:
    """A multicast group as a CAN bus.

    What is sent leaves by a socket of its own, so that its datagrams are known by their sender when they come back. A
    bus of which no identifier is wanted is not listened to.

    Args:
        request: which bus; its options are `port` and `hop_limit`.

    Attributes:
        controller: active; a group has none.

    Raises:
        OSError: the group cannot be reached or joined.
        ImportError: msgpack is not installed.
    """

    def __init__(self, request: PortRequest) -> None:
        import msgpack  # noqa: PLC0415  # an extra of this package: who has CAN interfaces needs none

        self.controller: Controller = "active"
        self._pack, self._unpack = msgpack.Packer().pack, msgpack.unpackb
        self._index, self._counts, self._fd = request.index, request.counts, request.settings.fd
        options: dict[str, Any] = request.settings.options
        family, address, hops = _where(request.settings.channel, **options)
        with ExitStack() as opened:
            self._sending = opened.enter_context(_sender(family, address, hops))
            self._own = _sockaddr(*self._sending.getsockname())
            self._hearing, self._membership = self._sending, None
            if request.ids is None or request.ids:
                self._hearing, self._membership = _listener(family, address)
                opened.enter_context(self._hearing)
                size_receive_buffer(self._hearing, request, _DATAGRAM_BYTES)
            self._drops = ReceiveDrops(self._hearing, request.counts)
            self._record = struct.Struct(f"{_RECORD} {len(self._own)}s 0N")
            self._datagrams = DatagramBatch(_BATCH, _LONGEST, _CONTROL, self._record.size - _LONGEST - _CONTROL)
            self._kinds: dict[tuple[bytes, int, bytes], tuple[int, bool]] = {}
            self._opened = opened.pop_all()

    def fileno(self) -> int:
        """Return the descriptor that is readable when something has come."""
        return self._hearing.fileno()

    def receive(self, limit: int) -> list[Frame]:
        """Return what has come, `limit` datagrams at most.

        Raises:
            OSError: the network is gone.
        """
        frames: list[Frame] = []
        self._take(limit, frames)
        return frames

    def send(self, frames: Sequence[Frame]) -> int:
        """Send frames until the socket is full; return how many were sent.

        Raises:
            OSError: the network is gone.
        """
        send, pack = self._sending.send, self._pack
        for sent, frame in enumerate(frames):
            try:
                send(pack(_message(frame)))
            except OSError as error:
                if sent or error.errno in _FULL:  # what fails for good fails again
                    return sent
                raise
        return len(frames)

    def check(self) -> None:
        """Count what was lost behind the last frame, and look whether the group can still be heard.

        Raises:
            OSError: it cannot.
        """
        self._drops.look()
        if self._membership is not None:
            self._membership.check()

    def close(self) -> None:
        """Leave the group; count what was lost behind the last frame, and what had come and nobody has read."""
        with self._opened:
            if self._membership is not None and self._hearing.fileno() >= 0:
                self._count_unread(self._membership)

    def _count_unread(self, membership: GroupMembership) -> None:
        """Let nothing more come; count what there is.

        Raises:
            OSError: the network is gone.
        """
        with suppress(OSError):
            membership.leave()
        self._drops.look()
        taken = _BATCH
        while taken == _BATCH:
            frames: list[Frame] = []
            taken = self._take(_BATCH, frames)
            self._counts.unread += len(frames)

    def _take(self, limit: int, frames: list[Frame]) -> int:
        """Append the frames of what has come; count the rest. Return how many datagrams it was, `limit` at most."""
        datagrams, own, drops, descriptor = self._datagrams, self._own, self._drops, self._hearing.fileno()
        taken = 0
        while taken < limit:
            asked = min(limit - taken, _BATCH)
            try:
                number = datagrams.receive(descriptor, asked)
            except OSError:
                if frames:  # an error that lasts comes again
                    return taken
                raise
            taken += number
            for (size, control), record in zip(
                datagrams.lengths(number), datagrams.records(number, self._record), strict=False
            ):
                content, seconds, nanoseconds, lost, sender = record
                if control == _CONTROL and lost != drops.in_all:
                    drops.note(lost)
                if sender != own:
                    time_ns = seconds * 1_000_000_000 + nanoseconds if control else time.time_ns()
                    frame = self._frame(content[:size] if size < _LONGEST else b"", time_ns)
                    if frame is not None:
                        frames.append(frame)
            if number < asked:
                break
        return taken

    def _frame(self, content: bytes, time_ns: int) -> Frame | None:
        """Return a datagram's data frame; None, and counted, if it is none.

        Datagrams that differ in nothing but their time and payload are read once by their keys: to do so for each costs
        more than all else.
        """
        before, _, behind = content.partition(_DATA)
        end = behind[0] + 1 if behind else 0
        kind = before[len(_TIME) + 8 :], end, behind[end:]
        known = self._kinds.get(kind) if before.startswith(_TIME) and len(behind) >= end else None
        if known is not None:
            can_id, fd = known
            return make_frame((time_ns, self._index, can_id, behind[1:end], fd))
        frame = self._read(content, time_ns)
        plain = kind[0] and before.startswith(_TIME) and len(self._kinds) < _MOST_KINDS
        if frame is not None and plain and frame.data == behind[1:end]:
            self._kinds[kind] = frame.can_id, frame.fd
        return frame

    def _read(self, content: bytes, time_ns: int) -> Frame | None:
        """Return a datagram's data frame by its keys; None, and counted, if it is none."""
        try:
            message = self._unpack(content, raw=True)  # keys as bytes: to decode eleven names costs as much as all else
            if message[b"is_error_frame"]:
                self._counts.error_frames += 1
                return None
            if message[b"is_remote_frame"]:
                self._counts.remote += 1
                return None
            can_id, data, extended = message[b"arbitration_id"], message[b"data"], message[b"is_extended_id"]
            fd, size = bool(message[b"is_fd"]), len(data)
            good = (
                type(data) is bytes
                and type(can_id) is int
                and 0 <= can_id <= (_ID_29 if extended else _ID_11)
                and size in FD_LENGTHS
                and (size <= _CLASSIC or fd)
                and size == message[b"dlc"]
            )
        except (ValueError, TypeError, LookupError):  # no msgpack, no map, a key that is missing or of another type
            good = False
        if not good:
            self._counts.malformed += 1
            return None
        if fd and not self._fd:
            self._counts.fd_unset += 1
            return None
        return Frame(time_ns, self._index, can_id | EXTENDED if extended else can_id, data, fd)


def _message(frame: Frame) -> dict[str, Any]:
    """Return a frame as the map that python-can packs."""
    return {
        "timestamp": frame.time_ns / 1_000_000_000,
        "arbitration_id": frame.can_id & _ID_29,
        "is_extended_id": bool(frame.can_id & EXTENDED),
        "is_remote_frame": False,
        "is_error_frame": False,
        "channel": None,
        "dlc": len(frame.data),
        "data": frame.data,
        "is_fd": frame.fd,
        "bitrate_switch": frame.fd,
        "error_state_indicator": False,
    }


def _sockaddr(host: str, port: int, *of_ipv6: int) -> bytes:
    """Return the kernel's form of an address that Python gives: of IPv6, flow and scope come behind the port."""
    if not of_ipv6:
        return struct.pack("@HH4s8x", socket.AF_INET, socket.htons(port), socket.inet_aton(host))
    flow, scope = of_ipv6
    packed = socket.inet_pton(socket.AF_INET6, host.partition("%")[0])
    return struct.pack("@HHI16sI", socket.AF_INET6, socket.htons(port), socket.htonl(flow), packed, scope)


def _where(group: str, port: int = PORT, hop_limit: int = 1) -> tuple[socket.AddressFamily, Any, int]:
    """Return address family, address and hop limit of a group.

    Raises:
        OSError: the group is no address.
    """
    family, _, _, _, address = socket.getaddrinfo(group, port, type=socket.SOCK_DGRAM)[0]
    return family, address, hop_limit


def _sender(family: socket.AddressFamily, address: Any, hops: int) -> socket.socket:
    """Return a socket that sends to the group."""
    sending = socket.socket(family, socket.SOCK_DGRAM)
    try:
        if family == socket.AF_INET:
            sending.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, hops)
        else:
            sending.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, hops)
        sending.setblocking(False)
        sending.connect(address)
    except OSError:
        sending.close()
        raise
    return sending


def _listener(family: socket.AddressFamily, address: Any) -> tuple[socket.socket, GroupMembership]:
    """Return a socket that hears the group and no other, and its membership."""
    hearing = socket.socket(family, socket.SOCK_DGRAM)
    try:
        for option in (socket.SO_REUSEADDR, socket.SO_REUSEPORT, _SO_TIMESTAMPNS, SO_RXQ_OVFL):
            hearing.setsockopt(socket.SOL_SOCKET, option, 1)
        hearing.setblocking(False)
        # before it is bound, so that whoever sees it bound can rely on its hearing all
        membership = GroupMembership(hearing, address)
        # bound to any address it would hear every group that this machine has joined on the port
        hearing.bind(address)
    except OSError:
        hearing.close()
        raise
    return hearing, membership
