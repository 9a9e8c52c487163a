"""WGS 84 and the plane that touches it, against textbook formulas of its own."""

from __future__ import annotations

from math import cos, degrees, pi, radians, sin, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.ego.geodesy import TangentPlane, ecef
from tests.support.effort import examples

A, INVERSE_FLATTENING = 6_378_137.0, 298.257_223_563
LATITUDES, LONGITUDES = st.floats(-90.0, 90.0), st.floats(-180.0, 180.0)
WITHIN_10_KM = st.floats(-7_000.0, 7_000.0)


def cartesian(latitude: float, longitude: float, height: float = 0.0) -> Floats:
    """Earth-centred coordinates, m, as EPSG guidance note 7-2 writes them; deg."""
    f = 1 / INVERSE_FLATTENING
    e2 = 2 * f - f * f
    phi, lam = radians(latitude), radians(longitude)
    nu = A / sqrt(1 - e2 * sin(phi) ** 2)
    return np.array(
        [
            (nu + height) * cos(phi) * cos(lam),
            (nu + height) * cos(phi) * sin(lam),
            ((1 - e2) * nu + height) * sin(phi),
        ]
    )


def topocentric(point: Floats, latitude: float, longitude: float, height: float = 0.0) -> Floats:
    """East, north and up of an earth-centred point from an origin in deg, by the same note's rotation."""
    phi, lam = radians(latitude), radians(longitude)
    rotation = np.array(
        [
            [-sin(lam), cos(lam), 0.0],
            [-sin(phi) * cos(lam), -sin(phi) * sin(lam), cos(phi)],
            [cos(phi) * cos(lam), cos(phi) * sin(lam), sin(phi)],
        ]
    )
    east_north_up: Floats = rotation @ (point - cartesian(latitude, longitude, height))
    return east_north_up


def test_the_notes_own_example_holds() -> None:
    """EPSG guidance note 7-2, geocentric and topocentric conversions: the formulas of this file are right."""
    place = 53 + 48 / 60 + 33.820 / 3600, 2 + 7 / 60 + 46.380 / 3600
    np.testing.assert_allclose(cartesian(*place, 73.0), [3_771_793.968, 140_253.342, 5_124_304.349], atol=1e-3)
    relative = topocentric(cartesian(*place, 73.0), 55.0, 5.0, 200.0)
    np.testing.assert_allclose(relative, [-189_013.869, -128_642.040, -4_220.171], atol=1e-3)


@settings(deadline=None, max_examples=examples(200))
@given(latitude=LATITUDES, longitude=LONGITUDES)
def test_places_on_the_ellipsoid(latitude: float, longitude: float) -> None:
    np.testing.assert_allclose(ecef(radians(latitude), radians(longitude)), cartesian(latitude, longitude), atol=1e-8)


@settings(deadline=None, max_examples=examples(200))
@given(latitude=LATITUDES, longitude=LONGITUDES, east=WITHIN_10_KM, north=WITHIN_10_KM)
def test_both_ways_are_exact_within_10_km(latitude: float, longitude: float, east: float, north: float) -> None:
    plane = TangentPlane(radians(latitude), radians(longitude))
    phi, lam = plane.to_earth(np.array([east]), np.array([north]))
    there = topocentric(cartesian(degrees(phi[0]), degrees(lam[0])), latitude, longitude)
    np.testing.assert_allclose(there[:2], [east, north], atol=1e-6)  # a thousandth of what is asked for
    assert there[2] == pytest.approx(-(east**2 + north**2) / (2 * 6_371_000), rel=0.01, abs=1e-6)
    np.testing.assert_allclose(plane.project(phi, lam), [[east], [north]], atol=1e-6)


@settings(deadline=None, max_examples=examples(100))
@given(latitude=LATITUDES, longitude=LONGITUDES, course=st.floats(-pi, pi), distance=st.floats(1e4, 6.2e6))
def test_a_plane_reaches_as_far_as_the_earth(latitude: float, longitude: float, course: float, distance: float) -> None:
    plane = TangentPlane(radians(latitude), radians(longitude))
    point = np.array([[distance * cos(course)], [distance * sin(course)]])
    np.testing.assert_allclose(plane.project(*plane.to_earth(*point)), point, atol=1e-5)


def test_numbers_and_arrays_agree() -> None:
    plane = TangentPlane(radians(48.1), radians(11.6))
    latitude, longitude = np.radians([48.1, 48.1001, 48.0]), np.radians([11.6, 11.5999, 11.7])
    together = np.array(plane.project(latitude, longitude))
    for k in range(3):
        np.testing.assert_array_equal(plane.project(float(latitude[k]), float(longitude[k])), together[:, k])
    np.testing.assert_allclose(together[:, 0], 0.0, atol=1e-8)


def test_a_metre_east_and_north_by_the_radii_of_curvature() -> None:
    f = 1 / INVERSE_FLATTENING
    e2, phi = 2 * f - f * f, radians(60.0)
    normal = A / sqrt(1 - e2 * sin(phi) ** 2)
    meridian = A * (1 - e2) / (1 - e2 * sin(phi) ** 2) ** 1.5
    latitude, longitude = TangentPlane(phi, 0.1).to_earth(np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    assert longitude[0] - 0.1 == pytest.approx(1 / (normal * cos(phi)), rel=1e-6)
    assert latitude[1] - phi == pytest.approx(1 / meridian, rel=1e-6)


def test_the_date_line_is_crossed() -> None:
    plane = TangentPlane(0.3, radians(179.999))
    _, longitude = plane.to_earth(np.array([-1000.0, 1000.0]), np.zeros(2))
    assert degrees(longitude[0]) == pytest.approx(179.99, abs=0.001)
    assert degrees(longitude[1]) == pytest.approx(-179.992, abs=0.001)
    east, _ = plane.project(np.full(2, 0.3), np.array([longitude[1], longitude[1] + 2 * pi]))
    np.testing.assert_allclose(east, 1000.0, atol=0.1)


def test_off_the_edge_of_the_earth_and_at_the_poles_all_is_finite() -> None:
    far = np.array([0.0, 1e5, 6.4e6, 1e9])
    for latitude in (-90.0, 0.0, 90.0):
        found = TangentPlane(radians(latitude), 1.0).to_earth(far, -far)
        assert np.isfinite(found).all()
        assert (np.abs(found[0]) <= pi / 2).all()
