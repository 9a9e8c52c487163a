"""Transmit queue of a bus that accepts no more frames: newer frames replace older ones, and each wait is bounded."""

from __future__ import annotations

from collections.abc import Sequence

from candaemon.frames.frame import Frame


class TxQueue:
    """Frames on their way to a bus, in the order in which they shall go out; bounded in number and in time.

    The newest state wins: where frames come, those of the same identifiers that still wait are dropped. The others keep
    their place before them, as an obstacle's last word must not be lost.

    Args:
        capacity: frames that wait at most.
        timeout_s: s that a frame waits at most.
    """

    def __init__(self, capacity: int, timeout_s: float) -> None:
        self._capacity = capacity
        self._timeout_s = timeout_s
        self._frames: list[Frame] = []
        self._until_s: list[float] = []

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def frames(self) -> Sequence[Frame]:
        """What waits, the next first."""
        return self._frames

    def put(self, frames: Sequence[Frame], now_s: float) -> int:
        """Append frames; return how many were dropped for them.

        Args:
            frames: newest state.
            now_s: monotonic s.
        """
        before = len(self._frames)
        if before:
            newer = {frame.can_id for frame in frames}
            self._keep([k for k, frame in enumerate(self._frames) if frame.can_id not in newer])
        self._frames += frames
        self._until_s += [now_s + self._timeout_s] * len(frames)
        excess = max(len(self._frames) - self._capacity, 0)
        self.remove_first(excess)
        return before + len(frames) - len(self._frames)

    def remove_first(self, number: int) -> None:
        """Remove the first frames: they were sent, or are dropped."""
        del self._frames[:number], self._until_s[:number]

    def expire(self, now_s: float) -> int:
        """Drop the frames that have waited too long; return how many.

        Args:
            now_s: monotonic s.
        """
        kept = [k for k, until_s in enumerate(self._until_s) if until_s > now_s]
        dropped = len(self._frames) - len(kept)
        self._keep(kept)
        return dropped

    def clear(self) -> int:
        """Drop all; return how many."""
        dropped = len(self._frames)
        self.remove_first(dropped)
        return dropped

    def _keep(self, places: list[int]) -> None:
        """Drop all but the frames at some places."""
        self._frames = [self._frames[k] for k in places]
        self._until_s = [self._until_s[k] for k in places]
