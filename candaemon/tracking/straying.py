"""Reflections that stray from their bodies: of someone who stood beside what stands, and walks away from it.

Things that stand close together are one obstacle, and someone between parked cars is a part of it. A range rate does
not tell that they walk across the line of sight. So the place of each reflection is followed on its own, by a fading
memory of first degree (Morrison 1969). Where one reflection of a body surely walks and another stands, they are two. If
it was a vehicle, who walks leaves it, and it keeps its id: it has stopped for someone who crosses before it.

People who walk side by side are one obstacle too, as both sides of a car that creeps are: what they show lies as close
together, and moves alike. But a vehicle soon shows another reflection, or is faster; who walks shows the same one all
the time. Where all reflections of a body have walked for long, those abreast are several people.
"""

from __future__ import annotations

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices
from candaemon.arrays.rows import distinct
from candaemon.config.tracker import ReflectionSettings
from candaemon.estimation.measurement import Measurement
from candaemon.tracking.body_modes import STANDING
from candaemon.tracking.body_sizes import SURELY_ALONE, WALKER
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.reflections import lengths, to_travel_axes

_SURELY = 3.0  # standard deviations
_JUMP = 4.5  # sums of both variances: the square of three standard deviations along one axis. Beyond, it is an outlier
_LEAST_JUMP = 0.3  # m more than someone goes: an outlier is farther off, however precise the sensor
_STILL = 0.5  # of the speed of what stands: a single reflection that is slower than that does not move …
_PERHAPS = 2.0  # … nor does one that is slower than as many standard deviations of its speed
_LEAST_STEP = 1e-3  # s
_LEAST_SPEED = 0.1  # m/s; slower, nothing has a course
_NEAREST = 1.0  # m², keeps the turn rate of a line of sight without length finite
_WALKING, _STANDING = (0.5, 0.1, 0.1, 0.05, 0.01, 0.24), (0.08, 0.01, 0.01, 0.89, 0.0, 0.01)  # modes of the two parts
_PLACE_SPREAD = 0.3  # m
_WALKING_SPREAD, _STANDING_SPREAD = 0.5, 0.1  # m/s


def note_strays(
    bodies: Bodies, rows: Indices, body: Indices, measurement: Measurement, time_ns: int, settings: ReflectionSettings
) -> None:
    """Note how fast reflections move over ground, how far they have walked, and for how long they have stood.

    Outliers are left out: places farther off than someone runs since the last detection, and than someone walks since
    the last that was no outlier. After `StraySettings.patience` without any other, the reflection has slid, and is
    followed anew from there; those of vehicles slide often, and are after `ReflectionSettings.patience`. Of a gap, no
    more than that counts as walked. On a vehicle that we pass, a reflection slides as fast as the line of sight turns:
    that is no walk.

    Args:
        bodies: with the reflections.
        rows: of the reflections detected, none twice (m,).
        body: row of each one's body (m,).
        measurement: of those (m), local frame.
        time_ns: of the scan.
        settings: how fast, how far.
    """
    reflections, stray = bodies.reflections, settings.stray
    if compiled.in_use:
        limits = stray.fastest, stray.patience, settings.patience, _LEAST_STEP
        fastest = bodies.obstacles.fastest
        dt, lost = compiled.kernels.steps_of_trails(reflections.trail_ns, rows, body, fastest, time_ns, *limits)
    else:
        passed = (time_ns - reflections.trail_ns.take(rows)) * 1e-9
        patience = np.where(bodies.obstacles.fastest[body] < stray.fastest, stray.patience, settings.patience)
        dt, lost = np.clip(passed, _LEAST_STEP, patience), passed > patience
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
            reflections.last_ns,
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
            stray.running,
            _STILL * slow,
            _PERHAPS,
            settings.patience,
            _NEAREST,
        )
        _drive_on(bodies, rows, measurement, settings)
        return
    place, velocity = trail[rows, :2], trail[rows, 2:]
    expected = place + dt[:, None] * velocity
    residual = position - expected
    variance = noise[:, 0, 0] + noise[:, 1, 1]
    unseen = np.minimum(dt, (time_ns - reflections.last_ns[rows]) * 1e-9)
    least = np.maximum(stray.fastest * dt, stray.running * unseen) + _LEAST_JUMP
    jump = np.maximum(_JUMP * variance, least * least)
    usable = lost | (residual[:, 0] * residual[:, 0] + residual[:, 1] * residual[:, 1] <= jump)
    gain = (1.0 - keep) * (1.0 - keep) / dt
    velocity = np.where(lost[:, None], 0.0, velocity + gain[:, None] * residual)
    followed = np.where(lost[:, None], position, expected + (1.0 - keep * keep)[:, None] * residual)
    sight, own = position - sensor, measurement.velocity
    distance = np.maximum(sight[:, 0] * sight[:, 0] + sight[:, 1] * sight[:, 1], _NEAREST)
    turns = np.abs(sight[:, 0] * own[1] - sight[:, 1] * own[0]) / distance
    unsure = np.sqrt(variance * dt / (4.0 * memory**3))  # of the velocity, in the steady state for steps ≪ memory
    slowest = np.maximum(slow, _SURELY * unsure) + 0.5 * length[body] * turns
    speed = np.sqrt(velocity[:, 0] * velocity[:, 0] + velocity[:, 1] * velocity[:, 1])
    share = np.minimum(dt, settings.patience) * speed / np.maximum(stray.distance, stray.deviations * np.sqrt(variance))
    walks = (speed > slowest) & (speed < stray.running)
    stands = ~lost & (speed < np.maximum(_STILL * slow, _PERHAPS * unsure))
    share, time = np.where(walks, walked[rows] + share, 0.0), np.where(stands, stood[rows] + dt, 0.0)
    every, rows = rows, rows[usable]
    trail[rows, :2], trail[rows, 2:], reflections.trail_ns[rows] = followed[usable], velocity[usable], time_ns
    walked[rows], stood[rows] = share[usable], time[usable]
    _drive_on(bodies, every, measurement, settings)


def _drive_on(bodies: Bodies, rows: Indices, measurement: Measurement, settings: ReflectionSettings) -> None:
    """Let reflections not have stood that surely move as their measured speeds tell, wherever they seem to lie.

    Where a vehicle slides by, what is seen of it stays where it is, and its speed does not.
    """
    slow, (x, y), (vx, vy) = settings.stood.speed, measurement.origin.tolist(), measurement.velocity.tolist()
    if compiled.in_use:
        rates = measurement.range_rate, measurement.range_rate_variance, measurement.projections
        compiled.kernels.drive_on(
            bodies.reflections.stood, rows, measurement.position, *rates, x, y, vx, vy, slow, _SURELY, _LEAST_STEP
        )
        return
    stood, moves = bodies.reflections.stood.take(rows), np.zeros(len(rows), dtype=np.bool_)
    for part in measurement.projections:
        moves |= np.abs(part.value) > slow + _SURELY * np.sqrt(part.variance)
    if measurement.range_rate is not None and measurement.range_rate_variance is not None:
        sight = measurement.position - measurement.origin
        sight /= np.maximum(lengths(sight), _LEAST_STEP)[:, None]
        along = measurement.range_rate + (sight[:, 0] * vx + sight[:, 1] * vy)
        moves |= np.abs(along) > slow + _SURELY * np.sqrt(measurement.range_rate_variance)
    bodies.reflections.stood[rows] = np.where(moves, 0.0, stood)


def strays(bodies: Bodies, settings: ReflectionSettings, time_ns: int) -> Indices | None:
    """Return the reflections detected in this cycle that walk while the leading one stands, or the other way round.

    None: there are none. Reflections of vehicles slide along them as they brake: who walks before one
    walks across, or far.

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
            obstacles.axis,
            reflections.trail,
            mean,
            still,
            stray.still,
            stray.fastest,
            stray.far,
            since_ns,
            time_ns,
        )
    body = reflections.body
    lead, vehicle = obstacles.leader[body], obstacles.fastest >= stray.fastest
    slowly = (mean[:, 2] * mean[:, 2] + mean[:, 3] * mean[:, 3] < still) & ~vehicle
    along, across = np.abs(to_travel_axes(reflections.trail[:, 2:], obstacles.axis[body])).T
    walks, stands = reflections.walked >= 1.0, reflections.stood >= stray.still
    walks &= ~vehicle[body] | (across > along) | (reflections.walked >= stray.far)
    rests = stands[lead] | slowly[body] & (reflections.stood[lead] > 0.0)
    apart = walks & ~walks[lead] & rests | stands & walks[lead]
    seen = (reflections.last_ns == time_ns) & (reflections.last_ns[lead] >= since_ns)
    found = np.flatnonzero(apart & seen)
    return found if len(found) else None


def abreast(bodies: Bodies, settings: ReflectionSettings, time_ns: int) -> Indices | None:
    """Return the reflections detected of late of those who walk side by side with who shows the leading one.

    None: there are none. All reflections of the body have walked far, or are as close to one that has as those of a
    person are; and it was never as fast as a vehicle is.

    Args:
        bodies: with the reflections.
        settings: how far they walk.
        time_ns: of the cycle.
    """
    reflections, obstacles, stray = bodies.reflections, bodies.obstacles, settings.stray
    walk = reflections.walked >= stray.abreast
    if np.count_nonzero(walk) < 2:
        return None
    body, place = reflections.body, bodies.offsets()
    people = (np.bincount(body[walk], minlength=len(bodies)) > 1) & (obstacles.fastest < stray.fastest)
    people[_with_others(body, place, walk, people)] = False
    lead, since_ns = obstacles.leader[body], time_ns - round(settings.patience * 1e9)
    velocity = reflections.trail[lead, 2:]
    course = velocity / np.maximum(lengths(velocity), _LEAST_SPEED)[:, None]
    aside = np.abs(to_travel_axes(place - place[lead], course)[:, 1])
    seen = (reflections.last_ns >= since_ns) & (reflections.last_ns[lead] >= since_ns)
    found = np.flatnonzero(people[body] & seen & (aside > WALKER[0]))
    return found if len(found) else None


def _with_others(body: Indices, place: Floats, walk: Booleans, people: Booleans) -> Indices:
    """Return which of the bodies that may be people show something apart from all that walks of them.

    Args:
        body: row of each reflection's body (n,).
        place: of the reflections (n, 2), m from their bodies' reference points.
        walk: which have walked far (n,).
        people: which bodies may be people (k,).
    """
    others, far = np.flatnonzero(~walk & people[body]), np.flatnonzero(walk & people[body])
    close = (body[others, None] == body[far]) & (lengths(place[others, None] - place[far]) < WALKER[0])
    apart: Indices = body[others[~close.any(axis=1)]]
    return apart


def part_abreast(bodies: Bodies, rows: Indices, settings: ReflectionSettings) -> None:
    """Give those who walk side by side bodies of their own, as small as people are: the farthest of each body.

    Args:
        bodies: of which some become two.
        rows: of their reflections (m,), as `abreast` returns them.
        settings: as there.
    """
    reflections, obstacles, known = bodies.reflections, bodies.obstacles, len(bodies)
    owner, place = reflections.body[rows], bodies.offsets()
    order = np.lexsort((-lengths(place[rows] - place[obstacles.leader[owner]]), owner))
    rows, owner = rows[order], owner[order]  # the farthest of each body first
    left, begin, group = np.unique(owner, return_index=True, return_inverse=True)
    own = lengths(place[rows] - place[rows[begin[group]]]) < WALKER[0]
    _go_on(bodies, known, left, bodies.split_together(rows[own]), settings)
    people = np.concatenate([left, np.arange(known, len(bodies))])
    obstacles.length[people], obstacles.width[people] = WALKER
    obstacles.alone[people] = SURELY_ALONE


def part_strays(bodies: Bodies, rows: Indices, settings: ReflectionSettings) -> None:
    """Give reflections that stray bodies of their own, but where who walks leads a vehicle that stands: him.

    They exist as surely as what they were a part of: they were followed for as long as it takes to walk so far.

    Args:
        bodies: of which some become two.
        rows: of the reflections, as `strays` returns them (m,).
        settings: for how long one stands, what is a vehicle.
    """
    reflections, obstacles, known = bodies.reflections, bodies.obstacles, len(bodies)
    owner, vehicle = reflections.body[rows], obstacles.fastest >= settings.stray.fastest
    stand = vehicle[owner] & (reflections.stood[rows] >= settings.stray.still)
    led, begin = np.unique(owner[stand], return_index=True)
    walkers = obstacles.leader[led]
    bodies.lead(led, rows[stand][begin])
    bodies.changed()
    rows = np.concatenate([rows[~stand], walkers])
    owner = reflections.body[rows]
    lead = _split_off(bodies, rows, settings.stray.still)
    exists = np.zeros(len(bodies))
    exists[reflections.body[rows]] = obstacles.existence[owner]
    obstacles.existence = np.maximum(obstacles.existence, exists)
    _go_on(bodies, known, distinct(owner), lead, settings, surely=True)
    bodies.forget_shape(reflections.body[rows[vehicle[owner]]])


def part(bodies: Bodies, rows: Indices, settings: ReflectionSettings) -> None:
    """Give reflections bodies of their own; these, and what is left, move as the trails of what leads them tell.

    What stands while its leader walks stays together. Trails of vehicles tell nothing.

    Args:
        bodies: of which some become two.
        rows: of the reflections, none of them leads (m,).
        settings: for how long one stands.
    """
    known, left = len(bodies), distinct(bodies.reflections.body[rows])
    _go_on(bodies, known, left, _split_off(bodies, rows, settings.stray.still), settings)


def _go_on(
    bodies: Bodies, known: int, left: Indices, lead: Indices, settings: ReflectionSettings, *, surely: bool = False
) -> None:
    """Let bodies that were parted go on as the trails of what leads them tell.

    Args:
        bodies: with those that are new.
        known: number of those before.
        left: rows of those whose reflections were taken (k,).
        lead: reflections that lead the new ones, in their order.
        settings: for how long one stands.
        surely: whether trails of vehicles tell something, too.
    """
    reflections, obstacles = bodies.reflections, bodies.obstacles
    parted = np.concatenate([np.arange(known, len(bodies)), left])
    lead = np.concatenate([lead, obstacles.leader[left]])
    walks, stands = reflections.walked[lead] >= 1.0, reflections.stood[lead] >= settings.stray.still
    sure = (walks | stands) & (surely | (obstacles.fastest[parted] < settings.stray.fastest))
    _begin_anew(bodies, parted[sure], lead[sure], walks[sure])


def _split_off(bodies: Bodies, rows: Indices, still: float) -> Indices:
    """Split off reflections (m,), together those that stand while their leader walks; return what leads new bodies."""
    reflections, obstacles = bodies.reflections, bodies.obstacles
    owner, place, first = reflections.body[rows], bodies.offsets(rows), np.arange(len(rows))
    together = (reflections.stood[rows] >= still) & (reflections.walked[obstacles.leader[owner]] >= 1.0)
    for body in distinct(owner[together]).tolist():
        mates = np.flatnonzero(together & (owner == body))
        first[mates] = mates[0]
    leads = first == np.arange(len(rows))
    bodies.split(rows[leads])
    mates = np.flatnonzero(~leads)
    body = reflections.body[rows[first[mates]]]
    reflections.body[rows[mates]] = body
    reflections.offset[rows[mates]] = to_travel_axes(place[mates] - place[first[mates]], obstacles.axis[body])
    return np.asarray(rows[leads])


def _begin_anew(bodies: Bodies, parted: Indices, lead: Indices, walks: Booleans) -> None:
    """Let bodies (k,) begin anew where the trails of their leading reflections (k,) are, walking or standing."""
    reflections = bodies.reflections
    count = np.bincount(reflections.body, minlength=len(bodies))[parted]
    reflections.offset[lead[count == 1]] = 0.0
    moves = walks[:, None] & (np.arange(len(_WALKING)) != STANDING)
    spread = np.where(moves, _WALKING_SPREAD, _STANDING_SPREAD)
    bodies.filter.restart(
        parted,
        reflections.trail[lead, :2] - bodies.offsets(lead),
        np.broadcast_to(np.eye(2) * _PLACE_SPREAD**2, (len(parted), 2, 2)),
        np.where(moves[..., None], reflections.trail[lead, None, 2:], 0.0),
        np.square(spread)[..., None, None] * np.eye(2),
        np.where(walks[:, None], _WALKING, _STANDING),
    )
    reflections.walked[lead] = reflections.stood[lead] = 0.0
    bodies.changed()
