"""The parts beside their libraries, and how the filters' cost grows with the number of tracks."""

from __future__ import annotations

from pathlib import Path
from statistics import median

import numpy as np
import pytest

from .comparisons import GROWTH, PARTS
from .conftest import Note
from .parts import BATCH, Axes, estimate
from .timing import held, microseconds


@pytest.mark.parametrize("name", PARTS)
def test_a_part_is_fast(name: str, tmp_path: Path, note: Note) -> None:
    result = held(PARTS[name](tmp_path))
    note(result)
    assert result.ratio >= result.comparison.least, str(result)


def test_axes_apart_have_filterpys_states() -> None:
    axes = Axes()
    assert axes.estimate(40) == axes.estimate_with_filterpy(40)
    np.testing.assert_allclose(*axes.states, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", GROWTH)
def test_cost_grows_less_than_the_number_of_tracks(name: str) -> None:
    settings, tracks, most = GROWTH[name]
    ratios = []
    for _ in range(5):
        few = microseconds(lambda: estimate(settings, BATCH, 40))
        ratios.append(microseconds(lambda: estimate(settings, tracks, 20)) / few)
    assert median(ratios) <= most
