"""Han et al. 2015: the adaptive Kalman filter on the current statistical model beside that on constant acceleration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from candaemon.arrays import Floats
from candaemon.papers.experiment import Advance, Experiment, Figure, Result, Row
from candaemon.papers.han_figures import figures
from candaemon.papers.han_filters import constant_acceleration, current_statistical, three_models
from candaemon.papers.profiles import ProfileMotion, bound, motion
from candaemon.papers.tracking import QUANTITIES, default_estimator, follow, rmse

_DT = 0.1
_NOTHING_KNOWN, _SPEED_SPREAD = np.zeros(2), 100.0 * np.eye(2)
_WEAVING = ((4.0, 0.0), *(((2.0, 1.3), (2.0, -1.3)) * 8), (4.0, 0.0))


@dataclass(frozen=True, slots=True)
class _MotionCase:
    """A motion at one noise variance (m²); printed figures of each method in the order of the quantities."""

    name: str
    motion: ProfileMotion
    variance: float
    printed: Mapping[str, Sequence[float]]


_MOTIONS = {
    "constant velocity": (
        motion(_DT, ((40.0, 0.0),), ((40.0, 0.0),), (6.0, 0.0)),
        {
            "CA": (0.1119, 0.1015, 0.5429, 0.0935, 0.8933, 0.5534),
            "CS": (0.1854, 0.1212, 0.7292, 0.0057, 0.7017, 0.0498),
        },
    ),
    "constant acceleration": (
        motion(_DT, ((40.0, 3.0),), ((40.0, 0.3),)),
        {
            "CA": (0.1197, 0.1090, 0.2899, 0.1324, 0.5742, 0.0948),
            "CS": (0.1493, 0.1062, 0.3070, 0.1222, 0.5503, 0.0773),
        },
    ),
    "varying acceleration": (
        motion(
            _DT,
            ((5.0, 0.0), (7.0, 2.0), (6.0, 0.0), (7.0, -3.0), (5.0, 0.0), (3.0, 1.5), (3.0, -1.5), (4.0, 0.0)),
            _WEAVING,
            (8.0, 0.0),
        ),
        {
            "CA": (2.4554, 1.9182, 4.1254, 3.1801, 2.2319, 1.0856),
            "CS": (0.2102, 0.6944, 0.8365, 1.5912, 1.5602, 1.4816),
        },
    ),
}
_VARIANCES = (1.0, 0.1)

_LEADER = _MotionCase(
    "lead vehicle",
    motion(
        _DT,
        (
            *((3.0, 0.0), (6.0, 2.0), (5.0, 0.5), (4.0, -1.0), (4.0, -3.0), (4.0, 0.0), (5.0, 3.0), (4.0, 1.0)),
            *((6.0, 0.0), (3.0, -2.5), (4.0, -0.5), (4.0, 1.5), (3.0, 0.0)),
        ),
        ((10.0, 0.0), (3.0, 0.3), (3.0, -0.3), (14.0, 0.0), (4.0, -0.2), (4.0, 0.2), (17.0, 0.0)),
        (10.0, 0.0),
    ),
    0.1,
    {
        "CA": (1.8468, 0.1728, 3.8322, 0.4923, 2.9796, 0.2808),
        "CS": (1.6330, 0.1440, 2.1996, 0.2345, 1.3044, 0.2153),
    },
)


def _table_1(runs: int, seed: int, advance: Advance) -> Result:
    rng = np.random.default_rng(seed)
    rows: list[Row] = []
    drawn: list[Figure] = []
    for variance in _VARIANCES:
        for name, (path, printed) in _MOTIONS.items():
            case = _MotionCase(f"{name}, noise variance {variance:g}", path, variance, printed)
            compared, estimates = _compared(case, runs, rng)
            rows += compared
            if variance == _VARIANCES[0]:
                drawn += figures(f"000-{name.replace(' ', '-')}", name.capitalize(), path, estimates)
            advance(1 / (len(_VARIANCES) * len(_MOTIONS)))
    return Result(tuple(rows), tuple(drawn))


def _table_2(runs: int, seed: int, advance: Advance) -> Result:
    rows, estimates = _compared(_LEADER, runs, np.random.default_rng(seed))
    advance(1.0)
    return Result(tuple(rows), figures("000-lead-vehicle", "Lead vehicle", _LEADER.motion, estimates))


def _compared(case: _MotionCase, runs: int, rng: np.random.Generator) -> tuple[list[Row], dict[str, Floats]]:
    """Return the case's rows, and the estimates (steps, runs, 6) of each method."""
    truth, deviation = case.motion, sqrt(case.variance)
    measured = truth.measured(deviation, runs, rng)
    start = (_DT, measured, case.variance * np.eye(2), _NOTHING_KNOWN, _SPEED_SPREAD)
    estimates = {
        "CA": constant_acceleration(_DT, case.variance, measured),
        "CS": current_statistical(_DT, case.variance, measured),
        "IMM": follow(three_models(), *start),
    }
    default = rmse(follow(default_estimator(), *start), truth.state)
    best = rmse(bound(truth, measured, deviation, 0.0), truth.state)
    rows = []
    for method, each in estimates.items():
        printed = case.printed.get(method)
        here = rmse(each, truth.state)
        rows += [
            Row(
                case.name,
                quantity,
                unit,
                method,
                None if printed is None else printed[c],
                float(here[c]),
                float(default[c]),
                float(best[c]),
            )
            for c, (quantity, unit) in enumerate(QUANTITIES)
        ]
    return rows, estimates


_FILTERS = (
    "The noise of the CA model is not printed: 1e-3 (m/s³)²/Hz, white and continuous; its gains are filterpy's.",
    (
        "α and the limits of the CS model are not printed: α = 0.4 1/s, a_max = 4 m/s² along x and 0.4 m/s² along y, "
        "which of those tried come nearest to table 1; at the limit and beyond it the variance is zero."
    ),
    "Predicted with F x + U ā, ā the current acceleration (17); (28) prints F x alone. q33 of (19) is put right.",
    (
        "CA and CS start from X(0) = 0 and P(0) = I (23), a step before the first measurement; the errors are those of "
        "all steps, so that settling from the wrong first velocity is a large part of them."
    ),
    (
        "IMM, not in the table: constant velocity (noise 1e-3), constant acceleration (1e-3) and changing acceleration "
        "(5), each left at 0.03 1/s. It and the default start from the first measurement and a velocity of 0 ± 10 m/s; "
        "the bound from the true position and velocity and certain of them, for along y CA and CS start on the truth."
    ),
)

EXPERIMENTS = (
    Experiment(
        "000-table-1",
        "CA and CS model in three simulated motions, paper 000 table 1",
        (
            (
                "Speeds and the varying acceleration are not printed: 6 m/s along x where the velocity is constant, "
                "from rest where the acceleration is; from 8 m/s on the varying one is a_x +2 m/s² at 5 to 12 s, −3 at "
                "18 to 25 s, ±1.5 at 30 to 36 s, and a_y ±1.3 m/s², changing every 2 s from 4 to 36 s."
            ),
            (
                "The noise variance is stated as 1 m²; the printed position errors lie below what a filter can reach "
                "with it and fit 0.1 m². Both are run."
            ),
            *_FILTERS,
        ),
        _table_1,
    ),
    Experiment(
        "000-table-2",
        "CA and CS model on a lead vehicle, a simulated stand-in for the drive of paper 000 table 2",
        (
            (
                "The recorded drive is not published. This is a stand-in as long, 55 s at 0.1 s: a vehicle ahead "
                "speeds up and brakes with up to 3 m/s² and changes lanes with up to 0.3 m/s²; x along the road, y to "
                "the left. Only the order of its figures can be compared."
            ),
            "The noise variance is 0.1 m², as fits table 1; the lidar's is not printed.",
            *_FILTERS,
        ),
        _table_2,
    ),
)
