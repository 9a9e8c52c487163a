"""How each signal of an object's message is written: which values say occupied, empty, new."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from candaemon.binding.conditions import (
    candidates,
    compile_condition,
    first_that,
    on_grid,
    passing_interval,
    value_limits,
    value_width,
)
from candaemon.binding.parts import Part, find_in_parts
from candaemon.binding.signals import SignalBinding, bind_signal, wraps_at
from candaemon.binding.where import Where
from candaemon.bus.spec import SignalSpec
from candaemon.config.base import Condition, SignalRef
from candaemon.config.sensors import ObjectFormat

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


def add_quantity(plans: Sequence[PartPlan], quantity: str, ref: SignalRef, where: Where) -> None:
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


def add_values(plans: Sequence[PartPlan], values: Mapping[str, float], kind: str, where: Where) -> None:
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


def add_conditions(plans: Sequence[PartPlan], form: ObjectFormat, where: Where) -> None:
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


def _by_signal(plans: Sequence[PartPlan], conditions: Sequence[Condition], where: Where) -> list[_SignalTest]:
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


def _choose_occupied(test: _SignalTest, fixed: set[str], where: Where) -> None:
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


def _choose_new(test: _SignalTest, valid: _SignalTest | None, where: Where) -> None:
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


def _choose_empty(valid: Sequence[_SignalTest], form: ObjectFormat, where: Where) -> None:
    """Make an empty slot fail one condition."""
    if form.empty:
        raise where.at("empty").error("a slot written so passes all conditions of 'valid'; give a value that fails one")
    for test in valid:
        value = first_that(test.candidates(), lambda value: not test.holds(value))  # noqa: B023  # called at once
        if value is not None:
            test.plan.empty = value
            return
    raise where.at("valid").error("no value fails these conditions, so a slot cannot be written as empty")
