"""What a tracker did: in its latest scan, and since the start."""

from __future__ import annotations

from dataclasses import dataclass

from candaemon.arrays import Booleans, Floats, Indices, Integers


@dataclass(slots=True)
class TrackerCounts:
    """What a tracker did.

    Attributes:
        cycles: scans tracked.
        detections: detections given.
        used: detections that updated or initiated a track.
        crowded: detections dropped because `max_tracks` was reached.
        obstacles: obstacles initiated.
        confirmed: obstacles confirmed.
        merged: obstacles merged into another.
        slot_jumps: detections whose sensor kept the id but that cannot be the track of that id.
    """

    cycles: int = 0
    detections: int = 0
    used: int = 0
    crowded: int = 0
    obstacles: int = 0
    confirmed: int = 0
    merged: int = 0
    slot_jumps: int = 0


@dataclass(slots=True)  # made each cycle
class Update:
    """The detections that updated or initiated a track in the latest scan.

    Attributes:
        detection: rows in the scan (m,).
        reflection: rows of the reflections they updated (m,).
        nis: normalised innovation squared (m,); NaN where a track was initiated.
        degrees_of_freedom: of each NIS (m,).
    """

    detection: Indices
    reflection: Indices
    nis: Floats
    degrees_of_freedom: Integers


@dataclass(slots=True)  # made each cycle
class Used:
    """The detections used in a cycle, as they are reported.

    Attributes:
        reflection: rows of the reflections updated (m,).
        sensor: index of the sensor.
        objects: its own id of each detection (m,).
    """

    reflection: Indices
    sensor: int
    objects: Integers


@dataclass(frozen=True, slots=True)
class PredictedReflections:
    """Where n reflections are expected, for a sensor that has a scan.

    Attributes:
        position: (n, 2), local frame, m.
        variance: of the position, both axes together (n,), m².
        obstacle: identity of the obstacle of each (n,).
        confirmed: whether the obstacle is (n,).
        shared: whether another sensor has ever detected the obstacle (n,).
        by_others: whether it was another sensor that reported the reflection last (n,).
    """

    position: Floats
    variance: Floats
    obstacle: Integers
    confirmed: Booleans
    shared: Booleans
    by_others: Booleans
