"""The three drives of Gao et al. 2016, section 4.2: a lidar that suffers bursts of noise and a radar that does not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation.discretisation import white_axis
from candaemon.papers.experiment import Advance, Result, Row
from candaemon.papers.gao_figures import drive_figures
from candaemon.papers.gao_filters import DT, METHODS, NOMINAL, QUANTITIES, Outcome, filtered, record

BURST = 2.0
"""Variance of the lidar's noise in a burst, of each component in its own unit squared."""
MANOEUVRING = white_axis(DT, 0.01, order=2).noise
"""Q for a varying acceleration: white jerk of 0.01 (m/s³)²/Hz."""

_MEASURES = (
    *((quantity, unit, True) for quantity, unit, _ in QUANTITIES),
    *((f"variance of {quantity}", squared, False) for quantity, _, squared in QUANTITIES),
)
"""Quantity of a table's row, its unit, and whether it is an error."""


@dataclass(frozen=True, slots=True)
class LidarRadarDrive:
    """One of the drives.

    Attributes:
        name: of the experiment.
        case: what was driven.
        truth: (steps, 3).
        start: state before the first step (3,).
        bursts: samples in which the lidar suffers, from and before.
        counted: first sample whose error counts.
        process: Q that suits a motion whose acceleration varies, (3, 3); None: it is constant.
        printed: the table's figures, a row a quantity, a column a method of the paper, in the order of `METHODS`.
    """

    name: str
    case: str
    truth: Floats
    start: Floats
    bursts: tuple[tuple[int, int], ...]
    counted: int
    process: Floats | None
    printed: tuple[tuple[float, ...], ...]

    def variance(self) -> Floats:
        """Return the true variance of lidar and radar over time, (2, steps)."""
        steps = len(self.truth)
        variance = np.tile(np.array(NOMINAL)[:, None], (1, steps))
        for begin, end in self.bursts:
            variance[0, begin:end] = BURST
        return variance

    def run(self, runs: int, seed: int, advance: Advance) -> Result:
        """Drive it; see `candaemon.papers.experiment.Experiment`."""
        random = np.random.default_rng(seed)
        recording = record(self.truth[:, None], self.variance(), self.start, runs, random, self.process)
        outcome = filtered(recording, advance)
        return Result(self._rows(outcome), drive_figures(self.name, recording, outcome))

    def _rows(self, outcome: Outcome) -> tuple[Row, ...]:
        default, bound = self._measures(outcome.default), self._measures(outcome.bound)
        here = {method: self._measures(estimates) for method, estimates in outcome.methods.items()}
        rows = []
        for q, (quantity, unit, error) in enumerate(_MEASURES):
            printed = dict(zip(METHODS, self.printed[q], strict=False))  # ours are not in the paper
            rows += [
                Row(
                    self.case,
                    quantity,
                    unit,
                    method,
                    printed.get(method),
                    found[q],
                    default[q] if error else None,
                    bound[q] if error else None,
                    error=error,
                )
                for method, found in here.items()
            ]
        return tuple(rows)

    def _measures(self, estimates: Floats) -> list[float]:
        """Return root mean square errors, and the variances of what is estimated over all samples, six figures."""
        counted = slice(self.counted, None)
        error = np.square(estimates[counted] - self.truth[counted, None]).mean(axis=(0, 1))
        return [*np.sqrt(error).tolist(), *estimates.var(axis=0).mean(axis=0).tolist()]


def accelerated(steps: int, velocity: float, acceleration: float) -> Floats:
    """Return displacement, velocity and acceleration after each step of a constant acceleration, (steps, 3)."""
    t = DT * np.arange(1, steps + 1)
    return np.stack(
        [velocity * t + acceleration * t**2 / 2, velocity + acceleration * t, np.full(steps, acceleration)], axis=1
    )


def swaying(steps: int, velocity: float, amplitude: float, period: float) -> Floats:
    """Return displacement, velocity and acceleration after each step of an acceleration that is a sine, (steps, 3)."""
    t, rate = DT * np.arange(1, steps + 1), 2 * np.pi / period
    swing = amplitude / rate
    return np.stack(
        [
            velocity * t + swing * (t - np.sin(rate * t) / rate),
            velocity + swing * (1 - np.cos(rate * t)),
            amplitude * np.sin(rate * t),
        ],
        axis=1,
    )


FIRST = LidarRadarDrive(
    "004-table-3",
    "constant acceleration",
    accelerated(5000, 5.43, 0.18),
    np.array((0.0, 5.43, 0.18)),
    ((1000, 1500), (2000, 3000), (3500, 4000)),
    500,
    None,
    (
        (0.0880, 0.0479, 0.0595, 0.0565, 0.0320),
        (0.0702, 0.0665, 0.0676, 0.0669, 0.0640),
        (0.0175, 0.0155, 0.0184, 0.0179, 0.0140),
        (2.0833e4, 2.0831e4, 2.0833e4, 2.0832e4, 2.0831e4),
        (6.7979, 6.7852, 6.7722, 6.7699, 6.7737),
        (4.2133e-4, 2.2840e-4, 3.1428e-4, 3.0290e-4, 1.8763e-4),
    ),
)
SECOND = LidarRadarDrive(
    "004-table-4",
    "varying acceleration",
    swaying(5000, 0.15, 0.538, 42.5),
    np.array((0.0, 0.15, 0.0)),
    ((2000, 3000), (3500, 4400)),
    500,
    MANOEUVRING,
    (
        (0.0912, 0.0883, 0.1754, 0.1296, 0.0685),
        (0.0367, 0.0338, 0.0527, 0.0551, 0.0269),
        (0.0190, 0.0133, 0.0205, 0.0203, 0.0135),
        (2.8775e4, 2.8744e4, 2.8771e4, 2.8774e4, 2.8773e4),
        (6.8020, 6.7737, 6.7849, 6.7872, 6.7794),
        (0.1355, 0.1364, 0.1351, 0.1348, 0.1356),
    ),
)
THIRD = LidarRadarDrive(
    "004-table-5",
    "lateral, changing lanes",
    swaying(1000, 0.0, 0.429, 16.4),
    np.zeros(3),
    ((200, 400), (600, 800)),
    100,
    MANOEUVRING,
    (
        (0.0779, 0.0636, 0.0681, 0.0636, 0.0549),
        (0.0437, 0.0431, 0.0431, 0.0414, 0.0385),
        (0.0415, 0.0380, 0.0442, 0.0443, 0.0368),
        (2.8638e4, 2.8635e4, 2.8642e4, 2.8641e4, 2.8633e4),
        (0.6702, 0.6688, 0.6711, 0.6772, 0.6619),
        (0.0414, 0.0410, 0.0420, 0.0424, 0.0409),
    ),
)
