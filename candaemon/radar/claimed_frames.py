"""Frames of an identifier that several take: a value in the payload says whose each is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

from candaemon.radar.scan import Scan

FrameHandler: TypeAlias = Callable[[int, int, bytes, int], Scan | None]
"""Takes part, slot, payload and time stamp (ns) of a frame; returns the scan that it closes."""
Route: TypeAlias = tuple[FrameHandler, int, int]
"""Handler of a CAN id, and the part and slot to call it with."""
ClaimedRoute: TypeAlias = tuple[int, Callable[[bytes], int], int, Route]
"""Payload bytes needed to read a frame's value, what reads it, the value it must have, and who receives it then."""


class ClaimedFrames:
    """Hands each frame to the first that claims it.

    Args:
        claims: of all who take frames of the identifier.
        others: who receives what nobody claims; None: it is let go.

    """

    def __init__(self, claims: Sequence[ClaimedRoute], others: FrameHandler | None = None) -> None:
        self._claims, self._others = tuple(claims), others

    def receive(self, part: int, slot: int, data: bytes, time_ns: int) -> Scan | None:
        """Take a frame; part and slot are those of whoever claims it."""
        for length, read, value, (receive, its_part, its_slot) in self._claims:
            if len(data) < length or read(data) == value:  # one that is too short is counted by the first
                return receive(its_part, its_slot, data, time_ns)
        return None if self._others is None else self._others(part, slot, data, time_ns)
