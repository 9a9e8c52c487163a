"""The outline of a vehicle: the ellipse inscribed in its box, and the point of it that faces an observer.

The reference point of an obstacle is the point of that ellipse whose outward normal faces the vehicle's own origin. It
is the ellipse's nearest point, moves steadily as the aspect changes, and is the point itself where the box has no size.
"""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Floats

_ROUNDS = 6
"""Enough for a centimetre on a lorry from a metre away, far less on a car."""
_LEAST = 1e-6  # m, semi-axes of a point


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
    a, b = np.maximum(half_length, _LEAST), np.maximum(half_width, _LEAST)
    x, y = np.abs(observer.T)
    focal = a * a - b * b
    evolute_x, evolute_y = focal / a, -focal / b
    c = s = np.full(len(observer), np.sqrt(0.5))  # cosine and sine of the point's parameter
    for _ in range(_ROUNDS):
        centre_x, centre_y = evolute_x * c * c * c, evolute_y * s * s * s
        away_x, away_y = x - centre_x, y - centre_y
        radius = np.hypot(a * c - centre_x, b * s - centre_y)
        ratio = radius / np.maximum(np.hypot(away_x, away_y), _LEAST)
        c = np.minimum(np.maximum((away_x * ratio + centre_x) / a, 0.0), 1.0)
        s = np.minimum(np.maximum((away_y * ratio + centre_y) / b, 0.0), 1.0)
        length = np.maximum(np.hypot(c, s), _LEAST)
        c /= length
        s /= length
    return np.asarray(np.copysign(np.stack([a * c, b * s], axis=1), observer))
