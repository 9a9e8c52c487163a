"""The tracker that the configuration's estimator needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

from candaemon.config.sensors import SensorSettings
from candaemon.config.tracker import TrackerSettings
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.radar.mounting import SensorView
from candaemon.tracking.identities import Identities
from candaemon.tracking.tracker import Tracker, TrackerState
from candaemon.tracking.vehicle_tracker import VehicleTracker, VehicleTrackerState

AnyTracker: TypeAlias = Tracker | VehicleTracker


def make_tracker(
    settings: TrackerSettings,
    identities: Identities,
    *,
    cycle_time: float,
    slack_ns: int,
    views: Sequence[SensorView],
    sensors: Mapping[int, SensorSettings] | None = None,
    ranging: bool = False,
) -> AnyTracker:
    """Return the tracker of one filter an obstacle for a `vehicle` estimator, else that of one a reflection.

    Args:
        settings: of the tracker.
        identities: the numbers of new obstacles.
        cycle_time: the longest of its sensors, s.
        slack_ns: how long an obstacle may be without a detection and not count as coasting.
        views: what the sensors can see.
        sensors: settings of the sensors by their number; of one left out nothing is learnt, its noise is white.
        ranging: the sensors tell ranges and no direction.
    """
    if isinstance(settings.estimator, VehicleEstimatorSettings):
        return VehicleTracker(
            settings, sensors or {}, identities, cycle_time=cycle_time, slack_ns=slack_ns, views=views
        )
    return Tracker(settings, identities, cycle_time=cycle_time, slack_ns=slack_ns, views=views, ranging=ranging)


def set_state(tracker: AnyTracker, state: TrackerState | VehicleTrackerState) -> None:
    """Let a tracker go on from a state.

    Raises:
        ValueError: it is of the other kind of tracker, does not fit the settings, or contradicts itself.
    """
    match tracker, state:
        case Tracker(), TrackerState():
            tracker.state = state
        case VehicleTracker(), VehicleTrackerState():
            tracker.state = state
        case _:
            raise ValueError("the state of another kind of tracker")


def same_filter(former: AnyTracker, successor: AnyTracker) -> bool:
    """Return whether the state of one tracker means the same in another: both have the same filter and extent model."""
    before, after = former.settings, successor.settings
    return before.estimator == after.estimator and before.reflections == after.reflections
