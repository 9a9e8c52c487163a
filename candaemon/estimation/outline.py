"""The outline of a vehicle: the ellipse inscribed in its box, and the point of it that faces an observer.

The reference point of an obstacle is the point of that ellipse whose outward normal faces the vehicle's own origin. It
is the ellipse's nearest point, moves steadily as the aspect changes, and is the point itself where the box has no size.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from candaemon import compiled
from candaemon.arrays import Floats

ROUNDS: Final = 6
"""Enough for a centimetre on a lorry from a metre away, far less on a car."""
LEAST: Final = 1e-6
"""m, semi-axes of a point."""


def facing_point(observer: Floats, half_length: Floats, half_width: Floats) -> Floats:
    """Return the points of ellipses whose outward normals face an observer.

    The ellipse is taken for its circle of curvature at the latest point, and the point of that circle is the next one.

    Args:
        observer: in each box's own axes, from its centre, x along the length (n, 2), m.
        half_length: a (n,), m.
        half_width: b (n,), m.

    Returns:
        In the same axes (n, 2), m. For an observer inside the ellipse too it is a point of the outline.
    """
    if compiled.in_use:
        return compiled.kernels.facing_points(observer, half_length, half_width, ROUNDS, LEAST)
    axes, eye = np.maximum(np.stack([half_length, half_width]), LEAST), np.abs(observer.T)
    squares = axes * axes
    evolute = (squares - squares[::-1]) / axes
    share = np.full(eye.shape, np.sqrt(0.5))  # cosine and sine of the point's parameter
    for _ in range(ROUNDS):
        centre = evolute * share * share * share
        away = eye - centre
        ratio = _length(axes * share - centre) / np.maximum(_length(away), LEAST)
        share = np.minimum(np.maximum((away * ratio + centre) / axes, 0.0), 1.0)
        share /= np.maximum(_length(share), LEAST)
    return np.asarray(np.copysign((axes * share).T, observer))


def _length(vectors: Floats) -> Floats:
    """Return the lengths (n,) of vectors (2, n)."""
    return np.asarray(np.sqrt(vectors[0] * vectors[0] + vectors[1] * vectors[1]))
