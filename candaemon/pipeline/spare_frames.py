"""Frames of messages that a DBC knows and nothing asks for: they are counted."""

from __future__ import annotations

from candaemon.pipeline.cycle import BusCounts


class SpareFrames:
    """Counts the frames of one message.

    Args:
        length: of the message, bytes.
        counts: of its bus; the owner's.
    """

    def __init__(self, length: int, counts: BusCounts) -> None:
        self._length, self._counts = length, counts

    def receive(self, _part: int, _slot: int, data: bytes, _time_ns: int) -> None:
        """Count a frame."""
        self._counts.spare += 1
        self._counts.spare_short += len(data) < self._length
