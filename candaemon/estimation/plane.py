"""From an axis to the plane: the matrices of two axes spread over the state of a track.

The plane's matrix is M = Mₗ ⊗ A + Mₜ ⊗ (I − A) with A = d dᵀ of the direction d, along which Mₗ holds and across which
Mₜ does.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from candaemon.arrays import Floats


class _Places(NamedTuple):
    """Where an axis with so many states has its rows and columns in the plane's state, for x and for y."""

    x_rows: Any
    x_columns: Any
    y_rows: Any
    y_columns: Any


X, Y, _X_JERK, _Y_JERK = slice(0, 6, 2), slice(1, 6, 2), np.array((0, 2, 4, 7)), np.array((1, 3, 5, 8))
_PLACES = {3: _Places(X, X, Y, Y), 4: _Places(_X_JERK[:, None], _X_JERK, _Y_JERK[:, None], _Y_JERK)}


def directed(along: Floats, across: Floats, direction: Floats, width: int) -> Floats:
    """Spread two S × S axis matrices over the plane, (n or 1, width, width).

    Args:
        along: matrix of the axis along the direction.
        across: matrix of the axis to its left.
        direction: unit vector in the level frame, (n, 2).
        width: of the plane's state.
    """
    if along is across or not (along != across).any():
        return isotropic(along, width)[None]
    at, along, across = _PLACES[len(along)], _fitting(along, width), _fitting(across, width)
    difference = along - across
    cosine, sine = direction[:, 0, None, None], direction[:, 1, None, None]
    mixed = difference * (cosine * sine)
    out = np.zeros((len(direction), width, width))
    out[:, at.x_rows, at.x_columns] = across + difference * (cosine * cosine)
    out[:, at.y_rows, at.y_columns] = across + difference * (sine * sine)
    out[:, at.x_rows, at.y_columns] = mixed
    out[:, at.y_rows, at.x_columns] = mixed
    return out


def isotropic(axis: Floats, width: int) -> Floats:
    """Give x and y the same S × S matrix, (width, width)."""
    at, axis = _PLACES[len(axis)], _fitting(axis, width)
    full = np.zeros((width, width))
    full[at.x_rows, at.x_columns] = axis
    full[at.y_rows, at.y_columns] = axis
    return full


def _fitting(axis: Floats, width: int) -> Floats:
    """Cut an axis to the states that a plane of this width has: a filter of velocities alone has no acceleration."""
    return axis[: width // 2, : width // 2]
