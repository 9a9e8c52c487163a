"""Which known name a mistyped one may stand for, and lists of names short enough to read."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import Final

MOST_COMPARED: Final = 100
"""Most known names that a mistyped one is compared with: those nearest in length."""
LONGEST_COMPARED: Final = 64
"""Longest name that is compared, characters."""
MOST_LISTED: Final = 30
"""Most names in a message."""


def similar_names(name: str, known: Sequence[str], count: int = 1) -> list[str]:
    """Return the known names that a mistyped one is near to, the nearest first; upper and lower case are the same.

    The one name of which it is a whole part is the nearest: `rate` stands for `range_rate` rather than for `range`.

    Args:
        name: the mistyped one.
        known: from which to choose.
        count: most names.
    """
    from difflib import get_close_matches  # noqa: PLC0415  # only what is wrong needs it

    if len(name) > LONGEST_COMPARED:
        return []
    likely = known if len(known) <= MOST_COMPARED else sorted(known, key=lambda each: abs(len(each) - len(name)))
    folded = {each.casefold(): each for each in islice(likely, MOST_COMPARED) if len(each) <= LONGEST_COMPARED}
    mistyped = name.casefold()
    near = get_close_matches(mistyped, folded, n=count)
    whole = [each for each in folded if mistyped in each.split("_")]
    if len(whole) == 1:
        near = list(dict.fromkeys([*whole, *near]))[:count]
    return [folded[each] for each in near]


def meant(name: str, known: Sequence[str]) -> str:
    """Return a suggestion of the nearest known name, to follow a message; empty where none is near."""
    near = similar_names(name, known)
    return f"; did you mean '{near[0]}'?" if near else ""


def listed_names(names: Sequence[str]) -> str:
    """Return names with commas between, and how many more there are."""
    shown = ", ".join(names[:MOST_LISTED])
    return shown if len(names) <= MOST_LISTED else f"{shown} and {len(names) - MOST_LISTED:,} more"
