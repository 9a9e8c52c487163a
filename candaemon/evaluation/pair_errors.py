"""Errors of paired tracks, and their means by age, range, visibility, manoeuvre, motion and class of the target.

A measure is a number of each pair whose mean is of interest: a squared error, a NEES, a share as 0 or 1; NaN where it
is not known. Only sums and counts are kept, so that those of several drives can be added.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.evaluation.chi_square import chi2_quantile
from candaemon.evaluation.pairing import Pairing
from candaemon.evaluation.tables import TrackTable
from candaemon.frames.bodies import CLASSES
from candaemon.tracking.obstacles import COASTING

MOVING: Final = 2.0
"""m/s over ground above which a target counts as moving."""
TWO_SIDES_FOR: Final = 0.5
"""s of an obstacle's life for which two sides of its target must have been seen."""
SIZED_AFTER: Final = 3.0
"""s since an obstacle's confirmation after which its size is judged."""
SIZE_TOLERANCE: Final = 0.25
"""Relative error of a length or width that counts as right."""

AGES: Final = (0.5, 1.0, 2.0, 4.0)
RANGES: Final = (20.0, 40.0, 80.0)
ACCELERATIONS: Final = (0.5, 2.0)

_PEDESTRIAN = CLASSES.index("pedestrian")
_SQUARES = ("x", "y", "vx", "vy", "ax", "ay", "along", "across", "v_along", "v_across", "heading", "yaw_rate")
_SUMS_OF_SQUARES = {"position": ("x", "y"), "velocity": ("vx", "vy"), "acceleration": ("ax", "ay")}
_SIZES = ("length", "width")
_NEES = {"x": (0,), "y": (1,), "vx": (2,), "vy": (3,), "position": (0, 1), "velocity": (2, 3), "state": (0, 1, 2, 3)}
ROOT_MEANS: Final = frozenset((*_SQUARES, *_SUMS_OF_SQUARES, *_SIZES, "center"))
"""Measures that are squares: the root of their mean is what is told."""


def nees_name(quantity: str) -> str:
    """Return the measure that is the NEES of x, y, vx, vy, position, velocity or the state of all four."""
    return f"nees_{quantity}"


def within_name(quantity: str) -> str:
    """Return the measure that tells whether that NEES is within its 95 % bound."""
    return f"within_{quantity}"


DEGREES_OF_FREEDOM: Final[Mapping[str, int]] = {name: len(rows) for name, rows in _NEES.items()}


@dataclass(frozen=True, slots=True)
class MeasureSums:
    """Sums of measures over groups of pairs.

    Attributes:
        groups: what each group is, as (by what, which), shape g.
        names: of the measures, shape k.
        pairs: in each group, shape (g,).
        sums: of the known values, shape (g, k).
        counts: of the known values, shape (g, k).
    """

    groups: tuple[tuple[str, str], ...]
    names: tuple[str, ...]
    pairs: Integers
    sums: Floats
    counts: Integers

    def __add__(self, other: MeasureSums) -> MeasureSums:
        """Return the sums over the pairs of both."""
        if (self.groups, self.names) != (other.groups, other.names):
            raise ValueError("the sums are of other groups or measures")
        return MeasureSums(
            self.groups, self.names, self.pairs + other.pairs, self.sums + other.sums, self.counts + other.counts
        )

    def samples(self, group: tuple[str, str], name: str) -> int:
        """Return how many pairs of a group have a measure."""
        return int(self.counts[self.groups.index(group), self.names.index(name)])

    def value(self, group: tuple[str, str], name: str) -> float:
        """Return a measure's mean over a group, or its root where it is a square; NaN without samples."""
        row, column = self.groups.index(group), self.names.index(name)
        if not self.counts[row, column]:
            return float("nan")
        mean = float(self.sums[row, column] / self.counts[row, column])
        return mean**0.5 if name in ROOT_MEANS else mean


ALL: Final = ("all", "all")


def measure(pairing: Pairing, covariance: Floats | None = None) -> MeasureSums:
    """Return the sums of all measures over all groups.

    Pairs with an actor that no sensor can see count in one group only, `("visibility", "hidden")`. Pairs sooner than
    `Options.settle` after their track's confirmation count in the groups of age only.

    Args:
        pairing: who was paired with whom.
        covariance: of x, y, vx, vy, vehicle axes, a row each of `Pairing.tracks`, (n, 4, 4); without it, that of the
            tracks' standard deviations.
    """
    true = np.flatnonzero(pairing.partner >= 0)
    reported = pairing.partner[true]
    samples = _PairSamples(pairing, reported, true)
    values = _measures(samples, _covariance(pairing.tracks, covariance, reported))
    groups = dict(_groups(samples, pairing.visible[true], pairing.options.settle))
    masks = np.array(list(groups.values()), dtype=np.float64).reshape(len(groups), -1)
    table = np.array(list(values.values())).T.reshape(len(true), len(values))
    known = np.isfinite(table)
    return MeasureSums(
        tuple(groups),
        tuple(values),
        masks.sum(axis=1).astype(np.int64),
        masks @ np.where(known, table, 0.0),
        (masks @ known).astype(np.int64),
    )


class _PairSamples:
    """Pairs of rows of tracks and rows of truth, n of them.

    Attributes:
        error: name of a quantity → track − truth, shape (n,).
        since: s since the track's confirmation.
        range: m from the vehicle axes' origin to the target.
        speed: of the target over ground, m/s.
        pull: acceleration of the target over ground, m/s².
        aspect: angle between the target's course (its heading while it stands) and the line of sight, 0 to π/2.
        coasting: whether the track has not been detected in this cycle.
        sized: whether the size may be judged: old enough, and two sides seen for long enough.
        length, width: true ones, NaN for a point.
        kind: true class, an index into `CLASSES`.
    """

    def __init__(self, pairing: Pairing, reported: Integers, true: Integers) -> None:
        tracks, truth = pairing.tracks, pairing.truth
        names = ("x", "y", "vx", "vy", "ax", "ay", "yaw_rate", "length", "width", "center_x", "center_y")
        self.error = {name: getattr(tracks, name)[reported] - getattr(truth, name)[true] for name in names}
        heading = truth.heading[true]
        turned = tracks.heading[reported] - heading
        self.error["heading"] = np.arctan2(np.sin(turned), np.cos(turned))
        x, y, vx, vy = (getattr(truth, name)[true] for name in ("x", "y", "vx", "vy"))
        self.range, self.speed = np.hypot(x, y), np.hypot(vx, vy)
        self.pull = np.hypot(truth.ax[true], truth.ay[true])
        moves = self.speed > MOVING
        course = np.where(moves, np.arctan2(vy, vx), heading)
        turn = np.exp(-1j * course)
        for parts, first, second in (("along", "x", "y"), ("v_along", "vx", "vy")):
            error = (self.error[first] + 1j * self.error[second]) * turn
            self.error[parts], self.error[parts.replace("along", "across")] = error.real, error.imag
        offset = np.abs(np.remainder(course - np.arctan2(y, x) + np.pi / 2, np.pi) - np.pi / 2)
        self.aspect = offset
        self.since = pairing.since_confirmed(reported)
        self.coasting = np.asarray(tracks.state[reported] == COASTING)
        self.length, self.width = (
            np.where(size > 0.0, size, np.nan) for size in (truth.length[true], truth.width[true])
        )
        self.kind = truth.kind[true]
        two = truth.sides[true] >= 2
        who = np.stack([tracks.id[reported], truth.id[true]])
        self.sized = (self.since >= SIZED_AFTER) & (_seen_for(two, who, truth.time_ns[true]) >= TWO_SIDES_FOR)


def _seen_for(seen: Booleans, who: Integers, time_ns: Integers) -> Floats:
    """Return for how long (s) something has been so of each pair, up to each sample.

    Args:
        seen: whether it is so (n,); samples are ordered by time.
        who: the ids of each pair (2, n).
        time_ns: of each sample (n,).
    """
    order = np.lexsort((time_ns, *who))
    same = (np.diff(who[:, order], axis=1) == 0).all(axis=0)
    step = np.zeros(len(order))
    step[1:] = np.where(same & seen[order][1:], np.diff(time_ns[order]) / 1e9, 0.0)
    total = np.cumsum(step)
    begins = np.ones(len(order), dtype=bool)
    begins[1:] = ~same
    first = np.maximum.accumulate(np.where(begins, np.arange(len(order)), 0))
    out = np.empty(len(order))
    out[order] = total - total[first] if len(order) else total
    return out


def _covariance(tracks: TrackTable, full: Floats | None, rows: Integers) -> Floats:
    """Return the stated covariance of x, y, vx, vy at some rows (k, 4, 4)."""
    if full is not None:
        return np.asarray(full[rows])
    sigma = np.stack([getattr(tracks, name)[rows] for name in ("sx", "sy", "svx", "svy")], axis=1)
    return np.asarray(np.where(sigma > 0, sigma, np.nan)[:, :, None] ** 2 * np.eye(4))


def _measures(samples: _PairSamples, covariance: Floats) -> dict[str, Floats]:
    """Return all measures of n pairs, each of shape (n,)."""
    error = samples.error
    values = {name: error[name] ** 2 for name in _SQUARES}
    values |= {name: values[a] + values[b] for name, (a, b) in _SUMS_OF_SQUARES.items()}
    drives = (samples.speed > MOVING) & np.isfinite(samples.length) & (samples.kind != _PEDESTRIAN)
    values["heading"] = np.where(drives, np.degrees(error["heading"]) ** 2, np.nan)
    values["heading_known"] = np.where(drives, np.isfinite(error["heading"]), np.nan)
    values["center"] = error["center_x"] ** 2 + error["center_y"] ** 2
    for name, size in (("length", samples.length), ("width", samples.width)):
        relative = np.where(samples.sized, error[name] / size, np.nan)
        values[name] = relative**2
        right = np.where(np.isfinite(relative), np.abs(relative) <= SIZE_TOLERANCE, np.nan)
        values[f"{name}_right"] = right
    deviation = np.stack([error[name] for name in ("x", "y", "vx", "vy")], axis=1)
    for name, rows in _NEES.items():
        nees = _nees(deviation[:, rows], covariance[:, rows][:, :, rows])
        values[nees_name(name)] = nees
        bound = chi2_quantile(0.95, float(len(rows)))
        values[within_name(name)] = np.where(np.isfinite(nees), nees <= bound, np.nan)
    return values


def _nees(error: Floats, covariance: Floats) -> Floats:
    """Return the normalised error squared of n samples; NaN where the covariance is not positive definite."""
    nees = np.full(len(error), np.nan)
    finite = np.isfinite(error).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    usable = np.flatnonzero(finite)
    usable = usable[np.linalg.eigvalsh(covariance[usable])[:, 0] > 0.0]
    solved = np.linalg.solve(covariance[usable], error[usable][:, :, None])[:, :, 0]
    nees[usable] = (error[usable] * solved).sum(axis=1)
    return nees


def _groups(samples: _PairSamples, visible: Booleans, settle: float) -> Iterable[tuple[tuple[str, str], Booleans]]:
    """Yield each group and which of n pairs it holds."""
    settled = samples.since >= settle
    counted = visible & settled
    yield ALL, counted
    yield from _binned("age", samples.since, AGES, "s", visible)
    yield from _binned("range", samples.range, RANGES, "m", counted)
    yield ("visibility", "detected"), counted & ~samples.coasting
    yield ("visibility", "coasting"), counted & samples.coasting
    yield ("visibility", "hidden"), ~visible & settled
    yield from _binned("manoeuvre", samples.pull, ACCELERATIONS, "m/s²", counted)
    moving = samples.speed > MOVING
    yield ("motion", "standing"), counted & ~moving
    yield ("motion", "along the line of sight"), counted & moving & (samples.aspect <= np.pi / 4)
    yield ("motion", "crossing"), counted & moving & (samples.aspect > np.pi / 4)
    solid = np.isfinite(samples.length)
    yield ("target", "point"), counted & ~solid
    for code, name in enumerate(CLASSES):
        if name != "standing":  # which no actor is
            yield ("target", name), counted & solid & (samples.kind == code)


def _binned(
    by: str, values: Floats, edges: tuple[float, ...], unit: str, among: Booleans
) -> Iterable[tuple[tuple[str, str], Booleans]]:
    """Yield the groups of values between edges, the lower one included; what is NaN is in none."""
    for low, high in zip((0.0, *edges), (*edges, np.inf), strict=True):
        name = f"{edges[-1]:g} {unit} and more" if high == np.inf else f"{low:g} to {high:g} {unit}"
        yield (by, name), among & (values >= low) & (values < high)
