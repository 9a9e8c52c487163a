"""A vehicle is rigid: what has another speed than most of what a scan shows of it is something else.

A car that waits over a manhole cover shows the cover as one of its reflections. As it starts off, the cover holds it
back, and would keep its identity where it stands.
"""

from __future__ import annotations

import numpy as np

from candaemon import compiled
from candaemon.arrays import Floats, Indices
from candaemon.arrays.rows import distinct
from candaemon.config.tracker import ReflectionSettings
from candaemon.estimation.body_filter import VELOCITY
from candaemon.estimation.measurement import Measurement, line_of_sight
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.turning import rate_and_pivot

_FEWEST = 3  # detections of a body: of two, neither is the most
_NONE = np.empty(0, dtype=np.intp)


def contradicting(bodies: Bodies, body: Indices, measurement: Measurement, settings: ReflectionSettings) -> Indices:
    """Return rows of detections whose speed is not that of most detections of the vehicle that they were taken for.

    Args:
        bodies: that are known.
        body: row of the body of each detection (m,), −1: of none.
        measurement: of the scan (m).
        settings: by how much they may differ, and how fast what is no vehicle is at most.
    """
    if compiled.in_use:
        turn, pivot = rate_and_pivot(bodies.turning())
        (x, y), (vx, vy) = measurement.origin.tolist(), measurement.velocity.tolist()
        found = compiled.kernels.apart_from_most(
            body,
            bodies.obstacles.fastest,
            bodies.moments().shown,
            measurement.position,
            measurement.range_rate,
            x,
            y,
            vx,
            vy,
            measurement.projections,
            turn,
            pivot,
            _FEWEST,
            settings.stray.fastest,
            settings.speed,
        )
        return np.array(found, dtype=np.intp) if found else _NONE
    of_some = (body >= 0).nonzero()[0]
    several = np.bincount(body[of_some], minlength=len(bodies)) >= _FEWEST
    several &= bodies.obstacles.fastest > settings.stray.fastest
    rows = of_some[several[body[of_some]]]
    if not len(rows):
        return rows
    faster, owner = _faster(bodies, body[rows], measurement.take(rows)), body[rows]
    apart = np.zeros(len(rows))
    for each in distinct(owner).tolist():
        own = owner == each
        apart[own] = np.abs(faster[own] - np.median(faster[own], axis=0)).max(axis=1)
    return rows[apart > settings.speed]


def _faster(bodies: Bodies, body: Indices, measurement: Measurement) -> Floats:
    """Return by how much measured speeds exceed those of the bodies at those places (m, f), m/s; 0: not measured."""
    velocity = bodies.moments().shown[body, VELOCITY]
    if (turning := bodies.turning()) is not None:
        velocity = velocity + turning.velocities(body, measurement.position)
    faster = [part.value - (part.direction * velocity).sum(axis=1) for part in measurement.projections]
    if measurement.range_rate is not None:
        moving = np.concatenate([measurement.position, velocity], axis=1)
        faster.append(measurement.range_rate - line_of_sight(moving, measurement.origin, measurement.velocity)[0])
    return np.nan_to_num(np.stack(faster, axis=1)) if faster else np.zeros((len(body), 1))
