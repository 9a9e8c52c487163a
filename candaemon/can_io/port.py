"""The interface of an open connection to a CAN bus: the port protocol, its counts and its state."""

from __future__ import annotations

import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

from candaemon.config.buses import BusSettings
from candaemon.frames.frame import Frame

Controller: TypeAlias = Literal["active", "warning", "passive", "bus-off"]
"""A CAN controller's state after ISO 11898-1: error active, the same with a warning, error passive, off the bus."""


@dataclass(slots=True)
class PortCounts:
    """What one live bus carried and lost; kept over reconnections. Every frame lost is in exactly one count.

    Attributes:
        received: data frames handed on.
        sent: frames that the bus took.
        kernel_lost: frames that the receive buffer had no room for, as the kernel reports it; error frames among them.
        queue_full: frames dropped behind a driver because the daemon did not take them in time.
        malformed: messages that no CAN frame can be.
        fd_unset: CAN FD frames on a bus without `fd: true`.
        unread: frames that had come when the bus was closed or left, and that nobody has read.
        send_dropped: frames given up because a newer state came, or the bus took none for too long.
        send_failed: frames not sent because the bus was down.
        remote: remote frames, skipped.
        error_frames: error frames of the controller; the counts below say what they reported.
        controller_overflows: times that the controller's own buffers overflowed; it does not say how many frames went.
        error_warning: times that the controller warned of its error counters.
        error_passive: times that it became error passive.
        bus_off: times that it went off the bus.
        no_acknowledge: frames that nobody on the bus acknowledged.
        arbitration_lost: times that it had to wait for a frame of higher priority.
        restarts: times that it came back from being off the bus.
        reconnects: times that the bus came back.
    """

    received: int = 0
    sent: int = 0
    kernel_lost: int = 0
    queue_full: int = 0
    malformed: int = 0
    fd_unset: int = 0
    unread: int = 0
    send_dropped: int = 0
    send_failed: int = 0
    remote: int = 0
    error_frames: int = 0
    controller_overflows: int = 0
    error_warning: int = 0
    error_passive: int = 0
    bus_off: int = 0
    no_acknowledge: int = 0
    arbitration_lost: int = 0
    restarts: int = 0
    reconnects: int = 0

    @property
    def lost(self) -> int:
        """Frames that should have reached the pipeline and did not."""
        return self.kernel_lost + self.queue_full + self.malformed + self.fd_unset + self.unread

    @property
    def unsent(self) -> int:
        """Frames that should have gone onto the bus and did not."""
        return self.send_dropped + self.send_failed


@dataclass(frozen=True, slots=True)
class BusState:
    """Whether a bus is there.

    Attributes:
        up: whether frames can be read from it and sent to it.
        since_ns: since when, in the clock given to `LiveBuses`.
        error: why it is down; empty where it is up.
        controller: what its controller says of itself, where it says anything.
    """

    up: bool
    since_ns: int
    error: str = ""
    controller: Controller = "active"


class Port(Protocol):
    """An open bus. Nothing here waits, and all of it is called from one thread.

    Attributes:
        controller: what its controller says of itself; active where it says nothing.
    """

    controller: Controller

    def fileno(self) -> int:
        """Return the descriptor that is readable when there is something to receive."""

    def receive(self, limit: int) -> list[Frame]:
        """Return what has come, `limit` frames at most.

        Raises `port_errors`: the bus is gone, or its link is down. No frame is lost by that: what fails behind some
        frames is raised by the next call.
        """

    def send(self, frames: Sequence[Frame]) -> int:
        """Send frames until one finds no room, or fails; return how many were taken.

        Raises `port_errors`: none was sent.
        """

    def check(self) -> None:
        """Look whether the bus is still there; asked once a second. Raises `port_errors` where it is not."""

    def close(self) -> None:
        """Close the bus; count what had come and nobody has read. Raises `port_errors`."""


@dataclass(frozen=True, slots=True)
class PortRequest:
    """What a port is opened from.

    Attributes:
        name: the bus's name in the configuration.
        index: its index, which its frames carry.
        settings: interface, channel and the rest.
        counts: what the port skips is counted here.
        ids: identifiers wanted, with `EXTENDED`; an interface may spare the others. None: all.
        rate: frames/s expected; None: a full bus.
    """

    name: str
    index: int
    settings: BusSettings
    counts: PortCounts
    ids: Collection[int] | None = None
    rate: float | None = None


def port_errors(*further: type[Exception]) -> tuple[type[Exception], ...]:
    """Return what a port raises when its bus is gone, select's ValueError on a closed file among it, to catch it.

    python-can's own error is among them where something has imported python-can: without that nothing raises it, and
    importing it takes longer than all else at a start.

    Args:
        further: to be caught too.
    """
    python_can = sys.modules.get("can")
    errors: tuple[type[Exception], ...] = (OSError, ValueError, *further)
    return errors if python_can is None else (python_can.CanError, *errors)
