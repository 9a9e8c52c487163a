"""The two sweeps, section 4.1: over the noise of the lidar, and over the acceleration of the vehicle.

Source: Gao et al. 2016.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from candaemon.arrays import Floats
from candaemon.papers.experiment import Advance, Result, Row
from candaemon.papers.gao_drives import accelerated
from candaemon.papers.gao_figures import adaptation_figure, sweep_figure
from candaemon.papers.gao_filters import NOMINAL, QUANTITIES, Outcome, filtered, record

VARIANCES = np.linspace(0.03, 5.93, 60)
ACCELERATIONS = np.linspace(0.18, 6.08, 60)
WARM_UP = 500
"""Samples before the noise begins to rise."""
SPAN = 100
"""Samples at one variance of the noise."""
SAMPLES = 300
"""Samples at one acceleration."""

_START = np.array((0.0, 2.0, 0.18))
_DEFAULT, _BOUND = "default", "bound"
_BATCH = 10

_NOISE_PRINTED = ((0.2323, 0.0837, 0.0237), (0.0818, 0.0689, 0.0171))
_ACCELERATION_PRINTED = ((0.0403, 0.0664, 0.0737), (0.0261, 0.0643, 0.0346))


def noise_sweep(runs: int, seed: int, advance: Advance, variances: Floats = VARIANCES) -> Result:
    """Let the lidar's noise rise in one drive, variance by variance."""
    lidar = np.concatenate([np.full(WARM_UP, variances[0]), np.repeat(variances, SPAN)])
    variance = np.stack([lidar, np.full(len(lidar), NOMINAL[1])])
    truth = accelerated(len(lidar), _START[1], _START[2])[:, None]
    outcome = filtered(record(truth, variance, _START, runs, np.random.default_rng(seed)), advance)

    def by_span(estimates: Floats) -> Floats:
        error = np.square(estimates - truth)[WARM_UP:].reshape(len(variances), SPAN, runs, 3)
        return np.asarray(np.sqrt(error.mean(axis=(1, 2))))

    errors = {method: by_span(estimates) for method, estimates in _all(outcome).items()}
    name = "004-noise-sweep"
    figures = (
        sweep_figure(name, "Errors over the lidar's noise", "variance of the lidar's noise", variances, errors),
        adaptation_figure(name, outcome.adaptation),
    )
    return Result(_rows(errors, _NOISE_PRINTED), figures)


def acceleration_sweep(runs: int, seed: int, advance: Advance, accelerations: Floats = ACCELERATIONS) -> Result:
    """Drive at one constant acceleration after another, each from the start."""
    random = np.random.default_rng(seed)
    batches = np.array_split(accelerations, -(-len(accelerations) // _BATCH))
    variance = np.tile(np.array(NOMINAL)[:, None], (1, SAMPLES))
    found: list[dict[str, Floats]] = []
    for batch in batches:
        each = np.stack([accelerated(SAMPLES, _START[1], acceleration) for acceleration in batch], axis=1)
        truth = np.repeat(each, runs, axis=1)
        recording = record(truth, variance, _START, truth.shape[1], random)
        outcome = filtered(recording, lambda share: advance(share / len(batches)))
        found.append({method: _by_value(estimates - truth, runs) for method, estimates in _all(outcome).items()})
    errors = {method: np.concatenate([each[method] for each in found]) for method in found[0]}
    figure = sweep_figure(
        "004-acceleration-sweep", "Errors over the acceleration", "acceleration, m/s²", accelerations, errors
    )
    return Result(_rows(errors, _ACCELERATION_PRINTED), (figure,))


def _by_value(error: Floats, runs: int) -> Floats:
    """Return root mean square errors of each value's runs, (values, 3), of errors (steps, values · runs, 3)."""
    return np.asarray(np.sqrt(np.square(error).reshape(len(error), -1, runs, 3).mean(axis=(0, 2))))


def _all(outcome: Outcome) -> dict[str, Floats]:
    """Return the estimates of the methods, the default estimator and the bound."""
    return {**outcome.methods, _DEFAULT: outcome.default, _BOUND: outcome.bound}


def _rows(errors: Mapping[str, Floats], printed: tuple[tuple[float, ...], tuple[float, ...]]) -> tuple[Row, ...]:
    """Return the largest and the average of root mean square errors (values, 3) over a sweep.

    Args:
        errors: of each method, of the default estimator and of the bound.
        printed: the paper's largest and average of the joint filter.
    """
    rows = []
    for case, figures in (("largest of the sweep", printed[0]), ("average of the sweep", printed[1])):
        over = np.max if case.startswith("largest") else np.mean
        errors_of = {method: over(error, axis=0).tolist() for method, error in errors.items()}
        default, bound = errors_of.pop(_DEFAULT), errors_of.pop(_BOUND)
        for q, (quantity, unit, _) in enumerate(QUANTITIES):
            rows += [
                Row(
                    case,
                    quantity,
                    unit,
                    method,
                    figures[q] if method == "JAKF" else None,
                    here[q],
                    default[q],
                    bound[q],
                )
                for method, here in errors_of.items()
            ]
    return tuple(rows)
