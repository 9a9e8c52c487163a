"""The assignment of tracks to detections that costs least in all."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Solver: TypeAlias = Callable[[Floats], tuple[Rows, Rows]]


def assign(cost: Floats) -> tuple[Rows, Rows]:
    """Pair each row with a column of its own, or each column with a row where there are fewer, at the least sum.

    Args:
        cost: of each pair, (n, m), finite.

    Returns:
        Rows, ascending, and their columns.
    """
    return _solver()(cost)


@cache
def _solver() -> Solver:
    """Return scipy's solver, which is one file of C++.

    The package around it takes half a second to import: too long in a running service, and more than all the rest of
    its start. Where the file is not where it used to be, the package is imported all the same.
    """
    scipy = find_spec("scipy")
    folders = [] if scipy is None else scipy.submodule_search_locations or []
    for path in (Path(folder, "optimize", f"_lsap{suffix}") for folder in folders for suffix in EXTENSION_SUFFIXES):
        spec = spec_from_file_location("scipy.optimize._lsap", path)
        if path.is_file() and spec is not None and spec.loader is not None:
            module = module_from_spec(spec)
            spec.loader.exec_module(module)
            return cast("Solver", module.linear_sum_assignment)
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 - see above

    return cast("Solver", linear_sum_assignment)
