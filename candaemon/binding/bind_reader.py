"""The reader of a sensor's objects, bound: its messages, signals, units and conditions found and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from candaemon.binding.bind_signal import bind_signal
from candaemon.binding.compile_condition import compile_condition, tabulate
from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.binding.look_up import check_alike, find_in_layouts, find_layouts
from candaemon.config.base import Condition, SignalRef
from candaemon.config.sensors import ObjectFormat
from candaemon.dbc.types import Database
from candaemon.errors import ConfigError
from candaemon.objects.message_layout import MessageLayout
from candaemon.objects.reader import LayoutReader, ObjectReader, ReadCondition, Row
from candaemon.objects.signals import SignalBinding


def bind_reader(
    form: ObjectFormat, signals: Mapping[str, SignalRef], database: Database, location: SettingLocation | None = None
) -> ObjectReader:
    """Bind the reader of one object format.

    Args:
        form: where the objects lie in the frames.
        signals: quantity → the signal it comes from.
        database: the DBC.
        location: place of the sensor in the configuration, holding `objects` and `signals`.

    Raises:
        ConfigError: naming every message, signal and unit that is wrong.

    """
    location = location or SettingLocation()
    place = location.at("objects")
    layouts = find_layouts(form, database, place)
    routes = _routes(layouts, form.multiplexed, place)
    read = _ReadSignals(layouts)
    errors: list[ConfigError] = []
    for quantity, ref in signals.items():
        with collected(errors):
            read.add_quantity(quantity, ref, location.at("signals", quantity))
    for index, condition in enumerate(form.valid):
        with collected(errors):
            read.valid.append(read.condition(condition, place.at("valid", index)))
    for index, condition in enumerate(form.new):
        with collected(errors):
            read.new.append(read.condition(condition, place.at("new", index)))
    pairs: list[Row] = []
    for index, name in enumerate(form.pair):
        with collected(errors):
            pairs.append(read.row(name, place.at("pair", index)))
    identity: Row | None = None
    if form.identity:
        with collected(errors):
            identity = read.row(form.identity, place.at("identity"))
    for kind, named in (("fixed", form.fixed), ("empty", form.empty)):
        for name in named:
            with collected(errors):
                find_in_layouts(layouts, name, place.at(kind, name))
    raise_all(errors)
    return ObjectReader(
        slots=form.slots,
        multiplexed=form.multiplexed,
        readers=[read.reader(layout, place) for layout in layouts],
        routes=routes,
        pairs=pairs,
        identity=identity,
    )


def _routes(
    layouts: Sequence[MessageLayout], multiplexed: bool, location: SettingLocation
) -> dict[int, tuple[int, int]]:
    """Map each CAN id to its layout and slot."""
    routes: dict[int, tuple[int, int]] = {}
    for layout in layouts:
        for slot, message in enumerate(layout.messages):
            if message.can_id in routes:
                other = layouts[routes[message.can_id][0]]
                raise location.at("messages", layout.index).error(
                    f"message '{message.name}' has the id 0x{message.can_id & 0x1FFFFFFF:X} "
                    f"that '{other.pattern}' has already; every message of an object needs its own"
                )
            routes[message.can_id] = (layout.index, -1 if multiplexed else slot)
    return routes


@dataclass(slots=True)
class _ReadSignals:
    """The signals that a reader decodes, gathered layout by layout: those of quantities first.

    Attributes:
        layouts: the messages of an object.
        rows: per layout, row of each signal by its name.
        bindings: per layout, the signals that are quantities, in the order of their rows.
        valid: conditions with the signal they are on.
        new: likewise.

    """

    layouts: tuple[MessageLayout, ...]
    rows: list[dict[str, int]] = field(init=False)
    bindings: list[list[SignalBinding]] = field(init=False)
    valid: list[tuple[Row, ReadCondition]] = field(default_factory=list)
    new: list[tuple[Row, ReadCondition]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rows = [{} for _ in self.layouts]
        self.bindings = [[] for _ in self.layouts]

    def row(self, name: str, location: SettingLocation) -> Row:
        """Find a signal's layout and row; one not decoded so far gets the next row."""
        layout, signal = find_in_layouts(self.layouts, name, location)[0]
        rows = self.rows[layout.index]
        return layout.index, rows.setdefault(signal.name, len(rows))

    def add_quantity(self, quantity: str, ref: SignalRef, location: SettingLocation) -> None:
        """Bind the signal of a quantity."""
        layout, signal = find_in_layouts(self.layouts, ref.signal, location)[0]
        rows, bindings = self.rows[layout.index], self.bindings[layout.index]
        binding = bind_signal(quantity, ref, signal, location)
        if signal.name in rows:
            other = bindings[rows[signal.name]].quantity
            raise location.error(f"signal '{signal.name}' is {other} already; a signal gives one quantity")
        rows[signal.name] = len(rows)
        bindings.append(binding)

    def condition(self, condition: Condition, location: SettingLocation) -> tuple[Row, ReadCondition]:
        """Compile a condition for the signal it is on."""
        layout, signal = find_in_layouts(self.layouts, condition.signal, location)[0]
        compiled = tabulate(compile_condition(condition, signal, location), signal, layout.shortest)
        return self.row(condition.signal, location), compiled

    def reader(self, layout: MessageLayout, location: SettingLocation) -> LayoutReader:
        """Make the reader of one layout, whose messages must carry the signals alike."""
        index, names = layout.index, list(self.rows[layout.index])
        check_alike(layout, names if layout.id_signal is None else [*names, layout.id_signal.name], location)
        valid = [(row, condition) for (of, row), condition in self.valid if of == index]
        new = [(row, condition) for (of, row), condition in self.new if of == index]
        return LayoutReader(layout, names, self.bindings[index], valid, new)
