"""The way of a frame: scans, ego motion, detections, tracks, obstacles, frames out.

It opens no socket, reads no clock and logs nothing per frame: the service and replay both call it, so that what
happened on the road happens again from its recording.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from candaemon.binding.bound import Binding, BoundSensor
from candaemon.binding.bus_load import Traffic, frame_time
from candaemon.calibration.calibrator import Calibrator
from candaemon.ego.factory import make_ego, make_georeferencer
from candaemon.ego.georeference import Georeferencer
from candaemon.ego.ins import InsMotion
from candaemon.ego.motion import EgoMotion
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.frames.frame import EXTENDED, Frame, Tick
from candaemon.frames.frame_batch import FrameBatch
from candaemon.frames.frame_block import FrameBlock
from candaemon.frames.times import NEVER_NS
from candaemon.output.encoder import OutputEncoder, OutputStatus
from candaemon.pipeline.cycle import BusCounts, Cycle, PipelineCounts
from candaemon.pipeline.ego_frames import EgoFrames, SteadyFrames
from candaemon.pipeline.health import HealthMonitor
from candaemon.pipeline.output_cycle import OutputCycle
from candaemon.pipeline.pipeline_state import PipelineState, Schedule
from candaemon.pipeline.scan_alignment import ScanAlignment, make_alignments
from candaemon.pipeline.spare_frames import SpareFrames
from candaemon.radar.assembler_factory import make_assembler
from candaemon.radar.assembly import ScanAssembler
from candaemon.radar.block_routing import BlockRouter, Succession
from candaemon.radar.claimed_frames import ClaimedFrames, ClaimedRoute, Route
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import Mounting
from candaemon.radar.scan import Scan
from candaemon.tracking.any_tracker import AnyTracker
from candaemon.tracking.groups import TrackerGroups
from candaemon.tracking.obstacles import Obstacles, concatenated, no_obstacles
from candaemon.tracking.sensor_trust import SensorTrust
from candaemon.tracking.stationary import StationaryWatch
from candaemon.tracking.tracker import Tracker
from candaemon.tracking.vehicle_tracker import VehicleTracker

_NO_STATUS: Final = OutputStatus()


class Pipeline:
    """Decodes, tracks and encodes.

    Args:
        binding: the configuration, bound to its DBC files.
    """

    def __init__(self, binding: Binding) -> None:
        self.binding = binding
        self._counts = PipelineCounts(buses=[BusCounts() for _ in binding.buses])
        # frames → scans
        self.assemblers = [make_assembler(sensor) for sensor in binding.sensors]
        # frames → ego motion
        self.ego = make_ego(binding.ego)
        self.georeferencer = make_georeferencer(binding.ego, self.ego)
        self.ego_frames = self._make_ego_frames()
        # scans → scans of one instant, where a group asks for it
        self._alignment_of = make_alignments(binding, self.assemblers)
        self.alignments = list(dict.fromkeys(self._alignment_of.values()))
        # scans → detections → tracks
        self.mountings = [
            Mounting(sensor.settings, sensor.reader.quantities, sensor.reader.longest) for sensor in binding.sensors
        ]
        self.tracker_groups = TrackerGroups(
            binding.settings, {sensor.name: sensor.settings for sensor in binding.sensors}
        )
        self._ranging = {sensor.index for sensor in binding.sensors if not sensor.settings.signals.directed}
        self.trackers, self._tracker_of = self.tracker_groups.trackers, self.tracker_groups.by_sensor
        self.trust = SensorTrust(
            binding.settings.trust,
            [sensor.settings for sensor in binding.sensors],
            self.tracker_groups.others,
            [self._judged_after(sensor) for sensor in binding.sensors],
        )
        self.stationary = self._make_stationary_watch()
        # detections of what stands → latency and yaw of the sensors, errors of ego motion
        self.calibrator = self._make_calibrator()
        self._corrects = self.calibrator is not None and self.calibrator.settings.apply
        # obstacles → frames
        self.output_cycle = OutputCycle(binding.settings)
        self.encoder = OutputEncoder(binding.output) if binding.output is not None else None
        self.health = HealthMonitor(binding)
        # what happens without a frame
        supervision = binding.settings.supervision
        self.schedule = Schedule()
        self._shortest_timeout_ns = min(round(sensor.settings.timeout * 1e9) for sensor in binding.sensors)
        fastest_ns = min(round(sensor.settings.cycle_time * 1e9) for sensor in binding.sensors)
        self._coast_ns = max(fastest_ns, round(binding.settings.output_cycle_time * 1e9))
        self._coast_after_ns = int(supervision.coast_after * fastest_ns)
        self._longest_coasting_ns = round(supervision.longest_coasting * 1e9)
        self._startup_ns = round(supervision.grace * 1e9)
        self._latency_ns = min(round(sensor.settings.latency * 1e9) for sensor in binding.sensors)
        self._routes = self._make_routes()
        self._classic = frozenset(bus.index for bus in binding.buses if not bus.settings.fd)
        self._frame_ns = [_least_frame_ns(binding, sensor) for sensor in binding.sensors]

    def run(self, items: Iterable[Frame | Tick]) -> Iterator[Cycle]:
        """Yield a cycle for each scan that the frames complete, and for each that should have come.

        Args:
            items: frames and ticks in order of time.
        """
        routes, counts, schedule, classic = self._routes, self._counts.buses, self.schedule, self._classic
        for item in items:
            if item[0] >= schedule.deadline_ns:
                yield from self.advance(item[0])
            if len(item) == 1:  # a tick
                continue
            time_ns, bus, can_id, data, fd = item
            if bus < 0:
                continue
            counts[bus].frames += 1
            if fd and bus in classic:
                counts[bus].fd_unset += 1
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
        """As `run`, for a log: scans that lie whole in a block are read together.

        Args:
            blocks: frames and ticks in order of time.
        """
        judges = self._judges()
        steady = self._make_steady(judges)
        router = BlockRouter(self._routes, self.binding.sensors, self.assemblers, judges, steady)
        counts = self._counts.buses
        for block in blocks:
            if not isinstance(block, FrameBlock):
                yield from self.run(block)
                continue
            events, unheard, frames, unknown = router.routed(block)
            for bus, count in enumerate(counts):
                count.frames += frames[bus]
                count.unknown += unknown[bus]
                if bus in self._classic and block.fd.any():
                    count.fd_unset += int(np.count_nonzero(block.fd & (block.bus == bus)))
            begin = 0
            for time_ns, passed, receive, part, slot, data in events:
                if time_ns >= self.schedule.deadline_ns:
                    if isinstance(data, Succession):  # something is due between its frames
                        yield from self._received_between(unheard, begin, receive, part, slot, data)
                        begin = passed
                        continue
                    yield from self._advance_by(unheard, begin, passed)
                    if time_ns >= self.schedule.deadline_ns:
                        yield from self.advance(time_ns)
                begin = passed
                scan = receive(part, slot, data, time_ns)
                if scan is not None:
                    yield from self._cycle(scan, time_ns)
                    self._set_deadline(time_ns)
            yield from self._advance_by(unheard, begin, len(unheard))

    def _received_between(
        self,
        unheard: Sequence[int],
        passed: int,
        receive: Callable[[int, int, Any, int], object],
        begin: int,
        end: int,
        frames: Succession,
    ) -> Iterator[Cycle]:
        """Receive frames that come one after the other, from `begin` to before `end`, and advance where that is due.

        Args:
            unheard: times of what nobody receives.
            passed: how many of those were before.
            receive: takes frames from one to before another.
            begin: the first, among all frames that are received so.
            end: after the last.
            frames: all of them.
        """
        while begin < end:
            yield from self._advance_by(unheard, passed, frames.passed[begin])
            if frames.time_ns[begin] >= self.schedule.deadline_ns:
                yield from self.advance(frames.time_ns[begin])
            due = bisect_left(frames.time_ns, self.schedule.deadline_ns, begin + 1, end)
            receive(begin, due, frames, frames.time_ns[due - 1])
            begin, passed = due, frames.passed[due - 1]

    def _advance_by(self, times: Sequence[int], begin: int, end: int) -> Iterator[Cycle]:
        """Advance to those of some ascending times, from index `begin` to before `end`, at which something is due."""
        while (begin := bisect_left(times, self.schedule.deadline_ns, begin, end)) < end:
            yield from self.advance(times[begin])
            begin += 1

    def advance(self, time_ns: int) -> Iterator[Cycle]:
        """Close the scans, and report the coasting obstacles, that are due by a time.

        It ends: closing a scan sets its deadline to `NEVER_NS`, which no time reaches, and coasting moves its due time
        on by a sensor's cycle, from `longest_coasting` before `time_ns` at the earliest. So it yields one cycle a
        sensor, and `longest_coasting` over the shortest cycle time and two at most, whatever the pause was.
        """
        time_ns = min(time_ns, NEVER_NS - 1)
        schedule = self.schedule
        if schedule.coast_due_ns == NEVER_NS:
            schedule.coast_due_ns = time_ns + self._startup_ns
        while True:
            assembler = min(self.assemblers, key=_deadline)
            for alignment in sorted(self.alignments, key=_given_up):
                if (given_up_ns := alignment.deadline_ns) <= min(time_ns, assembler.deadline_ns):
                    yield from self._follow(alignment.expire(), given_up_ns)
            if assembler.deadline_ns <= time_ns:
                closed_ns = assembler.deadline_ns
                scan = assembler.expire(closed_ns)
                if scan is not None:
                    yield from self._cycle(scan, closed_ns)
            elif assembler.deadline_ns == NEVER_NS and schedule.coast_due_ns <= time_ns and not self._is_waiting():
                yield self._coast(max(schedule.coast_due_ns, time_ns - self._longest_coasting_ns))
            else:
                break
        self._set_deadline(time_ns)

    def quiet_until_ns(self, now_ns: int) -> int:
        """Return a time before which no cycle comes, whatever frames do, as long as none of a scan is lost.

        Args:
            now_ns: a time by which all frames that had come were run.
        """
        quiet_ns = self.schedule.deadline_ns
        for assembler, frame_ns in zip(self.assemblers, self._frame_ns, strict=True):
            quiet_ns = min(quiet_ns, assembler.closes_after_ns(now_ns, frame_ns))
        return quiet_ns

    def finish(self) -> Iterator[Cycle]:
        """Close what is open, at the end of a log."""
        for assembler in sorted(self.assemblers, key=_deadline):
            closed_ns = assembler.deadline_ns
            scan = assembler.flush()
            if scan is not None:
                yield from self._cycle(scan, closed_ns)
        yield from self.settle(NEVER_NS)

    def settle(self, time_ns: int) -> Iterator[Cycle]:
        """Track the scans that wait for those of other sensors, by a time at the latest: the present one."""
        for alignment in sorted(self.alignments, key=_given_up):
            given_up_ns = min(alignment.deadline_ns, time_ns)
            yield from self._follow(alignment.expire(), given_up_ns)

    @property
    def counts(self) -> PipelineCounts:
        """What it did; other counts that are set go on from there."""
        return self._counts

    @counts.setter
    def counts(self, counts: PipelineCounts) -> None:
        self._counts = counts
        for frames in self.ego_frames.values():
            frames.count_into(counts)
        self._routes = self._make_routes()

    @property
    def state(self) -> PipelineState:
        """What it remembers between two runs: the states of its stages.

        Another pipeline of the same configuration whose state is set to it goes on where this one was.

        Raises:
            ValueError: a state that is set does not fit the configuration; the pipeline is of no use then.
        """
        return PipelineState(
            self.counts,
            [assembler.state for assembler in self.assemblers],
            self.ego.state,
            None if self.georeferencer is None else self.georeferencer.state,
            {can_id: frames.state for can_id, frames in self.ego_frames.items()},
            self.trust.state,
            self.tracker_groups.state,
            None if self.stationary is None else self.stationary.state,
            self.output_cycle.state,
            None if self.calibrator is None else self.calibrator.state,
            None if self.encoder is None else self.encoder.state,
            self.health.state,
            self.schedule,
            [alignment.state for alignment in self.alignments],
        )

    @state.setter
    def state(self, state: PipelineState) -> None:
        if len(state.counts.buses) != len(self.binding.buses) or len(state.assemblers) != len(self.assemblers):
            raise ValueError("other buses or sensors than the configuration's")
        if state.ego_frames.keys() != self.ego_frames.keys():
            raise ValueError("other messages of ego motion than the configuration's")
        self.counts = state.counts
        for assembler, of_assembler in zip(self.assemblers, state.assemblers, strict=True):
            assembler.state = of_assembler
        for can_id, frames in self.ego_frames.items():
            frames.state = state.ego_frames[can_id]
        _restore(None if self.ego.state is None else self.ego, state.ego)
        _restore(self.georeferencer, state.georeferencer)
        self.trust.state = state.trust
        self.tracker_groups.state = state.trackers
        _restore(self.stationary, state.stationary)
        self.output_cycle.state = state.output_cycle
        _restore(self.calibrator, state.calibrator)
        _restore(self.encoder, state.encoder)
        self.health.state = state.health
        self.schedule = state.schedule
        if len(state.alignments) != len(self.alignments):
            raise ValueError("other groups with align: lagrange than the configuration's")
        for alignment, remembered in zip(self.alignments, state.alignments, strict=True):
            alignment.restore(remembered)

    @property
    def drops(self) -> int:
        """Frames of sensors and ego motion that were lost or could not be used so far."""
        scans = sum(assembler.counts.dropped + assembler.counts.missing for assembler in self.assemblers)
        return scans + self._counts.ego_motion_short + self._counts.ego_motion.refused

    @property
    def saturated(self) -> int:
        """Output values that had to be brought into their signal's range."""
        return self.encoder.saturated if self.encoder is not None else 0

    @property
    def ego_signals(self) -> dict[str, int]:
        """How often each signal of ego motion came; of a quantity with several, the second is `left_wheels[1]`."""
        came: dict[str, int] = {}
        for frames in self.ego_frames.values():
            for name, count in frames.came:
                number = sum(each.partition("[")[0] == name for each in came)
                came[f"{name}[{number}]" if number else name] = count
        return came

    def tracker_of(self, sensor: int) -> AnyTracker:
        """Return the tracker of a sensor's group."""
        return self._tracker_of[sensor]

    def _cycle(self, scan: Scan, now_ns: int) -> Iterator[Cycle]:
        """Scan → detections → tracks → obstacles → frames."""
        self.health.note_scan(scan.sensor, now_ns)
        calibrator = self.calibrator
        corrected = calibrator.corrected(scan) if calibrator is not None and self._corrects else scan
        alignment = self._alignment_of.get(scan.sensor)
        ready = [corrected] if alignment is None else alignment.take(corrected, now_ns)
        used = yield from self._follow(ready, now_ns)
        if alignment is not None:  # the scans that were tracked are others, or none
            used = not self.trust.fault(scan.sensor).cuts_off and self.ego.pose(scan.time_ns) is not None
        if calibrator is not None and used:
            calibrator.learn(scan)

    def _follow(self, scans: Iterable[Scan], now_ns: int) -> Generator[Cycle, None, bool]:
        """Track scans one after the other; return whether all were used."""
        used = True
        for scan in scans:
            used &= yield from self._tracked(scan, now_ns)
        return used

    def _is_waiting(self) -> bool:
        """Return whether a scan waits for those of other sensors: it is about to show where things are."""
        return any(alignment.deadline_ns != NEVER_NS for alignment in self.alignments)

    def _tracked(self, scan: Scan, now_ns: int) -> Generator[Cycle, None, bool]:
        """Track a scan; return whether it was used."""
        self.trust.watch(now_ns)
        self.schedule.coast_due_ns = now_ns + self._coast_after_ns
        self.schedule.track(scan.time_ns, now_ns)
        calibrator = self.calibrator if self._corrects else None
        # where the vehicle was, and how it moved, at the measurement
        pose = self.ego.pose(scan.time_ns)
        if pose is None:
            self._counts.without_ego += 1
            yield self._report(no_obstacles(scan.time_ns), _unknown_pose(scan.time_ns), now_ns, None, None)
            return False
        if scan.at_end is not None and isinstance(self._tracker_of[scan.sensor], VehicleTracker):
            scan = self._placed(scan)
        # sensor axes → local frame
        yaw = calibrator.yaw(scan.sensor) if calibrator is not None else 0.0
        detections = self.mountings[scan.sensor].detections(scan, pose, yaw)
        # raw innovations → how far the sensor can be trusted
        tracker = self._tracker_of[scan.sensor]
        trusted = self.trust.judged(scan, detections, tracker, pose, now_ns)
        if trusted is None:
            yield self._report(self._track(None, None, pose), pose, now_ns, None, None)
            return False
        # association, update, initiation and deletion in the sensor's group; the other groups are predicted
        obstacles = self._track(tracker, trusted, pose)
        if scan.sensor in self._ranging and isinstance(tracker, Tracker) and tracker.detections is not None:
            trusted = tracker.detections  # ranges, where the tracker has placed them
        # obstacles → slots → signals → frames
        yield self._report(obstacles, pose, now_ns, trusted, tracker)
        # what stands still shows what the sensors of ego motion read wrongly
        if self.stationary is not None:
            returns = self.stationary.returns(trusted, tracker, obstacles, pose)
            if returns is not None:
                misled = calibrator is not None and calibrator.is_turned(scan.sensor)
                self.ego.learn(replace(returns, drifts=()) if misled else returns)
        return True

    def _placed(self, scan: Scan) -> Scan:
        """Return a scan without the objects whose place is a bound: such an obstacle would drive along that edge."""
        assert scan.at_end is not None, "some object is at an end"  # noqa: S101  # the caller asked
        self.assemblers[scan.sensor].counts.at_end += int(np.count_nonzero(scan.at_end))
        return scan.take(np.flatnonzero(~scan.at_end))

    def _coast(self, now_ns: int) -> Cycle:
        """Report where the obstacles should be, every sensor being silent: at the time of a scan that would end now.

        So a lost scan leaves a cycle between its neighbours, and the next scan is never older than what was told.
        """
        self.schedule.coast_due_ns = now_ns + self._coast_ns
        self._counts.coasting_cycles += 1
        self.trust.watch(now_ns)
        time_ns = now_ns - self._lag_ns()
        pose = self.ego.pose(time_ns)
        if pose is None:
            return self._report(no_obstacles(time_ns), _unknown_pose(time_ns), now_ns, None, None)
        return self._report(self._track(None, None, pose), pose, now_ns, None, None)

    def _lag_ns(self) -> int:
        """Return the time from a measurement until it is tracked, ns: that of the latest, or the least there is."""
        if self.schedule.lag_ns is not None:
            return self.schedule.lag_ns
        if self.calibrator is not None and self._corrects:
            return self._latency_ns + min(map(self.calibrator.latency_ns, range(len(self.assemblers))))
        return self._latency_ns

    def _track(self, tracker: AnyTracker | None, detections: Detections | None, pose: EgoPose) -> Obstacles:
        """Advance every group to the pose, the one tracker with detections."""
        obstacles = [each.step(detections if each is tracker else None, pose) for each in self.trackers]
        return obstacles[0] if len(obstacles) == 1 else concatenated(obstacles)

    def _report(
        self,
        obstacles: Obstacles,
        pose: EgoPose,
        now_ns: int,
        detections: Detections | None,
        tracker: AnyTracker | None,
    ) -> Cycle:
        """Encode a cycle's obstacles, if an output is due, and count it."""
        georeference = self.georeferencer.at(obstacles.time_ns) if self.georeferencer is not None else None
        reported = self.output_cycle.reported(obstacles, now_ns)
        update = None if tracker is None else tracker.update
        if reported is None:
            return Cycle(now_ns, obstacles, (), pose, detections, tracker, update, georeference)
        self._counts.cycles += 1
        self._counts.dead_reckoning += pose.status is EgoStatus.DEAD_RECKONING
        self._counts.ego_lost += pose.status is EgoStatus.LOST
        frames: Sequence[Frame] = ()
        output = self.binding.output
        if self.encoder is not None and output is not None:
            status = self._status(pose, now_ns) if output.status is not None else _NO_STATUS
            payloads = self.encoder.plan(reported, status, pose, georeference)
            frames = FrameBatch(now_ns, output.bus, payloads, output.fd_ids)
        self._counts.sent += len(frames)
        return Cycle(now_ns, obstacles, frames, pose, detections, tracker, update, georeference, reported)

    def _status(self, pose: EgoPose, now_ns: int) -> OutputStatus:
        """Return what the status message says beside the slots."""
        drops = self.drops
        valid_shares = [assembler.valid_share for assembler in self.assemblers]
        faults = [self.trust.fault(sensor.index) for sensor in self.binding.sensors]
        health = self.health.health(pose.status, valid_shares, faults, drops, now_ns)
        return OutputStatus(ego=int(pose.status), health=int(health), drops=drops)

    def _set_deadline(self, time_ns: int) -> None:
        """Find the next instant at which something happens without a frame."""
        schedule = self.schedule
        opening_ns = time_ns + self._shortest_timeout_ns  # a scan that opens from here on is due no sooner
        first_ns = min(map(_deadline, self.assemblers))
        for alignment in self.alignments:
            first_ns = min(first_ns, alignment.deadline_ns)
        # while a scan is open nothing coasts: it is about to show where things are
        schedule.deadline_ns = min(opening_ns, schedule.coast_due_ns if first_ns == NEVER_NS else first_ns)

    def _make_calibrator(self) -> Calibrator | None:
        """Return what calibrates the sensors; None where that is not asked for, or the vehicle stands for good."""
        settings = self.binding.settings
        if not settings.calibration.enabled or self.binding.ego is None:
            return None
        return Calibrator(settings.calibration, self.binding.sensors, self.ego, settings.ego)

    def _make_stationary_watch(self) -> StationaryWatch | None:
        """Return what watches what stands; None where ego motion has nothing to learn from it."""
        if self.ego.teaching is None:
            return None
        sensors = self.binding.sensors
        compensated = {each.index for each in sensors if each.settings.range_rates == "absolute"}
        return StationaryWatch(self.ego.teaching, compensated)

    def _judged_after(self, sensor: BoundSensor) -> float:
        """Return the s after which a sensor is silent that is tracked as often as its group's slowest."""
        alignment = self._alignment_of.get(sensor.index)
        slowest = self.binding.sensors[sensor.index if alignment is None else alignment.slowest]
        return max(self.binding.lost_after(sensor), self.binding.lost_after(slowest))

    def _make_ego_frames(self) -> dict[int, EgoFrames]:
        """Return who receives the frames of ego motion, by CAN id."""
        ego = self.binding.ego
        if ego is None:
            return {}
        consumers: list[EgoMotion | Georeferencer] = [self.ego]
        if self.georeferencer is not None:
            consumers.append(self.georeferencer)
        return {can_id: EgoFrames(message, ego, consumers, self._counts) for can_id, message in ego.messages.items()}

    def _judges(self) -> dict[tuple[int, int], EgoFrames]:
        """Return who receives frames that are judged together, by bus and CAN id."""
        ego = self.binding.ego
        if ego is None:
            return {}
        return {
            (ego.bus, can_id): frames
            for can_id, frames in self.ego_frames.items()
            if frames.are_judged_together and self._routes[ego.bus][can_id][0] == frames.receive
        }

    def _make_steady(
        self, judges: dict[tuple[int, int], EgoFrames]
    ) -> tuple[SteadyFrames, dict[tuple[int, int], int]] | None:
        """Return who receives frames of an INS that come one after the other, out of those that are judged together.

        Those are no longer among the judges' then.
        """
        if not isinstance(self.ego, InsMotion) or not self.ego.takes_many:
            return None
        found = {at: judges.pop(at) for at, frames in list(judges.items()) if frames.are_all_for(self.ego)}
        return SteadyFrames(self.ego, list(found.values())), {at: number for number, at in enumerate(found)}

    def _make_routes(self) -> list[dict[int, Route]]:
        """Return for each bus who receives an identifier: a sensor, ego motion, or a counter of the rest."""
        routes: list[dict[int, Route]] = [{} for _ in self.binding.buses]
        for bus, counts in zip(self.binding.buses, self._counts.buses, strict=True):
            for database in bus.databases:
                for can_id, message in database.by_id.items():
                    routes[bus.index][can_id] = (SpareFrames(message.length, counts).receive, 0, 0)
        if self.binding.ego is not None:
            for can_id, frames in self.ego_frames.items():
                routes[self.binding.ego.bus][can_id] = (frames.receive, 0, 0)
        claimed: dict[tuple[int, int], list[ClaimedRoute]] = {}
        for sensor, assembler in zip(self.binding.sensors, self.assemblers, strict=True):
            routes[sensor.bus].update(
                (can_id, route) for can_id, route in assembler.routes.items() if can_id not in assembler.claimed
            )
            for can_id, claims in assembler.claimed.items():
                claimed.setdefault((sensor.bus, can_id), []).extend(claims)
        for (index, can_id), all_claims in claimed.items():  # what no sensor claims is counted as known
            spare, _, _ = routes[index][can_id]
            routes[index][can_id] = (ClaimedFrames(all_claims, spare).receive, 0, 0)
        return routes


def _least_frame_ns(binding: Binding, sensor: BoundSensor) -> int:
    """Return the ns that the shortest frame of a sensor's objects takes on its bus at least."""
    settings = binding.buses[sensor.bus].settings
    shortest = (layout.shortest for layout in sensor.reader.layouts)
    traffic = (Traffic(0.0, each.length, bool(each.can_id & EXTENDED), each.is_fd) for each in shortest)
    return int(1e9 * min(frame_time(each, settings.bitrate, settings.data_bitrate, stuffing=0.0) for each in traffic))


def _unknown_pose(time_ns: int) -> EgoPose:
    """Return the pose of a vehicle that knows nothing of its motion."""
    return EgoPose(time_ns, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, EgoStatus.LOST)


def _restore(stage: Any, state: object) -> None:
    """Set the state of a stage that the configuration may leave out.

    Raises:
        ValueError: one is there without the other, or they do not fit.
    """
    if (stage is None) != (state is None):
        raise ValueError("other stages than the configuration's")
    if stage is not None:
        stage.state = state


def _deadline(assembler: ScanAssembler) -> int:
    return assembler.deadline_ns


def _given_up(alignment: ScanAlignment) -> int:
    return alignment.deadline_ns
