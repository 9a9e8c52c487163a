"""What measurements in real traffic show beyond white noise on fixed points: settings of a scenario, off without them.

Each group is switched on by naming it, `{}` for its defaults; these are what recorded object radars show, as far as
their descriptions say nothing else.
"""

from __future__ import annotations

from typing import Final, Literal

from pydantic import Field, model_validator

from candaemon.config.base import Settings
from candaemon.config.names import Name


class ReflectionEffects(Settings):
    """Which points of a body a sensor sees: where rays at drawn shares of its apparent width meet its outline.

    The first one of a body is always there, until it is given up for another; the others come and go.
    """

    fewest: int = Field(2, ge=1, le=8, description="of a car or truck that does not say its `reflections`")
    most: int = Field(4, ge=1, le=8, description="likewise; a two-wheeler has 2 at most, a pedestrian and a point 1")
    shown: float = Field(2.0, gt=0.01, le=1000, description="s, mean time for which one after the first is seen")
    gone: float = Field(1.0, gt=0.01, le=1000, description="s, mean time until another one takes its place")
    renewal: float = Field(10.0, gt=0.01, le=1000, description="s, mean time until the first is another object")
    slide: float = Field(
        0.3, ge=0, le=10, description="m across the sight, how far one wanders on the outline (standard deviation)"
    )
    slide_time: float = Field(1.0, gt=0.01, le=100, description="s, correlation time of that: wheels and edges pass")
    depth: float = Field(
        0.5, ge=0, le=5, description="m, greatest depth of a reflection within the outline: wheels, axles, the engine"
    )
    merging: float = Field(
        0.6, ge=0, le=20, description="m between two of a body that become one object; they part from 1.5 times that on"
    )

    @model_validator(mode="after")
    def _ends_are_in_order(self) -> ReflectionEffects:
        if self.fewest > self.most:
            raise ValueError(f"found fewest {self.fewest} above most {self.most}; exchange them")
        return self


class NoiseCorrelation(Settings):
    """The part of the noise's variance that a radar's own filter has made a slow one; the whole stays what it is."""

    time: float = Field(0.3, gt=0.001, le=10, description="s, correlation time")
    near: float = Field(0.3, ge=0, le=1, description="share of the variance next to the sensor")
    far: float = Field(0.7, ge=0, le=1, description="share at `range` and beyond")
    range: float = Field(100.0, gt=0, le=1000, description="m")


class OwnFilter(Settings):
    """A radar that filters its objects by itself: positions are a random walk about the truth, with sudden slides.

    In place of the sensor's noise of positions. Makes measured: 0.05 m white, a walk of 0.06 to 0.4 m²/s.
    """

    white: float = Field(0.05, gt=0, le=10, description="m, standard deviation of the white part, along and across")
    walk: float = Field(0.15, ge=0, le=10, description="m²/s, power spectral density of the walk across the sight")
    walk_along: float = Field(0.01, ge=0, le=10, description="m²/s, likewise along the sight, where range is measured")
    return_time: float = Field(5.0, gt=0.1, le=1000, description="s, with which walk and slides return to the truth")
    slides: float = Field(0.01, ge=0, le=10, description="1/s, how often each object begins to slide sideways")
    slowest: float = Field(3.0, gt=0, le=50, description="m/s of a slide")
    fastest: float = Field(7.0, gt=0, le=50, description="m/s of a slide")
    shortest: float = Field(1.0, gt=0, le=50, description="m of a slide")
    longest: float = Field(4.0, gt=0, le=50, description="m of a slide")

    @model_validator(mode="after")
    def _ends_are_in_order(self) -> OwnFilter:
        if self.slowest > self.fastest or self.shortest > self.longest:
            raise ValueError("slowest is above fastest, or shortest above longest; exchange them")
        return self


class GhostEffects(Settings):
    """False objects that move with true ones: echoes that went twice between both vehicles, or by a guard rail."""

    double_bounce: float = Field(0.02, ge=0, le=10, description="1/s, how often each actor within `reach` gets one")
    mirrored: float = Field(0.05, ge=0, le=10, description="1/s, likewise beside a rail, behind which it then is")
    time: float = Field(0.8, gt=0.01, le=100, description="s, mean time that one lasts")
    reach: float = Field(40.0, gt=0, le=1000, description="m")


class TrafficEffects(Settings):
    """How bodies in traffic are reported."""

    reflections: ReflectionEffects = Field(default_factory=ReflectionEffects)
    correlation: NoiseCorrelation = Field(default_factory=NoiseCorrelation)
    own_filter: OwnFilter | None = Field(None, description="default: the radar does not filter")
    ghosts: GhostEffects = Field(default_factory=GhostEffects)
    swaps: float = Field(
        0.005, ge=0, le=10, description="1/s, how often two neighbours exchange their slots, and nothing tells of it"
    )
    swap_distance: float = Field(5.0, ge=0, le=100, description="m between such neighbours")
    coasting: float = Field(
        0.5, ge=0, le=1, description="probability that an object of which nothing is seen is moved on, not left out"
    )
    size_noise: float = Field(0.15, ge=0, le=1, description="of length and width, most of it the same for an object")


class TransmissionFaults(Settings):
    """Frames that are lost together, and stamps that several share."""

    bursts: float = Field(0.1, ge=0, le=10, description="1/s, how often frames begin to get lost")
    burst_time: float = Field(0.1, gt=0.001, le=10, description="s, mean length of that")
    burst_loss: float = Field(0.7, ge=0, le=1, description="probability that a frame is lost meanwhile")
    lost_scans: float = Field(0.005, ge=0, le=1, description="probability that a whole scan does not come")
    batch: float = Field(0.004, ge=0, le=0.1, description="s; frames have the time at which an adapter handed them on")


SensorFaultKind = Literal["silent", "frozen", "biased", "drifting", "noisy"]
_AMOUNTS: Final = {"biased": 3.0, "drifting": 1.0, "noisy": 200.0}


class SensorFault(Settings):
    """A time in which a sensor fails, and how."""

    sensor: Name = Field(description="name in the configuration")
    kind: SensorFaultKind = Field(
        description="silent: it sends nothing; frozen: the same objects again and again; biased, drifting: they are "
        "farther than they are; noisy: its noise is greater"
    )
    begin: float = Field(ge=0, le=1e5, description="s")
    end: float = Field(ge=0, le=1e5, description="s")
    amount: float | None = Field(
        None,
        ge=-1000,
        le=1e5,
        description="m of a bias, m/s of a drift, times the variance of the noise configured; default: 3 m, 1 m/s, 200",
    )

    @model_validator(mode="after")
    def _is_whole(self) -> SensorFault:
        if self.end <= self.begin:
            raise ValueError(f"end {self.end:g} is not after begin {self.begin:g}")
        if self.amount is not None and self.kind not in _AMOUNTS:
            raise ValueError(f"amount is given but a {self.kind} sensor has none; leave it out")
        if self.kind == "noisy" and self.size < 1.0:
            raise ValueError(f"found amount {self.size:g}, expected 1 or more: times the variance")
        return self

    @property
    def size(self) -> float:
        """Amount, as given or by default; 0 where there is none."""
        return _AMOUNTS.get(self.kind, 0.0) if self.amount is None else self.amount


class OwnMotionFaults(Settings):
    """What goes wrong with an INS: its heading is off, its position jumps, it is silent. Odometry is silent only."""

    heading_bias_deg: float = Field(0.3, ge=-10, le=10, description="deg, of the heading, as after careless mounting")
    step_interval: float = Field(15.0, gt=0.1, le=1e5, description="s, mean time between steps of the position")
    step: float = Field(1.5, ge=0, le=1000, description="m, standard deviation of a step to the north and to the east")
    gap_interval: float = Field(20.0, gt=0.1, le=1e5, description="s, mean time between gaps")
    gap: float = Field(0.3, gt=0.001, le=60, description="s, mean length of a gap")
