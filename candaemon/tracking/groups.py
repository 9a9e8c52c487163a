"""Which tracker tracks what: one for each group of sensors, and one for those of no group."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

from candaemon.config.sensors import SensorSettings
from candaemon.config.settings import Config
from candaemon.radar.mounting import SensorView
from candaemon.tracking.tracker import Tracker


class Identities:
    """Gives each obstacle a number that no other one has: 1, 2, 3 and so on.

    Attributes:
        given: the last one; 0 before the first.
    """

    __slots__ = ("given",)

    def __init__(self) -> None:
        self.given = 0

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> int:
        self.given += 1
        return self.given


def make_trackers(config: Config, sensors: Mapping[str, SensorSettings]) -> tuple[list[Tracker], list[Tracker]]:
    """Return the trackers, and for each sensor the one of its group; identities are unique across them.

    Args:
        config: with the groups.
        sensors: settings by name, in the configuration's order.
    """
    ids = Identities()
    groups = [(group.tracker, frozenset(group.sensors)) for group in config.groups.values()]
    grouped = frozenset[str]().union(*(names for _, names in groups))
    rest = frozenset(sensors) - grouped
    if rest:
        groups.insert(0, (config.tracker, rest))
    trackers = []
    tracker_of: dict[str, Tracker] = {}
    for settings, names in groups:
        mine = [each for name, each in sensors.items() if name in names]
        cycle_time = max(each.cycle_time for each in mine)
        slack_ns = round(1.5 * cycle_time * 1e9) if len(sensors) > 1 else 0
        views = [SensorView(each.mount, each.field_of_view) for each in mine]
        tracker = Tracker(settings, ids, cycle_time=cycle_time, slack_ns=slack_ns, views=views)
        trackers.append(tracker)
        tracker_of.update(dict.fromkeys(names, tracker))
    return trackers, [tracker_of[name] for name in sensors]
