"""Tracker: association of detections with tracks, and the tracks' life cycle."""

from __future__ import annotations

from typing import Final, Literal

from pydantic import Field, model_validator

from candaemon.config.base import Settings
from candaemon.config.directions import AlongAcross, Pair
from candaemon.config.estimators import (
    SINGLE_MODEL,
    CaEstimatorSettings,
    EstimatorSettings,
    FederatedEstimatorSettings,
    IntersectionEstimatorSettings,
    MlkfEstimatorSettings,
    SingleModelEstimatorSettings,
)
from candaemon.config.names import Name
from candaemon.config.vehicle import VehicleEstimatorSettings

MOST_TRACKS: Final = 4096
"""Reflections that a tracker can be asked to keep."""


RANGES_ESTIMATOR: Final = MlkfEstimatorSettings.defaults(kind="mlkf")
"""Of sensors of ranges alone, where the configuration names none."""


class TravelSettings(Settings):
    """The direction of travel, by which along and across are distinguished."""

    min_speed: float = Field(3.0, gt=0, le=30, description="m/s over ground; slower, the direction is kept")
    time_constant: float = Field(2.0, gt=0, le=60, description="s, with which it follows the course over ground")


class AssociationSettings(Settings):
    """How detections find their tracks."""

    method: Literal["nearest", "id"] = Field(
        "nearest",
        description="nearest: the sensor's id as first guess, global nearest neighbour for the rest; id: the id alone",
    )
    joint: bool = Field(
        True,
        description="of vehicles: where gates of obstacles overlap, a detection counts by its probability",
    )
    gate: float = Field(16.0, gt=1, le=1000, description="largest normalised innovation squared")
    id_gate: float = Field(
        40.0, gt=1, le=1e6, description="the same where the sensor keeps the id of a confirmed obstacle"
    )
    velocity_gate: float = Field(
        40.0,
        gt=1,
        le=1e6,
        description="of vehicles: the same for what a sensor without ids tells the velocity of, which differs most "
        "from what is expected",
    )
    least_mode: float = Field(
        3e-4,
        ge=1e-6,
        le=1,
        description="of vehicles: probability of a mode below which one that was lost is not looked for where that "
        "mode would have moved it",
    )
    mode_time: float = Field(
        0.5,
        ge=0,
        le=30,
        description="s for which one that was lost is looked for where a mode would have moved it, if detections have "
        "a place but no speed; what appears there later may take up its identity once confirmed",
    )


class CourseSettings(Settings):
    """When two obstacles that drive on one course are one vehicle; of the estimator `vehicle`."""

    speed: float = Field(4.0, gt=0, le=30, description="m/s of both, above which their course is known well enough")
    along: float = Field(4.5, gt=0, le=30, description="m along it from one to the other")
    across: float = Field(1.8, gt=0, le=5, description="m across it")
    faster: float = Field(1.5, gt=0, le=10, description="m/s along it by which they may differ")
    drift: float = Field(3.0, gt=0, le=10, description="m/s across it, which is known worst")
    time: float = Field(0.15, ge=0, le=10, description="s side by side, longer where their places are not clear …")
    clear: float = Field(
        0.8, gt=0.01, le=10, description="… m: twice as long where the variances of both places sum up to its square"
    )
    apart_for: float = Field(
        3.0, ge=0, le=60, description="s since its first detection, after which a confirmed one stays by itself …"
    )
    apart: float = Field(
        1.0,
        gt=0,
        le=5,
        description="… where it is farther than so many m across the course: it drives in another lane; within "
        "`along`, too, while one of the two is out of sight; and beside what is larger where it was found to ride or "
        "walk",
    )


class StoodSettings(Settings):
    """What stands is none of what has moved, and may lie in any direction from what it is one with; of `vehicle`."""

    time: float = Field(
        2.0, ge=0, le=60, description="s since its first detection, for which it was never faster than …"
    )
    speed: float = Field(0.7, ge=0, le=10, description="… m/s; what is slower stands")
    moved: float = Field(1.5, gt=0, le=30, description="m/s, what was ever faster has moved")
    apart: float = Field(
        2.0,
        ge=0,
        le=10,
        description="m between the nearest reflections of two that stand and show more: nearer, they are one though "
        "one scan shows both …",
    )
    extent: float = Field(4.5, gt=0, le=30, description="… where their leading reflections are nearer than so many m")
    apart_for: float = Field(
        3.0, ge=0, le=60, description="s since its first detection, after which what stands by itself stays by itself"
    )


class StraySettings(Settings):
    """When a reflection of what stands is someone who stood beside it, and walks away; of `vehicle`."""

    memory: float = Field(0.5, ge=0.05, le=10, description="s over which the speed of a single reflection is told")
    patience: float = Field(
        0.4,
        gt=0,
        le=10,
        description="s without it, or with outliers alone, after which it has slid and is followed anew; of a body "
        "that was ever faster than `fastest`, `reflections.patience` holds",
    )
    running: float = Field(5.0, gt=0, le=30, description="m/s; a reflection that is faster slides, and nobody runs so")
    distance: float = Field(0.4, gt=0, le=10, description="m that it walks, faster than `stood.speed` …")
    deviations: float = Field(
        1.6, ge=0, le=10, description="… and as many standard deviations of its place, while the leading one …"
    )
    still: float = Field(0.5, gt=0, le=60, description="… has stood for s; or the other way round")
    fastest: float = Field(2.5, gt=0, le=30, description="m/s, what was ever faster is a vehicle …")
    far: float = Field(
        4.0,
        ge=1,
        le=100,
        description="… of which a reflection walks that goes across its axis, or so many times as far as tells that "
        "one walks: nearer, it slides along a vehicle that brakes",
    )
    abreast: float = Field(
        8.0,
        ge=1,
        le=100,
        description="times as far as tells that one walks: so far all reflections of an obstacle walk without a stop "
        "until those side by side are several people",
    )


class AloneSettings(Settings):
    """When what always shows a single reflection is small, and no car of which one alone is seen; of `vehicle`."""

    within: float = Field(30.0, gt=0, le=200, description="m, so near that a car shows several before long")
    time: float = Field(
        2.5,
        gt=0,
        le=60,
        description="s at a walk after which it is small: a walker, faster a rider; two who walk side by side are not "
        "merged before",
    )
    faster: float = Field(
        0.25, ge=0, le=1, description="share with which the time counts that it is faster; standing tells nothing"
    )
    crossing: float = Field(
        1.7,
        ge=0,
        le=10,
        description="times the time counts that it crosses the line of sight, at any speed: a car seen from its side "
        "shows several soon",
    )


class RidersSettings(Settings):
    """When what drives in line is several riders, and no vehicle; of `vehicle`."""

    fastest: float = Field(9.0, gt=0, le=60, description="m/s, what was ever faster is no bicycle")
    time: float = Field(
        3.0,
        gt=0,
        le=60,
        description="s, for which the same two reflections are seen, with room for a bicycle and `edge` between and "
        "nothing there, from behind or ahead, until they are two",
    )


class ReflectionSettings(Settings):
    """When several detections are one vehicle."""

    merge: bool = Field(True, description="false: every object of the sensor is an obstacle")
    along: float = Field(3.5, gt=0, le=30, description="m along the travel from a known reflection")
    across: float = Field(1.2, gt=0, le=5, description="m across it")
    edge: float = Field(
        0.5,
        ge=0,
        le=5,
        description="m beyond the box of a vehicle whose size is known, and between those of two that are one",
    )
    speed: float = Field(
        1.2,
        gt=0,
        le=10,
        description="m/s difference of speed along the line of sight; from most detections of a vehicle: what differs "
        "more is none of it",
    )
    slide: float = Field(
        1.5,
        ge=0,
        le=10,
        description="m by which reflections may have slid over a vehicle since it was first seen: divided by its age, "
        "that is added to `speed` where a sensor tells velocities",
    )
    before: float = Field(
        2.0,
        gt=0,
        le=50,
        description="m nearer to a sensor than all that it has shown of a vehicle for `course.apart_for`, beyond which "
        "a detection is of something else",
    )
    extent: float = Field(15.0, gt=0, le=50, description="m, longest vehicle")
    widest: float = Field(
        2.5, gt=0, le=10, description="m, widest vehicle: what surely shows more across its axis is two, side by side"
    )
    following: float = Field(
        0.2,
        ge=0,
        le=5,
        description="s to a vehicle in which nobody follows: what is on its course there, as fast, is a part of it …",
    )
    following_gap: float = Field(
        5.0,
        ge=0,
        le=50,
        description="m, … but not as far as this, however fast the two are: what is long is no faster than lorries are",
    )
    beside: float = Field(
        0.7,
        ge=0,
        le=5,
        description="m beside its box, or `course.across` beside its leading reflection, within which that is on its "
        "course",
    )
    following_speed: float = Field(0.5, gt=0, le=10, description="m/s along the course by which the two may differ")
    course: CourseSettings = Field(default_factory=CourseSettings.defaults)
    stood: StoodSettings = Field(default_factory=StoodSettings.defaults)
    alone: AloneSettings = Field(default_factory=AloneSettings.defaults)
    stray: StraySettings = Field(default_factory=StraySettings.defaults)
    riders: RidersSettings = Field(default_factory=RidersSettings.defaults)
    merge_time: float = Field(
        0.5,
        ge=0,
        le=10,
        description="s side by side until two obstacles become one; by existence, what is younger than twice that is "
        "not confirmed meanwhile",
    )
    patience: float = Field(
        0.15,
        ge=0,
        le=2,
        description="s without a detection until another reflection leads: hand-over delay; for so long a reflection "
        "counts for the place of its vehicle, to other sensors for its length, and for `stood.apart`",
    )
    return_time: float = Field(
        2.0, gt=0, le=60, description="s, with which the reference point returns to the leading reflection"
    )


class LifecycleSettings(Settings):
    """Birth, confirmation, coasting, deletion."""

    by: Literal["existence", "hits"] = Field(
        "existence",
        description="existence: the probability of existence confirms and ends the obstacles of a vehicle estimator, "
        "and what nothing can see is not missed; hits: detections among scans, and the time without one",
    )
    confirm: int = Field(
        5, ge=1, le=32, description="scans with a detection that confirm a track; by existence: in succession …"
    )
    confirm_early: int = Field(
        3,
        ge=2,
        le=32,
        description="… where a sensor's false detections are found to be few and not to come again, unless `confirm` "
        "is given and this is not …",
    )
    false_rate: float = Field(
        1.0,
        gt=0,
        le=100,
        description="1/min, … so that this many false obstacles of all sensors of a group are confirmed at most",
    )
    window: int = Field(8, ge=1, le=32, description="… by hits: among so many")
    sure: float = Field(0.95, gt=0.5, lt=1, description="probability of existence that confirms")
    doubtful: float = Field(0.05, gt=0, lt=0.5, description="that below which a confirmed obstacle is given up")
    first_existence: float = Field(0.2, ge=0.01, le=0.5, description="that of what was detected once")
    mean_life: float = Field(30.0, ge=1, le=1e4, description="s that an obstacle exists which nobody looks at")
    hidden: float = Field(
        4.0,
        ge=0,
        le=30,
        description="s that a confirmed obstacle is remembered undetected, reported or not; by existence only",
    )
    coast: float = Field(
        1.0,
        gt=0,
        le=30,
        description="s that a confirmed obstacle lives on undetected, by existence: though it is in sight; never "
        "longer than it was seen",
    )
    image: float = Field(
        3.0,
        ge=0,
        le=30,
        description="s after its first detection, for which what is where an image of another vehicle would be, and "
        "moves like that, is not confirmed; by existence only",
    )
    shadow: float = Field(
        1.0,
        ge=0,
        le=30,
        description="s likewise, at most `image`, where that vehicle is as fast as we are and hides it, as in a convoy",
    )
    coast_share: float = Field(
        0.6, gt=0, le=1, description="of the time that it was seen, for which a vehicle is reported undetected at most"
    )
    tentative_coast: float = Field(0.12, gt=0, le=5, description="s that a tentative one does")
    reflection_coast: float = Field(
        0.4, gt=0, le=30, description="s that a reflection does while its obstacle has others"
    )
    uncertainty: float = Field(
        2.0,
        gt=0,
        le=100,
        description="m, standard deviation of its place with which an undetected obstacle is given up, or, where "
        "nothing can see it, only remembered",
    )
    first_speed: Pair = Field(
        default_factory=lambda: AlongAcross.defaults(along=25.0, across=5.0),
        description="m/s, standard deviation over ground of an unknown target, along and across our own heading",
    )

    @property
    def earliest(self) -> int:
        """Detections in succession that confirm at least, by existence."""
        given = self.model_fields_set
        return self.confirm if "confirm" in given and "confirm_early" not in given else self.confirm_early

    @model_validator(mode="after")
    def _window_holds_the_hits(self) -> LifecycleSettings:
        if self.confirm > self.window:
            raise ValueError(f"confirm {self.confirm} of window {self.window} can never be reached; raise window")
        return self


class TrackerSettings(Settings):
    """How detections become obstacles."""

    estimator: EstimatorSettings = Field(default_factory=lambda: VehicleEstimatorSettings.defaults(kind="vehicle"))
    travel: TravelSettings = Field(default_factory=TravelSettings.defaults)
    association: AssociationSettings = Field(default_factory=AssociationSettings.defaults)
    reflections: ReflectionSettings = Field(default_factory=ReflectionSettings.defaults)
    lifecycle: LifecycleSettings = Field(default_factory=LifecycleSettings.defaults)
    max_tracks: int = Field(
        512, ge=1, le=MOST_TRACKS, description="reflections kept at once; what comes beyond is counted and dropped"
    )


class GroupSettings(Settings):
    """Sensors that are tracked on their own, apart from the others."""

    sensors: tuple[Name, ...] = Field(min_length=1, description="names of the sensors")
    tracker: TrackerSettings = Field(default_factory=TrackerSettings.defaults)
    fusion: Literal["central", "federated", "trilateration", "tracks"] = Field(
        "central",
        description="central: one filter takes all scans; federated: a local filter for each sensor, fused after every "
        "scan; trilateration: of sensors that tell ranges and no direction; tracks: by covariance intersection, for "
        "sensors that filter by themselves",
    )
    align: Literal["prediction", "lagrange"] = Field(
        "prediction",
        description="prediction: each scan is tracked at its own instant; lagrange: objects of the faster sensors are "
        "interpolated to the instants of the slowest, which wait for them",
    )

    @property
    def single_model(self) -> SingleModelEstimatorSettings | None:
        """The estimator whose one motion model the local filters have; None where it has none, or several."""
        if "estimator" not in self.tracker.model_fields_set:
            return CaEstimatorSettings(kind="ca", noise=AlongAcross(along=5.0, across=5.0))
        estimator = self.tracker.estimator
        return estimator if isinstance(estimator, SINGLE_MODEL) else None

    @property
    def fused_tracker(self) -> TrackerSettings:
        """The tracker with the estimator that the mode of fusion needs."""
        if self.fusion == "trilateration":
            if "estimator" in self.tracker.model_fields_set:
                return self.tracker
            return self.tracker.model_copy(update={"estimator": RANGES_ESTIMATOR})
        single = self.single_model
        if self.fusion == "central" or single is None:
            return self.tracker
        kind = FederatedEstimatorSettings if self.fusion == "federated" else IntersectionEstimatorSettings
        given = {name: getattr(single, name) for name in kind.model_fields if name in type(single).model_fields}
        name = "federated" if self.fusion == "federated" else "intersection"
        estimator = kind.model_validate(given | {"kind": name, "model": single})
        return self.tracker.model_copy(update={"estimator": estimator})
