"""Samples brought to one instant, points into one set of axes."""

from __future__ import annotations

from itertools import product
from math import cos, pi, radians, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.estimation.alignment import lagrange, mounted, mounting_rotation
from tests.support.builders import rotation
from tests.support.effort import examples

ANGLES = st.floats(-1.5, 1.5)


@settings(deadline=None, max_examples=examples(40))
@given(seed=st.integers(0, 2**32 - 1))
def test_a_parabola_is_met_at_any_instant(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, gaps = 1e3 * rng.random((6, 1)), rng.uniform(0.01, 0.2, (6, 3))
    times = start + np.cumsum(gaps, axis=1)
    curve = rng.normal(size=(6, 3, 2))

    def at(t: Floats) -> Floats:
        since = (t - start)[..., None]
        return curve[:, :1] + curve[:, 1:2] * since + curve[:, 2:] * since**2

    instant = times[:, :1] + rng.uniform(-0.1, 0.5, (6, 1))
    aligned = lagrange(times, at(times), instant[:, 0], 1.0)
    np.testing.assert_allclose(aligned.value, at(instant)[:, 0], rtol=1e-6, atol=1e-6)
    outside = (instant[:, 0] < times[:, 0]) | (instant[:, 0] > times[:, 2])
    np.testing.assert_array_equal(aligned.extrapolated, outside)
    assert not aligned.limited.any()


def test_interpolation_equals_the_papers_for_even_samples() -> None:
    """tᵢ = tmᵢ + τ h: τ (τ − 1)/2, 1 − τ², τ (τ + 1)/2."""
    tau, step = 0.3, 0.025
    weights = lagrange(np.array([[-step, 0.0, step]]), np.eye(3)[None], np.array([tau * step]), 0.0).value
    np.testing.assert_allclose(weights[0], [tau * (tau - 1) / 2, 1 - tau**2, tau * (tau + 1) / 2], rtol=1e-12)


def test_extrapolation_ends_at_its_reach() -> None:
    times, values = np.tile([0.0, 0.1, 0.2], (5, 1)), np.tile([[0.0], [0.01], [0.04]], (5, 1, 1))
    instant = np.array([0.2, 0.22, 0.25, 9.0, -9.0])
    aligned = lagrange(times, values, instant, 0.03)
    np.testing.assert_allclose(aligned.value[:, 0], np.clip(instant, -0.03, 0.23) ** 2, atol=1e-12)
    np.testing.assert_array_equal(aligned.extrapolated, [False, True, True, True, True])
    np.testing.assert_array_equal(aligned.limited, [False, False, True, True, True])


@pytest.mark.parametrize("times", [(0.0, 0.0, 0.1), (0.0, 0.2, 0.1)])
def test_samples_must_follow_each_other(times: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="must rise"):
        lagrange(np.array([times]), np.zeros((1, 3, 1)), np.zeros(1), 0.0)


def test_a_lidar_between_its_scans_is_met_at_the_radars_instant() -> None:
    """Scans of 25 ms that are out of step with the radar's by 8 ms: a vehicle that brakes is met to a millimetre."""
    instant = np.linspace(0.058, 2.958, 59)

    def at(t: Floats) -> Floats:
        return 20.0 * t - 3.0 * t**2 + 0.5 * np.sin(2.0 * t)

    nearest = 0.025 * np.round(instant / 0.025)
    times = nearest[:, None] + 0.025 * np.array([-1.0, 0.0, 1.0])
    aligned = lagrange(times, at(times)[..., None], instant, 0.0)
    assert np.abs(aligned.value[:, 0] - at(instant)).max() < 1e-4
    assert np.abs(at(nearest) - at(instant)).max() > 0.05


@settings(deadline=None, max_examples=examples(30))
@given(deflection=ANGLES, pitch=ANGLES)
def test_mounting_is_a_proper_rotation_about_x_then_z(deflection: float, pitch: float) -> None:
    found = mounting_rotation(deflection, pitch)
    about_z, about_x = np.eye(3), np.eye(3)
    about_z[:2, :2], about_x[1:, 1:] = rotation(deflection), rotation(pitch)
    np.testing.assert_allclose(found, about_z @ about_x, atol=1e-12)
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(found) == pytest.approx(1.0)


def test_signs_of_the_mounting() -> None:
    """x to the right, y forward, z up: φ turns the look to the left, α raises it."""
    ahead = np.array([0.0, 10.0, 0.0])
    left = mounted(ahead, mounting_rotation(pi / 2, 0.0), np.array([0.5, 3.0, 0.6]))
    np.testing.assert_allclose(left, [-9.5, 3.0, 0.6], atol=1e-12)
    up = mounted(ahead, mounting_rotation(0.0, radians(30)), np.zeros(3))
    np.testing.assert_allclose(up, [0.0, 10 * cos(radians(30)), 5.0], atol=1e-12)
    both = mounted(np.stack([ahead, -ahead]), mounting_rotation(0.2, 0.1), np.ones(3))
    np.testing.assert_allclose(both.sum(axis=0), 2.0, atol=1e-12)


def test_the_printed_matrix_is_no_rotation_with_any_signs() -> None:
    phi, alpha = 0.3, 0.2
    c, s, ca, sa = cos(phi), sin(phi), cos(alpha), sin(alpha)
    printed = np.array(((c, s * ca, s * ca), (s, c * ca, c * ca), (0.0, sa, ca)))
    for signs in product((-1.0, 1.0), repeat=9):
        signed = printed * np.reshape(signs, (3, 3))
        assert np.abs(signed @ signed.T - np.eye(3)).max() > 0.01
    np.testing.assert_allclose(np.abs(mounting_rotation(phi, alpha))[:, :2], printed[:, :2])
