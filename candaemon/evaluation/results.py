"""Results of an evaluation. Field names and nesting are those of `evaluate --json`: they are stable.

A figure without samples is NaN here and null in JSON.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Options:
    """Parameters of an evaluation.

    Attributes:
        gate: m; greatest distance of a pair; a track farther than this from every true object is false.
        velocity_gate: m/s; greatest difference in velocity of a pair: what drives through an actor is not its track.
        settle: s after a track's confirmation that errors and NEES exclude.
        max_gap: s; longest step of truth that is bridged by interpolation.
        gospa_cutoff: c of GOSPA, m.
        gospa_order: p of GOSPA.
        patience: s for which an actor has been visible without a break until a cycle without a track counts as missed.
    """

    gate: float = 4.0
    velocity_gate: float = 15.0
    settle: float = 1.0
    max_gap: float = 0.2
    gospa_cutoff: float = 4.0
    gospa_order: float = 2.0
    patience: float = 1.0


@dataclass(frozen=True, slots=True)
class Errors:
    """RMSE of settled tracks paired with a visible actor, vehicle axes.

    Attributes:
        samples: pairs.
        position: in the plane, m; its components are `x` and `y`.
        x: forward, m.
        y: to the left, m.
        velocity: over ground in the plane, m/s; its components are `vx` and `vy`.
        vx: forward, m/s.
        vy: to the left, m/s.
        acceleration: over ground in the plane, m/s²; its components are `ax` and `ay`.
        ax: forward, m/s².
        ay: to the left, m/s².
    """

    samples: int
    position: float
    x: float
    y: float
    velocity: float
    vx: float
    vy: float
    acceleration: float
    ax: float
    ay: float


@dataclass(frozen=True, slots=True)
class Consistency:
    """NEES of some of x, y, vx, vy from `sx`, `sy`, `svx`, `svy`: the table holds only the covariance's diagonal.

    Attributes:
        samples: pairs with the standard deviations.
        mean: mean NEES.
        expected: degrees of freedom: the mean of a consistent filter.
        lower: lower 95 % bound of the mean of `samples` independent samples; a track's errors are not independent
            from cycle to cycle, so the true bounds are wider.
        upper: upper 95 % bound of the same.
        coverage: share of samples within the 95 % quantile of χ² with these degrees of freedom; 0.95 if consistent.
    """

    samples: int
    mean: float
    expected: float
    lower: float
    upper: float
    coverage: float


@dataclass(frozen=True, slots=True)
class GospaSummary:
    """GOSPA over the visible actors. A track near a hidden actor or a stationary object is not counted as false.

    Attributes:
        cutoff: c, m.
        order: p.
        alpha: α, always 2.
        mean: mean over the cycles, m.
        power_mean: mean of its p-th power, m^p: the sum of the three parts.
        localisation: mean part of the pairs' distances, m^p.
        missed: mean part of missed actors, c^p / 2 each, m^p.
        false: mean part of false tracks, c^p / 2 each, m^p.
    """

    cutoff: float
    order: float
    alpha: float
    mean: float
    power_mean: float
    localisation: float
    missed: float
    false: float


@dataclass(frozen=True, slots=True)
class FalseTracks:
    """Confirmed tracks farther than the gate from every actor (hidden ones included) and every stationary object.

    Attributes:
        ids: tracks with one such sample or more.
        samples: such samples.
        share: of all confirmed samples.
    """

    ids: int
    samples: int
    share: float


@dataclass(frozen=True, slots=True)
class Duplicates:
    """Confirmed samples with another one within 3 m in x, 1 m in y and 1 m/s in vx.

    Attributes:
        ids: tracks with one such sample or more.
        samples: such samples.
        share: of all confirmed samples.
    """

    ids: int
    samples: int
    share: float


@dataclass(frozen=True, slots=True)
class Surplus:
    """Confirmed samples within the gate of an actor that another track is paired with, its box where truth has one.

    Attributes:
        ids: tracks with one such sample or more.
        samples: such samples.
        share: of all confirmed samples.
    """

    ids: int
    samples: int
    share: float


@dataclass(frozen=True, slots=True)
class Missed:
    """Cycles without a track of an actor that had been visible for `Options.patience` without a break.

    Attributes:
        awaited: cycles of actors visible for so long, one an actor a cycle.
        samples: those of them without a track.
        share: of all awaited.
    """

    awaited: int
    samples: int
    share: float


@dataclass(frozen=True, slots=True)
class BoxErrors:
    """RMSE of what only a body has, over settled pairs with a visible actor; null where a table lacks the columns.

    Attributes:
        heading: deg, of vehicles that move at more than 2 m/s.
        heading_known: share of their samples in which the track has a heading.
        yaw_rate: rad/s.
        length: relative, of tracks that are 3 s old and have seen two sides of the actor for half a second.
        width: likewise.
        length_right: share of those samples in which the length is right within a quarter.
        width_right: likewise.
        center: of the box, in the plane, m.
    """

    heading: float
    heading_known: float
    yaw_rate: float
    length: float
    width: float
    length_right: float
    width_right: float
    center: float


@dataclass(frozen=True, slots=True)
class GroupErrors:
    """Errors of a group of pairs.

    Attributes:
        by: what the pairs are grouped by: `all`, `age` (s since confirmation, settling included), `range`,
            `visibility` (`hidden` pairs are in no other group), `manoeuvre` (the actor's acceleration), `motion` or
            `target` (the actor's class; `point` where it has no box).
        group: which group of these.
        samples: pairs.
        position: RMSE in the plane, m.
        along: RMSE along the actor's course over ground, or along its heading while it stands, m.
        across: RMSE across it, m.
        velocity: RMSE in the plane, m/s.
        velocity_along: RMSE along the course, m/s.
        velocity_across: RMSE across it, m/s.
        box: RMSE of the body.
        nees: mean NEES of x, y, vx, vy.
        coverage: share of samples within its 95 % bound.
    """

    by: str
    group: str
    samples: int
    position: float
    along: float
    across: float
    velocity: float
    velocity_along: float
    velocity_across: float
    box: BoxErrors
    nees: float
    coverage: float


@dataclass(frozen=True, slots=True)
class ActorResult:
    """Result of one actor that was visible at least once.

    Attributes:
        id: as in the truth.
        visible: cycles in which it was visible.
        tracked: share of those in which it had a track.
        time_to_confirm: s from when it is first visible to the first cycle with a confirmed track; null if never.
        id_switches: how often its track's id changed.
        fragments: how often it regained a track after visible cycles without one.
        errors: RMSE.
    """

    id: int
    visible: int
    tracked: float
    time_to_confirm: float | None
    id_switches: int
    fragments: int
    errors: Errors


@dataclass(frozen=True, slots=True)
class TimeToConfirm:
    """Delay from when an actor is first visible to its first confirmed track.

    Attributes:
        mean: over the confirmed actors, s.
        max: the longest, s.
        unconfirmed: visible actors that never had a confirmed track.
    """

    mean: float
    max: float
    unconfirmed: int


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Tracks against truth.

    Attributes:
        options: parameters of the evaluation.
        cycles: times compared.
        skipped: times of tracks that truth does not cover.
        confirmed_ids: confirmed tracks at the times compared.
        confirmed_samples: their samples, one a track a cycle.
        errors: RMSE over all actors.
        nees: consistency of the standard deviations of x, y, vx, vy.
        gospa: GOSPA and its parts.
        id_switches: sum over the actors.
        fragments: sum over the actors.
        time_to_confirm: over the actors.
        false_tracks: tracks far from every true object.
        duplicates: several tracks of one object.
        actors: one entry per actor that was visible.
        nees_of: consistency of x, y, vx, vy, position and velocity, each alone.
        surplus: further tracks of actors that have one.
        missed: actors in sight without a track.
        groups: errors by age, range, visibility, manoeuvre and motion; the first is of all pairs.
    """

    options: Options
    cycles: int
    skipped: int
    confirmed_ids: int
    confirmed_samples: int
    errors: Errors
    nees: Consistency
    gospa: GospaSummary
    id_switches: int
    fragments: int
    time_to_confirm: TimeToConfirm
    false_tracks: FalseTracks
    duplicates: Duplicates
    actors: tuple[ActorResult, ...]
    nees_of: dict[str, Consistency]
    surplus: Surplus
    missed: Missed
    groups: tuple[GroupErrors, ...]

    def to_json(self) -> str:
        """Return it as JSON text; the keys are the fields' names."""
        return json.dumps(_without_nan(asdict(self)), indent=2, allow_nan=False) + "\n"


def _without_nan(value: Any) -> Any:
    """Replace NaN by None throughout a tree of dicts and sequences."""
    if isinstance(value, dict):
        return {key: _without_nan(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nan(one) for one in value]
    return None if isinstance(value, float) and math.isnan(value) else value
