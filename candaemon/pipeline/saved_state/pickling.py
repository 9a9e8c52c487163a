"""Pickles the content of a pipeline's parts; what it does not store is named instead.

A pickle can call whatever it names. This one may name classes of values, the few functions that make arrays, and what
the pipeline it is given to is made of; none of these touches more than the pipeline.
"""

from __future__ import annotations

import io
import pickle
import sys
from collections import OrderedDict, deque
from collections.abc import Mapping, Sequence
from functools import partial
from operator import itemgetter
from types import FunctionType, MethodType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from candaemon.pipeline.saved_state.skeleton import Name, Skeleton

_ROOMS: Final = ("cycle", "bus.frame", "bus.protect_sequence", "config", "sensing", "tracking", "estimation", "output")
"""Rooms of candaemon whose classes may be named: none of them touches a file."""


class _Pickler(pickle.Pickler):
    """Names what has a name."""

    def __init__(self, file: io.BytesIO, names: Mapping[int, Name]) -> None:
        super().__init__(file, protocol=5)
        self._names = names

    def persistent_id(self, obj: Any) -> Name | None:
        return self._names.get(id(obj))

    def reducer_override(self, obj: Any) -> Any:
        if type(obj) is np.ndarray and not (obj.flags.c_contiguous or obj.flags.f_contiguous):
            # as it lies in memory: a sum that runs over the axes in another order differs in the last bit
            order = sorted(range(obj.ndim), key=lambda axis: -abs(obj.strides[axis]))
            return laid_out, (np.ascontiguousarray(obj.transpose(order)), tuple(np.argsort(order).tolist()))
        if isinstance(obj, MethodType):
            return method_of, (obj.__self__, obj.__name__)
        return NotImplemented


class _Unpickler(pickle.Unpickler):
    """Finds only what `_Pickler` names."""

    def __init__(self, file: io.BytesIO, skeleton: Skeleton, parts: Sequence[Any]) -> None:
        super().__init__(file)
        self._skeleton, self._parts = skeleton, parts

    def persistent_load(self, pid: Any) -> Any:
        return self._skeleton.named(self._parts, pid)

    def find_class(self, module_name: str, global_name: str) -> Any:
        found = _ELSEWHERE.get((module_name, global_name))
        if found is None and _is_ours(module_name):
            found = getattr(sys.modules.get(module_name), global_name, None)
            # not what the module itself has from elsewhere
            found = found if isinstance(found, type) and found.__module__ == module_name else None
        if found is None:
            raise pickle.UnpicklingError(f"it asks for {module_name}.{global_name}, which no state needs")
        return found


def pickled(skeleton: Skeleton, pipeline: object) -> bytes:
    """Return the content of a pipeline's parts."""
    parts = skeleton.parts(pipeline)
    file = io.BytesIO()
    _Pickler(file, skeleton.names(parts)).dump(skeleton.contents(parts))
    return file.getvalue()


def fill(skeleton: Skeleton, pipeline: object, data: bytes) -> None:
    """Give the parts of a pipeline that has taken nothing yet the content of those of another.

    Raises:
        ArithmeticError, AttributeError, EOFError, LookupError, TypeError, ValueError, pickle.UnpicklingError: the bytes
            were not made by `pickled`, or of another structure.
    """
    parts = skeleton.parts(pipeline)
    skeleton.fill(parts, _Unpickler(io.BytesIO(data), skeleton, parts).load())


def laid_out(stored: npt.NDArray[Any], axes: tuple[int, ...]) -> npt.NDArray[Any]:
    """Return an array whose axes have another order than its memory."""
    return stored.transpose(axes)


def method_of(whole: object, name: str) -> MethodType:
    """Return a method of an object, one that candaemon itself defines: those of libraries may touch a file.

    Raises:
        TypeError: it is no such method.
    """
    found = getattr(type(whole), name, None)
    if not (isinstance(found, FunctionType) and _is_ours(type(whole).__module__) and _is_ours(found.__module__)):
        raise TypeError(f"'{name}' is no method of a {type(whole).__name__} that a state may hold")
    return MethodType(found, whole)


def _is_ours(module_name: str) -> bool:
    """Tell whether a module lies in a room whose classes may be named."""
    return any(f"{module_name}.".startswith(f"candaemon.{room}.") for room in _ROOMS)


def _of_numpy() -> tuple[Any, ...]:
    """Return what numpy names to make an array, a scalar and their type."""
    array, scalar = np.zeros(1), np.float64(0.0)
    return array.__reduce_ex__(5)[0], array.__reduce_ex__(2)[0], scalar.__reduce__()[0]


_MAKERS: Final = (laid_out, method_of, *_of_numpy())
_ELSEWHERE: Final[dict[tuple[str, str], Any]] = {
    (found.__module__, found.__qualname__): found
    for found in (
        *_MAKERS,
        *(int, float, complex, set, frozenset, bytearray, slice, range, deque, OrderedDict, partial, itemgetter),
    )
} | {("numpy", "ndarray"): np.ndarray, ("numpy", "dtype"): np.dtype}
