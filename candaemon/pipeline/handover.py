"""What a pipeline takes over from the one before it, when another configuration takes its place.

A sensor, own motion and the output go on as they were where neither their settings nor their messages have changed.
Obstacles live on where own motion does, for their frame of reference is its, where the tracker has the same filter, and
where a sensor that has seen them is the same as before; what only changed sensors have seen is forgotten. Identities
are never given twice, and totals go on.

It knows the insides of a pipeline and of a tracker: they know nothing of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from candaemon.binding.bound import Binding, BoundEgo, BoundOutput, BoundSensor
from candaemon.dbc.types import Database, MessageSpec
from candaemon.pipeline.cycle import BusCounts
from candaemon.pipeline.pipeline import Pipeline
from candaemon.tracking.tracker import Tracker


@dataclass(frozen=True, slots=True)
class Kept:
    """What was taken over.

    Attributes:
        sensors: names of the sensors that go on as they were.
        own_motion: whether own motion does.
        output: whether the output does, or there is none in both.
        obstacles: how many live on.
        ended: how many do not.
    """

    sensors: tuple[str, ...]
    own_motion: bool
    output: bool
    obstacles: int
    ended: int

    def __str__(self) -> str:
        goes_on = [*self.sensors, *["own motion"] * self.own_motion, *["output"] * self.output]
        ended = f", {self.ended} ended" if self.ended else ""
        return f"unchanged: {', '.join(goes_on) or 'nothing'}; {self.obstacles} obstacles kept{ended}"


def hand_over(former: Pipeline, successor: Pipeline) -> Kept:
    """Let a pipeline that has taken nothing go on where another one ends; that one is of no more use.

    Args:
        former: with everything that it was given taken.
        successor: of the other configuration.
    """
    own_motion = _same_own_motion(former.binding.ego, successor.binding.ego)
    sensors = _same_sensors(former.binding, successor.binding)
    output = _same_output(former.binding.output, successor.binding.output)
    alive = sum(map(len, former.trackers))
    if own_motion:
        successor.ego, successor.placer = former.ego, former.placer
    if output:
        successor._encoder = former._encoder
    _take_assemblers(former, successor, sensors)
    _take_trackers(former, successor, sensors if own_motion else {})
    if own_motion and len(sensors) == len(former.assemblers) and all(old == new for old, new in sensors.items()):
        successor._watch = former._watch
    _take_counts(former, successor)
    successor._routes = successor._make_routes()
    if own_motion:
        _take_own_frames(former, successor)
    kept = sum(map(len, successor.trackers))
    names = tuple(successor.binding.sensors[k].name for k in sorted(sensors.values()))
    return Kept(names, own_motion, output, kept, alive - kept)


def _same_own_motion(former: BoundEgo | None, successor: BoundEgo | None) -> bool:
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


def _messages(database: Database, can_ids: Iterable[int]) -> list[MessageSpec]:
    """Return what a DBC says of some identifiers."""
    return [database.by_id[can_id] for can_id in sorted(can_ids)]


def _take_assemblers(former: Pipeline, successor: Pipeline, sensors: Mapping[int, int]) -> None:
    """Let the open scans go on."""
    for old, new in sensors.items():
        assembler = former.assemblers[old]
        assembler._sensor = assembler._selection._sensor = new
        successor.assemblers[new] = assembler
        successor._last_scan_ns[new] = former._last_scan_ns[old]


def _take_trackers(former: Pipeline, successor: Pipeline, sensors: Mapping[int, int]) -> None:
    """Let the obstacles of each group live on that is tracked alike and has kept sensors."""
    groups, others = _groups(successor), _groups(former)
    for tracker in successor.trackers:
        tracker._tracks._ids = former.trackers[0]._tracks._ids
    for name, (tracker, members) in groups.items():
        predecessor, were = others.get(name, (tracker, frozenset()))
        kept = {old: new for old, new in sensors.items() if old in were and new in members}
        if kept and _tracks_alike(predecessor, tracker):
            tracker._tracks, tracker._time_ns, tracker.counts = (
                predecessor._tracks,
                predecessor._time_ns,
                predecessor.counts,
            )
            tracker._tracks.renumber(kept)


def _take_own_frames(former: Pipeline, successor: Pipeline) -> None:
    """Let what watches the frames of own motion go on, as long as they come from the bus of the same number."""
    ego, other = former.binding.ego, successor.binding.ego
    if ego is not None and other is not None and ego.bus == other.bus:
        successor._routes[ego.bus] |= {can_id: former._routes[ego.bus][can_id] for can_id in ego.messages}


def _groups(pipeline: Pipeline) -> dict[str, tuple[Tracker, frozenset[int]]]:
    """Return the tracker of each group and the numbers of its sensors, by the group's name; "" for all the others."""
    number = {sensor.name: sensor.index for sensor in pipeline.binding.sensors}
    named = {
        name: frozenset(number[sensor] for sensor in group.sensors)
        for name, group in pipeline.binding.settings.groups.items()
    }
    rest = frozenset(number.values()) - frozenset[int]().union(*named.values())
    members = named | ({"": rest} if rest else {})
    return {name: (pipeline._tracker_of[min(numbers)], numbers) for name, numbers in members.items()}


def _tracks_alike(former: Tracker, successor: Tracker) -> bool:
    """Tell whether the states of one tracker's filter mean the same in another's."""
    return (
        former._settings.estimator == successor._settings.estimator
        and former._settings.reflections == successor._settings.reflections
    )


def _take_counts(former: Pipeline, successor: Pipeline) -> None:
    """Let the totals go on, those of a bus by its name; nothing is due before the next frame or tick."""
    of_bus = dict(zip([bus.name for bus in former.binding.buses], former.counts.buses, strict=True))
    successor.counts = former.counts
    successor.counts.buses = [of_bus.get(bus.name) or BusCounts() for bus in successor.binding.buses]
    successor._drops, successor._dropped_ns = successor.drops, former._dropped_ns
    successor._coast_due_ns = former._coast_due_ns
