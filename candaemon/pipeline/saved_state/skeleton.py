"""The parts of a pipeline that change while it runs, found by their place in it.

A pipeline that has taken nothing yet shows them: every object with attributes, list, dictionary, set and deque that it
was made of. Those of the binding are the configuration's and do not change; what can be called is made by the code.
Parts are filled in place, so that whoever holds one, such as a receiver of frames, goes on holding the right one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from operator import itemgetter
from types import MethodType
from typing import Any, Final, TypeAlias

import numpy as np

from candaemon.pipeline.saved_state.packing import packed, unpacked
from candaemon.pipeline.saved_state.places import ATOMS, FUNCTIONS, Step, attributes, is_frozen, step, steps

Path: TypeAlias = tuple[Step, ...]
Name: TypeAlias = tuple[str, Any]
"""`binding` and the path there, or `part` and its number."""

_ABSENT: Final = object()


@dataclass(frozen=True, slots=True)
class _Part:
    """A place in the pipeline.

    Attributes:
        parent: number of the part that it is in; −1 for the pipeline itself.
        way: from there.
        kind: of what is there in a pipeline that has taken nothing.
        function: its name, where it is one; empty where it is none.
        changes: whether its content is state; that of a function or of a value is not.
        given: attributes that hold a part of the configuration.
    """

    parent: int
    way: Step
    kind: type
    function: str
    changes: bool
    given: frozenset[str]


class Skeleton:
    """The structure of all pipelines of a binding.

    Args:
        fresh: a pipeline that has taken nothing yet.
        owned: what the configuration alone decides: the binding.

    Attributes:
        digest: of the structure; another one is another version of the code.
    """

    def __init__(self, fresh: object, owned: object) -> None:
        self._owned_at = dict(_reachable(owned))
        self._owned_names: dict[int, Name] = {id(each): ("binding", path) for path, each in self._owned_at.items()}
        self._parts = tuple(self._find(fresh))
        self.digest = sha256("\n".join(map(_described, self._parts)).encode()).hexdigest()[:16]

    def parts(self, pipeline: object) -> list[Any]:
        """Return what is at each place of a pipeline, and a mark where something else or nothing is."""
        found: list[Any] = []
        for part in self._parts:
            each = pipeline if part.parent < 0 else _ABSENT
            whole = _ABSENT if part.parent < 0 else found[part.parent]
            if whole is not _ABSENT:
                with suppress(AttributeError, LookupError, TypeError):
                    each = step(whole, part.way)
            alike = type(each) is part.kind and part.function in ("", getattr(each, "__name__", ""))
            found.append(each if alike else _ABSENT)
        return found

    def names(self, parts: Sequence[Any]) -> dict[int, Name]:
        """Return what stands for each object that is not stored where it occurs, by its `id`."""
        names = self._owned_names.copy()
        for number, (part, each) in enumerate(zip(self._parts, parts, strict=True)):
            if (part.changes or part.function) and each is not _ABSENT:
                names.setdefault(id(each), ("part", number))
        return names

    def named(self, parts: Sequence[Any], name: Name) -> Any:
        """Return the object that a name stands for; only what `names` gives stands for any.

        Raises:
            LookupError, TypeError, ValueError: it is none of these.
        """
        kind, key = name
        if kind == "binding":
            return self._owned_at[key]  # a step from there could lead anywhere, to the functions of Python itself
        part = self._parts[key]
        if kind != "part" or parts[key] is _ABSENT or not (part.changes or part.function):
            raise LookupError(f"nothing is named {name}")
        return parts[key]

    def contents(self, parts: Sequence[Any]) -> list[tuple[int, Any]]:
        """Return the content of each part that changes, with its number.

        What a part was given of the configuration stays away, even where it is that of a configuration before: a part
        that a reload takes over goes on with it.
        """
        return [
            (number, _content(each, part.given))
            for number, (part, each) in enumerate(zip(self._parts, parts, strict=True))
            if part.changes and each is not _ABSENT
        ]

    def fill(self, parts: Sequence[Any], contents: Sequence[tuple[int, Any]]) -> None:
        """Give parts their content.

        Raises:
            AttributeError, LookupError, TypeError, ValueError: it does not fit.
        """
        for number, content in contents:
            if not self._parts[number].changes:
                raise ValueError(f"part {number} never changes")
            _fill(parts[number], content)

    def _find(self, fresh: object) -> Iterator[_Part]:
        """Yield every part once, whatever holds it before what it holds."""
        seen = {id(fresh)}
        waiting: deque[tuple[int, Step, object]] = deque([(-1, ("attribute", ""), fresh)])
        number = 0
        while waiting:
            parent, way, whole = waiting.popleft()
            function = whole.__name__ if isinstance(whole, FUNCTIONS) else ""
            by_value = isinstance(whole, (MethodType, partial, itemgetter)) or is_frozen(whole)
            given = frozenset(key for (_, key), each in steps(whole) if id(each) in self._owned_names)
            yield _Part(parent, way, type(whole), function, not function and not by_value, given)
            for further, each in steps(whole):
                if id(each) in seen or id(each) in self._owned_names or isinstance(each, (*ATOMS, np.ndarray)):
                    continue
                seen.add(id(each))
                waiting.append((number, further, each))
            number += 1


def _reachable(root: object) -> Iterator[tuple[Path, object]]:
    """Yield everything that can be found by a place in an object, with the shortest way there."""
    seen = {id(root)}
    waiting: deque[tuple[Path, object]] = deque([((), root)])
    while waiting:
        path, whole = waiting.popleft()
        yield path, whole
        for way, each in steps(whole):
            if id(each) not in seen and not isinstance(each, ATOMS):
                seen.add(id(each))
                waiting.append(((*path, way), each))


def _described(part: _Part) -> str:
    """Return a part as a line of text."""
    return f"{part.parent} {part.way} {part.kind.__module__}.{part.kind.__qualname__} {part.function}"


def _content(part: Any, given: frozenset[str]) -> Any:
    """Return what a part holds; of attributes, those that it was not given."""
    if isinstance(part, list | set | deque):
        return packed(list(part))
    if isinstance(part, dict):
        return dict(part)
    return {name: value for name, value in attributes(part).items() if name not in given}


def _fill(part: Any, content: Any) -> None:
    """Let a part hold a content and nothing else."""
    match part:
        case dict():
            part.clear()
            part.update(content)
        case set():
            part.clear()
            part.update(unpacked(content))
        case list() | deque():
            part.clear()
            part.extend(unpacked(content))
        case _:
            has = attributes(part)
            if not isinstance(content, Mapping) or not content.keys() <= has.keys():
                raise ValueError(f"found other attributes than those of a {type(part).__name__}")
            for name, value in content.items():
                if value is not has[name]:
                    setattr(part, name, value)
