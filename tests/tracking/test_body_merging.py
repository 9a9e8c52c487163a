"""Which obstacles are one vehicle."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.config.tracker import ReflectionSettings
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.tracking.body_merging import merge_candidates
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.identities import Identities

FIRST_NS = 10**9


@pytest.mark.parametrize(
    ("behind", "deviation", "lost", "older"),
    [(1.0, 1.0, False, 0), (1.0, 0.2, False, -1), (4.5, 1.0, False, -1), (1.0, 1.0, True, -1)],
    ids=["as far as is known", "too fast", "too far away", "one of them lost"],
)
def test_what_is_in_one_place_is_one_vehicle_unless_its_speed_is_known_to_differ(
    behind: float, deviation: float, lost: bool, older: int
) -> None:
    """Of what crosses, the speed is known only after some scans: the second obstacle seems 3 m/s faster."""
    bodies = Bodies(VehicleEstimatorSettings(kind="vehicle"), Identities())
    modes = bodies.filter.probability.shape[1]
    velocity = np.tile(np.array([[2.0, 0.0], [5.0, 0.0]])[:, None], (1, modes, 1))
    spread = np.tile(np.eye(2) * deviation**2, (2, modes, 1, 1))
    place = np.array([[0.0, 20.0], [-behind, 20.0]])
    bodies.filter.spawn(place, np.tile(np.eye(2) * 0.04, (2, 1, 1)), velocity, spread, np.full((2, modes), 1 / modes))
    for row in range(2):
        bodies.add(FIRST_NS, np.array([1.0, 0.0]), 4.5, 1.8)
        bodies.add_reflection(row, 0, row, FIRST_NS, np.zeros(2))
    bodies.obstacles.confirmed[0] = True
    bodies.obstacles.last_ns[:] = FIRST_NS * 3, FIRST_NS * (2 if lost else 3)
    found, _ = merge_candidates(bodies, ReflectionSettings(), 3 * FIRST_NS)
    assert found.tolist() == [-1, older]
