"""The writer of objects, bound: what each signal shows in an occupied, an empty and a new slot, found and checked."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import compress
from typing import Final, TypeAlias

import numpy as np

from candaemon.binding.bind_protection import (
    LayoutProtection,
    bind_protector,
    check_written,
    counter_period,
    layout_protections,
)
from candaemon.binding.bind_signal import DEFAULT_UNITS, bind_signal
from candaemon.binding.compile_condition import candidates, compile_condition, first_that, passing_interval
from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.binding.look_up import check_alike, find_in_layouts, find_layouts
from candaemon.binding.numbered_names import numbered_names, unlike_point
from candaemon.config.base import Condition, SignalRef, Units
from candaemon.config.protection import InputProtectionSettings, ProtectionSettings
from candaemon.config.sensors import MOST_SLOTS, ObjectFormat
from candaemon.dbc.batch_codec import BatchEncoder
from candaemon.dbc.bits import as_decoded, representable_values, sendable_values, value_count
from candaemon.dbc.types import Database, SignalSpec
from candaemon.errors import ConfigError
from candaemon.objects.conditions import CompiledCondition
from candaemon.objects.message_layout import MessageLayout, first_point_name, is_of_point, point_name
from candaemon.objects.reader import POSITION
from candaemon.objects.signals import SignalBinding
from candaemon.objects.writer import LayoutWriter, ObjectWriter, QuantityColumn

WRAPPING: Final = frozenset({"id", "counter", "sensors"})
"""Quantities that are written modulo the signal's number of values; the others saturate."""
MAY_BE_UNKNOWN: Final = frozenset(
    {
        "sx",
        "sy",
        "svx",
        "svy",
        "latitude",
        "longitude",
        "heading",
        "yaw_rate",
        "length",
        "width",
        "class_likelihood",
        "time_to_collision",
    }
)
"""Quantities that may be NaN: written as the signal's value for "unknown", or as its greatest where it has none."""
OPEN_ENDED: Final = MAY_BE_UNKNOWN | {"age"}
"""Quantities whose signal's end means "or more": written as the end, which counts as no loss."""

QuantitySignals: TypeAlias = Mapping[str, SignalRef | tuple[SignalRef, ...]]
"""Quantity → the signal, or signals, that carry it."""
AnyProtection: TypeAlias = ProtectionSettings | InputProtectionSettings


def bind_writer(
    form: ObjectFormat,
    signals: QuantitySignals,
    database: Database,
    protection: ProtectionSettings | None = None,
    *,
    counters: Iterable[str] = (),
    location: SettingLocation | None = None,
    units: Units = DEFAULT_UNITS,
    names: Collection[str] = (),
) -> ObjectWriter:
    """Bind the writer of one object format.

    Args:
        form: where the objects lie in the frames.
        signals: quantity → the signal, or signals, that carry it, in every message of the object that has them.
        database: the DBC.
        protection: counter and checksum of the frames.
        counters: further signals that count scans (a shared counter that marks the frames of one scan).
        location: place of the sensor or output in the configuration.
        units: of signals of which neither their entry nor the DBC names one.
        names: of further signals, which may hold numbers.

    Raises:
        ConfigError: naming every message, signal, unit and value that is wrong.

    """
    location = location or SettingLocation()
    place = location.at("objects")
    protection = protection or ProtectionSettings()
    counting = list(counters)
    layouts = find_layouts(form, database, place, numbered_names(form, signals, protection, counting, names))
    written = [_WrittenLayout(layout, points=len(form.points)) for layout in layouts]
    errors: list[ConfigError] = []
    for quantity, refs in signals.items():
        for ref in refs if isinstance(refs, tuple) else (refs,):
            if quantity == "counter":
                counting.append(ref.signal)
                continue
            with collected(errors):
                _add_quantity(written, quantity, ref, location.at("signals", quantity), units)
    for kind, values in (("fixed", form.fixed), ("empty", form.empty)):
        with collected(errors):
            _add_values(written, values, kind, place)
    with collected(errors):
        _add_conditions(written, form, place)
    protections = layout_protections(layouts, form, protection, location)
    counting += [each.settings.counter for each in protections if each.settings.counter is not None]
    with collected(errors):
        _add_counters_and_identity(written, [*form.pair, *counting], form.identity or None, location)
    raise_all(errors)
    return ObjectWriter(
        slots=form.slots,
        points=len(form.points),
        layouts=layouts,
        quantities=tuple(signals),
        data_ids=sum(
            len(layout.messages)
            for layout, entry in zip(layouts, form.messages, strict=True)
            if entry.protection is None
        ),
        writers=[
            _layout_writer(each, slots, protected, location)
            for each, protected in zip(written, protections, strict=True)
            for slots in _of_one_length(each.layout, protected.settings.checksum)
        ],
    )


@dataclass(slots=True)
class _WrittenSignal:
    """How one signal is written.

    Attributes:
        signal: the DBC's signal.
        occupied: value in an occupied slot, unless a quantity gives it.
        empty: value in an empty slot.
        binding: the quantity it carries, None where it carries none.
        interval: values between which the quantity reads as valid, None where all do.
        wrap: number of values of a quantity that wraps, 0 where it saturates.
        new: value of an object that is new in its slot, None where the signal does not show it.

    """

    signal: SignalSpec
    occupied: float = 0.0
    empty: float = 0.0
    binding: SignalBinding | None = None
    interval: tuple[float, float] | None = None
    wrap: int = 0
    new: float | None = None

    @property
    def tells_empty(self) -> bool:
        """Whether a slot with its empty value is empty, as the position is not known."""
        binding = self.binding
        return binding is not None and binding.quantity in POSITION and self.empty in binding.unknown


@dataclass(slots=True)
class _WrittenLayout:
    """How the messages of one layout are written: their signals, and which of those count or identify."""

    layout: MessageLayout
    signals: dict[str, _WrittenSignal] = field(default_factory=dict)
    counters: list[str] = field(default_factory=list)
    identities: list[str] = field(default_factory=list)
    points: int = 1

    @property
    def numbers_places(self) -> bool:
        """Whether its id signal counts messages otherwise than the objects are counted."""
        layout = self.layout
        return layout.id_signal is not None and (
            bool(layout.keys) or (layout.first, layout.step) != (0, 1) or self.points > 1 or layout.page is not None
        )

    def written(self, signal: SignalSpec) -> _WrittenSignal:
        """Return how a signal is written; one met for the first time is 0, or raw 0 in an empty slot."""
        known = self.signals.get(signal.name)
        if known is None:
            low, high = sendable_values(signal)
            known = self.signals[signal.name] = _WrittenSignal(
                signal, min(max(0.0, low), high), min(max(signal.offset, low), high)
            )
        return known


@dataclass(slots=True)
class _SignalConditions:
    """All conditions on one signal."""

    written: _WrittenSignal
    conditions: list[Condition]
    compiled: list[CompiledCondition]

    def hold(self, value: float) -> bool:
        """Return whether a value passes all of them, as it will be decoded."""
        decoded = as_decoded(self.written.signal, value)
        return all(bool(each.passes(decoded)) for each in self.compiled)

    def candidates(self) -> list[float]:
        return candidates(self.written.signal, self.conditions)


def _find(written: Sequence[_WrittenLayout], name: str, location: SettingLocation) -> list[_WrittenSignal]:
    """Find a signal in every layout that has it."""
    found = find_in_layouts([each.layout for each in written], name, location)
    return [written[layout.index].written(signal) for layout, signal in found]


def _add_quantity(
    written: Sequence[_WrittenLayout], quantity: str, ref: SignalRef, location: SettingLocation, units: Units
) -> None:
    """Let signals carry a quantity: in every message that has the signal.

    Raises:
        ConfigError: no message has it, its unit does not fit, or it carries another quantity.

    """
    for each in _find(written, ref.signal, location):
        if each.binding is not None:
            raise location.error(
                f"signal '{each.signal.name}' is {each.binding.quantity} already; a signal carries one quantity"
            )
        each.binding = bind_signal(quantity, ref, each.signal, location, units)
        if quantity in POSITION and each.binding.unknown:
            each.empty = each.binding.unknown[0]
        each.wrap = value_count(each.signal) if quantity in WRAPPING else 0


def _add_values(
    written: Sequence[_WrittenLayout], values: Mapping[str, float], kind: str, location: SettingLocation
) -> None:
    """Set the configuration's `fixed` or `empty` values, within the DBC's ranges.

    Raises:
        ConfigError: no message has the signal, the signal cannot have the value, or it carries a quantity.

    """
    for name, value in values.items():
        place = location.at(kind, name)
        for each in _find(written, name, place):
            low, high = representable_values(each.signal)
            step = abs(each.signal.scale)
            if not low - step / 2 <= value <= high + step / 2:
                raise place.error(f"found {value:g}, but '{each.signal.name}' goes from {low:g} to {high:g}")
            # What the DBC's own range leaves out goes out as its end.
            low, high = sendable_values(each.signal)
            value = min(max(value, low), high)
            if kind == "fixed":
                if each.binding is not None:
                    raise place.error(
                        f"'{each.signal.name}' carries {each.binding.quantity}; fix it or measure it, not both"
                    )
                each.occupied = value
            else:
                each.empty = value


def _add_conditions(written: Sequence[_WrittenLayout], form: ObjectFormat, location: SettingLocation) -> None:
    """Choose the values that make an occupied slot read valid, an empty one invalid, a new object new.

    Raises:
        ConfigError: no value does, or the values given contradict the conditions.

    """
    for layout in written:
        if layout.layout.selector is not None:
            signal, value = layout.layout.selector
            chosen = layout.written(signal)
            chosen.occupied = chosen.empty = value
    valid = _by_signal(written, form.valid, location.at("valid"))
    new = _by_signal(written, form.new, location.at("new"))
    fixed = {name.rpartition(".")[2] for name in form.fixed}
    for each in valid:
        _choose_occupied(each, fixed, location)
    for each in new:
        _choose_new(each, next((other for other in valid if other.written is each.written), None), location)
    told = [each for layout in written for each in layout.signals.values() if each.tells_empty]
    if valid and not told and all(each.hold(each.written.empty) for each in valid):
        _choose_empty(valid, form, location)


def _by_signal(
    written: Sequence[_WrittenLayout], conditions: Sequence[Condition], location: SettingLocation
) -> list[_SignalConditions]:
    """Gather the conditions on each signal, in the message where the reader looks for it."""
    gathered: dict[tuple[int, str], _SignalConditions] = {}
    for index, condition in enumerate(conditions):
        place = location.at(index)
        layout, signal = find_in_layouts([each.layout for each in written], condition.signal, place)[0]
        on_it = gathered.setdefault(
            (layout.index, signal.name), _SignalConditions(written[layout.index].written(signal), [], [])
        )
        on_it.conditions.append(condition)
        on_it.compiled.append(compile_condition(condition, signal, place))
    return list(gathered.values())


def _choose_occupied(valid: _SignalConditions, fixed: set[str], location: SettingLocation) -> None:
    """Choose the value of a signal in an occupied slot, or the limits of the quantity that it carries."""
    written, name = valid.written, valid.written.signal.name
    if written.binding is not None:
        written.interval = passing_interval(written.signal, valid.conditions, valid.hold)
        return
    if name in fixed:
        if not valid.hold(written.occupied):
            raise location.at("fixed").error(f"{name}: {written.occupied:g} does not pass the conditions of 'valid'")
        return
    value = first_that(valid.candidates(), valid.hold)
    if value is None:
        raise location.at("valid").error(f"no value of '{name}' passes; the conditions contradict each other")
    written.occupied = value


def _choose_new(new: _SignalConditions, valid: _SignalConditions | None, location: SettingLocation) -> None:
    """Choose the values of a signal for a new object and for one that is not, valid both."""
    written = new.written
    if written.binding is not None:
        return

    def passes(value: float) -> bool:
        return valid is None or valid.hold(value)

    values = [*new.candidates(), *([] if valid is None else valid.candidates())]
    written.new = first_that(values, lambda value: passes(value) and new.hold(value))
    old = first_that([written.occupied, *values], lambda value: passes(value) and not new.hold(value))
    if written.new is None or old is None:
        lacking = "is" if written.new is None else "is not"
        raise location.at("new").error(f"no valid value of '{written.signal.name}' says that an object {lacking} new")
    written.occupied = old


def _choose_empty(valid: Sequence[_SignalConditions], form: ObjectFormat, location: SettingLocation) -> None:
    """Make an empty slot fail one condition."""
    if form.empty:
        raise location.at("empty").error(
            "a slot written so passes all conditions of 'valid'; give a value that fails one"
        )
    for each in valid:
        value = first_that(each.candidates(), lambda value: not each.hold(value))  # noqa: B023  # called at once
        if value is not None:
            each.written.empty = value
            return
    raise location.at("valid").error("no value fails these conditions, so a slot cannot be written as empty")


def _add_counters_and_identity(
    written: Sequence[_WrittenLayout], counting: Iterable[str], identity: str | None, location: SettingLocation
) -> None:
    """Note which signals show the counter and which the identity."""
    layouts = [each.layout for each in written]
    for name in dict.fromkeys(counting):
        for layout, signal in find_in_layouts(layouts, name, location.at("protection", "counter")):
            written[layout.index].written(signal)
            written[layout.index].counters.append(signal.name)
    if identity is not None:
        for layout, signal in find_in_layouts(layouts, identity, location.at("objects", "identity")):
            written[layout.index].written(signal)
            written[layout.index].identities.append(signal.name)
    for each in written:
        id_signal = each.layout.id_signal
        if each.layout.page is not None:
            each.written(each.layout.page.signal)
        if id_signal is not None:
            each.written(id_signal)
        if id_signal is not None and not each.numbers_places and id_signal.name not in each.identities:
            each.identities.append(id_signal.name)


def _layout_writer(
    written: _WrittenLayout,
    slots: Sequence[int],
    protection: LayoutProtection[AnyProtection],
    location: SettingLocation,
) -> LayoutWriter:
    """Make the writer of some slots' messages.

    Args:
        written: how the layout's signals are written.
        slots: the slots whose messages these are, in their order.
        protection: counter and checksum of this layout.
        location: place of the sensor or output.

    """
    points, id_signal = written.points, written.layout.id_signal
    every_message = written.layout.messages
    messages = [every_message[slot] for slot in slots]
    message = messages[0]
    settings = protection.settings
    check_written(settings, protection.place)
    protector = bind_protector(messages, settings, protection.place, order=protection.order(slots))
    checksum = None if protector is None else settings.checksum
    for signal in message.signals:
        # Bits left 0 would show a value where zero is not raw 0. What has a number in its name that no setting names
        # is of one slot only, and stays 0.
        name = first_point_name(signal.name)
        if signal.offset and signal.multiplexer_signal is None and all(each.find(name) for each in every_message):
            written.written(message.signal(name))
    if checksum in written.counters:
        raise location.error(
            f"'{checksum}' counts the scans and is the checksum too; expected the signal of a counter in one, "
            "that of the checksum in the other"
        )
    signals = [each for name, each in written.signals.items() if name != checksum]
    names = [each.signal.name for each in signals]
    of_point = np.array([is_of_point(name) for name in names], np.bool_)
    unlike = unlike_point(message, compress(names, of_point), points)
    if unlike is not None:
        raise location.at("objects", "points").error(
            f"message '{message.name}' has no signal '{unlike}' like that of the first point; "
            "the points of a message differ in nothing but their bits' places"
        )
    others = [point_name(name, point) for point in range(1, points) for name in compress(names, of_point)]
    check_alike(written.layout, [*names, *others], location.at("objects"))
    page = written.layout.page
    on_page = MOST_SLOTS if page is None else page.places
    mine = None
    if len(messages) != len(every_message):
        mine = np.zeros(len(every_message), np.bool_)
        mine[list(slots)] = True
    return LayoutWriter(
        encoder=BatchEncoder(message, [*names, *others]),
        length=message.length,
        can_ids=np.array([each.can_id for each in every_message], np.int64),
        mine=mine,
        templates=np.array([[each.empty, each.occupied] for each in signals]).reshape(len(signals), 2),
        columns=tuple(_quantity_column(row, each, each.binding) for row, each in enumerate(signals) if each.binding),
        new=tuple((row, each.new) for row, each in enumerate(signals) if each.new is not None),
        counters=tuple(
            (names.index(name), counter_period(settings, written.signals[name].signal)) for name in written.counters
        ),
        identities=tuple(
            (names.index(name), value_count(written.signals[name].signal))
            for name in written.identities
            if written.signals[name].binding is None
        ),
        protector=protector,
        points=points,
        of_point=of_point.nonzero()[0],
        place=None
        if id_signal is None or not written.numbers_places
        else (
            names.index(id_signal.name),
            np.array([written.layout.key(place % on_page) for place in range(MOST_SLOTS)]),
        ),
        page=None if page is None else (names.index(page.signal.name), np.array(page.values(MOST_SLOTS))),
    )


def _quantity_column(row: int, written: _WrittenSignal, binding: SignalBinding) -> QuantityColumn:
    """Make the column of a quantity; one that is open-ended ends at the signal's limits without loss."""
    lossy = binding.quantity not in OPEN_ENDED
    low, high = sendable_values(written.signal)
    unknown = None
    if binding.quantity in MAY_BE_UNKNOWN or binding.unknown:
        if not binding.unknown:
            unknown = high if binding.gain > 0.0 else low
        else:
            unknown = binding.unknown[0]
            low, high = _known(written.signal, binding.unknown, low, high)
    limits = written.interval if (lossy and not binding.unknown) or written.interval is not None else (low, high)
    return QuantityColumn(
        row,
        binding.quantity,
        written.wrap,
        binding.gain,
        binding.bias,
        limits,
        lossy,
        unknown,
        None if binding.codes is None else np.array(binding.codes),
        binding.form,
    )


def _known(signal: SignalSpec, unknown: Sequence[float], low: float, high: float) -> tuple[float, float]:
    """Return the least and greatest value of a signal that is not written as if it were not known."""
    if signal.is_float:
        return low, high
    step = abs(signal.scale)
    for value in sorted(unknown):
        low += step * (value <= low)
    for value in sorted(unknown, reverse=True):
        high -= step * (value >= high)
    return low, high


def _of_one_length(layout: MessageLayout, checksum: str | None) -> list[list[int]]:
    """Group the slots whose messages have one length and one place for the checksum."""
    groups: dict[tuple[int, int | None], list[int]] = {}
    for slot, message in enumerate(layout.messages):
        signal = None if checksum is None else message.find(checksum)
        groups.setdefault((message.length, None if signal is None else signal.start), []).append(slot)
    return list(groups.values())
