"""The parts beside their libraries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from .comparisons import PARTS
from .conftest import Note
from .parts import Axes
from .timing import timed

pytestmark = pytest.mark.benchmark

LEAST = {"decode": 1.2}
"""Ratios that even a busy machine reaches, where that is not twice."""


@pytest.mark.parametrize("name", PARTS)
def test_a_part_is_faster_than_its_library(name: str, tmp_path: Path, note: Note) -> None:
    result = timed(PARTS[name](tmp_path))
    note(result)
    assert result.ratio >= LEAST.get(name, 2), str(result)


def test_axes_apart_have_filterpys_states() -> None:
    axes = Axes()
    assert axes.estimate(40) == axes.estimate_with_filterpy(40)
    np.testing.assert_allclose(*axes.states, rtol=0, atol=1e-9)
