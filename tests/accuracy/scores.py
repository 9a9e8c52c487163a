"""The score of a run, which adds up over runs: sums of measures of pairs, and counts of the drive."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, Floats
from candaemon.evaluation.pair_errors import (
    ALL,
    MOVING,
    SIZE_TOLERANCE,
    SIZED_AFTER,
    TWO_SIDES_FOR,
    MeasureSums,
    measure,
)
from candaemon.evaluation.pairing import Pairing, histories, pair
from candaemon.evaluation.results import Options
from candaemon.evaluation.tables import TrackTable
from tests.accuracy.oracle import Sources
from tests.accuracy.simulated_runs import TrackRows

MEMORY: Final = 3.0
"""s without a detection after which no tracker could tell where an actor is."""
OPTIONS: Final = Options(settle=0.0, gospa_cutoff=10.0, gospa_order=2.0)

LEGEND: Final = (
    ("position, velocity", "2-D RMSE of confirmed obstacles paired with an actor that some sensor can see, m and m/s"),
    ("along, across", "of the target's course over ground (of its heading while it stands)"),
    (
        "paired",
        f"at most {OPTIONS.gate:g} m and {OPTIONS.velocity_gate:g} m/s apart, one to one, last cycle's pairs first;",
    ),
    ("", "no pair begins with a track that is nearer to a stationary object, or to another actor's box"),
    ("GOSPA", f"c = {OPTIONS.gospa_cutoff:g} m, p = {OPTIONS.gospa_order:g}, α = 2, mean over the cycles, m"),
    ("switches", "changes of the id that an actor's obstacle has, a minute"),
    ("duplicates", "confirmed samples within the gate of an actor that another obstacle is paired with, share of all"),
    ("false", f"confirmed obstacles that come to lie more than {OPTIONS.gate:g} m from every true object, a minute"),
    ("missed", f"cycles without an obstacle of an actor visible for {OPTIONS.patience:g} s without a break, share"),
    (
        "undetected",
        f"those cycles of them in which no sensor had detected the actor in the last {MEMORY:g} s: what a tracker",
    ),
    ("", "misses that reports each actor from its first detection on, and knows where it is without one for so long"),
    ("least", "GOSPA of a tracker that misses what is undetected alone, tells nothing false, and whose places are as"),
    ("", "wrong as the project's"),
    ("moving", f"a target faster than {MOVING:g} m/s over ground"),
    ("heading", "RMS over moving vehicles, deg; known: share of their samples with a heading"),
    (
        "length, width",
        f"RMS of the relative error from {SIZED_AFTER:g} s after confirmation on, where two sides were seen",
    ),
    (
        "length_right, width_right",
        f"JSON: share of those samples within {SIZE_TOLERANCE:.0%}",
    ),
    ("two sides seen", f"some sensor could see two sides of the box for {TWO_SIDES_FOR:g} s of the obstacle's life"),
    ("NEES", "eᵀ P⁻¹ e of [x, y, vx, vy] with the whole covariance, 4 expected; 95 %: share within its 95 % bound"),
    ("age", "s since the obstacle's confirmation"),
    ("hidden", "the actor is in no field of view, or covered; counts in no other line"),
    ("manoeuvre", "the target's acceleration over ground"),
    ("target", "class of the actor in the truth; point: it has no box"),
    ("N", "a constant-velocity Kalman filter with range rate for each slot of the radar, every live slot an obstacle"),
    ("", "paired alike for all process noises, as the middle one of the grid; the best over the whole set is taken"),
    ("O", "the project's default estimator, given the true association"),
)
"""What the figures mean: name and text."""


@dataclass(frozen=True, slots=True)
class Score:
    """What a tracker did in some runs.

    Attributes:
        sums: of the measures of its pairs.
        runs: how many.
        cycles: compared.
        seconds: of the drives.
        gospa: sum over the cycles, m.
        switches: of ids.
        fragments: tracks regained.
        confirmed: samples of confirmed obstacles.
        surplus: those that are duplicates.
        false: ids that were false.
        awaited, missed: cycles of visible actors, those without an obstacle.
        broken: samples whose place or velocity is no number.
        undetected: awaited cycles of actors that no sensor has detected in the last `MEMORY` s.
        least_gospa: sum over the cycles of what missing those alone costs, m.
    """

    sums: MeasureSums
    runs: int
    cycles: int
    seconds: float
    gospa: float
    switches: int
    fragments: int
    confirmed: int
    surplus: int
    false: int
    awaited: int
    missed: int
    broken: int = 0
    undetected: int = 0
    least_gospa: float = 0.0

    def __add__(self, other: Score) -> Score:
        return Score(*(getattr(self, name) + getattr(other, name) for name in Score.__slots__))

    def value(self, name: str, group: tuple[str, str] = ALL) -> float:
        """Return a measure's mean (its root, where it is a square) over a group of pairs."""
        return self.sums.value(group, name)

    def figures(self) -> dict[str, float]:
        """Return the figures of the drives, by name."""
        minutes = self.seconds / 60.0
        return {
            **{name: self.value(name) for name in PAIR_FIGURES},
            "gospa": self.gospa / self.cycles if self.cycles else math.nan,
            "least_gospa": self.least_gospa / self.cycles if self.cycles else math.nan,
            "switches": self.switches / minutes,
            "duplicates": self.surplus / self.confirmed if self.confirmed else 0.0,
            "false": self.false / minutes,
            "missed": self.missed / self.awaited if self.awaited else math.nan,
            "undetected": self.undetected / self.awaited if self.awaited else math.nan,
            "broken": float(self.broken),
        }


PAIR_FIGURES: Final = (
    "position", "along", "across", "velocity", "v_along", "v_across", "heading", "heading_known", "length",
    "length_right", "width", "width_right", "center", "nees_state", "within_state", "nees_position", "within_position",
    "nees_velocity", "within_velocity", "nees_x", "nees_y", "nees_vx", "nees_vy",
)  # fmt: skip
"""Measures told of all pairs and of each group."""


def scored(rows: TrackRows, truth: TrackTable, detected: Sources | None = None) -> Score:
    """Return the score of one run's tracks; told what the detections are of, with what no tracker can know."""
    pairing = pair(rows.table, truth, OPTIONS)
    score = replace(score_of(pairing, rows.covariance), broken=rows.broken)
    if detected is None:
        return score
    undetected = _undetected(pairing, detected)
    return replace(
        score,
        undetected=int(np.count_nonzero(undetected & pairing.awaited)),
        least_gospa=_least_gospa(pairing, undetected, score.value("position")),
    )


def _undetected(pairing: Pairing, detected: Sources) -> Booleans:
    """Return which rows of the truth are of actors that no sensor had detected for `MEMORY` s."""
    truth = pairing.truth
    undetected = np.ones(len(truth.id), dtype=np.bool_)
    for actor in np.unique(truth.id).tolist():
        times = np.array(
            sorted(time_ns for (_, time_ns), of in detected.items() if actor in of.values()), dtype=np.int64
        )
        rows = np.flatnonzero(truth.id == actor)
        latest = np.searchsorted(times, truth.time_ns[rows], side="right") - 1
        seen = latest >= 0
        rows, latest = rows[seen], latest[seen]
        undetected[rows] = truth.time_ns[rows] - times[latest] > MEMORY * 1e9
    return undetected


def _least_gospa(pairing: Pairing, undetected: Booleans, error: float) -> float:
    """Return the sum of the cycles' GOSPA where these alone are missed and the rest is told with an error, m."""
    cost = np.where(undetected, OPTIONS.gospa_cutoff**2 / 2, 0.0 if math.isnan(error) else error**2)
    visible = np.flatnonzero(pairing.visible)
    cycle = np.searchsorted(pairing.times_ns, pairing.truth.time_ns[visible])
    return float(np.sqrt(np.bincount(cycle, cost[visible])).sum())


def score_of(pairing: Pairing, covariance: Floats | None) -> Score:
    """Return the score of one run's pairs, with the covariance of its tracks where they tell it."""
    history = histories(pairing)
    times = pairing.times_ns
    return Score(
        sums=measure(pairing, covariance),
        runs=1,
        cycles=len(times),
        seconds=float(times[-1] - times[0]) / 1e9 if len(times) else 0.0,
        gospa=float(pairing.gospa_values.sum()),
        switches=int(history.switches.sum()),
        fragments=int(history.fragments.sum()),
        confirmed=int(pairing.confirmed.sum()),
        surplus=int(pairing.surplus.sum()),
        false=len(np.unique(pairing.tracks.id[pairing.false])),
        awaited=int(history.awaited.sum()),
        missed=int(history.missed.sum()),
    )
