"""Names of array types, one table for the whole package, and arrays that share their rows.

Knows nothing of what the numbers mean.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Integers: TypeAlias = NDArray[np.int64]
Booleans: TypeAlias = NDArray[np.bool_]
Indices: TypeAlias = NDArray[np.intp]
"""Positions in another array's first axis."""
Bytes: TypeAlias = NDArray[np.uint8]
ComplexPlane: TypeAlias = NDArray[np.complex128]
"""Positions or velocities in a plane: the real part along x, the imaginary part along y."""

__all__ = ["Booleans", "Bytes", "ComplexPlane", "Floats", "Indices", "Integers"]
