"""Numbers of a table are written as Python formats them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from candaemon import compiled
from candaemon.arrays import Floats
from candaemon.evaluation.number_text import number_lines
from tests.support.effort import examples

NUMBERS = st.one_of(
    st.floats(), st.floats(-1e4, 1e4), st.sampled_from((0.0, -0.0, 0.00005, -0.00004, 0.99995, 1e11, 9.99999999e14))
)


@pytest.fixture(params=["compiled", "numpy"])
def _computing(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "compiled" and not compiled.in_use:
        pytest.skip("the kernels are not compiled: no compiler or no Cython")
    monkeypatch.setattr(compiled, "in_use", request.param == "compiled")


def expected(value: float, decimals: int) -> str:
    """Return a number as it is to be written: rounded as numpy rounds, and formatted by Python."""
    with np.errstate(over="ignore"):
        rounded = float(np.round(value, decimals))
    rounded = value if math.isinf(rounded) else rounded
    return f"{rounded + 0.0:.{decimals}f}" if math.isfinite(rounded) else ""


@pytest.mark.usefixtures("_computing")
@pytest.mark.parametrize("decimals", [0, 4, 9])
def test_each_is_written_as_python_does(decimals: int) -> None:
    @given(arrays(np.float64, st.tuples(st.integers(1, 4), st.integers(1, 3)), elements=NUMBERS))
    @settings(max_examples=examples(2000, 200))
    def hold(values: Floats) -> None:
        rows = [",".join(expected(value, decimals) for value in row) for row in values.tolist()]
        assert number_lines(values, decimals).decode().split("\n") == [*rows, ""]

    hold()


@pytest.mark.usefixtures("_computing")
def test_no_rows_are_no_lines() -> None:
    assert number_lines(np.zeros((0, 3)), 4) == b""
