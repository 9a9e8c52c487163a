"""Reflections that stray from their bodies: of someone who stood beside what stands, and walks away from it.

What stands together is one obstacle where nothing tells otherwise, a walker between parked cars too, and a range rate
tells nothing of who crosses the line of sight. So the place of each reflection is followed for itself, by a fading
memory of first degree (Morrison 1969); where one of a body walks for as far as its noise allows to be sure, and another
one stands, they are two.
"""

from __future__ import annotations

import numpy as np

from candaemon import compiled
from candaemon.arrays import Indices
from candaemon.config.tracker import ReflectionSettings
from candaemon.estimation.measurement import Measurement
from candaemon.tracking.body_modes import STANDING
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.reflections import to_travel_axes

_SURELY = 3.0  # standard deviations
_JUMP = 4.5  # variances of its place, squared apart which a reflection has slid, and not walked: three deviations
_LEAST_JUMP = 0.3  # m, and what one walks in a scan, nearer than which nothing has
_STILL = 0.5  # of the speed below which things stand: as slow as that a reflection does
_LEAST_STEP = 1e-3  # s
_NEAREST = 1.0  # m, nearer than which a line of sight turns anyhow
_WALKING, _STANDING = (0.5, 0.1, 0.1, 0.05, 0.01, 0.24), (0.08, 0.01, 0.01, 0.89, 0.0, 0.01)  # modes of the two parts
_PLACE_SPREAD = 0.3  # m
_WALKING_SPREAD, _STANDING_SPREAD = 0.5, 0.1  # m/s


def note_strays(
    bodies: Bodies, rows: Indices, body: Indices, measurement: Measurement, time_ns: int, settings: ReflectionSettings
) -> None:
    """Note how fast reflections move over ground, and for how far and how long they have walked or stood.

    A jump is no walk: until `ReflectionSettings.patience` has passed it is an outlier, then the place is followed anew.
    And what lies on a vehicle that we pass slides over it as fast as the line of sight turns.

    Args:
        bodies: with the reflections.
        rows: of the reflections detected, none twice (m,).
        body: row of each one's body (m,).
        measurement: of those (m), local frame.
        time_ns: of the scan.
        settings: how fast, how far.
    """
    reflections, stray = bodies.reflections, settings.stray
    dt = (time_ns - reflections.trail_ns.take(rows)) * 1e-9
    lost = dt > settings.patience
    dt = np.minimum(np.maximum(dt, _LEAST_STEP), settings.patience)
    keep = np.exp(dt / -stray.memory)
    trail, walked, stood = reflections.trail, reflections.walked, reflections.stood
    position, noise, sensor = measurement.position, measurement.noise, measurement.origin
    length, slow, memory = bodies.obstacles.length, settings.stood.speed, stray.memory
    if compiled.in_use:
        (x, y), (vx, vy) = sensor.tolist(), measurement.velocity.tolist()
        compiled.kernels.note_strays(
            trail,
            walked,
            stood,
            reflections.trail_ns,
            rows,
            body,
            position,
            noise,
            length,
            dt,
            keep,
            lost,
            time_ns,
            x,
            y,
            vx,
            vy,
            slow,
            stray.distance,
            stray.deviations,
            memory**3,
            _SURELY,
            _JUMP,
            _LEAST_JUMP,
            stray.fastest,
            _STILL * slow,
            _NEAREST,
        )
        return
    place, velocity = trail[rows, :2], trail[rows, 2:]
    expected = place + dt[:, None] * velocity
    residual = position - expected
    variance = noise[:, 0, 0] + noise[:, 1, 1]
    least = _LEAST_JUMP + stray.fastest * dt
    jump = np.maximum(_JUMP * variance, least * least)
    told = lost | (residual[:, 0] * residual[:, 0] + residual[:, 1] * residual[:, 1] <= jump)
    gain = (1.0 - keep) * (1.0 - keep) / dt
    velocity = np.where(lost[:, None], 0.0, velocity + gain[:, None] * residual)
    followed = np.where(lost[:, None], position, expected + (1.0 - keep * keep)[:, None] * residual)
    sight, own = position - sensor, measurement.velocity
    distance = np.maximum(sight[:, 0] * sight[:, 0] + sight[:, 1] * sight[:, 1], _NEAREST)
    turns = np.abs(sight[:, 0] * own[1] - sight[:, 1] * own[0]) / distance
    unsure = np.sqrt(variance * dt / (4.0 * memory**3))
    slowest = np.maximum(slow, _SURELY * unsure) + 0.5 * length[body] * turns
    speed = np.sqrt(velocity[:, 0] * velocity[:, 0] + velocity[:, 1] * velocity[:, 1])
    share = dt * speed / np.maximum(stray.distance, stray.deviations * np.sqrt(variance))
    walks, stands = (speed > slowest) & (speed < stray.fastest), ~lost & (speed < _STILL * slow)
    share, time = np.where(walks, walked[rows] + share, 0.0), np.where(stands, stood[rows] + dt, 0.0)
    rows = rows[told]
    trail[rows, :2], trail[rows, 2:], reflections.trail_ns[rows] = followed[told], velocity[told], time_ns
    walked[rows], stood[rows] = share[told], time[told]


def strays(bodies: Bodies, settings: ReflectionSettings, time_ns: int) -> Indices | None:
    """Return the reflections detected in this cycle that do what their leading one does not; None: there are none.

    One of them walks and the other stands. Of what was faster than someone walks, reflections slide as it brakes.

    Args:
        bodies: with the reflections.
        settings: how far one walks, for how long the other stands.
        time_ns: of the cycle.
    """
    reflections, obstacles, stray = bodies.reflections, bodies.obstacles, settings.stray
    mean, still = bodies.moments().mean, (_STILL * settings.stood.speed) ** 2
    since_ns = time_ns - round(settings.patience * 1e9)
    if compiled.in_use:
        return compiled.kernels.strays(
            reflections.walked,
            reflections.stood,
            reflections.body,
            reflections.last_ns,
            obstacles.leader,
            obstacles.fastest,
            mean,
            still,
            stray.still,
            stray.fastest,
            since_ns,
            time_ns,
        )
    body = reflections.body
    lead, slow = obstacles.leader[body], obstacles.fastest < stray.fastest
    rests = mean[:, 2] * mean[:, 2] + mean[:, 3] * mean[:, 3] < still
    walks, stands = reflections.walked >= 1.0, reflections.stood >= stray.still
    rests = stands[lead] | rests[body] & (reflections.stood[lead] > 0.0)
    apart = walks & ~walks[lead] & rests | stands & walks[lead]
    seen = (reflections.last_ns == time_ns) & (reflections.last_ns[lead] >= since_ns)
    found = np.flatnonzero(apart & seen & slow[body])
    return found if len(found) else None


def part(bodies: Bodies, rows: Indices, settings: ReflectionSettings) -> None:
    """Give reflections bodies of their own; where trails tell that these, or what they leave, walk or stand, they do.

    Of what drives faster than anyone walks, trails tell nothing.

    Args:
        bodies: of which some become two.
        rows: of the reflections, none of them leads (m,).
        settings: for how long one stands.
    """
    reflections, obstacles, known = bodies.reflections, bodies.obstacles, len(bodies)
    owner, place = reflections.body[rows], bodies.offsets(rows)
    left = np.unique(owner)
    stands = (reflections.stood[rows] >= settings.stray.still) & (reflections.walked[obstacles.leader[owner]] >= 1.0)
    alone = ~stands
    alone[np.unique(np.where(stands, owner, -1 - np.arange(len(rows))), return_index=True)[1]] = True
    bodies.split(rows[alone])
    for row, of, at in zip(rows[~alone].tolist(), owner[~alone].tolist(), place[~alone], strict=True):
        first = int(np.flatnonzero(alone & stands & (owner == of))[0])
        body = int(reflections.body[rows[first]])
        reflections.body[row] = body
        reflections.offset[row] = to_travel_axes(at - place[first], obstacles.axis[body])
    parted = np.concatenate([np.arange(known, len(bodies)), left])
    lead = np.concatenate([rows[alone], obstacles.leader[left]])
    walks, stands = reflections.walked[lead] >= 1.0, reflections.stood[lead] >= settings.stray.still
    told = np.flatnonzero((walks | stands) & (obstacles.fastest[parted] < settings.stray.fastest))
    parted, lead, walks = parted[told], lead[told], walks[told]
    count = np.bincount(reflections.body, minlength=len(bodies))[parted]
    reflections.offset[lead[count == 1]] = 0.0
    moves = np.arange(len(_WALKING)) != STANDING
    velocity = np.where((walks[:, None] & moves)[..., None], reflections.trail[lead, None, 2:], 0.0)
    spread = np.where(walks[:, None] & moves, _WALKING_SPREAD, _STANDING_SPREAD)
    bodies.filter.restart(
        parted,
        reflections.trail[lead, :2] - bodies.offsets(lead),
        np.broadcast_to(np.eye(2) * _PLACE_SPREAD**2, (len(parted), 2, 2)),
        velocity,
        np.square(spread)[..., None, None] * np.eye(2),
        np.where(walks[:, None], _WALKING, _STANDING),
    )
    reflections.walked[lead] = reflections.stood[lead] = 0.0
    bodies.changed()
