"""Sensors: assembly of frames into scans, mapping of signals to quantities, measurement noise."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field, model_validator

from candaemon.config.base import Condition, CrossReferenceError, Location, ObjectSignal, RawValue, Settings, Units
from candaemon.config.directions import Pair
from candaemon.config.names import DbcName, FilePath, Name
from candaemon.config.numbers import SignalValue
from candaemon.config.protection import InputProtectionSettings, PlausibilitySettings, SensorProtectionSettings


class Mount(Settings):
    """A sensor's pose in vehicle axes (x forward, y left, origin under the rear axle's centre)."""

    x: float = Field(0.0, ge=-30, le=30, description="m forward")
    y: float = Field(0.0, ge=-5, le=5, description="m to the left")
    yaw_deg: float = Field(0.0, ge=-180, le=180, description="deg, positive to the left")


_NUMBER = re.compile(r"\{(slot|point|object)(:0?[1-9]?[dxX])?\}")
"""What stands in a name for the number of a slot, of a point in its message, of an object of all messages."""
MOST_POINTS: Final = 64
"""Objects in one message: a byte of a CAN FD frame each."""


def _message_from_text(value: Any) -> Any:
    """Convert the bare name of a message to an entry."""
    return {"message": value} if isinstance(value, str) else value


class ObjectMessage(Settings):
    """One message of an object. `{slot}` in the name stands for the slot's number."""

    message: DbcName = Field(description="message name; `{slot}`, `{slot:02d}` … stands for the slot's number")
    id_signal: DbcName | Literal[False] | None = Field(
        None,
        description="signal of this message that says which object it is of; false: frames come in the objects' order",
    )
    when: dict[DbcName, RawValue] = Field(
        default_factory=dict,
        max_length=1,
        description="signal: value; only frames with that value are of this entry, others are of another one, "
        "or of another sensor",
    )
    optional: bool = Field(False, description="an object is used without this message too")
    protection: InputProtectionSettings | None = Field(
        None, description="of this message; default: that of the sensor or the output"
    )

    @model_validator(mode="after")
    def _name_has_only_slot(self) -> ObjectMessage:
        found = [match.group(1) for match in _NUMBER.finditer(self.message)]
        if not set(_NUMBER.sub("", self.message)).isdisjoint("{}") or set(found) - {"slot"}:
            raise ValueError(
                f"'{self.message}' has braces that are not {{slot}}, or such as {{slot:02d}} or {{slot:x}} (9 digits)"
            )
        return self

    def named(self, number: int) -> str:
        """Name of the message for the slot of this number."""
        return self.message.format(slot=number)


def is_numbered(name: str) -> bool:
    """Return whether numbers of slots, points or objects stand in a signal's name."""
    return _NUMBER.search(name) is not None and set(_NUMBER.sub("", name)).isdisjoint("{}")


Messages = tuple[
    Annotated[ObjectMessage, BeforeValidator(_message_from_text, json_schema_input_type=DbcName | ObjectMessage)], ...
]


def _counted(value: Any) -> Any:
    """Convert a number of points to their numbers, from 0."""
    counts = isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST_POINTS
    return tuple(range(value)) if counts else value


_Point = Annotated[int, Field(ge=0, le=1_000_000)] | DbcName
Points = Annotated[
    tuple[_Point, ...],
    Field(min_length=1, max_length=MOST_POINTS),
    BeforeValidator(_counted, json_schema_input_type=Annotated[int, Field(ge=1, le=MOST_POINTS)] | tuple[_Point, ...]),
]
MOST_SLOTS: Final = 4096
"""Objects that a format can hold."""


MOST_PAGES: Final = 64
"""Pages of a list of objects."""


class PageSettings(Settings):
    """A list longer than its messages: they come again with the next page."""

    signal: DbcName = Field(description="signal of each of the objects' messages that says which page a frame is of")
    count: int = Field(ge=2, le=MOST_PAGES, description="pages of a full list")
    first: int = Field(0, ge=0, le=1_000_000, description="the signal's value on the first page")
    step: int = Field(
        1,
        ge=1,
        le=1_000_000,
        description="difference of its values on neighbouring pages; where it is the number of a "
        "page's first object, the objects of a page",
    )


class ObjectFormat(Settings):
    """Where the objects lie in the frames; serves reading and writing alike."""

    messages: Messages = Field(min_length=1, description="the messages that together make one object")
    slots: int = Field(ge=1, le=MOST_SLOTS, description="objects the format can hold")
    first: int = Field(0, ge=0, le=1_000_000, description="number of the first slot in the names")
    step: int = Field(1, ge=1, le=1_000_000, description="difference of the numbers of neighbouring slots")
    points: Points = Field(
        (0,),
        description="objects in one message: how many, or a list of what `{point}` stands for in their signals' names",
    )
    pages: PageSettings | None = Field(
        None, description="pages of a list that its messages do not hold at once; `slots` counts the objects of all"
    )
    identity: DbcName | Literal[False] | None = Field(
        None,
        description="signal that is the object's identity; default: the slot is; false: it has none",
    )
    pair: tuple[DbcName, ...] = Field((), description="signals, one a message, that must be equal within an object")
    valid: tuple[Condition, ...] = Field((), description="all must hold for an object to be used")
    new: tuple[Condition, ...] = Field((), description="all hold on an object's first appearance in its slot")
    empty: dict[DbcName, SignalValue] = Field(
        default_factory=dict, description="signal values that write an empty slot"
    )
    fixed: dict[DbcName, SignalValue] = Field(
        default_factory=dict, description="signal values that write any occupied slot"
    )

    @model_validator(mode="after")
    def _slots_are_distinguishable(self) -> ObjectFormat:
        by_name = ["{slot" in entry.message for entry in self.messages]
        for entry, numbered in zip(self.messages, by_name, strict=True):
            if not numbered and entry.id_signal is None and self.places_on_page > 1:
                raise ValueError(
                    f"message '{entry.message}' is the same for all {self.places_on_page} slots; "
                    "put {slot} into its name or give its id_signal"
                )
        if any(by_name) and not all(by_name):
            raise ValueError("either every message of an object has {slot} in its name or none has")
        return self

    @model_validator(mode="after")
    def _points_fill_the_slots(self) -> ObjectFormat:
        if self.slots % len(self.points):
            raise ValueError(
                f"{self.slots} slots are no whole number of messages with {len(self.points)} points each; "
                "slots counts the objects of all messages"
            )
        return self

    @model_validator(mode="after")
    def _pages_fill_the_slots(self) -> ObjectFormat:
        if self.pages is not None and self.places % self.pages.count:
            raise ValueError(
                f"{self.places} messages are no whole number on each of {self.pages.count} pages; "
                "slots counts the objects of all pages"
            )
        if self.pages is not None and any(entry.id_signal is False for entry in self.messages):
            raise ValueError("id_signal: false counts the frames of a scan, whatever their page; leave pages out")
        return self

    @model_validator(mode="after")
    def _order_is_of_one_message(self) -> ObjectFormat:
        if any(entry.id_signal is False for entry in self.messages) and len(self.messages) > 1:
            raise ValueError("id_signal: false is for an object of one message; several need what tells objects apart")
        return self

    @model_validator(mode="after")
    def _new_is_of_an_identity(self) -> ObjectFormat:
        if self.identity is False and self.new:
            raise ValueError("identity is false, so no slot keeps its object, but new is given; leave one of them out")
        return self

    @property
    def places(self) -> int:
        """Messages that a scan can hold of each of an object's messages."""
        return self.slots // len(self.points)

    @property
    def places_on_page(self) -> int:
        """Places on a page; all, where there are none."""
        return self.places // (1 if self.pages is None else self.pages.count)

    @property
    def multiplexed(self) -> bool:
        """Whether all objects share the same messages and an id in the payload distinguishes them."""
        return "{slot" not in self.messages[0].message


class CounterScan(Settings):
    """Frames with the same counter are one scan; a scan closes when all came, when the counter changes, or late."""

    close: Literal["counter"]
    signal: DbcName = Field(description="counter signal in every object message")


_MARK_WHEN: Final = (
    "signal: value; only frames with that value are meant, others of the identifier are the objects', "
    "or another sensor's"
)


class TriggerScan(Settings):
    """A scan closes with a certain message."""

    close: Literal["trigger"]
    message: DbcName = Field(description="message that ends a scan; one of the objects' or another")
    when: dict[DbcName, RawValue] = Field(default_factory=dict, max_length=1, description=_MARK_WHEN)
    protection: InputProtectionSettings = Field(
        default_factory=InputProtectionSettings.defaults, description="of the message, where it is none of the objects'"
    )


def _listed(value: Any) -> Any:
    """Convert a single name to a list of one."""
    return (value,) if isinstance(value, str) else value


MOST_HEADERS: Final = 8
"""Header messages of a scan, and signals that add up to the number of its objects."""
Names = Annotated[
    tuple[DbcName, ...],
    Field(min_length=1, max_length=MOST_HEADERS),
    BeforeValidator(_listed, json_schema_input_type=tuple[DbcName, ...] | DbcName),
]


class HeaderScan(Settings):
    """A scan opens with a header message that says how many objects follow."""

    close: Literal["header"]
    message: Names = Field(description="header message, or the list of those that a scan has")
    when: dict[DbcName, RawValue] = Field(default_factory=dict, max_length=1, description=_MARK_WHEN)
    count: Names = Field(
        description="their signal with the number of objects that follow, or signals that add up to it"
    )
    counter: DbcName | None = Field(None, description="its measurement counter, by which a missed scan is noticed")
    used_only: bool = Field(
        True, description="only the objects counted are sent; false: all slots are, count gives how many are occupied"
    )
    protection: InputProtectionSettings = Field(
        default_factory=InputProtectionSettings.defaults, description="of the header message"
    )


class TimeoutScan(Settings):
    """A scan closes when no further frame of it came for a while, or all came."""

    close: Literal["timeout"]


ScanSettings = Annotated[CounterScan | TriggerScan | HeaderScan | TimeoutScan, Field(discriminator="close")]


class ObjectSignals(Settings):
    """Which signal is which quantity of an object, in sensor axes (x ahead, y left), relative to the sensor."""

    x: ObjectSignal | None = Field(None, description="position ahead, m")
    y: ObjectSignal | None = Field(None, description="position to the left, m")
    range: ObjectSignal | None = Field(None, description="distance, m")
    azimuth: ObjectSignal | None = Field(None, description="direction, positive to the left")
    range_rate: ObjectSignal | None = Field(None, description="speed along the line of sight, positive away")
    vx: ObjectSignal | None = Field(None, description="relative velocity along x")
    vy: ObjectSignal | None = Field(None, description="relative velocity along y (lateral rate)")
    ax: ObjectSignal | None = Field(None, description="relative acceleration along x, or along the line of sight")
    width: ObjectSignal | None = Field(None, description="width, m; 0 where it is not known")
    length: ObjectSignal | None = Field(None, description="length, m; 0 where it is not known")
    heading: ObjectSignal | None = Field(None, description="direction of its front from the sensor's x, to the left")
    score: ObjectSignal | None = Field(None, description="the sensor's own confidence")

    @model_validator(mode="after")
    def _has_a_position(self) -> ObjectSignals:
        cartesian = (self.x is not None, self.y is not None)
        polar = (self.range is not None, self.azimuth is not None)
        if any(cartesian) and any(polar):
            raise ValueError("give a position either as x and y or as range and azimuth, not parts of both")
        if not all(cartesian) and self.range is None:
            raise ValueError("no position; give x and y, or range and azimuth")
        if self.range_rate is not None and self.vx is not None:
            raise ValueError("range_rate and vx measure the same; give one")
        return self

    @property
    def polar(self) -> bool:
        """Whether positions come as range and azimuth."""
        return self.range is not None

    @property
    def directed(self) -> bool:
        """Whether it is told in which direction an object is; without, several sensors find its place together."""
        return self.range is None or self.azimuth is not None


class ErrorCorrelation(Settings):
    """The part of the noise's variance that lasts longer than a scan, as a radar smooths over several."""

    share: float = Field(0.5, ge=0, le=1, description="of the variance that is correlated")
    time: float = Field(0.3, gt=0.01, le=10, description="s, correlation time of that")


class ObjectNoise(Settings):
    """One standard deviation of each measured quantity; those the signals name are needed."""

    x: float | None = Field(None, gt=0, le=50, description="m")
    y: float | None = Field(None, gt=0, le=50, description="m")
    range: float | None = Field(None, gt=0, le=50, description="m")
    azimuth_deg: float | None = Field(None, gt=0, le=20, description="deg")
    range_rate: float | None = Field(None, gt=0, le=20, description="m/s")
    vx: float | None = Field(None, gt=0, le=20, description="m/s")
    vy: float | None = Field(None, gt=0, le=20, description="m/s")
    walk: Pair | None = Field(
        None,
        description="m²/s, random walk of reflections along and across the travel, of a sensor that filters by itself; "
        "default: learnt",
    )
    correlation: ErrorCorrelation | None = Field(
        None, description="of the noise from scan to scan, as far as it does not walk; default: learnt"
    )


class FieldOfView(Settings):
    """What the sensor can see; used by the simulation, and by the tracker to know what it should see."""

    range: float = Field(150.0, gt=0, le=1000, description="m")
    min_range: float = Field(1.0, ge=0, le=50, description="m")
    azimuth_deg: float = Field(45.0, gt=0, le=180, description="deg, half the opening angle")
    yaw_deg: float = Field(
        0.0, ge=-180, le=180, description="deg from the sensor's x axis to the middle of it, positive to the left"
    )


MOST_LOOKS: Final = 16
"""Looks that a sensor can take in turn."""


LookNumber = Annotated[str, Field(pattern=r"^(0|[1-9]\d*)$", min_length=1, max_length=5)]
"""A key that is a number: keys are text."""


class LookSettings(Settings):
    """Looks that a sensor takes in turn: each scan is one of them, with a field of view of its own."""

    signal: DbcName = Field(
        description="signal that says which look a scan is: of its header or trigger, or of the objects' messages"
    )
    fields_of_view: dict[LookNumber, FieldOfView] = Field(
        min_length=1, max_length=MOST_LOOKS, description="what each look can see, by the signal's value"
    )


class TimeStampSettings(Settings):
    """A signal in which the sensor says when it measured: better than when its frames arrive."""

    signal: DbcName = Field(
        description="of the scan's header or trigger, of the objects' messages, or MESSAGE.SIGNAL of a message of its "
        "own that comes once a scan"
    )
    kind: Literal["age", "clock"] = Field(
        description="age: the time since the measurement; clock: the sensor's own clock at the measurement"
    )
    unit: Literal["s", "ms", "us", "ns"] | None = Field(None, description="of the signal; default: the DBC's")
    wrap: float | None = Field(
        None, ge=0.1, le=4.3e9, description="s after which the clock begins anew; default: what the signal's bits hold"
    )
    longest: float = Field(
        0.25, ge=0.001, le=0.5, description="s, longest delay from the measurement to the arrival that can be"
    )

    @model_validator(mode="after")
    def _wraps_if_a_clock(self) -> TimeStampSettings:
        if self.wrap is not None and self.kind != "clock":
            raise ValueError(f"wrap is a clock's but kind is {self.kind}; leave one of them out")
        if self.wrap is not None and self.wrap <= 2 * self.longest:
            raise ValueError(f"wrap is {self.wrap:g} s, expected more than twice the longest delay, {self.longest:g} s")
        return self


class DetectionSettings(Settings):
    """How well a sensor detects, as far as it has not been learnt from its scans."""

    probability: float = Field(
        0.95, ge=0.1, le=0.99, description="of detecting what is in sight and was detected by the scan before"
    )
    gap: float = Field(
        0.15, ge=0.01, le=10, description="s, mean time for which the sensor does not detect an obstacle in sight"
    )
    clutter: float = Field(
        1e-5, ge=1e-9, le=1, description="detections of a scan that belong to nothing, per m² of the field of view"
    )


class LfmFskSettings(Settings):
    """A radar front end with two intertwined chirps (LFM-FSK, Avatirak et al. 2012); used by the simulation only.

    The defaults resolve 1 m and 0.39 m/s and are unambiguous up to 261 m.
    """

    kind: Literal["lfm_fsk"]
    carrier: float = Field(77e9, ge=1e9, le=1e12, description="Hz")
    bandwidth: float = Field(150e6, ge=1e6, le=1e10, description="Hz, swept by a chirp; resolves c / (2 bandwidth)")
    chirp_time: float = Field(
        5e-3, ge=1e-5, le=0.1, description="s, length of the measurement; resolves wavelength / (2 chirp_time)"
    )
    steps: int = Field(
        1024, ge=16, le=65_536, description="of a chirp; beat frequencies are unambiguous over so many cells"
    )
    step_frequency: float = Field(
        500e3,
        ge=1e3,
        le=1e8,
        description="Hz by which the second chirp lies below the first; the larger, the better the range is measured, "
        "and the smaller the unambiguous range",
    )
    oversampling: int = Field(
        16, ge=1, le=1024, description="lines of the Fourier transform in a cell; beat frequencies are read to one line"
    )
    snr_db: float = Field(
        60.0, ge=0, le=120, description="dB, of a target at 50 m after the Fourier transform; less by 12 dB at 100 m"
    )
    threshold_db: float = Field(12.0, ge=0, le=60, description="dB, signal-to-noise ratio below which nothing is seen")


class SensorSettings(Settings):
    """One sensor that reports objects."""

    kind: Literal["radar", "lidar", "camera"] = Field("radar", description="what it is; shown to the user")
    bus: Name = Field(description="name of the bus")
    dbc: FilePath = Field(description="DBC file, relative to this YAML")
    id_offset: int = Field(
        0,
        ge=-0x1FFF_FFFF,
        le=0x1FFF_FFFF,
        description="what this sensor's identifiers are more than the DBC's, such as 0x20 or -32: "
        "radars of one kind on one bus are told so",
    )
    mount: Mount = Field(default_factory=Mount.defaults)
    cycle_time: float = Field(ge=0.001, le=2, description="s between scans")
    timeout: float = Field(0.03, gt=0, le=2, description="s after a scan's first frame until it is closed as it is")
    latency: float = Field(0.0, ge=-0.5, le=0.5, description="s from measurement to the scan's time stamp")
    time_from: Literal["first", "last"] = Field("first", description="which frame of a scan gives its time stamp")
    time_stamp: TimeStampSettings | None = Field(
        None, description="signal that gives the instant of the measurement; default: the frames' arrival does"
    )
    objects: ObjectFormat
    scan: ScanSettings
    signals: ObjectSignals
    units: Units = Field(default_factory=Units.defaults, description="of signals without a unit of their own")
    noise: ObjectNoise
    rates: Literal["of_position", "over_ground", "absolute"] = Field(
        "of_position",
        description="vx and vy are rates of x and y in the turning sensor axes, or velocity differences, or velocities "
        "over ground",
    )
    range_rates: Literal["relative", "absolute"] = Field(
        "relative", description="range_rate is that of the distance, or compensated for the own motion already"
    )
    field_of_view: FieldOfView = Field(default_factory=FieldOfView.defaults)
    looks: LookSettings | None = Field(
        None, description="looks with different fields of view, in turn; default: each scan sees field_of_view"
    )
    detection: DetectionSettings = Field(default_factory=DetectionSettings.defaults)
    protection: SensorProtectionSettings = Field(default_factory=SensorProtectionSettings.defaults)
    plausibility: PlausibilitySettings = Field(default_factory=PlausibilitySettings.defaults)
    front_end: LfmFskSettings | None = Field(
        None, description="how the simulation makes range and range rate; default: truth with the noise above"
    )

    @property
    def identified(self) -> bool:
        """Whether its object ids say which object it was in the scan before."""
        return self.objects.identity is not False

    @property
    def views(self) -> Mapping[int, FieldOfView]:
        """What its scans can see, by their look; −1 where they have none."""
        if self.looks is None:
            return {-1: self.field_of_view}
        return {int(look): view for look, view in self.looks.fields_of_view.items()}

    @property
    def revisit_time(self) -> float:
        """Time after which it has looked everywhere, s."""
        return self.cycle_time * len(self.views)

    @model_validator(mode="after")
    def _sees_by_looks_or_without(self) -> SensorSettings:
        if self.looks is not None and "field_of_view" in self.model_fields_set:
            raise ValueError("looks give a field of view each, but field_of_view is given too; leave one of them out")
        return self

    @model_validator(mode="after")
    def _order_begins_with_a_scan(self) -> SensorSettings:
        if isinstance(self.scan, CounterScan) and any(entry.id_signal is False for entry in self.objects.messages):
            raise ValueError("frames without an id are counted from a scan's begin, which close: counter does not show")
        return self

    @model_validator(mode="after")
    def _front_end_is_a_radars(self) -> SensorSettings:
        if self.front_end is not None and self.kind != "radar":
            raise ValueError(f"front_end is a radar's but kind is {self.kind}; leave one of them out")
        if self.front_end is not None and "absolute" in {self.rates, self.range_rates}:
            raise ValueError(
                "front_end measures relative rates, but they are said to be absolute; leave one of them out"
            )
        return self

    @model_validator(mode="after")
    def _noise_is_complete(self) -> SensorSettings:
        problems = tuple(self._noise_problems())
        if problems:
            raise CrossReferenceError(problems)
        return self

    def _noise_problems(self) -> Iterator[tuple[Location, str]]:
        """Yield each quantity that is measured and has no noise, or the other way round."""
        for quantity in ("x", "y", "range", "azimuth", "range_rate", "vx", "vy"):
            field = "azimuth_deg" if quantity == "azimuth" else quantity
            measured, known = getattr(self.signals, quantity) is not None, getattr(self.noise, field) is not None
            if measured and not known:
                unit = ObjectNoise.model_fields[field].description
                text = f"missing, for signals.{quantity} is measured; expected one standard deviation of it in {unit}"
                yield ("noise", field), text
            if known and not measured:
                yield ("noise", field), f"given, but no signal gives signals.{quantity}; leave one out, or give both"
