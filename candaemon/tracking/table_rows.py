"""What holds of the tables of reflections and of their obstacles, whatever else their columns tell."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from candaemon.arrays import Indices, Integers
from candaemon.config.tracker import MOST_TRACKS


def check_rows(owner: Indices | Integers, leader: Indices | Integers, ids: Integers, rows: Collection[int]) -> None:
    """Check that reflections (n,) and obstacles (k,) refer to rows that are there.

    Args:
        owner: row of each reflection's obstacle (n,).
        leader: row of each obstacle's leading reflection (k,).
        ids: the obstacles' identities (k,).
        rows: of the reflections that object ids of sensors stand for.

    Raises:
        ValueError: they do not, or there are too many.
    """
    n, k = len(owner), len(leader)
    if n > MOST_TRACKS:
        raise ValueError(f"found {n} reflections, expected {MOST_TRACKS} at most")
    if ((owner < 0) | (owner >= k)).any() or ((leader < 0) | (leader >= n)).any():
        raise ValueError("a reflection has no obstacle, or an obstacle no leading reflection")
    if (ids <= 0).any() or len(np.unique(ids)) < k:
        raise ValueError("two obstacles have the same number, or one has none")
    if (owner[leader] != np.arange(k)).any():
        raise ValueError("an obstacle is led by another one's reflection")
    if any(not 0 <= row < n for row in rows):
        raise ValueError("a sensor's object id stands for no reflection")


def renumbered_ids(row_of: Mapping[tuple[int, int], int], sensors: Mapping[int, int]) -> dict[tuple[int, int], int]:
    """Return what object ids stand for, by the sensor's number from here on, without those of sensors left out.

    Args:
        row_of: row that an object id stands for, by the sensor's number and the id.
        sensors: number of a sensor from here on, by the number it had.
    """
    return {(sensors[of], key): row for (of, key), row in row_of.items() if of in sensors}


def renumbered(of: Integers, sensors: Mapping[int, int]) -> Integers:
    """Return numbers of sensors (n,) as they are from here on, −1 of those left out; `sensors` as above."""
    return np.array([sensors.get(each, -1) for each in of.tolist()], dtype=np.int64)


def renumbered_bits(seen_by: Integers, sensors: Mapping[int, int]) -> Integers:
    """Return by which sensors obstacles were seen (k,), one bit each, as they are numbered from here on."""
    found = np.zeros_like(seen_by)
    for old, new in sensors.items():
        found |= (seen_by >> old & 1) << new
    return found
