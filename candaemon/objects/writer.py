"""Objects into payloads, vectorised: the mirror of the reader, for output and simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from candaemon.arrays import Booleans, Floats, Indices, Integers
from candaemon.dbc.batch_codec import BatchEncoder
from candaemon.frames.payload_table import Payloads, PayloadTable
from candaemon.objects.message_layout import MessageLayout
from candaemon.objects.signals import AngleForm, form_of
from candaemon.protection.checksums import FrameProtector

QuantityValues: TypeAlias = Mapping[str, Floats | npt.NDArray[np.integer]]
"""Quantity → (m,) values of the slots written."""


@dataclass(slots=True)  # made each cycle
class SlotValues:
    """What m slots say in one cycle.

    Attributes:
        slot: (m,) slots, from 0.
        values: quantity → (m,) in SI and the signals' axes; one left out is written as 0. NaN is unknown where the
            quantity may be that.
        occupied: (m,) whether the slot holds an object; an empty one is written so that it reads invalid.
        counter: what counters and pair signals show, modulo their width; one for all or (m,).
        new: (m,) whether the object is new in its slot; None: none is.
    """

    slot: Integers
    values: QuantityValues
    occupied: Booleans
    counter: int | Integers
    new: Booleans | None = None


@dataclass(frozen=True, slots=True)
class QuantityColumn:
    """A signal that carries a quantity.

    Attributes:
        row: of the signal among those encoded.
        quantity: its name.
        wrap: number of values of a quantity that wraps, 0 where it saturates.
        gain: SI units of the quantity per unit of the signal.
        bias: quantity where the signal's value is 0.
        limits: values it is clipped to, None where the encoder's own limits do.
        lossy: whether clipping counts as saturated.
        unknown: the signal's value where the quantity is NaN; None where it never is.
        codes: the signal's values by class; None where the quantity is none, or its own value.
        form: whether the signal gives the sine or the slope of the quantity, an angle; None: neither.

    """

    row: int
    quantity: str
    wrap: int
    gain: float
    bias: float
    limits: tuple[float, float] | None
    lossy: bool
    unknown: float | None = None
    codes: Floats | None = None
    form: AngleForm | None = None

    def signal_values(self, found: Floats | npt.NDArray[np.integer]) -> tuple[Floats, Booleans | None]:
        """Convert the quantity into the signal's values; return with them which were clipped, None if that is free."""
        if self.codes is not None:
            return self.codes.take(found.astype(np.intp), mode="clip"), None
        wire: Floats = np.asarray(found % self.wrap if self.wrap else found, np.float64)
        if self.form is not None:
            wire = form_of(wire, self.form)
        if self.bias:
            wire = wire - self.bias
        if self.gain != 1.0:
            wire = wire / self.gain
        if self.limits is None:
            return wire, None
        low, high = self.limits
        inside = np.minimum(np.maximum(wire, low), high)
        clipped = (inside < wire) | (inside > wire) if self.lossy else None
        if self.unknown is not None:
            np.copyto(inside, self.unknown, where=np.isnan(inside))
        return inside, clipped


@dataclass(frozen=True, slots=True)
class LayoutWriter:
    """Writes the messages of one layout; of several lengths in a layout, those of one length.

    Attributes:
        encoder: of the signals, a row each.
        length: payload bytes.
        can_ids: by place of the whole layout; a single one where all objects share the message.
        mine: by place, whether this writer writes it; None where it writes all.
        templates: (signals, 2) values in an empty and in an occupied slot.
        columns: the signals that carry quantities.
        new: row and value of each signal that shows an object to be new in its slot.
        counters: row and number of values of each signal that counts.
        identities: row and number of values of each signal that shows the identity.
        protector: counter and checksum, None where there are none.
        points: objects in a message.
        of_point: rows of the signals that each point has; the encoder's rows are those of the first point and of the
            message, then these again for each further point.
        place: row of the signal that says which place a message is of, and its value by place; None where none does,
            or an identity does.
        page: likewise of the signal that says on which page of the list a message is.

    """

    encoder: BatchEncoder
    length: int
    can_ids: Integers
    mine: Booleans | None
    templates: Floats
    columns: tuple[QuantityColumn, ...]
    new: tuple[tuple[int, float], ...]
    counters: tuple[tuple[int, int], ...]
    identities: tuple[tuple[int, int], ...]
    protector: FrameProtector | None
    points: int = 1
    of_point: Indices = field(default_factory=lambda: np.empty(0, np.intp))
    place: tuple[int, Integers] | None = None
    page: tuple[int, Integers] | None = None

    def write(
        self,
        slot: Integers,
        values: QuantityValues,
        occupied: Booleans,
        counter: int | Integers,
        new: Booleans | None,
        identity: Integers,
    ) -> tuple[PayloadTable | None, int]:
        """Return the frames, None where there are none, and how many values were saturated.

        Arguments as `ObjectWriter.write`.
        """
        if self.mine is not None:
            chosen = np.flatnonzero(self.mine[slot // self.points % len(self.mine)])
            if not len(chosen):
                return None, 0
            slot, occupied, identity = slot[chosen], occupied[chosen], identity[chosen]
            values = {quantity: found[chosen] for quantity, found in values.items()}
            counter = counter if isinstance(counter, int) else counter[chosen]
            new = None if new is None else new[chosen]
        table = self.templates.take(occupied.view(np.int8), axis=1)
        full = np.count_nonzero(occupied) == len(occupied)
        outside = 0
        for each in self.columns:
            found = values.get(each.quantity)
            if found is None:
                continue
            wire, clipped = each.signal_values(found)
            if clipped is not None:
                outside += int(np.count_nonzero(clipped & occupied))
            table[each.row] = wire if full else np.where(occupied, wire, table[each.row])
        if new is not None:
            for row, value in self.new:
                table[row, new & occupied] = value
        for row, wrap in self.identities:
            table[row] = np.where(occupied, identity % wrap, table[row])
        if self.place is not None:
            row, of_place = self.place
            table[row] = of_place[slot // self.points]
        if self.page is not None:
            row, of_place = self.page
            table[row] = of_place[slot // self.points]
        for row, wrap in self.counters:
            table[row] = counter % wrap
        if self.points > 1:
            slot, table = self._by_message(slot, table, occupied)
        payloads, saturated = self.encoder.encode(table)
        ids = np.full(len(slot), self.can_ids[0]) if len(self.can_ids) == 1 else self.can_ids[slot % len(self.can_ids)]
        if self.protector is not None:
            if not payloads.flags.writeable:
                payloads = payloads.copy()
            self.protector.fill(ids, payloads)
        return PayloadTable(ids, payloads), saturated + outside

    def _by_message(self, slot: Integers, table: Floats, occupied: Booleans) -> tuple[Integers, Floats]:
        """Put the columns of objects, all points of each message side by side, into one column a message."""
        messages = len(slot) // self.points
        each = table.reshape(len(table), messages, self.points)
        # what all points of a message share shows what the first object in it does
        shown = occupied.reshape(messages, self.points).argmax(axis=1)
        whole = np.take_along_axis(each, shown[None, :, None], axis=2)[:, :, 0]
        of_point = each[self.of_point].transpose(2, 0, 1)
        whole[self.of_point] = of_point[0]
        return slot[:: self.points] // self.points, np.concatenate([whole, *of_point[1:]])


class ObjectWriter:
    """Writes objects of one format; `binding.bind_writer` makes it.

    Args:
        slots: objects the format can hold.
        points: objects in one message.
        layouts: the messages of an object.
        quantities: those that `write` uses.
        data_ids: messages that share the data ids of the protection.
        writers: of the layouts, in their order; several of one layout where its messages differ in length.

    Attributes:
        saturated: values so far that did not fit their signal and were clipped to its limits.

    """

    def __init__(
        self,
        *,
        slots: int,
        points: int = 1,
        layouts: Sequence[MessageLayout],
        quantities: Sequence[str],
        data_ids: int,
        writers: Sequence[LayoutWriter],
    ) -> None:
        self.slots, self.layouts, self.quantities = slots, tuple(layouts), tuple(quantities)
        self.points, self.places = points, slots // points
        self.data_ids = data_ids
        self.saturated = 0
        self._writers = tuple(writers)

    def write(
        self,
        slot: Integers,
        values: QuantityValues,
        occupied: Booleans,
        *,
        counter: int | Integers,
        new: Booleans | None = None,
        identity: Integers | None = None,
    ) -> Payloads:
        """Write m slots.

        Args:
            slot: (m,) slots, from 0.
            values: quantity → (m,) in SI and the signals' axes; one left out is written as 0. NaN is unknown where the
                quantity may be that.
            occupied: (m,) whether the slot holds an object; an empty one is written so that it reads invalid.
            counter: what counters and pair signals show, modulo their width; one for all or (m,).
            new: (m,) whether the object is new in its slot; default: none is.
            identity: (m,) the objects' identities, modulo their signal's width; default: the slots.

        Returns:
            CAN id and payload: the first message of every slot, then the second, and so on.

        """
        written = self._tables(SlotValues(slot, values, occupied, counter, new), identity)
        return [frame for table in written for frame in table.listed()]

    def _tables(self, told: SlotValues, identity: Integers | None = None) -> list[PayloadTable]:
        """Return what `write` returns, a table a message."""
        slot, values, occupied, counter = told.slot, told.values, told.occupied, told.counter
        if not len(slot):
            return []
        identity = slot if identity is None else identity
        new = None if told.new is None or not np.count_nonzero(told.new) else told.new
        if self.points > 1:
            slot, values, occupied, counter, new, identity = self._whole_messages(
                slot, values, occupied, counter, new, identity
            )
        tables = []
        for writer in self._writers:
            table, saturated = writer.write(slot, values, occupied, counter, new, identity)
            self.saturated += saturated
            if table is not None:
                tables.append(table)
        return tables

    @property
    def frames_a_slot(self) -> int | None:
        """How many frames `write` makes of each slot; None where that depends on the slots."""
        if self.points > 1 or any(writer.mine is not None for writer in self._writers):
            return None
        return len(self._writers)

    def write_cycles(self, told: SlotValues, counts: Sequence[int]) -> list[list[PayloadTable]]:
        """Write the slots of several cycles at once, each message in the array operations that one cycle takes.

        Args:
            told: what the slots say, cycle after cycle; of one cycle where `frames_a_slot` is None.
            counts: slots of each cycle.

        Returns:
            The frames of each cycle in the order of `write`, a table a message.

        """
        tables = self._tables(told)
        if len(counts) == 1:
            return [tables]
        ends = np.cumsum(counts).tolist()
        return [[table.rows(end - count, end) for table in tables] for count, end in zip(counts, ends, strict=True)]

    def _whole_messages(
        self,
        slot: Integers,
        values: QuantityValues,
        occupied: Booleans,
        counter: int | Integers,
        new: Booleans | None,
        identity: Integers,
    ) -> tuple[Integers, QuantityValues, Booleans, int | Integers, Booleans | None, Integers]:
        """Add the slots, empty, that are in a message with one of those given. Arguments as `write`."""
        messages = np.unique(slot // self.points)
        every = (messages[:, None] * self.points + np.arange(self.points)).ravel()
        place = np.searchsorted(every, slot)

        def spread(found: npt.NDArray[Any]) -> npt.NDArray[Any]:
            full = np.zeros(len(every), found.dtype)
            full[place] = found
            return full

        if not isinstance(counter, int):  # one frame has one counter: that of its first slot given
            order = place[::-1]
            of_message = np.zeros(len(messages), counter.dtype)
            of_message[order // self.points] = counter[::-1]
            counter = of_message.repeat(self.points)
        everywhere = every.copy()
        everywhere[place] = identity
        return (
            every,
            {name: spread(found) for name, found in values.items()},
            spread(occupied),
            counter,
            None if new is None else spread(new),
            everywhere,
        )
