"""The ground as a plane: WGS 84 latitude and longitude to and from the plane that touches the earth at a point.

Heights above the ellipsoid count as zero, both ways: a place is where its vertical onto the plane meets the ground.
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import Final, TypeVar

import numpy as np

from candaemon.arrays import Floats

Coordinate = TypeVar("Coordinate", float, Floats)

SEMI_MAJOR: Final = 6_378_137.0
"""m, radius of WGS 84's equator."""
FLATTENING: Final = 1 / 298.257223563
"""Of WGS 84."""
_REMAINDER: Final = (1 - FLATTENING) ** 2
"""1 − e², the square of the ratio of the two axes."""


def ecef(latitude: Coordinate, longitude: Coordinate) -> tuple[Coordinate, Coordinate, Coordinate]:
    """Return earth-centred coordinates of places on the ellipsoid, m.

    Args:
        latitude: geodetic, rad, positive north; a number or an array.
        longitude: rad, positive east; of the same shape.
    """
    s, c = np.sin(latitude), np.cos(latitude)
    normal = SEMI_MAJOR / np.sqrt(1 - (1 - _REMAINDER) * s * s)
    return normal * c * np.cos(longitude), normal * c * np.sin(longitude), normal * _REMAINDER * s


class TangentPlane:
    """The plane that touches WGS 84 at an origin, axes east and north there.

    Both ways are closed forms, exact to the rounding of the numbers (nanometres) as far as the earth reaches.

    Args:
        latitude: of the origin, geodetic, rad, positive north.
        longitude: of the origin, rad, positive east.
    """

    def __init__(self, latitude: float, longitude: float) -> None:
        self.latitude, self.longitude = latitude, longitude
        s, c = sin(latitude), cos(latitude)
        self._sine, self._cosine = s, c
        self._turn = cos(longitude), sin(longitude)
        self._normal = SEMI_MAJOR / sqrt(1 - (1 - _REMAINDER) * s * s)

    def project(self, latitude: Coordinate, longitude: Coordinate) -> tuple[Coordinate, Coordinate]:
        """Return where places lie in the plane: east and north of the origin, m.

        Args:
            latitude: geodetic, rad, positive north; a number or an array.
            longitude: rad, positive east; of the same shape.
        """
        x, y, z = ecef(latitude, longitude)
        cosine, sine = self._turn
        outward, east = cosine * x + sine * y, cosine * y - sine * x
        outward = outward - self._normal * self._cosine
        north = self._cosine * (z - self._normal * _REMAINDER * self._sine) - self._sine * outward
        return east, north

    def to_earth(self, east: Floats, north: Floats) -> tuple[Floats, Floats]:
        """Return latitude and longitude, rad, of points in the plane; longitude within (−π, π].

        A point off the edge of the earth comes back as a place on its horizon.

        Args:
            east: m, (n,).
            north: m, (n,).
        """
        s, c = self._sine, self._cosine
        down = self._drop(east, north)
        # the meridian's plane of the origin: outward from the axis, along the axis
        outward = (self._normal - down) * c - north * s
        along = (self._normal * _REMAINDER - down) * s + north * c
        radius = np.hypot(outward, east)
        latitude = np.arctan2(along, _REMAINDER * radius)
        turned = np.arctan2(east, outward) + self.longitude
        return latitude, np.arctan2(np.sin(turned), np.cos(turned))

    def _drop(self, east: Floats, north: Floats) -> Floats:
        """Return how far the ground lies under points of the plane, m.

        With the polar axis stretched by a / b the ellipsoid is a sphere, and what touches it still does: for a point d
        of the plane and the stretched vertical u, |q + d − t u| = a leaves t² u² − 2 t u·(q + d) + d² = 0.
        """
        s, c = self._sine, self._cosine
        stretched = c * c + s * s / _REMAINDER
        square = east * east + north * north * (s * s + c * c / _REMAINDER)
        half = self._normal + north * (s * c * (1 / _REMAINDER - 1))
        root = np.sqrt(np.maximum(half * half - stretched * square, 0.0))
        drop: Floats = square / np.maximum(half + root, 1.0)
        return drop
