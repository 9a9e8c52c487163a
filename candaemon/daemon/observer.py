"""What sees the core loop: the hooks it calls, and what they may read of the daemon.

Status, recording and log depend on this and not on the daemon, which calls them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from candaemon.binding.bound import Binding
from candaemon.can_io.live_buses import LiveBuses
from candaemon.can_io.reorder import ReorderBuffer
from candaemon.frames.frame import Frame, Tick
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline


class DaemonView(Protocol):
    """What an observer may read of a running daemon, and its request to stop."""

    @property
    def binding(self) -> Binding:
        """The configuration in force."""

    @property
    def pipeline(self) -> Pipeline:
        """The pipeline, with its counts; a reload replaces it."""

    @property
    def buses(self) -> LiveBuses:
        """The buses, with their counts."""

    @property
    def sequence(self) -> ReorderBuffer:
        """The reorder buffer, with its counts of clock steps."""

    @property
    def received(self) -> int:
        """Frames read from the buses."""

    @property
    def last(self) -> Cycle | None:
        """The latest cycle; None before the first."""

    def stop(self) -> None:
        """Request the end of the core loop."""


@dataclass(frozen=True, slots=True)
class CompletedCycle:
    """A cycle whose frames were handed to the output bus.

    Attributes:
        cycle: with its obstacles and frames.
        seconds: from the frame that closed the scan being read up to the cycle's frames being handed to the bus.
        latency: s from that frame's time stamp to the first obstacle frame being handed to the bus; NaN for a cycle
            that no frame caused, or that sent none.
    """

    cycle: Cycle
    seconds: float
    latency: float


class Observer:
    """Base of all observers. Each hook runs in the core thread and must not block; one left as it is does nothing."""

    def on_start(self, daemon: DaemonView) -> None:
        """React to the start: the buses are open, the first iteration is still to come."""

    def on_items(self, items: Sequence[Frame | Tick]) -> None:
        """React to what the pipeline is about to process, in order, with the times that it will see."""

    def on_cycle(self, completed: CompletedCycle) -> None:
        """React to a cycle whose frames were handed to the bus."""

    def on_iteration(self, daemon: DaemonView) -> None:
        """React to the end of an iteration of the core loop; there are at least 100 a second."""

    def on_mark(self, daemon: DaemonView) -> None:
        """React to the user's marking this moment (SIGUSR1)."""

    def on_reload_begin(self, daemon: DaemonView) -> None:
        """React to another configuration's being loaded."""

    def on_reload_end(self, daemon: DaemonView, error: str) -> None:
        """React to the end of a reload.

        Args:
            daemon: with another pipeline and perhaps other buses than before, where the reload succeeded.
            error: why the configuration was refused; empty where it is in force.
        """

    def on_stop(self, daemon: DaemonView) -> None:
        """React to the stop: the last cycle was sent and the buses are closed; all counts but observers' are final.

        What is open must be flushed and closed within 0.5 s.
        """
