"""Text from outside, such as a name in a log or a configuration, made safe to print."""

from __future__ import annotations

from typing import Final

LONGEST_SHOWN: Final = 500
"""Longest piece of text from outside in a message, in characters."""


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
