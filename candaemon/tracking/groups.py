"""Which tracker tracks what: one for each group of sensors, and one for those of no group."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from candaemon.config.sensors import SensorSettings
from candaemon.config.settings import Config
from candaemon.radar.mounting import sensor_views
from candaemon.tracking.any_tracker import AnyTracker, make_tracker, set_state
from candaemon.tracking.identities import Identities
from candaemon.tracking.tracker import TrackerState
from candaemon.tracking.vehicle_tracker import VehicleTrackerState


@dataclass(slots=True)
class TrackersState:
    """What the trackers of a pipeline remember.

    Attributes:
        identities: the numbers given to obstacles.
        trackers: of each group.
    """

    identities: Identities
    trackers: list[TrackerState | VehicleTrackerState]


class TrackerGroups:
    """The trackers of a pipeline: one for each group of sensors, and one for those of no group.

    Args:
        config: with the groups.
        sensors: settings by name, in the configuration's order.

    Attributes:
        identities: shared by the trackers, so that no two obstacles have the same number.
        trackers: of each group.
        by_sensor: the tracker of each sensor's group, in the order of the sensors.
        others: the other sensors in each one's group, likewise.
    """

    def __init__(self, config: Config, sensors: Mapping[str, SensorSettings]) -> None:
        self.identities = Identities()
        self.trackers: list[AnyTracker] = []
        ranging = frozenset(name for name, each in sensors.items() if not each.signals.directed)
        groups = [(group.fused_tracker, frozenset(group.sensors)) for group in config.groups.values()]
        rest = frozenset(sensors).difference(*(names for _, names in groups))
        if rest:
            groups.insert(0, (config.tracker, rest))
        tracker_of: dict[str, AnyTracker] = {}
        for settings, names in groups:
            numbered = {number: each for number, (name, each) in enumerate(sensors.items()) if name in names}
            members = list(numbered.values())
            cycle_time = max(each.revisit_time for each in members)
            in_turn = len(sensors) > 1 or members[0].looks is not None
            slack_ns = round(1.5 * cycle_time * 1e9) if in_turn else 0
            views = [view for number, each in numbered.items() for view in sensor_views(each, number).values()]
            tracker = make_tracker(
                settings,
                self.identities,
                cycle_time=cycle_time,
                slack_ns=slack_ns,
                views=views,
                sensors=numbered,
                ranging=names <= ranging,
            )
            self.trackers.append(tracker)
            tracker_of.update(dict.fromkeys(names, tracker))
        self.by_sensor = [tracker_of[name] for name in sensors]
        self.others = [
            [k for k, other in enumerate(self.by_sensor) if other is own and k != sensor]
            for sensor, own in enumerate(self.by_sensor)
        ]

    @property
    def state(self) -> TrackersState:
        """All that the trackers remember.

        Raises:
            ValueError: a state that is set does not fit the configuration.
        """
        return TrackersState(self.identities, [tracker.state for tracker in self.trackers])

    @state.setter
    def state(self, state: TrackersState) -> None:
        for tracker, remembered in zip(self.trackers, state.trackers, strict=True):
            set_state(tracker, remembered)
        given = state.identities.given
        if given < max((int(each.tracks.obstacles.id.max(initial=0)) for each in state.trackers), default=0):
            raise ValueError(f"an obstacle has a greater number than the latest one given, {given}")
        self.identities.given = given
