"""Scans of faster sensors brought to the instants of the slowest of their group: Gao et al. 2016, section 3.5.

A scan of the slowest waits until each other sensor has looked at that instant or later; then each object of theirs is
interpolated through the three scans around it, in the sensor's own axes. What has been seen twice only is interpolated
along a line; what has been seen once waits for the next scan. Nothing is extrapolated, which multiplies noise: where a
sensor is late or silent, its latest scan is tracked at its own instant, as without alignment.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.binding.bound import Binding, BoundSensor
from candaemon.estimation.alignment import lagrange
from candaemon.frames.times import NEVER_NS
from candaemon.radar.assembly import ScanAssembler
from candaemon.radar.scan import Scan

MOST_KEPT: Final = 8
"""Scans of a sensor that are kept, of which three are needed: others may come while a slower one is late."""
PATIENCE: Final = 2.0
"""Cycles of a sensor for which the scans of others wait for it."""
INTERPOLATED: Final = ("range", "azimuth", "x", "y", "range_rate", "vx", "vy")
"""Quantities that change from scan to scan as motion does; others are taken from the scan after the instant."""

_LONG_AGO_NS = -(1 << 62)
AnyT = TypeVar("AnyT", np.float64, np.bool_)


@dataclass(frozen=True, slots=True)
class KeptScan:
    """A scan as it is remembered, in numbers alone.

    Attributes:
        scan: with 0 for what was not known.
        known: which of its values were (quantities, n).
    """

    scan: Scan
    known: Booleans

    @classmethod
    def of(cls, scan: Scan) -> KeptScan:
        """Return a scan as it is remembered."""
        known = np.isfinite(scan.values)
        return cls(replace(scan, values=np.where(known, scan.values, 0.0)), known)

    @property
    def told(self) -> Scan:
        """The scan as it was."""
        return replace(self.scan, values=np.where(self.known, self.scan.values, np.nan))

    def fits(self, sensor: int, quantities: int) -> bool:
        """Whether it can be a scan of a sensor that tells so many quantities."""
        n = (len(self.scan.object_id),)
        shapes = {self.scan.values.shape, self.known.shape}
        return (
            self.scan.sensor == sensor
            and self.scan.slot.shape == self.scan.new.shape == n
            and shapes == {(quantities, *n)}
        )


@dataclass(slots=True)
class AlignmentState:
    """What is remembered of a group.

    Attributes:
        kept: the latest scans of each sensor but the slowest, oldest first.
        tracked_ns: measurement time up to which each of them was tracked.
        waiting: a scan of the slowest that waits for the others.
        deadline_ns: when it waits no longer; `NEVER_NS` where none does.
        began: ids of each of them that have begun, or mean another object, since they were last tracked.
        silent_from_ns: from when on the slowest is taken for silent.
    """

    kept: dict[int, list[KeptScan]]
    tracked_ns: dict[int, int]
    began: dict[int, list[int]]
    waiting: KeptScan | None = None
    deadline_ns: int = NEVER_NS
    silent_from_ns: int = 0

    def validate(self) -> None:
        """Refuse what contradicts itself.

        Raises:
            ValueError: more scans are kept than can be, or their times do not rise.
        """
        if not self.kept.keys() == self.tracked_ns.keys() == self.began.keys():
            raise ValueError("scans of other sensors than were tracked")
        for scans in self.kept.values():
            times = [each.scan.time_ns for each in scans]
            if len(scans) > MOST_KEPT or any(later <= former for former, later in pairwise(times)):
                raise ValueError(f"{len(scans)} scans are kept for alignment, expected {MOST_KEPT} at most, in order")


class ScanAlignment:
    """Aligns the scans of one group.

    Args:
        sensors: of the group; the slowest gives the instants, the first of them where several are.
        assemblers: of all sensors, by index; `unaligned` is counted there.
    """

    def __init__(self, sensors: Sequence[BoundSensor], assemblers: Sequence[ScanAssembler]) -> None:
        slowest = max(sensors, key=lambda sensor: sensor.settings.cycle_time)
        others = [sensor for sensor in sensors if sensor is not slowest]
        self.slowest = slowest.index
        self._silent_ns = _patience_ns(slowest)
        self._patience_ns = max(map(_patience_ns, others))
        self._assemblers = assemblers
        self._quantities = {each.index: len(each.reader.quantities) for each in sensors}
        self._moving = {
            each.index: np.array([k for k, name in enumerate(each.reader.quantities) if name in INTERPOLATED])
            for each in others
        }
        self._angle = {
            each.index: each.reader.quantities.index("azimuth") if "azimuth" in each.reader.quantities else -1
            for each in others
        }
        indices = [each.index for each in others]
        self.state = AlignmentState(
            {index: [] for index in indices}, dict.fromkeys(indices, _LONG_AGO_NS), {index: [] for index in indices}
        )

    @property
    def deadline_ns(self) -> int:
        """When a scan waits no longer."""
        return self.state.deadline_ns

    def restore(self, state: AlignmentState) -> None:
        """Go on where another alignment of the same sensors was.

        Raises:
            ValueError: the state is of other sensors.
        """
        state.validate()
        scans = {self.slowest: [] if state.waiting is None else [state.waiting]} | state.kept
        if scans.keys() != self._quantities.keys():
            raise ValueError("scans kept for alignment are of other sensors than the group's")
        for sensor, quantities in self._quantities.items():
            if not all(each.fits(sensor, quantities) for each in scans[sensor]):
                raise ValueError(f"a scan kept for alignment does not fit sensor {sensor}")
        self.state = state

    def take(self, scan: Scan, now_ns: int) -> list[Scan]:
        """Take a scan; return those that are to be tracked, in order of measurement.

        Args:
            scan: of a sensor of the group.
            now_ns: when it was complete.
        """
        state = self.state
        # after the clock was set back, what was to be waited for is far ahead
        state.silent_from_ns = min(state.silent_from_ns, now_ns + self._silent_ns)
        is_stale = state.waiting is not None and state.deadline_ns - now_ns > self._patience_ns
        ready = self.expire() if is_stale or scan.sensor == self.slowest else []
        if scan.sensor == self.slowest:
            state.waiting, state.deadline_ns = KeptScan.of(scan), now_ns + self._patience_ns
            state.silent_from_ns = now_ns + self._silent_ns
        else:
            kept = state.kept[scan.sensor]
            if kept and scan.time_ns <= kept[-1].scan.time_ns:  # the clock was set
                kept.clear()
                state.began[scan.sensor].clear()
                state.tracked_ns[scan.sensor] = _LONG_AGO_NS
            kept.append(KeptScan.of(scan))
            del kept[:-MOST_KEPT]
            state.began[scan.sensor] += scan.object_id[scan.new].tolist()
            if now_ns >= state.silent_from_ns and state.waiting is None:
                return [*ready, self._tracked(scan)]
        waiting = state.waiting
        if waiting is not None and all(
            kept and kept[-1].scan.time_ns >= waiting.scan.time_ns for kept in state.kept.values()
        ):
            ready += self.expire()
        return ready

    def expire(self) -> list[Scan]:
        """Return the scan that waits, and what the other sensors saw then, in order of measurement; wait no longer."""
        state = self.state
        waiting, state.waiting, state.deadline_ns = state.waiting, None, NEVER_NS
        if waiting is None:
            return []
        ready = [waiting.told, *self._others(waiting.scan.time_ns)]
        return sorted(ready, key=lambda scan: (scan.time_ns, scan.sensor))

    def _others(self, time_ns: int) -> Iterator[Scan]:
        """Yield what each other sensor saw at an instant, or last."""
        tracked_ns = self.state.tracked_ns
        for sensor, kept in self.state.kept.items():
            after = next((k for k, each in enumerate(kept) if each.scan.time_ns >= time_ns), 0)
            if after:
                found = self._interpolated([each.told for each in kept[max(after - 2, 0) : after + 1]], time_ns)
            elif kept and kept[-1].scan.time_ns > tracked_ns[sensor]:
                found = kept[-1].told
            else:
                continue
            yield self._tracked(found)

    def _tracked(self, scan: Scan) -> Scan:
        """Note that a scan is tracked; return it with what has begun since the one before."""
        state, sensor = self.state, scan.sensor
        began = state.began[sensor]
        state.tracked_ns[sensor] = scan.time_ns
        if not began:
            return scan
        # what could not be tracked yet is new to the tracker when it is
        there = {number for each in state.kept[sensor] for number in each.scan.object_id.tolist()}
        state.began[sensor] = sorted(set(began) & there - set(scan.object_id.tolist()))
        return replace(scan, new=np.isin(scan.object_id, np.array(began, dtype=scan.object_id.dtype)))

    def _interpolated(self, scans: Sequence[Scan], time_ns: int) -> Scan:
        """Return the objects of two or three scans at an instant between the last two of them."""
        last = scans[-1]
        row = _rows(scans)  # of each object of the last scan in each of them
        twice = row[-2] >= 0
        thrice = twice & (row[0] >= 0) if len(scans) == 3 else np.zeros_like(twice)
        times = np.array([(scan.time_ns - time_ns) * 1e-9 for scan in scans])
        samples = np.stack([_taken(scan.values, at) for scan, at in zip(scans, row, strict=True)]).transpose(2, 0, 1)
        if (angle := self._angle[last.sensor]) >= 0:  # never the long way round
            reference = samples[:, -1:, angle]
            samples[:, :, angle] = reference + np.remainder(samples[:, :, angle] - reference + np.pi, 2 * np.pi) - np.pi
        moving = self._moving[last.sensor]
        values = last.values.copy()
        for chosen, count in ((thrice, 3), (twice & ~thrice, 2)):
            if chosen.any():
                through = _through(times[-count:], samples[chosen][:, -count:, moving])
                known = np.isfinite(through)
                at = np.ix_(moving, np.flatnonzero(chosen))
                values[at] = np.where(known, through, values[at].T).T
        self._assemblers[last.sensor].counts.unaligned += int(np.count_nonzero(~twice))
        return replace(
            last,
            time_ns=time_ns,
            object_id=last.object_id[twice],
            slot=last.slot[twice],
            new=last.new[twice],
            values=values[:, twice],
        )


def _patience_ns(sensor: BoundSensor) -> int:
    """Return how long after a scan of one sensor those of another wait for the next."""
    return round((PATIENCE * sensor.settings.cycle_time + sensor.settings.timeout) * 1e9)


def _rows(scans: Sequence[Scan]) -> Indices:
    """Return the row of each object of the last scan in each scan, (scans, n); −1 where it was not, or was another."""
    wanted = scans[-1].object_id
    rows = np.stack([_row_of(wanted, scan.object_id) for scan in scans])
    for k in range(len(scans) - 1, 0, -1):
        rows[:k, (rows[k] < 0) | _taken(scans[k].new, rows[k])] = -1
    rows[-1] = np.arange(len(wanted))
    return rows


def _row_of(wanted: Integers, ids: Integers) -> Indices:
    """Return where each wanted id is among the ids; −1 where it is not, or twice."""
    if not len(ids):
        return np.full(len(wanted), -1, dtype=np.intp)
    known, first, counts = np.unique(ids, return_index=True, return_counts=True)
    at = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    return np.where((known[at] == wanted) & (counts[at] == 1), first[at], -1)


def _taken(values: NDArray[AnyT], at: Indices) -> NDArray[AnyT]:
    """Return columns; anything where there is none to be taken."""
    return values[..., at] if values.shape[-1] else np.zeros((*values.shape[:-1], len(at)), values.dtype)


def _through(times: Floats, samples: Floats) -> Floats:
    """Return the values at instant 0 of the parabola, or the line, through samples (n, 3 or 2, d), as (n, d).

    Samples that are equal give that value to the last bit: by that it shows that a sensor is frozen.

    Source: Gao et al. 2016, eq. (28), for three of them.
    """
    last = samples[:, -1]
    if len(times) == 3:
        n, apart = len(samples), samples - last[:, None]
        between: Floats = last + lagrange(np.broadcast_to(times, (n, 3)), apart, np.zeros(n), 0.0).value
    else:
        between = last + times[1] / (times[1] - times[0]) * (samples[:, 0] - last)
    return between


def make_alignments(binding: Binding, assemblers: Sequence[ScanAssembler]) -> dict[int, ScanAlignment]:
    """Return what aligns the scans of each sensor, by its index; of groups that ask for it alone.

    Args:
        binding: the configuration.
        assemblers: of the sensors.
    """
    found: dict[int, ScanAlignment] = {}
    for group in binding.settings.groups.values():
        if group.align == "lagrange":
            sensors = [sensor for sensor in binding.sensors if sensor.name in group.sensors]
            found.update(dict.fromkeys((each.index for each in sensors), ScanAlignment(sensors, assemblers)))
    return found
