"""Avatirak et al. 2012: two radars follow a vehicle that turns left, by MLKF and trilateration and by EKF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation.motion_models import CoordinatedTurn
from candaemon.papers.avatirak_filters import SAMPLE, by_default, first_motion, mlkf, turning_ekf
from candaemon.papers.avatirak_scenario import DEVIATIONS, SENSORS, STEP, LeftTurn
from candaemon.papers.experiment import Advance, Experiment, Figure, Line, Panel, Result, Row
from candaemon.papers.range_ekf import range_ekf
from candaemon.papers.tracking import QUANTITIES, rmse

_TURNING, _STEADY = CoordinatedTurn(1.0, 0.1), CoordinatedTurn(0.0, 0.0)
_DRAWN = 5


@dataclass(frozen=True, slots=True)
class _TurnCase:
    """A scenario, with the figures of Table I in the order of the quantities."""

    name: str
    turn: LeftTurn
    mlkf: tuple[float, ...]
    ekf: tuple[float, ...]

    @property
    def printed(self) -> Mapping[str, tuple[float, ...]]:
        """The printed figures of the methods that the paper has."""
        return {"MLKF without centripetal term": self.mlkf, "MLKF": self.mlkf, "EKF": self.ekf}


_CASES = (
    _TurnCase(
        "s1",
        LeftTurn(speed=11.0, radius=15.0, duration=0.8),
        (0.0057, 0.0119, 0.2760, 0.0751, 0.3702, 0.5013),
        (0.0124, 0.0244, 0.0760, 0.1220, 0.3164, 0.3738),
    ),
    _TurnCase(
        "s2",
        LeftTurn(speed=30.0, radius=10.0, duration=0.4),
        (0.0179, 0.0115, 0.4801, 1.6222, 1.3555, 0.9077),
        (0.6232, 0.0813, 4.8145, 0.2584, 13.762, 8.6387),
    ),
    _TurnCase(
        "s3",
        LeftTurn(speed=20.0, radius=15.0, duration=0.6),
        (0.0202, 0.0113, 0.4879, 1.6149, 1.1348, 0.9540),
        (0.6194, 0.0809, 4.7501, 0.2642, 13.689, 8.5746),
    ),
)


def _table_1(runs: int, seed: int, advance: Advance) -> Result:
    rng = np.random.default_rng(seed)
    rows: list[Row] = []
    drawn: list[Figure] = []
    total = sum(case.turn.duration for case in _CASES)
    for case in _CASES:
        compared, figure = _compared(case, runs, rng, _share(advance, case.turn.duration / total))
        rows += compared
        drawn.append(figure)
    return Result(tuple(rows), tuple(drawn))


def _share(advance: Advance, share: float) -> Advance:
    """Return the progress callback of a step that is such a share of the whole."""
    return lambda done: advance(done * share)


def _compared(case: _TurnCase, runs: int, rng: np.random.Generator, advance: Advance) -> tuple[list[Row], Figure]:
    """Return the case's rows, errors at its last instant, and its drawing."""
    turn = case.turn
    printed_way = turn.measured(runs, rng, centripetal=False)
    measured = turn.measured(runs, rng)
    filtered, spread = mlkf(measured)
    estimates = {"MLKF without centripetal term": mlkf(printed_way, centripetal=False)[0], "MLKF": filtered}
    advance(0.1)
    estimates["EKF"] = _ekf(measured, _share(advance, 0.7))
    estimates["turning EKF"] = turning_ekf(measured, _TURNING)
    last = turn.truth[-1:]
    default = rmse(by_default(filtered, spread)[None], last)
    best = rmse(turning_ekf(measured, _STEADY)[-1:], last)
    advance(0.2)
    here = {method: rmse(each[-1:], last) for method, each in estimates.items()}
    rows = [
        Row(
            case.name,
            quantity,
            unit,
            method,
            case.printed[method][c] if method in case.printed else None,
            float(here[method][c]),
            float(default[c]),
            float(best[c]),
        )
        for c, (quantity, unit) in enumerate(QUANTITIES)
        for method in estimates
    ]
    return rows, _figure(case, estimates)


def _ekf(measured: Floats, advance: Advance) -> Floats:
    """Return what the paper's EKF makes of the ranges."""
    first = first_motion(measured).state
    first[:, 4:] = 0.0
    return range_ekf(measured[..., 0], SENSORS, float(DEVIATIONS[0]), STEP, first, SAMPLE, advance)


def _figure(case: _TurnCase, estimates: Mapping[str, Floats]) -> Figure:
    """Return the paths of the first run, and the errors over time as figure 4 of the paper has them, over all runs."""
    truth = case.turn.truth[SAMPLE - 1 :: SAMPLE]
    time = case.turn.time[SAMPLE - 1 :: SAMPLE]
    kept = slice(_DRAWN - 1, None, _DRAWN)
    paths = [Line(name, each[kept, 0, 0], each[kept, 0, 1]) for name, each in estimates.items()]
    errors = {name: np.sqrt(np.square(each - truth[:, None]).mean(axis=1)) for name, each in estimates.items()}
    return Figure(
        f"001-{case.name}",
        f"Scenario {case.name}: path of the tracked corner before the host, rms errors over runs",
        (
            Panel("x to the right, m", "y forward, m", (Line("truth", truth[:, 0], truth[:, 1]), *paths), equal=True),
            *(
                Panel(
                    "time, s", f"{quantity}, {unit}", tuple(Line(n, time[kept], e[kept, c]) for n, e in errors.items())
                )
                for c, (quantity, unit) in enumerate(QUANTITIES)
            ),
        ),
    )


_CHOICES = (
    (
        "The point that starts at (5, 10) m is the closest point of the outline, as the text below (29) has it: the "
        "rear left corner, by (20) to (22) fixed to the vehicle. No other corner comes nearer; late in s1 a point of "
        "the flank does, but one that slides along the flank is not that of (20)."
    ),
    "Speed and radius are those of the vehicle's centre; the corner has its own, by the vehicle's turning.",
    "The host drives at 21 m/s in s2 and s3 too, where the paper names no speed.",
    "s3 prints an acceleration of −8.06 m/s², which is that of s1; v²/R = 26.7 is driven.",
    (
        "MLKF without centripetal term: the simulated range accelerations lack it, as in (26), and so does (12). All "
        "others measure the true second derivative of range, and MLKF takes the term off before (12)."
    ),
    "F of MLKF has T²/2; D is a floor of 0.3 (m/s²)² under K33, as the printed D makes the variance negative.",
    "MLKF starts from the first measurement, with K[1|0] = I as printed.",
    (
        "EKF: Q₁ = 0 and K[1|0] = I as printed; it starts from position and velocity of the first trilateration and no "
        "acceleration, as the paper names no start."
    ),
    (
        "turning EKF, not in the paper: a coordinated turn over ground by range and range rate, the host's speed "
        "known; noise 1 (m/s²)²/Hz on velocity, 0.1 (rad/s²)²/Hz on the turn rate."
    ),
    (
        "The default estimator gets the positions that MLKF and trilateration tell every 10 ms, with their "
        "covariances. s2 turns at 3 rad/s under 90 m/s², more than it takes a vehicle to be able to."
    ),
    "The bound is the turning EKF told that speed and turn rate never change: without noise in its model.",
)

EXPERIMENTS = (
    Experiment(
        "001-table-1",
        "A left turn before two radars: MLKF with trilateration and EKF, paper 001 table I",
        _CHOICES,
        _table_1,
    ),
)
