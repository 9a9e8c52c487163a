"""Text from outside, such as a name in a log or a configuration, made safe to print."""

from __future__ import annotations

from typing import Final
from unicodedata import category

LONGEST_SHOWN: Final = 500
"""Longest piece of text from outside in a message, in characters."""

_BREAKING: Final = frozenset({"Cc", "Cs", "Zl", "Zp"})
"""Unicode's categories of control characters, surrogates, line and paragraph separators."""


def printable(text: str, longest: int | None = None) -> str:
    r"""Return a text in which nothing acts on a terminal or begins another line.

    Control characters, line separators, marks that change the direction of writing, and the surrogates that stand for
    bytes that are not UTF-8 become escapes such as `\x1b`, `\u2028` and `\udcff`. All else stays.

    Args:
        text: from anywhere.
        longest: cut after so many characters, which three dots show; None: never.
    """
    if longest is not None and len(text) > longest:
        text = text[:longest] + "..."
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else _escaped(each) for each in text)


def _escaped(character: str) -> str:
    """Return the escape of one character, as Python writes it."""
    return character.encode("unicode_escape").decode("ascii")


def is_one_line(text: str) -> bool:
    """Return whether a text has no control characters, line separators, or surrogates of bytes that are not UTF-8.

    Other characters that are not printable, such as a no-break space, are parts of words in some languages.
    """
    return text.isprintable() or not any(category(each) in _BREAKING for each in text)
