"""A whole service that drives: traffic onto its buses, and all that is seen of it from outside."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from tests.beds.service import Service

from .heard import OK, VALID, Cycle, Ears
from .telling import Telling
from .traffic import Traffic

PLACES = [(20.0 + 12.0 * number, 3.5 * (number % 3 - 1)) for number in range(4)]
"""Of the vehicles ahead: m ahead and to the left."""


class Whole(Telling):
    """A service that tracks.

    Args:
        service: the process.
        folder: of its status socket.
        traffic: what its sensors tell.
        ears: on the bus of the obstacles.
    """

    def __init__(self, service: Service, folder: Path, traffic: Traffic, ears: Ears) -> None:
        super().__init__(service, folder)
        self.traffic = traffic
        self.ears = ears

    def track(self, timeout_s: float = 60.0, count: int = len(PLACES)) -> Cycle:
        """Wait until all that is there is told and nothing is amiss; return that cycle."""

        def well(cycle: Cycle) -> bool:
            return cycle.occupied == count and cycle.health == OK and cycle.ego == VALID

        return self.ears.wait_for(well, f"{count} obstacles and no fault", timeout_s)[-1]

    def pause(self) -> dict[str, Any]:
        """Silence the traffic until `traffic.silent` is emptied; return the figures once all of it is taken."""
        self.traffic.silent.update(self.traffic.interfaces)
        return self.settled()


def steps(cycles: Sequence[Cycle], of: str) -> list[int]:
    """Return the values that an attribute takes one after another, each once as long as it stays."""
    values = [getattr(cycle, of) for cycle in cycles]
    return [value for number, value in enumerate(values) if number == 0 or value != values[number - 1]]


def longest_gap(cycles: Sequence[Cycle]) -> float:
    """Return the longest time between two cycles, s."""
    return max(b.at_s - a.at_s for a, b in pairwise(cycles))
