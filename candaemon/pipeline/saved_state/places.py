"""Where the parts of an object are: the steps from it to what it holds, the same in each process."""

from __future__ import annotations

import types
from collections import deque
from collections.abc import Iterator
from enum import Enum
from functools import partial
from operator import itemgetter
from pathlib import PurePath
from typing import Any, Final, TypeAlias

import numpy as np

Step: TypeAlias = tuple[str, Any]
"""How to get from an object to one it holds: `attribute`, `item` or `cell`, and which."""

FUNCTIONS: Final = (types.FunctionType, types.BuiltinFunctionType, types.MethodWrapperType, np.ufunc)
"""What the code makes and no state holds: found again by its place."""

ATOMS: Final = (
    type(None),
    bool,
    int,
    float,
    complex,
    str,
    bytes,
    frozenset,
    range,
    slice,
    Enum,
    np.generic,
    np.dtype,
    type,
    types.ModuleType,
    PurePath,
)
"""What holds nothing that could be found by a place."""


def steps(whole: object) -> Iterator[tuple[Step, object]]:
    """Yield each part of an object with the step that leads to it, in an order that is always the same."""
    if isinstance(whole, ATOMS):
        return
    if isinstance(whole, dict):
        for key, value in whole.items():
            yield ("item", key), value
        return
    if isinstance(whole, list | tuple | deque):
        for k, value in enumerate(whole):
            yield ("item", k), value
        return
    for name in _names(whole):
        yield ("attribute", name), getattr(whole, name)
    if isinstance(whole, types.FunctionType):
        for k, cell in enumerate(whole.__closure__ or ()):
            yield ("cell", k), cell.cell_contents


def step(whole: object, way: Step) -> Any:
    """Go one step.

    Raises:
        AttributeError, LookupError, TypeError: it does not lead anywhere.
    """
    kind, key = way
    if kind == "item":
        return whole[key]  # type: ignore[index]  # the step says that it has items
    if kind == "attribute":
        return getattr(whole, key)
    return whole.__closure__[key].cell_contents  # type: ignore[attr-defined]  # the step says that it is a function


def attributes(whole: object) -> dict[str, Any]:
    """Return an object's own attributes, those in slots too; one that is not set is left out."""
    return {name: getattr(whole, name) for name in _names(whole)}


def is_frozen(whole: object) -> bool:
    """Tell whether an object is a value: never changed, only replaced."""
    parameters = getattr(type(whole), "__dataclass_params__", None)
    return isinstance(whole, tuple) or (parameters is not None and bool(parameters.frozen))


def _names(whole: object) -> Iterator[str]:
    """Yield the names of the attributes that an object itself has."""
    if isinstance(whole, types.MethodType):
        yield "__self__"
    elif isinstance(whole, partial):
        yield from ("func", "args", "keywords")
    elif not isinstance(whole, (*FUNCTIONS, itemgetter, np.ndarray, set, dict, list, tuple, deque)):
        for kind in type(whole).__mro__:
            slots = kind.__dict__.get("__slots__", ())
            for name in (slots,) if isinstance(slots, str) else slots:
                if name not in {"__dict__", "__weakref__"} and hasattr(whole, name):
                    yield name
        yield from getattr(whole, "__dict__", {})
