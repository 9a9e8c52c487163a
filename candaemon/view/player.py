"""What one browser sees next: plays a store at a pace of its own, with pause, speed and seek."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import Any, Final

from candaemon.view.picture_store import PictureStore

HISTORY_S: Final = 20.0
"""s before an instant that a browser gets with it: trails and plots reach as far back."""
MOST_PICTURES: Final = 40
"""Pictures of one message while it plays; where more are due, the oldest of them are left out and counted."""
SLOWEST_PLAY: Final = 0.05
"""Least multiple of real time."""
FASTEST_PLAY: Final = 50.0
"""Largest multiple of real time."""
MOST_HISTORY: Final = 2000
"""Pictures of one message after a seek: all of 20 s of 100 cycles/s; of more, the newest half and some of the older."""
LONGEST_GAP_S: Final = 5.0
"""s without a picture that are played; a longer gap is passed over."""


@dataclass(frozen=True, slots=True)
class Due:
    """Pictures that are due.

    Attributes:
        at_s: the instant that is shown, s.
        pictures: the last is the one to draw.
        afresh: whether they replace all that were sent before.
        dropped: how many were left out before them.
    """

    at_s: float
    pictures: list[bytes]
    afresh: bool
    dropped: int


class Player:
    """Plays a store to one browser.

    Args:
        store: what it plays.
        follows: whether it shows the newest picture as soon as it is there, until it is told otherwise.
        speed: multiple of real time to begin with.

    Attributes:
        playing: whether time goes on.
        follows: whether it shows the newest.
        speed: multiple of real time.
        dropped: pictures left out so far.
    """

    def __init__(self, store: PictureStore, *, follows: bool, speed: float = 1.0) -> None:
        self._store = store
        self.playing, self.follows, self.speed, self.dropped = True, follows, speed, 0
        self._at_s: float | None = None
        self._now_s: float | None = None
        self._next = 0
        self._afresh = True
        self._stepped: int | None = None  # number after the picture that was stepped to: several may be of one time

    @property
    def state(self) -> dict[str, Any]:
        """What its controls show."""
        return {"playing": self.playing, "follows": self.follows, "speed": self.speed}

    def play(self) -> None:
        """Let time go on; from the beginning where it has ended."""
        extent = self._store.extent()
        ended = extent.complete and self._at_s is not None and self._at_s >= extent.last_s
        if ended and not self.playing:
            self.seek(extent.first_s)
        self.playing, self._stepped = True, None

    def pause(self) -> None:
        """Stop where it is."""
        self.playing = self.follows = False

    def set_speed(self, speed: float) -> None:
        """Play so many times as fast as it was, within the limits."""
        self.speed = min(max(speed, SLOWEST_PLAY), FASTEST_PLAY)

    def seek(self, time_s: float) -> None:
        """Go to an instant, or the nearest there is."""
        extent = self._store.extent()
        self._at_s = min(max(time_s, extent.first_s), extent.last_s)
        self.follows, self._afresh, self._stepped = False, True, None

    def follow(self) -> None:
        """Show the newest from here on."""
        self.playing = self.follows = self._afresh = True
        self._stepped = None

    def step(self, pictures: int) -> None:
        """Pause, and go on or back by so many pictures."""
        extent = self._store.extent()
        if self._at_s is not None and extent.after > extent.first:
            shown = (self._stepped or self._store.number_at(self._at_s)) - 1
            number = min(max(shown + pictures, extent.first), extent.after - 1)
            self.seek(self._store.time_of(number))
            self._stepped = number + 1
        self.pause()

    def due(self, now_s: float) -> Due | None:
        """Return what is to be sent; None where nothing is.

        Args:
            now_s: monotonic s; what passed since the last call is how far time goes on.
        """
        extent = self._store.extent()
        passed_s = 0.0 if self._now_s is None else now_s - self._now_s
        self._now_s = now_s
        if extent.after == extent.first:
            return None
        if self.follows:
            self._at_s = extent.last_s
        elif self._at_s is None:
            self._at_s = extent.first_s
        elif self.playing:
            self._at_s = self._beyond_gap(self._at_s + passed_s * self.speed)
            if self._at_s >= extent.last_s:
                self._at_s = extent.last_s
                self.playing = not extent.complete
        if self._at_s < extent.first_s:  # has been forgotten meanwhile
            self._at_s, self._afresh, self._stepped = extent.first_s, True, None
        after = self._stepped or self._store.number_at(self._at_s)
        if self._afresh:
            return self._whole(after)
        return self._further(after) if after > self._next else None

    def _beyond_gap(self, time_s: float) -> float:
        """Return a time, or that of the next picture where none comes for long."""
        coming = self._store.number_at(time_s)
        next_s = self._store.time_of(coming)  # of the last one, where no other comes
        if next_s - time_s <= LONGEST_GAP_S:
            return time_s
        self._afresh = True
        return next_s

    def _whole(self, after: int) -> Due:
        """Return the pictures that lead to an instant; the last one before it is one of them, however old it is."""
        assert self._at_s is not None  # noqa: S101 - set by the caller
        first = min(self._store.number_at(self._at_s - HISTORY_S), after - 1)
        self._next, self._afresh = after, False
        return Due(self._at_s, self._history(first, after), afresh=True, dropped=0)

    def _history(self, first: int, after: int) -> list[bytes]:
        """Return the pictures of these numbers; where they are too many, the newest and, of all older, some."""
        if after - first <= MOST_HISTORY:
            return self._store.read(first, after)
        half = MOST_HISTORY // 2
        others = after - half - first
        numbers = (first + k * others // half for k in range(half))
        spread = chain.from_iterable(self._store.read(number, number + 1) for number in numbers)
        return [*spread, *self._store.read(after - half, after)]

    def _further(self, after: int) -> Due:
        """Return the pictures since the last ones, no more than a message holds."""
        assert self._at_s is not None  # noqa: S101 - set by the caller
        first = max(self._next, after - MOST_PICTURES)
        dropped = first - self._next
        self.dropped += dropped
        self._next = after
        return Due(self._at_s, self._store.read(first, after), afresh=False, dropped=dropped)
