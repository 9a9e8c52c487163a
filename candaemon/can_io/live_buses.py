"""Live buses, all in the thread that calls: read, sent to, and opened again without end.

Reading waits on the descriptors of all buses at once. A bus that goes away is opened again in the background; until
then what is sent to it counts as `send_failed`. A failed bus ends nothing here; its state and its counts report it.
"""

from __future__ import annotations

import logging
import time
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import inf
from operator import itemgetter
from selectors import DefaultSelector, SelectorKey
from types import TracebackType
from typing import Self

from candaemon.can_io.live_bus import LiveBus
from candaemon.can_io.port import PortCounts, PortRequest
from candaemon.config.buses import BusSettings
from candaemon.errors import BusError
from candaemon.frames.frame import Frame

logger = logging.getLogger(__name__)

READ_LIMIT = 256
"""Frames of one bus in one reading, more or less: no flood on one bus keeps the others waiting."""

_DRAIN_S = 0.001
_time_of = itemgetter(0)


class LiveBuses:
    """All buses of a configuration. A context manager: leaving it closes them.

    Args:
        buses: settings by name; the order gives the indices that frames carry.
        clock: gives nanoseconds, for `BusState.since_ns`.
        ids: identifiers wanted of a bus, with `EXTENDED`, by its name; all of a bus that it leaves out. An interface
            that can filter spares the others, so that they are not even counted.
        rates: frames/s expected of a bus, by its name; a full bus where it is left out.
    """

    def __init__(
        self,
        buses: Mapping[str, BusSettings],
        *,
        clock: Callable[[], int],
        ids: Mapping[str, Collection[int]] | None = None,
        rates: Mapping[str, float] | None = None,
    ) -> None:
        self._clock = clock
        self._selector = DefaultSelector()
        self._held: list[Frame] = []
        self._ahead: set[int] = set()
        self._read_s = -inf
        self._buses = tuple(self._bus(request) for request in _requests(buses, ids or {}, rates or {}))

    def __getitem__(self, index: int) -> LiveBus:
        return self._buses[index]

    def __len__(self) -> int:
        return len(self._buses)

    def __iter__(self) -> Iterator[LiveBus]:
        return iter(self._buses)

    def open(self, *, strict: bool = True) -> None:
        """Try to open every bus.

        Args:
            strict: whether a bus that cannot be opened is an error; otherwise it is tried again in the background.

        Raises:
            BusError: strict, and a bus cannot be opened; none is left open then.
        """
        for bus in self._buses:
            try:
                bus.open(time.monotonic())
            except BusError as error:
                if strict:
                    self.close()
                    raise
                logger.warning("%s. It is tried again until it opens", error)

    def read(self, timeout_s: float, coalescing_s: float = 0.0) -> list[Frame]:
        """Wait up to `timeout_s` s for frames; return those that have come, ordered by time.

        All else that is due is done meanwhile: what waits is sent, what is gone is opened again.

        Args:
            timeout_s: how long to wait.
            coalescing_s: s from when frames were read last for which what comes waits, to be read together: to wake up
                costs more than to read some frames.
        """
        now_s = time.monotonic()
        end_s = now_s + timeout_s
        coalesced_s = min(self._read_s + coalescing_s, end_s)
        while True:
            due_s = self._tend(now_s)
            until_s = now_s if self._held else min(end_s, due_s)
            if now_s < coalesced_s and not self._held:
                time.sleep(max(min(coalesced_s, until_s) - now_s, 0.0))
                now_s = time.monotonic()
                continue
            ready = self._selector.select(max(until_s - now_s, 0.0))
            now_s = time.monotonic()
            frames = self._receive(ready, now_s) if ready or self._held else []
            if frames:
                self._read_s = now_s
            if frames or now_s >= end_s:
                return frames

    def send(self, bus: int, frames: Sequence[Frame]) -> int:
        """Send frames on the bus of that index, without waiting.

        What finds no room waits, and is tried again while buses are read. It is dropped for newer frames of the same
        identifiers, or once it has waited for the bus's `send_timeout`.

        Returns:
            how many frames, these or those that waited before them, went out at once.
        """
        return self._buses[bus].send(frames, time.monotonic())

    def drain(self, timeout_s: float) -> bool:
        """Wait up to `timeout_s` s for what waits to be sent; return whether all of it was sent or given up."""
        end_s = time.monotonic() + timeout_s
        while (now_s := time.monotonic()) < end_s and any(bus.waiting for bus in self._buses):
            for bus in self._buses:
                bus.tend(now_s)
            time.sleep(_DRAIN_S)
        return not any(bus.waiting for bus in self._buses)

    def change(
        self,
        buses: Mapping[str, BusSettings],
        *,
        ids: Mapping[str, Collection[int]] | None = None,
        rates: Mapping[str, float] | None = None,
    ) -> None:
        """Take the buses of another configuration: those that are alike stay open, the others open in the background.

        Counts go on where the name stays, and so does what has come and was not read yet.

        Args:
            buses: as for the constructor.
            ids: likewise.
            rates: likewise.
        """
        names = [bus.name for bus in self._buses]
        before = dict(zip(names, self._buses, strict=True))
        kept = []
        for request in _requests(buses, ids or {}, rates or {}):
            old = before.get(request.name)
            if old is not None:
                request = replace(request, counts=old.counts)
                if request == old.request:
                    kept.append(before.pop(request.name))
                    continue
            kept.append(self._bus(request))
        for bus in before.values():
            self._held += bus.leave()
        index = {bus.name: bus.index for bus in kept}
        self._give_up([frame for frame in self._held if names[frame.bus] not in index])
        self._held = [frame._replace(bus=index[names[frame.bus]]) for frame in self._held if names[frame.bus] in index]
        self._buses = tuple(kept)
        self._ahead.clear()

    def close(self) -> None:
        """Close every bus; takes 0.2 s for one whose driver does not come back. What nobody has read is counted."""
        for bus in self._buses:
            bus.close()
        self._give_up(self._held)
        self._held = []
        self._ahead.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _bus(self, request: PortRequest) -> LiveBus:
        return LiveBus(request, self._clock, self._selector)

    def _give_up(self, frames: Iterable[Frame]) -> None:
        """Count frames as unread that were received and held back, and that nobody will get."""
        for frame in frames:
            counts = self._buses[frame.bus].counts
            counts.received -= 1
            counts.unread += 1

    def _tend(self, now_s: float) -> float:
        """Do what is due on every bus; return when something is due next."""
        next_s = inf
        for bus in self._buses:
            if bus.due_s <= now_s:
                self._held += bus.tend(now_s)
            next_s = min(next_s, bus.due_s)
        return next_s

    def _receive(self, ready: Iterable[tuple[SelectorKey, int]], now_s: float) -> list[Frame]:
        """Return what has come, in order of time.

        A bus that gave all that it may in one reading has more, and older than what others have given: theirs is held
        back behind its last frame, and they are not read before it has caught up. What they have yet to give may be
        older than what it gives beyond their last frame: that is held back likewise.
        """
        frames, self._held = self._held, []
        last_ns = {frame.bus: frame.time_ns for frame in frames}
        behind = []
        for key, _ in ready:
            bus: LiveBus = key.data
            if bus.index in self._ahead:
                behind.append(last_ns[bus.index])
                continue
            come = bus.receive(READ_LIMIT, now_s)
            frames += come
            if len(come) >= READ_LIMIT:
                behind.append(come[-1].time_ns)
        frames.sort(key=_time_of)
        self._ahead.clear()
        if behind:
            known = bisect_right(frames, min(behind), key=_time_of)
            frames, self._held = frames[:known], frames[known:]
            self._ahead.update(frame.bus for frame in self._held)
        return frames


def _requests(
    buses: Mapping[str, BusSettings], ids: Mapping[str, Collection[int]], rates: Mapping[str, float]
) -> Iterator[PortRequest]:
    """Yield what each bus is opened from."""
    for index, (name, settings) in enumerate(buses.items()):
        yield PortRequest(name, index, settings, PortCounts(), ids.get(name), rates.get(name))
