"""Vehicles that drive off from what they stood over.

A cover in the road, or a post beside it, may have been one of the reflections of a vehicle that stood there. Where it
is the one that is seen as the vehicle drives off, the obstacle stays with it, and the vehicle seems to be another one.
"""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Indices
from candaemon.config.tracker import ReflectionSettings
from candaemon.estimation.body_filter import POSITION, VELOCITY
from candaemon.tracking.body_merging import found_small
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.reflections import to_travel_axes

_ALONG = 0.5  # speed across the axis, as a share of that along it, up to which it drives off along its axis


def departures(bodies: Bodies, young: Indices, settings: ReflectionSettings, time_ns: int) -> list[tuple[int, int]]:
    """Return which newly confirmed obstacles drive off from where an older one, which had driven there, seems to stay.

    The older one is detected still. As what stays may have lain at either end of the vehicle, the other one appears
    within a box of twice its length, and drives along it.

    Args:
        bodies: of the cycle.
        young: rows of those just confirmed (m,).
        settings: what stands, and what has moved.
        time_ns: of the cycle.

    Returns:
        Pairs of rows: who drives off, and what stays. No row is in two of them.
    """
    obstacles, moments, stood = bodies.obstacles, bodies.moments(), settings.stood
    place, velocity = moments.shown[:, :2], moments.mean[:, VELOCITY]
    squared = (velocity * velocity).sum(axis=1)
    driving = young[(squared[young] > stood.moved**2) & ~found_small(bodies)[young]]
    if not len(driving):
        return []
    stays = obstacles.confirmed & obstacles.directed & (obstacles.fastest > stood.moved) & (squared < stood.speed**2)
    stays &= obstacles.last_ns >= time_ns - round(settings.stray.patience * 1e9)
    stays[young] = False
    standing, found = stays.nonzero()[0], []
    axis, reach = obstacles.axis[standing], np.stack([obstacles.length, 0.5 * obstacles.width], axis=1)[standing]
    centre = moments.mean[standing, POSITION] - obstacles.facing[standing]
    for row in driving.tolist():
        inside = (np.abs(to_travel_axes(place[row] - centre, axis)) < reach).all(axis=1)
        speed = np.abs(to_travel_axes(np.broadcast_to(velocity[row], axis.shape), axis))
        over = (inside & (speed[:, 1] < _ALONG * speed[:, 0])).nonzero()[0]
        if len(over):
            found.append((row, int(standing[over[0]])))
            rest = standing != standing[over[0]]
            standing, axis, reach, centre = standing[rest], axis[rest], reach[rest], centre[rest]
    return found
