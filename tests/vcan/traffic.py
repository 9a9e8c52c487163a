"""Plays frames onto interfaces at their own pace, whatever becomes of the interfaces and of the clock meanwhile."""

from __future__ import annotations

import socket
import struct
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import count
from threading import Event, Thread
from types import TracebackType
from typing import Self

from candaemon.frames.frame import Frame

from .drives import LAP_S

_FRAME = struct.Struct("=IB3x8s")
_SOON_S = 0.001


def packed(can_id: int, data: bytes) -> bytes:
    """Return a frame as a socket takes it."""
    return _FRAME.pack(can_id, len(data), data)


class Traffic:
    """A context while which a lap is played over and over.

    Args:
        lap: frames, times in ns from its beginning.
        onto: interface by the index of the frames' bus.

    Attributes:
        interfaces: onto which it plays.
        silent: interfaces onto which nothing is sent for now.
        sent: frames that the kernel took, by interface.
        refused: those that it did not: the interface was down or gone.
    """

    def __init__(self, lap: Sequence[Frame], onto: Mapping[int, str]) -> None:
        self.interfaces = frozenset(onto.values())
        self.silent: set[str] = set()
        self.sent: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self._lap = [(each.time_ns * 1e-9, onto[each.bus], packed(each.can_id, each.data)) for each in lap]
        self._ended = Event()
        self._thread = Thread(target=self._play)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def lengths(self, interface: str) -> dict[int, int]:
        """Return the identifiers that it has for an interface, and how long their frames are."""
        frames = (_FRAME.unpack(frame) for _, name, frame in self._lap if name == interface)
        return {can_id: length for can_id, length, _ in frames}

    def _play(self) -> None:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as out:
            start_s = time.monotonic()
            for at_s, interface, frame in self._endless():
                wait_s = start_s + at_s - time.monotonic()
                if wait_s > _SOON_S and self._ended.wait(wait_s):
                    return
                if interface in self.silent:
                    continue
                try:
                    out.sendto(frame, (interface,))
                except OSError:
                    self.refused[interface] += 1
                else:
                    self.sent[interface] += 1

    def _endless(self) -> Iterator[tuple[float, str, bytes]]:
        for number in count():
            if self._ended.is_set():
                return
            for at_s, interface, frame in self._lap:
                yield number * LAP_S + at_s, interface, frame
