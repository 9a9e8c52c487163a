"""An experiment that takes no time, for what is done with its results."""

from __future__ import annotations

import math

import numpy as np

from candaemon.papers.experiment import Advance, Experiment, Figure, Line, Panel, Result, Row


def invented(name: str) -> Experiment:
    """Return an experiment that takes no time."""

    def run(runs: int, seed: int, advance: Advance) -> Result:
        noise = np.random.default_rng(seed).normal(size=(runs, 50))
        error, time = float(np.sqrt(np.square(noise).mean())), np.linspace(0.0, 4.9, 50)
        for _ in range(4):
            advance(0.25)
        rows = (
            Row("constant velocity", "position x", "m", "CA", 0.5, error, 0.0123456, 0.01),
            Row("constant velocity", "position x", "m", "CS", 123456.0, math.nan, None, None),
            Row("constant velocity", "share of the time", "", "CS", None, 0.25),
        )
        curves = (Line("truth", time, np.zeros(50)), Line("measured", time, noise[0]))
        panels = (
            Panel("x (m)", "y (m)", curves, equal=True),
            Panel("time (s)", "error of position x (m)", (*curves[1:], Line("CA", time, noise[0] / 2))),
        )
        return Result(rows, (Figure(f"{name}-errors", "Errors of the first run", panels),))

    return Experiment(name, "three motions (table 1)", ("P(0) is left open: it is the identity.",), run)
