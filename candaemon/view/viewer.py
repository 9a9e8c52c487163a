"""The conversation with one browser over its WebSocket.

The page is told `setup` once, then `pictures` as they are due and `health` once a second. It says what it wants as
`{"do": …}`, and confirms each numbered message by `{"do": "shown", "n": …}`: no more than `MOST_UNCONFIRMED` are on
their way, so that neither side holds more than those for a browser that is slow. One that confirms nothing is dropped.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

from aiohttp import WSCloseCode, WSMsgType, web

from candaemon.view.picture_store import PictureStore
from candaemon.view.player import Player

MOST_UNCONFIRMED: Final = 2
"""Messages to a browser that it has not confirmed yet; until then it gets no more."""
CONFIRM_S: Final = 10.0
"""s within which a browser confirms a message, or is dropped."""
LONGEST_COMMAND: Final = 1 << 10
"""Bytes of a message from a browser."""
MOST_COMMANDS: Final = 200
"""Messages from a browser in a second; one that sends more is dropped."""

_PACE_S: Final = 1 / 40
_HEALTH_S: Final = 1.0
_FARTHEST: Final = 1e12


@dataclass(slots=True)
class Show:
    """What is shown, to all browsers alike.

    Attributes:
        store: the pictures.
        stage: what does not change: sensors, names.
        live: whether it is of live buses.
        title: what it is of: a log's name, the buses.
        session: of this process: a page that sees another one begins afresh.
        speed: multiple of real time to begin with.
        status: the running service's figures, None where there is no service.
        problem: why no more pictures come; empty where they do.
    """

    store: PictureStore
    stage: dict[str, Any]
    live: bool
    title: str
    session: str
    speed: float = 1.0
    status: dict[str, Any] | None = None
    problem: str = ""


@dataclass(slots=True)
class ViewCounts:
    """What the server refused, and whom it dropped.

    Attributes:
        refused: requests by wrong token, host or origin, or to what is not there.
        crowded: connections and browsers beyond the limits.
        stalled: connections that asked for nothing in time.
        unread: browsers that confirmed nothing.
        misused: browsers that said what no page says.
    """

    refused: int = 0
    crowded: int = 0
    stalled: int = 0
    unread: int = 0
    misused: int = 0


class MisuseError(ValueError):
    """A message that no page sends."""


@dataclass(slots=True)
class _Sent:
    """The messages on their way.

    Attributes:
        number: of the latest.
        confirmed: of the latest that the browser confirmed.
        since_s: since when the oldest has been waited for.
    """

    number: int = 0
    confirmed: int = 0
    since_s: float = 0.0

    @property
    def waiting(self) -> int:
        """How many are not confirmed."""
        return self.number - self.confirmed


class Viewer:
    """One browser.

    Args:
        socket: its WebSocket.
        show: what it sees.
        counts: of the server.
        hang_up: ends the connection without a word.
        clock: monotonic s.
    """

    def __init__(
        self,
        socket: web.WebSocketResponse,
        show: Show,
        counts: ViewCounts,
        hang_up: Callable[[], None],
        clock: Callable[[], float],
    ) -> None:
        self._socket, self._show, self._counts = socket, show, counts
        self._hang_up, self._clock = hang_up, clock
        self.player = Player(show.store, follows=show.live, speed=show.speed)
        self._sent = _Sent()
        self._told: dict[str, Any] = {}
        self._second, self._commands = 0.0, 0
        self._asked = asyncio.Event()

    async def converse(self) -> None:
        """Talk with the browser until it leaves or is dropped."""
        show = self._show
        setup = {"type": "setup", "live": show.live, "title": show.title, "session": show.session, **show.stage}
        await self._socket.send_str(json.dumps(setup))
        telling = asyncio.create_task(self._tell())
        try:
            async for message in self._socket:
                self._limit()
                self.take(message.data if message.type is WSMsgType.TEXT else "")
                self._asked.set()
        except MisuseError as error:
            self._counts.misused += 1
            await self._socket.close(code=WSCloseCode.POLICY_VIOLATION, message=str(error).encode()[:100])
        finally:
            telling.cancel()
            with suppress(asyncio.CancelledError, ConnectionError):
                await telling

    def take(self, text: str) -> None:
        """Do what the browser asks for.

        Raises:
            MisuseError: no page asks for that.
        """
        try:
            command = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise MisuseError("expected JSON") from error
        match command:
            case {"do": "shown", "n": int(number)} if self._sent.confirmed <= number <= self._sent.number:
                self._sent.confirmed, self._sent.since_s = number, self._clock()
            case {"do": "play"}:
                self.player.play()
            case {"do": "pause"}:
                self.player.pause()
            case {"do": "follow"}:
                self.player.follow()
            case {"do": "seek", "t": int() | float() as time_s} if _in_range(time_s):
                self.player.seek(float(time_s))
            case {"do": "step", "by": int(pictures)} if abs(pictures) <= _FARTHEST:
                self.player.step(pictures)
            case {"do": "speed", "value": int() | float() as speed} if _in_range(speed):
                self.player.set_speed(float(speed))
            case _:
                raise MisuseError("unknown command")

    def _limit(self) -> None:
        """Count a message.

        Raises:
            MisuseError: there were too many within a second.
        """
        now_s = self._clock()
        if now_s - self._second >= 1.0:
            self._second, self._commands = now_s, 0
        self._commands += 1
        if self._commands > MOST_COMMANDS:
            raise MisuseError("too many messages")

    async def _tell(self) -> None:
        """Send what is due until the browser is gone; drop one that confirms nothing."""
        health_s = 0.0
        while not self._socket.closed:
            now_s = self._clock()
            if self._sent.waiting >= MOST_UNCONFIRMED:
                if now_s - self._sent.since_s > CONFIRM_S:
                    self._drop()
                    return
            elif now_s - health_s >= _HEALTH_S:
                health_s = now_s
                if not await self._send({"type": "health", "status": self._show.status}, ()):
                    return
            elif (due := self.player.due(now_s)) is not None:
                about = {"type": "pictures", "at": round(due.at_s, 4), "afresh": due.afresh, "dropped": due.dropped}
                if not await self._send(about, due.pictures):
                    return
            elif self._told != self._state() and not await self._send({"type": "state"}, ()):
                return
            with suppress(TimeoutError):
                await asyncio.wait_for(self._asked.wait(), _PACE_S)
            self._asked.clear()

    def _state(self) -> dict[str, Any]:
        """Return what the controls of the page show."""
        extent = self._show.store.extent()
        return {
            **self.player.state,
            "first": extent.first_s,
            "last": extent.last_s,
            "complete": extent.complete,
            "cut": extent.cut,
            "problem": self._show.problem,
        }

    async def _send(self, about: dict[str, Any], pictures: list[bytes] | tuple[()]) -> bool:
        """Send a numbered message; return whether the browser is still there."""
        sent, self._told = self._sent, self._state()
        if not sent.waiting:
            sent.since_s = self._clock()
        sent.number += 1
        head = json.dumps({**about, "n": sent.number, "state": self._told}, separators=(",", ":"), allow_nan=False)
        text = head if not pictures else f'{head[:-1]},"pictures":[{b",".join(pictures).decode()}]}}'
        try:
            await asyncio.wait_for(self._socket.send_str(text), CONFIRM_S)
        except TimeoutError:
            self._drop()
        except ConnectionError:
            return False
        return not self._socket.closed

    def _drop(self) -> None:
        """Hang up on a browser that does not read."""
        self._counts.unread += 1
        self._hang_up()


def _in_range(value: float) -> bool:
    """Return whether a number from a browser can be meant."""
    return abs(value) <= _FARTHEST  # so NaN is not
