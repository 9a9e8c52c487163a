"""Rows of things that stand in line: guard rails, walls, posts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Floats
from candaemon.tracking.reflections import to_travel_axes

_FEWEST = 3  # things in a row
_LINE = 0.6  # m, how exactly they lie in line
_APART = 12.0  # m from one to the next at most


@dataclass(frozen=True, slots=True)
class StandingRow:
    """Things that stand in line.

    Attributes:
        centre: mean of their places (2,), local frame, m.
        axis: unit vector along them (2,).
        begin, end: of the row along it, from the centre, m.
    """

    centre: Floats
    axis: Floats
    begin: float
    end: float


def standing_rows(places: Floats) -> list[StandingRow]:
    """Return the rows among what stands, the fullest first; nothing is of two.

    The pairs that are next to each other tell lines; the one with most beside it, and these most in line, is a row.

    Args:
        places: of what stands (n, 2), local frame, m.
    """
    rows = []
    while len(places) >= _FEWEST:
        first, second = np.triu_indices(len(places), 1)
        axis = places[second] - places[first]
        long = np.linalg.norm(axis, axis=1)
        axis /= np.maximum(long, _LINE)[:, None]
        along, across = np.moveaxis(to_travel_axes(places - places[first, None], axis[:, None]), -1, 0)
        inside = (np.abs(across) < _LINE) & (along > -_APART) & (along < long[:, None] + _APART)
        straight = inside.sum(axis=1) - np.sqrt((across**2 * inside).sum(axis=1)) / _LINE
        best = int(np.where((long > _LINE) & (long < _APART), straight, 0.0).argmax())
        found = places[inside[best]]
        if len(found) < _FEWEST:
            break
        centre = found.mean(axis=0)
        apart = found - centre
        direction = np.linalg.eigh(apart.T @ apart)[1][:, 1]
        reach = apart @ direction
        rows.append(StandingRow(centre, direction, float(reach.min()), float(reach.max())))
        places = places[~inside[best]]
    return rows
