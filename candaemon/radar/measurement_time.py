"""When a scan was measured, by the sensor's own time stamps: an age, or a clock that runs free and wraps.

An age is taken from the arrival of the frame that carries it. A clock's offset and drift against the frames' time are
not known; no frame comes before it was measured, so the frames that were delayed least show them. The line below the
delays of a minute, as near to them as can be, is the clock (Moon, Skelly & Towsley 1999, "Estimation and removal of
clock skew from network delay measurements"): what is above it, a frame was delayed more than the fastest. What the
fastest is delayed, no clock tells; the setting `latency` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

from candaemon.config.sensors import TimeStampSettings
from candaemon.frames.times import LONG_AGO_NS
from candaemon.objects.scan_messages import TimeStampField
from candaemon.radar.scan import ScanCounts

BLOCK_NS: Final = 1_000_000_000
"""ns of which the least delay is one point of the clock's line."""
MOST_BLOCKS: Final = 64
"""Points of the line: a minute."""
LEAST_BLOCKS: Final = 8
"""Points from which on the line may have a slope."""
LARGEST_DRIFT: Final = 1e-3
"""By which a clock may run fast or slow; a steeper line is one of changing delays."""
RESTART: Final = 5
"""Stamps in a row that cannot be, after which the clock was set."""


@dataclass(slots=True)
class TimeStampState:
    """What is remembered of a sensor's time stamps between two frames.

    Attributes:
        stamp_ns: age or clock of the open scan, or of the next one; None where none came.
        came_ns: when it came.
        next_ns: a stamp that came while a scan was open and is of the next one; None where none did.
        next_came_ns: when that came.
        measured_ns: measurement time of the last scan that had a stamp.
        usual_ns: from there to that scan's arrival, on average.
        clock_ns: the clock's last reading; None before the first.
        read_ns: when that came.
        delay_ns: its delay, relative to that of the first reading.
        refused: readings in a row that could not be.
        block_ns: when the running block began.
        least_ns: least delay in it.
        least_at_ns: when that came.
        times, delays: of the blocks before: when the reading of the least delay came, and that delay.
        line_at_ns, line_ns, drift: the line through the least delays: its delay at a time, and its slope.
    """

    stamp_ns: int | None = None
    came_ns: int = 0
    next_ns: int | None = None
    next_came_ns: int = 0
    measured_ns: int = LONG_AGO_NS
    usual_ns: int = 0
    clock_ns: int | None = None
    read_ns: int = 0
    delay_ns: int = 0
    refused: int = 0
    block_ns: int = 0
    least_ns: int = 0
    least_at_ns: int = 0
    times: list[int] = field(default_factory=list)
    delays: list[int] = field(default_factory=list)
    line_at_ns: int = 0
    line_ns: int = 0
    drift: float = 0.0

    def validate(self) -> None:
        """Refuse what no reader of time stamps comes to.

        Raises:
            ValueError: it is that.
        """
        if not len(self.times) == len(self.delays) <= MOST_BLOCKS:
            raise ValueError(f"{len(self.times)} times and {len(self.delays)} delays of a clock")
        if not abs(self.drift) <= LARGEST_DRIFT:
            raise ValueError(f"a clock that drifts by {self.drift:g}")


class MeasurementTime:
    """Gives the instants of a sensor's scans by its time stamps.

    Args:
        settings: of the time stamps.
        stamp: what reads them.
        cycle_ns: ns between scans.
        counts: where stamps that are missing or cannot be are counted; the owner's.

    Attributes:
        stamp: as given.
        counts: as given.
        state: what it remembers.
    """

    def __init__(self, settings: TimeStampSettings, stamp: TimeStampField, cycle_ns: int, counts: ScanCounts) -> None:
        self.stamp, self.counts = stamp, counts
        self.state = TimeStampState()
        self._is_clock = settings.kind == "clock"
        self._longest_ns = round(settings.longest * 1e9)
        self._half_cycle_ns = cycle_ns // 2

    def take(self, data: bytes, time_ns: int) -> None:
        """Take the stamp from a frame of its message."""
        self.state.stamp_ns, self.state.came_ns = self.stamp.stamp_ns(data), time_ns

    def take_alone(self, data: bytes, time_ns: int, open_ns: int | None) -> None:
        """Take the stamp from a message of its own: half a cycle after the open scan's first frame, of the next scan.

        Args:
            data: its payload.
            time_ns: when it came.
            open_ns: when the first frame of the open scan came; None where none is open.
        """
        if open_ns is None or time_ns < open_ns + self._half_cycle_ns:
            self.take(data, time_ns)
        else:
            self.state.next_ns, self.state.next_came_ns = self.stamp.stamp_ns(data), time_ns

    def begin_next(self) -> None:
        """Close a scan: the stamp that came was its own."""
        state = self.state
        state.stamp_ns, state.came_ns, state.next_ns = state.next_ns, state.next_came_ns, None

    def measured_ns(self, first_ns: int, arrival_ns: int) -> int:
        """Return when a scan was measured; where its stamp does not tell, its arrival less the usual delay.

        Args:
            first_ns: when its first frame came.
            arrival_ns: when it arrived: its first frame, or its last one, less the latency.
        """
        state = self.state
        if state.stamp_ns is None or state.came_ns < first_ns - self._half_cycle_ns:
            self.counts.unstamped += 1
            return arrival_ns - state.usual_ns
        delay_ns = self._clock_delay(state.stamp_ns, state.came_ns) if self._is_clock else state.stamp_ns
        if delay_ns is None or not 0 <= delay_ns <= self._longest_ns or state.came_ns - delay_ns <= state.measured_ns:
            self.counts.odd_stamps += 1
            return arrival_ns - state.usual_ns
        measured_ns = state.came_ns - delay_ns
        is_first = state.measured_ns == LONG_AGO_NS
        late_ns = max(0, min(arrival_ns - measured_ns, self._longest_ns))
        state.usual_ns = late_ns if is_first else state.usual_ns + (late_ns - state.usual_ns) // 8
        state.measured_ns = measured_ns
        return measured_ns

    def _clock_delay(self, clock_ns: int, came_ns: int) -> int | None:
        """Return by how much longer a reading took to come than the fastest; None where it cannot be."""
        state = self.state
        if state.clock_ns is None or came_ns - state.read_ns > MOST_BLOCKS * BLOCK_NS:
            return self._begin(clock_ns, came_ns)
        wrap_ns = self.stamp.wrap_ns
        later_ns = came_ns - state.read_ns - (clock_ns - state.clock_ns)
        state.delay_ns += (later_ns + wrap_ns // 2) % wrap_ns - wrap_ns // 2
        state.clock_ns, state.read_ns = clock_ns, came_ns
        delay_ns = state.delay_ns
        if abs(delay_ns - self._fastest(came_ns)) > self._longest_ns:
            state.refused += 1
            return self._begin(clock_ns, came_ns) if state.refused >= RESTART else None
        state.refused = 0
        if came_ns >= state.block_ns + BLOCK_NS:
            self._end_block()
            state.block_ns, state.least_ns, state.least_at_ns = came_ns, delay_ns, came_ns
        elif delay_ns < state.least_ns:
            state.least_ns, state.least_at_ns = delay_ns, came_ns
        return delay_ns - self._fastest(came_ns)

    def _begin(self, clock_ns: int, came_ns: int) -> int:
        """Begin anew with a reading, the fastest so far."""
        state = self.state
        state.clock_ns, state.read_ns, state.delay_ns, state.refused = clock_ns, came_ns, 0, 0
        state.block_ns, state.least_ns, state.least_at_ns = came_ns, 0, came_ns
        state.times, state.delays = [], []
        return 0

    def _fastest(self, came_ns: int) -> int:
        """Return the delay of the fastest reading that comes at a time."""
        state = self.state
        if not state.times:
            return state.least_ns
        return min(state.least_ns, state.line_ns + round(state.drift * (came_ns - state.line_at_ns)))

    def _end_block(self) -> None:
        """Add the running block to the line."""
        state = self.state
        state.times.append(state.least_at_ns)
        state.delays.append(state.least_ns)
        del state.times[:-MOST_BLOCKS], state.delays[:-MOST_BLOCKS]
        state.line_at_ns, state.line_ns, state.drift = line_below(state.times, state.delays)


def line_below(times: Sequence[int], delays: Sequence[int]) -> tuple[int, int, float]:
    """Return the line that no delay lies below and that is as near to them as can be on average.

    It is the edge of their lower convex hull below the mean time. It is level where the points are too few to show a
    slope, or show one that no clock has.

    Args:
        times: ns, ascending (n,).
        delays: ns (n,).

    Returns:
        A time of the line, its delay there, and its slope.
    """
    level = times[-1], min(delays), 0.0
    if len(times) < LEAST_BLOCKS:
        return level
    hull: list[tuple[int, int]] = []
    for point in zip(times, delays, strict=True):
        while len(hull) > 1 and _is_above(hull[-1], hull[-2], point):
            hull.pop()
        hull.append(point)
    middle = sum(times) // len(times)
    (begin, low), (end, high) = next(edge for edge in pairwise(hull) if edge[1][0] >= middle)
    drift = (high - low) / (end - begin)
    return (begin, low, drift) if abs(drift) <= LARGEST_DRIFT else level


def _is_above(point: tuple[int, int], one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return whether a point lies on or above the line of two others."""
    return (point[1] - one[1]) * (other[0] - one[0]) >= (other[1] - one[1]) * (point[0] - one[0])
