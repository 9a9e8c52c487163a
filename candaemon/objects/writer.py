"""Objects into payloads, vectorised: the mirror of the reader, for output and simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from struct import Struct
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.binding.bind_protection import (
    PartProtection,
    check_written,
    counter_period,
    part_protector,
    parts_protection,
)
from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.config.base import Condition, SignalRef
from candaemon.config.protection import InputProtectionSettings, ProtectionSettings
from candaemon.config.sensors import ObjectFormat
from candaemon.dbc.batch_codec import BatchEncoder
from candaemon.dbc.types import Database, SignalSpec
from candaemon.errors import ConfigError
from candaemon.objects.conditions import (
    candidates,
    compile_condition,
    first_that,
    on_grid,
    passing_interval,
    value_limits,
    value_width,
)
from candaemon.objects.layout import Part, check_layouts, find_in_parts, resolve_parts
from candaemon.objects.signals import SignalBinding, bind_signal, wraps_at

WRAPPING = frozenset({"id", "counter", "sensors"})
"""Quantities that go onto the wire modulo the signal's number of values; the others saturate."""
OPEN_ENDED = frozenset({"age", "sx", "sy", "svx", "svy", "latitude", "longitude"})
"""Quantities whose signal's end means "or more" or "not known": written as the end, which counts as no loss."""


@dataclass(slots=True)
class SignalPlan:
    """How one signal is written.

    Attributes:
        signal: the DBC's signal.
        occupied: value in an occupied slot, unless a quantity gives it.
        empty: value in an empty slot.
        binding: the quantity it carries, None where it carries none.
        interval: values between which the quantity reads as valid, None where all do.
        wrap: number of values of a quantity that wraps, 0 where it saturates.
        new: value of an object that is new in its slot, None where the signal does not tell.

    """

    signal: SignalSpec
    occupied: float = 0.0
    empty: float = 0.0
    binding: SignalBinding | None = None
    interval: tuple[float, float] | None = None
    wrap: int = 0
    new: float | None = None


@dataclass(slots=True)
class PartPlan:
    """How one message is written: its signals, and which of them count, alternate or identify."""

    part: Part
    signals: dict[str, SignalPlan] = field(default_factory=dict)
    counters: list[str] = field(default_factory=list)
    identities: list[str] = field(default_factory=list)

    def plan(self, signal: SignalSpec) -> SignalPlan:
        """Find or make the plan of a signal."""
        known = self.signals.get(signal.name)
        if known is None:
            low, high = value_limits(signal)
            known = self.signals[signal.name] = SignalPlan(
                signal, min(max(0.0, low), high), min(max(signal.offset, low), high)
            )
        return known


def add_quantity(plans: Sequence[PartPlan], quantity: str, ref: SignalRef, where: SettingLocation) -> None:
    """Let signals carry a quantity: in every message that has the signal.

    Raises:
        ConfigError: no message has it, its unit does not fit, or it carries another quantity.

    """
    for part, signal in find_in_parts([plan.part for plan in plans], ref.signal, where):
        plan = plans[part.index].plan(signal)
        if plan.binding is not None:
            raise where.error(
                f"signal '{signal.name}' is {plan.binding.quantity} already; a signal carries one quantity"
            )
        plan.binding = bind_signal(quantity, ref, signal, where)
        plan.wrap = wraps_at(signal) if quantity in WRAPPING else 0


def add_values(plans: Sequence[PartPlan], values: Mapping[str, float], kind: str, where: SettingLocation) -> None:
    """Take over the configuration's `fixed` or `empty` values, within the DBC's ranges.

    Raises:
        ConfigError: no message has the signal, the signal cannot have the value, or a quantity is in its place.

    """
    for name, value in values.items():
        place = where.at(kind, name)
        for part, signal in find_in_parts([plan.part for plan in plans], name, place):
            low, high = value_width(signal)
            step = abs(signal.scale)
            if not low - step / 2 <= value <= high + step / 2:
                raise place.error(f"found {value:g}, but '{signal.name}' goes from {low:g} to {high:g}")
            plan = plans[part.index].plan(signal)
            # What the DBC's own range leaves out goes out as its end.
            low, high = value_limits(signal)
            value = min(max(value, low), high)
            if kind == "fixed":
                if plan.binding is not None:
                    raise place.error(
                        f"'{signal.name}' carries {plan.binding.quantity}; fix it or measure it, not both"
                    )
                plan.occupied = value
            else:
                plan.empty = value


def add_conditions(plans: Sequence[PartPlan], form: ObjectFormat, where: SettingLocation) -> None:
    """Choose the values that make an occupied slot read valid, an empty one invalid, a new object new.

    Raises:
        ConfigError: no value does, or the values given contradict the conditions.

    """
    valid = _by_signal(plans, form.valid, where.at("valid"))
    new = _by_signal(plans, form.new, where.at("new"))
    fixed = {name.rpartition(".")[2] for name in form.fixed}
    for test in valid:
        _choose_occupied(test, fixed, where)
    for test in new:
        matching = next((each for each in valid if each.plan is test.plan), None)
        _choose_new(test, matching, where)
    if valid and all(test.holds(test.plan.empty) for test in valid):
        _choose_empty(valid, form, where)


@dataclass(slots=True)
class _SignalTest:
    """All conditions on one signal."""

    plan: SignalPlan
    conditions: list[Condition]
    tests: list[Callable[[float], bool]]

    def holds(self, value: float) -> bool:
        """Tell whether a value passes all of them, as it will be decoded."""
        decoded = on_grid(self.plan.signal, value)
        return all(bool(test(decoded)) for test in self.tests)

    def candidates(self) -> list[float]:
        return candidates(self.plan.signal, self.conditions)


def _by_signal(plans: Sequence[PartPlan], conditions: Sequence[Condition], where: SettingLocation) -> list[_SignalTest]:
    """Gather the conditions on each signal, in the message where the reader looks for it."""
    gathered: dict[tuple[int, str], _SignalTest] = {}
    for index, condition in enumerate(conditions):
        place = where.at(index)
        part, signal = find_in_parts([plan.part for plan in plans], condition.signal, place)[0]
        plan = plans[part.index].plan(signal)
        test = gathered.setdefault((part.index, signal.name), _SignalTest(plan, [], []))
        test.conditions.append(condition)
        test.tests.append(compile_condition(condition, signal, place))
    return list(gathered.values())


def _choose_occupied(test: _SignalTest, fixed: set[str], where: SettingLocation) -> None:
    plan, name = test.plan, test.plan.signal.name
    if plan.binding is not None:
        plan.interval = passing_interval(plan.signal, test.conditions, test.holds)
        return
    if name in fixed:
        if not test.holds(plan.occupied):
            raise where.at("fixed").error(f"{name}: {plan.occupied:g} does not pass the conditions of 'valid'")
        return
    value = first_that(test.candidates(), test.holds)
    if value is None:
        raise where.at("valid").error(f"no value of '{name}' passes; the conditions contradict each other")
    plan.occupied = value


def _choose_new(test: _SignalTest, valid: _SignalTest | None, where: SettingLocation) -> None:
    plan = test.plan
    if plan.binding is not None:
        return

    def passes(value: float) -> bool:
        return valid is None or valid.holds(value)

    values = [*test.candidates(), *([] if valid is None else valid.candidates())]
    plan.new = first_that(values, lambda value: passes(value) and test.holds(value))
    old = first_that([plan.occupied, *values], lambda value: passes(value) and not test.holds(value))
    if plan.new is None or old is None:
        lacking = "is" if plan.new is None else "is not"
        raise where.at("new").error(f"no valid value of '{plan.signal.name}' says that an object {lacking} new")
    plan.occupied = old


def _choose_empty(valid: Sequence[_SignalTest], form: ObjectFormat, where: SettingLocation) -> None:
    """Make an empty slot fail one condition."""
    if form.empty:
        raise where.at("empty").error("a slot written so passes all conditions of 'valid'; give a value that fails one")
    for test in valid:
        value = first_that(test.candidates(), lambda value: not test.holds(value))  # noqa: B023  # called at once
        if value is not None:
            test.plan.empty = value
            return
    raise where.at("valid").error("no value fails these conditions, so a slot cannot be written as empty")


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

    def wire(self, found: Floats | npt.NDArray[np.integer]) -> tuple[Floats, Booleans | None]:
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


Values: TypeAlias = Mapping[str, Floats | npt.NDArray[np.integer]]
AnyProtection: TypeAlias = ProtectionSettings | InputProtectionSettings
Refs: TypeAlias = Mapping[str, SignalRef | tuple[SignalRef, ...]]


class ObjectWriter:
    """Writes objects of one format.

    Args:
        form: where the objects lie in the frames.
        signals: quantity → the signal, or signals, that carry it, in every message of the object that has them.
        database: the DBC.
        protection: counter and checksum of the frames.
        counters: further signals that count scans (a shared counter by which a scan is told).
        where: place of the sensor or output in the configuration.

    Attributes:
        slots: objects the format can hold.
        parts: the messages of an object.
        quantities: those that `write` takes.
        data_ids: messages that share the data ids of the protection.
        saturated: values so far that did not fit their signal and were brought to its limits.

    Raises:
        ConfigError: naming every message, signal, unit and value that is wrong.

    """

    def __init__(
        self,
        form: ObjectFormat,
        signals: Refs,
        database: Database,
        protection: ProtectionSettings | None = None,
        *,
        counters: Iterable[str] = (),
        where: SettingLocation | None = None,
    ) -> None:
        where = where or SettingLocation()
        place = where.at("objects")
        protection = protection or ProtectionSettings()
        self.slots = form.slots
        self.parts = resolve_parts(form, database, place)
        self.quantities = tuple(signals)
        self.saturated = 0
        plans = [PartPlan(part) for part in self.parts]
        errors: list[ConfigError] = []
        counted = list(counters)
        for quantity, refs in signals.items():
            for ref in refs if isinstance(refs, tuple) else (refs,):
                if quantity == "counter":
                    counted.append(ref.signal)
                    continue
                with collected(errors):
                    add_quantity(plans, quantity, ref, where.at("signals", quantity))
        for kind, values in (("fixed", form.fixed), ("empty", form.empty)):
            with collected(errors):
                add_values(plans, values, kind, place)
        with collected(errors):
            add_conditions(plans, form, place)
        protections = parts_protection(self.parts, form, protection, where)
        self.data_ids = sum(
            len(part.messages)
            for part, entry in zip(self.parts, form.messages, strict=True)
            if entry.protection is None
        )
        counted += [each.settings.counter for each in protections if each.settings.counter is not None]
        with collected(errors):
            _add_counted(plans, [*form.pair, *counted], form.identity, where)
        raise_all(errors)
        self._writers = [
            _PartWriter(plan, slots, each, where)
            for plan, each in zip(plans, protections, strict=True)
            for slots in _alike(plan.part, each.settings.checksum)
        ]

    def write(
        self,
        slot: Integers,
        values: Values,
        occupied: Booleans,
        *,
        counter: int | Integers,
        new: Booleans | None = None,
        identity: Integers | None = None,
    ) -> list[tuple[int, bytes]]:
        """Write m slots.

        Args:
            slot: (m,) slots, from 0.
            values: quantity → (m,) in SI and the signals' axes; one left out is written as 0.
            occupied: (m,) whether the slot holds an object; an empty one is written so that it reads invalid.
            counter: what counters and pair signals show, modulo their width; one for all or (m,).
            new: (m,) whether the object is new in its slot; default: none is.
            identity: (m,) the objects' identities, modulo their signal's width; default: the slots.

        Returns:
            CAN id and payload: the first message of every slot, then the second, and so on.

        """
        frames: list[tuple[int, bytes]] = []
        if not len(slot):
            return frames
        identity = slot if identity is None else identity
        new = None if new is None or not np.count_nonzero(new) else new
        for writer in self._writers:
            self.saturated += writer.write(frames, slot, values, occupied, counter, new, identity)
        return frames


def _add_counted(plans: list[PartPlan], counted: Iterable[str], identity: str | None, where: SettingLocation) -> None:
    """Note which signals show the counter and which the identity."""
    parts = [plan.part for plan in plans]
    for name in dict.fromkeys(counted):
        for part, signal in find_in_parts(parts, name, where.at("protection", "counter")):
            plans[part.index].plan(signal)
            plans[part.index].counters.append(signal.name)
    if identity is not None:
        for part, signal in find_in_parts(parts, identity, where.at("objects", "identity")):
            plans[part.index].plan(signal)
            plans[part.index].identities.append(signal.name)
    for plan in plans:
        signal_of_id = plan.part.id_signal
        if signal_of_id is not None and signal_of_id.name not in plan.identities:
            plan.plan(signal_of_id)
            plan.identities.append(signal_of_id.name)


class _PartWriter:
    """Writes the messages of one part that are laid out alike.

    Args:
        plan: how the part's signals are written.
        slots: the slots whose messages these are, in their order.
        protection: counter and checksum of this part.
        where: place of the sensor or output.

    """

    def __init__(
        self, plan: PartPlan, slots: Sequence[int], protection: PartProtection[AnyProtection], where: SettingLocation
    ) -> None:
        self.part = plan.part
        messages = [plan.part.messages[slot] for slot in slots]
        layout = messages[0]
        self._length = layout.length
        settings = protection.settings
        check_written(settings, protection.place)
        self._protector = part_protector(messages, settings, protection.place, order=protection.order(slots))
        checksum = None if self._protector is None else settings.checksum
        for signal in layout.signals:
            # Bits left 0 would say something where zero is not raw 0.
            if signal.offset and signal.multiplexer_signal is None:
                plan.plan(signal)
        plans = [each for name, each in plan.signals.items() if name != checksum]
        names = [each.signal.name for each in plans]
        check_layouts(plan.part, names, where.at("objects"))
        self._encoder = BatchEncoder(layout, names)
        self._ids = np.array([message.can_id for message in plan.part.messages], np.int64)
        self._mine = None
        if len(messages) != len(plan.part.messages):
            self._mine = np.zeros(len(plan.part.messages), np.bool_)
            self._mine[list(slots)] = True
        self._templates = np.array([[each.empty, each.occupied] for each in plans]).reshape(len(plans), 2)
        self._carriers = [carrier(row, each, each.binding) for row, each in enumerate(plans) if each.binding]
        self._new = [(row, each.new) for row, each in enumerate(plans) if each.new is not None]
        self._counters = [
            (names.index(name), counter_period(settings, plan.signals[name].signal)) for name in plan.counters
        ]
        self._identities = [
            (names.index(name), wraps_at(plan.signals[name].signal))
            for name in plan.identities
            if plan.signals[name].binding is None
        ]

    def write(
        self,
        frames: list[tuple[int, bytes]],
        slot: Integers,
        values: Values,
        occupied: Booleans,
        counter: int | Integers,
        new: Booleans | None,
        identity: Integers,
    ) -> int:
        """Append the frames; return how many values were saturated."""
        if self._mine is not None:
            chosen = np.flatnonzero(self._mine[slot])
            if not len(chosen):
                return 0
            slot, occupied, identity = slot[chosen], occupied[chosen], identity[chosen]
            values = {quantity: found[chosen] for quantity, found in values.items()}
            counter = counter if isinstance(counter, int) else counter[chosen]
            new = None if new is None else new[chosen]
        table = self._templates.take(occupied.view(np.int8), axis=1)
        full = np.count_nonzero(occupied) == len(occupied)
        outside = 0
        for each in self._carriers:
            found = values.get(each.quantity)
            if found is None:
                continue
            wire, clipped = each.wire(found)
            if clipped is not None:
                outside += int(np.count_nonzero(clipped & occupied))
            table[each.row] = wire if full else np.where(occupied, wire, table[each.row])
        if new is not None:
            for row, value in self._new:
                table[row, new & occupied] = value
        for row, wrap in self._identities:
            table[row] = np.where(occupied, identity % wrap, table[row])
        for row, wrap in self._counters:
            table[row] = counter % wrap
        payloads, saturated = self._encoder.encode(table)
        ids = np.full(len(slot), self._ids[0]) if len(self._ids) == 1 else self._ids[slot]
        if self._protector is not None:
            if not payloads.flags.writeable:
                payloads = payloads.copy()
            self._protector.fill(ids, payloads)
        frames += zip(ids.tolist(), _cut(self._length, len(slot)).unpack(payloads.tobytes()), strict=True)
        return saturated + outside


@lru_cache
def _cut(length: int, count: int) -> Struct:
    """Make the cutter of so many joined payloads, all in one call."""
    return Struct(f"{length}s" * count)


def _alike(part: Part, checksum: str | None) -> list[list[int]]:
    """Group the slots whose messages have one length and one place for the checksum."""
    groups: dict[tuple[int, int | None], list[int]] = {}
    for slot, message in enumerate(part.messages):
        start = next((signal.start for signal in message.signals if signal.name == checksum), None)
        groups.setdefault((message.length, start), []).append(slot)
    return list(groups.values())
