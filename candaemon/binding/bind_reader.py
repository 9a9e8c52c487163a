"""The reader of a sensor's objects, bound: its messages, signals, units and conditions found and checked."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from candaemon.binding.bind_signal import DEFAULT_UNITS, bind_signal
from candaemon.binding.compile_condition import compile_condition, tabulate
from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.binding.look_up import check_alike, find_in_layouts, find_layouts
from candaemon.binding.numbered_names import numbered_names, unlike_point
from candaemon.config.base import Condition, SignalRef, Units
from candaemon.config.sensors import ObjectFormat
from candaemon.dbc.single_codec import compile_field_reader
from candaemon.dbc.types import Database
from candaemon.errors import ConfigError
from candaemon.objects.conditions import KnownCondition
from candaemon.objects.message_layout import MessageLayout, is_of_point, point_name
from candaemon.objects.reader import POSITION, Claim, LayoutReader, ObjectReader, ReadCondition, Row
from candaemon.objects.signals import SignalBinding


def bind_reader(
    form: ObjectFormat,
    signals: Mapping[str, SignalRef],
    database: Database,
    location: SettingLocation | None = None,
    *,
    units: Units = DEFAULT_UNITS,
    names: Collection[str] = (),
) -> ObjectReader:
    """Bind the reader of one object format.

    Args:
        form: where the objects lie in the frames.
        signals: quantity → the signal it comes from.
        database: the DBC.
        location: place of the sensor in the configuration, holding `objects` and `signals`.
        units: of signals of which neither their entry nor the DBC names one.
        names: of further signals, which may hold numbers.

    Raises:
        ConfigError: naming every message, signal and unit that is wrong.

    """
    location = location or SettingLocation()
    place = location.at("objects")
    layouts = find_layouts(form, database, place, numbered_names(form, signals, names))
    routes = _routes(layouts, form.multiplexed, place)
    read = _ReadSignals(layouts, units, len(form.points))
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
        points=len(form.points),
        multiplexed=form.multiplexed,
        readers=[read.reader(layout, place) for layout in layouts],
        routes=routes,
        claims=_claims(layouts, form.multiplexed),
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
            other = layouts[routes[message.can_id][0]] if message.can_id in routes else None
            if other is not None and _told_apart(layout, other):
                continue
            if other is not None:
                raise location.at("messages", layout.index).error(
                    f"message '{message.name}' has the id 0x{message.can_id & 0x1FFFFFFF:X} "
                    f"that '{other.pattern}' has already; every message of an object needs its own"
                )
            routes[message.can_id] = (layout.index, -1 if multiplexed else slot)
    return routes


def _claims(layouts: Sequence[MessageLayout], multiplexed: bool) -> dict[int, tuple[Claim, ...]]:
    """List for each CAN id of which a frame's value says whose it is, what the layouts take."""
    claims: dict[int, tuple[Claim, ...]] = {}
    for layout in layouts:
        if layout.selector is None:
            continue
        signal, value = layout.selector
        for place, message in enumerate(layout.messages):
            read, of_place = compile_field_reader(message, signal), -1 if multiplexed else place
            claim = Claim(message.length, read, value, layout.index, of_place)
            claims[message.can_id] = (*claims.get(message.can_id, ()), claim)
    return claims


def _told_apart(one: MessageLayout, other: MessageLayout) -> bool:
    """Return whether a signal says of which of two layouts a frame is."""
    if one.selector is None or other.selector is None:
        return False
    (signal, value), (other_signal, other_value) = one.selector, other.selector
    return signal.name == other_signal.name and value != other_value


@dataclass(slots=True)
class _ReadSignals:
    """The signals that a reader decodes, gathered layout by layout: those of quantities first.

    Attributes:
        layouts: the messages of an object.
        units: of signals of which nothing else names one.
        points: objects in a message.
        rows: per layout, row of each signal by its name.
        bindings: per layout, the signals that are quantities, in the order of their rows.
        valid: conditions with the signal they are on.
        new: likewise.

    """

    layouts: tuple[MessageLayout, ...]
    units: Units
    points: int
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
        binding = bind_signal(quantity, ref, signal, location, self.units)
        if signal.name in rows:
            other = bindings[rows[signal.name]].quantity
            raise location.error(f"signal '{signal.name}' is {other} already; a signal gives one quantity")
        rows[signal.name] = len(rows)
        bindings.append(binding)
        if quantity in POSITION and binding.unknown:
            known = KnownCondition(binding.unknown, abs(signal.scale) / 2)
            self.valid.append(((layout.index, rows[signal.name]), known))

    def condition(self, condition: Condition, location: SettingLocation) -> tuple[Row, ReadCondition]:
        """Compile a condition for the signal it is on."""
        layout, signal = find_in_layouts(self.layouts, condition.signal, location)[0]
        compiled = tabulate(compile_condition(condition, signal, location), signal, layout.shortest)
        return self.row(condition.signal, location), compiled

    def reader(self, layout: MessageLayout, location: SettingLocation) -> LayoutReader:
        """Make the reader of one layout, whose messages must carry the signals alike."""
        index, names = layout.index, list(self.rows[layout.index])
        valid = [(row, condition) for (of, row), condition in self.valid if of == index]
        new = [(row, condition) for (of, row), condition in self.new if of == index]
        unlike = unlike_point(layout.shortest, filter(is_of_point, names), self.points)
        if unlike is not None:
            raise location.at("points").error(
                f"message '{layout.shortest.name}' has no signal '{unlike}' like that of the first point; "
                "the points of a message differ in nothing but their bits' places"
            )
        every = dict.fromkeys(point_name(name, point) for point in range(self.points) for name in names)
        check_alike(layout, every if layout.id_signal is None else [*every, layout.id_signal.name], location)
        return LayoutReader(layout, names, self.bindings[index], valid, new, self.points)
