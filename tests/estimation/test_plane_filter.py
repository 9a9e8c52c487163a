"""The filter of one model in the plane against the bank of that one model, and what its form must keep."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats, Indices
from candaemon.estimation.filter_bank import FilterBank
from candaemon.estimation.imm import Imm
from candaemon.estimation.measurement import Measurement, Projection
from candaemon.estimation.motion_models import CurrentStatistical, Singer
from candaemon.estimation.packed_symmetric import PackedSymmetric
from candaemon.estimation.plane_filter import PlaneFilter
from tests.support.builders import polar_measurement, random_covariance
from tests.support.effort import examples

SEEDS = st.integers(0, 2**32 - 1)
MODELS = (Singer(0.5, 2.0), CurrentStatistical(0.5, 10.0, 1.0), CurrentStatistical(0.2, 8.0, 0.1, 1.0))
EAST: Floats = np.array([[1.0, 0.0]])


def both(model: Singer | CurrentStatistical, rng: np.random.Generator, tracks: int) -> tuple[PlaneFilter, Imm]:
    """Return the filter and the bank of its model, with the same tracks."""
    plane, bank = PlaneFilter(model, acceleration=3.0), Imm([model], switch_rate=1.0, acceleration=3.0)
    place, velocity = rng.normal(size=(tracks, 2)) * 50.0, rng.normal(size=(tracks, 2)) * 10.0
    spreads = random_covariance(rng, 2, tracks), random_covariance(rng, 2, tracks)
    for each in (plane, bank):
        each.spawn(place, spreads[0], velocity, spreads[1])
    return plane, bank


def detections(bank: FilterBank, rows: Indices, rng: np.random.Generator, speeds: int) -> Measurement:
    """Return detections near tracks: of positions, of range rates that may lack, of velocity components."""
    place = bank.combined()[0][rows, :2] + rng.normal(size=(len(rows), 2))
    rate = rng.normal(size=len(rows)) * 10.0 if speeds else None
    if rate is not None:
        rate[rng.random(len(rows)) < 0.3] = np.nan
    seen = polar_measurement(np.hypot(*place.T), np.arctan2(*place.T[::-1]), rate, (0.3, 0.02, 0.1))
    components = tuple(
        Projection(np.tile(unit, (len(rows), 1)), rng.normal(size=len(rows)), np.full(len(rows), 0.2))
        for unit in np.eye(2)[: max(speeds - 1, 0)]
    )
    return Measurement(
        seen.position, seen.noise, seen.origin, seen.velocity, rate, seen.range_rate_variance, components
    )


def assert_same(plane: FilterBank, bank: FilterBank) -> None:
    for mine, other in zip(plane.combined(), bank.combined(), strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-9, atol=1e-9)
    covariance = plane.combined()[1]
    np.testing.assert_array_equal(covariance, np.swapaxes(covariance, 1, 2))


@settings(deadline=None, max_examples=examples(40))
@given(seed=SEEDS, model=st.sampled_from(MODELS), speeds=st.integers(0, 3), tracks=st.integers(1, 9))
def test_the_plane_filter_equals_the_bank_of_its_model(
    seed: int, model: Singer | CurrentStatistical, speeds: int, tracks: int
) -> None:
    rng = np.random.default_rng(seed)
    plane, bank = both(model, rng, tracks)
    for _ in range(20):
        dt = float(rng.uniform(0.0, 0.3))
        rows = np.flatnonzero(rng.random(tracks) < 0.8)
        for each in (plane, bank):
            each.predict(dt, np.tile(EAST, (tracks, 1)))
        seen = detections(bank, rows, rng, speeds)
        np.testing.assert_allclose(plane.update(rows, seen), bank.update(rows, seen), rtol=1e-8, atol=1e-9)
        assert_same(plane, bank)


def test_rows_come_and_go_and_move_as_the_banks() -> None:
    rng = np.random.default_rng(3)
    plane, bank = both(MODELS[1], rng, 6)
    spread = random_covariance(rng, 2, 2)
    for each in (plane, bank):
        each.predict(0.05, np.tile(EAST, (6, 1)))
        each.clone(np.array([4, 1]), np.ones((2, 2)), spread)
        each.keep(np.array([True, False, True, True, False, True, True, True]))
        each.retrodict(0.02)
        each.spawn(np.zeros((1, 2)), spread[:1], np.ones((1, 2)), spread[1:])
        each.predict(0.05, np.tile(EAST, (7, 1)))
    assert len(plane) == len(bank) == 7
    assert_same(plane, bank)
    rows = np.array([6, 0])
    np.testing.assert_allclose(
        plane.expected_position(rows, 0.7, EAST), bank.expected_position(rows, 0.7, EAST), rtol=1e-12
    )


def test_a_smoother_hears_the_same() -> None:
    plane, bank = both(MODELS[1], np.random.default_rng(4), 5)
    for each in (plane, bank):
        each.linking = True
        each.predict(0.05, np.tile(EAST, (5, 1)))
    mine, other = plane.link, bank.link
    assert mine is not None
    assert other is not None
    np.testing.assert_allclose(mine.mean, other.mean, rtol=1e-10)
    np.testing.assert_allclose(mine.covariance, other.covariance, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(mine.gain, other.gain, rtol=1e-7, atol=1e-9)


def test_without_tracks_it_does_nothing() -> None:
    plane = PlaneFilter(MODELS[1], acceleration=3.0)
    plane.predict(0.05, np.zeros((0, 2)))
    nothing = Measurement(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(2), np.zeros(2))
    assert len(plane.update(np.empty(0, np.intp), nothing)) == 0
    assert plane.combined()[1].shape == (0, 6, 6)


@pytest.mark.parametrize("size", [1, 2, 3, 6])
def test_triangles_are_the_matrices(size: int) -> None:
    rng = np.random.default_rng(size)
    triangle, matrices, f = PackedSymmetric(size), random_covariance(rng, size, 7), rng.normal(size=(size, size))
    packed = triangle.pack(matrices)
    assert packed.shape == (triangle.entries, 7)
    np.testing.assert_allclose(triangle.unpack(packed), matrices, rtol=1e-12)
    moved = triangle.unpack(triangle.propagation(f) @ packed)
    np.testing.assert_allclose(moved, f @ matrices @ f.T, rtol=1e-10, atol=1e-12)
    vectors = rng.normal(size=(size, 7))
    outer = np.einsum("in,jn->nij", vectors, vectors)
    np.testing.assert_array_equal(triangle.unpack(triangle.product(vectors)), outer)
    np.testing.assert_array_equal(packed[triangle.diagonal], np.diagonal(matrices, axis1=1, axis2=2).T)
