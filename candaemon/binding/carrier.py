"""How a quantity becomes the values of the signal that carries it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from candaemon.binding.conditions import value_limits
from candaemon.binding.plan import OPEN_ENDED, SignalPlan
from candaemon.binding.signals import SignalBinding

Floats = npt.NDArray[np.float64]
Booleans = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Carrier:
    """A signal that carries a quantity.

    Attributes:
        row: of the signal.
        quantity: its name.
        wrap: number of values of a quantity that wraps, 0 where it saturates.
        gain: SI units of the quantity per unit of the signal.
        bias: quantity where the signal's value is 0.
        limits: values it is brought between, None where the encoder's own limits do.
        lossy: whether being brought there counts as saturated.

    """

    row: int
    quantity: str
    wrap: int
    gain: float
    bias: float
    limits: tuple[float, float] | None
    lossy: bool

    def wire(self, found: npt.NDArray[np.float64] | npt.NDArray[np.integer]) -> tuple[Floats, Booleans | None]:
        """Turn the quantity into the signal's values, and tell which lost by being brought between the limits."""
        wire: Floats = np.asarray(found % self.wrap if self.wrap else found, np.float64)
        if self.bias:
            wire = wire - self.bias
        if self.gain != 1.0:
            wire = wire / self.gain
        if self.limits is None:
            return wire, None
        low, high = self.limits
        inside = np.minimum(np.maximum(wire, low), high)
        return inside, (inside < wire) | (inside > wire) if self.lossy else None


def carrier(row: int, plan: SignalPlan, binding: SignalBinding) -> Carrier:
    """Make the carrier of a quantity; one that is open-ended ends at the signal's limits without loss."""
    lossy = binding.quantity not in OPEN_ENDED
    limits = plan.interval if lossy else value_limits(plan.signal)
    return Carrier(row, binding.quantity, plan.wrap, binding.gain, binding.bias, limits, lossy)
