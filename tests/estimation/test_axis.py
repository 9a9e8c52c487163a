"""One axis of motion against van Loan's discretisation, filterpy, and the paper's closed forms."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise, van_loan_discretization
from scipy.linalg import expm

from candaemon.arrays import Floats
from candaemon.estimation.discretisation import decaying_axis, white_axis
from tests.estimation.test_motion_models import DECAYS, continuous


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("decay", DECAYS)
def test_a_decaying_axis_is_van_loans(decay: float, order: int) -> None:
    f, q = van_loan_discretization(*continuous(decay, order), 1.0)  # T = 1: its entries are then of one size
    size = order + 1
    for dt in (0.05, 1.0):
        axis = decaying_axis(decay / dt, dt, 2.5, order=order)
        scale = dt ** np.arange(order, -1, -1.0)  # state in units of T: position T², velocity T, acceleration 1
        np.testing.assert_allclose(axis.transition[:size, :size], f * np.outer(scale, 1 / scale), rtol=1e-9, atol=0)
        np.testing.assert_allclose(axis.noise[:size, :size], 2.5 * dt * q * np.outer(scale, scale), rtol=1e-9, atol=0)
        assert not axis.transition[size:].any()
        assert not axis.noise[size:].any()


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("dt", [0.01, 0.05, 1.0])
def test_a_white_axis_is_filterpys(dt: float, order: int) -> None:
    axis = white_axis(dt, 0.7, order=order)
    size = order + 1
    np.testing.assert_allclose(axis.noise[:size, :size], Q_continuous_white_noise(size, dt, 0.7), rtol=1e-14)
    f, _ = van_loan_discretization(*continuous(0.0, order), dt)
    np.testing.assert_allclose(axis.transition[:size, :size], f, rtol=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_a_long_memory_tends_to_white_noise(order: int) -> None:
    slow, white = decaying_axis(1e-5, 0.05, 1.0, order=order), white_axis(0.05, 1.0, order=order)
    np.testing.assert_allclose(slow.transition, white.transition, rtol=1e-6)
    np.testing.assert_allclose(slow.noise, white.noise, rtol=1e-6)


def exact(decay: float, dt: float) -> tuple[Floats, Floats, Floats]:
    """Return F, Q and U of paper 000 (15), (19) and (16) with 80 digits, q33 put right."""
    with localcontext(prec=80):
        x, t = Decimal(decay), Decimal(dt)
        a, e = x / t, (-x).exp()
        q11 = (1 - e * e + 2 * x + 2 * x**3 / 3 - 2 * x * x - 4 * x * e) / (2 * a**5)
        q12 = (e * e + 1 - 2 * e + 2 * x * e - 2 * x + x * x) / (2 * a**4)
        q13 = (1 - e * e - 2 * x * e) / (2 * a**3)
        q22 = (4 * e - 3 - e * e + 2 * x) / (2 * a**3)
        q23 = (e * e + 1 - 2 * e) / (2 * a**2)
        q33 = (1 - e * e) / (2 * a)
        f = np.array(((1, t, (x - 1 + e) / a**2), (0, 1, (1 - e) / a), (0, 0, e)), dtype=float)
        q = np.array(((q11, q12, q13), (q12, q22, q23), (q13, q23, q33)), dtype=float)
        u = np.array(((-t + a * t * t / 2 + (1 - e) / a) / a, t - (1 - e) / a, 1 - e), dtype=float)
    return f, q, u


@pytest.mark.parametrize("dt", [0.01, 0.05, 1.0, 30.0])
@pytest.mark.parametrize("decay", [1e-9, 1e-7, *DECAYS, 0.999, 1.001, 6.0, 12.0, 30.0, 60.0, 2000.0])
def test_a_decaying_axis_is_the_papers_closed_form_without_its_cancellation(decay: float, dt: float) -> None:
    """From αT far below those of a radar to a fast decay over a long gap."""
    axis = decaying_axis(decay / dt, dt, 1.0, order=2)
    f, q, u = exact(decay, dt)
    np.testing.assert_allclose(axis.transition, f, rtol=1e-13, atol=0)
    np.testing.assert_allclose(axis.noise, q, rtol=1e-13, atol=0)
    np.testing.assert_allclose(axis.input, u, rtol=1e-13, atol=0)
    deviation = np.sqrt(np.diag(axis.noise))
    assert np.linalg.eigvalsh(axis.noise / np.outer(deviation, deviation)).min() > 5e-3


def test_no_time_changes_nothing() -> None:
    for order in (1, 2):
        axis = decaying_axis(0.5, 0.0, 1.0, order=order)
        np.testing.assert_array_equal(axis.transition, np.diag((1.0, 1.0, order - 1.0)))
        assert not axis.noise.any()
        assert not axis.input.any()


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("decay", DECAYS)
def test_the_input_of_a_mean_is_a_matrix_exponential(decay: float, order: int) -> None:
    """Paper 000 (16), and the like for a velocity: the mean as one more state that never changes."""
    dt = 0.4
    alpha = decay / dt
    a = np.diag(np.ones(order + 1), 1)
    a[order, order:] = -alpha, alpha
    u = decaying_axis(alpha, dt, 1.0, order=order).input
    np.testing.assert_allclose(u[: order + 1], expm(a * dt)[: order + 1, order + 1], rtol=1e-9)
    assert not u[order + 1 :].any()
