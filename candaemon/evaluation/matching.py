"""Matching of tracks with true objects: truth at the tracks' times, assignment over time, and GOSPA.

Sources: K. Bernardin, R. Stiefelhagen, "Evaluating multiple object tracking performance: the CLEAR MOT metrics",
2008, section 2.1 (a pair is kept while it is valid); A. S. Rahmathullah, Á. F. García-Fernández, L. Svensson,
"Generalized optimal sub-pattern assignment metric", 2017, equation (3) with α = 2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.evaluation.tables import ACTOR, HIDDEN, NUMBERS, STATIONARY, TrackTable
from candaemon.frames.bodies import BODY
from candaemon.tracking.obstacles import TENTATIVE

_SIDES: tuple[Literal["left"], Literal["right"]] = ("left", "right")


def covered(truth_ns: Integers, times_ns: Integers, max_gap_ns: int) -> Booleans:
    """Return which times are covered by truth.

    Args:
        truth_ns: the times of truth, sorted, unique.
        times_ns: the times asked for, shape (n,).
        max_gap_ns: longest step between two times of truth that is bridged.

    Returns:
        Shape (n,): true at a time of truth and between two that are at most `max_gap_ns` apart.
    """
    if not len(truth_ns):
        return np.zeros(len(times_ns), dtype=bool)
    before = np.searchsorted(truth_ns, times_ns, side="right") - 1
    after = np.searchsorted(truth_ns, times_ns, side="left")
    inside = (before >= 0) & (after < len(truth_ns))
    last = len(truth_ns) - 1
    gap = truth_ns[np.clip(after, 0, last)] - truth_ns[np.clip(before, 0, last)]
    return inside & (gap <= max_gap_ns)


def resample(truth: TrackTable, times_ns: Integers, max_gap_ns: int) -> TrackTable:
    """Return truth interpolated at other times, each object on its own.

    Positions follow the cubic Hermite curve through two neighbouring rows. Its slopes are the object's velocity over
    ground, shifted so that their mean is the slope of the chord: the shift is the ego motion, unknown here and assumed
    constant over the step. All other numbers are interpolated linearly. Nothing is extrapolated.

    Args:
        truth: rows of truth.
        times_ns: the times, sorted, unique.
        max_gap_ns: longest step between two rows of an object that is bridged.

    Returns:
        Rows at those of the times that truth covers; `hidden` where either neighbour is; `objects` left empty.
    """
    truth = truth.take(np.lexsort((truth.time_ns, truth.id)))
    step = np.diff(truth.time_ns)
    bridged = np.flatnonzero((np.diff(truth.id) == 0) & (step <= max_gap_ns))
    first = np.searchsorted(times_ns, truth.time_ns[bridged], side="right")
    count = np.searchsorted(times_ns, truth.time_ns[bridged + 1], side="left") - first
    count = np.maximum(count, 0)
    between = np.repeat(bridged, count)
    offset = np.arange(len(between)) - np.repeat(np.cumsum(count) - count, count)
    exact = np.flatnonzero(np.isin(truth.time_ns, times_ns))

    left = np.concatenate((exact, between))
    right = np.concatenate((exact, between + 1))
    now = np.concatenate((truth.time_ns[exact], times_ns[np.repeat(first, count) + offset]))
    table = _between(truth, left, right, now)
    return table.take(np.lexsort((table.id, table.time_ns)))


def _between(truth: TrackTable, left: Integers, right: Integers, now: Integers) -> TrackTable:
    """Return rows interpolated between the rows `left` and `right`, at the times `now`."""
    begin, end = truth.take(left), truth.take(right)
    step = (end.time_ns - begin.time_ns) / 1e9
    share = (now - begin.time_ns) / 1e9 / np.where(step > 0, step, 1.0)
    numbers = {}
    for name in (*NUMBERS, *BODY):
        a, b = getattr(begin, name), getattr(end, name)
        change = np.remainder(b - a + math.pi, 2 * math.pi) - math.pi if name == "heading" else b - a
        numbers[name] = a + share * change
    bend = 0.5 * share * (1.0 - share) * step
    numbers["x"] -= bend * np.nan_to_num(end.vx - begin.vx)
    numbers["y"] -= bend * np.nan_to_num(end.vy - begin.vy)
    state = np.where(end.state == HIDDEN, end.state, begin.state)
    return replace(begin, time_ns=now, state=state, objects=np.full(len(now), ""), **numbers)


@dataclass(frozen=True, slots=True)
class MatchedCycle:
    """Reported tracks and true objects at one time.

    Attributes:
        time_ns: the time.
        tracks: rows of confirmed and coasting tracks in the tracks' table, shape (n,).
        actors: rows of actors, hidden ones too, in the truth's table, shape (m,).
        distance: m between actor and track in the plane, infinite where their velocities are those of two bodies,
            shape (m, n).
        outside: m from the actor's box to the track, 0 within; from its reference point where the truth has no box,
            shape (m, n).
        visible: which actors some sensor can see, shape (m,).
        still_distance: m from each track to the nearest stationary object, infinite where there is none, shape (n,).
    """

    time_ns: int
    tracks: Integers
    actors: Integers
    distance: Floats
    outside: Floats
    visible: Booleans
    still_distance: Floats


def cycles(
    tracks: TrackTable, truth: TrackTable, times_ns: Integers, velocity_gate: float = math.inf
) -> Iterator[MatchedCycle]:
    """Yield confirmed tracks and truth of each time; both tables are ordered by time, truth is at these times.

    Args:
        tracks: with the tentative ones.
        truth: actors and stationary objects.
        times_ns: to yield.
        velocity_gate: m/s; tracks and actors that differ by more are infinitely far from one another.
    """
    edges = (np.searchsorted(of, times_ns, side=side) for of in (tracks.time_ns, truth.time_ns) for side in _SIDES)
    for time_ns, a, b, c, d in zip(times_ns.tolist(), *edges, strict=True):
        mine = a + np.flatnonzero(tracks.state[a:b] != TENTATIVE)
        there = np.arange(c, d)
        distance = np.hypot(
            truth.x[there, None] - tracks.x[mine],
            truth.y[there, None] - tracks.y[mine],
        )
        still = truth.state[there] == STATIONARY
        actors = there[~still]
        against = np.hypot(
            truth.vx[actors, None] - tracks.vx[mine],
            truth.vy[actors, None] - tracks.vy[mine],
        )
        yield MatchedCycle(
            time_ns,
            mine,
            actors,
            np.where(against > velocity_gate, np.inf, distance[~still]),
            _outside(tracks, truth, mine, actors),
            truth.state[actors] == ACTOR,
            distance[still].min(axis=0, initial=np.inf),
        )


def _outside(tracks: TrackTable, truth: TrackTable, mine: Integers, actors: Integers) -> Floats:
    """Return how far tracks lie from the boxes of actors, 0 within; from their reference points where there is none."""
    boxed = np.isfinite(truth.heading[actors]) & (truth.length[actors] > 0.0) & np.isfinite(truth.center_x[actors])
    turn = np.where(boxed, truth.heading[actors], 0.0)
    x = np.where(boxed, truth.center_x[actors], truth.x[actors])
    y = np.where(boxed, truth.center_y[actors], truth.y[actors])
    offset = (tracks.x[mine] - x[:, None] + 1j * (tracks.y[mine] - y[:, None])) * np.exp(-1j * turn)[:, None]
    half_length, half_width = (np.where(boxed, size[actors], 0.0) / 2 for size in (truth.length, truth.width))
    beyond = np.maximum(np.abs(offset.real) - half_length[:, None], 0.0)
    return np.asarray(np.hypot(beyond, np.maximum(np.abs(offset.imag) - half_width[:, None], 0.0)))


def assign(
    distance: Floats,
    actor: Integers,
    track: Integers,
    previous: Mapping[int, int],
    gate: float,
    farthest: Floats | float = math.inf,
) -> tuple[Integers, Integers]:
    """Pair actors and tracks one to one: keep the previous cycle's pairs, then add as many as possible at least cost.

    Args:
        distance: m, shape (m, n).
        actor: ids, shape (m,).
        track: ids, shape (n,).
        previous: the track's id of each actor that was paired in the cycle before.
        gate: m; greatest distance of a pair.
        farthest: m, at which each track begins a pair, with any actor (n,) or with each (m, n). A track that lies on a
            post or on a lorry is of that, not of what passes it.

    Returns:
        Rows and columns of `distance` that are paired, each of shape (k,).
    """
    near = distance <= gate
    column = {int(identity): k for k, identity in enumerate(track)}
    kept = [
        (row, column[previous[identity]])
        for row, identity in enumerate(actor.tolist())
        if identity in previous and previous[identity] in column and near[row, column[previous[identity]]]
    ]
    rows = np.array([row for row, _ in kept], dtype=np.int64)
    columns = np.array([k for _, k in kept], dtype=np.int64)
    near &= distance <= farthest
    near[rows] = near[:, columns] = False
    free_rows, free_columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
    if not len(free_rows) or not len(free_columns):
        return rows, columns
    part = np.ix_(free_rows, free_columns)
    # costs more than all near pairs together, so that no near pair is dropped for a smaller sum
    barred = gate * (min(len(free_rows), len(free_columns)) + 1)
    chosen, assigned = linear_sum_assignment(np.where(near[part], distance[part], barred))
    valid = near[part][chosen, assigned]
    return (
        np.concatenate((rows, free_rows[chosen[valid]])),
        np.concatenate((columns, free_columns[assigned[valid]])),
    )


@dataclass(frozen=True, slots=True)
class Gospa:
    """GOSPA at one time, α = 2.

    Attributes:
        localisation: sum of the paired distances to the power p, m^p.
        missed: true objects without a track.
        false: tracks without a true object.
        cutoff: c, m.
        order: p.
        unpaired: columns of the tracks without a true object.
    """

    localisation: float
    missed: int
    false: int
    cutoff: float
    order: float
    unpaired: Integers

    @property
    def penalty(self) -> float:
        """Cost of one missed or false object: c^p / 2, m^p."""
        return math.pow(self.cutoff, self.order) / 2.0

    @property
    def value(self) -> float:
        """The metric, m."""
        return math.pow(self.localisation + self.penalty * (self.missed + self.false), 1.0 / self.order)


def gospa(distance: Floats, *, cutoff: float = 4.0, order: float = 2.0) -> Gospa:
    """Return GOSPA with α = 2 between m true objects and n tracks.

    Args:
        distance: m, shape (m, n).
        cutoff: c, m: pairs at least this far apart count as one missed and one false object.
        order: p ≥ 1.
    """
    cost = np.minimum(distance, cutoff) ** order
    rows, columns = linear_sum_assignment(cost)
    paired = distance[rows, columns] < cutoff
    unpaired = np.ones(distance.shape[1], dtype=bool)
    unpaired[columns[paired]] = False
    pairs = int(paired.sum())
    return Gospa(
        localisation=float(cost[rows, columns][paired].sum()),
        missed=distance.shape[0] - pairs,
        false=distance.shape[1] - pairs,
        cutoff=cutoff,
        order=order,
        unpaired=np.flatnonzero(unpaired),
    )
