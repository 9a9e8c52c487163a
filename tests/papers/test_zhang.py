"""Paper 003's two tests: the printed errors, the order of the methods, the drawings."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.papers.experiment import Experiment, Result, Row
from candaemon.papers.zhang import EXPERIMENTS

RUNS = 300
SHARES: dict[str, list[float]] = {}


@pytest.fixture(scope="module", params=EXPERIMENTS, ids=lambda experiment: experiment.name)
def done(request: pytest.FixtureRequest) -> tuple[Experiment, Result]:
    experiment: Experiment = request.param
    SHARES[experiment.name] = []
    return experiment, experiment.run(RUNS, 2, SHARES[experiment.name].append)


def position(result: Result, method: str) -> Row:
    (found,) = (row for row in result.rows if (row.method, row.quantity) == (method, "position x"))
    return found


def test_the_numbers_to_hold(done: tuple[Experiment, Result]) -> None:
    experiment, result = done
    switch = {"003-test-1": 5.0, "003-test-2": 5.3}[experiment.name]
    assert position(result, "CSM").here == pytest.approx(5.4, abs=0.1)
    assert position(result, "switch").here == pytest.approx(switch, abs=0.1)
    assert position(result, "IMM").here <= 4.7


def test_no_method_is_better_than_the_bound(done: tuple[Experiment, Result]) -> None:
    experiment, result = done
    for row in result.rows:
        assert row.bound is not None
        assert row.default is not None
        assert row.bound < min(row.here, row.default)
    known = {"003-test-1": 3.7, "003-test-2": 3.85}[experiment.name]
    assert position(result, "CSM").bound == pytest.approx(known, abs=0.1)


def test_the_order_is_the_papers_and_the_imm_is_better(done: tuple[Experiment, Result]) -> None:
    _, result = done
    csm, switch, imm = (position(result, method) for method in ("CSM", "switch", "IMM"))
    assert csm.printed is not None
    assert switch.printed is not None
    assert switch.printed < csm.printed
    assert imm.here < switch.here < csm.here
    assert csm.here == pytest.approx(csm.printed, rel=0.03)
    assert switch.here == pytest.approx(switch.printed, rel=0.05)


def test_the_progress_is_whole_and_the_seed_decides(done: tuple[Experiment, Result]) -> None:
    experiment, _ = done
    assert sum(SHARES[experiment.name]) == pytest.approx(1.0)
    rows = [experiment.run(3, seed, lambda _: None).rows for seed in (1, 1, 2)]
    assert rows[0] == rows[1] != rows[2]


def test_the_drawing_shows_when_which_model_was_told(done: tuple[Experiment, Result]) -> None:
    experiment, result = done
    (figure,) = result.figures
    assert figure.name == experiment.name
    _, speed, told = figure.panels
    truth = speed.lines[0]
    assert truth.y[-1] == pytest.approx({"003-test-1": 5.0, "003-test-2": -16.0}[experiment.name])
    switch, imm = told.lines
    assert switch.y[:19] == pytest.approx(1.0)  # T2 has not passed
    assert switch.y[60] < 1.0
    for line in (switch, imm):
        assert ((line.y >= 0.0) & (line.y <= 1.0)).all()
        assert np.isfinite(line.y).all()
    assert imm.y[40:50].mean() > imm.y[80:90].mean()  # driving steadily since 50 s
