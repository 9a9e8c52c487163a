"""Tracks against truth: errors, consistency, GOSPA, identity, delay, false tracks, duplicates."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.errors import InputError
from candaemon.evaluation.chi_square import chi2_quantile
from candaemon.evaluation.pair_errors import ALL, DEGREES_OF_FREEDOM, MeasureSums, measure, nees_name, within_name
from candaemon.evaluation.pairing import ActorHistory, Pairing, histories, pair
from candaemon.evaluation.results import (
    ActorResult,
    BoxErrors,
    Consistency,
    Duplicates,
    Errors,
    Evaluation,
    FalseTracks,
    GospaSummary,
    GroupErrors,
    Missed,
    Options,
    Surplus,
    TimeToConfirm,
)
from candaemon.evaluation.tables import ACTOR, TrackTable, read_tracks, read_truth

_COMPARED = ("x", "y", "vx", "vy", "ax", "ay")
_PLANE = {
    "position": "position",
    "along": "along",
    "across": "across",
    "velocity": "velocity",
    "velocity_along": "v_along",
    "velocity_across": "v_across",
}
"""Field of `GroupErrors` → measure."""
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
    pairing = pair(tracks, truth, options)
    history, sums = histories(pairing), measure(pairing)
    actors = tuple(_actors(pairing, history, truth))
    delays = [one.time_to_confirm for one in actors if one.time_to_confirm is not None]
    return Evaluation(
        options=options,
        cycles=len(pairing.times_ns),
        skipped=pairing.skipped,
        confirmed_ids=_ids(pairing, pairing.confirmed),
        confirmed_samples=int(pairing.confirmed.sum()),
        errors=_errors(_settled_errors(pairing)[1]),
        nees=_consistency(sums, "state"),
        gospa=_summary(pairing),
        id_switches=int(history.switches.sum()),
        fragments=int(history.fragments.sum()),
        time_to_confirm=TimeToConfirm(
            mean=math.fsum(delays) / len(delays) if delays else math.nan,
            max=max(delays, default=math.nan),
            unconfirmed=len(actors) - len(delays),
        ),
        false_tracks=FalseTracks(*_marked(pairing, pairing.false)),
        duplicates=Duplicates(*_marked(pairing, pairing.alike)),
        actors=actors,
        nees_of={name: _consistency(sums, name) for name in DEGREES_OF_FREEDOM if name != "state"},
        surplus=Surplus(*_marked(pairing, pairing.surplus)),
        missed=_missed(history),
        groups=tuple(_groups(sums)),
    )


def _missed(history: ActorHistory) -> Missed:
    """Return how many cycles of visible actors had no track; a share of 0 of none."""
    awaited, samples = int(history.awaited.sum()), int(history.missed.sum())
    return Missed(awaited, samples, samples / max(awaited, 1))


def _groups(sums: MeasureSums) -> Iterator[GroupErrors]:
    """Yield the errors of each group of pairs that has any, that of all pairs in any case."""
    for group, pairs in zip(sums.groups, sums.pairs.tolist(), strict=True):
        if pairs or group == ALL:
            by, which = group
            plane = {field: sums.value(group, name) for field, name in _PLANE.items()}
            box = BoxErrors(**{field.name: sums.value(group, field.name) for field in fields(BoxErrors)})
            nees, coverage = (sums.value(group, name("state")) for name in (nees_name, within_name))
            yield GroupErrors(by, which, pairs, **plane, box=box, nees=nees, coverage=coverage)


def _settled_errors(pairing: Pairing) -> tuple[Integers, Floats]:
    """Return the actor and the errors in x, y, vx, vy, ax, ay of all settled pairs in sight, shapes (n,) and (6, n)."""
    true = np.flatnonzero((pairing.partner >= 0) & pairing.visible)
    true = true[pairing.since_confirmed(pairing.partner[true]) >= pairing.options.settle]
    tracks, truth, reported = pairing.tracks, pairing.truth, pairing.partner[true]
    error = np.stack([getattr(tracks, name)[reported] - getattr(truth, name)[true] for name in _COMPARED])
    return truth.id[true], error


def _actors(pairing: Pairing, history: ActorHistory, truth: TrackTable) -> Iterator[ActorResult]:
    """Yield the result of each visible actor; `truth` is the table before resampling."""
    actor, error = _settled_errors(pairing)
    for k, identity in enumerate(history.id.tolist()):
        confirmed_ns = int(history.confirmed_ns[k])
        delay = None if confirmed_ns < 0 else (confirmed_ns - _first_visible(truth, identity)) / 1e9
        yield ActorResult(
            id=identity,
            visible=int(history.visible[k]),
            tracked=float(history.tracked[k] / history.visible[k]),
            time_to_confirm=delay,
            id_switches=int(history.switches[k]),
            fragments=int(history.fragments[k]),
            errors=_errors(error[:, actor == identity]),
        )


def _ids(pairing: Pairing, rows: Booleans) -> int:
    """Return how many ids some rows of tracks have."""
    return len(np.unique(pairing.tracks.id[rows]))


def _marked(pairing: Pairing, rows: Booleans) -> tuple[int, int, float]:
    """Return the ids and the samples of some confirmed rows, and their share of all; 0 of none."""
    samples = int(rows.sum())
    return _ids(pairing, rows), samples, samples / max(int(pairing.confirmed.sum()), 1)


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


def _consistency(sums: MeasureSums, quantity: str) -> Consistency:
    """Return the NEES of a quantity over all settled pairs."""
    count, dof = sums.samples(ALL, nees_name(quantity)), float(DEGREES_OF_FREEDOM[quantity])
    if not count:
        return Consistency(0, math.nan, dof, math.nan, math.nan, math.nan)
    return Consistency(
        samples=count,
        mean=sums.value(ALL, nees_name(quantity)),
        expected=dof,
        lower=chi2_quantile(0.025, dof * count) / count,
        upper=chi2_quantile(0.975, dof * count) / count,
        coverage=sums.value(ALL, within_name(quantity)),
    )


def _summary(pairing: Pairing) -> GospaSummary:
    """Return the means of GOSPA over the cycles."""
    options = pairing.options
    penalty = options.gospa_cutoff**options.gospa_order / 2.0
    if len(pairing.gospa):
        mean = float(pairing.gospa_values.mean())
        localisation, missed, false = (pairing.gospa.mean(axis=0) * (1.0, penalty, penalty)).tolist()
    else:
        mean = localisation = missed = false = math.nan
    return GospaSummary(
        cutoff=options.gospa_cutoff,
        order=options.gospa_order,
        alpha=2.0,
        mean=mean,
        power_mean=localisation + missed + false,
        localisation=localisation,
        missed=missed,
        false=false,
    )
