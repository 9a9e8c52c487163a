"""Units: a signal of the DBC as a physical quantity, with gain and bias into SI."""

from __future__ import annotations

import re
from typing import Final, Literal, TypeAlias

from candaemon.binding.location import SettingLocation
from candaemon.config.base import UNIT_FACTORS, ObjectSignalRef, SignalRef, Units
from candaemon.dbc.bits import has_value, representable_values
from candaemon.dbc.types import SignalSpec
from candaemon.objects.signals import SignalBinding

Dimension: TypeAlias = Literal["length", "angle", "speed", "rate", "acceleration", "curvature", "time", "number"]

UNITS: Final[dict[str, tuple[Dimension, float]]] = {
    **dict.fromkeys(("m", "meter", "metre"), ("length", UNIT_FACTORS["m"])),
    **{name: ("length", factor) for name, factor in (("mm", 1e-3), ("cm", 1e-2), ("dm", 1e-1), ("km", 1e3))},
    **{
        f"{name}meter": ("length", factor)
        for name, factor in (("milli", 1e-3), ("centi", 1e-2), ("deci", 1e-1), ("kilo", 1e3))
    },
    **dict.fromkeys(("ft", "feet", "foot"), ("length", 0.3048)),
    **dict.fromkeys(("deg", "degree", "°", "ø", "degreeofarc", "degreofarc"), ("angle", UNIT_FACTORS["deg"])),
    **dict.fromkeys(("rad", "radian"), ("angle", 1.0)),
    "mrad": ("angle", 1e-3),
    **dict.fromkeys(("m/s", "mps", "meter/s", "metre/s"), ("speed", 1.0)),
    **dict.fromkeys(("km/h", "kph", "kmh", "kmph", "km/hr", "kilometer/h"), ("speed", UNIT_FACTORS["km/h"])),
    **dict.fromkeys(("mph", "mi/h"), ("speed", UNIT_FACTORS["mph"])),
    **{name: ("speed", factor) for name, factor in (("mm/s", 1e-3), ("cm/s", 1e-2), ("dm/s", 1e-1))},
    **dict.fromkeys(("ft/s", "fps", "feet/s"), ("speed", 0.3048)),
    **dict.fromkeys(("kn", "kt", "kts", "knot", "knots"), ("speed", 1852 / 3600)),
    **dict.fromkeys(
        ("deg/s", "degree/s", "°/s", "dps", "degreeofarc/s", "degreofarc/s"), ("rate", UNIT_FACTORS["deg/s"])
    ),
    **dict.fromkeys(("rad/s", "radian/s"), ("rate", 1.0)),
    "mrad/s": ("rate", 1e-3),
    **dict.fromkeys(
        ("m/s^2", "m/s2", "m/s²", "m/s/s", "meter/s/s", "meter/s^2", "m/s**2", "mpss"), ("acceleration", 1.0)
    ),
    **dict.fromkeys(("g", "g-force"), ("acceleration", UNIT_FACTORS["g"])),
    **dict.fromkeys(("1/m", "m^-1", "rad/m", "1/meter"), ("curvature", 1.0)),
    **dict.fromkeys(("s", "second"), ("time", 1.0)),
    **dict.fromkeys(("ms", "millis"), ("time", 1e-3)),
    **dict.fromkeys(("us", "µs", "μs"), ("time", 1e-6)),
    "ns": ("time", 1e-9),
    **dict.fromkeys(("%", "percent"), ("number", 0.01)),
    **dict.fromkeys(("1", "-", "count"), ("number", 1.0)),
}
"""Dimension and SI value of a unit, by its text brought into the form that `normalised_unit` gives."""

DIMENSIONS: Final[dict[str, Dimension]] = {
    **dict.fromkeys(("x", "y", "range", "width", "length", "sx", "sy"), "length"),
    **dict.fromkeys(("center_x", "center_y", "center_dx", "center_dy"), "length"),
    **dict.fromkeys(("azimuth", "heading", "slip", "latitude", "longitude"), "angle"),
    **dict.fromkeys(("vx", "vy", "range_rate", "rel_vx", "rel_vy", "svx", "svy", "speed"), "speed"),
    **dict.fromkeys(("velocity_north", "velocity_east", "left_wheels", "right_wheels"), "speed"),
    **dict.fromkeys(("ax", "ay", "rel_ax"), "acceleration"),
    "yaw_rate": "rate",
    "curvature": "curvature",
    "age": "time",
    "time_to_collision": "time",
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

_PER: Final = re.compile("per(?!cent)")
_SQUARED: Final = re.compile("squar(ed?)?$")

DEFAULT_UNITS: Final = Units()
"""SI, and no word on angles."""


def normalised_unit(unit: str) -> str:
    """Bring a unit's text into one form: `Meters/Sec` and `Unit_MeterPerSecon` become `meter/s`."""
    text = unit.strip().strip("[]").lower().replace(" ", "").removeprefix("unit_")
    text = _PER.sub("/", _SQUARED.sub("^2", text)).replace("seconds", "s").replace("second", "s").replace("secon", "s")
    text = text.replace("sec", "s").replace("hour", "h").replace("hr", "h").replace("metre", "meter")
    for plural in ("meters", "degrees", "radians"):
        text = text.replace(plural, plural[:-1])
    return text


def assumes_speed(quantity: str, ref: SignalRef, signal: SignalSpec, units: Units) -> bool:
    """Return whether a signal is taken as m/s for want of any unit."""
    told = ref.unit is not None or bool(signal.unit.strip()) or "speed" in units.model_fields_set
    return DIMENSIONS.get(quantity) == "speed" and not told


def bind_signal(
    quantity: str, ref: SignalRef, signal: SignalSpec, location: SettingLocation, units: Units = DEFAULT_UNITS
) -> SignalBinding:
    """Work out gain and bias of a signal as a quantity.

    Args:
        quantity: a key of `DIMENSIONS`, or any other name for a plain number.
        ref: the signal's entry in the configuration.
        signal: as the DBC describes it.
        location: the entry's place.
        units: of signals of which neither the entry nor the DBC names one.

    Raises:
        ConfigError: the unit does not fit the quantity, is not known, or is an angle's and given nowhere; or the DBC
            gives the signal one value only.

    """
    if signal.scale == 0.0:
        raise location.error(
            f"signal '{signal.name}' has the factor 0 in line {signal.line} of the DBC, so all its values are one; "
            "correct the factor there"
        )
    form = ref.form if isinstance(ref, ObjectSignalRef) else None
    dimension = DIMENSIONS.get(quantity, "number")
    if form is not None and dimension != "angle":
        raise location.error(f"'form: {form}' is of an angle, but '{signal.name}' is {quantity}; leave it out")
    dimension = "number" if form is not None else dimension
    unit, source = (ref.unit, "the configuration") if ref.unit is not None else (signal.unit, "the DBC")
    if not unit.strip():
        unit, source = getattr(units, dimension, None) or "", "the configuration"
    factor = 1.0
    expected = f"expected {SI_NAMES[dimension]} or another unit of {dimension}; give {{signal: {ref.signal}, unit: …}}"
    known = UNITS.get(normalised_unit(unit)) if unit.strip() else None
    if not unit.strip():
        if dimension in {"angle", "rate"}:
            raise location.error(
                f"signal '{signal.name}' has no unit in the DBC and {quantity} is an angle; {expected}"
            )
    elif known is None:
        # A plain number's unit is a remark (`class`, `bits`): nothing to convert.
        if dimension != "number":
            raise location.error(f"signal '{signal.name}' has the unit '{unit}' by {source}, {expected}")
    elif known[0] == dimension:
        factor = known[1]
    elif dimension != "number" and not (ref.unit is None and known == ("number", 1.0)):
        raise location.error(f"signal '{signal.name}' has the unit '{unit}' ({known[0]}) by {source}, {expected}")
    gain, bias = factor * ref.scale, factor * ref.offset
    if not isinstance(ref, ObjectSignalRef):
        return SignalBinding(quantity, signal, gain, bias)
    if ref.codes is not None and quantity != "class":
        raise location.error(f"'codes' are values for classes, but '{signal.name}' is {quantity}; leave them out")
    from_raw = [raw * signal.scale + signal.offset for raw in ref.unknown_raw]
    if from_raw and signal.is_float:
        raise location.error(f"signal '{signal.name}' is a float; give 'unknown' instead of 'unknown_raw'")
    named = [("unknown", value) for value in ref.unknown] + [("unknown_raw", value) for value in from_raw]
    for key, value in (*named, *(("codes", code) for code in ref.codes or ())):
        if not has_value(signal, value):
            low, high = representable_values(signal)
            raise location.error(
                f"'{key}' has {value:g}, which signal '{signal.name}' cannot be; expected a value from {low:g} to "
                f"{high:g} in steps of {abs(signal.scale):g}"
            )
    return SignalBinding(quantity, signal, gain, bias, (*ref.unknown, *from_raw), ref.codes, form)
