"""All bodies that a group of sensors tracks: one row an obstacle with one filter, and the reflections that they show.

Bodies, their filter and the boxes keep the same rows in the same order; rows are appended and deleted here alone.
Offsets are along and across the body's axis, from its reference point (with the bias that its filter estimates).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import expm1
from typing import Final

import numpy as np

from candaemon import compiled
from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.arrays.rows import checked_state
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.estimation.body_filter import BIAS, POSITION, BodyFilter, BodyFilterState
from candaemon.tracking.body_modes import STANDING, dynamics_of, modes_of
from candaemon.tracking.body_sizes import CAR_LENGTH, CAR_WIDTH, ENOUGH, SMALL, TOLD_LENGTH
from candaemon.tracking.columns import Table
from candaemon.tracking.id_rows import IdRows
from candaemon.tracking.identities import Identities
from candaemon.tracking.reflections import from_travel_axes, to_travel_axes
from candaemon.tracking.table_rows import check_rows, renumbered, renumbered_bits, renumbered_ids
from candaemon.tracking.turning import Turning, rate_and_pivot

UNUSED: Final = 1e3
"""Of an innovation that there is none: so large is no error."""
_LEAST_NORMAL = 1e-12  # 1/m²
_BEYOND_TIME = 0.2  # s, with which a reference point follows reflections that lie beyond its body
_DRIFT_TIME = 1.0  # s, time constant of the mean speed of that
_OPENING_TIME = 0.03  # s, after which the square of that speed is added to the variance of the velocity
_LEAST_DRIFT = 1e-3  # m/s; below it nothing drifts
_LEAST_TIME = 1e-3  # s
_LONGEST_INTERVAL = 0.5  # s; a gap that is longer counts as one of this length
_COURSE_SPEED = 3.0  # m/s, what was ever faster has a known axis


def _integers() -> Integers:
    return np.zeros(0, dtype=np.int64)


def _numbers() -> Floats:
    return np.zeros(0)


def _pairs() -> Floats:
    return np.zeros((0, 2))


@dataclass(slots=True)
class BodyReflectionTable(Table):
    """Columns of the reflections.

    Attributes:
        sensor: index of the sensor that reports it.
        serial: number that no other reflection ever has.
        object_id: that sensor's own id, −1 once the id has gone to something else.
        body: row of its body.
        first_ns, last_ns: first and latest detection.
        offset: where it lies (n, 2), along and across the body's axis, m.
        variance: of each component of the offset, m².
        rate_difference: smoothed difference of its range rate from that of its body, m/s.
        innovation: of its place when it was last detected (n, 2), local frame, in standard deviations of the noise;
            `UNUSED` where it did not lead, or its body was too young.
        trail: its place and its velocity over ground for itself (n, 4), local frame, m and m/s; of bodies that show
            several.
        trail_ns: of those.
        walked: how far it has walked in that time, 1: far enough to be sure.
        stood: for how long it has not moved at all, s.
    """

    sensor: Integers = field(default_factory=_integers)
    serial: Integers = field(default_factory=_integers)
    object_id: Integers = field(default_factory=_integers)
    body: Integers = field(default_factory=_integers)
    first_ns: Integers = field(default_factory=_integers)
    last_ns: Integers = field(default_factory=_integers)
    offset: Floats = field(default_factory=_pairs)
    variance: Floats = field(default_factory=_numbers)
    rate_difference: Floats = field(default_factory=_numbers)
    innovation: Floats = field(default_factory=_pairs)
    trail: Floats = field(default_factory=lambda: np.zeros((0, 4)))
    trail_ns: Integers = field(default_factory=_integers)
    walked: Floats = field(default_factory=_numbers)
    stood: Floats = field(default_factory=_numbers)

    def __len__(self) -> int:
        return len(self.sensor)


@dataclass(slots=True)
class BodyTable(Table):
    """Columns of the bodies.

    Attributes:
        id: identity.
        first_ns, last_ns: first and latest detection.
        interval: time from the detection before to the latest one, by whatever sensor, s.
        history: bit 0 the latest scan, set where it was detected.
        scans: scans since its initiation.
        confirmed: whether it ever was.
        leader: row of the reflection whose bias the filter estimates.
        axis: unit vector along the body, local frame.
        directed: whether its course, or a sensor, has ever told that axis well.
        ahead: speed backwards from which on it has turned round rather than backs, m/s: the greatest that it surely had
            along its axis, or the greatest at which anything backs where a sensor told its heading.
        length, width: of its box, m.
        length_variance, width_variance: of those, m².
        extent: how much of its length its reflections have shown, m.
        alone: for how long it was near and showed one reflection only, 1: long enough to be small; below 0 once it
            has shown several.
        fastest: greatest speed it had, m/s.
        facing: reference point minus centre of the box (n, 2), local frame, m.
        drift: mean speed at which its reference point followed reflections beyond its box (n, 2), local frame, m/s; it
            changes while the body is detected.
        alongside_ns: time for which it has been a merge candidate.
        sensors: bit k set where sensor k detected it.
        existence: probability that there is something.
        in_sight: share of it that the latest scan to look there could see, 0 to 1.
        unseen: time for which it could have been detected since it was, s.
    """

    id: Integers = field(default_factory=_integers)
    first_ns: Integers = field(default_factory=_integers)
    last_ns: Integers = field(default_factory=_integers)
    interval: Floats = field(default_factory=_numbers)
    history: Integers = field(default_factory=_integers)
    scans: Integers = field(default_factory=_integers)
    confirmed: Booleans = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    leader: Integers = field(default_factory=_integers)
    axis: Floats = field(default_factory=_pairs)
    directed: Booleans = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    ahead: Floats = field(default_factory=_numbers)
    length: Floats = field(default_factory=_numbers)
    width: Floats = field(default_factory=_numbers)
    length_variance: Floats = field(default_factory=_numbers)
    width_variance: Floats = field(default_factory=_numbers)
    extent: Floats = field(default_factory=_numbers)
    alone: Floats = field(default_factory=_numbers)
    fastest: Floats = field(default_factory=_numbers)
    facing: Floats = field(default_factory=_pairs)
    drift: Floats = field(default_factory=_pairs)
    alongside_ns: Integers = field(default_factory=_integers)
    sensors: Integers = field(default_factory=_integers)
    existence: Floats = field(default_factory=_numbers)
    in_sight: Floats = field(default_factory=_numbers)
    unseen: Floats = field(default_factory=_numbers)

    def __len__(self) -> int:
        return len(self.id)

    @property
    def sized(self) -> Booleans:
        """Of which bodies the size is known: a sensor told it, they are small, or enough of them was seen."""
        return (self.length_variance < TOLD_LENGTH) | (self.length < SMALL) | (self.extent > ENOUGH)


@dataclass(slots=True)
class BodiesState:
    """All that is remembered of the bodies.

    Attributes:
        reflections: one row a reflection.
        obstacles: one row a body.
        estimator: of the filter, one row a body.
        row_of: row of the reflection that a sensor's object id stands for, by the sensor's number and the id.
        serials: given to reflections so far.
    """

    reflections: BodyReflectionTable
    obstacles: BodyTable
    estimator: BodyFilterState
    row_of: dict[tuple[int, int], int] = field(default_factory=dict)
    serials: int = 0


@dataclass(slots=True)  # made each cycle
class BodyMoments:
    """What the filter says of the bodies at the moment.

    Attributes:
        mean: (k, 8), as in `BodyFilter`.
        covariance: of place and velocity (k, 4, 4).
        shown: place where the leading reflection is expected, and velocity (k, 4), local frame.
        shown_covariance: (k, 4, 4).
    """

    mean: Floats
    covariance: Floats
    shown: Floats
    shown_covariance: Floats


class Bodies:
    """The bodies that live.

    Args:
        settings: of the estimator.
        identities: the numbers of new obstacles.
    """

    def __init__(self, settings: VehicleEstimatorSettings, identities: Identities) -> None:
        self._identities = identities
        self._places = settings.reflections
        self.filter = BodyFilter(modes_of(settings), dynamics_of(settings))
        self.reflections = BodyReflectionTable()
        self.obstacles = BodyTable()
        self._state = BodiesState(self.reflections, self.obstacles, self.filter.state)
        # computed from the state when first asked for
        self._moments: BodyMoments | None = None
        self._turning: Turning | None = None
        self._turning_known = False
        self._shifted = False
        self._id_rows = IdRows()
        self.first_existence = 0.5

    def __len__(self) -> int:
        return len(self.obstacles.id)

    @property
    def state(self) -> BodiesState:
        """All that it remembers.

        Raises:
            ValueError: a state that is set does not fit the settings, or contradicts itself.
        """
        return self._state

    @state.setter
    def state(self, state: BodiesState) -> None:
        obstacles = checked_state(state.obstacles, BodyTable())
        reflections = checked_state(state.reflections, BodyReflectionTable())
        self.filter.state = state.estimator
        _check_rows(state)
        self._state, self.reflections, self.obstacles = state, reflections, obstacles
        self._id_rows.clear()
        self.changed()

    def changed(self) -> None:
        """Forget what was computed from the filter: it has changed."""
        self._moments, self._shifted = None, False
        self.forget_turning()

    def restart(self) -> None:
        """Let what the filter says follow from its state alone, to the last bit, as after that was restored."""
        self.forget_turning()
        if self._shifted:
            self.changed()

    def moments(self) -> BodyMoments:
        """Return what the filter says."""
        if self._moments is None:
            self._moments = BodyMoments(*self.filter.moments())
        return self._moments

    def turning(self) -> Turning | None:
        """Return how those bodies turn that are known to be no points; None: none is.

        A box is known, or several reflections were seen. A walker or rider, taken for small where it shows one
        reflection, turns about that.
        """
        if not self._turning_known:
            self._turning, self._turning_known = self._find_turning(), True
        return self._turning

    def _find_turning(self) -> Turning | None:
        obstacles, mean = self.obstacles, self.moments().mean
        if compiled.in_use:
            found = compiled.kernels.turning_of_bodies(
                self.filter.probability.T,
                self.filter.state.mean.T,
                self.filter.state.covariance.T,
                mean,
                obstacles.facing,
                obstacles.length,
                obstacles.length_variance,
                obstacles.extent,
                obstacles.alone,
                obstacles.directed,
                TOLD_LENGTH,
                SMALL,
                ENOUGH,
            )
            return None if found is None else Turning(*found)
        sized, directed = obstacles.sized, obstacles.directed & (obstacles.length >= SMALL)
        known = directed & (sized | (obstacles.alone < 0.0))
        if not known.any():
            return None
        rate, variance = self.filter.turn_rates()
        pivot = mean[:, POSITION] - np.where(sized[:, None], obstacles.facing, 0.0)
        return Turning(np.where(known, rate, 0.0), np.where(known, variance, 0.0), pivot)

    def forget_turning(self) -> None:
        """Forget how the bodies turn, and about which points: those have moved."""
        self._turning, self._turning_known = None, False

    def swing(self) -> tuple[Floats, Floats] | None:
        """Return what turning adds to the velocity that the filter tells, to get that of the reference point.

        What stands does not turn: of a turn rate as much counts as is probable to move.

        Returns:
            It (k, 2), local frame, m/s, and one standard deviation of it, a vector likewise; None: nothing of any.
        """
        turning = self.turning()
        if turning is None:
            return None
        mean, standing = self.moments().mean, self.filter.probability[:, STANDING]
        if compiled.in_use:
            return compiled.kernels.swing_of_bodies(mean, standing, turning.rate, turning.variance, turning.pivot)
        arm = mean[:, POSITION] - turning.pivot
        if not np.count_nonzero(arm):
            return None
        moves = (1.0 - standing)[:, None]
        more, unknown = turning.swing(arm)
        return moves * more, moves * unknown

    def sure_turning(self) -> Turning | None:
        """Return how bodies turn as far as they surely do, and do not stand; None: none does."""
        turning = self.turning()
        if turning is None:
            return None
        # a turn rate that is still told after the turn would drive the point off
        sure = turning.surely(self._places.sure_turn, 1.0 - self.filter.probability[:, STANDING])
        return sure if np.count_nonzero(sure.rate) else None

    def swing_references(self, dt: float) -> None:
        """Let the reference points turn with their bodies, as far as those surely turn: predicted, they went straight.

        Args:
            dt: s; below 0 for a scan that comes late.
        """
        if compiled.in_use:
            if (turning := self.turning()) is not None:
                mean, standing, sure = self.moments().mean, self.filter.probability[:, STANDING], self._places.sure_turn
                rate, variance, pivot = turning.rate, turning.variance, turning.pivot
                step = compiled.kernels.sure_swings(mean, standing, rate, variance, pivot, sure, dt)
                if step is not None:
                    self.shift(step)
            return
        turning = self.sure_turning()
        if turning is None:
            return
        swing, _ = turning.swing(self.moments().mean[:, POSITION] - turning.pivot)
        if np.count_nonzero(swing):
            self.shift(dt * swing)

    def reflection_states(self, rows: Indices | None = None) -> tuple[Floats, Floats]:
        """Return where reflections are expected and how they move: means (n, 4), covariances (n, 4, 4).

        Args:
            rows: of the reflections (n,); None: all.
        """
        moments, reflections = self.moments(), self.reflections
        body = reflections.body if rows is None else reflections.body.take(rows)
        variance = reflections.variance if rows is None else reflections.variance.take(rows)
        if compiled.in_use:
            offset = reflections.offset if rows is None else reflections.offset.take(rows, axis=0)
            shown, spread, axis = moments.shown, moments.shown_covariance, self.obstacles.axis
            turn, pivot = rate_and_pivot(self.turning())
            return compiled.kernels.states_of_reflections(shown, spread, body, offset, variance, axis, turn, pivot)
        mean, covariance = moments.shown.take(body, axis=0), moments.shown_covariance.take(body, axis=0)
        mean[:, :2] += self.offsets(rows)
        covariance[:, 0, 0] += variance
        covariance[:, 1, 1] += variance
        if (turning := self.turning()) is not None:
            mean[:, 2:] += turning.velocities(body, mean[:, :2])
        return mean, covariance

    def offsets(self, rows: Indices | None = None) -> Floats:
        """Return the offsets of some reflections, None: of all, (n, 2), local frame, m."""
        body, offset, axis = self.reflections.body, self.reflections.offset, self.obstacles.axis
        if rows is None:
            return from_travel_axes(offset, axis.take(body, axis=0))
        if compiled.in_use:
            return compiled.kernels.offsets_of_reflections(offset, axis, body, rows)
        return from_travel_axes(offset.take(rows, axis=0), axis.take(body.take(rows), axis=0))

    def learn_offsets(self, rows: Indices, position: Floats, noise: Floats, before: Floats) -> None:
        """Update where on their bodies reflections lie.

        Args:
            rows: of the reflections, none twice (m,).
            position: where they were measured (m, 2), local frame, m.
            noise: covariances of that (m, 2, 2), m².
            before: their offsets before the bodies were updated (m, 2), local frame, m.
        """
        reflections, shown, axis = self.reflections, self.moments().shown, self.obstacles.axis
        body, offset, variance = reflections.body.take(rows), reflections.offset, reflections.variance
        if compiled.in_use:
            compiled.kernels.learn_offsets(offset, variance, rows, body, position, noise, shown, before, axis)
            return
        place = position - shown[body, :2] - before
        was = variance[rows]
        gain = was / (was + 0.5 * (noise[:, 0, 0] + noise[:, 1, 1]))
        offset[rows] += gain[:, None] * to_travel_axes(place, axis[body])
        variance[rows] = (1.0 - gain) * was

    def rows_of(self, sensor: int, object_id: Integers) -> tuple[Indices, bool]:
        """Return the rows that a sensor's ids stand for, −1: for nothing; and whether no id and no row comes twice."""
        return self._id_rows.of(self._state.row_of, sensor, object_id)

    def mark_detected(self, rows: Indices, keys: Integers | None, sensor: int, time_ns: int) -> None:
        """Mark reflections and their bodies as detected, and assign the ids that they were detected with.

        Args:
            rows: of the reflections, none twice (m,).
            keys: the sensor's object ids (m,); None: it tells none.
            sensor: its number.
            time_ns: of the scan.
        """
        obstacles, reflections, renamed = self.obstacles, self.reflections, list[int]()
        body = reflections.body.take(rows)
        if compiled.in_use:
            renamed = compiled.kernels.mark_detected(
                rows,
                body,
                keys,
                reflections.sensor,
                reflections.object_id,
                reflections.last_ns,
                obstacles.history,
                obstacles.sensors,
                sensor,
                time_ns,
            )
        else:
            if keys is not None:
                changed = (reflections.object_id[rows] != keys) | (reflections.sensor[rows] != sensor)
                renamed = np.flatnonzero(changed).tolist()
            reflections.sensor[np.delete(rows, renamed)] = sensor
            reflections.last_ns[rows] = time_ns
            obstacles.history[body] |= 1
            obstacles.sensors[body] |= 1 << sensor
        if keys is not None:
            for each in renamed:
                self.assign_id(int(rows[each]), sensor, int(keys[each]))

    def assign_id(self, reflection: int, sensor: int, key: int) -> None:
        """Assign a sensor's object id to a reflection; it stands for no other, nor another of its ids for this.

        An id of each sensor is kept, since several may see the same point in turn.
        """
        self._id_rows.clear()
        reflections, row_of = self.reflections, self._state.row_of
        latest = int(reflections.sensor[reflection]), int(reflections.object_id[reflection])
        if latest[0] == sensor and row_of.get(latest) == reflection:
            del row_of[latest]
        former = row_of.get((sensor, key))
        if former is not None and reflections.sensor[former] == sensor:
            reflections.object_id[former] = -1
        row_of[sensor, key] = reflection
        reflections.sensor[reflection], reflections.object_id[reflection] = sensor, key

    def add(self, time_ns: int, axis: Floats, length: float, width: float, ahead: float = 0.0) -> int:
        """Append a body whose row the filter has just appended, led by the next reflection; return its row."""
        zero = np.zeros(1, dtype=np.int64)
        self.obstacles.append(
            id=np.array([self._identities.new()]),
            first_ns=np.array([time_ns]),
            last_ns=np.array([time_ns]),
            interval=np.zeros(1),
            history=zero,
            scans=zero,
            confirmed=np.zeros(1, dtype=np.bool_),
            leader=np.array([len(self.reflections)]),
            axis=axis[None],
            directed=np.array([ahead > 0.0]),
            ahead=np.array([ahead]),
            length=np.array([length]),
            width=np.array([width]),
            length_variance=np.array([_LENGTH_SPREAD**2]),
            width_variance=np.array([_WIDTH_SPREAD**2]),
            extent=np.zeros(1),
            alone=np.zeros(1),
            fastest=np.zeros(1),
            facing=np.zeros((1, 2)),
            drift=np.zeros((1, 2)),
            alongside_ns=zero,
            sensors=zero,
            existence=np.array([self.first_existence]),
            in_sight=np.ones(1),
            unseen=np.zeros(1),
        )
        self.changed()
        return len(self.obstacles) - 1

    def add_reflection(self, body: int, sensor: int, key: int | None, time_ns: int, offset: Floats) -> int:
        """Append a reflection of a body, an offset (2,) away from the leading one; return its row."""
        row, obstacles = len(self.reflections), self.obstacles
        leads = int(obstacles.leader[body]) == row
        self._state.serials += 1
        self.reflections.append(
            sensor=np.array([sensor]),
            serial=np.array([self._state.serials]),
            object_id=np.array([-1]),
            body=np.array([body]),
            first_ns=np.array([time_ns]),
            last_ns=np.array([time_ns]),
            offset=offset[None],
            variance=np.array([0.0 if leads else self._places.spread**2]),
            rate_difference=np.zeros(1),
            innovation=np.full((1, 2), UNUSED),
            trail=np.zeros((1, 4)),
            trail_ns=np.zeros(1, dtype=np.int64),
            walked=np.zeros(1),
            stood=np.zeros(1),
        )
        if key is not None:
            self.assign_id(row, sensor, key)
        if not leads and np.count_nonzero(self.reflections.body == body) == 2:
            self.filter.loosen(np.array([body]), self._places.body**2)
            self.changed()
        if obstacles.last_ns[body] != time_ns:
            self.note_detections(np.array([body]), time_ns)
        obstacles.history[body] |= 1
        obstacles.sensors[body] |= 1 << sensor
        return row

    def lead(self, bodies: Indices, leaders: Indices) -> None:
        """Let other reflections lead bodies; they keep their offsets, so that the reference points stay."""
        self.obstacles.leader[bodies] = leaders

    def take_axes(self, axes: Floats, told: Booleans) -> None:
        """Turn the axes of the bodies, and their reflections with them, but for those whose axes were a guess so far.

        Args:
            axes: unit vectors (k, 2), local frame.
            told: whose axes their courses tell for the first time (k,): their reflections stay where they are.
        """
        reflections, before = self.reflections, self.obstacles.axis
        self.obstacles.axis = axes
        if not np.count_nonzero(told):
            return
        rows = np.flatnonzero(told[reflections.body])
        body = reflections.body[rows]
        place = from_travel_axes(reflections.offset[rows], before[body])
        reflections.offset[rows] = to_travel_axes(place, axes[body])

    def keep_reflections(self, turned_round: Booleans) -> None:
        """Let the reflections of bodies whose axes turned round (k,) stay where they are."""
        self.reflections.offset[turned_round[self.reflections.body]] *= -1.0

    def refer_to_leaders(self, bodies: Indices) -> None:
        """Move the reference points of bodies to where their leading reflections are."""
        obstacles, reflections = self.obstacles, self.reflections
        step = np.zeros((len(self), 2))
        step[bodies] = reflections.offset[obstacles.leader[bodies]]
        reflections.offset -= step.take(reflections.body, axis=0)
        self.shift(from_travel_axes(step, obstacles.axis))

    def note_detections(self, bodies: Indices, time_ns: int) -> None:
        """Note that bodies (m,) are detected at a time, and how long that is after their detections before.

        What follows what a body shows goes by that interval: the time since the scan before would be shorter the more
        sensors there are, whether they see the body or not.
        """
        obstacles = self.obstacles
        if compiled.in_use:
            compiled.kernels.note_detections(obstacles.interval, obstacles.last_ns, bodies, time_ns, _LONGEST_INTERVAL)
            return
        interval = (time_ns - obstacles.last_ns[bodies]) * 1e-9
        obstacles.interval[bodies] = np.minimum(np.maximum(interval, 0.0), _LONGEST_INTERVAL)
        obstacles.last_ns[bodies] = time_ns

    def return_reference(self, time_ns: int, return_time: float, patience_ns: int) -> None:
        """Let the reference points return to what is seen of the bodies, without a speed of their own.

        Along a body that point follows the end that faces us, the more the less we see of the body's side; across it,
        the middle of what is seen. Of what has no known axis it follows what is nearest to us. All sensors' reflections
        count alike: one that sees no more than an end of a body does not outweigh those that see its whole side. What
        has just begun was led by whichever reflection came first: it returns as a mean over its life would.

        Args:
            time_ns: of the scan.
            return_time: time constant, s; that of younger bodies is their age.
            patience_ns: for which a reflection still counts.
        """
        obstacles, reflections = self.obstacles, self.reflections
        self._keep_bias_within(time_ns)
        if not np.count_nonzero(reflections.offset):  # faster than any()
            return
        exponent = self._return_exponents(time_ns, return_time)
        if not np.count_nonzero(exponent):
            return
        left, target = np.expm1(exponent), self._reference_targets(time_ns - patience_ns)
        if compiled.in_use:
            step = compiled.kernels.step_references(reflections.body, reflections.offset, target, left, obstacles.axis)
        else:
            step = -left[:, None] * target
            reflections.offset -= step.take(reflections.body, axis=0)
            step = from_travel_axes(step, obstacles.axis)
        self.shift(step)

    def _return_exponents(self, time_ns: int, return_time: float) -> Floats:
        """Return by which powers of e the reference points keep away from where they belong (k,).

        That is minus the time since the detection before, where there is one now, over the time constant.
        """
        obstacles = self.obstacles
        if compiled.in_use:
            return compiled.kernels.return_exponents(
                obstacles.first_ns, obstacles.last_ns, obstacles.interval, time_ns, return_time, _LEAST_TIME
            )
        age = (time_ns - obstacles.first_ns) * 1e-9
        return np.asarray(-self.detected_after(time_ns) / np.maximum(np.minimum(age, return_time), _LEAST_TIME))

    def detected_after(self, time_ns: int) -> Floats:
        """Return how long after the detection before bodies are detected at a time (k,), s; 0 where they are not."""
        interval, last_ns = self.obstacles.interval, self.obstacles.last_ns
        if compiled.in_use:
            return compiled.kernels.detected_after(interval, last_ns, time_ns)
        return np.where(last_ns == time_ns, interval, 0.0)

    def shift(self, step: Floats) -> None:
        """Move the reference points by steps (k, 2), m; what the filter says moves along."""
        self.forget_turning()
        if compiled.in_use and self._moments is not None:
            mean = self.filter.state.mean.T
            compiled.kernels.shift_bodies(mean, self._moments.mean, self._moments.shown, step)
            self._shifted = True
            return
        self.filter.shift(step)
        if self._moments is not None:
            self._moments.mean[:, POSITION] += step
            self._moments.shown[:, :2] += step
            self._shifted = True

    def _reference_targets(self, since_ns: int) -> Floats:
        """Return where the reference points belong (k, 2), along and across from where they are, m.

        Args:
            since_ns: from when on detected reflections count.
        """
        obstacles, reflections = self.obstacles, self.reflections
        if compiled.in_use:
            return compiled.kernels.reference_targets(
                reflections.body,
                reflections.last_ns,
                reflections.offset,
                obstacles.facing,
                obstacles.axis,
                obstacles.length,
                obstacles.width,
                obstacles.fastest,
                since_ns,
                _COURSE_SPEED,
                _LEAST_NORMAL,
            )
        k, recent = len(obstacles), np.flatnonzero(reflections.last_ns >= since_ns)
        owner, place = reflections.body[recent], reflections.offset[recent]
        count = np.bincount(owner, minlength=k)
        sums = np.stack([np.bincount(owner, each, k) for each in place.T], axis=1)
        target = np.asarray(sums / np.maximum(count, 1)[:, None], dtype=np.float64)
        several = (count > 1) & (obstacles.fastest > _COURSE_SPEED)
        facing, aside = to_travel_axes(obstacles.facing, obstacles.axis).T
        towards_us, half = np.copysign(1.0, facing), 0.5 * obstacles.length
        normal = np.square(facing / np.square(obstacles.length)), np.square(aside / np.square(obstacles.width))
        end = np.full(k, -np.inf)
        np.maximum.at(end, owner, towards_us[owner] * place[:, 0])
        from_end = towards_us * (np.where(several, end, 0.0) - half + np.abs(facing))
        share = np.where(several, normal[0] / np.maximum(normal[0] + normal[1], _LEAST_NORMAL), 0.0)
        target[:, 0] += share * (from_end - target[:, 0])
        # What has no known axis lies where it is nearest to us.
        sight = np.stack([facing / np.square(obstacles.length), aside / np.square(obstacles.width)], axis=1)
        sight /= np.maximum(np.sqrt(normal[0] + normal[1]), _LEAST_NORMAL)[:, None]
        near = np.full(k, -np.inf)
        np.maximum.at(near, owner, (sight[owner] * place).sum(axis=1))
        slow = (count > 0) & (obstacles.fastest <= _COURSE_SPEED)
        nearer = np.where(slow, near - (sight * target).sum(axis=1), 0.0)
        target += nearer[:, None] * sight
        return target

    def _keep_bias_within(self, time_ns: int) -> None:
        """Let the reference points of bodies detected follow reflections that would else lie beyond those.

        Those that slide over a body stay on it: where the point has to follow for long, the body moves, and its
        velocity is not what it seemed to be.
        """
        obstacles = self.obstacles
        beyond, some = _beyond(self.moments().mean, obstacles, self._places.beyond)
        if not some and not np.count_nonzero(obstacles.drift):
            return
        dt = self.detected_after(time_ns)
        step, spread = _following(obstacles, beyond, dt, -np.expm1(-dt / _BEYOND_TIME), -np.expm1(-dt / _DRIFT_TIME))
        self.filter.settle(step, spread)
        self.changed()

    def return_to_seen(self, dt: float, return_time: float) -> None:
        """Let the reference points return to where the sensors see them, without a speed of their own.

        How far off that is, the bias, tells of a reflection that has slid away, or of one that had when it was taken up
        and has slid back: the longer it lasts, the likelier is the latter. What is slow stays where it was found.

        Args:
            dt: since the time before, s.
            return_time: time constant, s.
        """
        mean = self.moments().mean
        driving = 1.0 - self.filter.unsteady(np.hypot(mean[:, 2], mean[:, 3]))
        self.settle((-expm1(-dt / return_time) * driving)[:, None] * mean[:, BIAS])

    def settle(self, step: Floats) -> None:
        """Move the reference points by steps that the bias had (k, 2), m: what the sensors see stays where it is."""
        self.forget_turning()
        self.filter.settle(step)
        if self._moments is not None:
            self._moments.mean[:, POSITION] += step
            self._moments.mean[:, BIAS] -= step
            self._shifted = True

    def merge(self, young: int, old: int) -> None:
        """Give the reflections of one body to another; the row left without reflections is to be deleted."""
        obstacles, reflections, moments = self.obstacles, self.reflections, self.moments()
        rows = np.flatnonzero(reflections.body == young)
        apart = moments.shown[young, :2] - moments.shown[old, :2]
        place = apart + from_travel_axes(reflections.offset[rows], obstacles.axis[young])
        reflections.offset[rows] = to_travel_axes(place, obstacles.axis[old])
        reflections.variance[rows] = self._places.spread**2
        reflections.body[rows] = old
        obstacles.last_ns[old] = max(obstacles.last_ns[old], obstacles.last_ns[young])
        obstacles.first_ns[old] = min(obstacles.first_ns[old], obstacles.first_ns[young])
        obstacles.history[old] |= obstacles.history[young]
        obstacles.scans[old] = max(obstacles.scans[old], obstacles.scans[young])
        obstacles.sensors[old] |= obstacles.sensors[young]
        obstacles.existence[old] = max(obstacles.existence[old], obstacles.existence[young])
        obstacles.unseen[old] = min(obstacles.unseen[old], obstacles.unseen[young])
        obstacles.extent[old] = max(obstacles.extent[old], obstacles.extent[young])

    def take_up(self, young: int, old: int) -> None:
        """Let one body go on as another, under its number and since its first detection; they exchange those."""
        obstacles = self.obstacles
        for name in ("id", "first_ns"):
            column = getattr(obstacles, name)
            column[young], column[old] = column[old], column[young]
        obstacles.sensors[young] |= obstacles.sensors[old]
        if obstacles.length_variance[old] <= obstacles.length_variance[young]:
            for name in ("length", "width", "length_variance", "width_variance"):
                column = getattr(obstacles, name)
                column[young] = column[old]
        obstacles.extent[young] = max(obstacles.extent[young], obstacles.extent[old])
        obstacles.fastest[young] = max(obstacles.fastest[young], obstacles.fastest[old])
        if obstacles.directed[old] and not obstacles.directed[young]:
            axes, told = obstacles.axis.copy(), np.zeros(len(self), dtype=np.bool_)
            axes[young], told[young] = obstacles.axis[old], True
            self.take_axes(axes, told)
            self.forget_turning()
            for name in ("directed", "ahead"):
                column = getattr(obstacles, name)
                column[young] = column[old]

    def split(self, splitting: Indices) -> None:
        """Give each of the reflections (none of them leading) a body of its own, which moves as the one it leaves."""
        obstacles, reflections = self.obstacles, self.reflections
        owner, place = reflections.body[splitting], self.offsets()[splitting]
        first = len(obstacles)
        self.filter.keep(np.concatenate([np.arange(first), owner]))
        shift = np.zeros((first + len(splitting), 2))
        shift[first:] = place
        self.filter.shift(shift)
        copies = {name: getattr(obstacles, name)[owner] for name in _COPIED}
        obstacles.append(
            id=np.array([self._identities.new() for _ in splitting], dtype=np.int64),
            last_ns=reflections.last_ns[splitting],
            interval=np.zeros(len(splitting)),
            history=np.ones(len(splitting), dtype=np.int64),
            scans=np.zeros(len(splitting), dtype=np.int64),
            confirmed=np.zeros(len(splitting), dtype=np.bool_),
            ahead=np.zeros(len(splitting)),
            leader=splitting.astype(np.int64),
            alongside_ns=np.zeros(len(splitting), dtype=np.int64),
            existence=np.full(len(splitting), self.first_existence),
            in_sight=np.ones(len(splitting)),
            unseen=np.zeros(len(splitting)),
            **copies,
        )
        reflections.body[splitting] = np.arange(first, len(obstacles))
        reflections.offset[splitting], reflections.variance[splitting] = 0.0, 0.0
        reflections.rate_difference[splitting] = 0.0
        self.changed()

    def forget_shape(self, rows: Indices) -> None:
        """Forget size, course and greatest speed of bodies (m,) that were split off others unlike them."""
        obstacles = self.obstacles
        obstacles.directed[rows] = False
        obstacles.length[rows], obstacles.width[rows] = CAR_LENGTH, CAR_WIDTH
        obstacles.length_variance[rows], obstacles.width_variance[rows] = _LENGTH_SPREAD**2, _WIDTH_SPREAD**2
        obstacles.extent[rows] = obstacles.alone[rows] = obstacles.fastest[rows] = obstacles.ahead[rows] = 0.0
        obstacles.facing[rows] = obstacles.drift[rows] = 0.0
        self.changed()

    def split_together(self, splitting: Indices) -> Indices:
        """Give reflections (m,), none of them leading, bodies of their own: those of one body together.

        Returns:
            The reflections that lead the new bodies, the first of each of the old ones.
        """
        reflections, place = self.reflections, self.offsets(splitting)
        _, begin, group = np.unique(reflections.body[splitting], return_index=True, return_inverse=True)
        first = begin[group]
        self.split(splitting[begin])
        mates = (first != np.arange(len(splitting))).nonzero()[0]
        body = reflections.body[splitting[first[mates]]]
        reflections.body[splitting[mates]] = body
        apart = place[mates] - place[first[mates]]
        reflections.offset[splitting[mates]] = to_travel_axes(apart, self.obstacles.axis[body])
        return splitting[begin]

    def delete(self, lost: Booleans, ended: Booleans) -> Indices:
        """Delete reflections (n,) and bodies (k,), all reflections of an ended body among the lost.

        Returns:
            The new row of each reflection kept, by its old row.
        """
        new_row, new_owner = np.cumsum(~lost) - 1, np.cumsum(~ended) - 1
        if ended.any():
            self.filter.keep(~ended)
            self.obstacles.keep(~ended)
        self.reflections.keep(~lost)
        self.reflections.body = new_owner[self.reflections.body]
        self.obstacles.leader = new_row[self.obstacles.leader]
        gone = lost.tolist()
        self._state.row_of = {key: int(new_row[row]) for key, row in self._state.row_of.items() if not gone[row]}
        self._id_rows.clear()
        self.changed()
        return new_row

    def renumber_sensors(self, sensors: Mapping[int, int]) -> None:
        """Give sensors other numbers, and forget those left out: their reflections, and the bodies only they have seen.

        Args:
            sensors: number of a sensor from here on, by the number it had.
        """
        obstacles, reflections = self.obstacles, self.reflections
        self._id_rows.clear()
        self._state.row_of = renumbered_ids(self._state.row_of, sensors)
        reflections.sensor = renumbered(reflections.sensor, sensors)
        reflections.object_id[reflections.sensor < 0] = -1
        obstacles.sensors = renumbered_bits(obstacles.sensors, sensors)
        ended = obstacles.sensors == 0
        if ended.any():
            self.delete(ended[reflections.body], ended)


_LENGTH_SPREAD, _WIDTH_SPREAD = 2.0, 0.4  # m, of vehicles about a car's
_COPIED = (
    "first_ns",
    "axis",
    "directed",
    "length",
    "width",
    "length_variance",
    "width_variance",
    "extent",
    "alone",
    "fastest",
    "facing",
    "drift",
    "sensors",
)


def _beyond(mean: Floats, obstacles: BodyTable, margin: float) -> tuple[Floats, bool]:
    """Return how far biases reach beyond the boxes, along and across (k, 2), m, and whether any does.

    Along a box that is known they reach from its reference point, which lies where it faces us; of others it is not
    known where on the body that is.

    Args:
        mean: of the bodies (k, 8).
        obstacles: their columns.
        margin: beyond an end of a known box, that a bias may reach, m.
    """
    if compiled.in_use:
        return compiled.kernels.beyond_bodies(
            mean,
            obstacles.axis,
            obstacles.facing,
            obstacles.length,
            obstacles.width,
            obstacles.length_variance,
            obstacles.extent,
            obstacles.directed,
            TOLD_LENGTH,
            SMALL,
            ENOUGH,
            margin,
        )
    place = to_travel_axes(mean[:, BIAS], obstacles.axis)
    half = 0.5 * np.stack([obstacles.length, obstacles.width], axis=1)
    known = obstacles.directed & obstacles.sized
    place[:, 0] = np.where(known, place[:, 0] + to_travel_axes(obstacles.facing, obstacles.axis)[:, 0], place[:, 0])
    half[:, 0] = np.where(known, half[:, 0] + margin, half[:, 0])
    beyond = place - np.minimum(np.maximum(place, -half), half)
    return beyond, bool(beyond.any())


def _following(obstacles: BodyTable, beyond: Floats, dt: Floats, near: Floats, share: Floats) -> tuple[Floats, Floats]:
    """Return by which steps reference points follow biases (k, 2), m, and how fast bodies may move that way, m/s.

    How fast reference points follow is averaged: the bodies' drift.

    Args:
        obstacles: the bodies.
        beyond: how far the biases reach beyond the boxes, along and across (k, 2), m.
        dt: time since the detection before, of what is not detected 0 (k,), s.
        near: share of the way that the points go in that time (k,).
        share: that the speed of it has in the average (k,).
    """
    if compiled.in_use:
        return compiled.kernels.follow_biases(
            obstacles.drift, obstacles.axis, beyond, dt, near, share, _LEAST_TIME, _LEAST_DRIFT, _OPENING_TIME
        )
    step = from_travel_axes(near[:, None] * beyond, obstacles.axis)
    speed = step / np.maximum(dt, _LEAST_TIME)[:, None]
    drift = obstacles.drift + share[:, None] * (speed - obstacles.drift)
    obstacles.drift = np.where(np.abs(drift) > _LEAST_DRIFT, drift, 0.0)
    return step, np.sqrt(dt / _OPENING_TIME)[:, None] * obstacles.drift


def _check_rows(state: BodiesState) -> None:
    """Check that the tables of a state refer to rows that are there.

    Raises:
        ValueError: they do not.
    """
    reflections, obstacles = state.reflections, state.obstacles
    filters = len(state.estimator.probability)
    if len(obstacles) != filters:
        raise ValueError(f"found {filters} filters for {len(obstacles)} obstacles")
    check_rows(reflections.body, obstacles.leader, obstacles.id, state.row_of.values())
    probable = (obstacles.existence >= 0.0) & (obstacles.existence <= 1.0)
    if not (probable & (obstacles.in_sight >= 0.0) & (obstacles.in_sight <= 1.0) & (obstacles.unseen >= 0.0)).all():
        raise ValueError("the existence of an obstacle is no probability, or was not seen for less than no time")
    if not np.isfinite(reflections.trail).all():
        raise ValueError("a reflection was followed to no place")
