"""A DBC signal as a physical quantity: units, gain and bias, and quick readers of single fields."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from candaemon.binding.location import SettingLocation
from candaemon.config.base import UNIT_FACTORS, SignalRef
from candaemon.dbc.batch_codec import compile_decoder
from candaemon.dbc.bits import first_bit, raw_range, raw_width
from candaemon.dbc.types import MessageSpec, SignalSpec

Dimension: TypeAlias = Literal["length", "angle", "speed", "rate", "acceleration", "curvature", "time", "number"]

UNITS: Final[dict[str, tuple[Dimension, float]]] = {
    **dict.fromkeys(("m", "meter", "metre"), ("length", UNIT_FACTORS["m"])),
    **{name: ("length", factor) for name, factor in (("mm", 1e-3), ("cm", 1e-2), ("dm", 1e-1), ("km", 1e3))},
    **dict.fromkeys(("deg", "degree", "°", "ø"), ("angle", UNIT_FACTORS["deg"])),
    **dict.fromkeys(("rad", "radian"), ("angle", 1.0)),
    **dict.fromkeys(("m/s", "mps", "meter/s", "metre/s"), ("speed", 1.0)),
    **dict.fromkeys(("km/h", "kph", "kmh", "kmph", "km/hr"), ("speed", UNIT_FACTORS["km/h"])),
    **dict.fromkeys(("mph", "mi/h"), ("speed", UNIT_FACTORS["mph"])),
    **dict.fromkeys(("deg/s", "degree/s", "°/s", "dps"), ("rate", UNIT_FACTORS["deg/s"])),
    **dict.fromkeys(("rad/s", "radian/s"), ("rate", 1.0)),
    **dict.fromkeys(("m/s^2", "m/s2", "m/s²", "m/s/s", "meter/s/s", "m/s**2", "mpss"), ("acceleration", 1.0)),
    **dict.fromkeys(("g", "g-force"), ("acceleration", UNIT_FACTORS["g"])),
    **dict.fromkeys(("1/m", "m^-1", "rad/m"), ("curvature", 1.0)),
    **dict.fromkeys(("s", "second"), ("time", 1.0)),
    "ms": ("time", 1e-3),
    **dict.fromkeys(("%", "percent"), ("number", 0.01)),
    **dict.fromkeys(("1", "-", "count"), ("number", 1.0)),
}
"""Dimension and SI value of a unit, by its text brought into the form that `normalised` gives."""

DIMENSIONS: Final[dict[str, Dimension]] = {
    **dict.fromkeys(("x", "y", "range", "width", "length", "sx", "sy"), "length"),
    **dict.fromkeys(("azimuth", "heading", "latitude", "longitude"), "angle"),
    **dict.fromkeys(("vx", "vy", "range_rate", "rel_vx", "rel_vy", "svx", "svy", "speed"), "speed"),
    **dict.fromkeys(("velocity_north", "velocity_east", "left_wheels", "right_wheels"), "speed"),
    **dict.fromkeys(("ax", "ay", "rel_ax"), "acceleration"),
    "yaw_rate": "rate",
    "curvature": "curvature",
    "age": "time",
}
"""Dimension of each quantity; those left out are plain numbers."""

SI_NAMES: Final[dict[Dimension, str]] = {
    "length": "m",
    "angle": "deg or rad",
    "speed": "m/s",
    "rate": "deg/s or rad/s",
    "acceleration": "m/s^2",
    "curvature": "1/m",
    "time": "s",
    "number": "1",
}


@dataclass(frozen=True, slots=True)
class SignalBinding:
    """A signal that is a quantity: quantity = gain × value + bias, in SI (angles in radians).

    Attributes:
        quantity: name of the quantity.
        signal: the DBC's signal.
        gain: SI units of the quantity per DBC unit of the signal.
        bias: quantity where the signal's value is 0.

    """

    quantity: str
    signal: SignalSpec
    gain: float
    bias: float


def normalised(unit: str) -> str:
    """Bring a unit's text into one form: `Meters/Sec` becomes `meter/s`."""
    text = unit.strip().strip("[]").lower().replace(" ", "").replace("seconds", "s").replace("second", "s")
    text = text.replace("sec", "s").replace("hour", "h").replace("hr", "h").replace("metre", "meter")
    for plural in ("meters", "degrees", "radians"):
        text = text.replace(plural, plural[:-1])
    return text


def bind_signal(quantity: str, ref: SignalRef, signal: SignalSpec, where: SettingLocation) -> SignalBinding:
    """Work out gain and bias of a signal as a quantity.

    Args:
        quantity: a key of `DIMENSIONS`, or any other name for a plain number.
        ref: the signal's entry in the configuration.
        signal: what the DBC says of it.
        where: the entry's place.

    Raises:
        ConfigError: the unit does not fit the quantity, is not known, or is an angle's and nowhere said.

    """
    dimension = DIMENSIONS.get(quantity, "number")
    said, source = (ref.unit, "the configuration") if ref.unit is not None else (signal.unit, "the DBC")
    factor = 1.0
    expected = f"expected {SI_NAMES[dimension]} or another unit of {dimension}; give {{signal: {ref.signal}, unit: …}}"
    known = UNITS.get(normalised(said)) if said.strip() else None
    if not said.strip():
        if dimension in {"angle", "rate"}:
            raise where.error(f"signal '{signal.name}' has no unit in the DBC and {quantity} is an angle; {expected}")
    elif known is None:
        # A plain number's unit is a remark (`class`, `bits`): nothing to convert.
        if dimension != "number":
            raise where.error(f"signal '{signal.name}' has the unit '{said}' by {source}, {expected}")
    elif known[0] == dimension:
        factor = known[1]
    elif dimension != "number" and not (ref.unit is None and known == ("number", 1.0)):
        raise where.error(f"signal '{signal.name}' has the unit '{said}' ({known[0]}) by {source}, {expected}")
    return SignalBinding(quantity, signal, factor * ref.scale, factor * ref.offset)


def field_reader(message: MessageSpec, signal: SignalSpec) -> Callable[[bytes], int]:
    """Make a function that reads one integer signal (a counter, an id) from a payload long enough."""
    first = first_bit(signal)
    byte, before = divmod(first, 8)
    plain = not signal.signed and not signal.is_float and (signal.scale, signal.offset) == (1, 0)
    if plain and signal.multiplexer_signal is None and before + signal.length <= 8:
        if signal.length == 8:
            return operator.itemgetter(byte)
        shift = before if signal.byte_order == "little" else 8 - before - signal.length
        mask = (1 << signal.length) - 1
        return lambda data: data[byte] >> shift & mask
    decode = compile_decoder(message, [signal.name])

    def read(data: bytes) -> int:
        values = decode(data)
        return -1 if values is None or not math.isfinite(values[0]) else int(values[0])

    return read


def wraps_at(signal: SignalSpec) -> int:
    """Count the values that a counter or identity in this signal can have."""
    return 1 << min(signal.length, 62)


def dbc_range(binding: SignalBinding) -> tuple[float, float] | None:
    """Give the least and greatest value of a quantity by the DBC's [min|max], half a step wider, in SI.

    None where the DBC gives no range, or one that excludes nothing or cannot be reached: a mistake.
    """
    signal = binding.signal
    given, (low, high) = raw_range(signal), raw_width(signal)
    if given is None or given[0] > high or given[1] < low or (given[0] <= low and given[1] >= high):
        return None
    step = 0.0 if signal.is_float else 0.5
    ends = ((given[0] - step) * signal.scale + signal.offset, (given[1] + step) * signal.scale + signal.offset)
    first, last = sorted(binding.gain * end + binding.bias for end in ends)
    return first, last
