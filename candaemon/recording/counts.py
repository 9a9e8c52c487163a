"""What a recording did: one count of each thing, which journal, status and metrics all take from here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from threading import Lock


@dataclass(slots=True)
class RecordingCounts:
    """What a recording did since the start. Of the items that it was given, each is written, lost, or waits still.

    Attributes:
        recording: whether it takes input.
        files, bytes: of the ring.
        items: frames and ticks written.
        lost: those that were not, whatever the reason.
        pauses: times that input had to be left out.
        events: events archived.
        events_lost: events that could not be.
    """

    recording: bool = True
    files: int = 0
    bytes: int = 0
    items: int = 0
    lost: int = 0
    pauses: int = 0
    events: int = 0
    events_lost: int = 0
    _lock: Lock = field(default_factory=Lock, repr=False, compare=False)

    def lose(self, items: int) -> None:
        """Count items that are lost; the core loop and the thread that writes both do."""
        with self._lock:
            self.lost += items

    def lose_event(self) -> None:
        """Count an event that is lost; the core loop and the thread that writes both do."""
        with self._lock:
            self.events_lost += 1

    def tree(self) -> Mapping[str, int | bool]:
        """Return all by name; keys are stable."""
        return {
            "recording": self.recording,
            "files": self.files,
            "bytes": self.bytes,
            "items": self.items,
            "lost": self.lost,
            "pauses": self.pauses,
            "events": self.events,
            "events_lost": self.events_lost,
        }
