"""The daemon's heart: frames and ticks in, obstacles and frames out.

It opens no socket, reads no clock and logs nothing per frame: the service and replay both call it, so that what
happened on the road happens again from its recording.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import count

from candaemon.binding.bound import Binding
from candaemon.binding.ego import EgoMessage
from candaemon.bus.frame import Frame, Tick, frames_at
from candaemon.cycle import BusCounts, Cycle, PipelineCounts
from candaemon.output.encoder import OutputEncoder, OutputStatus
from candaemon.sensing.assembly import NEVER, Receiver, Route, ScanAssembler
from candaemon.sensing.closing import make_assembler
from candaemon.sensing.detections import Detections
from candaemon.sensing.ego import EgoMotion
from candaemon.sensing.mounting import Mounting, View
from candaemon.sensing.placement import Placer
from candaemon.sensing.pose import EgoPose, EgoStatus
from candaemon.sensing.scan import Scan
from candaemon.sensing.sources import make_ego, make_placer
from candaemon.tracking.obstacles import Obstacles, joined, none
from candaemon.tracking.stationary import StationaryWatch
from candaemon.tracking.tracker import Tracker

_SILENT_CYCLES = 1.5
_LONGEST_COASTING_NS = 10_000_000_000
_LOST_AFTER_CYCLES = 5
_STARTING_NS = 1_000_000_000  # after the first frame or tick, until the status is told without a scan
_WORRIED_NS = 1_000_000_000


class Pipeline:
    """Decodes, tracks and encodes.

    Args:
        binding: the configuration, bound to its DBC files.
    """

    def __init__(self, binding: Binding) -> None:
        self.binding = binding
        self.counts = PipelineCounts(buses=[BusCounts() for _ in binding.buses])
        self.ego: EgoMotion = make_ego(binding.ego)
        self.placer = make_placer(binding.ego, self.ego)
        self._watch = StationaryWatch(self.ego.teaching) if self.ego.teaching is not None else None
        self.assemblers = [make_assembler(sensor) for sensor in binding.sensors]
        self._mountings = [Mounting(sensor.settings, sensor.reader.quantities) for sensor in binding.sensors]
        self.trackers, self._tracker_of = _make_trackers(binding)
        self._encoder = OutputEncoder(binding.output) if binding.output is not None else None
        self._routes = self._make_routes()
        self._cycle_ns = [round(sensor.settings.cycle_time * 1e9) for sensor in binding.sensors]
        self._last_scan_ns = [0] * len(binding.sensors)
        self._shortest_timeout_ns = min(round(sensor.settings.timeout * 1e9) for sensor in binding.sensors)
        self._coast_ns = min(self._cycle_ns)
        self._coast_due_ns = NEVER
        self._latency_ns = min(round(sensor.settings.latency * 1e9) for sensor in binding.sensors)
        self._drops = 0
        self._dropped_ns = -_WORRIED_NS
        self._deadline_ns = 0

    def run(self, items: Iterable[Frame | Tick]) -> Iterator[Cycle]:
        """Yield a cycle for each scan that the frames complete, and for each that should have come.

        Args:
            items: frames and ticks in order of time.
        """
        routes, counts = self._routes, self.counts.buses
        for item in items:
            if item[0] >= self._deadline_ns:
                yield from self.advance(item[0])
            if len(item) == 1:  # a tick
                continue
            time_ns, bus, can_id, data, _ = item
            if bus < 0:
                continue
            counts[bus].frames += 1
            route = routes[bus].get(can_id)
            if route is None:
                counts[bus].unknown += 1
                continue
            receive, part, slot = route
            scan = receive(part, slot, data, time_ns)
            if scan is not None:
                yield from self._cycle(scan, time_ns)
                self._set_deadline(time_ns)

    def advance(self, time_ns: int) -> Iterator[Cycle]:
        """Close the scans, and tell the coasting obstacles, that are due by a time."""
        if self._coast_due_ns == NEVER:
            self._coast_due_ns = time_ns + _STARTING_NS
        while True:
            assembler = min(self.assemblers, key=_deadline)
            if assembler.deadline_ns <= time_ns:
                closed_ns = assembler.deadline_ns
                scan = assembler.expire(closed_ns)
                if scan is not None:
                    yield from self._cycle(scan, closed_ns)
            elif assembler.deadline_ns == NEVER and self._coast_due_ns <= time_ns:
                yield self._coast(max(self._coast_due_ns, time_ns - _LONGEST_COASTING_NS))
            else:
                break
        self._set_deadline(time_ns)

    def finish(self) -> Iterator[Cycle]:
        """Close what is open, at the end of a log."""
        for assembler in sorted(self.assemblers, key=_deadline):
            closed_ns = assembler.deadline_ns
            scan = assembler.flush()
            if scan is not None:
                yield from self._cycle(scan, closed_ns)

    @property
    def drops(self) -> int:
        """Frames of sensors and own motion that were lost or could not be used so far."""
        scans = sum(assembler.counts.dropped + assembler.counts.missing for assembler in self.assemblers)
        return scans + self.counts.own_motion_short

    @property
    def saturated(self) -> int:
        """Output values that had to be brought into their signal's range."""
        return self._encoder.saturated if self._encoder is not None else 0

    def _set_deadline(self, time_ns: int) -> None:
        """Find the next instant at which something happens without a frame."""
        opening_ns = time_ns + self._shortest_timeout_ns  # a scan that opens from here on is due no sooner
        first_ns = min(each.deadline_ns for each in self.assemblers)
        # while a scan is open nothing coasts: it is about to tell where things are
        self._deadline_ns = min(opening_ns, self._coast_due_ns if first_ns == NEVER else first_ns)

    def _cycle(self, scan: Scan, now_ns: int) -> Iterator[Cycle]:
        """Scan → detections → tracks → obstacles → frames."""
        self._last_scan_ns[scan.sensor] = now_ns
        self._coast_due_ns = now_ns + int(_SILENT_CYCLES * self._coast_ns)
        pose = self.ego.pose(scan.time_ns)
        if pose is None:
            self.counts.without_ego += 1
            yield self._tell(none(scan.time_ns), _nowhere(scan.time_ns), now_ns, None, None)
            return
        detections = self._mountings[scan.sensor].detections(scan, pose)
        tracker = self._tracker_of[scan.sensor]
        obstacles = self._step(tracker, detections, pose)
        yield self._tell(obstacles, pose, now_ns, detections, tracker)
        if self._watch is not None:
            returns = self._watch.returns(detections, tracker, obstacles, pose)
            if returns is not None:
                self.ego.learn(returns)

    def _coast(self, now_ns: int) -> Cycle:
        """Tell where the obstacles should be, every sensor being silent."""
        self._coast_due_ns = now_ns + self._coast_ns
        self.counts.coasting_cycles += 1
        time_ns = now_ns - self._latency_ns
        pose = self.ego.pose(time_ns)
        if pose is None:
            return self._tell(none(time_ns), _nowhere(time_ns), now_ns, None, None)
        return self._tell(self._step(None, None, pose), pose, now_ns, None, None)

    def _step(self, tracker: Tracker | None, detections: Detections | None, pose: EgoPose) -> Obstacles:
        """Advance every group to the pose, the one tracker with detections."""
        told = [each.step(detections if each is tracker else None, pose) for each in self.trackers]
        return told[0] if len(told) == 1 else joined(told)

    def _tell(
        self, obstacles: Obstacles, pose: EgoPose, now_ns: int, detections: Detections | None, tracker: Tracker | None
    ) -> Cycle:
        """Encode a cycle's obstacles and count it."""
        self.counts.cycles += 1
        frames: list[Frame] = []
        placement = self.placer.at(obstacles.time_ns) if self.placer is not None else None
        output = self.binding.output
        if self._encoder is not None and output is not None:
            status = OutputStatus(ego=int(pose.status), health=self._health(pose, now_ns), drops=self.drops)
            payloads = self._encoder.encode(obstacles, status, pose, placement)
            frames = frames_at(now_ns, output.bus, payloads, output.fd_ids)
        self.counts.sent += len(frames)
        return Cycle(now_ns, obstacles, frames, pose, detections, tracker, placement)

    def _health(self, pose: EgoPose, now_ns: int) -> int:
        """Return 0 ok, 1 degraded (own motion is not valid, or frames were lost of late), 2 a sensor is lost."""
        drops = self.drops
        if drops > self._drops:
            self._drops, self._dropped_ns = drops, now_ns
        for last_ns, cycle_ns in zip(self._last_scan_ns, self._cycle_ns, strict=True):
            if now_ns - last_ns > _LOST_AFTER_CYCLES * cycle_ns:
                return 2
        return int(pose.status is not EgoStatus.VALID or now_ns - self._dropped_ns < _WORRIED_NS)

    def _make_routes(self) -> list[dict[int, Route]]:
        """Return for each bus who receives an identifier: a sensor, own motion, or a counter of the rest."""
        routes: list[dict[int, Route]] = [{} for _ in self.binding.buses]
        for bus in self.binding.buses:
            for database in bus.databases:
                for can_id, message in database.by_id.items():
                    routes[bus.index][can_id] = (_spare(message.length, self.counts.buses[bus.index]), 0, 0)
        ego = self.binding.ego
        if ego is not None:
            takers: list[EgoMotion | Placer] = [self.ego]
            if self.placer is not None:
                takers.append(self.placer)
            for can_id, own in ego.messages.items():
                routes[ego.bus][can_id] = (_own_motion(own, takers, self.counts, ego.bus), 0, 0)
        for sensor, assembler in zip(self.binding.sensors, self.assemblers, strict=True):
            routes[sensor.bus].update(assembler.routes)
        return routes


def _nowhere(time_ns: int) -> EgoPose:
    """Return the pose of a vehicle that knows nothing of its motion."""
    return EgoPose(time_ns, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, EgoStatus.LOST)


def _deadline(assembler: ScanAssembler) -> int:
    return assembler.deadline_ns


def _spare(length: int, counts: BusCounts) -> Receiver:
    """Count the frames of a message that nothing asks for."""

    def receive(_part: int, _slot: int, data: bytes, _time_ns: int) -> None:
        if len(data) < length:
            counts.short += 1
        else:
            counts.spare += 1

    return receive


def _own_motion(own: EgoMessage, takers: Sequence[EgoMotion | Placer], counts: PipelineCounts, bus: int) -> Receiver:
    """Give a message's quantities to own motion, and to what places it on earth."""
    decode, names, length = own.decode, own.quantities, own.message.length
    updates = [taker.update for taker in takers if not taker.wanted.isdisjoint(names)]

    def receive(_part: int, _slot: int, data: bytes, time_ns: int) -> None:
        values = decode(data) if updates else ()
        if values is None or len(data) < length:
            counts.own_motion_short += 1
            counts.buses[bus].short += 1
            return
        for update in updates:
            update(time_ns, names, values)

    return receive


def _make_trackers(binding: Binding) -> tuple[list[Tracker], list[Tracker]]:
    """Return the trackers, and for each sensor the one of its group; identities are unique across them."""
    ids = count(1)
    config = binding.settings
    groups = [(group.tracker, frozenset(group.sensors)) for group in config.groups.values()]
    grouped = frozenset[str]().union(*(names for _, names in groups))
    rest = frozenset(sensor.name for sensor in binding.sensors) - grouped
    if rest:
        groups.insert(0, (config.tracker, rest))
    trackers = []
    tracker_of: dict[str, Tracker] = {}
    for settings, names in groups:
        cycles = [sensor.settings.cycle_time for sensor in binding.sensors if sensor.name in names]
        slack_ns = round(1.5 * max(cycles) * 1e9) if len(binding.sensors) > 1 else 0
        views = [
            View(sensor.settings.mount, sensor.settings.field_of_view)
            for sensor in binding.sensors
            if sensor.name in names
        ]
        tracker = Tracker(settings, ids, cycle_time=max(cycles), slack_ns=slack_ns, views=views)
        trackers.append(tracker)
        tracker_of.update(dict.fromkeys(names, tracker))
    return trackers, [tracker_of[sensor.name] for sensor in binding.sensors]
