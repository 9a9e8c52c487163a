"""Payloads of many frames side by side, made into one tuple a frame only where somebody asks for them one by one."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from struct import Struct
from typing import TypeAlias, overload

from candaemon.arrays import Bytes, Integers

Payloads: TypeAlias = list[tuple[int, bytes]]
"""CAN id and payload of frames."""


@dataclass(slots=True)  # made each cycle
class PayloadTable:
    """n frames whose payloads have the same length.

    Attributes:
        can_id: (n,).
        payload: (n, length).
    """

    can_id: Integers
    payload: Bytes

    def __len__(self) -> int:
        return len(self.can_id)

    def rows(self, begin: int, end: int) -> PayloadTable:
        """Return some of the frames."""
        return PayloadTable(self.can_id[begin:end], self.payload[begin:end])

    def listed(self) -> Payloads:
        """Return CAN id and payload of each."""
        split = _splitter(*self.payload.shape).unpack(self.payload.tobytes())
        return list(zip(self.can_id.tolist(), split, strict=True))


class TabledPayloads(Sequence[tuple[int, bytes]]):
    """CAN id and payload of frames, of which most lie in tables."""

    __slots__ = ("_listed",)

    def __init__(self) -> None:
        self._listed: Payloads | None = None

    @property
    @abstractmethod
    def first(self) -> Payloads:
        """Frames before those of the tables."""

    @property
    @abstractmethod
    def tables(self) -> Sequence[PayloadTable]:
        """The other frames, in their order."""

    @overload
    def __getitem__(self, index: int) -> tuple[int, bytes]: ...

    @overload
    def __getitem__(self, index: slice) -> Payloads: ...

    def __getitem__(self, index: int | slice) -> tuple[int, bytes] | Payloads:
        return self._all()[index]

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        return iter(self._all())

    def _all(self) -> Payloads:
        if self._listed is None:
            self._listed = [*self.first, *(frame for table in self.tables for frame in table.listed())]
        return self._listed


@lru_cache
def _splitter(count: int, length: int) -> Struct:
    """Return what splits so many joined payloads in one call."""
    return Struct(f"{length}s" * count)
