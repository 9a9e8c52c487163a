"""Objects into payloads, vectorised: the mirror of the reader, for output and simulation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from struct import Struct
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from candaemon.binding.carrier import carrier
from candaemon.binding.parts import Part, check_layouts, find_in_parts, resolve_parts
from candaemon.binding.plan import PartPlan, add_conditions, add_quantity, add_values
from candaemon.binding.protection import PartProtection, check_written, counter_period, part_protector, parts_protection
from candaemon.binding.signals import wraps_at
from candaemon.binding.where import Where, collected, raise_all
from candaemon.bus.codec import BatchEncoder
from candaemon.bus.spec import Database
from candaemon.config.base import SignalRef
from candaemon.config.protection import InputProtectionSettings, ProtectionSettings
from candaemon.config.sensors import ObjectFormat
from candaemon.errors import ConfigError

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Booleans = npt.NDArray[np.bool_]
Values: TypeAlias = Mapping[str, npt.NDArray[np.float64] | npt.NDArray[np.integer]]
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
        where: Where | None = None,
    ) -> None:
        where = where or Where()
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


def _add_counted(plans: list[PartPlan], counted: Iterable[str], identity: str | None, where: Where) -> None:
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
        self, plan: PartPlan, slots: Sequence[int], protection: PartProtection[AnyProtection], where: Where
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
