"""The project's automotive set: a radar with range rate tracks a vehicle that cruises, brakes, cuts in and turns."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation.imm import Imm
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.motion_models import CoordinatedTurn, LinearModel, MotionModel
from candaemon.papers.experiment import Advance, Experiment, Result, Row
from candaemon.papers.tracking import default_estimator

DT = 0.05
"""s between two measurements."""
RANGE, AZIMUTH, RANGE_RATE = 0.25, radians(0.5), 0.12
"""Standard deviations of the noise: m, rad, m/s."""
_CONVERGED_AFTER = 20
_SPEED_ACROSS = 8.0
_PARTS = 50
_AT_REST = np.zeros(2)
_MEASURES = (("position in the plane", "m", True), ("velocity in the plane", "m/s", True), ("mean NIS", "1", False))
"""Quantity of a row, its unit, and whether it is an error."""


@dataclass(frozen=True, slots=True)
class AutomotiveDrive:
    """A vehicle's motion before a radar at rest in the origin.

    Attributes:
        duration: s.
        start: x, y in m and vx, vy in m/s at time 0; x ahead, y to the left.
        pushes: (from s, to s, ax, ay in m/s²), one after another.
        turns: (from s, to s, rad/s), positive to the left.
    """

    duration: float
    start: tuple[float, float, float, float]
    pushes: tuple[tuple[float, float, float, float], ...] = ()
    turns: tuple[tuple[float, float, float], ...] = ()

    def states(self) -> Floats:
        """Return [x, y, vx, vy] at 0, DT, …, (steps, 4), integrated in fiftieths of a step."""
        dt = DT / _PARTS
        steps = round(self.duration / DT)
        middle = (np.arange(steps * _PARTS) + 0.5) * dt
        acceleration, rate = np.zeros((len(middle), 2)), np.zeros(len(middle))
        for first, last, *push in self.pushes:
            acceleration[(middle >= first) & (middle < last)] = push
        for first, last, turn in self.turns:
            rate[(middle >= first) & (middle < last)] = turn
        # the vehicle turns or is pushed, never both: the heading turns the first velocity alone
        heading = np.cumsum(rate * dt)[:, None]
        vx, vy = self.start[2:]
        turned = np.cos(heading) * (vx, vy) + np.sin(heading) * (-vy, vx)
        velocity = np.concatenate([[(vx, vy)], turned + np.cumsum(acceleration * dt, axis=0)])
        moved = np.cumsum((velocity[:-1] + velocity[1:]) * dt / 2, axis=0)
        position = self.start[:2] + np.concatenate([np.zeros((1, 2)), moved])
        return np.concatenate([position, velocity], axis=1)[:-1:_PARTS]


DRIVES = {
    "cruise": AutomotiveDrive(20.0, (40.0, 1.0, -1.0, 0.0)),
    "brake": AutomotiveDrive(20.0, (100.0, 1.0, 0.0, 0.0), pushes=((6.0, 8.0, -6.0, 0.0), (10.0, 14.0, 3.0, 0.0))),
    "cut-in": AutomotiveDrive(
        20.0,
        (30.0, 3.5, 1.0, 0.0),
        pushes=((8.0, 9.5, 0.0, -1.556), (9.5, 11.0, 0.0, 1.556), (12.0, 15.0, -1.0, 0.0)),
    ),
    "turn": AutomotiveDrive(9.0, (70.0, -30.0, 0.0, 10.0), turns=((3.0, 3.0 + pi / 2 / 0.6, 0.6),)),
}


def three_models() -> Imm:
    """Return the IMM of the set, constant velocity, changing acceleration and turning, without tracks."""
    models: list[MotionModel] = [LinearModel(1, (1e-3, 1e-3)), LinearModel(2, (5.0, 5.0)), CoordinatedTurn(0.01, 0.1)]
    return Imm(models, switch_rate=0.2, acceleration=3.0, turn_rate=0.3)


def _run(runs: int, seed: int, advance: Advance) -> Result:
    rng = np.random.default_rng(seed)
    rows: list[Row] = []
    for case, drive in DRIVES.items():
        truth = drive.states()
        measured = _measured(truth, runs, rng)
        here, default = (_figures(imm, truth, measured) for imm in (three_models(), default_estimator()))
        rows += [
            Row(case, quantity, unit, "IMM", None, here[m], default[m], error=error)
            for m, (quantity, unit, error) in enumerate(_MEASURES)
        ]
        advance(1 / len(DRIVES))
    return Result(tuple(rows), ())


def _measured(truth: Floats, runs: int, rng: np.random.Generator) -> Floats:
    """Return range, azimuth and range rate of states (steps, 4) with their noise, (steps, 3, runs)."""
    x, y, vx, vy = truth.T
    distance = np.hypot(x, y)
    exact = np.stack([distance, np.arctan2(y, x), (x * vx + y * vy) / distance], axis=1)
    noise = np.array([RANGE, AZIMUTH, RANGE_RATE])[:, None] * rng.normal(size=(len(truth), 3, runs))
    return np.asarray(exact[:, :, None] + noise)


def _measurement(polar: Floats) -> Measurement:
    """Return the measured range, azimuth and range rate that a filter gets, (3, runs)."""
    distance, azimuth, rate = polar
    sight, runs = _sight(azimuth), len(distance)
    spread = np.zeros((runs, 2, 2))
    spread[:, 0, 0], spread[:, 1, 1] = RANGE**2, (distance * AZIMUTH) ** 2
    return Measurement(
        distance[:, None] * sight[:, :, 0],
        sight @ spread @ np.swapaxes(sight, 1, 2),
        _AT_REST,
        _AT_REST,
        rate,
        np.full(runs, RANGE_RATE**2),
    )


def _sight(azimuth: Floats) -> Floats:
    """Return the matrices (n, 2, 2) whose columns are the directions along and across the line of sight."""
    c, s = np.cos(azimuth), np.sin(azimuth)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def _figures(imm: Imm, truth: Floats, measured: Floats) -> tuple[float, float, float]:
    """Track from the first scan on; return the errors of position and velocity in the plane, and the mean NIS."""
    _spawn(imm, measured[0])
    every, direction = np.arange(len(imm)), np.tile([1.0, 0.0], (len(imm), 1))
    errors, nis = [], []
    for k in range(1, len(truth)):
        imm.predict(DT, direction)
        fit = imm.update(every, _measurement(measured[k]))
        if k >= _CONVERGED_AFTER:
            errors.append(imm.combined()[0][:, :4] - truth[k])
            nis.append(fit)
    squared = np.square(errors).mean(axis=(0, 1))
    return float(np.sqrt(squared[:2].sum())), float(np.sqrt(squared[2:].sum())), float(np.mean(nis))


def _spawn(imm: Imm, polar: Floats) -> None:
    """Begin the tracks with the range rate along the line of sight, and a velocity across it of 0 ± 8 m/s."""
    _, azimuth, rate = polar
    first, sight = _measurement(polar), _sight(azimuth)
    spread = sight @ np.diag([RANGE_RATE**2, _SPEED_ACROSS**2]) @ np.swapaxes(sight, 1, 2)
    imm.spawn(first.position, first.noise, rate[:, None] * sight[:, :, 0], spread)


EXPERIMENTS = (
    Experiment(
        "000-automotive",
        "Three-model IMM and the default on the project's own automotive set, with range rate",
        (
            (
                "The set is the project's own, no paper prints a figure of it: every 0.05 s a radar in the origin "
                "measures range, azimuth and range rate with noise of 0.25 m, 0.5° and 0.12 m/s; 400 steps, 180 of the "
                "turn, the first 20 not counted."
            ),
            (
                "Cruise: from 40 m at −1 m/s. Brake: 100 m ahead, −6 m/s² at 6 to 8 s and +3 at 10 to 14 s. Cut-in: "
                "from 30 m ahead and 3.5 m to the left at 1 m/s, over at 8 to 11 s with ∓1.556 m/s², −1 m/s² at 12 to "
                "15 s. Turn: across at 10 m/s, from 3 s on through 90° to the left with 0.6 rad/s."
            ),
            (
                "The project's limits on position and velocity of IMM: cruise 0.085 m and 0.087 m/s, brake 0.235 and "
                "0.49, cut-in 0.17 and 0.49, turn 0.165 and 0.24; on the mean NIS, of three degrees of freedom, 2.7 to "
                "3.3."
            ),
            (
                "IMM: constant velocity (noise 1e-3), changing acceleration (5) and turn (0.01 on the velocity, 0.1 on "
                "the turn rate), each left at 0.2 1/s. Both start with the measured range rate along the line of sight "
                "and a speed of 0 ± 8 m/s across it; no bound is told."
            ),
        ),
        _run,
    ),
)
