"""Zhang et al. 2016: a vehicle's GNSS track by the current statistical model, alone and switched with CV."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import sqrt

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation.axis_filter import AxisFilter
from candaemon.estimation.filter_bank import FilterBank
from candaemon.estimation.imm import Imm
from candaemon.estimation.manoeuvre_detection import SwitchRule
from candaemon.estimation.motion_models import CurrentStatistical, LinearModel
from candaemon.estimation.switching import CvCsmSwitch
from candaemon.papers.experiment import Advance, Experiment, Figure, Line, Panel, Result, Row
from candaemon.papers.profiles import ProfileMotion, bound, motion
from candaemon.papers.tracking import default_estimator, follow, rmse

_DT = 1.0
_DEVIATION = 8.0
_SPEED, _FIRST_VARIANCE = 5.0, 10.0
_VELOCITY = np.array([_SPEED, 0.0])
_STATISTICAL = CurrentStatistical(0.05, 3.0, 0.0)
_CV_NOISE = 0.1
_RULE = SwitchRule(threshold=0.05, least_change=0.0, manoeuvre_time=10.0, steady_time=20.0, interval=_DT)


@dataclass(frozen=True, slots=True)
class _TestCase:
    """A speed profile along x, with the printed position errors, m, of CSM and of the switch."""

    name: str
    motion: ProfileMotion
    csm: float
    switch: float


_TEST_1 = _TestCase(
    "test 1",
    motion(_DT, ((50.0, 0.2), (50.0, 0.0), (50.0, -0.2)), ((150.0, 0.0),), (_SPEED, 0.0)),
    5.43,
    5.13,
)
_TEST_2 = _TestCase(
    "test 2",
    motion(
        _DT,
        ((30.0, 0.2), (20.0, -0.1), (50.0, 0.0), (50.0, -0.2), (50.0, -0.3)),
        ((200.0, 0.0),),
        (_SPEED, 0.0),
    ),
    5.41,
    5.24,
)


@dataclass(frozen=True, slots=True)
class _SwitchRun:
    """What one method says of x.

    Attributes:
        estimates: position and speed, (steps, runs, 2).
        manoeuvre: how much of the runs it takes for a manoeuvre, (steps,).
    """

    estimates: Floats
    manoeuvre: Floats | None = None


def _run(case: _TestCase, runs: int, seed: int, advance: Advance) -> Result:
    truth = case.motion
    measured = truth.measured(_DEVIATION, runs, np.random.default_rng(seed))
    along = measured[..., 0]
    methods = {"CSM": _statistical(along), "switch": _switched(along), "IMM": _interacting(measured)}
    advance(0.5)
    default = _errors(_plane(default_estimator(), measured), truth)
    best = _errors(bound(truth, measured, _DEVIATION, sqrt(_FIRST_VARIANCE))[..., 0:3:2], truth)
    advance(0.5)
    printed = {("CSM", 0): case.csm, ("switch", 0): case.switch}
    rows = []
    for method, run in methods.items():
        here = _errors(run.estimates, truth)
        rows += [
            Row(case.name, quantity, unit, method, printed.get((method, c)), here[c], default[c], best[c])
            for c, (quantity, unit) in enumerate((("position x", "m"), ("velocity x", "m/s")))
        ]
    return Result(tuple(rows), (_figure(case, methods),))


def _statistical(along: Floats) -> _SwitchRun:
    """Track with CSM alone."""
    steps, runs = along.shape
    csm = AxisFilter(_STATISTICAL)
    csm.spawn(np.tile([0.0, _SPEED, 0.0], (runs, 1)), np.tile(_FIRST_VARIANCE * np.eye(3), (runs, 1, 1)))
    estimates = np.empty((steps, runs, 2))
    for k in range(steps):
        csm.predict(_DT)
        csm.update(along[k], _DEVIATION**2)
        estimates[k] = csm.mean[:, :2]
    return _SwitchRun(estimates)


def _switched(along: Floats) -> _SwitchRun:
    """Track with the paper's algorithm; the manoeuvre is the share of the runs in which it reports CSM."""
    steps, runs = along.shape
    switch = CvCsmSwitch(1, _CV_NOISE, _STATISTICAL, _RULE)
    switch.spawn(np.tile([0.0, _SPEED, 0.0], (runs, 1, 1)), np.tile(_FIRST_VARIANCE * np.eye(3), (runs, 1, 1, 1)))
    estimates, share = np.empty((steps, runs, 2)), np.empty(steps)
    for k in range(steps):
        switch.predict(_DT)
        switch.update(along[k][:, None], _DEVIATION**2)
        estimates[k], share[k] = switch.mean[:, 0, :2], switch.manoeuvring.mean()
    return _SwitchRun(estimates, share)


def _interacting(measured: Floats) -> _SwitchRun:
    """Track with two interacting models; the manoeuvre is the mean probability of the accelerating one."""
    imm = Imm([LinearModel(1, (1e-3, 1e-3)), LinearModel(2, (1e-3, 1e-3))], switch_rate=0.03, acceleration=0.3)
    probability = np.empty(len(measured))

    def note(step: int, bank: FilterBank) -> None:
        probability[step - 1] = bank.probability[:, 1].mean()

    estimates = _plane(imm, measured, note)
    probability[-1] = imm.probability[:, 1].mean()
    return _SwitchRun(estimates, probability)


def _plane(imm: Imm, measured: Floats, before: Callable[[int, FilterBank], None] | None = None) -> Floats:
    """Track in the plane, of which y is noise alone, and return the estimates of x, (steps, runs, 2)."""
    noise, velocity_noise = _DEVIATION**2 * np.eye(2), _FIRST_VARIANCE * np.eye(2)
    return follow(imm, _DT, measured, noise, _VELOCITY, velocity_noise, before)[..., 0:3:2]


def _errors(estimates: Floats, truth: ProfileMotion) -> list[float]:
    """Return the root mean square errors of position and speed over steps and runs."""
    return [float(each) for each in rmse(estimates, truth.state[:, 0:3:2])]


def _figure(case: _TestCase, methods: Mapping[str, _SwitchRun]) -> Figure:
    """Return figures 1 and 2 of the paper, with the speed and what each method holds for a manoeuvre below."""
    time, truth = case.motion.time, case.motion.state[:, 0:3:2]
    error = [
        Line(name, time, np.sqrt(np.square(run.estimates[..., 0] - truth[:, :1]).mean(axis=1)))
        for name, run in methods.items()
    ]
    speed = [Line(name, time, run.estimates[:, 0, 1]) for name, run in methods.items()]
    belief = [Line(name, time, run.manoeuvre) for name, run in methods.items() if run.manoeuvre is not None]
    return Figure(
        f"003-{case.name.replace(' ', '-')}",
        f"{case.name.capitalize()}: positioning error, speed, model",
        (
            Panel("time, s", "rms error of position over runs, m", tuple(error)),
            Panel("time, s", "speed in the first run, m/s", (Line("truth", time, truth[:, 1]), *speed)),
            Panel("time, s", "share of manoeuvre model, mean over runs", tuple(belief)),
        ),
    )


_CHOICES = (
    (
        "The paper prints neither noise nor parameters: white noise of 8 m, α = 0.05 1/s, a_max = 3 m/s², no variance "
        "at the limit and beyond it, CV noise 0.1 (m/s²)²/Hz; with them CSM has the printed error."
    ),
    (
        "(7) compares filtered speeds of the CV filter one sample apart, (8) with 5 % of its speed; T1 = 10 s and "
        "T2 = 20 s without a break. Both filters always run; the paper lets CSM start anew when a manoeuvre begins."
    ),
    "G is [T²/2; T], which the paper misprints; here the noise is continuous and its matrix exact.",
    "The 5 % threshold does not see an acceleration below 0.05 v/T: in test 1 that of 0.2 m/s² from 4 m/s on.",
    (
        "All start from P(0) = 10 I and 5 m/s: CSM, the switch and the bound in the origin a step before the first "
        "measurement, IMM and the default at it, with its noise."
    ),
    (
        "IMM, not in the paper: constant velocity and constant acceleration, noise 1e-3 each, left at 0.03 1/s. It and "
        "the default track in the plane, with 8 m of noise on y too."
    ),
)

EXPERIMENTS = (
    Experiment(
        "003-test-1",
        "CSM alone and switched with CV, paper 003 test 1 (figure 1)",
        _CHOICES,
        partial(_run, _TEST_1),
    ),
    Experiment(
        "003-test-2",
        "CSM alone and switched with CV, paper 003 test 2 (figure 2)",
        (*_CHOICES, "As printed the vehicle ends reversing at 16 m/s; it is driven as printed."),
        partial(_run, _TEST_2),
    ),
)
