"""Results of experiments for programs.

The JSON is an object with

- `runs`: number of Monte Carlo runs,
- `seed`: of all random numbers,
- `experiments`: a list, in the order in which they were run, of objects with

  - `name`, `paper`, `title`: texts, such as '000-table-1', '000',
  - `choices`: texts: what the paper leaves open or misprints, and what was chosen,
  - `rows`: a list of objects, a figure of the table each, with the texts `case`, `quantity`, `unit`, `method` and the
    numbers `printed` (the paper's), `here`, `default` (the default estimator), `bound` (which knows when the target
    manoeuvres); a number that there is none of, or that is not finite, is null; and `error`: whether the numbers are
    errors, of which the smaller is the better.

The same runs and seed give the same text.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from candaemon.papers.experiment import Experiment, Result, Row


def to_json(results: Iterable[tuple[Experiment, Result]], runs: int, seed: int) -> str:
    """Return results as JSON text; the module's docstring lists its keys."""
    experiments = [
        {
            "name": experiment.name,
            "paper": experiment.paper,
            "title": experiment.title,
            "choices": list(experiment.choices),
            "rows": [_row(row) for row in result.rows],
        }
        for experiment, result in results
    ]
    tree = {"runs": runs, "seed": seed, "experiments": experiments}
    return json.dumps(tree, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def _row(row: Row) -> dict[str, Any]:
    """Return a row with null for what is not finite, which JSON has no word for."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in asdict(row).items()
    }
