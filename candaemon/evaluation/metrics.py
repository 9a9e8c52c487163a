"""Tracks against truth: errors, consistency, GOSPA, identity, delay, false tracks, duplicates.

Everything is compared in vehicle axes, at the times of the tracks; a time of truth that is farther than three quarters
of a step from all of them counts as a cycle without tracks. Only confirmed and coasting tracks count. Tracks
and actors are paired by `candaemon.evaluation.matching.assign`, at most `gate` apart.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.errors import InputError
from candaemon.evaluation.chi_square import chi2_quantile
from candaemon.evaluation.duplicates import duplicated
from candaemon.evaluation.matching import Gospa, MatchedCycle, assign, covered, cycles, gospa, resample
from candaemon.evaluation.results import (
    ActorResult,
    Consistency,
    Duplicates,
    Errors,
    Evaluation,
    FalseTracks,
    GospaSummary,
    Options,
    TimeToConfirm,
)
from candaemon.evaluation.tables import ACTOR, TrackTable, read_tracks, read_truth
from candaemon.tracking.obstacles import TENTATIVE

_COMPARED = ("x", "y", "vx", "vy", "ax", "ay")
_SIGMAS = ("sx", "sy", "svx", "svy")
_DEFAULTS = Options()


def evaluate(tracks_path: Path | str, truth_path: Path | str, options: Options = _DEFAULTS) -> Evaluation:
    """Compare a table of tracks with a table of truth.

    Args:
        tracks_path: as `--tracks` writes it.
        truth_path: as `--truth` writes it.
        options: gate, settling time, interpolation and GOSPA parameters.

    Raises:
        InputError: a table cannot be used, or the two have no time in common.
    """
    tracks, truth = read_tracks(tracks_path), read_truth(truth_path)
    try:
        return compare(tracks, truth, options)
    except InputError as error:
        raise InputError(error.message, file=truth_path) from None


def compare(tracks: TrackTable, truth: TrackTable, options: Options = _DEFAULTS) -> Evaluation:
    """Compare tracks with truth, both in memory.

    Args:
        tracks: rows of tracks.
        truth: rows of truth; a table without rows means an empty road.
        options: gate, settling time, interpolation and GOSPA parameters.

    Raises:
        InputError: no time of the tracks lies within the truth.
    """
    times_ns, skipped = _comparison_times(tracks, truth, round(options.max_gap * 1e9))
    at_tracks = resample(truth, times_ns, round(options.max_gap * 1e9))
    tally = _Accumulator(tracks, at_tracks, options)
    for cycle in cycles(tracks, at_tracks, times_ns):
        tally.add(cycle)
    return tally.evaluation(truth, len(times_ns), skipped)


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


@dataclass(slots=True)
class _ActorHistory:
    """Counts of one actor over the cycles."""

    visible: int = 0
    tracked: int = 0
    confirmed_ns: int | None = None
    last_id: int | None = None
    switches: int = 0
    fragments: int = 0
    lost: bool = False

    def see(self, *, paired: bool, time_ns: int) -> None:
        """Count a cycle in which the actor is visible."""
        self.visible += 1
        if not paired:
            self.lost = self.tracked > 0
            return
        self.tracked += 1
        self.fragments += self.lost
        self.lost = False
        if self.confirmed_ns is None:
            self.confirmed_ns = time_ns

    def follow(self, track: int) -> None:
        """Note the id of the actor's track."""
        self.switches += self.last_id is not None and self.last_id != track
        self.last_id = track


@dataclass(slots=True)
class _Accumulator:
    """Accumulates the metrics over the cycles, in order of time."""

    tracks: TrackTable
    truth: TrackTable
    options: Options
    lives: dict[int, _ActorHistory] = field(default_factory=lambda: defaultdict(_ActorHistory))
    previous: dict[int, int] = field(default_factory=dict)
    pairs: list[tuple[Integers, Integers]] = field(default_factory=list)
    scores: list[Gospa] = field(default_factory=list)
    confirmed: list[Integers] = field(default_factory=list)
    false: list[Integers] = field(default_factory=list)
    alike: list[Integers] = field(default_factory=list)

    def add(self, cycle: MatchedCycle) -> None:
        """Process one cycle; cycles come in order of time."""
        tracks, gate = self.tracks, self.options.gate
        actor, track = self.truth.id[cycle.actors], tracks.id[cycle.tracks]
        rows, columns = assign(cycle.distance, actor, track, self.previous, gate)
        self.previous = dict(zip(actor[rows].tolist(), track[columns].tolist(), strict=True))
        for k, identity in enumerate(actor.tolist()):
            if identity in self.previous:
                self.lives[identity].follow(self.previous[identity])
            if cycle.visible[k]:
                self.lives[identity].see(paired=identity in self.previous, time_ns=cycle.time_ns)
        seen = cycle.visible[rows]
        self.pairs.append((cycle.tracks[columns[seen]], cycle.actors[rows[seen]]))
        self.scores.append(self._gospa(cycle))
        nearest = np.minimum(cycle.distance.min(axis=0, initial=np.inf), cycle.still_distance)
        self.confirmed.append(cycle.tracks)
        self.false.append(cycle.tracks[nearest > gate])
        mine = cycle.tracks
        self.alike.append(mine[duplicated(tracks.x[mine], tracks.y[mine], tracks.vx[mine])])

    def _gospa(self, cycle: MatchedCycle) -> Gospa:
        """Return GOSPA over the visible actors, less the unpaired tracks near hidden or stationary objects."""
        options = self.options
        score = gospa(cycle.distance[cycle.visible], cutoff=options.gospa_cutoff, order=options.gospa_order)
        hidden = cycle.distance[~cycle.visible].min(axis=0, initial=np.inf)
        explained = np.minimum(hidden, cycle.still_distance) <= options.gate
        false = score.unpaired[~explained[score.unpaired]]
        return replace(score, false=len(false), unpaired=false)

    def evaluation(self, truth: TrackTable, count: int, skipped: int) -> Evaluation:
        """Return the metrics; `truth` is the table before resampling."""
        reported, true = (
            _concatenated([rows for rows, _ in self.pairs]),
            _concatenated([rows for _, rows in self.pairs]),
        )
        settled = self._settled(reported)
        reported, true = reported[settled], true[settled]
        error = np.stack([getattr(self.tracks, name)[reported] - getattr(self.truth, name)[true] for name in _COMPARED])
        sigma = np.stack([getattr(self.tracks, name)[reported] for name in _SIGMAS])
        actor = self.truth.id[true]
        actors = tuple(
            self._actor(identity, life, _first_visible(truth, identity), _errors(error[:, actor == identity]))
            for identity, life in sorted(self.lives.items())
            if life.visible
        )
        delays = [one.time_to_confirm for one in actors if one.time_to_confirm is not None]
        confirmed, false, alike = (_concatenated(rows) for rows in (self.confirmed, self.false, self.alike))
        ids = self.tracks.id
        return Evaluation(
            options=self.options,
            cycles=count,
            skipped=skipped,
            confirmed_ids=len(np.unique(ids[confirmed])),
            confirmed_samples=len(confirmed),
            errors=_errors(error),
            nees=_consistency(error[:4], sigma),
            gospa=_summary(self.scores, self.options),
            id_switches=sum(one.id_switches for one in actors),
            fragments=sum(one.fragments for one in actors),
            time_to_confirm=TimeToConfirm(
                mean=math.fsum(delays) / len(delays) if delays else math.nan,
                max=max(delays, default=math.nan),
                unconfirmed=len(actors) - len(delays),
            ),
            false_tracks=FalseTracks(len(np.unique(ids[false])), len(false), _share(false, confirmed)),
            duplicates=Duplicates(len(np.unique(ids[alike])), len(alike), _share(alike, confirmed)),
            actors=actors,
        )

    def _settled(self, rows: Integers) -> Booleans:
        """Return which rows of tracks lie at least `settle` after their track's confirmation."""
        reported = self.tracks.take(self.tracks.state != TENTATIVE)
        # rows are ordered by time: the first of an id is its confirmation
        identity, first = np.unique(reported.id, return_index=True)
        since = reported.time_ns[first][np.searchsorted(identity, self.tracks.id[rows])]
        settled: Booleans = self.tracks.time_ns[rows] - since >= round(self.options.settle * 1e9)
        return settled

    @staticmethod
    def _actor(identity: int, life: _ActorHistory, first_ns: int, errors: Errors) -> ActorResult:
        """Return the result of one visible actor."""
        return ActorResult(
            id=identity,
            visible=life.visible,
            tracked=life.tracked / life.visible,
            time_to_confirm=None if life.confirmed_ns is None else (life.confirmed_ns - first_ns) / 1e9,
            id_switches=life.switches,
            fragments=life.fragments,
            errors=errors,
        )


def _concatenated(rows: list[Integers]) -> Integers:
    """Return the rows of all cycles as one array."""
    return np.concatenate([np.empty(0, np.int64), *rows])


def _share(part: Integers, whole: Integers) -> float:
    """Return the share of samples; 0 of none."""
    return len(part) / len(whole) if len(whole) else 0.0


def _first_visible(truth: TrackTable, identity: int) -> int:
    """Return the time at which an actor is first visible, ns."""
    return int(truth.time_ns[(truth.id == identity) & (truth.state == ACTOR)].min())


def _errors(error: Floats) -> Errors:
    """Return the RMSE of errors in x, y, vx, vy, ax, ay, shape (6, n); pairs with NaN are left out."""
    pairs = (error**2).reshape(3, 2, -1)
    return Errors(
        error.shape[1],
        *(_root_mean(values) for first, second in pairs for values in (first + second, first, second)),
    )


def _root_mean(squares: Floats) -> float:
    """Return the root mean of the squares that are not NaN; NaN if there is none."""
    known = squares[~np.isnan(squares)]
    return math.sqrt(float(known.mean())) if len(known) else math.nan


def _consistency(error: Floats, sigma: Floats) -> Consistency:
    """Return the NEES of errors and their standard deviations, both of shape (4, n)."""
    usable = np.isfinite(error).all(axis=0) & (sigma > 0).all(axis=0)
    nees = ((error[:, usable] / sigma[:, usable]) ** 2).sum(axis=0)
    dof, count = float(len(error)), len(nees)
    if not count:
        return Consistency(0, math.nan, dof, math.nan, math.nan, math.nan)
    return Consistency(
        samples=count,
        mean=float(nees.mean()),
        expected=dof,
        lower=chi2_quantile(0.025, dof * count) / count,
        upper=chi2_quantile(0.975, dof * count) / count,
        coverage=float((nees <= chi2_quantile(0.95, dof)).mean()),
    )


def _summary(scores: list[Gospa], options: Options) -> GospaSummary:
    """Return the means of GOSPA over the cycles."""
    parts = np.array([(one.localisation, one.penalty * one.missed, one.penalty * one.false) for one in scores])
    localisation, missed, false = parts.mean(axis=0).tolist() if scores else [math.nan] * 3
    return GospaSummary(
        cutoff=options.gospa_cutoff,
        order=options.gospa_order,
        alpha=2.0,
        mean=math.fsum(one.value for one in scores) / len(scores) if scores else math.nan,
        power_mean=localisation + missed + false,
        localisation=localisation,
        missed=missed,
        false=false,
    )
