"""When two obstacles are one vehicle, and when a reflection is none of its obstacle's."""

from __future__ import annotations

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.config.tracker import ReflectionSettings
from candaemon.estimation.body_filter import POSITION, VELOCITY
from candaemon.tracking.body_sizes import ENOUGH, RIDER, SMALL, TOLD_LENGTH, WALKER
from candaemon.tracking.body_store import Bodies
from candaemon.tracking.box import NARROW
from candaemon.tracking.reflections import near_pairs, to_travel_axes

_DEVIATIONS = 3.0  # standard deviations by which the velocities of what is seen in one place may differ more …
_OTHERWISE = 3.0  # m/s by which bodies move otherwise: who walks past a car that stands is slower
_UNCLEAR = 1.0  # (m/s)², variance of a speed that is not known yet
_YOUNG_NS = 10**9  # ns, … while the later one is younger: who walks past a car is told from it by then


def merge_candidates(bodies: Bodies, settings: ReflectionSettings, time_ns: int) -> tuple[Integers, Floats]:
    """Return for each obstacle the row of an older one that it is alongside of and moves like, or −1; and for how long.

    What moves is compared along and across its course: its speed across is known worst, and parts of one vehicle
    differ there by noise alone. What stands and never showed a course is compared in all directions alike, for it
    may be parked across; but what was last seen in one scan is two, as who stands beside a car, unless reflections
    of both lie close together: so do those of a car parked across, and who stands that close to one is a part of
    it. What has stood apart for long stays apart, as cars side by side at a light, and so does what has driven
    apart in another lane. What is small is one only where both sizes leave room for no more than an edge between,
    and with what was found to be small only what lies within its size. What moves one behind the other as fast is
    one vehicle where no driver would follow so closely; who rides does, and two who may be riders, each by itself
    for long, stay two. What has stood all the time is none of what has moved: a car that stops beside a post stays
    a car. Of two that never were faster than someone walks, one that surely walks is none of one that stands. Two
    that were each found to be a person, and are no nearer than one is wide, stay two, and of two that may be it
    takes longer to say, until that shows. So do two side by side that were apart for long, while one of them is not
    seen, and who was found to be a person or a rider for as long, beside what is larger.

    Args:
        bodies: of the cycle.
        settings: how near, and how alike.
        time_ns: of the cycle.

    Returns:
        Rows (k,), and the time alongside that is needed (k,), s.
    """
    found, needed = _alongside(bodies, settings, time_ns)
    young = (found >= 0).nonzero()[0]
    if len(young):
        if not compiled.in_use:  # the kernel leaves people out by itself
            found[young[_people_apart(bodies, young, found[young])]] = -1
        walking = young[_walk(bodies, young, found[young], settings)]
        needed[walking] = np.maximum(needed[walking], settings.alone.time)
        found[young[_known_as_two(bodies, young, found[young], settings, time_ns)]] = -1
    return found, needed


def _walk(bodies: Bodies, young: Indices, old: Indices, settings: ReflectionSettings) -> Booleans:
    """Return which pairs of bodies (m,), both confirmed, may be people who walk or walked side by side."""
    obstacles, velocity = bodies.obstacles, bodies.moments().mean[:, VELOCITY]
    fastest = np.maximum(obstacles.fastest, np.sqrt((velocity * velocity).sum(axis=1)))
    walk = obstacles.confirmed & (fastest > settings.stood.speed) & (fastest < settings.stray.fastest)
    walk &= (obstacles.length_variance > TOLD_LENGTH) | (obstacles.length < ENOUGH)
    return np.asarray(walk[young] & walk[old])


def _people_apart(bodies: Bodies, young: Indices, old: Indices) -> Booleans:
    """Return which pairs of bodies (m,) are people, and no nearer than one is wide."""
    people, place = found_small(bodies) & (bodies.obstacles.length < NARROW), bodies.moments().shown[:, :2]
    apart = place[young] - place[old]
    return np.asarray(people[young] & people[old] & ((apart * apart).sum(axis=1) > WALKER[0] * WALKER[0]))


def _known_as_two(bodies: Bodies, young: Indices, old: Indices, settings: ReflectionSettings, time_ns: int) -> Booleans:
    """Return which pairs of bodies (m,) are two, as was found before they came close.

    A car that is out of sight goes on as it went when it was seen last, and so may seem to drive into the one beside
    it. Two that a sensor has told apart for long are one only while it sees both.

    Args:
        bodies: of the cycle.
        young: later rows of the pairs (m,).
        old: earlier rows (m,).
        settings: how long is long, and how near is beside.
        time_ns: of the cycle.
    """
    obstacles, place = bodies.obstacles, bodies.moments().shown[:, :2]
    late = obstacles.confirmed[young] & (obstacles.first_ns[young] <= time_ns - round(settings.course.apart_for * 1e9))
    if not late.any():
        return late
    apart, small = place[young] - place[old], found_small(bodies)
    latest_ns = np.minimum(obstacles.last_ns[young], obstacles.last_ns[old])
    unseen = latest_ns < time_ns - round(settings.patience * 1e9)
    unseen &= (apart * apart).sum(axis=1) < settings.course.along**2
    return np.asarray(late & (unseen | (small[young] & ~small[old])))


def found_small(bodies: Bodies) -> Booleans:
    """Return which bodies (k,) were found to be small; what a sensor tells to be as small may be a part of a car."""
    obstacles = bodies.obstacles
    return (obstacles.length < SMALL) & ((obstacles.alone > 1.0) | (obstacles.length_variance > TOLD_LENGTH))


def _alongside(bodies: Bodies, settings: ReflectionSettings, time_ns: int) -> tuple[Integers, Floats]:
    """Return for each obstacle an older one that it is alongside of, as `merge_candidates`; in numpy of people, too."""
    obstacles, reflections, moments = bodies.obstacles, bodies.reflections, bodies.moments()
    course, standing = settings.course, settings.stood
    since_ns, stood_ns = time_ns - round(settings.patience * 1e9), round(standing.time * 1e9)
    if compiled.in_use:
        return compiled.kernels.bodies_to_merge(
            moments.shown,
            moments.shown_covariance,
            moments.mean,
            obstacles.axis,
            obstacles.facing,
            obstacles.length,
            obstacles.width,
            obstacles.confirmed,
            obstacles.directed,
            obstacles.last_ns,
            obstacles.first_ns,
            obstacles.length_variance,
            obstacles.extent,
            obstacles.alone,
            obstacles.fastest,
            reflections.body,
            reflections.last_ns,
            reflections.offset,
            time_ns,
            stood_ns,
            since_ns,
            time_ns - _YOUNG_NS,
            time_ns - round(standing.apart_for * 1e9),
            time_ns - round(course.apart_for * 1e9),
            standing.speed,
            standing.moved,
            standing.apart,
            standing.extent,
            settings.along,
            settings.across,
            settings.speed**2,
            _DEVIATIONS**2,
            settings.merge_time,
            settings.following,
            settings.following_gap,
            settings.beside,
            settings.following_speed,
            settings.extent,
            settings.edge,
            WALKER,
            NARROW,
            RIDER,
            settings.riders.fastest,
            TOLD_LENGTH,
            SMALL,
            ENOUGH,
            course.speed,
            course.along,
            course.across,
            course.apart,
            course.faster,
            course.drift,
            course.time,
            course.clear**2,
        )
    stood = (obstacles.fastest < standing.speed) & (time_ns - obstacles.first_ns > stood_ns)
    rides, small = may_ride(bodies, settings), found_small(bodies)
    found, needed = np.full(len(obstacles), -1, dtype=np.int64), np.full(len(obstacles), settings.merge_time)
    place, velocity = moments.shown[:, :2], moments.mean[:, VELOCITY]
    reach = max(settings.along, course.along, standing.extent, settings.extent) + max(settings.across, course.across)
    young, old = near_pairs(place[:, 0], place[:, 1], reach)
    if not len(young):
        return found, needed
    axis = obstacles.axis[old]
    apart = np.abs(to_travel_axes(place[young] - place[old], axis))
    faster = np.abs(to_travel_axes(velocity[young] - velocity[old], axis))
    speed = np.sqrt(velocity[:, 0] * velocity[:, 0] + velocity[:, 1] * velocity[:, 1])
    moving = np.minimum(speed[young], speed[old]) > course.speed
    late = obstacles.confirmed[young] & (obstacles.first_ns[young] <= time_ns - round(course.apart_for * 1e9))
    ride = late & rides[young] & rides[old]
    lane = np.where(late, np.where(ride, min(course.apart, RIDER[1]), course.apart), np.inf)
    along = 0.5 * (obstacles.length[young] + obstacles.length[old]) + settings.edge
    shorter = np.minimum(obstacles.length[young], obstacles.length[old])
    along = np.where(small[young] | small[old], shorter + settings.edge, along)
    along = np.where(ride, np.minimum(along, RIDER[0]), along)
    by_course = (
        moving
        & (apart[:, 0] < np.minimum(course.along, along))
        & (apart[:, 1] < np.minimum(course.across, lane))
        & (faster[:, 0] < course.faster)
        & (faster[:, 1] < course.drift)
    )
    stands = stand_without_course(bodies, standing.speed, standing.moved)
    across = np.minimum(lane, 0.5 * (obstacles.width[young] + obstacles.width[old]) + settings.edge)
    near = (apart[:, 0] < np.minimum(settings.along, along)) & (apart[:, 1] < np.minimum(settings.across, across))
    squared = (apart * apart).sum(axis=1)
    either = (squared < settings.along * settings.along) & (obstacles.last_ns[young] != obstacles.last_ns[old])
    either |= (squared < standing.extent * standing.extent) & _close_by(
        bodies, stands, young, old, standing.apart, since_ns
    )
    both_stand = stands[young] & stands[old]
    fresh = obstacles.first_ns[young] > time_ns - round(standing.apart_for * 1e9)
    near = np.where(both_stand, (near | either) & fresh, near)
    variance = np.trace(moments.shown_covariance[:, VELOCITY, VELOCITY], axis1=1, axis2=2)
    lately, begun = obstacles.last_ns >= since_ns, time_ns - obstacles.first_ns < _YOUNG_NS
    unclear, differ = variance[young] + variance[old], (faster * faster).sum(axis=1)
    walkers = (obstacles.fastest[young] <= standing.moved) & (obstacles.fastest[old] <= standing.moved)
    walks_off = walkers & (differ > np.maximum(standing.speed**2, _DEVIATIONS**2 * unclear))
    unclear = np.where(lately[young] & lately[old] & begun[young], unclear, 0.0)
    by_speed = near & ~walks_off & (differ < settings.speed**2 + _DEVIATIONS**2 * unclear)
    # Nearer to the box than any driver follows: another part of the vehicle, however long it proves to be.
    gap = np.minimum(settings.following * speed, settings.following_gap)
    beyond = to_travel_axes(place[young] - (moments.mean[old, POSITION] - obstacles.facing[old]), axis)
    by_box = (
        moving
        & ~ride
        & (shorter >= SMALL)
        & (np.abs(beyond[:, 0]) - 0.5 * obstacles.length[old] < gap[old])
        & (np.abs(beyond[:, 0]) < settings.extent)
        & ((apart[:, 1] < course.across) | (np.abs(beyond[:, 1]) - 0.5 * obstacles.width[old] < settings.beside))
        & (apart[:, 1] < lane)
        & (faster[:, 0] < settings.following_speed)
        & (faster[:, 1] < course.drift)
    )
    moved = obstacles.fastest > standing.moved
    apart_before = (stood[young] & moved[old]) | (moved[young] & stood[old])
    beside = (by_course | by_speed | by_box) & obstacles.confirmed[old] & ~apart_before
    found[young[beside][::-1]] = old[beside][::-1]  # reversed, so that the oldest of several is written last
    spread = moments.shown_covariance[:, 0, 0] + moments.shown_covariance[:, 1, 1]
    unclear = 1.0 + (spread[young] + spread[old]) / course.clear**2
    needed[young[by_course]] = np.minimum(course.time * unclear[by_course], settings.merge_time)
    return found, needed


def may_ride(bodies: Bodies, settings: ReflectionSettings) -> Booleans:
    """Return which bodies may be someone on a bicycle (k,): never faster, and neither told nor seen to be longer."""
    obstacles = bodies.obstacles
    told = (obstacles.length_variance < TOLD_LENGTH) & (obstacles.length > ENOUGH)
    return (obstacles.fastest < settings.riders.fastest) & (obstacles.extent < ENOUGH) & ~told


def _close_by(bodies: Bodies, stands: Booleans, young: Indices, old: Indices, reach: float, since_ns: int) -> Booleans:
    """Return which pairs of bodies (m,) have two reflections nearer to one another than a reach, and more than those.

    Of one reflection each, they may as well be two people.

    Args:
        bodies: of the cycle.
        stands: which of them are looked at (k,).
        young: later rows of the pairs (m,).
        old: earlier rows (m,).
        reach: m.
        since_ns: from when on detected reflections count.
    """
    reflections = bodies.reflections
    lately = np.flatnonzero((reflections.last_ns >= since_ns) & stands[reflections.body])
    body = reflections.body[lately]
    place = bodies.moments().shown[body, :2] + bodies.offsets(lately)
    one, other = near_pairs(place[:, 0], place[:, 1], reach)
    apart = place[one] - place[other]
    one, other = (body[each[(apart * apart).sum(axis=1) < reach * reach]] for each in (one, other))
    k, several = len(bodies), np.bincount(body, minlength=len(bodies)) > 1
    close = np.isin(young * k + old, np.maximum(one, other) * k + np.minimum(one, other))
    return close & (several[young] | several[old])


def stand_without_course(bodies: Bodies, slow: float, moved: float) -> Booleans:
    """Return which bodies stand and never showed a course (k,): their reflections may lie in any direction.

    Args:
        bodies: of the cycle.
        slow: speed below which they stand, m/s.
        moved: speed that they never exceeded, m/s.
    """
    obstacles, velocity = bodies.obstacles, bodies.moments().mean[:, VELOCITY]
    speed = np.sqrt(velocity[:, 0] * velocity[:, 0] + velocity[:, 1] * velocity[:, 1])
    return (speed < slow) & (obstacles.fastest <= moved) & ~obstacles.directed


def inside_others(bodies: Bodies, candidates: Indices, settings: ReflectionSettings, time_ns: int) -> Booleans:
    """Return which of some bodies (m,) have begun inside a vehicle that is seen, or seem to, and move otherwise.

    Two vehicles are not in one place: what a detection far off has begun follows those of the other one, and has a
    velocity of its own until they have corrected it. What is there for longer is something else, and so is what has a
    velocity that is well known: who rides past a car that is shorter than is thought.

    Args:
        bodies: that are known.
        candidates: rows of those asked for (m,).
        settings: for how long without a detection a body counts as seen, what has moved, and how far its edge reaches.
        time_ns: of the cycle.
    """
    obstacles, moments = bodies.obstacles, bodies.moments()
    seen = obstacles.confirmed & (obstacles.last_ns >= time_ns - round(settings.patience * 1e9))
    seen &= obstacles.fastest > settings.stood.moved
    seen[candidates] = False
    others = seen.nonzero()[0]
    centre = moments.mean[others, POSITION] - obstacles.facing[others]
    away = np.abs(to_travel_axes(moments.shown[candidates, None, :2] - centre, obstacles.axis[others]))
    covariance = moments.shown_covariance[candidates]
    spread = np.trace(covariance[:, POSITION, POSITION], axis1=1, axis2=2)
    beyond = away - 0.5 * np.stack([obstacles.length[others], obstacles.width[others]], axis=1)
    inside = (beyond < settings.edge + np.sqrt(spread)[:, None, None]).all(axis=2)
    faster = moments.shown[candidates, None, VELOCITY] - moments.shown[others, VELOCITY]
    squared = (faster * faster).sum(axis=2)
    unclear = np.einsum("mos,mst,mot->mo", faster, covariance[:, VELOCITY, VELOCITY], faster) > _UNCLEAR * squared
    held = (inside & unclear & (squared > _OTHERWISE * _OTHERWISE)).any(axis=1)
    return np.asarray(held & (obstacles.first_ns[candidates] > time_ns - _YOUNG_NS))


def alongside_long(alongside_ns: Integers, older: Integers, needed: Floats, dt_ns: int) -> list[int]:
    """Return the rows of the obstacles that have been alongside of an older one for long enough.

    Args:
        alongside_ns: for how long each has been (k,), ns; a step longer now, in place, or not at all.
        older: row of the older one (k,), −1: there is none.
        needed: time that is long enough (k,), s.
        dt_ns: length of the step.
    """
    if compiled.in_use:
        return compiled.kernels.stay_alongside(alongside_ns, older, needed, dt_ns)
    alongside_ns[:] = np.where(older >= 0, alongside_ns + dt_ns, 0)
    return np.flatnonzero((older >= 0) & (alongside_ns >= (needed * 1e9).astype(np.int64))).tolist()


def split_candidates(bodies: Bodies, settings: ReflectionSettings) -> Booleans | None:
    """Return which reflections are none of their obstacle's (n,): too far away, or of another speed; None: none is.

    The bounds are wider than those for joining, so that a reflection at the edge does not come and go; what lies far
    along the body may be another vehicle in a queue, and is to move as the body does.
    """
    obstacles, reflections, leader = bodies.obstacles, bodies.reflections, bodies.obstacles.leader
    if len(reflections) == len(bodies):
        return None
    if compiled.in_use:
        return compiled.kernels.reflections_to_split(
            reflections.offset,
            reflections.rate_difference,
            reflections.body,
            leader,
            bodies.moments().mean,
            obstacles.directed,
            obstacles.fastest,
            settings.course.along,
            settings.extent,
            2 * settings.across,
            (settings.along + settings.across) ** 2,
            settings.speed,
            2 * settings.stood.speed,
            settings.stood.moved,
        )
    far = np.abs(reflections.offset[:, 0]) > settings.course.along
    around = stand_without_course(bodies, 2 * settings.stood.speed, settings.stood.moved)[reflections.body]
    around &= (reflections.offset * reflections.offset).sum(axis=1) < (settings.along + settings.across) ** 2
    away = (
        (np.abs(reflections.offset[:, 0]) > settings.extent)
        | ((np.abs(reflections.offset[:, 1]) > 2 * settings.across) & ~around)
        | (np.abs(reflections.rate_difference) > np.where(far, settings.speed, 2 * settings.speed))
    )
    away[leader] = False
    return away if away.any() else None
