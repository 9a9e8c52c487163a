"""Rows of arrays: which there are, and dataclasses of arrays that share them, one row a track in each."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import fields
from typing import TypeVar

import numpy as np

from candaemon.arrays import Integers

StateT = TypeVar("StateT")


def distinct(rows: Integers) -> Integers:
    """Return rows (n,) in ascending order, each once (m,).

    So does `np.unique`; but it imports numpy's masked arrays the first time: 10 ms in the middle of a drive.
    """
    found = np.sort(rows)
    first = np.ones(len(found), dtype=np.bool_)
    np.not_equal(found[1:], found[:-1], out=first[1:])
    return found[first]


def checked_state(state: object, empty: StateT, *, except_for: Collection[str] = ()) -> StateT:
    """Return a state after checking that its class, array types and shapes are those expected.

    Args:
        state: a dataclass of arrays with one row a track.
        empty: one of the expected class without rows; its arrays give the types and the other dimensions.
        except_for: names of the arrays that do not have one row a track; only their types are checked.

    Raises:
        ValueError: it is of another class, an array is of another type or shape, or the numbers of rows differ.
    """
    kind = type(empty)
    if type(state) is not kind or not isinstance(state, kind):
        raise ValueError(f"found a {type(state).__name__}, expected a {kind.__name__}")
    rows = None
    for field in fields(empty):  # type: ignore[arg-type]  # every state is a dataclass
        found, expected = getattr(state, field.name), getattr(empty, field.name)
        if not isinstance(expected, np.ndarray):
            continue
        name = f"{kind.__name__}.{field.name}"
        if not isinstance(found, np.ndarray) or found.dtype != expected.dtype or found.ndim != expected.ndim:
            raise ValueError(f"{name} is no array of {expected.dtype} with {expected.ndim} dimensions")
        if field.name in except_for:
            continue
        if found.shape[1:] != expected.shape[1:] or (rows is not None and len(found) != rows):
            raise ValueError(f"{name} has the shape {found.shape}, which does not fit")
        rows = len(found)
    return state
