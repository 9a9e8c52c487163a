"""How the objects of a table move: rates against derivatives, and standing ones against own motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.wizard.object_table import ObjectTable
from candaemon.wizard.occupancy import Occupancy
from candaemon.wizard.own_motion import SLOWEST, OwnMotion

LAG_S: Final = 0.4
"""s over which motion is compared with what is told of it."""
FEWEST_PAIRS: Final = 40


@dataclass(frozen=True, slots=True)
class Pairs:
    """Rows of the same object, some scans apart.

    Attributes:
        first, last: (n,) rows.
        seconds: (n,) between them.
        run: (n,) number of the object.
    """

    first: Indices
    last: Indices
    seconds: Floats
    run: Indices

    def rows(self, keep: Booleans) -> Pairs:
        """Return some of them."""
        return Pairs(self.first[keep], self.last[keep], self.seconds[keep], self.run[keep])

    def __len__(self) -> int:
        return len(self.first)


def pairs(table: ObjectTable, held: Occupancy, seconds: float = LAG_S) -> Pairs:
    """Return pairs of rows of one object, about so many seconds apart.

    A slot that was empty for a scan between holds the same object if that is where it would have gone.
    """
    scans = max(1, round(seconds / table.cycle_time))
    rows = np.flatnonzero(held.occupied)
    slot, time = table.slot[rows], table.time[rows]
    stride = float(table.time.max()) + 10.0
    key = slot * stride + time
    found = np.searchsorted(key, key + scans * table.cycle_time - 0.5 * table.cycle_time)
    kept = found < len(rows)
    first, last = rows[kept], rows[found[kept]]
    step = table.time[last] - table.time[first]
    good = (table.slot[first] == table.slot[last]) & (step < (scans + 0.5) * table.cycle_time)
    good &= held.chain[first] == held.chain[last]
    return Pairs(first[good], last[good], step[good], held.chain[first][good])


@dataclass(frozen=True, slots=True)
class Slope:
    """A straight line through pairs of numbers.

    Attributes:
        value: its slope.
        deviation: one standard deviation of it; successive samples of an object count as one.
        correlation: of the numbers.
        samples: how many.
    """

    value: float
    deviation: float
    correlation: float
    samples: int

    @property
    def sigmas(self) -> float:
        """How many standard deviations its slope is from 0."""
        return abs(self.value) / max(self.deviation, 1e-12)


NO_SLOPE: Final = Slope(float("nan"), float("inf"), 0.0, 0)


def fitted(x: Floats, y: Floats, group: Indices) -> Slope:
    """Fit y = slope × x, robustly, with errors that are alike within a group.

    Args:
        x: (n,) what it is seen against.
        y: (n,) what is seen.
        group: (n,) number of the object.
    """
    good = np.isfinite(x) & np.isfinite(y)
    x, y, group = x[good], y[good], group[good]
    if len(x) < FEWEST_PAIRS or not np.any(x):
        return NO_SLOPE
    weight = np.ones(len(x))
    slope = 0.0
    for _ in range(8):
        slope = float((weight * x) @ y / ((weight * x) @ x))
        off = y - slope * x
        spread = 1.4826 * float(np.median(np.abs(off))) + 1e-9
        weight = 1.0 / (1.0 + np.square(off / (2.0 * spread)))
    moment = np.bincount(group - group.min(), weights=weight * x * off)
    deviation = float(np.sqrt(np.sum(moment**2))) / float((weight * x) @ x)
    weighted = float((weight * x) @ y) / float(np.sqrt(((weight * x) @ x) * ((weight * y) @ y)) + 1e-12)
    return Slope(slope, deviation, weighted, len(x))


def derivative_slope(position: Floats, rate: Floats, of: Pairs) -> Slope:
    """Return how the change of a position goes with a rate: slope 1 where the rate is the position's derivative."""
    moved = position[of.last] - position[of.first]
    told = 0.5 * (rate[of.first] + rate[of.last]) * of.seconds
    return fitted(told, moved, of.run)


def approach_slope(position: Floats, of: Pairs, table: ObjectTable, own: OwnMotion) -> Slope:
    """Return how the distance of what seems to stand goes with the way that the vehicle went: −1 in metres."""
    gone = own.way_at(table.time[of.last]) - own.way_at(table.time[of.first])
    fast = gone > SLOWEST * of.seconds
    moved = position[of.last] - position[of.first]
    ratio = -moved / np.maximum(gone, 1e-6)
    near = fast & (np.abs(ratio - 1.0) < 0.3)
    if np.count_nonzero(near) < FEWEST_PAIRS:
        return NO_SLOPE
    return fitted(gone[near], moved[near], of.run[near])


def standing_rows(rate: Floats, table: ObjectTable, held: Occupancy, own: OwnMotion) -> Booleans:
    """Return the rows of what seems to stand: it nears as fast as the vehicle drives.

    Args:
        rate: (n,) m/s, of the distance.
        table: the objects.
        held: which rows hold one.
        own: own motion.
    """
    speed = own.speed_at(table.time)
    fast = speed > SLOWEST
    ratio = -rate / np.maximum(speed, SLOWEST)
    stands: Booleans = held.occupied & fast & (ratio > 0.72) & (ratio < 1.0 + 0.03 + 0.3 / np.maximum(speed, SLOWEST))
    return stands


def turning_slope(
    lateral: Floats, drift: Floats, lever: Floats, of: Pairs, table: ObjectTable, own: OwnMotion
) -> Slope:
    """Return how what stands moves sideways as the vehicle turns, in the lateral signal's unit for each rad or m.

    Args:
        lateral: (n,) the signal.
        drift: (pairs,) by how much it changes without any turn.
        lever: (pairs,) by how much it would change with a turn of one rad to the right.
        of: pairs of what stands.
        table: the objects.
        own: own motion.
    """
    turned = own.heading_at(table.time[of.last]) - own.heading_at(table.time[of.first])
    x = -turned * lever
    y = lateral[of.last] - lateral[of.first] - drift
    good = np.isfinite(y)
    if np.count_nonzero(good) < FEWEST_PAIRS:
        return NO_SLOPE
    # a bias of the yaw rate looks as a turn that is always the same
    bias = (lever * of.seconds)[good]
    x, y, run = x[good], y[good], of.run[good]
    spread = float(bias @ bias)
    if spread > 0:
        inner = x - bias * (float(bias @ x) / spread)
        outer = y - bias * (float(bias @ y) / spread)
        if float(inner @ inner) > 1e-6 * float(x @ x):
            return fitted(inner, outer, run)
    return NO_SLOPE


def white_noise(values: Floats, held: Occupancy) -> float:
    """Return the standard deviation of a measured value from scan to scan, from its second differences."""
    triple = held.continuing[:-2] & held.continuing[1:-1]
    bend = (values[2:] - 2 * values[1:-1] + values[:-2])[triple]
    bend = bend[np.isfinite(bend)]
    if len(bend) < FEWEST_PAIRS:
        return float("nan")
    low, high = np.quantile(bend, [0.1587, 0.8413])
    return float((high - low) / 2 / np.sqrt(6))


def growth(x: Floats, y: Floats, table: ObjectTable, held: Occupancy, stands: Booleans, own: OwnMotion) -> Floats:
    """Return by how much more the places of what stands wander in a second than from one scan to the next.

    Args:
        x: (n,) place ahead, m.
        y: (n,) place to the left, m.
        table: the objects.
        held: which rows hold one.
        stands: (n,) rows of what stands.
        own: own motion.

    Returns:
        Ratios of the variances along and across (2,); about 1 where errors are white. NaN where too little stands.
    """
    variances = np.full((2, 2), np.nan)
    for row, seconds in enumerate((table.cycle_time, 1.0)):
        of = pairs(table, held, seconds)
        of = of.rows(stands[of.first] & stands[of.last])
        if len(of) < FEWEST_PAIRS:
            return np.full(2, np.nan)
        gone = own.way_at(table.time[of.last]) - own.way_at(table.time[of.first])
        turned = own.heading_at(table.time[of.last]) - own.heading_at(table.time[of.first])
        ahead, aside = 0.5 * (x[of.first] + x[of.last]), 0.5 * (y[of.first] + y[of.last])
        moved = (x[of.last] - x[of.first] + gone - turned * aside, y[of.last] - y[of.first] + turned * ahead)
        for column, off in enumerate(moved):
            # what moves slowly seems to stand; it is not to widen the middle
            low, high = np.quantile(off, [0.25, 0.75])
            variances[row, column] = max(float(high - low) / 1.349, 1e-6) ** 2
    ratio: Floats = variances[1] / variances[0]
    return ratio
