"""Common parts of all settings: strict, frozen models, and references to signals."""

from __future__ import annotations

import math
from inspect import signature
from typing import Annotated, Any, Final, Literal, Self, TypeAlias, cast

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, field_validator, model_validator

from candaemon.config.names import DbcName
from candaemon.config.numbers import SMALLEST, Factor, SignalValue
from candaemon.frames.bodies import CLASSES

Location: TypeAlias = tuple[str | int, ...]
"""Path of keys and list positions from the YAML's root."""


class CrossReferenceError(ValueError):
    """One part of the configuration does not fit another: it names what is not there, or lacks what the other needs.

    Attributes:
        problems: (location, text) of each, from the settings whose validator raises it.

    """

    def __init__(self, problems: tuple[tuple[Location, str], ...]) -> None:
        self.problems = problems
        super().__init__("; ".join(f"{'.'.join(map(str, location))}: {text}" for location, text in problems))


Unit = Literal["m", "rad", "deg", "m/s", "km/h", "mph", "rad/s", "deg/s", "m/s^2", "g", "1/m", "s", "%", "1"]

UNIT_FACTORS: dict[str, float] = {
    "m": 1.0,
    "rad": 1.0,
    "deg": math.pi / 180,
    "m/s": 1.0,
    "km/h": 1 / 3.6,
    "mph": 0.44704,
    "rad/s": 1.0,
    "deg/s": math.pi / 180,
    "m/s^2": 1.0,
    "g": 9.80665,
    "1/m": 1.0,
    "s": 1.0,
    "%": 0.01,
    "1": 1.0,
}
"""SI value of one unit."""


def _not_next_to_nothing(value: Any) -> Any:
    """Refuse numbers so small that products of them vanish."""
    numbers = value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else (value,)
    for number in numbers:
        if isinstance(number, float) and 0.0 < abs(number) < SMALLEST:
            raise ValueError(f"found {number:g}, expected 0 or a magnitude of at least {SMALLEST:g}")
    return value


# pydantic asks for it once a field: to find it again took a tenth of the time that a configuration takes to be loaded
setattr(_not_next_to_nothing, "__signature__", signature(_not_next_to_nothing))  # noqa: B010  # functions are typed without


class Settings(BaseModel):
    """Base of all settings: unknown keys are errors, values are checked once and frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    _numbers = field_validator("*")(_not_next_to_nothing)

    @classmethod
    def defaults(cls, **values: Any) -> Self:
        """Return the settings of a section that gives these values, which are not checked, and no others.

        To check a section's own defaults, pydantic would build its schema a second time.
        """
        return cast("Self", cls.model_construct(**values))  # mypy's plugin of pydantic types it by this class

    def dumped(self) -> dict[str, Any]:
        """Return what `model_dump(mode="json", by_alias=True)` returns, for which pydantic would build serializers."""
        fields = type(self).model_fields
        return {fields[name].alias or name: _dumped(value) for name, value in self.__dict__.items()}


def _dumped(value: Any) -> Any:
    if isinstance(value, Settings):
        return value.dumped()
    if isinstance(value, dict):
        return {key: _dumped(each) for key, each in value.items()}
    return [_dumped(each) for each in value] if isinstance(value, tuple) else value


MOST_UNKNOWN: Final = 16
"""Values of a signal that say that a quantity is not known."""


def _several(value: Any) -> Any:
    """Convert a single value to a list of one."""
    return (value,) if isinstance(value, int | float) and not isinstance(value, bool) else value


RawValue = Annotated[int, Field(ge=-(2**63), lt=2**64)]
UnknownValues = Annotated[
    tuple[SignalValue, ...],
    Field(max_length=MOST_UNKNOWN),
    BeforeValidator(_several, json_schema_input_type=tuple[SignalValue, ...] | SignalValue),
]
UnknownRaws = Annotated[
    tuple[RawValue, ...],
    Field(max_length=MOST_UNKNOWN),
    BeforeValidator(_several, json_schema_input_type=tuple[RawValue, ...] | RawValue),
]


class Units(Settings):
    """Units of signals whose own entry gives none and of which the DBC names none either."""

    length: Literal["m", "dm", "cm", "mm"] = Field("m", description="of positions and sizes")
    angle: Literal["deg", "rad"] | None = Field(None, description="of directions; default: each signal must say")
    speed: Literal["m/s", "km/h", "mph"] = Field("m/s", description="of speeds and range rates")
    rate: Literal["deg/s", "rad/s"] | None = Field(None, description="of yaw rates; default: each signal must say")
    acceleration: Literal["m/s^2", "g"] = Field("m/s^2", description="of accelerations")


class SignalRef(Settings):
    """A DBC signal read as, or written from, a physical quantity: quantity = unit × (scale × signal + offset).

    In YAML either a mapping of these fields or a short text: `PosLat`, `-LAT_DIST` (scale −1: an axis that
    points the other way), `Velocity.VelNorth` (message and signal). The minus sign may stand in the mapping too:
    `{signal: -LAT_DIST, unit: m}`.
    """

    signal: DbcName = Field(description="signal name, or MESSAGE.SIGNAL; a minus sign before it turns the scale's")
    unit: Unit | None = Field(None, description="unit of the signal; default: the DBC's, and SI where it names none")
    scale: Factor = Field(1.0, description="factor on the DBC's physical value; −1 turns an axis round")
    offset: Factor = Field(0.0, description="added after the scale, in the signal's unit")

    @model_validator(mode="after")
    def _scale_is_invertible(self) -> SignalRef:
        if self.scale == 0.0:
            raise ValueError("scale 0 makes the signal a constant; give a factor other than 0")
        return self


class ObjectSignalRef(SignalRef):
    """A signal of an object: which of its values says that the quantity is not known, and which stand for classes."""

    unknown: UnknownValues = Field(
        (),
        description="value of the signal, or list of values, in the DBC's unit, that says: the quantity is not known",
    )
    unknown_raw: UnknownRaws = Field(
        (), description="likewise as the number in the signal's bits, before the DBC's scale and offset: 0xFFF"
    )
    form: Literal["sine", "slope"] | None = Field(
        None, description="of an angle only: the signal gives its sine, or its slope (tangent); default: the angle"
    )
    codes: tuple[SignalValue, ...] | None = Field(
        None,
        min_length=len(CLASSES),
        max_length=len(CLASSES),
        description=f"of `class` only: values of the signal for {', '.join(CLASSES)}; default: 0, 1, 2, …",
    )


def _signal_from_text(value: Any) -> Any:
    """Convert the short text form of a signal to its fields, and a minus sign before its name to the scale's."""
    if isinstance(value, str):
        value = {"signal": value.strip()}
    if not isinstance(value, dict) or not isinstance(value.get("signal"), str) or value["signal"][:1] != "-":
        return value
    scale = value.get("scale", 1.0)
    turned = -scale if isinstance(scale, int | float) and not isinstance(scale, bool) else scale
    return {**value, "signal": value["signal"].removeprefix("-").strip(), "scale": turned}


Signal = Annotated[SignalRef, BeforeValidator(_signal_from_text, json_schema_input_type=DbcName | SignalRef)]


ObjectSignal = Annotated[
    ObjectSignalRef, BeforeValidator(_signal_from_text, json_schema_input_type=DbcName | ObjectSignalRef)
]


def _listed(value: Any) -> Any:
    """Convert a single signal to a list of one."""
    return (value,) if isinstance(value, str | dict | SignalRef) else value


Signals = Annotated[tuple[Signal, ...], BeforeValidator(_listed, json_schema_input_type=tuple[Signal, ...] | Signal)]
"""One signal or a list of them."""
ListedObjectSignals = Annotated[
    tuple[ObjectSignal, ...], BeforeValidator(_listed, json_schema_input_type=tuple[ObjectSignal, ...] | ObjectSignal)
]
"""Likewise, of an object."""


class Condition(Settings):
    """A test on one DBC signal: true where every bound given holds.

    `in` lists the values that pass, `min` and `max` are inclusive, `below` and `above` are exclusive; all in the
    DBC's own unit.
    """

    signal: DbcName = Field(description="signal name in one of the object's messages")
    values: tuple[SignalValue, ...] | None = Field(
        None,
        alias="in",
        min_length=1,
        description="numbers that pass; the DBC's table of values has them beside its texts",
    )
    min: SignalValue | None = Field(None, description="smallest value that passes")
    max: SignalValue | None = Field(None, description="largest value that passes")
    below: SignalValue | None = Field(None, description="passes under this value")
    above: SignalValue | None = Field(None, description="passes over this value")

    @model_validator(mode="after")
    def _tests_something(self) -> Condition:
        bounds = (self.values, self.min, self.max, self.below, self.above)
        if all(bound is None for bound in bounds):
            raise ValueError("the condition tests nothing; give one of: in, min, max, below, above")
        return self
