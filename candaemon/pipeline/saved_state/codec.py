"""A tree of state dataclasses as msgpack, and back.

Written is what the objects hold: a dataclass as a map of its fields, a named tuple or a set as a list, a complex number
as two floats, an array as [type, shape, order of the axes in memory, bytes]. Read is what the annotations of the
dataclasses ask for, piece by piece, and nothing else: the bytes name no class, and no more of them is unpacked than an
annotation has room for.
"""

from __future__ import annotations

import math
import types
import typing
from collections import deque
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, Final, TypeVar, Union, get_args, get_origin

import msgpack
import numpy as np
import numpy.typing as npt

from candaemon.frames.times import NEVER_NS

State = TypeVar("State")

MOST_BYTES: Final = 1 << 25
"""Of a stored state."""
MOST_ITEMS: Final = 1 << 18
"""Of all lists, sets and dictionaries in it together."""
LONGEST_TEXT: Final = 256
MOST_DIMENSIONS: Final = 8
LARGEST: Final = 1e75
"""Magnitude of a number: the fourth power of any is a number still."""
LARGEST_INTEGER: Final = 1 << 62
"""Magnitude of an integer, but for `NEVER_NS`: the sum of any two has 64 bits still."""

_ARRAY_KINDS: Final = {"bool": np.bool_, "uint8": np.uint8, "int64": np.int64, "float64": np.float64,
                       "complex128": np.complex128}  # fmt: skip
_LONGEST_SCALAR: Final = 9
"""Bytes of a packed number."""
_BYTES_BEGIN: Final = (0xC4, 0xC5, 0xC6)
"""First byte of packed bytes."""


def encoded(state: object) -> bytes:
    """Return a tree of states as bytes.

    Raises:
        TypeError: it holds something that no state may hold.
    """
    packed: bytes = msgpack.packb(state, default=_plain)
    return packed


def decoded(kind: type[State], data: bytes | memoryview, like: State) -> State:
    """Return the tree of states in some bytes.

    Args:
        kind: the dataclass at the root.
        data: what `encoded` returned, or anything.
        like: a state of a fresh pipeline of the same configuration. Where the annotation leaves a
            choice of dataclasses, its choice counts; where its arrays have a length, so must those in the bytes.

    Raises:
        ValueError: the bytes are not such a tree; says where.
    """
    reader = _Reader(memoryview(data))
    state = reader.value(kind, like, "state")
    reader.require_end()
    return typing.cast("State", state)


@cache
def schema(kind: Any) -> str:
    """Return what a dataclass and all that it holds are made of, as text: another one is another version."""
    hint = _unaliased(kind)
    if isinstance(hint, type) and is_dataclass(hint):
        return f"{hint.__name__}({', '.join(f'{name}: {schema(each)}' for name, each in _hints(hint).items())})"
    arguments = ", ".join(schema(each) for each in get_args(hint))
    if _is_named_tuple(hint):
        arguments = ", ".join(schema(each) for each in _hints(hint).values())
    return f"{getattr(hint, '__name__', hint)}[{arguments}]"


def _plain(value: Any) -> Any:
    """Return what stands for an object that msgpack does not know."""
    if isinstance(value, np.ndarray):
        return _packed_array(value)
    kind = typing.cast("Any", type(value))
    if hasattr(kind, "__dataclass_fields__"):
        return {name: getattr(value, name) for name in _names(kind)}
    if isinstance(value, complex):
        return (value.real, value.imag)
    if isinstance(value, set):
        return sorted(value)
    if isinstance(value, deque):
        return list(value)
    raise TypeError(f"a state may not hold a {kind.__name__}")


def _packed_array(array: npt.NDArray[Any]) -> tuple[str, tuple[int, ...], tuple[int, ...], bytes]:
    """Return type, shape, order of the axes and bytes of an array, as it lies in memory.

    A sum that runs over the axes in another order differs in the last bit.
    """
    if array.dtype.name not in _ARRAY_KINDS:
        raise TypeError(f"a state may not hold an array of {array.dtype}")
    if array.flags.c_contiguous:
        return array.dtype.name, array.shape, tuple(range(array.ndim)), array.tobytes()
    order = sorted(range(array.ndim), key=lambda axis: -abs(array.strides[axis]))
    return array.dtype.name, array.shape, tuple(order), array.transpose(order).tobytes()


class _Reader:
    """Reads values one after another, each as its annotation asks.

    Args:
        data: the bytes.
        room: how many more items lists and the like may have; shared with the reader of a part.
    """

    def __init__(self, data: memoryview, room: list[int] | None = None) -> None:
        self._data = data
        self._room = [MOST_ITEMS] if room is None else room
        self._unpacker = msgpack.Unpacker(
            max_buffer_size=max(len(data), 1), max_array_len=MOST_ITEMS, max_map_len=MOST_ITEMS, strict_map_key=False
        )
        self._unpacker.feed(data)

    def require_end(self) -> None:
        """Refuse bytes behind the last value."""
        if self._unpacker.tell() != len(self._data):
            raise ValueError("something follows the state")

    def value(self, hint: Any, like: Any, at: str) -> Any:
        """Return the next value.

        Args:
            hint: its annotation.
            like: the same in the state of a fresh pipeline; None where there is none.
            at: its place, for messages.
        """
        hint = _unaliased(hint)
        origin = get_origin(hint)
        if origin in (Union, types.UnionType):
            return self._one_of(get_args(hint), like, at)
        if is_dataclass(hint):
            return self._dataclass(hint, like, at)
        if origin is np.ndarray:
            return self._array(get_args(get_args(hint)[1])[0], like, at)
        if origin is dict:
            return self._dictionary(hint, like, at)
        if origin in (list, deque, set):
            (item,) = get_args(hint)
            likes = like if isinstance(like, list) else ()
            items = [
                self.value(item, likes[k] if k < len(likes) else None, f"{at}[{k}]")
                for k in range(self._header("read_array_header", at))
            ]
            return origin(items)
        if origin is tuple or _is_named_tuple(hint):
            return self._tuple(hint, at)
        if hint is complex:
            return complex(*self._fixed((float, float), at))
        return self._scalar(hint, at)

    def _one_of(self, hints: tuple[Any, ...], like: Any, at: str) -> Any:
        """Return the next value, of one of several annotations."""
        span = self._span(at)
        if span[0] == 0xC0:  # nil
            if types.NoneType in hints:
                return None
            raise ValueError(f"{at} is missing")
        choices = [each for each in hints if each is not types.NoneType and type(like) in (each, types.NoneType)]
        if len(choices) > 1:  # of dataclasses, that with these fields
            names = _Reader(span, self._room).names(at)
            choices = [each for each in choices if _names(each) == names]
        if not choices:
            raise ValueError(f"{at} is none of those expected")
        return _Reader(span, self._room).value(choices[0], like, at)

    def names(self, at: str) -> tuple[str, ...]:
        """Return the names in a map."""
        found = []
        for _ in range(self._header("read_map_header", at)):
            found.append(self._scalar(str, at))
            self._span(at)
        return tuple(found)

    def _dataclass(self, kind: Any, like: Any, at: str) -> Any:
        if like is not None and type(like) is not kind:
            raise ValueError(f"{at} is a {kind.__name__}, expected a {type(like).__name__}")
        hints = _hints(kind)
        count = self._header("read_map_header", at)
        if count != len(hints):
            raise ValueError(f"{at} has {count} fields, expected {len(hints)}")
        values = {}
        for name, hint in hints.items():
            found = self._scalar(str, at)
            if found != name:
                raise ValueError(f"{at} has a field '{found}', expected '{name}'")
            values[name] = self.value(hint, getattr(like, name, None), f"{at}.{name}")
        state = kind(**values)
        validate = getattr(state, "validate", None)
        if validate is not None:
            try:
                validate()
            except ValueError as error:
                raise ValueError(f"{at}: {error}") from error
        return state

    def _dictionary(self, hint: Any, like: Any, at: str) -> dict[Any, Any]:
        key_hint, value_hint = get_args(hint)
        found: dict[Any, Any] = {}
        count = self._header("read_map_header", at)
        for _ in range(count):
            key = self.value(key_hint, None, f"a key of {at}")
            found[key] = self.value(value_hint, like.get(key) if isinstance(like, Mapping) else None, f"{at}[{key!r}]")
        if len(found) != count:
            raise ValueError(f"{at} has a key twice")
        return found

    def _tuple(self, hint: Any, at: str) -> Any:
        if _is_named_tuple(hint):
            return hint(*self._fixed(tuple(_hints(hint).values()), at))
        hints = get_args(hint)
        if len(hints) == 2 and hints[1] is ...:
            return tuple(self.value(list[hints[0]], None, at))  # type: ignore[valid-type]  # a type found at run time
        return tuple(self._fixed(hints, at))

    def _fixed(self, hints: tuple[Any, ...], at: str) -> list[Any]:
        """Return the next list, of as many values as there are annotations."""
        count = self._header("read_array_header", at)
        if count != len(hints):
            raise ValueError(f"{at} has {count} values, expected {len(hints)}")
        return [self.value(hint, None, f"{at}[{k}]") for k, hint in enumerate(hints)]

    def _array(self, kind: type[np.generic], like: Any, at: str) -> npt.NDArray[Any]:
        if self._header("read_array_header", at) != 4:
            raise ValueError(f"{at} is no array")
        name = self._scalar(str, at)
        if _ARRAY_KINDS.get(name) is not np.dtype(kind).type:
            raise ValueError(f"{at} is an array of {name}, expected {np.dtype(kind).name}")
        shape = self.value(list[int], None, at)
        order = self.value(list[int], None, at)
        data = self._scalar(bytes, at)
        if len(shape) > MOST_DIMENSIONS or sorted(order) != list(range(len(shape))) or min(shape, default=0) < 0:
            raise ValueError(f"{at} has no shape")
        if math.prod(shape) * np.dtype(kind).itemsize != len(data):
            raise ValueError(f"{at} has {len(data)} bytes, which is not its shape")
        if isinstance(like, np.ndarray):
            fits = len(shape) == like.ndim and all(n in (0, m) for m, n in zip(shape, like.shape, strict=True))
            if not fits:
                raise ValueError(f"{at} has the shape {tuple(shape)}, expected {like.shape}, 0 standing for any")
        array = np.frombuffer(data, kind).copy()
        array = array.reshape([shape[axis] for axis in order]).transpose(np.argsort(order))
        if array.dtype.kind in "fc" and not (np.abs(array) < LARGEST).all():
            raise ValueError(f"{at} holds what is no number, or one beyond {LARGEST:g}")
        if array.dtype.kind == "i" and not _are_in_range(array):
            raise ValueError(f"{at} holds an integer beyond 62 bits")
        if array.dtype.kind == "b" and (np.frombuffer(data, np.uint8) > 1).any():
            raise ValueError(f"{at} holds what is neither true nor false")
        return array

    def _scalar(self, kind: Any, at: str) -> Any:
        """Return the next value, which is none of several."""
        span = self._span(at)
        is_small = len(span) <= (LONGEST_TEXT if kind is str else _LONGEST_SCALAR)
        if not (span[0] in _BYTES_BEGIN if kind is bytes else is_small):
            raise ValueError(f"{at} is no {kind.__name__}")
        value = msgpack.unpackb(span, max_bin_len=MOST_BYTES)
        if kind is float and type(value) is int:
            value = float(value)
        if type(value) is not kind:
            raise ValueError(f"{at} is a {type(value).__name__}, expected {kind.__name__}")
        if kind is int and not (abs(value) <= LARGEST_INTEGER or abs(value) == NEVER_NS):
            raise ValueError(f"{at} is beyond 62 bits")
        if kind is float and not abs(value) < LARGEST:
            raise ValueError(f"{at} is no number, or one beyond {LARGEST:g}")
        return value

    def _header(self, of: str, at: str) -> int:
        """Return how many items the list or dictionary has that begins."""
        try:
            count = int(getattr(self._unpacker, of)())
        except (ValueError, msgpack.UnpackException) as error:
            raise ValueError(f"{at} is no {'list' if of == 'read_array_header' else 'dictionary'}") from error
        self._room[0] -= count
        if self._room[0] < 0:
            raise ValueError(f"{at} has {count} items, expected {MOST_ITEMS} at most in the whole state")
        return count

    def _span(self, at: str) -> memoryview:
        """Return the bytes of the next value."""
        begin = self._unpacker.tell()
        try:
            self._unpacker.skip()
        except (ValueError, msgpack.UnpackException) as error:
            raise ValueError(f"{at} is damaged ({type(error).__name__})") from error
        return self._data[begin : self._unpacker.tell()]


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """Return the annotations of a dataclass's or named tuple's fields, in their order."""
    hints = typing.get_type_hints(kind)
    return {name: hints[name] for name in _names(kind)}


@cache
def _names(kind: Any) -> tuple[str, ...]:
    """Return the names of a dataclass's or named tuple's fields, in their order."""
    if is_dataclass(kind):
        return tuple(field.name for field in fields(kind))
    names: tuple[str, ...] = getattr(kind, "_fields", ())
    return names


def _are_in_range(array: npt.NDArray[Any]) -> bool:
    """Return whether integers are such that any two can be added, or stand for what never happens."""
    beyond = array[(array > LARGEST_INTEGER) | (array < -LARGEST_INTEGER)]
    return bool(((beyond == NEVER_NS) | (beyond == -NEVER_NS)).all())


def _is_named_tuple(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields")


def _unaliased(hint: Any) -> Any:
    """Return an annotation without what says nothing of its values."""
    return get_args(hint)[0] if get_origin(hint) is typing.Annotated else hint
