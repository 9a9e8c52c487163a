"""One live bus: open or on its way to be, with what waits to be sent."""

from __future__ import annotations

import errno
import logging
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from selectors import EVENT_READ, BaseSelector
from typing import Final

from candaemon.can_io.open_port import BackgroundOpening, open_port
from candaemon.can_io.port import BusState, Port, PortRequest, port_errors
from candaemon.can_io.tx_queue import TxQueue
from candaemon.errors import BusError
from candaemon.frames.frame import Frame

logger = logging.getLogger(__name__)

MOST: Final = 10
WITHIN_S: Final = 60.0
"""So many messages within that time: a bus with a short circuit goes off ten times a second while it lasts."""


class BusStateLog:
    """Logs when a bus goes up or down; of one that changes too often, only the state after a pause is logged.

    Args:
        name: of the bus in the configuration.

    Attributes:
        logged_up: the state logged last; set where the caller logs it.
    """

    def __init__(self, name: str) -> None:
        self.logged_up = True
        self._name = name
        self._times_s: deque[float] = deque(maxlen=MOST)

    def update(self, now_s: float, *, up: bool, error: str) -> None:
        """Log whether the bus is up, and why it is not, if that has changed; to be called again periodically.

        Args:
            now_s: monotonic s.
            up: whether it is.
            error: why it is down.
        """
        if up == self.logged_up:
            return
        if len(self._times_s) == MOST and now_s - self._times_s[0] < WITHIN_S:
            return
        self._times_s.append(now_s)
        self.logged_up = up
        if up:
            logger.info("bus '%s' is up", self._name)
        else:
            logger.warning("bus '%s' is down: %s", self._name, error)


_CHECK_S = 1.0
_OPENING_S = 0.01
_RETRY_S = 0.001
"""Time of a short frame at 100 kbit/s: a full transmit queue does not signal when it has room again."""

_STAMPING_S = 1.0
"""After a bus was opened, within which the kernel may stamp frames when they are read: where nobody asked for stamps
before, it begins to give them a moment after it was asked."""

_LAST_FRAMES = 1_000_000  # of a bus that is gone: no more come
_LEFT_FRAMES = 20_000  # of a bus that is not: a flood on it must not hold the others up
_ERRORS_BEFORE_FRAMES = 2
_CURES = {
    errno.ENETDOWN: "the link is down; `ip link set {channel} up` starts it",
    errno.ENODEV: "the interface is gone; it is awaited under the same name",
}
_BUS_OFF = (
    "the controller is off the bus after too many errors, or has no carrier: check the wiring and the bit rate; "
    "`ip link set {channel} type can restart-ms 100` lets it come back by itself"
)


class LiveBus:
    """A configured bus, opened again for as long as it takes.

    A bus whose link is down, or whose controller is off the bus, stays open: it hears when it is back. Any other is
    closed and opened anew, after a wait that doubles up to the longest one set.

    Args:
        request: which bus.
        clock: gives nanoseconds; for `BusState.since_ns` only.
        selector: gets the descriptor to read registered, with this bus as its data.

    Attributes:
        name: the bus's name in the configuration.
        index: its index, which its frames carry.
        request: as given.
        counts: what it carried and lost.
        state: whether it is there.
        due_s: when `tend` has something to do, in monotonic s.
    """

    def __init__(self, request: PortRequest, clock: Callable[[], int], selector: BaseSelector) -> None:
        settings = request.settings
        self.name, self.index = request.name, request.index
        self.request = request
        self.counts = request.counts
        self.state = BusState(False, clock(), "not opened yet")
        self.due_s = 0.0
        self._clock = clock
        self._selector = selector
        self._port: Port | None = None
        self._descriptor = -1
        self._left: list[Frame] = []
        self._opening: BackgroundOpening | None = None
        self._waiting = TxQueue(settings.send_queue, settings.send_timeout)
        self._delay_s = settings.reopen_first
        self._next_s = 0.0
        self._stamping_s = 0.0
        self._state_log = BusStateLog(request.name)
        self._told_fd = False

    @property
    def waiting(self) -> int:
        """Frames that wait to be sent."""
        return len(self._waiting)

    def open(self, now_s: float) -> None:
        """Open the bus.

        Raises:
            BusError: it cannot be opened; says why and what to do. It is tried again in the background.
        """
        try:
            self._adopt(open_port(self.request), now_s)
        except BusError as error:
            self._state_log.logged_up = False  # the caller logs it
            self._stay_down(str(error), now_s)
            self._put_off(now_s)
            raise
        self.state = BusState(True, self._clock())

    def receive(self, limit: int, now_s: float) -> list[Frame]:
        """Return what has come, about `limit` frames at most."""
        port = self._port
        if port is None:
            return []
        try:
            frames = port.receive(limit)
        except port_errors(BusError) as error:
            self._go_down(error, now_s)
            return self._take_remaining()
        if port.controller != self.state.controller:
            self._follow(port, now_s)
        elif frames and not self.state.up:
            self._next_s = now_s  # the link may be up again: look at once
            self._plan(now_s)
        self.counts.received += len(frames)
        return as_arrived(frames) if now_s < self._stamping_s else frames

    def send(self, frames: Sequence[Frame], now_s: float) -> int:
        """Send frames as far as there is room; the others wait. Return how many went out at once."""
        if not self.state.up:
            self.counts.send_failed += len(frames)
            return 0
        self.counts.send_dropped += self._waiting.put(frames, now_s)
        return self._send_waiting(now_s)

    def tend(self, now_s: float) -> list[Frame]:
        """Do what is due: open the bus, look whether it is still there, send what waits.

        Returns:
            what a bus that is gone had received; nothing as a rule.
        """
        if self._opening is not None:
            self._look_at_opening(self._opening, now_s)
        elif now_s >= self._next_s:
            if self._port is None:
                self._opening = BackgroundOpening(self.request)
                self._next_s = now_s + _OPENING_S
            else:
                self._check(self._port, now_s)
        if self._waiting:
            self.counts.send_dropped += self._waiting.expire(now_s)
            self._send_waiting(now_s)
        frames = self._take_remaining()
        self._plan(now_s)
        return frames

    def leave(self) -> list[Frame]:
        """Close the bus; return what it had received and nobody has read."""
        if self._port is not None:
            self._left += _last_frames(self._port, _LEFT_FRAMES)
        frames = self._take_remaining()
        self.close()
        return frames

    def close(self) -> None:
        """Close the bus; what waits to be sent is dropped, and counted as what had come and nobody has read."""
        self.counts.send_dropped += self._waiting.clear()
        self.counts.unread += len(self._left)
        self._left = []
        if self._opening is not None:
            self._opening.abandon()
            self._opening = None
        self._close_port()
        self.state = BusState(False, self._clock(), "closed")

    def _adopt(self, port: Port, now_s: float) -> None:
        """Read an open port from now on."""
        self._port = port
        self._descriptor = port.fileno()
        self._selector.register(self._descriptor, EVENT_READ, self)
        self._next_s = now_s + _CHECK_S
        self._stamping_s = now_s + _STAMPING_S
        self._plan(now_s)

    def _look_at_opening(self, opening: BackgroundOpening, now_s: float) -> None:
        """Take the bus that was opened in the background, if that is over."""
        self._next_s = now_s + _OPENING_S
        if not opening.is_over():
            return
        self._opening = None
        try:
            self._adopt(opening.port(), now_s)
        except BusError as error:
            self._stay_down(str(error), now_s)
            self._put_off(now_s)
        else:
            self._come_up(now_s)

    def _check(self, port: Port, now_s: float) -> None:
        """Look whether an open bus is still there, or there again."""
        try:
            port.check()
        except port_errors() as error:
            self._go_down(error, now_s)
            return
        self._next_s = now_s + _CHECK_S
        self._follow(port, now_s)
        self._tell(now_s)
        self._tell_fd()
        if port.controller == "bus-off":
            return
        if self.state.up:
            self._delay_s = self.request.settings.reopen_first
        else:
            self._come_up(now_s)

    def _send_waiting(self, now_s: float) -> int:
        """Send what waits, as far as there is room; return how much went out."""
        port = self._port
        if port is None or not self._waiting:
            return 0
        try:
            sent = port.send(self._waiting.frames)
        except port_errors() as error:
            self._go_down(error, now_s)
            return 0
        self._waiting.remove_first(sent)
        self.counts.sent += sent
        self._plan(now_s)
        return sent

    def _plan(self, now_s: float) -> None:
        """Say when something is to be done next."""
        self.due_s = min(self._next_s, now_s + _RETRY_S) if self._waiting else self._next_s
        if self._left:
            self.due_s = now_s

    def _follow(self, port: Port, now_s: float) -> None:
        """Take over what the controller says of itself."""
        before, controller = self.state.controller, port.controller
        if controller == before:
            return
        if controller == "bus-off":
            self._stay_down(_BUS_OFF.format(channel=self.request.settings.channel), now_s)
            self.state = replace(self.state, controller=controller)
        elif before == "bus-off":
            self._come_up(now_s)
        else:
            self.state = replace(self.state, controller=controller)

    def _come_up(self, now_s: float) -> None:
        """Note that the bus is back."""
        controller = "active" if self._port is None else self._port.controller
        self.state = BusState(True, self._clock(), controller=controller)
        self.counts.reconnects += 1
        self._tell(now_s)

    def _go_down(self, error: Exception, now_s: float) -> None:
        """Note why the bus is gone; close it unless it hears itself when it is back."""
        if self._port is not None:
            self._left += _last_frames(self._port, _LAST_FRAMES)
        number = error.errno if isinstance(error, OSError) else None
        if number != errno.ENETDOWN:
            self._close_port()
        cure = _CURES.get(number or 0, "it is opened again as soon as it can be")
        self._stay_down(f"{error}: {cure.format(channel=self.request.settings.channel)}", now_s)
        self._put_off(now_s)

    def _stay_down(self, error: str, now_s: float) -> None:
        """Note why nothing can be sent or read; what waits is not sent any more."""
        self.counts.send_failed += self._waiting.clear()
        self.state = BusState(False, self._clock() if self.state.up else self.state.since_ns, error)
        self._tell(now_s)

    def _tell(self, now_s: float) -> None:
        """Let the log know whether the bus is there."""
        self._state_log.update(now_s, up=self.state.up, error=self.state.error)

    def _tell_fd(self) -> None:
        """Let the log know, once, that CAN FD frames come where none are meant to."""
        if self.counts.fd_unset and not self._told_fd:
            self._told_fd = True
            logger.warning(
                "bus '%s': CAN FD frames come and are not read; give buses.%s fd: true, and reload",
                self.name,
                self.name,
            )

    def _put_off(self, now_s: float) -> None:
        """Try again after a wait, and the next time after a longer one."""
        self._next_s = now_s + self._delay_s
        self._delay_s = min(2 * self._delay_s, self.request.settings.reopen_longest)
        self._plan(now_s)

    def _take_remaining(self) -> list[Frame]:
        """Return what a bus that is gone had received, once."""
        frames, self._left = self._left, []
        self.counts.received += len(frames)
        return frames

    def _close_port(self) -> None:
        """Close the bus if it is open; what fails then is of no use to anyone."""
        port, self._port = self._port, None
        if port is None:
            return
        self._selector.unregister(self._descriptor)
        with suppress(*port_errors()):
            port.close()


def as_arrived(frames: list[Frame]) -> list[Frame]:
    """Return frames of one bus, in the order in which they arrived, none stamped later than those behind it.

    One that is later by more than a second is left as it is: the clock was set.
    """
    stamped = frames.copy()
    for k in range(len(frames) - 2, -1, -1):
        latest_ns = stamped[k + 1].time_ns
        if latest_ns < stamped[k].time_ns < latest_ns + round(_STAMPING_S * 1e9):
            stamped[k] = stamped[k]._replace(time_ns=latest_ns)
    return stamped


def _last_frames(port: Port, limit: int) -> list[Frame]:
    """Return what a bus had received before it went: a socket reports its errors first, down and then deleted."""
    for _ in range(_ERRORS_BEFORE_FRAMES):
        with suppress(*port_errors(BusError)):
            return port.receive(limit)
    return []
