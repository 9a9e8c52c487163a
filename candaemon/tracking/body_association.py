"""Which detection is of which body: by the sensor's id, by place and speed, or as one more reflection."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices
from candaemon.config.tracker import AssociationSettings, ReflectionSettings
from candaemon.estimation.body_filter import POSITION
from candaemon.estimation.measurement import Measurement
from candaemon.radar.detections import Detections
from candaemon.tracking.association import best_pairs, gated_pairs, near_pairs, nis_in_best_mode, pair_nis
from candaemon.tracking.body_modes import SLIDING, STANDING
from candaemon.tracking.body_store import Bodies, BodyTable
from candaemon.tracking.joint_association import doubts, likelihood_ratios
from candaemon.tracking.near_side import detections_before
from candaemon.tracking.reflections import to_travel_axes
from candaemon.tracking.turning import rate_and_pivot

_NEAREST = 1e-3  # m, nearer than which there is no line of sight
_PLACE_AND_RATE = 3  # numbers measured; with more, a velocity is among them
_STANDS = 0.5  # probability above which a body is taken to stand
_LEAST_AGE = 0.05  # s, of a body that began just before


@dataclass(slots=True)
class Association:
    """What each of n detections belongs to.

    Attributes:
        body: row of the body (n,), −1: of none that is known.
        reflection: row of the reflection (n,), −1: of none that is known.
        nis: normalised innovation squared against that reflection (n,), NaN where there is none.
        doubt: times the noise that the detections have where they may be another body's, None: there is no doubt.
        slot_jumps: detections whose sensor kept the id but that cannot be the reflection of that id.
    """

    body: Indices
    reflection: Indices
    nis: Floats
    doubt: Floats | None = None
    slot_jumps: int = 0

    def leave_out(self, detections: Indices) -> None:
        """Let some detections, rows (m,), be of nothing that is known."""
        self.body[detections] = self.reflection[detections] = -1
        self.nis[detections] = np.nan


@dataclass(frozen=True, slots=True)
class Detecting:
    """How a sensor detects.

    Attributes:
        probability: of detecting what is in sight.
        clutter: density of its false detections, per m².
    """

    probability: float
    clutter: float


def associate(
    bodies: Bodies,
    detections: Detections,
    settings: AssociationSettings,
    extent: ReflectionSettings,
    vague: Booleans,
    detecting: Callable[[], Detecting | None] | None = None,
) -> Association:
    """Return what the detections of a scan belong to.

    First by the sensor's ids, where the detection lies within the gate of the id's reflection, over all modes or in
    one; those left over by global nearest neighbour among the reflections left over; those still left over, as one more
    reflection, with the body whose reflections they lie beside and whose speed they have; and the rest with bodies of
    which nothing was found, as one of their modes may have moved them.

    Args:
        bodies: predicted to the time of the detections.
        detections: one scan.
        settings: gates.
        extent: how near one body's reflections lie to each other, and how alike they move.
        vague: which bodies (k,) are too uncertain for a gate to tell what is theirs: nothing is.
        detecting: tells how the sensor detects; None, also if told: nothing is in doubt.
    """
    n, measurement, braked = len(detections), detections.measurement, np.empty(0, dtype=np.intp)
    if not len(bodies) or not n or not detections.identified:
        found = _nothing(n)
    else:
        found = _by_id(bodies, detections, settings, vague)
        if found.slot_jumps:
            braked = _by_id_in_modes(found, bodies, detections, settings, vague, extent.stray.fastest)
    if not len(bodies) or not n:
        return found
    left = (found.reflection < 0).nonzero()[0]
    if not len(left):
        found.body = bodies.reflections.body.take(found.reflection)
        return found
    mean, covariance = bodies.reflection_states()
    if settings.method == "nearest" or not detections.identified:
        usable = ~vague.take(bodies.reflections.body)
        usable[found.reflection[found.reflection >= 0]] = False
        gate: float | Floats = settings.gate
        if measurement.projections and not detections.identified:
            gate = np.where(measurement.measured > _PLACE_AND_RATE, settings.velocity_gate, settings.gate)
        _by_place(found, bodies, mean, covariance, np.flatnonzero(usable), measurement, gate, detecting)
        left = np.flatnonzero(found.reflection < 0)
    found.body = np.where(found.reflection < 0, -1, bodies.reflections.body.take(found.reflection))
    if extent.merge and len(left):
        if len(braked):
            mean = _as_found(found, bodies, mean, measurement, braked)
        found.body[left] = beside(bodies, mean, measurement, left, extent, detections.time_ns)
    if settings.method == "nearest" or not detections.identified:
        lost = detections.time_ns - bodies.obstacles.last_ns > round(settings.mode_time * 1e9)
        claimed = _by_modes(found, bodies, mean, covariance, vague, lost, measurement, settings, extent.stray.fastest)
        found.slot_jumps -= _kept(found, bodies, detections, claimed)
        left = np.flatnonzero(found.body < 0)
        if extent.merge and len(claimed) and len(left):
            mean = _as_found(found, bodies, mean, measurement, claimed)
            found.body[left] = beside(bodies, mean, measurement, left, extent, detections.time_ns)
    return found


def _nothing(n: int) -> Association:
    """Return that n detections are of nothing known."""
    return Association(np.full(n, -1, np.intp), np.full(n, -1, np.intp), np.full(n, np.nan))


def _by_id(bodies: Bodies, detections: Detections, settings: AssociationSettings, vague: Booleans) -> Association:
    """Associate by ids; one that comes twice in a scan stands for nothing, nor does that of an object called new."""
    keys = detections.object_id
    rows, distinct = bodies.rows_of(detections.sensor, keys)
    if compiled.in_use and distinct and settings.method != "id" and not detections.measurement.projections:
        return _fit(bodies, detections, settings, vague, rows)
    found = _nothing(len(keys))
    row = np.where(detections.new | vague.take(bodies.reflections.body.take(rows)), -1, rows)
    if not distinct:
        _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
        row[counts[inverse] > 1] = -1
    known = np.flatnonzero(row >= 0)
    if not len(known):
        return found
    row = row.take(known)
    nis = pair_nis(*bodies.reflection_states(row), detections.measurement.take(known))
    if settings.method == "id":
        within = np.ones(len(known), dtype=np.bool_)
    else:
        confirmed = bodies.obstacles.confirmed.take(bodies.reflections.body.take(row))
        within = nis <= np.where(confirmed, settings.id_gate, settings.gate)
        found.slot_jumps = int(len(within) - np.count_nonzero(within))
    chosen = np.flatnonzero(within)
    if not distinct:  # of two ids for one reflection the likelier one counts
        order = chosen[np.argsort(nis[chosen], kind="stable")]
        _, first = np.unique(row[order], return_index=True)
        chosen = order[first]
    found.reflection[known[chosen]] = row[chosen]
    found.nis[known[chosen]] = nis[chosen]
    return found


def _fit(
    bodies: Bodies,
    detections: Detections,
    settings: AssociationSettings,
    vague: Booleans,
    rows: Indices,
) -> Association:
    """Do that with a kernel, where no id comes twice and all are gated."""
    moments, reflections, measurement = bodies.moments(), bodies.reflections, detections.measurement
    rate, variance = measurement.range_rate, measurement.range_rate_variance
    if rate is None or variance is None:
        rate = variance = np.full(len(rows), np.nan)
    (x0, y0), (vx0, vy0) = measurement.origin.tolist(), measurement.velocity.tolist()
    reflection, nis, slot_jumps = compiled.kernels.fit_reflections(
        rows,
        detections.new,
        vague,
        reflections.body,
        moments.shown,
        moments.shown_covariance,
        reflections.offset,
        reflections.variance,
        bodies.obstacles.axis,
        bodies.obstacles.confirmed,
        measurement.position,
        measurement.noise,
        rate,
        variance,
        x0,
        y0,
        vx0,
        vy0,
        settings.id_gate,
        settings.gate,
        *rate_and_pivot(bodies.turning()),
    )
    return Association(np.full(len(rows), -1, np.intp), reflection, nis, slot_jumps=slot_jumps)


def _by_id_in_modes(
    found: Association,
    bodies: Bodies,
    detections: Detections,
    settings: AssociationSettings,
    vague: Booleans,
    walking: float,
) -> Indices:
    """Associate by ids what lies outside the gate of all modes together, as one of them may have moved its body.

    Who brakes hard leaves that gate within three scans, while those who drive on prevail in it. What never drove has no
    course along which to brake.

    Returns:
        The detections.
    """
    rows, distinct = bodies.rows_of(detections.sensor, detections.object_id)
    body, obstacles = bodies.reflections.body.take(rows), bodies.obstacles
    moving = (obstacles.confirmed & _driven(obstacles, walking) & ~vague).take(body)
    left = np.flatnonzero((rows >= 0) & (found.reflection < 0) & ~detections.new & moving & distinct)
    if not len(left):
        return left
    row, body = rows[left], body[left]
    nis = _nis_in_modes(
        bodies, *bodies.reflection_states(row), body, detections.measurement.take(left), settings.least_mode
    )
    inside = nis <= settings.gate
    left = left[inside]
    found.reflection[left], found.nis[left] = row[inside], nis[inside]
    found.slot_jumps -= len(left)
    return left


def _by_place(
    found: Association,
    bodies: Bodies,
    mean: Floats,
    covariance: Floats,
    free: Indices,
    measurement: Measurement,
    gate: float | Floats,
    detecting: Callable[[], Detecting | None] | None,
) -> None:
    """Associate what is left by global nearest neighbour, in doubt where bodies compete for a detection."""
    left = np.flatnonzero(found.reflection < 0)
    row, detection, nis = gated_pairs(mean, covariance, free, measurement, left, gate)
    chosen = best_pairs(row, detection, nis)
    found.reflection[detection[chosen]], found.nis[detection[chosen]] = row[chosen], nis[chosen]
    told = None if detecting is None or len(chosen) == len(row) else detecting()
    if told is None:
        return
    ratio = likelihood_ratios(mean[row], covariance[row], measurement.take(detection), told.probability, told.clutter)
    doubt = doubts(row, detection, bodies.reflections.body[row], ratio, chosen)
    if (doubt > 1.0).any():
        found.doubt = np.ones(len(found.body))
        found.doubt[detection[chosen]] = doubt


def _by_modes(
    found: Association,
    bodies: Bodies,
    mean: Floats,
    covariance: Floats,
    vague: Booleans,
    lost: Booleans,
    measurement: Measurement,
    settings: AssociationSettings,
    walking: float,
) -> Indices:
    """Associate what is left with confirmed bodies of which nothing was found, as each of their modes has moved them.

    Who brakes or turns off out of sight leaves the gate of all modes together, in which those who drive on prevail.
    What never drove has no course to leave, and nothing but false detections drives off with it. What was lost for long
    may be anywhere: a place without a speed does not tell that it is there, though what appears there takes up its
    identity once confirmed.

    Returns:
        The detections.
    """
    left, owner = np.flatnonzero(found.body < 0), bodies.reflections.body
    if not len(left):
        return left
    missed = bodies.obstacles.confirmed & _driven(bodies.obstacles, walking) & ~vague
    missed[found.body[found.body >= 0]] = False
    row, detection = near_pairs(mean, np.flatnonzero(missed.take(owner)), measurement, left)
    told = ~lost[owner[row]] | (measurement.measured[detection] >= _PLACE_AND_RATE)
    row, detection = row[told], detection[told]
    if not len(row):
        return detection
    each = measurement.take(detection)
    nis = _nis_in_modes(bodies, mean[row], covariance[row], owner[row], each, settings.least_mode)
    inside = nis <= settings.gate
    row, detection, nis = row[inside], detection[inside], nis[inside]
    chosen = best_pairs(row, detection, nis)
    row, detection = row[chosen], detection[chosen]
    found.reflection[detection], found.nis[detection], found.body[detection] = row, nis[chosen], owner[row]
    return detection


def _driven(obstacles: BodyTable, walking: float) -> Booleans:
    """Return who has a course to leave: who was ever faster than those who walk, m/s."""
    return obstacles.directed & (obstacles.fastest > walking)


def _kept(found: Association, bodies: Bodies, detections: Detections, claimed: Indices) -> int:
    """Return how many of some detections are of the reflections that the sensor's ids say: their slots did not jump."""
    if not detections.identified or not len(claimed):
        return 0
    rows, distinct = bodies.rows_of(detections.sensor, detections.object_id)
    same = (rows[claimed] == found.reflection[claimed]) & ~detections.new[claimed]
    return int(np.count_nonzero(same)) if distinct else 0


def _as_found(found: Association, bodies: Bodies, mean: Floats, measurement: Measurement, claimed: Indices) -> Floats:
    """Return states of reflections (n, 4), of bodies that were found elsewhere as one of their detections has them.

    Args:
        found: what the detections belong to.
        bodies: that are known.
        mean: of their reflections as expected (n, 4).
        measurement: of the scan.
        claimed: rows of the detections of such bodies.
    """
    innovation, jacobian, _ = measurement.take(claimed).linearised(mean[found.reflection[claimed]])
    apart = np.concatenate(
        [innovation[:, :2], np.einsum("pf,pfd->pd", innovation[:, 2:], jacobian[:, 2:, 2:4])], axis=1
    )
    step = np.zeros((len(bodies), 4))
    step[found.body[claimed]] = apart
    return mean + step.take(bodies.reflections.body, axis=0)


def _nis_in_modes(
    bodies: Bodies, mean: Floats, covariance: Floats, body: Indices, measurement: Measurement, least: float
) -> Floats:
    """Return the normalised innovations squared of aligned pairs in the mode that fits each best (p,).

    Args:
        bodies: that are known.
        mean: states of reflections over all modes (p, 4).
        covariance: (p, 4, 4).
        body: row of the body of each (p,).
        measurement: p detections.
        least: probability below which a mode is not looked for.
    """
    moments, (probability, shown, spread) = bodies.moments(), in_modes(bodies, body)
    modes = shown.shape[1]
    mean = mean[:, None] + (shown - moments.shown[body, None])
    covariance = covariance[:, None] + (spread - moments.shown_covariance[body, None])
    each = measurement.take(np.repeat(np.arange(len(body)), modes))
    innovation, jacobian, noise = each.linearised(mean.reshape(-1, 4))
    s = jacobian @ covariance.reshape(-1, 4, 4) @ np.swapaxes(jacobian, 1, 2) + noise
    f = innovation.shape[1]
    return nis_in_best_mode(probability, innovation.reshape(-1, modes, f), s.reshape(-1, modes, f, f), least)


def in_modes(bodies: Bodies, rows: Indices) -> tuple[Floats, Floats, Floats]:
    """Return how probable modes are in which some bodies may have gone on, and what a sensor would see in each.

    What moves does not stand at once: of that mode the probability is 0 unless the body is taken to stand. Nor does a
    reflection that slides over a body explain where that has gone.

    Args:
        bodies: that are known.
        rows: of the bodies (m,).

    Returns:
        Probabilities (m, M), means (m, M, 4) and covariances (m, M, 4, 4) of place and velocity.
    """
    probability, (shown, spread) = bodies.filter.probability[rows], bodies.filter.shown_in_modes(rows)
    probability[:, STANDING] *= probability[:, STANDING] > _STANDS
    probability[:, SLIDING] = 0.0
    return probability, shown, spread


def beside(
    bodies: Bodies, mean: Floats, measurement: Measurement, left: Indices, extent: ReflectionSettings, time_ns: int
) -> Indices:
    """Return for each of some detections the body that it is one more reflection of, or −1.

    It lies near one of the body's reflections, as far as its size leaves room for, or within its box where its size
    and course are known. Beside who is known to walk, what stands is none of them. Nor is what lies before a body that
    was seen for long: a sensor sees the near side of what it sees, and not something else of it seconds later.

    Args:
        bodies: that are known.
        mean: states of their reflections (n, 4).
        measurement: of the scan.
        left: rows of the detections (m,).
        extent: how near, and how alike.
        time_ns: of the scan.
    """
    owner, obstacles = bodies.reflections.body, bodies.obstacles
    axis = obstacles.axis[owner]
    place = to_travel_axes(measurement.position[left, None] - mean[None, :, :2], axis)
    reach = to_travel_axes(measurement.position[left, None] - bodies.moments().shown[owner, :2], axis)
    longest = obstacles.length[owner] + extent.along
    close = (
        (np.abs(place[..., 0]) < np.minimum(extent.along, obstacles.length[owner] + extent.edge))
        & (np.abs(place[..., 1]) < extent.across)
        & (np.abs(reach[..., 0]) < np.minimum(longest, extent.extent))
        & (np.abs(reach[..., 1]) < 2 * extent.across)
    )
    age = np.maximum(time_ns - obstacles.first_ns.take(owner), 0) * 1e-9
    slow = obstacles.confirmed.take(owner) & (obstacles.fastest.take(owner) <= extent.stray.fastest)
    speed = np.where(slow & (age > extent.stood.time), min(extent.speed, extent.stood.speed), extent.speed)
    alike = _as_fast(mean, measurement, left, speed, extent.slide / np.maximum(age, _LEAST_AGE))
    before = detections_before(bodies, mean, measurement, left, extent, time_ns)
    close &= alike & ~before.take(owner, axis=1)
    distance = np.where(close, (place[..., 0] / extent.along) ** 2 + (place[..., 1] / extent.across) ** 2, np.inf)
    found = np.where(close.any(axis=1), owner[distance.argmin(axis=1)], -1)
    sized = obstacles.sized & obstacles.directed
    if not sized.any() or (found >= 0).all():
        return found
    centre = bodies.moments().mean[:, POSITION] - obstacles.facing
    within = np.abs(to_travel_axes(measurement.position[left, None] - centre, obstacles.axis))
    within[..., 0] -= 0.5 * obstacles.length
    within[..., 1] -= 0.5 * obstacles.width
    inside = (within.max(axis=2) < extent.edge) & sized & alike[:, obstacles.leader]
    deepest = np.where(inside, within.max(axis=2), np.inf).argmin(axis=1)
    return np.where((found < 0) & inside.any(axis=1), deepest, found)


def _as_fast(mean: Floats, measurement: Measurement, left: Indices, speed: Floats, unclear: Floats) -> Booleans:
    """Return which of the detections (m,) have the speeds of which reflections (n,), as far as they are measured.

    A range rate is that of the body along the detection's own line of sight: metres away on what passes close by,
    a reflection of the same body is seen at another angle. Across the line of sight, the speed of a young body follows
    from few places, which slide over it: a sensor that tells velocities may contradict it.

    Args:
        mean: states of the reflections (n, 4).
        measurement: of the scan.
        left: rows of the detections (m,).
        speed: by which they may differ (n,), m/s.
        unclear: by which velocities may differ beyond that (n,), m/s.
    """
    alike = np.ones((len(left), len(mean)), dtype=np.bool_)
    if measurement.range_rate is not None:
        sight = measurement.position[left] - measurement.origin
        sight /= np.maximum(np.sqrt((sight * sight).sum(axis=1)), _NEAREST)[:, None]
        rate = sight @ (mean[:, 2:4] - measurement.velocity).T
        measured = measurement.range_rate[left, None]
        alike &= (np.abs(rate - measured) < speed) | ~np.isfinite(measured)
    for part in measurement.projections:
        value = part.value[left, None]
        differs = np.abs(part.direction[left] @ mean[:, 2:4].T - value)
        alike &= (differs < speed + unclear + 2 * np.sqrt(part.variance[left, None])) | ~np.isfinite(value)
    return alike
