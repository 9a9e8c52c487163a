"""The project's own set of motions in the manner of Han et al. 2015: the three-model IMM, filtered and smoothed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation.imm import Imm
from candaemon.papers.experiment import Advance, Experiment, Result, Row
from candaemon.papers.han_filters import three_models
from candaemon.papers.profiles import Pieces, ProfileMotion, bound, motion
from candaemon.papers.tracking import default_estimator, follow_smoothed, rmse

DT = 0.1
"""s between two measurements."""
CONVERGED_AFTER = 20
"""Steps at the start that are not counted."""
LAG_NS = 1_000_000_000
"""How long an instant is smoothed."""
VARIANCE = 1.0
"""Of the noise of a measured position, m²."""
_SPEED_VARIANCE = 400.0
_REPORTED = (("position x", "m", 0), ("velocity x", "m/s", 2))


def _along(pieces: Pieces, speed: float) -> ProfileMotion:
    return motion(DT, pieces, ((40.0, 0.0),), (speed, 0.0))


MOTIONS = {
    "S1": _along(((40.0, 0.0),), 15.0),
    "S2": _along(((40.0, 3.0),), 0.0),
    "S3": _along(
        ((5.0, 0.0), (7.0, 2.0), (6.0, 0.0), (7.0, -3.0), (5.0, 0.0), (3.0, 1.5), (3.0, -1.5), (4.0, 0.0)), 15.0
    ),
}
"""Constant velocity, constant acceleration, and one that changes: along x, 40 s each."""


@dataclass(frozen=True, slots=True)
class _Tracked:
    """Root mean square errors (6,) of an estimator, filtered and smoothed."""

    filtered: Floats
    smoothed: Floats


def _run(runs: int, seed: int, advance: Advance) -> Result:
    rng = np.random.default_rng(seed)
    rows: list[Row] = []
    for name, truth in MOTIONS.items():
        measured = truth.measured(sqrt(VARIANCE), runs, rng)
        here, default = (_tracked(imm, truth, measured) for imm in (three_models(), default_estimator()))
        best = _errors(bound(truth, measured, sqrt(VARIANCE), sqrt(_SPEED_VARIANCE)), truth)
        rows += _rows(name, "", here.filtered, default.filtered, best.tolist())
        rows += _rows(name, ", 1 s later", here.smoothed, default.smoothed, [None] * 6)
        advance(1 / len(MOTIONS))
    return Result(tuple(rows), ())


def _tracked(imm: Imm, truth: ProfileMotion, measured: Floats) -> _Tracked:
    """Track from the first measurement and a velocity of 0 ± 20 m/s on."""
    noise, velocity_noise = VARIANCE * np.eye(2), _SPEED_VARIANCE * np.eye(2)
    filtered, smoothed, _ = follow_smoothed(imm, LAG_NS, DT, measured, noise, np.zeros(2), velocity_noise)
    return _Tracked(_errors(filtered, truth), _errors(smoothed, truth))


def _errors(estimates: Floats, truth: ProfileMotion) -> Floats:
    return rmse(estimates[CONVERGED_AFTER:], truth.state[CONVERGED_AFTER:])


def _rows(case: str, when: str, here: Floats, default: Floats, best: Sequence[float | None]) -> list[Row]:
    return [
        Row(case, f"{quantity}{when}", unit, "IMM", None, float(here[c]), float(default[c]), best[c])
        for quantity, unit, c in _REPORTED
    ]


EXPERIMENTS = (
    Experiment(
        "000-set",
        "Three-model IMM, filtered and smoothed, on the project's own motions in the manner of paper 000",
        (
            (
                "The set is the project's own, the paper prints no figure of it: S1 15 m/s; S2 3 m/s² from rest; S3 "
                "from 15 m/s on with +2 m/s² at 5 to 12 s, −3 at 18 to 25 s, +1.5 at 30 to 33 s and −1.5 to 36 s; all "
                "along x, 400 steps of 0.1 s with 1 m of noise, the first 20 not counted."
            ),
            (
                "The project's limits on position and velocity of IMM: S1 0.26 m and 0.19 m/s, S2 0.41 and 0.43, S3 "
                "0.58 and 1.08, S3 a second later 0.28 and 0.34."
            ),
            (
                "IMM: constant velocity (noise 1e-3), constant acceleration (1e-3) and changing acceleration (5), each "
                "left at 0.03 1/s. It and the default start at the first measurement with a velocity of 0 ± 20 m/s; "
                "the bound from the truth ± 20 m and ± 20 m/s a step before."
            ),
            (
                "'1 s later' is fixed-lag smoothing: an instant as it is known once the measurements of the second "
                "after it are in. The bound is one of filters, so that it has none there."
            ),
        ),
        _run,
    ),
)
