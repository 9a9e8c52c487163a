"""A DBC signal as a physical quantity in SI units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from candaemon.arrays import Floats
from candaemon.dbc.bits import dbc_raw_range, representable_raw
from candaemon.dbc.types import SignalSpec

AngleForm: TypeAlias = Literal["sine", "slope"]


@dataclass(frozen=True, slots=True)
class SignalBinding:
    """A signal that is a quantity: quantity = gain × value + bias, in SI (angles in radians).

    Attributes:
        quantity: name of the quantity.
        signal: the DBC's signal.
        gain: SI units of the quantity per DBC unit of the signal.
        bias: quantity where the signal's value is 0.
        unknown: values of the signal, in the DBC's unit, that say that the quantity is not known.
        codes: values of the signal for each class, in the order of `CLASSES`; None: the quantity is no class, or the
            signal's values are those of the classes.
        form: of an angle of which the signal gives the sine or the slope; None: it gives the quantity itself. Gain and
            bias lead to the sine or slope then.

    """

    quantity: str
    signal: SignalSpec
    gain: float
    bias: float
    unknown: tuple[float, ...] = ()
    codes: tuple[float, ...] | None = None
    form: AngleForm | None = None


def dbc_range(binding: SignalBinding) -> tuple[float, float] | None:
    """Return the least and greatest value of a quantity by the DBC's [min|max], half a step wider, in SI.

    None where the DBC gives no range, or one that excludes nothing or cannot be reached: a mistake.
    """
    signal = binding.signal
    given, (low, high) = dbc_raw_range(signal), representable_raw(signal)
    if given is None or given[0] > high or given[1] < low or (given[0] <= low and given[1] >= high):
        return None
    step = 0.0 if signal.is_float else 0.5
    ends = ((given[0] - step) * signal.scale + signal.offset, (given[1] + step) * signal.scale + signal.offset)
    first, last = sorted(binding.gain * end + binding.bias for end in ends)
    if binding.form is not None:
        first, last = angle_of(np.array([first, last]), binding.form).tolist()
    return first, last


def angle_of(values: Floats, form: AngleForm) -> Floats:
    """Return the angles, rad, of which sines or slopes are given; a sine beyond 1 is that of a right angle."""
    angles: Floats = np.arctan(values) if form == "slope" else np.arcsin(np.clip(values, -1.0, 1.0))
    return angles


def form_of(angles: Floats, form: AngleForm) -> Floats:
    """Return the sines or slopes of angles, rad."""
    values: Floats = np.tan(angles) if form == "slope" else np.sin(angles)
    return values
