"""The numbers of obstacles."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Identities:
    """Gives each obstacle a number that no other one has: 1, 2, 3 and so on.

    Attributes:
        given: the latest one; 0 before the first.
    """

    given: int = 0

    def new(self) -> int:
        """Return the number of a new obstacle."""
        self.given += 1
        return self.given
