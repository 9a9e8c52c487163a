"""Every experiment of the papers runs through the command, and gives rows and drawings as it promises."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from candaemon.cli.main import main
from candaemon.papers import registry
from candaemon.papers.experiment import Advance, Experiment, Figure, Result, Row

NAMES = [experiment.name for experiment in registry.EXPERIMENTS]
LONG = {"001-table-1", "004-noise-sweep", "004-acceleration-sweep", "004-table-3", "004-table-4", "004-table-5"}
"""Experiments of which even two runs take long."""
LONGEST_LINE = 2000

pytestmark = pytest.mark.usefixtures("logging_as_it_was")


def test_every_paper_has_its_experiments_and_no_name_is_used_twice() -> None:
    assert {experiment.paper for experiment in registry.EXPERIMENTS} == {"000", "001", "002", "003", "004"}
    assert len(set(NAMES)) == len(NAMES)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in NAMES]
)
def test_experiments_keep_their_contract(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (experiment,) = registry.choose([name])
    results, shares = [], []

    def run(runs: int, seed: int, advance: Advance) -> Result:
        def counted(share: float) -> None:
            shares.append(share)
            advance(share)

        results.append(experiment.run(runs, seed, counted))
        return results[-1]

    monkeypatch.setattr(registry, "EXPERIMENTS", (replace(experiment, run=run),))
    assert main(["papers", name, "--runs", "2", "--json", str(tmp_path / "r.json")]) == 0
    (result,) = results
    assert math.isclose(sum(shares), 1.0, abs_tol=1e-6)
    assert capsys.readouterr().out.count(f"{name}  ") == 2 + len(result.rows) + len(experiment.choices)
    check_rows(result.rows)
    assert len({figure.name for figure in result.figures}) == len(result.figures)
    for figure in result.figures:
        check_figure(experiment, figure)


def check_rows(rows: tuple[Row, ...]) -> None:
    """Hold what a table's rows promise."""
    keys = [(row.case, row.quantity, row.unit, row.method) for row in rows]
    assert rows
    assert len(set(keys)) == len(keys)
    assert not [key for key in keys for text in key if "  " in text or text != text.strip()]
    for row in rows:
        given = [value for value in (row.printed, row.here, row.default, row.bound) if value is not None]
        assert np.isfinite(given).all(), row
    told: dict[tuple[str, str], tuple[float | None, float | None]] = {}
    for row in rows:
        assert told.setdefault((row.case, row.quantity), (row.default, row.bound)) == (row.default, row.bound), row


def check_figure(experiment: Experiment, figure: Figure) -> None:
    """Hold what a drawing's data promise."""
    assert figure.name.startswith(f"{experiment.paper}-")
    assert figure.title
    for panel in figure.panels:
        assert panel.x_label
        assert panel.y_label
        labels = [line.label for line in panel.lines]
        assert labels
        assert len(set(labels)) == len(labels), "two curves under one label"
        for line in panel.lines:
            assert line.x.shape == line.y.shape
            assert 1 < line.x.size <= LONGEST_LINE
            assert np.isfinite(line.x).all()
            assert not np.isinf(line.y).any()
