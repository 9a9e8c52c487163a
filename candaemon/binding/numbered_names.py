"""Signals whose names hold a number: of the slot, of the point in its message, of the object.

`LR_RNG_01` and `LR_RNG_02` are one signal, `LR_RNG_{slot:02d}`, of two slots. A message is looked at so that its
numbered signals have their patterns for names; what follows (codecs, conditions, protection) knows of no numbers then.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

from pydantic import BaseModel

from candaemon.config.sensors import ObjectFormat, is_numbered
from candaemon.dbc.bits import same_layout
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.objects.message_layout import first_point_name, point_name

_EVERY_TRAIT_BUT_ITS_PLACE = ("length", "byte_order", "signed", "is_float", "scale", "offset", "minimum", "maximum")


def numbered_names(*parts: Any) -> frozenset[str]:
    """Collect the names of signals that hold numbers, wherever they stand in some settings."""
    return frozenset(name.rpartition(".")[2] for name in _texts(parts) if is_numbered(name.rpartition(".")[2]))


def _texts(part: Any) -> Iterator[str]:
    """Yield every text in some settings, keys included."""
    if isinstance(part, str):
        yield part
    elif isinstance(part, BaseModel):
        for name in type(part).model_fields:
            yield from _texts(getattr(part, name))
    elif isinstance(part, Mapping):
        for key, value in part.items():
            yield from _texts(key)
            yield from _texts(value)
    elif isinstance(part, Iterable):
        for each in part:
            yield from _texts(each)


def numbered_view(message: MessageSpec, names: Iterable[str], form: ObjectFormat, place: int) -> MessageSpec:
    """Return a message with the numbered signals of one place under the names of their patterns.

    Args:
        message: as the DBC describes it.
        names: patterns of signals.
        form: gives the numbers.
        place: which of the format's messages it is, from 0.

    """
    patterns = _patterns(names, form, place)
    patterns = {name: pattern for name, pattern in patterns.items() if message.find(name) is not None}
    if not patterns:
        return message
    return replace(
        message,
        signals=tuple(
            replace(
                signal,
                name=patterns.get(signal.name, signal.name),
                multiplexer_signal=patterns.get(signal.multiplexer_signal or "", signal.multiplexer_signal),
            )
            for signal in message.signals
        ),
    )


def _patterns(names: Iterable[str], form: ObjectFormat, place: int) -> dict[str, str]:
    """Map the DBC's name of each numbered signal of a place to its pattern."""
    number, count = form.first + form.step * place, len(form.points)
    found: dict[str, str] = {}
    for pattern in sorted(names):
        for point, text in enumerate(form.points):
            try:
                name = pattern.format(slot=number, point=text, object=form.first + place * count + point)
            except ValueError:  # {point:02d} of a text that is no number
                continue
            found.setdefault(name, point_name(pattern, point))
    return found


def selected_view(
    message: MessageSpec, selector: SignalSpec, names: Iterable[str], form: ObjectFormat
) -> tuple[MessageSpec, dict[int, int]]:
    """Return a message whose multiplexer says the place, as it is where one place is selected.

    Args:
        message: as the DBC describes it.
        selector: its signal that says which place a frame is of.
        names: patterns of signals.
        form: gives the numbers.

    Returns:
        The message with the numbered signals of the first place, free of the multiplexer, and the place that each value
        of the selector stands for; no values where no numbered signal depends on it.

    Raises:
        ValueError: a place has no such signals, or other ones; says which.

    """
    views = [_freed(numbered_view(message, names, form, place), selector.name, names) for place in range(form.places)]
    first, of_first = views[0]
    if not of_first:
        return message, {}
    keys: dict[int, int] = {}
    for place, (view, ids) in enumerate(views):
        if ids.keys() != of_first.keys() or not same_layout(first, view, of_first):
            lacking = next((name for name in of_first if name not in ids), next(iter(of_first)))
            number = form.first + form.step * place
            raise ValueError(f"signal '{lacking}' is not there for slot {number}, or laid out otherwise")
        for value in frozenset.intersection(*ids.values()):
            keys[value] = place
    return first, keys


def _freed(view: MessageSpec, selector: str, names: Iterable[str]) -> tuple[MessageSpec, dict[str, frozenset[int]]]:
    """Return a view whose numbered signals no longer depend on the selector, and the values they were selected by."""
    patterns = set(names)
    ids = {
        signal.name: signal.multiplexer_ids
        for signal in view.signals
        if signal.multiplexer_signal == selector and first_point_name(signal.name) in patterns
    }
    signals = (
        replace(signal, multiplexer_signal=None, multiplexer_ids=frozenset()) if signal.name in ids else signal
        for signal in view.signals
        if signal.name in ids or signal.multiplexer_signal != selector or len(signal.multiplexer_ids) > 1
    )
    return replace(view, signals=tuple(signals)), ids


def valued_view(message: MessageSpec, selector: str, value: int) -> MessageSpec:
    """Return a message as it is while one of its signals, which may be a multiplexer, has a value."""
    signals = (
        replace(signal, multiplexer_signal=None, multiplexer_ids=frozenset())
        if signal.multiplexer_signal == selector
        else signal
        for signal in message.signals
        if signal.multiplexer_signal != selector or value in signal.multiplexer_ids
    )
    return replace(message, signals=tuple(signals))


def unlike_point(message: MessageSpec, names: Iterable[str], points: int) -> str | None:
    """Return the first signal of a point that is missing, or otherwise than that of the first point, bar its place."""
    for name in names:
        first = message.find(name)
        for point in range(1, points):
            other = message.find(point_name(name, point))
            if first is None or other is None:
                return point_name(name, point)
            if any(getattr(first, trait) != getattr(other, trait) for trait in _EVERY_TRAIT_BUT_ITS_PLACE):
                return point_name(name, point)
    return None
