"""The hot loops of other rooms, `_kernels.pyx`, which the build compiles where it finds a compiler; and whether it has.

What they compute is what numpy and Python compute without them, to the last bit; so nobody has to choose.

Knows nothing of who calls them: a kernel takes arrays and numbers, and stands beside the function that does the same.
"""

from __future__ import annotations

from typing import Final

from candaemon.arrays import Floats

REVISION: Final = 148
"""Of the kernels that this code calls: others, left in a checkout by an earlier build, are not used."""
WIDEST: Final = 16
"""Components of a state that the kernels of updates one after another have room for."""
COMPONENTS: Final = 9
MODELS: Final = 8
"""Components of a state, and models of it, that the kernels of interacting models have room for."""
QUANTITIES: Final = 24
"""Quantities of ego motion that the kernel of an INS has room for."""

__all__ = ("COMPONENTS", "MODELS", "QUANTITIES", "REVISION", "WIDEST", "description", "fit_for", "in_use", "kernels")

try:
    from candaemon.compiled import _kernels as kernels
except ImportError:
    in_use = False
else:
    in_use = kernels.REVISION == REVISION


def fit_for(mean: Floats, covariance: Floats) -> bool:
    """Return whether the kernels can be used for states (k, M, D) and their covariances (k, M, D, D)."""
    return in_use and _held(mean, 3) and _held(covariance, 4) and mean.shape[2] <= WIDEST


def description() -> str:
    """Return which of the two computes, for people."""
    return "compiled kernels" if in_use else "numpy alone, without compiled kernels"


def _held(array: Floats, dimensions: int) -> bool:
    """Return whether an array lies in memory as the kernels expect it."""
    return array.ndim == dimensions and array.flags.c_contiguous and array.dtype == float
