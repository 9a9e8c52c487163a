"""Turns a fuzzer's bytes into choices; when they run out, every further choice is the first."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


class Drawn:
    """Choices from bytes.

    Args:
        data: of the fuzzer.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def __bool__(self) -> bool:
        """Tell whether bytes are left."""
        return self._at < len(self._data)

    def taken(self, count: int) -> bytes:
        """Return the next bytes, fewer at the end."""
        piece = self._data[self._at : self._at + count]
        self._at += count
        return piece

    def rest(self) -> bytes:
        """Return all that is left."""
        return self.taken(len(self._data))

    def integer(self, low: int, high: int) -> int:
        """Choose from low to high, both included."""
        span = high - low + 1
        size = ((span - 1).bit_length() + 7) // 8
        return low + int.from_bytes(self.taken(size), "little") % span

    def choice(self, items: Sequence[T]) -> T:
        """Choose one of several."""
        return items[self.integer(0, len(items) - 1)]

    def flag(self) -> bool:
        """Choose yes or no."""
        return self.integer(0, 1) == 1

    def number(self) -> float:
        """Choose any double, infinities and a NaN among them."""
        value: float = struct.unpack("<d", self.taken(8).ljust(8, b"\0"))[0]
        return math.nan if math.isnan(value) else value  # no arithmetic gives a signalling one

    def edited(self, text: bytes, words: Sequence[bytes]) -> bytes:
        """Change a text in some places: bytes taken out, put in, doubled, or swapped for a word of its language.

        Args:
            text: what is sound.
            words: of the language, and odd values.
        """
        for _ in range(self.integer(0, 8)):
            at = self.integer(0, len(text))
            kind = self.integer(0, 4)
            size = self.integer(0, 40)
            match kind:
                case 0:
                    text = text[:at] + text[at + size :]
                case 1:
                    text = text[:at] + self.taken(size) + text[at:]
                case 2:
                    text = text[:at] + text[at : at + size] + text[at:]
                case 3:
                    text = text[:at] + self.choice(words) + text[at:]
                case _:
                    word_ends = next((k for k in range(at, len(text)) if text[k : k + 1] in b" \n,:]})|"), len(text))
                    text = text[:at] + self.choice(words) + text[word_ends:]
        return text
