"""Where the identities of obstacles come from."""

from __future__ import annotations

from typing import Self


class Identities:
    """Gives each obstacle a number that no other one has: 1, 2, 3 and so on.

    Attributes:
        given: the last one; 0 before the first.
    """

    __slots__ = ("given",)

    def __init__(self) -> None:
        self.given = 0

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> int:
        self.given += 1
        return self.given
