"""The point of an outline that faces an observer is the nearest one."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.estimation.outline import facing_point

ANGLES = np.linspace(-np.pi, np.pi, 8001)


@pytest.mark.parametrize(("length", "width"), [(4.5, 1.8), (16.5, 2.5), (2.0, 0.7), (0.5, 0.5)])
def test_the_facing_point_is_the_nearest_of_the_ellipse(length: float, width: float) -> None:
    random = np.random.default_rng(1)
    eye = random.uniform(-30, 30, (400, 2))
    outside = (eye[:, 0] / (length / 2 + 1)) ** 2 + (eye[:, 1] / (width / 2 + 1)) ** 2 > 1
    eye = eye[outside]
    outline = np.stack([length / 2 * np.cos(ANGLES), width / 2 * np.sin(ANGLES)], axis=1)
    nearest = np.array([outline[((outline - each) ** 2).sum(axis=1).argmin()] for each in eye])
    found = facing_point(eye, np.full(len(eye), length / 2), np.full(len(eye), width / 2))
    assert np.abs(found - nearest).max() < 0.02


def test_the_facing_point_of_a_point_is_itself() -> None:
    assert np.abs(facing_point(np.array([[10.0, -3.0]]), np.zeros(1), np.zeros(1))).max() < 1e-5


def test_the_facing_point_moves_steadily_with_the_aspect() -> None:
    angles = np.radians(np.arange(0.0, 360.0, 0.5))
    eye = 20.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    found = facing_point(eye, np.full(len(eye), 2.25), np.full(len(eye), 0.9))
    assert np.hypot(*np.diff(found, axis=0).T).max() < 0.06
