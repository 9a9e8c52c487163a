"""What a pipeline takes over from the one before it, when another configuration takes its place.

A sensor, ego motion and the output go on as they were where neither their settings nor their messages have changed.
Obstacles keep their slots, whatever else changes of the output, as long as it has the same: a reader sees a slot empty
before it is another's, and none that stays as it was for ever.
Obstacles live on where ego motion does, for their frame of reference is its, where the tracker has the same filter, and
where a sensor that has seen them is the same as before; what only changed sensors have seen is forgotten. Identities
are never assigned twice, and totals go on.

What goes on is the `state` of a stage: here is decided which stages take over that of their predecessor.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from candaemon.binding.bound import Binding, BoundEgo, BoundOutput, BoundSensor
from candaemon.dbc.types import Database, MessageSpec
from candaemon.pipeline.cycle import BusCounts
from candaemon.pipeline.output_cycle import OutputCycleState
from candaemon.pipeline.pipeline import Pipeline
from candaemon.tracking.any_tracker import AnyTracker, same_filter, set_state


@dataclass(frozen=True, slots=True)
class Kept:
    """What was taken over.

    Attributes:
        sensors: names of the sensors that go on as they were.
        ego_motion: whether ego motion does.
        output: whether the output does, or there is none in both.
        obstacles: how many live on.
        ended: how many do not.
    """

    sensors: tuple[str, ...]
    ego_motion: bool
    output: bool
    obstacles: int
    ended: int

    def __str__(self) -> str:
        goes_on = [*self.sensors, *["own motion"] * self.ego_motion, *["output"] * self.output]
        ended = f", {self.ended} ended" if self.ended else ""
        return f"unchanged: {', '.join(goes_on) or 'nothing'}; {self.obstacles} obstacles kept{ended}"


def hand_over(former: Pipeline, successor: Pipeline) -> Kept:
    """Let a fresh pipeline go on where another one ends; that one is of no more use.

    Args:
        former: with all items of its input processed, and settled.
        successor: of the other configuration.
    """
    ego_motion = _same_ego(former.binding.ego, successor.binding.ego)
    sensors = _same_sensors(former.binding, successor.binding)
    output = _same_output(former.binding.output, successor.binding.output)
    alive = sum(map(len, former.trackers))
    _take_sensors(former, successor, sensors)
    if ego_motion:
        _take_ego(former, successor)
    if former.encoder is not None and successor.encoder is not None:
        if _same_slots(former.binding.output, successor.binding.output):
            successor.encoder.state = former.encoder.state
        else:
            successor.encoder.state.saturated = former.saturated
    successor.output_cycle.state = OutputCycleState(former.output_cycle.state.due_ns)
    _take_trackers(former, successor, sensors if ego_motion else {})
    same_numbers = len(sensors) == len(former.assemblers) and all(old == new for old, new in sensors.items())
    if ego_motion and same_numbers and former.stationary is not None and successor.stationary is not None:
        successor.stationary.state = former.stationary.state
    if ego_motion:
        _take_calibration(former, successor, sensors)
    _take_counts(former, successor)
    _take_times(former, successor, sensors)
    kept = sum(map(len, successor.trackers))
    names = tuple(successor.binding.sensors[k].name for k in sorted(sensors.values()))
    return Kept(names, ego_motion, output, kept, alive - kept)


def _same_ego(former: BoundEgo | None, successor: BoundEgo | None) -> bool:
    if former is None or successor is None:
        return former is successor
    return former.settings == successor.settings and _messages(former.database, former.messages) == _messages(
        successor.database, successor.messages
    )


def _same_sensors(former: Binding, successor: Binding) -> dict[int, int]:
    """Return the former number and that of the successor of each sensor that is the same."""
    before = {sensor.name: sensor for sensor in former.sensors}
    return {
        before[sensor.name].index: sensor.index
        for sensor in successor.sensors
        if sensor.name in before and _same_sensor(before[sensor.name], sensor)
    }


def _same_sensor(former: BoundSensor, successor: BoundSensor) -> bool:
    return former.settings == successor.settings and _messages(former.database, former.can_ids) == _messages(
        successor.database, successor.can_ids
    )


def _same_output(former: BoundOutput | None, successor: BoundOutput | None) -> bool:
    if former is None or successor is None:
        return former is successor
    return former.settings == successor.settings and _messages(former.database, former.can_ids) == _messages(
        successor.database, successor.can_ids
    )


def _same_slots(former: BoundOutput | None, successor: BoundOutput | None) -> bool:
    """Return whether a reader takes the slots of both for the same."""
    if former is None or successor is None:
        return False
    before, after = former.settings, successor.settings
    return (before.bus, before.objects, former.writer.slots) == (after.bus, after.objects, successor.writer.slots)


def _messages(database: Database, can_ids: Iterable[int]) -> list[MessageSpec]:
    """Return what a DBC says of some identifiers."""
    return [database.by_id[can_id] for can_id in sorted(can_ids)]


def _take_ego(former: Pipeline, successor: Pipeline) -> None:
    """Let ego motion go on; what watches its frames does as long as they come from the bus of the same number."""
    successor.ego.state = former.ego.state
    if former.georeferencer is not None and successor.georeferencer is not None:
        successor.georeferencer.state = former.georeferencer.state
    ego, other = former.binding.ego, successor.binding.ego
    if ego is not None and other is not None and ego.bus == other.bus:
        for can_id, frames in successor.ego_frames.items():
            frames.state = former.ego_frames[can_id].state


def _take_sensors(former: Pipeline, successor: Pipeline, sensors: Mapping[int, int]) -> None:
    """Let sensors that are the same go on, and the totals of those that are not: a counter never falls."""
    for old, new in sensors.items():
        successor.assemblers[new].state = former.assemblers[old].state
    before = {sensor.name: sensor.index for sensor in former.binding.sensors}
    for sensor in successor.binding.sensors:
        if sensor.name in before and sensor.index not in sensors.values():
            assembler = successor.assemblers[sensor.index]
            assembler.state = replace(assembler.state, counts=former.assemblers[before[sensor.name]].counts)


def _take_trackers(former: Pipeline, successor: Pipeline, sensors: Mapping[int, int]) -> None:
    """Let the obstacles of each group live on that is tracked alike and has kept sensors."""
    groups, others = _groups(successor), _groups(former)
    successor.tracker_groups.identities.given = former.tracker_groups.identities.given
    for name, (tracker, members) in groups.items():
        predecessor, were = others.get(name, (tracker, frozenset()))
        kept = {old: new for old, new in sensors.items() if old in were and new in members}
        if kept and same_filter(predecessor, tracker):
            predecessor.renumber_sensors(kept)
            set_state(tracker, predecessor.state)
        elif predecessor is not tracker:
            tracker.state.counts = predecessor.counts


def _take_calibration(former: Pipeline, successor: Pipeline, sensors: Mapping[int, int]) -> None:
    """Let what was learnt of the sensors live on that are the same."""
    if former.calibrator is not None and successor.calibrator is not None:
        before, after = former.calibrator.state.sensors, successor.calibrator.state.sensors
        for old, new in sensors.items():
            after[new] = before[old]


def _groups(pipeline: Pipeline) -> dict[str, tuple[AnyTracker, frozenset[int]]]:
    """Return the tracker of each group and the numbers of its sensors, by the group's name; "" for all the others."""
    number = {sensor.name: sensor.index for sensor in pipeline.binding.sensors}
    named = {
        name: frozenset(number[sensor] for sensor in group.sensors)
        for name, group in pipeline.binding.settings.groups.items()
    }
    rest = frozenset(number.values()) - frozenset[int]().union(*named.values())
    members = named | ({"": rest} if rest else {})
    return {name: (pipeline.tracker_of(min(numbers)), numbers) for name, numbers in members.items()}


def _take_counts(former: Pipeline, successor: Pipeline) -> None:
    """Let the totals go on, those of a bus by its name."""
    of_bus = dict(zip([bus.name for bus in former.binding.buses], former.counts.buses, strict=True))
    buses = [of_bus.get(bus.name) or BusCounts() for bus in successor.binding.buses]
    successor.counts = replace(former.counts, buses=buses)


def _take_times(former: Pipeline, successor: Pipeline, sensors: Mapping[int, int]) -> None:
    """Let what was last when go on; nothing is due before the next frame or tick."""
    before, after = former.health.state, successor.health.state
    for old, new in sensors.items():
        after.last_scan_ns[new] = before.last_scan_ns[old]
        successor.trust.state.sensors[new] = former.trust.state.sensors[old]
    after.drops, after.dropped_ns = successor.drops, before.dropped_ns
    schedule, last = successor.schedule, former.schedule
    schedule.coast_due_ns, schedule.latest_ns, schedule.lag_ns = last.coast_due_ns, last.latest_ns, last.lag_ns
