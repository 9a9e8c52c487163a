"""A lidar that fails beside a radar, at moments all over a drive: noticed, never harmful, used again."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.binding.bound import Binding
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.simulate import simulate
from candaemon.tracking.sensor_trust import Fault
from tests.accuracy.experiments.finding import Effort, Experiment, Finding
from tests.support.bound import binding
from tests.support.failing_lidar import alone, failing, scenario, squared_errors

KINDS: Final = ("silent", "frozen", "biased", "noisy")
NOISE: Final = 200.0
"""Factor on the variance of a noisy lidar."""
BEGINS: Final = tuple(3.0 + 0.73 * k for k in range(10))
"""s, when it begins to fail, while the car ahead drives on, brakes and speeds up; at other phases of its scans each."""
LASTS: Final = 2.5
AFTER: Final = 2.0
"""s that it fails, and that are compared afterwards."""
LEAST_WEIGHT: Final = 0.1
"""Weight from which a sensor counts as used."""
LONGEST: Final = BEGINS[-1] + LASTS + AFTER
MEASUREMENT: Final[Mapping[str, Any]] = {"traffic": {}}
LIDAR: Final = 1
"""Index of the sensor that fails."""


@dataclass(frozen=True, slots=True)
class Failure:
    """What became of a failure.

    Attributes:
        noticed: s after which the sensor was called faulty; infinite: never.
        used_again: s after its end until the sensor was used, neither cut off nor next to it.
        squares: mean squared errors of position and velocity from its begin on (2,).
        alone: those of the radar without the lidar, of the same drive and time.
    """

    noticed: float
    used_again: float
    squares: Floats
    alone: Floats


def failure(both: Binding, kind: str, begin: float, radar: Floats, seed: int) -> Failure:
    """Return what becomes of a failure.

    Args:
        both: the lidar and the radar.
        kind: of failure.
        begin: s of the drive.
        radar: time and squared errors of the radar alone (n, 3).
        seed: of the simulation.
    """
    end = begin + LASTS
    drive = scenario(failing((kind, begin, end), amount=NOISE if kind == "noisy" else None), LONGEST, MEASUREMENT)
    pipeline, named, used = Pipeline(both), [], []

    def watch(time: float) -> None:
        fault, weight = pipeline.trust.fault(LIDAR), pipeline.trust.weight(LIDAR)
        if fault is not Fault.NONE and time >= begin:
            named.append(time)
        if time > end and not fault.cuts_off and weight >= LEAST_WEIGHT:
            used.append(time)

    rows = np.array(list(squared_errors(pipeline, simulate(drive, both, seed), watch)))
    window = [(one[:, 0] >= begin) & (one[:, 0] < end + AFTER) for one in (rows, radar)]
    return Failure(
        named[0] - begin if named else math.inf,
        used[0] - end if used else math.inf,
        rows[window[0], 1:].mean(axis=0),
        radar[window[1], 1:].mean(axis=0),
    )


def run(effort: Effort) -> Iterator[Finding]:
    """Yield the figures by kind of failure."""
    both = binding("radar_lidar")
    with TemporaryDirectory() as folder:
        single = alone(Path(folder))
        plain = scenario((), LONGEST, MEASUREMENT)
        drives = {seed: simulate(plain, single, seed) for seed in effort.seeds}
        radar = {seed: np.array(list(squared_errors(Pipeline(single), each))) for seed, each in drives.items()}
    for kind in KINDS:
        found = [failure(both, kind, begin, radar[seed], seed) for seed in effort.seeds for begin in BEGINS]
        yield Finding(f"{kind}: noticed, latest", max(one.noticed for one in found), "s", most=2.0)
        yield Finding(f"{kind}: used again, latest", max(one.used_again for one in found), "s", most=1.0)
        squares, without = (np.array([getattr(one, name) for one in found]) for name in ("squares", "alone"))
        over_all, worst = np.sqrt(squares.mean(axis=0) / without.mean(axis=0)), np.sqrt(squares / without).max(axis=0)
        for k, name in enumerate(("position", "velocity")):
            yield Finding(f"{kind}: {name}, of all", float(over_all[k]), "of radar", most=1.05)
            yield Finding(f"{kind}: {name}, worst", float(worst[k]), "of radar")


FAILING_SENSOR: Final = Experiment(
    "is a lidar that fails at any moment noticed, harmless, and used again?",
    (
        ("failures", f"of {LASTS:g} s, {len(BEGINS)} moments from {BEGINS[0]:g} to {BEGINS[-1]:g} s, each kind"),
        ("noisy", f"its variance is {NOISE:g} times greater"),
        ("noticed", "until the status calls the lidar faulty; a biased one may count as noisy first"),
        ("used again", f"after the failure's end: not cut off, with a weight of at least {LEAST_WEIGHT:g}"),
        ("of radar", f"RMSE from the failure's begin to {AFTER:g} s after its end over that of the radar alone"),
    ),
    3,
    run,
)
