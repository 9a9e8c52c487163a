"""The boxes of bodies: length, width and axis from what sensors say and from where reflections lie; their class.

Where reflections lie tells how long a body is at least, seldom how long it is: so a box grows with them quickly and
shrinks slowly, and what the sensors say of sizes and headings is averaged.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices
from candaemon.config.tracker import AloneSettings
from candaemon.ego.pose import EgoPose
from candaemon.estimation.body_filter import BIAS, POSITION, TURN, VELOCITY
from candaemon.estimation.outline import LEAST, ROUNDS, facing_point
from candaemon.frames.bodies import CLASSES
from candaemon.radar.detections import Detections
from candaemon.tracking.body_axes import LEADS
from candaemon.tracking.body_sizes import (
    CAR_LENGTH,
    CAR_WIDTH,
    ENOUGH,
    LORRY_LENGTH,
    RIDER,
    SMALL,
    TOLD_LENGTH,
    TOLD_WIDTH,
    WALKER,
)
from candaemon.tracking.body_store import Bodies, BodyTable
from candaemon.tracking.reflections import from_travel_axes, to_travel_axes

_WHOLLY = 0.8  # share in sight, below which one reflection is all that can be seen of a body of any size
_SIZE_NOISE = 0.5  # m, of a size that a sensor tells
_HEADING_SHARE = 0.1  # of a heading that a sensor tells, a scan
_SIZE_WALK = 0.05  # m²/s, at which what is known of a size grows old
_MARGIN = 0.4  # m by which a body goes on behind its outermost reflections, both sides together
_GROWTH_TIME = 0.2  # s, time constant with which a size grows to what reflections show
_SHRINKAGE_TIME = 25.0  # s, time constant with which a length not told, while it is seen, returns to a car's
_AXIS_SPEED, _AXIS_AGE = 3.0, 1.0  # m/s and s from which on the axis is known well enough
TRUCK_WIDTH = 2.5  # m
_NEVER_ALONE = -1e12  # of what has shown several reflections
_MOVED, _RIDING = 0.5, 9.0  # m/s
_CROSSING = 1.5  # times the speed along the line of sight, from which on that across it shows a side
_PACE_TIME = 4.0  # s, time constant with which the greatest speed of something small is forgotten, down to a walk
_TURN_ERROR = 0.15  # rad/s, by which a turn rate is wrong
_BESIDE = 16.0  # m, the length of a lorry; what passes farther off slides too slowly to matter
_SLIDE_STEP = 0.05  # s
UNKNOWN, CAR, TRUCK, TWO_WHEELER, PEDESTRIAN, STANDING = range(len(CLASSES))
TRUCK_LENGTH, NARROW, WALKING = 7.0, 1.1, 3.5
_PACE = 0.9 * WALKING  # m/s
_LENGTHS = np.array([NARROW, ENOUGH, TRUCK_LENGTH])  # m, at which walkers, riders and cars end
_WIDTHS = np.array([WALKER[1], RIDER[1], CAR_WIDTH, TRUCK_WIDTH])


def learn(
    bodies: Bodies,
    rows: Indices,
    reflections: Indices,
    detections: Detections,
    in_sight: Floats,
    recent: float,
    alone: AloneSettings,
    backing: float,
) -> None:
    """Let boxes learn from the detections of a scan.

    Args:
        bodies: updated with the scan.
        rows: of the detections that belong to a reflection (m,).
        reflections: rows of those (m,).
        detections: the scan.
        in_sight: share of each body that its sensor could see (k,).
        recent: s, for which a reflection that another sensor has seen still tells how long its body is.
        alone: when what shows a single reflection is small.
        backing: faster than which nothing backs, m/s.
    """
    obstacles, body = bodies.obstacles, bodies.reflections.body.take(reflections)
    if detections.length is not None:
        told = detections.length.take(rows)
        if detections.longest < LORRY_LENGTH:
            told = np.where(told >= detections.longest, np.maximum(obstacles.length.take(body), LORRY_LENGTH), told)
        _average(obstacles.length, obstacles.length_variance, body, told, obstacles.interval)
    if detections.width is not None:
        _average(obstacles.width, obstacles.width_variance, body, detections.width.take(rows), obstacles.interval)
    if detections.heading is not None:
        _turn(bodies, body, detections.heading[rows], backing)
    _note_size(bodies, body, detections, rows, in_sight, alone)
    if detections.length is not None and detections.width is None:
        _suit_widths(bodies)
    _grow(bodies, detections.time_ns, detections.sensor, detections.time_ns - round(recent * 1e9))


def _average(size: Floats, variance: Floats, body: Indices, told: Floats, interval: Floats) -> None:
    """Average sizes (k,) with those told (m,) of their bodies after an interval, as a Kalman filter does."""
    known = np.isfinite(told)
    if not np.count_nonzero(known):
        return
    body, told = body[known], told[known]
    count = np.bincount(body, minlength=len(size))
    seen = count > 0
    mean = np.bincount(body, told, len(size))[seen] / count[seen]
    prior = variance[seen] + _SIZE_WALK * interval[seen]
    gain = prior / (prior + _SIZE_NOISE**2)
    size[seen] += gain * (mean - size[seen])
    variance[seen] = (1.0 - gain) * prior


def _turn(bodies: Bodies, body: Indices, heading: Floats, backing: float) -> None:
    """Turn axes towards the mean of the headings that a sensor tells, or of their opposites: whichever are nearer.

    The first heading tells which end leads; one against it that is told scan after scan turns round what never drove,
    and what goes backwards, too. Who drove else has shown which end leads: some radars tell the orientation of a body
    without knowing its front.

    Args:
        bodies: with their axes.
        body: row of each detection's (m,).
        heading: that is told of it, NaN: none (m,), rad.
        backing: faster than which nothing backs, m/s.
    """
    known, obstacles = np.isfinite(heading), bodies.obstacles
    told, body = np.stack([np.cos(heading[known]), np.sin(heading[known])]), body[known]
    count = np.bincount(body, minlength=len(bodies))
    rows = count.nonzero()[0]
    axis, drives = obstacles.axis, (obstacles.axis * bodies.moments().mean[:, VELOCITY]).sum(axis=1)[rows]
    against = np.bincount(body, (axis[body] * told.T).sum(axis=1), len(bodies))[rows] < 0.0
    heard = ~obstacles.directed[rows] | (obstacles.fastest[rows] < LEADS) | (against & (drives < -_MOVED))
    ahead = np.where(against, obstacles.ahead[rows] - 2.0 * _HEADING_SHARE * backing, backing)
    turned_round = np.zeros(len(bodies), dtype=np.bool_)
    turned_round[rows] = heard & (ahead < 0.0)
    obstacles.ahead[rows[heard]] = np.where(ahead < 0.0, backing, ahead)[heard]
    if turned_round.any():
        axis[turned_round] *= -1.0
        bodies.keep_reflections(turned_round)
    told *= np.copysign(1.0, (axis[body] * told.T).sum(axis=1))
    mean = np.stack([np.bincount(body, each, len(bodies)) for each in told], axis=1)[rows] / count[rows, None]
    turned = axis[rows] + _HEADING_SHARE * (mean - axis[rows])
    axis[rows] = turned / np.linalg.norm(turned, axis=1)[:, None]
    obstacles.directed[rows] = True


def _note_size(
    bodies: Bodies, body: Indices, detections: Detections, rows: Indices, in_sight: Floats, settings: AloneSettings
) -> None:
    """Take what stays a single reflection close by for something small: a walker, or a rider where it is faster.

    Two of three scans show one reflection of a car too, and for seconds at a time; from its side it shows several
    sooner. Who walks does so all the time. A lorry of which another one hides all but a corner does so too.
    """
    obstacles, mean, measurement = bodies.obstacles, bodies.moments().mean, detections.measurement
    if compiled.in_use:
        compiled.kernels.note_sizes(
            obstacles.alone,
            obstacles.fastest,
            obstacles.length,
            obstacles.width,
            obstacles.length_variance,
            obstacles.width_variance,
            obstacles.first_ns,
            mean,
            body,
            rows,
            measurement.position,
            measurement.origin,
            measurement.velocity,
            obstacles.interval,
            in_sight,
            detections.time_ns,
            settings.within,
            settings.time,
            settings.faster,
            settings.crossing,
            _CROSSING,
            _WHOLLY,
            _NEVER_ALONE,
            _AXIS_AGE,
            TOLD_WIDTH,
            _MOVED,
            WALKING,
            _RIDING,
            _PACE,
            _PACE_TIME,
            WALKER,
            RIDER,
        )
        return
    count, size_variance = np.bincount(body, minlength=len(obstacles)), obstacles.length_variance
    size_variance = np.minimum(size_variance, obstacles.width_variance)
    x, y = (measurement.position.take(rows, axis=0) - measurement.origin).T
    near, crosses = np.zeros((2, len(obstacles)), dtype=np.bool_)
    near[body[np.sqrt(x * x + y * y) < settings.within]] = True
    vx, vy = mean[:, 2].take(body), mean[:, 3].take(body)
    crossing = np.abs(vy * x - vx * y) > _CROSSING * np.abs(vx * x + vy * y)
    # what drives beside us shows one side all the time
    ox, oy = measurement.velocity.tolist()
    crossing &= np.abs(vy * ox - vx * oy) >= _CROSSING * np.abs(vx * ox + vy * oy)
    crosses[body[crossing]] = True
    speed = np.sqrt(mean[:, 2] * mean[:, 2] + mean[:, 3] * mean[:, 3])
    alone = near & (count == 1) & (speed > _MOVED) & (in_sight >= _WHOLLY)
    counts = np.where(crosses, settings.crossing, np.where(speed < WALKING, 1.0, settings.faster)) * alone
    obstacles.alone = np.where(count > 1, _NEVER_ALONE, obstacles.alone + obstacles.interval * counts / settings.time)
    sure = (detections.time_ns - obstacles.first_ns) * 1e-9 > _AXIS_AGE
    obstacles.fastest = np.maximum(obstacles.fastest, np.where(sure, speed, 0.0))
    small = (obstacles.alone > 1.0) & (size_variance > TOLD_WIDTH) & (obstacles.fastest > _MOVED)
    # a walker far away or crossing may have seemed to run; what stops may be a rider still
    walking = small & (count > 0) & (speed > _MOVED) & (obstacles.fastest < _RIDING)
    faster = np.maximum(obstacles.fastest - np.maximum(speed, _PACE), 0.0) * walking
    obstacles.fastest -= np.minimum(obstacles.interval / _PACE_TIME, 1.0) * faster
    walks, rides = small & (obstacles.fastest < WALKING), small & (obstacles.fastest < _RIDING)
    obstacles.length = np.where(walks, WALKER[0], np.where(rides, RIDER[0], obstacles.length))
    obstacles.width = np.where(walks, WALKER[1], np.where(rides, RIDER[1], obstacles.width))


def _suit_widths(bodies: Bodies) -> None:
    """Let what is told to be as long as walkers, riders, cars or lorries be as wide, where no width is told."""
    obstacles = bodies.obstacles
    untold = (obstacles.length_variance < TOLD_LENGTH) & (obstacles.width_variance > TOLD_WIDTH)
    usual = _WIDTHS.take(np.searchsorted(_LENGTHS, obstacles.length))
    obstacles.width = np.where(untold, usual, obstacles.width)


def _grow(bodies: Bodies, time_ns: int, sensor: int, since_ns: int) -> None:
    """Let boxes of known axis hold, along them, the reflections of this scan and of other sensors lately.

    A lorry shows its front to one sensor and its rear to another, so that no scan alone tells how long it is. A long
    box is as wide as lorries are: across, the spread of reflections is mostly noise. What was found to be small, and
    shows to be longer than any rider, is as wide as a car.

    Args:
        bodies: with their reflections.
        time_ns: of the scan; boxes of what it did not detect stay as they are.
        sensor: number of the one whose scan it is.
        since_ns: from when on reflections that others detected count.
    """
    obstacles, reflections, mean = bodies.obstacles, bodies.reflections, bodies.moments().mean
    passed = bodies.detected_after(time_ns)
    several = len(reflections) > len(obstacles)
    share = -np.expm1(passed / -_GROWTH_TIME) if several else passed  # alone, none tells a length
    if compiled.in_use:
        compiled.kernels.grow_boxes(
            obstacles.length,
            obstacles.width,
            obstacles.extent,
            obstacles.length_variance,
            obstacles.width_variance,
            obstacles.first_ns,
            passed,
            share,
            mean,
            reflections.body,
            reflections.sensor,
            reflections.last_ns,
            reflections.offset,
            time_ns,
            sensor,
            since_ns,
            _SHRINKAGE_TIME,
            CAR_LENGTH,
            _AXIS_SPEED,
            _AXIS_AGE,
            _MARGIN,
            TRUCK_LENGTH,
            TOLD_WIDTH,
            TRUCK_WIDTH,
            ENOUGH,
            CAR_WIDTH,
        )
        return
    untold = obstacles.length_variance > 1.0
    obstacles.length -= passed / _SHRINKAGE_TIME * np.maximum(obstacles.length - CAR_LENGTH, 0.0) * untold
    if not several:
        return
    lately = (reflections.last_ns >= since_ns) & (reflections.sensor != sensor)
    lately = np.flatnonzero(lately | (reflections.last_ns == time_ns))
    body, place = reflections.body[lately], reflections.offset[lately, 0]
    low, high = np.full(len(obstacles), np.inf), np.full(len(obstacles), -np.inf)
    np.minimum.at(low, body, place)
    np.maximum.at(high, body, place)
    known = mean[:, 2] * mean[:, 2] + mean[:, 3] * mean[:, 3] > _AXIS_SPEED**2
    known &= (time_ns - obstacles.first_ns) * 1e-9 > _AXIS_AGE
    shown = np.where(known & (high > low), high - low + _MARGIN, 0.0)
    obstacles.length += share * np.maximum(shown - obstacles.length, 0.0)
    obstacles.extent += share * np.maximum(shown - obstacles.extent, 0.0)
    untold, length = obstacles.width_variance > TOLD_WIDTH, obstacles.length
    narrow = untold & (np.minimum(length, obstacles.extent) > ENOUGH) & (obstacles.width < CAR_WIDTH)
    width = np.where(narrow, CAR_WIDTH, obstacles.width)
    obstacles.width = np.where(untold & (length > TRUCK_LENGTH), TRUCK_WIDTH, width)


def facing_offsets(bodies: Bodies, pose: EgoPose) -> Floats:
    """Return the reference points minus the centres of the boxes (k, 2), local frame, m.

    Args:
        bodies: with their boxes.
        pose: of the vehicle, whose origin they face.
    """
    obstacles, mean = bodies.obstacles, bodies.moments().mean
    if compiled.in_use:
        box = obstacles.facing, obstacles.axis, obstacles.length, obstacles.width
        return compiled.kernels.facing_offsets(mean, *box, pose.east, pose.north, ROUNDS, LEAST)
    centre = mean[:, POSITION] - obstacles.facing
    observer = to_travel_axes(np.array([pose.east, pose.north]) - centre, obstacles.axis)
    return from_travel_axes(facing_point(observer, obstacles.length / 2, obstacles.width / 2), obstacles.axis)


def slides(bodies: Bodies, pose: EgoPose) -> Floats | None:
    """Return how fast what is seen of bodies would slide along them as they pass near us (k,), m/s; None: of none.

    A vehicle of which we see the side pass by shows another point of it all the time. What slides is slower than the
    vehicle, which seems to brake where nothing else explains it. A car of known size of which one scan shows several
    points does not slide: where they all are slower, it brakes.

    Args:
        bodies: of the time before.
        pose: of the vehicle, whose origin they face.
    """
    obstacles, reflections, mean = bodies.obstacles, bodies.reflections, bodies.moments().mean
    if compiled.in_use:
        return compiled.kernels.speeds_of_slides(
            mean,
            obstacles.facing,
            obstacles.axis,
            obstacles.length,
            obstacles.width,
            obstacles.length_variance,
            obstacles.extent,
            obstacles.confirmed,
            obstacles.directed,
            obstacles.last_ns,
            reflections.body,
            reflections.last_ns,
            pose.east,
            pose.north,
            pose.ve,
            pose.vn,
            ROUNDS,
            LEAST,
            TOLD_LENGTH,
            SMALL,
            ENOUGH,
            TRUCK_LENGTH,
            _BESIDE,
            _SLIDE_STEP,
        )
    sight = mean[:, POSITION] - np.array([pose.east, pose.north])
    near = (sight * sight).sum(axis=1) < _BESIDE * _BESIDE
    shown = reflections.body[reflections.last_ns == obstacles.last_ns[reflections.body]]
    one = np.bincount(shown, minlength=len(obstacles)) < 2
    slides = ~obstacles.sized | (obstacles.length > TRUCK_LENGTH) | one
    near &= obstacles.confirmed & obstacles.directed & slides
    rows = near.nonzero()[0]
    if not len(rows):
        return None
    axis, half_length, half_width = obstacles.axis[rows], obstacles.length[rows] / 2, obstacles.width[rows] / 2
    observer = to_travel_axes(obstacles.facing[rows] - sight[rows], axis)
    passing = to_travel_axes(mean[rows, VELOCITY] - np.array([pose.ve, pose.vn]), axis)
    before = facing_point(observer, half_length, half_width)
    after = facing_point(observer - _SLIDE_STEP * passing, half_length, half_width)
    found = np.zeros(len(obstacles))
    found[rows] = (after - before)[:, 0] / _SLIDE_STEP
    return found


def follow_slides(bodies: Bodies, sliding: Floats, dt: float) -> None:
    """Let what is seen of bodies slide along them for good, as fast as it may.

    How far the bias has come along a body is where it shows another part. The reference point of which `follow_aspect`
    knows the way stays, and the reflections have slid: if their bias faded, what is seen would draw that point along.
    Where no size is known they slide as far as the middle: from there on it is a longer body, of which the reference
    point follows what is seen, as it does of any other. The bodies keep their speeds.

    Args:
        bodies: predicted.
        sliding: how fast that is (k,), m/s, as `slides` tells.
        dt: since the time before, s.
    """
    obstacles, reflections, farthest = bodies.obstacles, bodies.reflections, np.abs(sliding) * dt
    along = (bodies.moments().mean[:, BIAS] * obstacles.axis).sum(axis=1)
    step = np.clip(along, -farthest, farthest)
    bodies.settle(step[:, None] * obstacles.axis)
    place = to_travel_axes(obstacles.facing, obstacles.axis)[:, 0] + reflections.offset[obstacles.leader, 0]
    to_middle = np.clip(place + step, np.minimum(place, 0.0), np.maximum(place, 0.0)) - place
    slid = np.where(obstacles.sized, step, to_middle) * _shows_its_aspect(obstacles)
    if slid.any():
        reflections.offset[:, 0] += slid.take(reflections.body)
        bodies.shift(-slid[:, None] * obstacles.axis)


def follow_aspect(bodies: Bodies, pose: EgoPose, dt: float) -> None:
    """Let another point of a body of known axis be its reference point, as it shows us another side.

    The body moves as it did: of a lorry that crosses ahead the point goes from its front to its rear, of a car that
    passes us likewise; what has shown several reflections and no size is taken for as long as a car. Between a
    prediction and an update nothing but the aspect changes which point that is. What circles us shows the same side all
    the time: only what the aspect changes beyond the error of the turn rate counts.

    Args:
        bodies: predicted to the pose's time.
        pose: of the vehicle, whose origin they face.
        dt: since the time before, s; below 0 for a scan that comes late.
    """
    obstacles, reflections, mean = bodies.obstacles, bodies.reflections, bodies.moments().mean
    turn = mean[:, TURN] * dt
    c, s = np.cos(turn), np.sin(turn)
    if compiled.in_use:
        slid = compiled.kernels.slide_references(
            mean,
            obstacles.facing,
            obstacles.axis,
            c,
            s,
            obstacles.length,
            obstacles.width,
            obstacles.length_variance,
            obstacles.extent,
            obstacles.alone,
            obstacles.directed,
            reflections.body,
            reflections.offset,
            pose.east,
            pose.north,
            pose.ve,
            pose.vn,
            ROUNDS,
            LEAST,
            TOLD_LENGTH,
            SMALL,
            ENOUGH,
            _TURN_ERROR,
        )
        if slid is not None:
            bodies.shift(slid)
        return
    known = _shows_its_aspect(obstacles)
    turned = np.stack([c, s], axis=1)
    axis, before = from_travel_axes(obstacles.axis, turned), from_travel_axes(obstacles.facing, turned)
    sight = mean[:, POSITION] - before - np.array([pose.east, pose.north])
    after = from_travel_axes(
        facing_point(to_travel_axes(-sight, axis), obstacles.length / 2, obstacles.width / 2), axis
    )
    (x, y), vx, vy = sight.T, mean[:, 2] - pose.ve, mean[:, 3] - pose.vn
    rate = (x * vy - y * vx) / np.maximum(x * x + y * y, 1.0) - mean[:, TURN]
    share = np.maximum(1.0 - _TURN_ERROR / np.maximum(np.abs(rate), 1e-9), 0.0)
    step = np.where(known[:, None], share[:, None] * (after - before), 0.0)
    if step.any():
        reflections.offset -= to_travel_axes(step, obstacles.axis).take(reflections.body, axis=0)
        obstacles.facing += step
        bodies.shift(step)


def _shows_its_aspect(obstacles: BodyTable) -> Booleans:
    """Return of which bodies (k,) the box tells where along them the reference point is: of known axis and extent."""
    return np.asarray(obstacles.directed & (obstacles.sized | (obstacles.alone < 0.0)))


def classes(
    length: Floats, width: Floats, length_variance: Floats, speed: Floats, standing: Booleans
) -> NDArray[np.int8]:
    """Return the class of each body (k,), as far as its size and speed tell: `UNKNOWN` else.

    Args:
        length: m.
        width: m.
        length_variance: m².
        speed: m/s.
        standing: which bodies stand and never moved.
    """
    told = (length_variance < TOLD_LENGTH) | (length < SMALL)
    kind = np.full(len(length), UNKNOWN, dtype=np.int8)
    kind[told & (width >= NARROW)] = CAR
    kind[length > TRUCK_LENGTH] = TRUCK
    small = told & (width < NARROW)
    kind[small & (speed > WALKING)] = TWO_WHEELER
    kind[small & (speed <= WALKING) & (length < NARROW)] = PEDESTRIAN
    kind[standing] = STANDING
    return kind
