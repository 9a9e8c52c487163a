"""The daemon's heart: frames and ticks in, obstacles and frames out.

It opens no socket, reads no clock and logs nothing per frame: the service and replay both call it, so that what
happened on the road happens again from its recording.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from candaemon.binding.bound import Binding, BoundEgo, BoundSensor, EgoMessage
from candaemon.ego.factory import make_ego, make_placer
from candaemon.ego.georeference import Georeferencer
from candaemon.ego.motion import EgoMotion
from candaemon.ego.motion_plausibility import MotionPlausibility
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.frames.batch import FrameBatch
from candaemon.frames.block import FrameBlock
from candaemon.frames.frame import Frame, Tick
from candaemon.frames.times import NEVER_NS
from candaemon.output.encoder import OutputEncoder, OutputStatus
from candaemon.pipeline.cycle import BusCounts, Cycle, PipelineCounts
from candaemon.protection.monitor import FrameGuard
from candaemon.radar.assembly import FrameHandler, Route, ScanAssembler, make_assembler
from candaemon.radar.block_routing import BlockRouter
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import Mounting
from candaemon.radar.scan import Scan
from candaemon.tracking.groups import make_trackers
from candaemon.tracking.obstacles import Obstacles, joined, none
from candaemon.tracking.stationary import StationaryWatch
from candaemon.tracking.tracker import Tracker


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
        self.trackers, self._tracker_of = make_trackers(
            binding.settings, {sensor.name: sensor.settings for sensor in binding.sensors}
        )
        self._encoder = OutputEncoder(binding.output) if binding.output is not None else None
        self._routes = self._make_routes()
        supervision = binding.settings.supervision
        self._lost_after_ns = [round(binding.patience(sensor) * 1e9) for sensor in binding.sensors]
        self._last_scan_ns = [0] * len(binding.sensors)
        self._shortest_timeout_ns = min(round(sensor.settings.timeout * 1e9) for sensor in binding.sensors)
        self._coast_ns = min(round(sensor.settings.cycle_time * 1e9) for sensor in binding.sensors)
        self._coast_after_ns = int(supervision.coast_after * self._coast_ns)
        self._longest_coasting_ns = round(supervision.longest_coasting * 1e9)
        self._grace_ns = round(supervision.grace * 1e9)
        self._coast_due_ns = NEVER_NS
        self._latency_ns = min(round(sensor.settings.latency * 1e9) for sensor in binding.sensors)
        self._worry_ns = round(supervision.worry * 1e9)
        self._drops = 0
        self._dropped_ns = -self._worry_ns
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

    def run_blocks(self, blocks: Iterable[FrameBlock | Sequence[Frame | Tick]]) -> Iterator[Cycle]:
        """As `run`, for a log: what came whole in a block is taken together.

        Args:
            blocks: frames and ticks in order of time.
        """
        router, counts = BlockRouter(self._routes, self.binding.sensors, self.assemblers), self.counts.buses
        for block in blocks:
            if not isinstance(block, FrameBlock):
                yield from self.run(block)
                continue
            events, frames, unknown = router.routed(block)
            for bus, count in enumerate(counts):
                count.frames += frames[bus]
                count.unknown += unknown[bus]
            for time_ns, receive, part, slot, data in events:
                if time_ns >= self._deadline_ns:
                    yield from self.advance(time_ns)
                scan = receive(part, slot, data, time_ns)
                if scan is not None:
                    yield from self._cycle(scan, time_ns)
                    self._set_deadline(time_ns)

    def advance(self, time_ns: int) -> Iterator[Cycle]:
        """Close the scans, and tell the coasting obstacles, that are due by a time."""
        if self._coast_due_ns == NEVER_NS:
            self._coast_due_ns = time_ns + self._grace_ns
        while True:
            assembler = min(self.assemblers, key=_deadline)
            if assembler.deadline_ns <= time_ns:
                closed_ns = assembler.deadline_ns
                scan = assembler.expire(closed_ns)
                if scan is not None:
                    yield from self._cycle(scan, closed_ns)
            elif assembler.deadline_ns == NEVER_NS and self._coast_due_ns <= time_ns:
                yield self._coast(max(self._coast_due_ns, time_ns - self._longest_coasting_ns))
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
        return scans + self.counts.own_motion_short + self.counts.own_motion.refused

    @property
    def saturated(self) -> int:
        """Output values that had to be brought into their signal's range."""
        return self._encoder.saturated if self._encoder is not None else 0

    def _set_deadline(self, time_ns: int) -> None:
        """Find the next instant at which something happens without a frame."""
        opening_ns = time_ns + self._shortest_timeout_ns  # a scan that opens from here on is due no sooner
        first_ns = min(each.deadline_ns for each in self.assemblers)
        # while a scan is open nothing coasts: it is about to tell where things are
        self._deadline_ns = min(opening_ns, self._coast_due_ns if first_ns == NEVER_NS else first_ns)

    def _cycle(self, scan: Scan, now_ns: int) -> Iterator[Cycle]:
        """Scan → detections → tracks → obstacles → frames."""
        self._last_scan_ns[scan.sensor] = now_ns
        self._coast_due_ns = now_ns + self._coast_after_ns
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
        frames: Sequence[Frame] = ()
        placement = self.placer.at(obstacles.time_ns) if self.placer is not None else None
        output = self.binding.output
        if self._encoder is not None and output is not None:
            status = OutputStatus()
            if output.status is not None:
                drops = self.drops
                status = OutputStatus(ego=int(pose.status), health=self._health(pose, now_ns, drops), drops=drops)
            payloads = self._encoder.encode(obstacles, status, pose, placement)
            frames = FrameBatch(now_ns, output.bus, payloads, output.fd_ids)
        self.counts.sent += len(frames)
        return Cycle(now_ns, obstacles, frames, pose, detections, tracker, placement)

    def _health(self, pose: EgoPose, now_ns: int, drops: int) -> int:
        """Return 0 ok, 1 degraded (own motion is reckoned, or frames were lost of late), 2 a sensor is lost, 3 fault.

        Without own motion, or without any sensor, obstacles are not to be relied on.
        """
        if drops > self._drops:
            self._drops, self._dropped_ns = drops, now_ns
        lost = [self._is_lost(sensor, now_ns) for sensor in self.binding.sensors]
        if all(lost) or pose.status is EgoStatus.LOST:
            return 3
        if any(lost):
            return 2
        return int(pose.status is EgoStatus.DEAD_RECKONING or now_ns - self._dropped_ns < self._worry_ns)

    def _is_lost(self, sensor: BoundSensor, now_ns: int) -> bool:
        """Tell whether a sensor is silent, or most of what it sends fails."""
        silent_ns = now_ns - self._last_scan_ns[sensor.index]
        if silent_ns > self._lost_after_ns[sensor.index]:
            return True
        return self.assemblers[sensor.index].trust < sensor.settings.protection.least_trust

    def _make_routes(self) -> list[dict[int, Route]]:
        """Return for each bus who receives an identifier: a sensor, own motion, or a counter of the rest."""
        routes: list[dict[int, Route]] = [{} for _ in self.binding.buses]
        for bus in self.binding.buses:
            for database in bus.databases:
                for can_id, message in database.by_id.items():
                    routes[bus.index][can_id] = (_spare(message.length, self.counts.buses[bus.index]), 0, 0)
        ego = self.binding.ego
        if ego is not None:
            takers: list[EgoMotion | Georeferencer] = [self.ego]
            if self.placer is not None:
                takers.append(self.placer)
            for can_id, own in ego.messages.items():
                routes[ego.bus][can_id] = (_own_motion(own, ego, takers, self.counts), 0, 0)
        for sensor, assembler in zip(self.binding.sensors, self.assemblers, strict=True):
            routes[sensor.bus].update(assembler.routes)
        return routes


def _nowhere(time_ns: int) -> EgoPose:
    """Return the pose of a vehicle that knows nothing of its motion."""
    return EgoPose(time_ns, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, EgoStatus.LOST)


def _deadline(assembler: ScanAssembler) -> int:
    return assembler.deadline_ns


def _spare(length: int, counts: BusCounts) -> FrameHandler:
    """Count the frames of a message that nothing asks for."""

    def receive(_part: int, _slot: int, data: bytes, _time_ns: int) -> None:
        if len(data) < length:
            counts.short += 1
        else:
            counts.spare += 1

    return receive


def _own_motion(
    own: EgoMessage, ego: BoundEgo, takers: Sequence[EgoMotion | Georeferencer], counts: PipelineCounts
) -> FrameHandler:
    """Give a message's quantities, where they can be true, to own motion and to what places it on earth."""
    decode, names, length, can_id = own.decode, own.quantities, own.message.length, own.message.can_id
    guard = None if own.guard is None else FrameGuard(own.guard, counts.own_motion)
    plausible = MotionPlausibility(own, ego.settings.plausibility, counts.own_motion)
    updates = [taker.update for taker in takers if not taker.wanted.isdisjoint(names)]

    def receive(_part: int, _slot: int, data: bytes, time_ns: int) -> None:
        values = decode(data) if updates else ()
        if values is None or len(data) < length:
            counts.own_motion_short += 1
            counts.buses[ego.bus].short += 1
            return
        if guard is not None and not guard.admits(can_id, data, time_ns):
            return
        if updates and not plausible.admits(time_ns, values):
            return
        for update in updates:
            update(time_ns, names, values)

    return receive
