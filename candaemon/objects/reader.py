"""Payloads of one scan's objects into quantities, vectorised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from candaemon.arrays import Booleans, Bytes, Floats, Integers
from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.config.base import Condition, SignalRef
from candaemon.config.sensors import ObjectFormat
from candaemon.dbc.batch_codec import BatchDecoder
from candaemon.dbc.bits import readable
from candaemon.dbc.types import Database, MessageSpec, SignalSpec
from candaemon.errors import ConfigError
from candaemon.objects.batch import ObjectBatch, every, same
from candaemon.objects.conditions import Test, compile_condition
from candaemon.objects.layout import Part, check_layouts, find_in_parts, resolve_parts
from candaemon.objects.signals import SignalBinding, bind_signal, field_reader

Column: TypeAlias = Sequence[bytes | None] | Bytes
"""Payloads of one part, one an object; None where it did not come. Or (n, length), where all came."""


@dataclass(slots=True)
class _PartPlan:
    """What to do with one part: rows of its decoder, the first of them quantities."""

    part: Part
    rows: dict[str, int]
    bindings: list[SignalBinding]
    valid: list[tuple[int, Test]]
    new: list[tuple[int, Test]]
    length: int = 0
    first: int = 0
    decoder: BatchDecoder | None = None
    gain: Floats = field(default_factory=lambda: np.empty((0, 1)))
    bias: Floats | None = None
    uncertain: bool = False

    def row(self, signal: SignalSpec) -> int:
        """Row of a signal, given one where it has none."""
        return self.rows.setdefault(signal.name, len(self.rows))

    def compile(self, first: int) -> None:
        """Make the decoder and the affine map of the quantities into rows from `first` on."""
        self.length, self.first = self.part.length, first
        # Signals that are no number in every frame (floats, multiplexed ones) can make a quantity NaN.
        self.uncertain = any(b.signal.is_float or b.signal.multiplexer_signal for b in self.bindings)
        if self.rows:
            self.decoder = BatchDecoder(self.part.layout, list(self.rows))
        self.gain = np.array([[binding.gain] for binding in self.bindings])
        bias = np.array([[binding.bias] for binding in self.bindings])
        self.bias = bias if bias.any() else None


class ObjectReader:
    """Reads objects of one format.

    Args:
        form: where the objects lie in the frames.
        signals: quantity → the signal it comes from.
        database: the DBC.
        where: place of the sensor in the configuration, holding `objects` and `signals`.

    Attributes:
        slots: objects the format can hold.
        parts: the messages of an object.
        routes: CAN id → (part, slot); slot −1 where all objects share the message.
        quantities: names of the rows of `ObjectBatch.values`.
        multiplexed: whether `object_key` tells the object.
        bindings: the quantities' signals, in the order of `quantities`.

    Raises:
        ConfigError: naming every message, signal and unit that is wrong.

    """

    def __init__(
        self,
        form: ObjectFormat,
        signals: Mapping[str, SignalRef],
        database: Database,
        *,
        where: SettingLocation | None = None,
    ) -> None:
        where = where or SettingLocation()
        place = where.at("objects")
        self.slots = form.slots
        self.multiplexed = form.multiplexed
        self.parts = resolve_parts(form, database, place)
        self.routes = _routes(self.parts, form.multiplexed, place)
        self._plans = [_PartPlan(part, {}, [], [], []) for part in self.parts]
        errors: list[ConfigError] = []
        for quantity, ref in signals.items():
            with collected(errors):
                self._add_quantity(quantity, ref, where.at("signals", quantity))
        for name, conditions in (("valid", form.valid), ("new", form.new)):
            for index, condition in enumerate(conditions):
                with collected(errors):
                    self._add_condition(name, condition, place.at(name, index))
        self._pairs: list[tuple[int, int]] = []
        for index, name in enumerate(form.pair):
            with collected(errors):
                self._pairs.append(self._row_of(name, place.at("pair", index)))
        self._identity: tuple[int, int] | None = None
        if form.identity is not None:
            with collected(errors):
                self._identity = self._row_of(form.identity, place.at("identity"))
        for kind, named in (("fixed", form.fixed), ("empty", form.empty)):
            for name in named:
                with collected(errors):
                    find_in_parts(self.parts, name, place.at(kind, name))
        raise_all(errors)
        for plan in self._plans:
            check_layouts(plan.part, [*plan.rows, *_id_name(plan.part)], place)
            plan.compile(sum(len(earlier.bindings) for earlier in self._plans[: plan.part.index]))
        self.bindings = tuple(binding for plan in self._plans for binding in plan.bindings)
        self.quantities = tuple(binding.quantity for binding in self.bindings)
        self._has_new = any(plan.new for plan in self._plans)
        self._keys = [
            field_reader(part.layout, part.id_signal) if part.id_signal is not None else None for part in self.parts
        ]

    def object_key(self, part: int, data: bytes) -> int:
        """Read the object id from a payload of a multiplexed format, 0 where there is only one object."""
        key = self._keys[part]
        return 0 if key is None else key(data)

    def read(self, columns: Sequence[Column]) -> ObjectBatch:
        """Read the objects of a scan.

        Args:
            columns: per part n payloads, each of the part's length or longer, or None where it did not come. Without a
                required part an object is not valid; without an optional one its quantities are NaN.

        """
        n = len(columns[0])
        values = np.empty((len(self.quantities), n))
        valid: list[Booleans] = []
        finite: list[Booleans] = []
        new: list[Booleans] = []
        raws: list[Floats] = []
        for plan in self._plans:
            payload, missing = _joined(columns[plan.part.index], plan.length)
            if missing is not None and not plan.part.optional:
                valid.append(~missing)
            if plan.decoder is None:
                raws.append(values)
                continue
            raw = plan.decoder.decode(payload)
            raws.append(raw)
            count = len(plan.bindings)
            if count:
                rows = values[plan.first : plan.first + count]
                np.multiply(raw[:count], plan.gain, out=rows)
                if plan.bias is not None:
                    rows += plan.bias
                if plan.uncertain:
                    finite.append(np.logical_and.reduce(np.isfinite(rows)))
                if missing is not None:
                    rows[:, missing] = np.nan
            # Where some objects lack a part, nothing is known of those.
            for row, test in plan.valid:
                passed: Booleans = test(raw[row])
                valid.append(passed if missing is None else passed | missing)
            for row, test in plan.new:
                passed = test(raw[row])
                new.append(passed if missing is None else passed & ~missing)
        is_new = every(new, n) if self._has_new else same(False, n)
        is_valid, not_finite = every(valid, n), None
        if finite:
            told, is_valid = is_valid, is_valid & every(finite, n)
            not_finite = told & ~is_valid
        paired = self._paired(raws, columns, n)
        return ObjectBatch(self._identities(raws, n), is_valid, is_new, paired, values, not_finite)

    def _identities(self, raws: Sequence[Floats], n: int) -> Integers:
        if self._identity is None:
            return same(-1, n)
        part, row = self._identity
        identities: Integers = raws[part][row].astype(np.int64)
        return identities

    def _paired(self, raws: Sequence[Floats], columns: Sequence[Column], n: int) -> Booleans:
        tested: list[Booleans] = []
        if self._pairs:
            (first, first_row), *others = self._pairs
            for part, row in others:
                equal = raws[first][first_row] == raws[part][row]
                if self.parts[part].optional:
                    equal |= np.array([payload is None for payload in columns[part]], np.bool_)
                tested.append(equal)
        return every(tested, n)

    def _add_quantity(self, quantity: str, ref: SignalRef, where: SettingLocation) -> None:
        part, signal = find_in_parts(self.parts, ref.signal, where)[0]
        plan = self._plans[part.index]
        binding = bind_signal(quantity, ref, signal, where)
        if signal.name in plan.rows:
            other = plan.bindings[plan.rows[signal.name]].quantity
            raise where.error(f"signal '{signal.name}' is {other} already; a signal gives one quantity")
        plan.row(signal)
        plan.bindings.append(binding)

    def _add_condition(self, name: str, condition: Condition, where: SettingLocation) -> None:
        part, signal = find_in_parts(self.parts, condition.signal, where)[0]
        plan = self._plans[part.index]
        test = _tabulated(compile_condition(condition, signal, where), signal, part.layout)
        (plan.valid if name == "valid" else plan.new).append((plan.row(signal), test))

    def _row_of(self, name: str, where: SettingLocation) -> tuple[int, int]:
        part, signal = find_in_parts(self.parts, name, where)[0]
        return part.index, self._plans[part.index].row(signal)


def _tabulated(test: Test, signal: SignalSpec, message: MessageSpec) -> Test:
    """Make a look-up of a test of a short plain number, one step whatever it compares with."""
    plain = not (signal.signed or signal.is_float) and (signal.scale, signal.offset) == (1, 0)
    always = readable(message, signal) and not any(each.is_multiplexer for each in message.signals)
    if not plain or not always or signal.length > 8:
        return test
    passed = np.array([bool(test(float(value))) for value in range(1 << signal.length)], np.bool_)
    return lambda values: passed.take(values.astype(np.intp))


def _id_name(part: Part) -> list[str]:
    return [] if part.id_signal is None else [part.id_signal.name]


def _routes(parts: Sequence[Part], multiplexed: bool, where: SettingLocation) -> dict[int, tuple[int, int]]:
    """Map each CAN id to its part and slot."""
    routes: dict[int, tuple[int, int]] = {}
    for part in parts:
        for slot, message in enumerate(part.messages):
            if message.can_id in routes:
                other = parts[routes[message.can_id][0]]
                raise where.at("messages", part.index).error(
                    f"message '{message.name}' has the id 0x{message.can_id & 0x1FFFFFFF:X} "
                    f"that '{other.pattern}' has already; every message of an object needs its own"
                )
            routes[message.can_id] = (part.index, -1 if multiplexed else slot)
    return routes


def _joined(column: Column, length: int) -> tuple[bytes | Bytes, Booleans | None]:
    """Join a part's payloads, zeros for those missing, and tell which are."""
    if isinstance(column, np.ndarray):
        return column, None
    missing = None
    try:
        payload = b"".join(column)  # type: ignore[arg-type]  # a None in it is what the except is for
    except TypeError:
        blank = bytes(length)
        missing = np.array([data is None for data in column], np.bool_)
        column = [blank if data is None else data for data in column]
        payload = b"".join(data for data in column if data is not None)
    if len(payload) != len(column) * length:
        payload = b"".join(data[:length] for data in column if data is not None)
    return payload, missing
