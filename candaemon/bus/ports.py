"""One open connection to a CAN bus: what `live` reads from and sends to.

`Port` is all that `live` asks of a bus. `PythonCanPort` serves every interface of python-can; a port made for one
interface takes its place with an entry in `PORTS`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from threading import Lock
from typing import Any, Protocol, TypeAlias

import can

from candaemon.bus.frame import EXTENDED, Frame
from candaemon.bus.messages import to_frame, to_message
from candaemon.config.buses import BusSettings
from candaemon.errors import BusError

PORT_ERRORS = (can.CanError, OSError, ValueError)
"""What a port raises when its bus is gone; select raises ValueError on a closed file."""

_OPEN_ERRORS = (*PORT_ERRORS, ImportError, NotImplementedError, TypeError)
_BATCH = 256
_SEND_TIMEOUT_S = 0.005
_MOST_KERNEL_FILTERS = 512
_HINTS = {
    "socketcan": (
        "see `ip link show {channel}`; `ip link set {channel} up type can bitrate {bitrate}` brings a real interface"
        " up, `ip link add dev {channel} type vcan` makes a virtual one"
    ),
    "udp_multicast": (
        "expected a multicast group such as 239.74.163.2 as channel, and `pip install 'candaemon[multicast]'`"
    ),
}
_HINT = "check the bus's channel and options, and that the interface's driver is installed"


@dataclass(slots=True)
class BusCounts:
    """What one live bus carried and lost; kept over reconnections.

    Attributes:
        received: data frames handed on.
        sent: frames sent.
        queue_full: frames dropped because the daemon did not take them in time.
        send_failed: frames not sent: the bus was down, or refused them.
        malformed: messages that no CAN frame can be.
        error_frames: error frames, skipped.
        remote: remote frames, skipped.
        reconnects: times that the bus came back.
    """

    received: int = 0
    sent: int = 0
    queue_full: int = 0
    send_failed: int = 0
    malformed: int = 0
    error_frames: int = 0
    remote: int = 0
    reconnects: int = 0


class Port(Protocol):
    """An open bus. `receive` and `send` may run in two threads at the same time."""

    def receive(self, timeout_s: float) -> list[Frame]:
        """Wait up to `timeout_s` s for frames; return those that are there. Raises `PORT_ERRORS`."""

    def send(self, frames: Sequence[Frame]) -> int:
        """Send frames until one is refused; return how many were sent. Does not raise."""

    def close(self) -> None:
        """Close the bus. Raises `PORT_ERRORS`."""


@dataclass(frozen=True, slots=True)
class PortRequest:
    """What a port is opened from.

    Attributes:
        name: the bus's name in the configuration.
        index: its index, which its frames carry.
        settings: interface, channel and the rest.
        counts: what the port skips is counted here.
        ids: identifiers wanted, with `EXTENDED`; an interface may spare the others. None: all.
    """

    name: str
    index: int
    settings: BusSettings
    counts: BusCounts
    ids: Collection[int] | None = None


class PythonCanPort:
    """A bus opened through python-can.

    Args:
        request: what to open.

    Raises:
        can.CanError, OSError, ValueError, ImportError, NotImplementedError, TypeError: python-can cannot open it so.
    """

    def __init__(self, request: PortRequest) -> None:
        settings = request.settings
        self._index = request.index
        self._counts = request.counts
        # python-can delivers a multicast datagram to its own sender too
        self._echoes = _Echoes() if settings.interface == "udp_multicast" else None
        # what a python-can configuration file on this machine says must not change the daemon
        self._bus = can.Bus(
            channel=settings.channel,
            interface=settings.interface,
            ignore_config=True,
            can_filters=_filters(request),
            receive_own_messages=False,
            **{**_rates(settings), **settings.options},
        )

    def receive(self, timeout_s: float) -> list[Frame]:
        """Wait up to `timeout_s` s for a frame; return it and those that already wait behind it."""
        frames: list[Frame] = []
        message = self._bus.recv(timeout_s)
        for _ in range(_BATCH):
            if message is None:
                break
            self._take(message, frames)
            message = self._bus.recv(0)
        else:
            if message is not None:
                self._take(message, frames)
        return frames

    def send(self, frames: Sequence[Frame]) -> int:
        """Send frames until one is refused: what follows on a full bus would only wait in vain."""
        for sent, frame in enumerate(frames):
            if self._echoes is not None:
                self._echoes.expect(frame)
            try:
                self._bus.send(to_message(frame), timeout=_SEND_TIMEOUT_S)
            except PORT_ERRORS:
                if self._echoes is not None:
                    self._echoes.is_echo(frame)
                return sent
        return len(frames)

    def close(self) -> None:
        """Close the bus."""
        self._bus.shutdown()

    def _take(self, message: can.Message, frames: list[Frame]) -> None:
        """Append a data message's frame; count another."""
        if message.is_error_frame:
            self._counts.error_frames += 1
        elif message.is_remote_frame:
            self._counts.remote += 1
        else:
            try:
                frame = to_frame(message, self._index)
            except (ValueError, OverflowError):
                self._counts.malformed += 1
                return
            if self._echoes is None or not self._echoes.is_echo(frame):
                frames.append(frame)


class _Echoes:
    """Frames sent that are yet to be heard back; the oldest are given up."""

    def __init__(self) -> None:
        self._expected: deque[tuple[int, bytes]] = deque(maxlen=1024)
        self._lock = Lock()

    def expect(self, frame: Frame) -> None:
        """Remember a frame that is about to be sent."""
        with self._lock:
            self._expected.append((frame.can_id, frame.data))

    def is_echo(self, frame: Frame) -> bool:
        """Tell whether a frame heard is one sent, and forget that one."""
        with self._lock:
            try:
                self._expected.remove((frame.can_id, frame.data))
            except ValueError:
                return False
            return True


PortMaker: TypeAlias = Callable[[PortRequest], Port]

PORTS: dict[str, PortMaker] = {}
"""Ports made for one python-can interface, by its name; the others are served by `PythonCanPort`."""


def open_port(request: PortRequest) -> Port:
    """Open a bus.

    Args:
        request: what to open.

    Raises:
        BusError: it cannot be opened; says why and what to do.
    """
    settings = request.settings
    try:
        return PORTS.get(settings.interface, PythonCanPort)(request)
    except _OPEN_ERRORS as error:
        where = f"bus '{request.name}': cannot open {settings.interface} '{settings.channel}'"
        raise BusError(f"{where}: {error}; {_hint(settings)}") from error


def _hint(settings: BusSettings) -> str:
    """Say what to do about a bus that cannot be opened."""
    if settings.interface not in (*PORTS, *can.VALID_INTERFACES):
        return f"expected one of python-can's interfaces: {', '.join(sorted(can.VALID_INTERFACES))}"
    hint = _HINTS.get(settings.interface, _HINT)
    return hint.format(channel=settings.channel, bitrate=settings.bitrate)


def _rates(settings: BusSettings) -> dict[str, Any]:
    """Return the arguments about CAN FD and bit rates that an interface takes."""
    if settings.interface == "virtual":
        return {}
    if settings.interface in ("socketcan", "udp_multicast"):  # the first has its bit rate from `ip link`
        return {"fd": settings.fd}
    if settings.fd:
        return {"fd": True, "bitrate": settings.bitrate, "data_bitrate": settings.data_bitrate}
    return {"bitrate": settings.bitrate}


def _filters(request: PortRequest) -> list[can.typechecking.CanFilter] | None:
    """Return the kernel's filters for the wanted identifiers; None where python-can would filter message by message."""
    ids = request.ids
    if ids is None or request.settings.interface != "socketcan" or len(ids) > _MOST_KERNEL_FILTERS:
        return None
    return [
        {
            "can_id": can_id & ~EXTENDED,
            "can_mask": 0x1FFF_FFFF if can_id & EXTENDED else 0x7FF,
            "extended": bool(can_id & EXTENDED),
        }
        for can_id in sorted(ids)
    ]
