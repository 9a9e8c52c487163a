"""Tracks paired with true objects over a whole drive, and what follows from who was paired with whom.

Everything is compared in vehicle axes, at the times of the tracks; a time of truth that is farther than three quarters
of a step from all of them counts as a cycle without tracks. Only confirmed and coasting tracks count. Tracks
and actors are paired by `candaemon.evaluation.matching.assign`, at most `gate` apart in place and `velocity_gate` in
velocity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.errors import InputError
from candaemon.evaluation.duplicates import duplicated
from candaemon.evaluation.matching import Gospa, MatchedCycle, assign, covered, cycles, gospa, resample
from candaemon.evaluation.results import Options
from candaemon.evaluation.tables import ACTOR, STATIONARY, TrackTable
from candaemon.tracking.obstacles import TENTATIVE

NOBODY = -1
"""Partner of an object that has none."""


@dataclass(frozen=True, slots=True)
class Pairing:
    """Who was paired with whom, cycle by cycle.

    Attributes:
        options: of the evaluation.
        times_ns: the times compared, shape (c,).
        skipped: times of the tracks that truth does not cover.
        tracks: n rows, ordered by time.
        truth: m rows at the times compared, ordered by time.
        partner: row of the track of each row of truth, or `NOBODY`, shape (m,).
        confirmed: which rows of tracks were confirmed or coasting at a time compared, shape (n,).
        false: those of them farther than the gate from every true object, shape (n,).
        surplus: those of them within the gate of an actor that has another one, and nearer to it than to anything that
            stands, shape (n,).
        alike: those of them that `duplicated` names, shape (n,).
        gospa: of each cycle: localisation, missed and false objects, shape (c, 3).
    """

    options: Options
    times_ns: Integers
    skipped: int
    tracks: TrackTable
    truth: TrackTable
    partner: Integers
    confirmed: Booleans
    false: Booleans
    surplus: Booleans
    alike: Booleans
    gospa: Floats

    @property
    def visible(self) -> Booleans:
        """Which rows of truth are an actor that some sensor can see, shape (m,)."""
        return np.asarray(self.truth.state == ACTOR)

    @property
    def gospa_values(self) -> Floats:
        """GOSPA of each cycle, m, shape (c,)."""
        options = self.options
        penalty = options.gospa_cutoff**options.gospa_order / 2.0
        power = self.gospa[:, 0] + penalty * (self.gospa[:, 1] + self.gospa[:, 2])
        return np.asarray(power ** (1.0 / options.gospa_order))

    @property
    def awaited(self) -> Booleans:
        """Which rows of truth are an actor that has been visible for `Options.patience` without a break, shape (m,)."""
        rows = np.lexsort((self.truth.time_ns, self.truth.id))
        visible, awaited = self.visible[rows], np.zeros(len(rows), dtype=bool)
        since_ns = _visible_for(self.truth.time_ns[rows], self.truth.id[rows], visible)
        awaited[rows] = visible & (since_ns >= round(self.options.patience * 1e9))
        return awaited

    def since_confirmed(self, rows: Integers) -> Floats:
        """Return the time since the confirmation of the tracks of some rows, s."""
        reported = np.flatnonzero(self.tracks.state != TENTATIVE)
        # rows are ordered by time: the first of an id is its confirmation
        identity, first = np.unique(self.tracks.id[reported], return_index=True)
        began = self.tracks.time_ns[reported[first]][np.searchsorted(identity, self.tracks.id[rows])]
        return np.asarray((self.tracks.time_ns[rows] - began) / 1e9)


def pair(tracks: TrackTable, truth: TrackTable, options: Options) -> Pairing:
    """Pair tracks with truth.

    Args:
        tracks: rows of tracks.
        truth: rows of truth; a table without rows means an empty road.
        options: gate, interpolation and GOSPA parameters.

    Raises:
        InputError: no time of the tracks lies within the truth.
    """
    times_ns, skipped = _comparison_times(tracks, truth, round(options.max_gap * 1e9))
    at_tracks = resample(truth, times_ns, round(options.max_gap * 1e9))
    confirmed, false, surplus, alike = np.zeros((4, len(tracks)), dtype=bool)
    pairing = Pairing(
        options,
        times_ns,
        skipped,
        tracks,
        at_tracks,
        np.full(len(at_tracks), NOBODY, dtype=np.int64),
        confirmed,
        false,
        surplus,
        alike,
        np.zeros((len(times_ns), 3)),
    )
    previous: dict[int, int] = {}
    for k, cycle in enumerate(cycles(tracks, at_tracks, times_ns, options.velocity_gate)):
        previous = _pair_cycle(pairing, cycle, previous)
        score = _gospa(cycle, options)
        pairing.gospa[k] = score.localisation, score.missed, score.false
    return pairing


def _pair_cycle(pairing: Pairing, cycle: MatchedCycle, previous: dict[int, int]) -> dict[int, int]:
    """Note one cycle's pairs; return the track's id of each actor that has one."""
    tracks, gate, mine = pairing.tracks, pairing.options.gate, cycle.tracks
    actor, track = pairing.truth.id[cycle.actors], tracks.id[mine]
    nearest = cycle.outside.min(axis=0, initial=np.inf)
    farthest = np.where(cycle.outside > nearest, 0.0, cycle.still_distance)  # no pair with what is farther than another
    rows, columns = assign(cycle.distance, actor, track, previous, gate, farthest)
    pairing.partner[cycle.actors[rows]] = mine[columns]
    pairing.confirmed[mine] = True
    pairing.false[mine] = np.minimum(nearest, cycle.still_distance) > gate
    surplus = (nearest <= gate) & (nearest < cycle.still_distance)
    surplus[columns] = False
    if surplus.any():
        paired = np.zeros(len(actor), dtype=bool)
        paired[rows] = True
        surplus &= paired[cycle.outside.argmin(axis=0)]
    pairing.surplus[mine] = surplus
    pairing.alike[mine] = duplicated(tracks.x[mine], tracks.y[mine], tracks.vx[mine])
    return dict(zip(actor[rows].tolist(), track[columns].tolist(), strict=True))


def _gospa(cycle: MatchedCycle, options: Options) -> Gospa:
    """Return GOSPA over the visible actors, less the unpaired tracks near hidden or stationary objects."""
    score = gospa(cycle.distance[cycle.visible], cutoff=options.gospa_cutoff, order=options.gospa_order)
    hidden = cycle.outside[~cycle.visible].min(axis=0, initial=np.inf)
    explained = np.minimum(hidden, cycle.still_distance) <= options.gate
    false = score.unpaired[~explained[score.unpaired]]
    return replace(score, false=len(false), unpaired=false)


def _comparison_times(tracks: TrackTable, truth: TrackTable, max_gap_ns: int) -> tuple[Integers, int]:
    """Return the times to compare at, and how many times of the tracks have no truth."""
    reported = np.unique(tracks.time_ns)
    if not len(truth):
        return reported, 0
    true = np.unique(truth.time_ns)
    inside = covered(true, reported, max_gap_ns)
    if len(reported) and not inside.any():
        raise InputError(
            f"no truth within {max_gap_ns / 1e9:g} s around any of the tracks' times; "
            "expected the clock of the tracks and a finer step"
        )
    if not len(reported):
        return true, 0
    # the step of the coarser table: truth may have times for each sensor's scan, tracks only one for all sensors
    far = 0.75 * max(_step(reported), _step(true))
    after = np.searchsorted(reported, true)
    last = len(reported) - 1
    away = np.minimum(
        np.abs(reported[np.minimum(after, last)] - true), np.abs(reported[np.maximum(after - 1, 0)] - true)
    )
    return np.union1d(reported[inside], true[away > far]), int((~inside).sum())


def _step(times_ns: Integers) -> float:
    """Return the median step between times, ns; 0 for a single one."""
    return float(np.median(np.diff(times_ns))) if len(times_ns) > 1 else 0.0


@dataclass(frozen=True, slots=True)
class ActorHistory:
    """What became of the actors that were visible at least once, a row each, ordered by id.

    Attributes:
        id: as in the truth.
        visible: cycles in which it was visible.
        tracked: those of them in which it had a track.
        awaited: cycles in which it had been visible for `Options.patience` without a break.
        missed: those of them in which it had no track.
        confirmed_ns: first cycle with a track while visible; −1: never.
        switches: how often its track's id changed, hidden cycles included.
        fragments: how often it regained a track after visible cycles without one.
    """

    id: Integers
    visible: Integers
    tracked: Integers
    awaited: Integers
    missed: Integers
    confirmed_ns: Integers
    switches: Integers
    fragments: Integers


def histories(pairing: Pairing) -> ActorHistory:
    """Return what became of each actor."""
    truth = pairing.truth
    rows = np.flatnonzero(truth.state != STATIONARY)
    rows = rows[np.lexsort((truth.time_ns[rows], truth.id[rows]))]
    identity, actor = np.unique(truth.id[rows], return_inverse=True)
    visible, paired = pairing.visible[rows], pairing.partner[rows] >= 0
    track = pairing.tracks.id[pairing.partner[rows[paired]]]

    def count(of: Booleans, whose: Integers) -> Integers:
        return np.bincount(whose[of], minlength=len(identity))

    followed = actor[paired]
    switched = np.zeros(len(followed), dtype=bool)
    switched[1:] = (np.diff(followed) == 0) & (np.diff(track) != 0)
    in_sight, seen = actor[visible], paired[visible]
    regained = np.zeros(len(in_sight), dtype=bool)
    regained[1:] = (np.diff(in_sight) == 0) & seen[1:] & ~seen[:-1]
    first = np.searchsorted(in_sight[seen], np.arange(len(identity)))
    ever = count(seen, in_sight) > 0
    # a track that comes for the first time is not regained
    known = np.zeros(len(in_sight), dtype=np.int64)
    known[1:] = np.cumsum(seen)[:-1]
    begin = np.searchsorted(in_sight, in_sight)
    regained &= known > known[begin]
    confirmed = np.full(len(identity), -1, dtype=np.int64)
    confirmed[ever] = truth.time_ns[rows[visible][seen][first[ever]]]
    awaited = pairing.awaited[rows]
    history = ActorHistory(
        identity,
        count(visible, actor),
        count(visible & paired, actor),
        count(awaited, actor),
        count(awaited & ~paired, actor),
        confirmed,
        count(switched, followed),
        count(regained, in_sight),
    )
    ever_seen = history.visible > 0
    return ActorHistory(*(getattr(history, name)[ever_seen] for name in ActorHistory.__slots__))


def _visible_for(time_ns: Integers, actor: Integers, visible: Booleans) -> Integers:
    """Return since how long each row's actor has been visible without a break, ns; rows by actor, then time."""
    begins = visible.copy()
    begins[1:] &= ~visible[:-1] | (np.diff(actor) != 0)
    latest = np.maximum.accumulate(np.where(begins, np.arange(len(actor)), 0))
    return np.where(visible, time_ns - time_ns[latest], -1) if len(actor) else time_ns
