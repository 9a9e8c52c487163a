"""SocketCAN through a raw socket, for what python-can's interface lacks.

The kernel filters by identifier, stamps each frame as it is received, keeps frames while the daemon is busy and reports
how many it had no room for; the controller's error frames come too. Many frames are taken in one system call.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import struct
import sys
import time
from collections.abc import Collection, Sequence
from contextlib import suppress
from typing import Final

from candaemon.can_io import timestamps
from candaemon.can_io.port import Controller, PortCounts, PortRequest
from candaemon.can_io.receive_buffer import SO_RXQ_OVFL, ReceiveDrops, size_receive_buffer
from candaemon.can_io.recvmmsg import DatagramBatch
from candaemon.frames.frame import EXTENDED, Frame, make_frame
from candaemon.frames.frame_block import FD_LENGTHS

ERROR_FLAG = 0x2000_0000
"""CAN_ERR_FLAG in the identifier of an error frame."""
EVERY_ERROR = 0x1FFF_FFFF
"""CAN_ERR_MASK: the filter that takes every class of error."""

_LOST_ARBITRATION = 0x002
_CONTROLLER = 0x004
_NO_ACKNOWLEDGE = 0x020
_BUS_OFF = 0x040
_RESTARTED = 0x100

_OVERFLOW = 0x03  # CAN_ERR_CRTL_RX_OVERFLOW | CAN_ERR_CRTL_TX_OVERFLOW, in byte 1
_WARNING = 0x0C
_PASSIVE = 0x30
_ACTIVE = 0x40


def count_error_frame(can_id: int, data: bytes, counts: PortCounts, before: Controller) -> Controller:
    """Count what an error frame reports.

    Args:
        can_id: with the classes of error in its bits.
        data: its 8 bytes; byte 1 details a problem of the controller.
        counts: counted there.
        before: state of the controller up to this frame.

    Returns:
        state of the controller from this frame on.
    """
    counts.error_frames += 1
    if can_id & _LOST_ARBITRATION:
        counts.arbitration_lost += 1
    if can_id & _NO_ACKNOWLEDGE:
        counts.no_acknowledge += 1
    if can_id & _BUS_OFF:
        counts.bus_off += 1
        return "bus-off"
    if can_id & _RESTARTED:
        counts.restarts += 1
        return "active"
    return _controller_state(data[1], counts, before) if can_id & _CONTROLLER else before


def _controller_state(detail: int, counts: PortCounts, before: Controller) -> Controller:
    """Count a problem of the controller; return its state."""
    if detail & _OVERFLOW:
        counts.controller_overflows += 1
    if detail & _PASSIVE:
        counts.error_passive += before != "passive"
        return "passive"
    if detail & _WARNING:
        counts.error_warning += before != "warning"
        return "warning"
    return "active" if detail & _ACTIVE else before


FRAME_BYTES: Final = 768
"""What a frame takes of a receive buffer, classic or FD: the kernel counts its own book-keeping."""

_CAN_RAW_ERR_FILTER: Final = 2  # these are Linux's, and Python has no names for them
_SIOCGIFFLAGS: Final = 0x8913
_SIOCGIFMTU: Final = 0x8921
_SIOCGIFINDEX: Final = 0x8933
_IFF_UP: Final = 0x01
_IFF_RUNNING: Final = 0x40
_CARRIER_S: Final = 1.5
"""The kernel reports a change of carrier up to a second late."""

_NO_ROOM: Final = (errno.EAGAIN, errno.ENOBUFS)
_REMOTE_FLAG: Final = 0x4000_0000
_FD_SWITCH: Final = 0x01  # CANFD_BRS: the payload has the data bit rate
_MOST_FILTERS: Final = 512  # CAN_RAW_FILTER_MAX
_CLASSIC: Final = struct.Struct("=IB3x8s")
_FD: Final = struct.Struct("=IBB2x64s")

_BATCH: Final = 64
_ERRORS_BEFORE_FRAMES: Final = 3
"""Readings of a socket that had an error and then another, until what is in its buffer comes."""
_ERROR_FRAME_FACTOR: Final = 4
"""How many times the limit is read where what comes are error frames, which no limit counts."""

_STAMPS_SPACE: Final = struct.calcsize("@Nii6l0N")
_COUNT_SPACE: Final = struct.calcsize("@NiiI0N")
_HEADER: Final = f"{struct.calcsize('@Nii')}x"
_RECORD: Final = struct.Struct(f"@IB3x64s {_HEADER}6l0N {_HEADER}I0N")
"""A frame, SCM_TIMESTAMPING's three times (software, unused, hardware), and SO_RXQ_OVFL's count."""


class SocketCanPort:
    """An interface of SocketCAN.

    An interface that goes down keeps its socket, which hears it come up again; one that is deleted does not.

    Args:
        request: what to open.

    Attributes:
        controller: what the controller says of itself.

    Raises:
        OSError: it is not there, is down, or cannot carry CAN FD where that is wanted; or this system has no SocketCAN.
    """

    def __init__(self, request: PortRequest) -> None:
        if sys.platform != "linux":
            raise OSError(errno.ENOSYS, "SocketCAN is Linux's own")
        self.controller: Controller = "active"
        self._index = request.index
        self._counts, self._fd = request.counts, request.settings.fd
        self._name = request.settings.channel
        self._failure: OSError | None = None
        self._contradicted_s: float | None = None
        self._clock = timestamps.HardwareClockOffset()
        self._datagrams = DatagramBatch(_BATCH, _FD.size, _STAMPS_SPACE + _COUNT_SPACE)
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_NONBLOCK, socket.CAN_RAW)
        self._drops = ReceiveDrops(self._socket, request.counts)
        try:
            self._set_up(request)
            self._interface = self._ask(_SIOCGIFINDEX)
            self.check()  # a socket bound while the link is down reads ENETDOWN once, even if the link is up by then
            self._socket.bind((self._name,))
            self.check()
        except BaseException:
            self._socket.close()
            raise

    def fileno(self) -> int:
        """Return the socket's descriptor."""
        return self._socket.fileno()

    def receive(self, limit: int) -> list[Frame]:
        """Return what has come, `limit` frames at most, give or take a batch.

        Raises:
            OSError: the interface went down (ENETDOWN) or was deleted (ENODEV). What came before can still be received.
        """
        self._raise_failure()
        frames: list[Frame] = []
        before = self.controller
        for _ in range(1 + _ERROR_FRAME_FACTOR * limit // _BATCH):
            try:
                number = self._datagrams.receive(self._socket.fileno(), _BATCH)
            except OSError as error:
                self.controller = "active"  # as which it starts with its link
                if not frames:
                    raise
                self._failure = error  # the kernel reports it once
                return frames
            self._take(number, frames)
            if number < _BATCH or len(frames) >= limit:
                break
        if frames and before == self.controller == "bus-off":  # it hears, so it is back on the bus
            self.controller = "active"
        return frames

    def send(self, frames: Sequence[Frame]) -> int:
        """Send frames until the transmit queue is full; return how many it took.

        Raises:
            OSError: the interface is down or was deleted, or the frames are none that it can carry.
        """
        send = self._socket.send
        for sent, frame in enumerate(frames):
            try:
                send(_packed(frame))
            except OSError as error:
                if sent or error.errno in _NO_ROOM:  # what fails for good fails again
                    return sent
                raise
        return len(frames)

    def check(self) -> None:
        """Look whether this is still the interface of that name, and up; count what was lost behind the last frame.

        Raises:
            OSError: it is not.
        """
        self._raise_failure()
        if self._ask(_SIOCGIFINDEX) != self._interface:
            raise OSError(errno.ENODEV, "the interface was made anew")
        flags = self._ask(_SIOCGIFFLAGS)
        if not flags & _IFF_UP:
            raise OSError(errno.ENETDOWN, os.strerror(errno.ENETDOWN))
        self._follow_carrier(bool(flags & _IFF_RUNNING), time.monotonic())
        self._drops.look()

    def close(self) -> None:
        """Close the socket; count what was lost behind the last frame, and what had come and nobody has read."""
        with suppress(OSError):  # nothing more comes, so that what there is can be counted
            self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
            self._socket.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, 0)
        self._drops.look()
        for _ in range(_ERRORS_BEFORE_FRAMES):
            with suppress(OSError):
                self._count_unread()
        self._socket.close()

    def _count_unread(self) -> None:
        """Empty the receive buffer; count the frames in it.

        Raises:
            OSError: the socket reports an error first; once, then what is in the buffer can be read.
        """
        number = _BATCH
        while number == _BATCH:
            number = self._datagrams.receive(self._socket.fileno(), _BATCH)
            frames: list[Frame] = []
            self._take(number, frames)
            self._counts.unread += len(frames)

    def _raise_failure(self) -> None:
        """Raise, once, what ended the last reading behind some frames."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _follow_carrier(self, there: bool, now_s: float) -> None:
        """Learn from the carrier that the controller is off the bus, or back, where no error frame reported it.

        It may have gone before the socket was there, and an error frame may have found no room.

        Args:
            there: whether the interface has a carrier, as it has while its controller takes part.
            now_s: monotonic s.
        """
        if there == (self.controller != "bus-off"):
            self._contradicted_s = None
        elif self._contradicted_s is None:
            self._contradicted_s = now_s
        elif now_s - self._contradicted_s >= _CARRIER_S:
            self._contradicted_s = None
            self._counts.bus_off += not there
            self.controller = "active" if there else "bus-off"

    def _set_up(self, request: PortRequest) -> None:
        """Set all that must hold before the first frame comes."""
        settings = request.settings
        if settings.fd:
            self._demand_fd()
        option = self._socket.setsockopt
        option(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)  # where they are not meant to come they are counted
        option(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 0)  # what other programs of this machine send is heard
        option(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, EVERY_ERROR)
        if request.ids is not None and len(request.ids) <= _MOST_FILTERS:
            option(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, receive_filters(request.ids))
        option(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        option(socket.SOL_SOCKET, timestamps.SO_TIMESTAMPING, timestamps.timestamping_flags(settings.time_stamps))
        size_receive_buffer(self._socket, request, FRAME_BYTES)

    def _demand_fd(self) -> None:
        """Refuse an interface that would refuse every CAN FD frame."""
        if self._ask(_SIOCGIFMTU) < _FD.size:
            raise OSError(errno.EMSGSIZE, f"the interface is classic CAN; expected mtu {_FD.size}, as fd: true needs")

    def _ask(self, request: int) -> int:
        """Ask the kernel for one number about the interface of that name.

        Raises:
            OSError: there is none.
        """
        answer: bytes = fcntl.ioctl(self._socket, request, struct.pack("16s24x", self._name.encode()))
        if request == _SIOCGIFFLAGS:
            return int(struct.unpack_from("16xH", answer)[0])
        return int(struct.unpack_from("16xi", answer)[0])

    def _take(self, number: int, frames: list[Frame]) -> None:
        """Append the frames of as many datagrams; count the others and the losses before them."""
        datagrams, drops = self._datagrams, self._drops
        for (length, control), record in zip(
            datagrams.lengths(number), datagrams.records(number, _RECORD), strict=False
        ):
            can_id, size, data, seconds, nanoseconds, _, _, hardware_s, hardware_ns, lost = record
            if control >= _STAMPS_SPACE:
                time_ns = seconds * 1_000_000_000 + nanoseconds
                if hardware_s or hardware_ns:
                    time_ns = self._clock.system_ns(hardware_s * 1_000_000_000 + hardware_ns, time_ns)
            else:
                time_ns = time.time_ns()
            if control == _STAMPS_SPACE + _COUNT_SPACE and lost != drops.in_all:
                drops.note(lost)
            fd = length == _FD.size
            if can_id & ERROR_FLAG:
                self.controller = count_error_frame(can_id, data, self._counts, self.controller)
            elif can_id & _REMOTE_FLAG:
                self._counts.remote += 1
            elif fd and not self._fd:
                self._counts.fd_unset += 1
            elif size not in FD_LENGTHS:
                self._counts.malformed += 1
            else:
                frames.append(make_frame((time_ns, self._index, can_id, data[:size], fd)))


def receive_filters(ids: Collection[int]) -> bytes:
    """Return the kernel's filters that pass the data frames of some identifiers; none at all pass nothing.

    Each names one identifier wholly, its length too: such filters the kernel finds at once, others it tries in turn.

    Args:
        ids: with `EXTENDED`.
    """
    of_all = EXTENDED | _REMOTE_FLAG
    masks = ((can_id, of_all | (0x1FFF_FFFF if can_id & EXTENDED else 0x7FF)) for can_id in sorted(ids))
    return b"".join(struct.pack("=II", *each) for each in masks)


def _packed(frame: Frame) -> bytes:
    """Return a frame as the kernel takes it."""
    if frame.fd:
        return _FD.pack(frame.can_id, len(frame.data), _FD_SWITCH, frame.data)
    return _CLASSIC.pack(frame.can_id, len(frame.data), frame.data)
