"""Which rows of a table hold an object: signals that say so, values that stand for nothing, where objects change."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.dbc.bits import representable_raw
from candaemon.dbc.types import SignalSpec
from candaemon.wizard.object_table import ObjectColumn, ObjectTable
from candaemon.wizard.vocabulary import role_of, words

MOST_VALUES: Final = 16
"""Values of a signal that may say whether a slot holds an object."""
NEARLY_ALL: Final = 0.95
JUMP: Final = 3.0
"""m between two scans, beyond what the object's speed explains, that is another object."""
REUNION: Final = 0.6
"""s for which an object may be missed."""
_GONE: Final = re.compile(
    r"\b(?:invalid|no targets?|no objects?|not valid|deleted?|predict(?:ed|ion)?|coast(?:ed|ing)?|not used)\b"
    r"|\b(?:empty|unused)$"
)
"""What value tables call a slot whose object was not measured: an empty trailer is no empty slot."""
_NOT_KNOWN: Final = re.compile(r"\b(?:sna|not available|reserved|error|fault|unknown)\b")
"""What they call a value that says nothing."""
_STATE_BITS: Final = 4
"""Most bits of a signal whose table of values is one of states: what is longer is measured, and has special values."""
_STATES: Final = frozenset(("state", "status", "stat", "valid", "validity", "meas", "measured", "flag", "lifecycle"))
"""Words of the names of signals that say what became of an object."""
_DEVIATIONS: Final = frozenset(("rms", "std", "stddev", "sigma", "dev", "deviation", "var", "variance", "uncertainty"))
"""Words of the names of signals whose tables are of standard deviations."""


@dataclass(frozen=True, slots=True)
class Test:
    """A condition of a configuration, and what speaks for it.

    Attributes:
        signal: name.
        bound: as a configuration has it, such as `in: [1]`.
        why: the evidence.
        guess: whether the log does not prove it.
    """

    signal: str
    bound: str
    why: str
    guess: bool = False


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Which rows hold an object.

    Attributes:
        occupied: (n,).
        run: (n,) number of the object that a row is of, −1 where it holds none.
        valid, new: conditions.
        empty: value of the distance in an empty slot, None where none is known.
        unexplained: share of the rows taken that look empty all the same.
    """

    occupied: Booleans
    run: Indices
    valid: tuple[Test, ...] = ()
    new: tuple[Test, ...] = ()
    empty: float | None = None
    unexplained: float = 0.0
    continuing: Booleans = field(default_factory=lambda: np.zeros(0, np.bool_))
    """(n,) whether the next row is the same object's, a scan later."""
    chain: Indices = field(default_factory=lambda: np.zeros(0, np.intp))
    """(n,) as `run`, but going on where an object was missed for some scans and is where it would have gone."""


def occupancy(
    table: ObjectTable, distance: str, others: Sequence[str], velocity: Floats | None, *, all_held: bool = False
) -> Occupancy:
    """Find out which rows of a table hold an object.

    Args:
        table: the objects.
        distance: column that tells how far an object is, or how far ahead.
        others: columns of what else changes while an object moves.
        velocity: (n,) m/s, rate of the distance, where one is known.
        all_held: whether each row is known to hold one.
    """
    far = table.values(distance)
    code = None if all_held else _empty_value(table, far)
    dead = _frozen(table, [far, *(table.values(name) for name in others)]) | ~np.isfinite(far)
    if code is not None:
        dead |= far == code
    valid = [] if all_held else list(_conditions(table, dead))
    occupied = np.isfinite(far)
    for _, passes in valid:
        occupied &= passes
    tests = [test for test, _ in valid]
    if code is not None and np.any(far[occupied] == code):
        highest = code >= np.nanmax(far)
        share = np.mean(far == code)
        bound = f"below: {code:.15g}" if highest else f"above: {code:.15g}"
        tests.append(Test(distance, bound, f"{code:.10g} in {share:.0%} of the frames, and constant there"))
        occupied &= far < code if highest else far > code
    starts, jumps = _starts(table, occupied, far, velocity)
    new = tuple(_new(table, occupied, starts, jumps))
    begins = starts | jumps
    for test in new:
        values = [float(value) for value in test.bound.partition("[")[2].rstrip("]").split(",")]
        flagged = np.isin(table.values(test.signal), values)
        begins |= flagged & ~np.roll(flagged & table.following, 1)
    begins &= occupied
    run = np.where(occupied, np.cumsum(begins) - 1, -1)
    continuing = np.zeros(len(table), np.bool_)
    continuing[:-1] = table.following[:-1] & occupied[:-1] & occupied[1:] & (run[:-1] == run[1:])
    left = float(np.mean(dead[occupied])) if occupied.any() else 1.0
    chain = _chains(table, occupied, run, far, velocity)
    return Occupancy(occupied, run, tuple(tests), new, code, left, continuing, chain)


@dataclass(frozen=True, slots=True)
class _States:
    """A table of values that may say what became of an object.

    Attributes:
        column: the signal.
        texts: by raw value.
        gone, unknown: raw values that stand for no object, and for nothing known.
        rank: the lower, the likelier.
    """

    column: ObjectColumn
    texts: Mapping[int, str]
    gone: frozenset[int]
    unknown: frozenset[int]
    rank: tuple[bool, int]

    @property
    def held(self) -> list[int]:
        """Raw values of a slot that holds an object."""
        return sorted(self.texts.keys() - self.gone - self.unknown)

    @property
    def first(self) -> list[int]:
        """Raw values of an object that is new in its slot."""
        return [raw for raw in self.held if "new" in self.texts[raw].split()]


def tabled_tests(columns: Iterable[ObjectColumn], taken: Collection[str] = ()) -> tuple[Test | None, Test | None]:
    """Return what the DBC's tables of values call an object, and a new one: for where no log tells.

    Args:
        columns: of the objects.
        taken: names of those that are quantities.
    """
    found = [_states(column) for column in columns if column.name not in taken and _may_be_state(column)]
    found.sort(key=lambda each: each.rank)
    valid = next((_valid_by(each) for each in found if each.gone and each.held), None)
    new = next((_new_by(each) for each in found if each.first and len(each.texts) > len(each.first)), None)
    return valid, new


def _may_be_state(column: ObjectColumn) -> bool:
    """Return whether a table of values is one of states: it names most of what a short signal can be."""
    spec = column.spec
    named = 2 * len(spec.choices or {}) >= 1 << spec.length
    return spec.length <= _STATE_BITS and named and not _DEVIATIONS & set(words(column.name))


def _states(column: ObjectColumn) -> _States:
    """Return a signal's table of values; names of states go first, then those with more words for no object."""
    texts = {raw: _plain(text) for raw, text in (column.spec.choices or {}).items()}
    gone = {raw: match[0] for raw, text in texts.items() if (match := _GONE.search(text))}
    unknown = frozenset(raw for raw, text in texts.items() if _NOT_KNOWN.search(text))
    rank = (not _STATES & set(words(column.name)), -len(set(gone.values())))
    return _States(column, texts, frozenset(gone), unknown, rank)


def _valid_by(states: _States) -> Test:
    """Return the condition of an object by a table of values."""
    column = states.column
    left_out = ", ".join(f"{raw} {(column.spec.choices or {})[raw]}" for raw in sorted(states.gone | states.unknown))
    why = f"by the DBC's table of values, which has {left_out} too"
    return Test(column.name, _bound(column, states.held), why, guess=True)


def _new_by(states: _States) -> Test:
    """Return the condition of a new object by a table of values."""
    bound = _bound(states.column, states.first)
    return Test(states.column.name, bound, "by the DBC's table of values", guess=True)


def unknown_raws(spec: SignalSpec) -> dict[int, str]:
    """Return the values of a measured signal of which the DBC's table says that they are no measurement, and its words.

    Args:
        spec: of the signal; of a state, or a flag, there are none.
    """
    if spec.is_float or spec.length <= _STATE_BITS:
        return {}
    low, high = representable_raw(spec)
    texts = {raw: _plain(text) for raw, text in (spec.choices or {}).items() if low <= raw <= high}
    return {raw: text for raw, text in texts.items() if _NOT_KNOWN.search(text) or _GONE.search(text)}


def _plain(text: str) -> str:
    """Return a text of a table of values as words in lower case, a blank between them."""
    return " ".join(text.replace("_", " ").lower().split())


def _bound(column: ObjectColumn, raws: Sequence[int]) -> str:
    """Return the condition that a signal has one of some raw values, in the DBC's unit."""
    spec = column.spec
    return f"in: [{', '.join(f'{raw * spec.scale + spec.offset:.15g}' for raw in raws)}]"


def _chains(table: ObjectTable, occupied: Booleans, run: Indices, far: Floats, velocity: Floats | None) -> Indices:
    """Return the runs joined where a slot goes on within a second with an object that is where the last one went."""
    chain = run.copy()
    rows = np.flatnonzero(occupied)
    if velocity is None or len(rows) < 2:
        return chain
    before, after = rows[:-1], rows[1:]
    step = table.time[after] - table.time[before]
    ahead = far[before] + velocity[before] * step
    goes_on = (table.slot[before] == table.slot[after]) & (step > 0) & (step < REUNION)
    goes_on &= np.abs(far[after] - ahead) < 0.5 + 0.5 * step
    goes_on &= np.abs(velocity[after] - velocity[before]) < 0.5 + 3.0 * step
    chain[rows[0]] = 0
    chain[after] = np.cumsum(~goes_on)
    return chain


def _empty_value(table: ObjectTable, far: Floats) -> float | None:
    """Return the distance that stands for no object: an extreme one, frequent, and constant."""
    known = far[np.isfinite(far)]
    if not len(known):
        return None
    values, counts = np.unique(known, return_counts=True)
    if len(values) < 3:
        return None
    for value, count in ((values[0], counts[0]), (values[-1], counts[-1])):
        at = np.flatnonzero((far == value) & table.following)
        frequent = count > 0.01 * len(known) and count > 5 * np.median(counts)
        if frequent and len(at) and np.mean(far[np.minimum(at + 1, len(far) - 1)] == value) > 0.8:
            return float(value)
    return None


def _frozen(table: ObjectTable, columns: Iterable[Floats]) -> Booleans:
    """Return which rows are as the one before and the one behind: nothing that moves is measured to the same bit."""
    same = table.following.copy()
    same[-1] = False
    for values in columns:
        filled = np.nan_to_num(values, nan=-1e9)
        same[:-1] &= filled[:-1] == filled[1:]
    frozen = same & np.roll(same, 1)
    return frozen | np.roll(frozen, 1) & np.roll(same, 1) | np.roll(frozen, -1) & same


def _enumerations(table: ObjectTable) -> list[ObjectColumn]:
    """Return the columns that may hold a state: few values, and not another one in each scan."""
    found = []
    for column in table.columns.values():
        role, _ = role_of(column.name)
        if column.spec.length > 4 or column.spec.is_float or role in {"counter", "checksum", "identity"}:
            continue
        values = column.values
        changes = np.mean(values[:-1][table.following[:-1]] != values[1:][table.following[:-1]])
        if changes < 0.5 and 1 < len(np.unique(values[np.isfinite(values)])) <= MOST_VALUES:
            found.append(column)
    return found


def _conditions(table: ObjectTable, dead: Booleans) -> Iterable[tuple[Test, Booleans]]:
    """Return the conditions by which states tell objects from empty slots, each with the rows that pass it."""
    best: tuple[float, Test, Booleans] | None = None
    for column in _enumerations(table):
        role, _ = role_of(column.name)
        known = np.isfinite(column.values)
        good, notes = [], []
        for value in np.unique(column.values[known]).tolist():
            rows = column.values == value
            share = float(np.mean(dead[rows]))
            text = (column.spec.choices or {}).get(int(value), "")
            gone = _GONE.search(_plain(text)) is not None
            notes.append(f"{value:g}: {1 - share:.0%}" + (f" ({text})" if text else ""))
            if not gone and share < (0.4 if role == "valid" else 0.1):
                good.append(value)
        passes = np.isin(column.values, good) | ~known
        if not good or passes.all():
            continue
        caught = float(np.mean(~passes[dead])) if dead.any() else 0.0
        lost = np.mean(dead[~passes])
        if caught < 0.5 or lost < (0.4 if role == "valid" else 0.9):
            continue
        name = {"valid": 0.2}.get(role, 0.0) + 0.05 * ("valid" in column.name.lower() or "stat" in column.name.lower())
        merit = caught + name
        if best is None or merit > best[0]:
            why = f"objects that move, by its value: {', '.join(notes)}"
            unseen = _unseen(column, np.unique(column.values[known]))
            bound = f"in: [{', '.join(f'{value:.15g}' for value in good)}]"
            best = (merit, Test(column.name, bound, why + unseen, guess=False), passes)
    return [] if best is None else [best[1:]]


def _unseen(column: ObjectColumn, seen: Floats) -> str:
    """Say which values of a state did not come."""
    every = set(range(1 << column.spec.length)) if column.spec.scale == 1 and not column.spec.offset else set()
    missing = sorted(every - {int(value) for value in seen})
    return f"; {', '.join(map(str, missing))} never came" if 0 < len(missing) <= 8 else ""


def _starts(table: ObjectTable, occupied: Booleans, far: Floats, velocity: Floats | None) -> tuple[Booleans, Booleans]:
    """Return where an object begins in a slot after none, and where another one takes its place."""
    before = np.zeros(len(table), np.bool_)
    before[1:] = table.following[:-1] & occupied[:-1]
    starts = occupied & ~before
    step = np.zeros(len(table))
    step[1:] = far[1:] - far[:-1]
    if velocity is not None:
        step[1:] -= velocity[:-1] * np.diff(table.time)
    limit = JUMP if velocity is not None else JUMP + 60 * table.cycle_time
    return starts, occupied & before & (np.abs(step) > limit)


def _new(table: ObjectTable, occupied: Booleans, starts: Booleans, jumps: Booleans) -> Iterable[Test]:
    """Return the condition that tells an object's first scan in its slot."""
    begins = starts | jumps
    if np.count_nonzero(starts) < 3:
        return []
    best: tuple[float, Test] | None = None
    # a slot that held something when the log began says nothing
    first = np.ones(len(table), np.bool_)
    first[1:] = np.diff(table.slot) != 0
    judged = begins & ~first
    if not judged.any():
        return []
    for column in _enumerations(table):
        role, _ = role_of(column.name)
        for value in np.unique(column.values[occupied & np.isfinite(column.values)]).tolist():
            rows = (column.values == value) & occupied
            if np.count_nonzero(rows) > 0.5 * np.count_nonzero(occupied):
                continue  # most are no first scans
            at_starts = float(np.mean(rows[judged]))
            # a flag may last for a second scan
            soon = begins | np.roll(begins & table.following, 1)
            of_rows = float(np.mean(soon[rows])) if rows.any() else 0.0
            named = role == "new" and value != 0
            if at_starts >= (0.4 if named or of_rows > 0.9 else 0.8) and of_rows >= (0.2 if named else 0.6):
                why = f"{value:g} in {at_starts:.0%} of first scans, {of_rows:.0%} of its rows are such"
                merit = at_starts + of_rows + named
                if best is None or merit > best[0]:
                    best = (merit, Test(column.name, f"in: [{value:.15g}]", why, guess=not named and of_rows < 0.9))
    return [] if best is None else [best[1]]
