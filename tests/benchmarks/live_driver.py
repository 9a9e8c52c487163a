"""Sends a drive over the buses at its pace, and stamps the obstacles that come back."""

from __future__ import annotations

import socket
import struct
import time
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from types import TracebackType
from typing import Self, TypeAlias

import msgpack
from can.interfaces.udp_multicast.utils import pack_message

from candaemon.binding.bind import bind
from candaemon.can_io.python_can import to_message
from candaemon.config.load import load_config
from candaemon.simulation.scenario import EgoMotionSensors, load_scenario
from candaemon.simulation.simulate import simulate

from .live_wire import OWN_MOTION_SHARE, ROOT, SLOTS, Wire

_RADAR = 0
_SO_TIMESTAMPNS = 35  # Linux; the socket module has no name for it
_STAMP = struct.Struct("@ll")
_RECEIVE_BUFFER = 4 << 20
_ROOM_NS = 300_000
"""What came back stays in the socket's buffer while the next frame is due within this."""
_PATIENCE_S = 0.15
_LOOK_UP_NS = 1_000_000
_STALL_NS = 3_000_000
_STRETCH, _LAST = 25, 5

Span: TypeAlias = tuple[int, int]
"""Begin and end in ns of the machine's clock."""


@dataclass(frozen=True, slots=True)
class Datagram:
    """A frame on its way.

    Attributes:
        at_ns: when it is sent, from the drive's start.
        bus: index of its bus.
        closes: whether it is the last of a radar's scan.
        content: as python-can packs it.
    """

    at_ns: int
    bus: int
    closes: bool
    content: bytes


def make_drive(config: Path, rate: float, seconds: float) -> list[Datagram]:
    """Simulate 64 objects ahead of the radar and the INS of a configuration, which send `rate` frames/s together."""
    scenario = load_scenario(ROOT / "config/scenarios/dense.yaml")
    own = EgoMotionSensors(rate=rate * OWN_MOTION_SHARE)
    ego = scenario.ego.model_copy(update={"own_motion": own})
    scenario = scenario.model_copy(update={"duration": seconds, "ego": ego})
    drive, start_ns, in_scan = [], None, 0
    for frame in simulate(scenario, bind(load_config(config))).frames():
        start_ns = frame.time_ns if start_ns is None else start_ns
        in_scan += frame.bus == _RADAR
        closes = frame.bus == _RADAR and in_scan % SLOTS == 0
        drive.append(Datagram(frame.time_ns - start_ns, frame.bus, closes, pack_message(to_message(frame))))
    return drive


def undisturbed(span: Span, stalls: Sequence[Span]) -> bool:
    """Tell whether the machine ran all the time; under a hypervisor that rations it, it does not."""
    return not any(began_ns < span[1] and span[0] < ended_ns for began_ns, ended_ns in stalls)


@dataclass(slots=True)
class Played:
    """What was sent and what came back, times of the machine's clock in ns.

    Attributes:
        seconds: from the first to the last.
        closed: when each scan's last frame was sent.
        heard: obstacle frames as (time, CAN id).
        stalls: when the driver did not get to run, though it should have: begin and end.
        longest_delay: by which a frame was sent too late, s.
    """

    seconds: float = 0.0
    closed: list[int] = field(default_factory=list)
    heard: list[tuple[int, int]] = field(default_factory=list)
    stalls: list[Span] = field(default_factory=list)
    longest_delay: float = 0.0

    def answers(self) -> list[Span]:
        """Return when each scan closed and when the first obstacle frame of its cycle came."""
        cycles = list(self._cycles())
        stretches = [self.closed[k : k + _STRETCH] for k in range(0, len(self.closed) - 1, _STRETCH)]
        return [answer for closed in stretches for answer in _matched(closed, cycles[bisect_left(cycles, closed[0]) :])]

    def _cycles(self) -> Iterator[int]:
        """Yield when the first obstacle frame of each cycle came: a CAN id comes once a cycle."""
        seen = set[int]()
        for time_ns, can_id in self.heard:
            if not seen or can_id in seen:
                seen.clear()
                yield time_ns
            seen.add(can_id)


def _matched(closed: Sequence[int], cycles: Sequence[int]) -> list[Span]:
    """Match a stretch of scans with the cycles that began since the first of them closed, in order.

    A cycle that begins before the next scan has closed is of none: the obstacles coasted. Nothing is returned where the
    last ones are late by a whole scan: the daemon is behind, or left one out so that all others are matched wrongly.
    """
    answers, left = list[Span](), iter(cycles)
    for closed_ns in closed:
        began_ns = next((time_ns for time_ns in left if time_ns >= closed_ns), None)
        if began_ns is not None:
            answers.append((closed_ns, began_ns))
    period_ns = (closed[-1] - closed[0]) / max(len(closed) - 1, 1)
    return answers if min((came - it for it, came in answers[-_LAST:]), default=inf) < period_ns else []


class Driver:
    """The other side of the buses. A context manager.

    The obstacles' times are the kernel's, those of the scans are taken right before their last frame is sent: that the
    driver sleeps in between changes none.

    Args:
        wire: the buses.
        spared: CAN id on the obstacles' bus that is no obstacle.
    """

    def __init__(self, wire: Wire, spared: int | None = None) -> None:
        self._looked_ns = 0
        *self._to, obstacles = wire.addresses()
        self._spared = spared
        with ExitStack() as opened:
            self._sending = opened.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            self._hearing = opened.enter_context(_listening(*obstacles))
            self._opened = opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    def play(self, drive: Sequence[Datagram]) -> Played:
        """Send a part of a drive, the first frame at once."""
        played = Played()
        self._looked_ns = time.time_ns()
        start_ns = self._looked_ns - drive[0].at_ns
        for each in drive:
            now_ns = self._wait(start_ns + each.at_ns, played)
            self._sending.sendto(each.content, self._to[each.bus])
            if each.closes:
                played.closed.append(now_ns)
        played.seconds = (now_ns - start_ns - drive[0].at_ns) / 1e9
        return played

    def hear_the_rest(self, played: Played) -> None:
        """Wait for the last cycle."""
        end = time.monotonic() + _PATIENCE_S
        while time.monotonic() < end:
            time.sleep(0.005)
            self._hear(played)

    def _wait(self, due_ns: int, played: Played) -> int:
        """Wait until a frame is due; return when that was. Look up often enough to see the machine stand still."""
        now_ns = time.time_ns()
        while now_ns < due_ns:
            if now_ns + _ROOM_NS < due_ns:
                self._hear(played)
            time.sleep(min(max(due_ns - time.time_ns(), 0), _LOOK_UP_NS) / 1e9)
            now_ns = self._look_up(played)
        played.longest_delay = max(played.longest_delay, (now_ns - due_ns) / 1e9)
        return self._look_up(played)

    def _look_up(self, played: Played) -> int:
        """Return the time; note where the driver did not get to look for it for long."""
        now_ns = time.time_ns()
        if now_ns - self._looked_ns > _STALL_NS:
            played.stalls.append((self._looked_ns, now_ns))
        self._looked_ns = now_ns
        return now_ns

    def _hear(self, played: Played) -> None:
        """Take what came back."""
        while True:
            try:
                content, stamps, _, _ = self._hearing.recvmsg(4096, 64)
            except BlockingIOError:
                return
            seconds, nanoseconds = _STAMP.unpack(stamps[0][2])
            can_id = msgpack.unpackb(content)["arbitration_id"]
            if can_id != self._spared:
                played.heard.append((seconds * 1_000_000_000 + nanoseconds, can_id))


def _listening(group: str, port: int) -> socket.socket:
    """Return a socket that hears a bus, stamped by the kernel; reading does not wait."""
    hearing = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for option in (socket.SO_REUSEADDR, socket.SO_REUSEPORT, _SO_TIMESTAMPNS):
        hearing.setsockopt(socket.SOL_SOCKET, option, 1)
    hearing.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
    hearing.bind(("", port))
    membership = socket.inet_aton(group) + struct.pack("@I", socket.INADDR_ANY)
    hearing.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    hearing.setblocking(False)
    return hearing
