"""What can be hung onto the core loop: recording, metrics, status, supervision."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from candaemon.bus.frame import Frame, Tick
from candaemon.cycle import Cycle

if TYPE_CHECKING:
    from candaemon.service.daemon import Daemon


@dataclass(frozen=True, slots=True)
class Told:
    """A cycle that was told.

    Attributes:
        cycle: with its obstacles and frames.
        seconds: from the frame that closed the scan being taken up to the cycle's frames being handed to the bus.
        latency: s from that frame's time stamp to the first obstacle frame being handed to the bus; NaN for a cycle
            that no frame brought, or that sent none.
    """

    cycle: Cycle
    seconds: float
    latency: float


class Observer:
    """Sees what the core loop does, in its thread: no method may wait. What it does not override costs a call."""

    def started(self, daemon: Daemon) -> None:
        """Look at a daemon whose buses are open, before its first turn."""

    def took(self, items: Sequence[Frame | Tick]) -> None:
        """Look at what the pipeline is about to take, in order, with the times that it will see."""

    def told(self, told: Told) -> None:
        """Look at a cycle whose frames were handed to the bus."""

    def turned(self, daemon: Daemon) -> None:
        """Look at the daemon after a turn of the loop, some 100 times a second at least."""

    def marked(self, daemon: Daemon) -> None:
        """Hear that the user marked this moment (SIGUSR1)."""

    def reloading(self, daemon: Daemon) -> None:
        """Hear that another configuration is being loaded."""

    def reloaded(self, daemon: Daemon, error: str) -> None:
        """Hear that a configuration took its place (`error` is empty), or was refused and why.

        What the daemon holds, its pipeline among it, may be others than before.
        """

    def stopped(self, daemon: Daemon) -> None:
        """Hear that the last cycle was sent; what is open must be flushed and closed within 0.5 s."""
