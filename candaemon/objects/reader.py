"""Payloads of one scan into its objects, vectorised."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from math import inf
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from candaemon.arrays import Booleans, Bytes, Floats, Integers
from candaemon.dbc.batch_codec import BatchDecoder
from candaemon.dbc.bits import sendable_values
from candaemon.dbc.single_codec import compile_field_reader
from candaemon.objects.conditions import CompiledCondition, KnownCondition, TabulatedCondition
from candaemon.objects.message_layout import MessageLayout, point_name
from candaemon.objects.object_batch import ObjectBatch
from candaemon.objects.signals import SignalBinding, angle_of

Column: TypeAlias = Sequence[bytes | None] | Bytes
"""Payloads of one layout, one an object; None where it did not come. Or (n, length), where all came."""
Row: TypeAlias = tuple[int, int]
"""A decoded signal: index of its layout, and its row there."""
ReadCondition: TypeAlias = CompiledCondition | TabulatedCondition | KnownCondition
POSITION: Final = ("x", "y", "range", "azimuth")
"""Quantities without which an object is nowhere."""
SPEEDS: Final = ("range_rate", "vx", "vy")
"""Quantities that are not known at an end of their signals: an obstacle would have that speed."""
BOUNDED: Final = (*POSITION, *SPEEDS)
"""Quantities of which the ends of their signals are bounds: what is farther or faster is told as them."""


class Claim(NamedTuple):
    """What frames of an identifier that several messages share are of one of them.

    Attributes:
        length: payload bytes of the message.
        read: payload → the value that says it.
        value: that of these frames.
        layout: index of the layout they are of.
        place: theirs; −1 where the payload says it.
    """

    length: int
    read: Callable[[bytes], int]
    value: int
    layout: int
    place: int


class LayoutReader:
    """How the messages of one layout are read.

    Args:
        layout: the messages.
        names: signals that are decoded, a row each; those of the bindings come first, in their order.
        bindings: the signals that are quantities.
        valid: row and condition of each signal that makes an object valid.
        new: row and condition of each signal that makes it new in its slot.
        points: objects in a message.

    Attributes:
        length: payload bytes that are read.
        decoder: of the signals, None where nothing of these messages is read.
        required: signals without which an object is not used.
        gain: (quantities, 1) SI units per unit of the signal.
        bias: (quantities, 1) in SI, None where all are 0.
        uncertain: whether a quantity may be NaN, as floats and multiplexed signals can.
        selective: whether any signal may be, by a multiplexer's value.
        unknown: row of each signal and value of it that says nothing, and how near to that is as good.
        ends: row of each signal of a place or speed, a value of it that is a bound (its least or greatest, not 0), and
            whether it is of a place.
        codes: row of each signal with values for classes, and those values (1, classes).
        angles: row of each signal that gives the sine or the slope of an angle, and which of them.

    """

    def __init__(
        self,
        layout: MessageLayout,
        names: Sequence[str],
        bindings: Sequence[SignalBinding],
        valid: Sequence[tuple[int, ReadCondition]],
        new: Sequence[tuple[int, ReadCondition]],
        points: int = 1,
    ) -> None:
        self.layout, self.bindings = layout, tuple(bindings)
        self.points = points
        self.valid, self.new = tuple(valid), tuple(new)
        self.length = layout.length
        conditional = (layout.shortest.signal(point_name(names[row], 0)) for row, _ in valid)
        self.required = tuple(dict.fromkeys([*(each.signal for each in bindings), *conditional]))
        each = [point_name(name, point) for point in range(points) for name in names]
        self.decoder = BatchDecoder(layout.shortest, each) if names else None
        self.gain: Floats = np.array([[binding.gain] for binding in bindings])
        bias = np.array([[binding.bias] for binding in bindings])
        self.bias: Floats | None = bias if bias.any() else None
        self.unknown = tuple(
            (row, value, abs(each.signal.scale) / 2) for row, each in enumerate(bindings) for value in each.unknown
        )
        self.ends = tuple(
            (row, end, each.quantity in POSITION)
            for row, each in enumerate(bindings)
            if each.quantity in BOUNDED and not each.signal.is_float
            for end in sendable_values(each.signal)
            if each.gain * end + each.bias != 0.0
        )
        self.angles = tuple((row, each.form) for row, each in enumerate(bindings) if each.form is not None)
        self.codes = tuple((row, np.array([each.codes])) for row, each in enumerate(bindings) if each.codes is not None)
        self.uncertain = any(each.signal.is_float or each.signal.multiplexer_signal for each in bindings)
        self.selective = any(signal.is_multiplexer for signal in layout.shortest.signals)

    def decode(self, payload: bytes | Bytes) -> Floats:
        """Decode the signals of n frames: a row each, a column an object."""
        assert self.decoder is not None, "there are signals to decode"  # noqa: S101  # the caller asked
        raw = self.decoder.decode(payload)
        if self.points == 1:
            return raw
        signals, frames = len(raw) // self.points, raw.shape[1]
        return raw.reshape(self.points, signals, frames).transpose(1, 2, 0).reshape(signals, frames * self.points)


class ObjectReader:
    """Reads objects of one format; `binding.bind_reader` makes it.

    Args:
        slots: objects the format can hold.
        points: objects in one message.
        multiplexed: whether all objects share their messages and `object_key` gives the object of a payload.
        readers: one a message of the object.
        routes: CAN id → (layout, place); place −1 where all objects share the message.
        claims: by CAN id, what of its frames is whose, where a value in them says it.
        pairs: signals that are equal in messages of one object.
        identity: the signal that is the object's identity, None where the format has none.

    Attributes:
        places: messages that a scan can hold of each of an object's messages: slots, where each holds one object.
        layouts: the messages of an object.
        paged: whether a value in each frame says on which page of the list it is.
        bindings: the signals that are quantities.
        quantities: their names, in the same order: the rows of `ObjectBatch.values`.
        longest: the greatest length that its signal can tell, m: what is longer is told as that; infinite where there
            is none.
        required: signals without which an object is not used, of quantities and of what makes it valid, with their
            layout.

    """

    def __init__(
        self,
        *,
        slots: int,
        points: int = 1,
        multiplexed: bool,
        readers: Sequence[LayoutReader],
        routes: Mapping[int, tuple[int, int]],
        claims: Mapping[int, tuple[Claim, ...]] | None = None,
        pairs: Sequence[Row],
        identity: Row | None,
    ) -> None:
        self.slots, self.multiplexed, self.routes = slots, multiplexed, routes
        self.points, self.places = points, slots // points
        self.claims = claims or {}
        self.layouts = tuple(reader.layout for reader in readers)
        self.bindings = tuple(binding for reader in readers for binding in reader.bindings)
        self.quantities = tuple(binding.quantity for binding in self.bindings)
        self.longest = next((_greatest(each) for each in self.bindings if each.quantity == "length"), inf)
        self.required = tuple((reader.layout, signal) for reader in readers for signal in reader.required)
        self._readers = tuple(readers)
        self._pairs, self._identity = tuple(pairs), identity
        self._has_new = any(reader.new for reader in readers)
        self._pages = [
            None if each.page is None else (compile_field_reader(each.shortest, each.page.signal), each.page)
            for each in self.layouts
        ]
        self.paged = any(each is not None for each in self._pages)
        self._keys = [
            None if each.id_signal is None else compile_field_reader(each.shortest, each.id_signal)
            for each in self.layouts
        ]

    @property
    def reports_new(self) -> bool:
        """Whether every object is reported as new in its slot or not, by messages that cannot be missing."""
        return self._has_new and not any(reader.new and reader.layout.optional for reader in self._readers)

    def object_key(self, layout: int, data: bytes) -> int:
        """Read the place from a payload of a multiplexed format, 0 where there is only one, −1 where it is none."""
        key = self._keys[layout]
        return 0 if key is None else self.layouts[layout].place(key(data))

    def place_of(self, layout: int, place: int, data: bytes) -> int:
        """Return the place in the whole list of a frame with a place on its page, −1 where there is no such page."""
        paging = self._pages[layout]
        if paging is None or place < 0:
            return place
        read, page = paging
        before = page.offset(read(data))
        return -1 if before < 0 or place >= page.places else before + place

    def read(self, columns: Sequence[Column]) -> ObjectBatch:
        """Read the objects of a scan.

        Args:
            columns: per layout n payloads (of as many objects, or `points` times as many), each of the layout's length
                or longer, or None where it did not come. Without a required message an object is not valid; without an
                optional one its quantities are NaN, as one is whose signal says that it is not known.

        """
        n = len(columns[0]) * self.points
        values = np.empty((len(self.quantities), n))
        valid: list[Booleans] = []
        finite: list[Booleans] = []
        new: list[Booleans] = []
        raws: list[Floats] = []
        at_end: Booleans | None = None
        first = 0
        for reader, column in zip(self._readers, columns, strict=True):
            payload, missing = _joined(column, reader.length)
            if missing is not None and self.points > 1:
                missing = missing.repeat(self.points)
            if missing is not None and not reader.layout.optional:
                valid.append(~missing)
            if reader.decoder is None:
                raws.append(values)
                continue
            raw = reader.decode(payload)
            raws.append(raw)
            count = len(reader.bindings)
            if count:
                rows = values[first : first + count]
                first += count
                np.multiply(raw[:count], reader.gain, out=rows)
                if reader.bias is not None:
                    rows += reader.bias
                if reader.uncertain:
                    is_finite: Booleans = np.logical_and.reduce(np.isfinite(rows))
                    finite.append(is_finite if missing is None else is_finite | missing)
                for row, form in reader.angles:
                    rows[row] = angle_of(rows[row], form)
                for row, unknown, near in reader.unknown:
                    rows[row, np.abs(raw[row] - unknown) < near] = np.nan
                for row, end, is_place in reader.ends:
                    bound = raw[row] == end
                    if not np.count_nonzero(bound):
                        continue
                    if is_place:
                        at_end = bound if at_end is None else at_end | bound
                    else:
                        rows[row, bound] = np.nan
                for row, codes in reader.codes:  # a value that stands for no class is the first: unknown
                    rows[row] = (raw[row][:, None] == codes).argmax(axis=1)
                if missing is not None:
                    rows[:, missing] = np.nan
            # Where some objects lack a message, nothing is known of those.
            for row, condition in reader.valid:
                passed: Booleans = condition.passes(raw[row])
                if reader.selective:
                    absent = np.isnan(raw[row])
                    if missing is not None:
                        absent &= ~missing
                    passed = passed | absent  # nothing says that it is not reported: it is counted
                    finite.append(~absent)
                valid.append(passed if missing is None else passed | missing)
            for row, condition in reader.new:
                passed = condition.passes(raw[row])
                new.append(passed if missing is None else passed & ~missing)
        is_new = _all_of(new, n) if self._has_new else _constant(False, n)
        is_valid, not_finite = _all_of(valid, n), None
        if finite:
            reported, is_valid = is_valid, is_valid & _all_of(finite, n)
            not_finite = reported & ~is_valid
        paired = self._paired(raws, columns, n)
        return ObjectBatch(self._identities(raws, n), is_valid, is_new, paired, values, not_finite, at_end)

    def _identities(self, raws: Sequence[Floats], n: int) -> Integers:
        if self._identity is None:
            return _constant(-1, n)
        layout, row = self._identity
        identities: Integers = raws[layout][row].astype(np.int64)
        return identities

    def _paired(self, raws: Sequence[Floats], columns: Sequence[Column], n: int) -> Booleans:
        equalities: list[Booleans] = []
        if self._pairs:
            (first, first_row), *others = self._pairs
            for layout, row in others:
                equal = raws[first][first_row] == raws[layout][row]
                if self.layouts[layout].optional:
                    equal |= np.array([payload is None for payload in columns[layout]], np.bool_).repeat(self.points)
                equalities.append(equal)
        return _all_of(equalities, n)


@lru_cache
def _constant(value: int, n: int) -> npt.NDArray[Any]:
    """Return an array (n,) of one value; made once, so it is read-only."""
    array = np.full(n, value)
    array.flags.writeable = False
    return array


def _all_of(tests: Sequence[Booleans], n: int) -> Booleans:
    """Return which of n objects pass all tests; the first test's array may be overwritten with it."""
    if not tests:
        return _constant(True, n)
    first, *others = tests
    for each in others:
        first &= each
    return first


def _greatest(binding: SignalBinding) -> float:
    """Return the greatest value that a signal can tell of its quantity, SI."""
    if binding.signal.is_float:
        return inf
    return max(binding.gain * end + binding.bias for end in sendable_values(binding.signal))


def _joined(column: Column, length: int) -> tuple[bytes | Bytes, Booleans | None]:
    """Join a layout's payloads, zeros for those missing; return with them which are missing, None where none is."""
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
