"""Rows of things that stand in line are found among what stands."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.tracking.standing_rows import standing_rows


def test_two_rails_are_two_rows_whatever_stands_about() -> None:
    random = np.random.default_rng(1)
    axis, aside = np.array([0.8, 0.6]), np.array([-0.6, 0.8])
    left = np.arange(0.0, 40.0, 4.0)[:, None] * axis + 6.0 * aside
    right = np.arange(0.0, 24.0, 4.0)[:, None] * axis - 6.0 * aside
    about = np.array([[20.0, 40.0], [50.0, -20.0], [-30.0, 5.0]])
    places = np.concatenate([left + random.normal(0.0, 0.1, left.shape), right, about])
    found = standing_rows(places[random.permutation(len(places))])
    assert [row.end - row.begin for row in found] == pytest.approx([36.0, 20.0], abs=0.5)
    for row, side in zip(found, (6.0, -6.0), strict=True):
        assert abs(row.axis @ axis) == pytest.approx(1.0, abs=1e-3)
        assert row.centre @ aside == pytest.approx(side, abs=0.1)


@pytest.mark.parametrize(
    "places",
    [
        np.zeros((0, 2)),
        [[0.0, 0.0], [4.0, 0.0]],
        [[0.0, 0.0], [4.0, 0.0], [8.0, 1.5]],
        [[0.0, 0.0], [4.0, 0.0], [30.0, 0.0]],
    ],
    ids=["nothing", "two", "not in line", "far apart"],
)
def test_what_is_no_row(places: list[list[float]]) -> None:
    assert standing_rows(np.asarray(places, dtype=float)) == []
