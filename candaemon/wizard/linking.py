"""Objects without identity: which detection of a scan is which of another, found by where it would have gone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from candaemon.arrays import Floats, Indices

MOST_LOOKS_TRIED: Final = 4
"""Scans apart that are tried: a radar that looks elsewhere in turn sees the same things again after so many."""
MOST_LINKED_SCANS: Final = 1500
"""Scans that are linked, from the log's beginning."""


@dataclass(frozen=True, slots=True)
class Linked:
    """Detections with the objects that they seem to be of.

    Attributes:
        rows: (n,) detections, in order of time.
        number: (n,) of the object.
        scans: how many scans apart successive detections of an object are.
        factor: of the rate, with its sense, by which most went on.
        found: how many went on.
        otherwise: how many did with the other sense.
    """

    rows: Indices
    number: Indices
    scans: int
    factor: float
    found: int
    otherwise: int


def linked(rows: Indices, time: Floats, far: Floats, aside: Floats, rate: Floats, cycle_time: float) -> Linked | None:
    """Link detections of successive scans.

    Args:
        rows: (n,) which detections are objects.
        time: (all,) s.
        far: (all,) distance, m.
        aside: (all,) the other coordinate, in any unit.
        rate: (all,) rate of the distance in m/s but for its sense.
        cycle_time: s between scans.
    """
    rows = rows[np.argsort(time[rows], kind="stable")]
    if len(rows) < 100:
        return None
    scan = np.cumsum(np.diff(time[rows], prepend=time[rows[0]]) > 0.3 * cycle_time)
    rows, scan = rows[scan < MOST_LINKED_SCANS], scan[scan < MOST_LINKED_SCANS]
    edges = np.searchsorted(scan, np.arange(int(scan[-1]) + 2))
    width = float(np.subtract(*np.quantile(aside[rows], [0.95, 0.05]))) or 1.0
    best: Linked | None = None
    for apart in range(1, MOST_LOOKS_TRIED + 1):
        tried = {
            sense: _chains(rows, edges, apart, time, far, aside / (0.03 * width), rate * sense) for sense in (1.0, -1.0)
        }
        sense = max(tried, key=lambda each: tried[each][1])
        number, found = tried[sense]
        if best is None or found > 1.3 * best.found:
            best = Linked(rows, number, apart, sense, found, tried[-sense][1])
    return best


def _chains(
    rows: Indices, edges: Indices, apart: int, time: Floats, far: Floats, aside: Floats, rate: Floats
) -> tuple[Indices, int]:
    """Return the number of each detection's object, and how many detections go on."""
    number = np.arange(len(rows))
    found = 0
    for k in range(len(edges) - 1 - apart):
        a, b = np.arange(edges[k], edges[k + 1]), np.arange(edges[k + apart], edges[k + apart + 1])
        if not len(a) or not len(b):
            continue
        of, to = rows[a], rows[b]
        step = time[to][None, :] - time[of][:, None]
        cost = np.abs(far[to][None, :] - far[of][:, None] - rate[of][:, None] * step) / 0.6
        cost += np.abs(aside[to][None, :] - aside[of][:, None]) + np.abs(rate[to][None, :] - rate[of][:, None]) / 0.6
        nearest = cost.argmin(axis=1)
        mutual = cost.argmin(axis=0)[nearest] == np.arange(len(a))
        good = mutual & (cost[np.arange(len(a)), nearest] < 2.5)
        number[b[nearest[good]]] = number[a[good]]
        found += int(np.count_nonzero(good))
    return number, found
