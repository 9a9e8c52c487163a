"""Which signal is which quantity of an object, in which unit and with which sign."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.binding.bind_signal import UNITS, normalised_unit
from candaemon.config.base import MOST_UNKNOWN, UNIT_FACTORS
from candaemon.config.sensors import MOST_LOOKS
from candaemon.wizard.draft import Choice
from candaemon.wizard.layouts import Layout
from candaemon.wizard.linking import linked
from candaemon.wizard.object_motion import (
    NO_SLOPE,
    Slope,
    approach_slope,
    derivative_slope,
    fitted,
    growth,
    pairs,
    standing_rows,
    turning_slope,
    white_noise,
)
from candaemon.wizard.object_table import ObjectColumn, ObjectTable
from candaemon.wizard.occupancy import Occupancy, Test, occupancy, tabled_tests, unknown_raws
from candaemon.wizard.own_motion import SLOWEST, OwnMotion
from candaemon.wizard.vocabulary import angle_form, role_of, says_absolute, side_of

LISTED: Final = 0.35
"""Share of objects that go on by their numbers, below which these say nothing."""
PROVEN: Final = 4.0
"""Standard deviations from which on a log proves a sign or a unit."""
WANDERS: Final = 6.0
"""Ratio of the variances of a second and of a scan, from which on a radar's errors are no white noise."""
FRONT: Final = 3.6
"""m from the rear axle to the front bumper of a car, where nothing says more."""
SPEEDS: Final = {"m/s": 1.0, "km/h": 1 / 3.6, "mph": UNIT_FACTORS["mph"]}


@dataclass(slots=True)
class Mapping:
    """What is known of a sensor's quantities.

    Attributes:
        polar: whether the position is range and azimuth.
        table: the objects, by the number that is their identity.
        columns: names of the signals by quantity.
        factors: SI value of one unit of each, sign included.
        choices: YAML by quantity.
        held: which rows hold objects.
        identity: signal that is their identity, `false` where none is, None where the slot is.
        apart: scans from one detection of an object to the next.
        valid, new: conditions.
        looks: signal that says which look a scan is, and how far and wide (m, deg) each sees; None without looks.
        noise: by key of `noise`.
        over_ground: the evidence that the speed is one over ground; empty where it is relative. The table has the
            relative speed in its place then.
        own_filter: whether the radar's errors wander as those of a radar that filters by itself.
        seen: largest distance in m, and half opening angle in deg, that the log holds.
        notes: what contradicts the DBC or cannot be said.
    """

    polar: bool
    table: ObjectTable
    columns: dict[str, str]
    factors: dict[str, float]
    choices: dict[str, Choice]
    held: Occupancy
    identity: Choice | None = None
    apart: int = 1
    valid: tuple[Test, ...] = ()
    new: tuple[Test, ...] = ()
    looks: tuple[str, dict[int, tuple[float, float]]] | None = None
    noise: dict[str, Choice] = field(default_factory=dict)
    over_ground: str = ""
    own_filter: str = ""
    seen: tuple[float, float] = (0.0, 0.0)
    notes: list[str] = field(default_factory=list)


def names_by_role(layout: Layout) -> dict[str, str]:
    """Return the signal that each role's name suggests most strongly, by role; the first of several."""
    best: dict[str, tuple[int, str]] = {}
    for part in layout.parts:
        for name, spec in zip(part.names, part.specs, strict=True):
            role, weight = _role(name, spec.unit, spec.length)
            weight -= says_absolute(name)  # where another one is relative
            if role and weight > best.get(role, (0, ""))[0]:
                best[role] = (weight, name)
    return {role: name for role, (_, name) in best.items()}


_DIMENSION_OF: Final = {
    "x": "length", "y": "length", "range": "length", "width": "length", "length": "length", "azimuth": "angle",
    "heading": "angle", "range_rate": "speed", "vx": "speed", "vy": "speed", "ax": "acceleration",
}  # fmt: skip
_SI: Final = {"length": "m", "speed": "m/s", "angle": "deg", "acceleration": "m/s^2"}
"""What is taken for a unit of the DBC that nobody knows."""
_LEAST_BITS: Final = {"x": 6, "y": 6, "range": 6, "azimuth": 6, "range_rate": 6, "vx": 6, "vy": 5, "ax": 5}


def _role(name: str, unit: str, bits: int) -> tuple[str, int]:
    """Return the role of a signal by its name, if its unit and size allow that."""
    role, weight = role_of(name)
    known = UNITS.get(normalised_unit(unit)) if unit.strip() else None
    if role in _DIMENSION_OF and known is not None and known[0] not in {_DIMENSION_OF[role], "number"}:
        return "", 0
    return ("", 0) if bits < _LEAST_BITS.get(role, 1) else (role, weight)


def map_signals(table: ObjectTable, own: OwnMotion | None) -> Mapping | None:
    """Find the quantities of a table's objects; None where no position is found."""
    roles = {role: name for role, name in names_by_role(table.layout).items() if name in table.columns}
    position = _position(roles)
    if position is None:
        return None
    far, aside, polar = position
    others = [
        name
        for role, name in roles.items()
        if role in {"x", "y", "range", "azimuth", "range_rate", "vx", "vy"} and name != far
    ]
    velocity = roles.get("range_rate") or roles.get("vx")
    table, over_ground = (table, "") if velocity is None or own is None else _made_relative(table, far, velocity, own)
    rate = None if velocity is None else table.values(velocity)
    rough = occupancy(table, far, others, None)
    mapped = Mapping(polar, table, {("range" if polar else "x"): far}, {}, {}, rough, valid=rough.valid)
    mapped.over_ground = over_ground
    _map_distance(mapped, table, far, own)
    if velocity is not None and rate is not None:
        table = _link(mapped, table, far, aside, velocity)
        rate = table.values(velocity)
        _map_rate(mapped, table, velocity, roles, own)
        key = next(key for key in ("range_rate", "vx") if key in mapped.columns)
        factor = mapped.factors["range" if polar else "x"]
        speed = rate * mapped.factors[key] / factor
        if mapped.identity is None:
            mapped.held = occupancy(table, far, others, speed)
            mapped.valid, mapped.new = mapped.held.valid, mapped.held.new
            _map_identity(mapped, far, speed)
            table = mapped.table
        else:
            mapped.held = occupancy(table, far, (), speed, all_held=True)
    _map_lateral(mapped, table, aside, own)
    _line_of_sight(mapped, table, roles, own)
    _map_others(mapped, table, roles)
    if mapped.identity is None:
        _map_tabled(mapped, table.columns.values())
    _measure_noise(mapped, table, own)
    for quantity, name in mapped.columns.items():
        if quantity in mapped.choices:
            mapped.choices[quantity] = _with_unknowns(mapped.choices[quantity], table.columns[name])
    return mapped


def _made_relative(table: ObjectTable, far: str, velocity: str, own: OwnMotion) -> tuple[ObjectTable, str]:
    """Return a table whose speed is relative, and the evidence if it was one over ground; else the table itself.

    The distance changes by the speed then only together with the way that the vehicle goes. What is near the vehicle's
    own direction counts, as directions are not known yet.
    """
    column = table.columns[velocity]
    place = table.values(far) * _unit_of(table.columns[far])[1]
    factor = _unit_of(column)[1]
    held = occupancy(table, far, (), None)
    of = pairs(table, held)
    if not len(of):
        return table, ""
    gone = own.way_at(table.time[of.last]) - own.way_at(table.time[of.first])
    moved = place[of.last] - place[of.first]
    usual = (np.abs(moved) < 4 * np.abs(gone) + 5.0) & (gone > SLOWEST * of.seconds)
    of, gone, moved = of.rows(usual), gone[usual], moved[usual]
    if not len(of):
        return table, ""
    told = 0.5 * (column.values[of.first] + column.values[of.last]) * factor * of.seconds
    relative, compensated = fitted(told, moved, of.run), fitted(told, moved + gone, of.run)
    if relative.correlation**2 > 0.8 * compensated.correlation**2 or abs(compensated.correlation) < 0.9:
        return table, ""
    unit = _nearest_speed(abs(compensated.value) * factor)
    if compensated.sigmas < PROVEN or unit is None:
        return table, ""
    scale = float(np.copysign(SPEEDS[unit], compensated.value))
    columns = dict(table.columns)
    columns[velocity] = replace(column, values=column.values - own.speed_at(table.time) / scale)
    why = (
        f"the distance changes by it and the way driven, correlation {compensated.correlation:+.2f}, "
        f"by it alone {relative.correlation:+.2f}"
    )
    return replace(table, columns=columns), why


def _link(mapped: Mapping, table: ObjectTable, far: str, aside: str, velocity: str) -> ObjectTable:
    """Return a table by objects where no number goes on with them: a list of detections, linked by where they go."""
    held = mapped.held
    numbers = [table.slot] + [
        np.nan_to_num(column.values).astype(np.intp)
        for name, column in table.columns.items()
        if role_of(name)[0] == "identity" and column.spec.length >= 4
    ]
    dimension, factor = _unit_of(table.columns[velocity])
    rate = table.values(velocity) * factor
    count = int(np.count_nonzero(held.occupied))
    going = max(_going_on(table, held, number, far, rate * sense) for number in numbers for sense in (1.0, -1.0))
    if count < 200 or going > LISTED * count:
        return table
    values = table.values(far) * _unit_of(table.columns[far])[1]
    best = linked(np.flatnonzero(held.occupied), table.time, values, table.values(aside), rate, table.cycle_time)
    if best is None or best.found < 1.5 * going or best.found < 0.3 * len(best.rows):
        return table
    order = np.lexsort((table.time[best.rows], best.number))
    rows = best.rows[order]
    apart = f" {best.scans} scans later" if best.scans > 1 else " in the next scan"
    why = f"{best.found:,} of {len(rows):,} go on to where they would be{apart}, by their numbers {going:,}"
    mapped.identity = Choice("false", why)
    mapped.apart = best.scans
    mapped.table = table.rows(rows, best.number[order], best.scans)
    mapped.held = occupancy(mapped.table, far, (), rate[rows] * best.factor, all_held=True)
    del dimension
    return mapped.table


def _map_identity(mapped: Mapping, far: str, speed: Floats) -> None:
    """Take a signal for the objects' identity if they go on by it better than by their slots."""
    table, held = mapped.table, mapped.held
    best = _going_on(table, held, table.slot, far, speed)
    for name, column in table.columns.items():
        role, _ = role_of(name)
        if role != "identity" or column.spec.length < 4 or table.layout.listed:
            continue
        number = np.nan_to_num(column.values).astype(np.intp)
        count = _going_on(table, held, number, far, speed)
        if count > 1.05 * best + 10:
            why = f"{count:,} objects go on by it from scan to scan, by their slots {best:,}"
            mapped.identity, best = Choice(name, why), count
    if mapped.identity is None:
        return
    rows = np.flatnonzero(held.occupied)
    number = np.nan_to_num(table.values(mapped.identity.value)).astype(np.intp)
    rows = rows[np.lexsort((table.time[rows], number[rows]))]
    mapped.table = table.rows(rows, number[rows])
    mapped.held = occupancy(mapped.table, far, (), speed[rows], all_held=True)


def _going_on(table: ObjectTable, held: Occupancy, number: Indices, far: str, speed: Floats) -> int:
    """Count the objects that are, a scan later, where they would have gone, if a number is their identity."""
    rows = np.flatnonzero(held.occupied)
    rows = rows[np.lexsort((table.time[rows], number[rows]))]
    before, after = rows[:-1], rows[1:]
    step = table.time[after] - table.time[before]
    values = table.values(far)
    good = (number[before] == number[after]) & (step > 0) & (step < 1.6 * table.cycle_time)
    good &= np.abs(values[after] - values[before] - speed[before] * step) < 1.0
    return int(np.count_nonzero(good))


def has_place(layout: Layout) -> bool:
    """Return whether signals are called what a position is called, in units that it may have."""
    return _position(names_by_role(layout)) is not None


def _position(roles: dict[str, str]) -> tuple[str, str, bool] | None:
    """Return the signals of the position, and whether it is polar."""
    if "x" in roles and "y" in roles:
        return roles["x"], roles["y"], False
    if "range" in roles and "azimuth" in roles:
        return roles["range"], roles["azimuth"], True
    if "x" in roles and "azimuth" in roles:
        return roles["x"], roles["azimuth"], True
    return None


def _unit_of(column: ObjectColumn) -> tuple[str, float]:
    """Return the dimension and SI value of the DBC's unit; an empty dimension where it names none that is known."""
    known = UNITS.get(normalised_unit(column.spec.unit)) if column.spec.unit.strip() else None
    return ("", 1.0) if known is None or known[0] == "number" else known


def _form_of(key: str, column: ObjectColumn) -> str:
    """Return what an angle's signal gives in its place by its name, `sine` or `slope`; empty: the angle itself."""
    return angle_form(column.name) if key == "azimuth" and not _unit_of(column)[0] else ""


def _reference(
    column: ObjectColumn, *, negative: bool = False, unit: str = "", scale: float = 1.0, form: str = ""
) -> str:
    """Return a signal as a configuration has it."""
    if form:
        name = f"{'-' if negative else ''}{column.name}"
        return f"{{signal: {_in_mapping(name)}, form: {form}}}"
    sign, unit = "-" if negative else "", unit or _unit_instead(column)
    name = _in_mapping(column.name)
    if scale != 1.0:
        return f"{{signal: {name}, unit: {unit or '1'}, scale: {sign}{scale:.4g}}}"
    return f"{{signal: {name}, unit: {unit}, scale: -1}}" if unit and negative else (
        f"{{signal: {name}, unit: {unit}}}" if unit else f"{sign}{column.name}"
    )  # fmt: skip


def _in_mapping(name: str) -> str:
    """Return a signal's name as it stands in a mapping, where braces would mean something else."""
    return f'"{name}"' if "{" in name else name


def _unit_instead(column: ObjectColumn) -> str:
    """Return the unit that stands for one of the DBC that nobody knows; empty where it is known, or not needed."""
    unknown = column.spec.unit.strip() and normalised_unit(column.spec.unit) not in UNITS
    return _SI.get(_DIMENSION_OF.get(role_of(column.name)[0], ""), "") if unknown else ""


def _map_distance(mapped: Mapping, table: ObjectTable, far: str, own: OwnMotion | None) -> None:
    """Map the distance: by the way that the vehicle goes towards what stands."""
    key = "range" if mapped.polar else "x"
    column = table.columns[far]
    dimension, factor = _unit_of(column)
    of = pairs(table, mapped.held)
    moved = approach_slope(column.values * factor, of, table, own) if own is not None else None
    if moved is not None and moved.samples and abs(moved.value + 1) < 0.1:
        why = f"nears by {-moved.value:.3f} of the way driven ({moved.samples:,} samples of what stands)"
        choice = Choice(_reference(column), why if dimension else f"{why}: metres")
        may_be_ahead = moved.value + 1 < 2 * moved.deviation  # a distance along the line of sight changes by less
    else:
        why = "by name" + ("" if dimension else "; the DBC names no unit: m")
        choice, may_be_ahead = Choice(_reference(column), why, guess=not dimension), True
    mapped.choices[key] = _as_called(choice, key, column) if may_be_ahead else choice
    mapped.factors[key] = factor


def _as_called(choice: Choice, key: str, column: ObjectColumn) -> Choice:
    """Return what was found for a distance; a guess, where one ahead by its name comes with a direction."""
    if key != "range" or role_of(column.name)[0] != "x":
        return choice
    why = f"{choice.why}; called a distance ahead, which with a direction is taken for that along the line of sight"
    return replace(choice, why=why, guess=True)


def _with_unknowns(choice: Choice, column: ObjectColumn) -> Choice:
    """Return what was found for a quantity, with the values that are no measurement by the DBC's table."""
    texts = dict(list(unknown_raws(column.spec).items())[:MOST_UNKNOWN])
    if not texts:
        return choice
    raws = f"unknown_raw: [{', '.join(map(str, texts))}]"

    def told(value: str) -> str:
        return f"{value[:-1]}, {raws}}}" if value.startswith("{") else f"{{signal: {_in_mapping(value)}, {raws}}}"

    why = f"{choice.why}; not known where the DBC's table says {', '.join(dict.fromkeys(texts.values()))}"
    return replace(choice, value=told(choice.value), options=tuple(map(told, choice.options)), why=why)


def _map_rate(mapped: Mapping, table: ObjectTable, name: str, roles: dict[str, str], own: OwnMotion | None) -> None:
    """Map the speed: unit and sign by the derivative of the distance."""
    column = table.columns[name]
    key = "range_rate" if roles.get("range_rate") == name else "vx"
    position = "range" if mapped.polar else "x"
    dimension, factor = _unit_of(column)
    far = table.values(mapped.columns[position]) * mapped.factors[position]
    of = pairs(table, mapped.held)
    slope = derivative_slope(far, column.values * factor, of)
    mapped.columns[key] = name
    sign = -1.0 if slope.value < 0 and slope.sigmas > PROVEN else 1.0
    if abs(slope.correlation) < 0.6 or slope.sigmas < PROVEN:
        why = "by name; the change of the distance does not tell its sense or unit"
        mapped.choices[key] = Choice(_reference(column), why, guess=True, ask="sign")
        mapped.factors[key] = factor
        return
    sense = "away" if sign > 0 else "towards"
    why = f"positive {sense}: the distance changes by {slope.value:+.3f} of it, correlation {slope.correlation:+.3f}"
    unit = "" if abs(abs(slope.value) - 1) < 0.15 else _nearest_speed(abs(slope.value) * factor)
    if unit is None:
        mapped.choices[key] = Choice(
            _reference(column, negative=sign < 0), f"{why}; no unit of speed explains that", guess=True
        )
    elif unit:
        factor = SPEEDS[unit]
        contrary = f", not {column.spec.unit}" if dimension else ""
        mapped.choices[key] = Choice(_reference(column, negative=sign < 0, unit=unit), f"{why}: {unit}{contrary}")
        if dimension:
            mapped.notes.append(f"{name}: the DBC's unit {column.spec.unit} contradicts the motion, {unit} agrees")
    else:
        mapped.choices[key] = Choice(_reference(column, negative=sign < 0), why)
    mapped.factors[key] = sign * factor
    del own


def _nearest_speed(value: float) -> str | None:
    """Return the unit of speed of this SI value, None where none is near."""
    unit = min(SPEEDS, key=lambda each: abs(np.log(SPEEDS[each] / value)))
    return unit if abs(np.log(SPEEDS[unit] / value)) < 0.15 else None


def _rate_of(mapped: Mapping, table: ObjectTable) -> Floats:
    """Return the rate of the distance, m/s, told or from its differences."""
    for key in ("range_rate", "vx"):
        if key in mapped.columns:
            return table.values(mapped.columns[key]) * mapped.factors[key]
    key = "range" if mapped.polar else "x"
    far = table.values(mapped.columns[key]) * mapped.factors[key]
    rate: Floats = np.full(len(far), np.nan)
    scans = max(1, round(0.3 / table.cycle_time))
    of = pairs(table, mapped.held, scans * table.cycle_time)
    rate[of.first] = (far[of.last] - far[of.first]) / of.seconds
    return rate


def _map_lateral(mapped: Mapping, table: ObjectTable, aside: str, own: OwnMotion | None) -> None:
    """Map the second coordinate: unit and side by what stands, as the vehicle turns and passes."""
    column, key = table.columns[aside], "azimuth" if mapped.polar else "y"
    dimension, factor = _unit_of(column)
    held = mapped.held
    told = side_of(column.spec.comment)
    stated = f"; the DBC's comment says {'left' if told > 0 else 'right'}" if told else ""
    turn = _turn(mapped, table, column, own)
    mapped.columns[key] = aside
    raw = np.abs(column.values[held.occupied])
    wide = float(np.quantile(raw[np.isfinite(raw)], 0.99)) if np.isfinite(raw).any() else 0.0
    unit, unit_why, unit_guess = "", "", False
    form = _form_of(key, column)
    if form:
        unit_why, unit_guess = f"{form} by its name", True
    elif mapped.polar and not dimension:
        unit, unit_why, unit_guess = _angle_unit(turn, wide, column)
        factor = UNIT_FACTORS[unit]
    elif mapped.polar and dimension == "angle" and turn.sigmas > PROVEN:
        expected = 1 / factor
        ratio = abs(turn.value) / expected
        if ratio > 5 or ratio < 0.2:
            unit = "rad" if factor < 0.5 else "deg"
            factor = UNIT_FACTORS[unit]
            unit_why = f"{unit}, not {column.spec.unit}: a turn of 1 rad moves what stands by {abs(turn.value):.3g}"
            mapped.notes.append(f"{aside}: the DBC's unit {column.spec.unit} contradicts the motion, {unit} agrees")
    proven = turn.sigmas > PROVEN and own is not None
    side_known = own is not None and own.side_known
    negative = (turn.value < 0) if turn.sigmas > 3 else told < 0 if told else _usual_side(column)
    words = "right" if negative else "left"
    if proven and side_known:
        found = f"{min(turn.sigmas, 99):.0f} σ ({turn.samples:,} samples)"
        why = f"positive to the {words}: what stands moves against own turns, {found}{stated}"
        if told and (told < 0) != negative:
            mapped.notes.append(f"{aside}: the comment in the DBC says another side than the motion")
        guess = False
    elif proven:
        why = f"positive to the {words} if the yaw rate's sign is right ({turn.sigmas:.0f} σ){stated}"
        guess = True
    elif told:
        why, guess = f"positive to the {words} by the DBC's comment; the log turns too little to tell", False
    else:
        why, guess = f"positive to the {words}? the log turns too little to tell ({_sigmas(turn)})", True
    value = _reference(column, negative=negative, unit=unit, form=form)
    other = _reference(column, negative=not negative, unit=unit, form=form)
    text = f"{unit_why}; {why}" if unit_why else why
    mapped.choices[key] = Choice(
        value, text, guess=guess or unit_guess, ask="side" if guess else "unit", options=(other,)
    )
    mapped.factors[key] = -factor if negative else factor


def _sigmas(slope: Slope) -> str:
    return f"{slope.sigmas:.1f} σ" if slope.samples else "nothing stands in it"


def _usual_side(column: ObjectColumn) -> bool:
    """Return whether a signal is rather positive to the right: nothing says so, ISO 8855 is left."""
    del column
    return False


def _angle_unit(turn: Slope, wide: float, column: ObjectColumn) -> tuple[str, str, bool]:
    """Return an angle's unit, where the DBC names none: by how far it reaches, and by own turns."""
    by_size = "deg" if wide > 1.7 else "rad"
    clear = wide > 3.2 or wide < 1.2
    top = max(abs(column.spec.minimum or 0.0), abs(column.spec.maximum or 0.0))
    why = f"{by_size}: 99 % of it within ±{wide:.3g}" + (f", the DBC's range ±{top:g}" if top else "")
    if turn.sigmas > PROVEN:
        value = abs(turn.value)
        unit = "deg" if abs(np.log(value / 57.3)) < abs(np.log(value)) else "rad"
        against = (abs(57.3 - value) if unit == "rad" else abs(value - 1.0)) / max(turn.deviation, 1e-9)
        if unit == by_size or turn.sigmas > 2 * PROVEN:
            other = "rad" if unit == "deg" else "deg"
            return (
                unit,
                f"{unit}: what stands turns by {value:.3g} for 1 rad, {min(against, 999):.0f} σ from {other}",
                unit != by_size,
            )
    return by_size, why, not clear


def _turn(mapped: Mapping, table: ObjectTable, column: ObjectColumn, own: OwnMotion | None) -> Slope:
    """Return how a lateral signal of what stands goes with own turns."""
    if own is None:
        return NO_SLOPE
    of = pairs(table, mapped.held)
    stands = standing_rows(_rate_of(mapped, table), table, mapped.held, own)
    of = of.rows(stands[of.first] & stands[of.last])
    if not len(of):
        return NO_SLOPE
    key = "range" if mapped.polar else "x"
    far = table.values(mapped.columns[key]) * mapped.factors[key]
    mean = np.maximum(0.5 * (far[of.first] + far[of.last]), 1.0)
    if not mapped.polar:
        return turning_slope(column.values, np.zeros(len(of)), mean + FRONT, of, table, own)
    gone = own.way_at(table.time[of.last]) - own.way_at(table.time[of.first])
    value = 0.5 * (column.values[of.first] + column.values[of.last])
    # sin(k a) / k is nearly a in any unit: what is passed drifts outwards
    drift = gone * value / mean
    return turning_slope(column.values, drift, 1 + FRONT / mean, of, table, own)


def _line_of_sight(mapped: Mapping, table: ObjectTable, roles: dict[str, str], own: OwnMotion | None) -> None:
    """Tell a speed along the line of sight from one along the axis, where a name may mean either."""
    key = next((key for key in ("range_rate", "vx") if key in mapped.columns), None)
    if mapped.over_ground:  # what stands has no speed then, along whichever line
        return
    if key is None or own is None or ("vy" in roles and key == "vx"):
        return
    cosine = cosines(mapped, table)
    rate = table.values(mapped.columns[key]) * mapped.factors[key]
    speed = own.speed_at(table.time)
    straight_on = standing_rows(rate, table, mapped.held, own) & (cosine > 0.998)
    scale = float(np.median((-rate / np.maximum(speed, 1.0))[straight_on])) if straight_on.any() else 1.0
    scale = scale if 0.9 < scale < 1.1 else 1.0
    # what stands by one or the other
    margin = 0.3 + 0.01 * speed
    stands = mapped.held.occupied & (cosine < 0.998) & (cosine > 0.5) & (speed > 2 * SLOWEST)
    stands &= (-rate < scale * speed + margin) & (-rate > scale * speed * cosine - margin)
    runs = mapped.held.chain[stands]
    if np.count_nonzero(stands) < 100 or len(np.unique(runs)) < 5:
        return
    _, y = place_aside(mapped, table)
    sideways = own.yaw_rate_at(table.time) * FRONT * np.sign(y) * np.sqrt(np.maximum(1 - cosine**2, 0.0))
    radial = np.abs(rate + scale * speed * cosine + sideways)[stands]
    straight = np.abs(rate + scale * speed)[stands]
    numbers = runs - runs.min()
    count = np.bincount(numbers)
    better = (np.bincount(numbers, straight - radial) / np.maximum(count, 1))[count > 0]
    sigmas = float(better.mean() / (better.std() / np.sqrt(len(better)) + 1e-9))
    clear_name = role_of(mapped.columns[key])[1] >= 8
    if abs(sigmas) < (8 if clear_name else 3):
        return
    found = "range_rate" if sigmas > 0 else "vx"
    what = "along the line of sight" if sigmas > 0 else "along the axis"
    errors = (float(np.mean(radial)), float(np.mean(straight)))
    near, wide = errors if sigmas > 0 else errors[::-1]
    choice = mapped.choices.pop(key)
    why = f"{choice.why}; {what}: what stands comes out {near:.2f} m/s off, else {wide:.2f}"
    mapped.choices[found] = Choice(choice.value, why, choice.guess, choice.ask, choice.options)
    mapped.columns[found], mapped.factors[found] = mapped.columns.pop(key), mapped.factors.pop(key)


def cosines(mapped: Mapping, table: ObjectTable) -> Floats:
    """Return the cosine of each row's direction."""
    if mapped.polar:
        angle = table.values(mapped.columns["azimuth"]) * mapped.factors["azimuth"]
        result: Floats = np.cos(angle)
        return result
    x, y = (table.values(mapped.columns[key]) * mapped.factors[key] for key in ("x", "y"))
    cosine: Floats = x / np.maximum(np.hypot(x, y), 1e-6)
    return cosine


def place_aside(mapped: Mapping, table: ObjectTable) -> tuple[Floats, Floats]:
    """Return x and y of each row, m, in sensor axes."""
    if mapped.polar:
        far = table.values(mapped.columns["range"]) * mapped.factors["range"]
        angle = table.values(mapped.columns["azimuth"]) * mapped.factors["azimuth"]
        return far * np.cos(angle), far * np.sin(angle)
    return (
        table.values(mapped.columns["x"]) * mapped.factors["x"],
        table.values(mapped.columns["y"]) * mapped.factors["y"],
    )


def _map_others(mapped: Mapping, table: ObjectTable, roles: dict[str, str]) -> None:
    """Map the lateral rate by the derivative of the position, and what only names tell."""
    if "vy" in roles and ("vx" in mapped.columns or mapped.polar is False):
        _map_lateral_rate(mapped, table, roles["vy"])
    for key in ("ax", "width", "length", "score"):
        name = roles.get(key)
        if name is None or key in mapped.choices:
            continue
        column = table.columns[name]
        _, factor = _unit_of(column)
        values = column.values[mapped.held.occupied]
        if not np.isfinite(values).any() or np.nanmin(values) == np.nanmax(values):
            continue  # it never says anything
        if key == "ax":
            _map_acceleration(mapped, table, column, factor)
            continue
        mapped.choices[key] = Choice(_reference(column), "by name", guess=False)
        mapped.columns[key], mapped.factors[key] = name, factor


def _map_lateral_rate(mapped: Mapping, table: ObjectTable, name: str) -> None:
    column = table.columns[name]
    _, factor = _unit_of(column)
    _, y = place_aside(mapped, table)
    slope = derivative_slope(y, column.values * factor, pairs(table, mapped.held, 0.8))
    if slope.sigmas > PROVEN and abs(slope.correlation) > 0.3:
        negative = slope.value < 0
        why = f"its sense by the derivative of y, {slope.sigmas:.0f} σ"
        guess = False
    else:
        negative, why, guess = mapped.factors.get("y", mapped.factors.get("azimuth", 1.0)) < 0, "sense as y's", True
    mapped.choices["vy"] = Choice(_reference(column, negative=negative), why, guess=guess, ask="sign")
    mapped.columns["vy"], mapped.factors["vy"] = name, -factor if negative else factor


def _map_acceleration(mapped: Mapping, table: ObjectTable, column: ObjectColumn, factor: float) -> None:
    """Map the acceleration if it is the derivative of the speed; else it is left out: wrong, it would harm."""
    key = next((key for key in ("range_rate", "vx") if key in mapped.columns), None)
    if key is None:
        return
    rate = table.values(mapped.columns[key]) * mapped.factors[key]
    slope = derivative_slope(rate, column.values * factor, pairs(table, mapped.held, 0.3))
    if slope.sigmas > PROVEN and 0.5 < abs(slope.value) < 1.6 and abs(slope.correlation) > 0.5:
        negative = slope.value < 0
        mapped.choices["ax"] = Choice(
            _reference(column, negative=negative),
            f"the speed changes by {slope.value:+.2f} of it, {slope.sigmas:.0f} σ",
        )
        mapped.columns["ax"], mapped.factors["ax"] = column.name, -factor if negative else factor


def _measure_noise(mapped: Mapping, table: ObjectTable, own: OwnMotion | None) -> None:
    """Measure how much values scatter from scan to scan, and whether the errors wander."""
    held = mapped.held
    least = {
        "x": 0.03,
        "y": 0.03,
        "range": 0.03,
        "azimuth": np.radians(0.05),
        "range_rate": 0.03,
        "vx": 0.03,
        "vy": 0.05,
    }
    keys = {
        "x": "x",
        "y": "y",
        "range": "range",
        "azimuth": "azimuth_deg",
        "range_rate": "range_rate",
        "vx": "vx",
        "vy": "vy",
    }
    white: dict[str, float] = {}
    for quantity, key in keys.items():
        if quantity not in mapped.columns:
            continue
        column = table.columns[mapped.columns[quantity]]
        factor = abs(mapped.factors[quantity])
        step = abs(column.spec.scale) * factor / np.sqrt(12)
        noise = white_noise(column.values * factor, held)
        white[quantity] = max(noise, step, least[quantity]) if np.isfinite(noise) else 5 * least[quantity]
        shown = np.degrees(white[quantity]) if quantity == "azimuth" else white[quantity]
        why = "scatter from scan to scan" if np.isfinite(noise) else "by habit: too few samples"
        mapped.noise[key] = Choice(f"{shown:.2g}", why, guess=not np.isfinite(noise))
    x, y = place_aside(mapped, table)
    inside = held.occupied & np.isfinite(x)
    if inside.any():
        far = float(np.quantile(np.hypot(x, y)[inside], 0.999))
        wide = float(np.degrees(np.quantile(np.abs(np.arctan2(y, x))[inside], 0.99)))
        mapped.seen = (far, wide)
    mapped.looks = _looks(mapped)
    if own is not None:
        _judge_filter(mapped, table, own, x, y)


def _looks(mapped: Mapping) -> tuple[str, dict[int, tuple[float, float]]] | None:
    """Return the signal that says which look a scan is, and how far and wide (m, deg) each sees; None without any."""
    if mapped.apart < 2:
        return None
    table = mapped.table
    x, y = place_aside(mapped, table)
    far, wide = np.hypot(x, y), np.degrees(np.abs(np.arctan2(y, x)))
    for column in table.columns.values():
        known = column.values[np.isfinite(column.values)]
        values = np.unique(known)
        state = role_of(column.name)[0] in {"new", "valid", "class"} or column.spec.scale != 1
        if state or not 2 <= len(values) <= MOST_LOOKS or len(values) < mapped.apart:
            continue
        reach = {
            int(value): (
                float(np.quantile(far[column.values == value], 0.97)),
                float(np.quantile(wide[column.values == value], 0.99)),
            )
            for value in values
        }
        farthest = [each for each, _ in reach.values()]
        if max(farthest) > 1.5 * min(farthest):
            return column.name, reach
    return None


def _judge_filter(mapped: Mapping, table: ObjectTable, own: OwnMotion, x: Floats, y: Floats) -> None:
    """Say whether the places of what stands wander, as a radar's own filter lets them."""
    stands = standing_rows(_rate_of(mapped, table), table, mapped.held, own)
    along, across = growth(x, y, table, mapped.held, stands, own)
    if np.isfinite(along) and min(along, across) > WANDERS:
        mapped.own_filter = f"what stands wanders in 1 s {along:.0f} and {across:.0f} times as much as in a scan"


def map_by_names(layout: Layout) -> Mapping:
    """Return what names alone suggest for a layout's quantities: guesses, but for what the DBC states."""
    specs = {name: spec for part in layout.parts for name, spec in zip(part.names, part.specs, strict=True)}
    nothing, none = np.zeros(0), np.zeros(0, np.intp)
    columns = {name: ObjectColumn(name, spec, 0, nothing) for name, spec in specs.items()}
    table = ObjectTable(layout, -1, nothing, none, none, columns, 0.05)
    roles = names_by_role(layout)
    position = _position(roles)
    far, aside, polar = position if position is not None else ("", "", False)
    mapped = Mapping(polar, table, {}, {}, {}, Occupancy(np.zeros(0, np.bool_), none))
    wanted = {"range" if polar else "x": far, "azimuth" if polar else "y": aside}
    speed = "range_rate" if "range_rate" in roles else "vx"
    lateral = () if polar or speed not in roles else ("vy",)
    wanted |= {key: roles[key] for key in (speed, *lateral, "width", "length", "score") if key in roles}
    for key, name in wanted.items():
        mapped.choices[key] = _with_unknowns(
            _as_called(_by_name(key, columns[name]), key, columns[name]), columns[name]
        )
    if speed in wanted and says_absolute(wanted[speed]):
        mapped.over_ground = "by its name"
    habits = {
        "x": "0.2",
        "y": "0.3",
        "range": "0.25",
        "azimuth": "0.5",
        "range_rate": "0.12",
        "vx": "0.15",
        "vy": "0.4",
    }
    for key in (each for each in habits if each in wanted):
        mapped.noise["azimuth_deg" if key == "azimuth" else key] = Choice(habits[key], "by habit: no log", guess=True)
    _map_tabled(mapped, columns.values())
    state = roles.get("valid")
    if not mapped.valid and state is not None and specs[state].length == 1:
        mapped.valid = (Test(state, "in: [1]", "by name", guess=True),)
    if not mapped.new and "new" in roles:
        mapped.new = (Test(roles["new"], "in: [1]", "by name", guess=True),)
    return mapped


def _map_tabled(mapped: Mapping, columns: Iterable[ObjectColumn]) -> None:
    """Let the DBC's tables of values say which slots hold an object, and a new one, where nothing else does."""
    roles = names_by_role(mapped.table.layout)
    taken = {*mapped.columns.values(), *(roles[key] for key in (*_DIMENSION_OF, "score") if key in roles)}
    valid, new = tabled_tests(columns, taken)
    if not mapped.valid and valid is not None:
        mapped.valid = (valid,)
    if not mapped.new and new is not None:
        mapped.new = (new,)


def _by_name(key: str, column: ObjectColumn) -> Choice:
    """Return a quantity's signal with what the DBC says of its unit and side."""
    dimension, _ = _unit_of(column)
    told = side_of(column.spec.comment)
    top = max(abs(column.spec.minimum or 0.0), abs(column.spec.maximum or 0.0))
    form = _form_of(key, column)
    unit = ("rad" if 0 < top < 3.3 else "deg") if key == "azimuth" and not (dimension or form) else ""
    strange = "" if unit or form or not _unit_instead(column) else column.spec.unit.strip()
    why = "by name" + (f"; the DBC's comment says positive to the {'left' if told > 0 else 'right'}" if told else "")
    why += f"; the DBC's unit '{strange}' is not known" if strange else ""
    why += f"; {unit} by the DBC's range" if unit else ""
    sure = key in {"range", "x", "width", "length", "score"} and not strange
    return Choice(_reference(column, negative=told < 0, unit=unit, form=form), why, guess=not sure, ask="sign")
