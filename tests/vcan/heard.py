"""What another control unit hears of the obstacles."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from types import TracebackType
from typing import NamedTuple, Self

from candaemon.dbc.database import load_database
from candaemon.dbc.single_codec import Decoder, compile_decoder
from tests.support.paths import ROOT

EMPTY, TENTATIVE, CONFIRMED, COASTING = range(4)
"""States of a slot."""
OK, DEGRADED, SENSOR_LOST, FAULT = range(4)
"""Health of the whole."""
LOST, DEAD_RECKONING, VALID = range(3)
"""Own motion."""

_STATUS_ID, _FIRST_ID, _SLOTS = 0x652, 0x653, 32
_FRAME = struct.Struct("=IB3x8s")
_BUFFER = 1 << 20


class Obstacle(NamedTuple):
    """An occupied slot: position in m ahead and to the left, speed in m/s."""

    number: int
    state: int
    x: float
    y: float
    vx: float


@dataclass(slots=True)
class Cycle:
    """A cycle as it was heard.

    Attributes:
        at_s: monotonic s at which its status came.
        count: of the cycle, modulo 256.
        occupied: slots that hold an obstacle.
        health: of the whole.
        ego: how far own motion is known.
        drops: frames not used so far, modulo 65536.
        obstacles: those heard, by slot.
    """

    at_s: float
    count: int
    occupied: int
    health: int
    ego: int
    drops: int
    obstacles: dict[int, Obstacle] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """Whether every occupied slot was heard."""
        return len(self.obstacles) == self.occupied

    @property
    def identities(self) -> set[tuple[int, int]]:
        """Slots and the identities in them."""
        return {(slot, each.number) for slot, each in self.obstacles.items()}


class Ears:
    """Hears the status and the first message of each slot, on whatever interface they come. A context manager."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        wanted = [struct.pack("=II", can_id, 0x7FF) for can_id in range(_STATUS_ID, _FIRST_ID + _SLOTS)]
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"".join(wanted))
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        self._socket.bind(("",))  # all, so that it outlives each of them

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._socket.close()

    def hear(self, seconds: float) -> list[Cycle]:
        """Return the cycles that come within some time; the first may have begun before, and the last go on."""
        end_s = time.monotonic() + seconds
        return list(self._cycles(end_s))

    def wait_for(self, condition: Callable[[Cycle], bool], expected: str, timeout_s: float = 60.0) -> list[Cycle]:
        """Return the cycles up to the first whole one for which a condition holds."""
        end_s = time.monotonic() + timeout_s
        heard: list[Cycle] = []
        for cycle in self._cycles(end_s):
            if heard and heard[-1].whole and condition(heard[-1]):
                return heard
            heard.append(cycle)
        raise AssertionError(f"not within {timeout_s:g} s: {expected}; heard {len(heard)} cycles, last {heard[-2:]}")

    def _cycles(self, end_s: float) -> Iterator[Cycle]:
        """Yield cycles as their status comes; their obstacles follow. What has waited in the socket is passed over."""
        status, slot = _decoders()
        self._drain()
        cycle: Cycle | None = None
        while (left_s := end_s - time.monotonic()) > 0.0:
            self._socket.settimeout(left_s)
            try:
                can_id, length, data = _FRAME.unpack(self._socket.recv(_FRAME.size))
            except TimeoutError:
                return
            values = (status if can_id == _STATUS_ID else slot)(data[:length])
            assert values is not None, f"{can_id:X} came with {length} bytes"
            if can_id == _STATUS_ID:
                count, occupied, health, ego, drops = map(int, values)
                cycle = Cycle(time.monotonic(), count, occupied, health, ego, drops)
                yield cycle
            elif cycle is not None and values[1] != EMPTY:
                number, state, x, y, vx = values
                cycle.obstacles[can_id - _FIRST_ID] = Obstacle(int(number), int(state), x, y, vx)

    def _drain(self) -> None:
        self._socket.setblocking(False)
        try:
            while True:
                self._socket.recv(_FRAME.size)
        except BlockingIOError:
            return


@cache
def _decoders() -> tuple[Decoder, Decoder]:
    """Return those of the status, and of a slot's first message."""
    database = load_database(ROOT / "dbc" / "obstacles.dbc")
    return (
        compile_decoder(database.message("OBSTACLE_STATUS"), ["Cycle", "Occupied", "Health", "Ego", "Drops"]),
        compile_decoder(database.message("OBSTACLE_00_A"), ["Id", "State", "X", "Y", "Vx"]),
    )
