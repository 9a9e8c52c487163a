"""Two runs of a fleet, drive by drive: what became worse, what became better, what is the same to the byte."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from math import exp, inf, isfinite, isnan, nan
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from candaemon.fleet.fleet_figures import DriveFigure, DriveFigures, FleetFigures
from candaemon.fleet.paired_test import fewest_pairs, holm, paired_difference

Verdict: TypeAlias = Literal["worse", "better", "different", "no difference"]

LEVEL: Final = 0.05
"""Probability that one figure or more is called different though nothing is."""
LEAST_CHANGE: Final = 0.001
"""Relative change of the mean below which a figure counts as the same, unless told otherwise."""
TOLERANCE: Final = 0.1
"""Relative change by which a single drive counts as worse, unless told otherwise."""
_DRIVES_TOLD: Final = 10
_ORDER: Final[Mapping[Verdict, int]] = {"worse": 0, "different": 1, "better": 2, "no difference": 3}


@dataclass(frozen=True, slots=True)
class FigureChange:
    """A figure in both runs.

    Attributes:
        key, name, unit: of the figure.
        drives: that have it in both.
        before, after: means over these.
        change: relative change; of ratios the mean, else that of the means; NaN where there was nothing before, or
            there is nothing after.
        low, high: 95 % confidence interval of `change`.
        p: corrected for the number of figures.
        verdict: what that means.
    """

    key: str
    name: str
    unit: str
    drives: int
    before: float
    after: float
    change: float
    low: float
    high: float
    p: float
    verdict: Verdict


@dataclass(frozen=True, slots=True)
class DriveChange:
    """A drive that became worse in a figure, by a relative `change`: infinite where it was 0, or is gone (NaN)."""

    drive: str
    key: str
    name: str
    before: float
    after: float
    change: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two runs compared.

    Attributes:
        figures: those that became worse first.
        worse_drives: beyond the tolerance, or without a figure that they had, worst first.
        same_bytes: drives whose tables are the same to the byte.
        same_figures: others whose figures are equal.
        changed: all other drives of both runs.
        other_logs: drives of both whose logs differ; they are compared with nothing.
        missing: complete in the first, not in the second, with the reason where it is known.
        added: likewise in the second alone.
        tolerance: relative change of a single drive.
    """

    figures: tuple[FigureChange, ...]
    worse_drives: tuple[DriveChange, ...]
    same_bytes: tuple[str, ...]
    same_figures: tuple[str, ...]
    changed: tuple[str, ...]
    other_logs: tuple[str, ...]
    missing: Mapping[str, str]
    added: tuple[str, ...]
    tolerance: float

    @property
    def regressions(self) -> tuple[FigureChange, ...]:
        """Figures that became worse."""
        return tuple(each for each in self.figures if each.verdict == "worse")

    def to_json(self) -> dict[str, Any]:
        """Return it for a file; unknown numbers are null."""
        plain: dict[str, Any] = _plain(asdict(self))
        return plain


def compare(
    before: FleetFigures, after: FleetFigures, *, least: float = LEAST_CHANGE, tolerance: float = TOLERANCE
) -> Comparison:
    """Compare two runs.

    Args:
        before: the first run.
        after: the second run.
        least: relative change of a mean below which a figure counts as the same.
        tolerance: relative change by which a single drive counts as worse.
    """
    common = [name for name in before.drives if name in after.drives]
    other_logs = [name for name in common if before.drives[name].inputs != after.drives[name].inputs]
    pairs = [(before.drives[name], after.drives[name]) for name in common if name not in set(other_logs)]
    known = {each.key: each for each in (*before.figures(), *after.figures())}
    changes = [change for each in known.values() if (change := _change(each, pairs)) is not None]
    corrected = holm([each.p for each, _ in changes])
    judged = [_judged(each, figure, p, least) for (each, figure), p in zip(changes, corrected, strict=True)]
    judged += [gone for each in known.values() if (gone := _gone(each, pairs)) is not None]
    judged.sort(key=lambda each: (_ORDER[each.verdict], each.p, each.key))
    worse = [each for figure in known.values() for each in _worse_drives(figure, pairs, tolerance)]
    same_bytes = [a.drive for a, b in pairs if a.files and a.files == b.files]
    same_figures = [a.drive for a, b in pairs if a.values == b.values and a.drive not in set(same_bytes)]
    same = {*same_bytes, *same_figures}
    missing = [name for name in before.drives if name not in after.drives]
    reasons = {name: after.failed.get(name, "not in the second run") for name in missing}
    return Comparison(
        tuple(judged),
        tuple(sorted(worse, key=lambda each: (-each.change, each.drive, each.key))),
        tuple(same_bytes),
        tuple(same_figures),
        tuple(a.drive for a, _ in pairs if a.drive not in same),
        tuple(other_logs),
        reasons,
        tuple(name for name in after.drives if name not in before.drives),
        tolerance,
    )


def _change(
    figure: DriveFigure, pairs: list[tuple[DriveFigures, DriveFigures]]
) -> tuple[FigureChange, DriveFigure] | None:
    """Return how a figure changed, not yet judged; None where no drive has it."""
    key = figure.key
    values = np.array([(a.values[key], b.values[key]) for a, b in pairs if key in a.values and key in b.values])
    if not len(values):
        return None
    before, after = values.T
    mean = float(before.mean())
    if figure.ratio and (values > 0).all():
        found = paired_difference(np.log(after / before))
        change, low, high = (exp(each) - 1.0 for each in (found.mean, found.low, found.high))
    else:
        found = paired_difference(after - before)
        scale = mean or float("nan")
        change, low, high = (each / scale for each in (found.mean, found.low, found.high))
        change = 0.0 if found.mean == 0.0 else change
    about = (figure.key, figure.name, figure.unit, found.pairs, mean, float(after.mean()))
    return FigureChange(*about, change, low, high, found.p, "no difference"), figure


def _judged(change: FigureChange, figure: DriveFigure, p: float, least: float) -> FigureChange:
    verdict: Verdict = "no difference"
    is_large = abs(change.change) >= least if isfinite(change.change) else change.after != change.before
    if p < LEVEL and is_large:
        rises = change.after > change.before if not isfinite(change.change) else change.change > 0
        if figure.better == "neither":
            verdict = "different"
        else:
            verdict = "worse" if rises == (figure.better == "lower") else "better"
    values = asdict(change) | {"p": p, "verdict": verdict}
    return FigureChange(**values)


def _gone(figure: DriveFigure, pairs: list[tuple[DriveFigures, DriveFigures]]) -> FigureChange | None:
    """Return a figure that no drive has any longer, as that of obstacles where there are none; None: some has it."""
    before = [a.values[figure.key] for a, _ in pairs if figure.key in a.values]
    if figure.better == "neither" or not before or any(figure.key in b.values for _, b in pairs):
        return None
    mean = sum(before) / len(before)
    return FigureChange(figure.key, figure.name, figure.unit, len(before), mean, nan, nan, nan, nan, 0.0, "worse")


def _worse_drives(
    figure: DriveFigure, pairs: list[tuple[DriveFigures, DriveFigures]], tolerance: float
) -> Iterator[DriveChange]:
    """Yield drives whose figure is worse by more than the tolerance and its slack, or gone."""
    if figure.better == "neither":
        return
    for a, b in pairs:
        if figure.key not in a.values:
            continue
        before, after = a.values[figure.key], b.values.get(figure.key, nan)
        worse = after - before if figure.better == "lower" else before - after
        if isnan(after) or (worse > figure.slack and worse > tolerance * before):
            change = worse / before if before > 0 and not isnan(after) else inf
            yield DriveChange(a.drive, figure.key, figure.name, before, after, change)


def _plain(value: Any) -> Any:
    match value:
        case dict():
            return {key: _plain(each) for key, each in value.items()}
        case list() | tuple():
            return [_plain(each) for each in value]
        case float():
            return value if isfinite(value) else None
        case _:
            return value


def value_text(value: float) -> str:
    """Return a figure for readers; one that is gone is none."""
    return "none" if isnan(value) else f"{value:.4g}"


def change_text(change: float) -> str:
    """Return a relative change for readers."""
    return f"{100 * change:+.2f} %" if isfinite(change) else "–"


def markdown(comparison: Comparison, before: str, after: str) -> str:
    """Return a comparison for a pull request."""
    lines = [f"### Fleet: {_cell(after)} against {_cell(before)}", "", *sentences(comparison), ""]
    told = [each for each in comparison.figures if each.verdict != "no difference"]
    if told:
        lines += ["| figure | before | after | change | 95 % interval | p | |", "|---|--:|--:|--:|--:|--:|---|"]
        for each in told:
            name = f"{each.name} ({each.unit})" if each.unit else each.name
            values = f"{each.before:.4g} | {value_text(each.after)} | {change_text(each.change)}"
            interval = f"{change_text(each.low)} to {change_text(each.high)}"
            lines.append(
                f"| {_cell(name)} | {values} | {interval} "
                f"| {each.p:.2g} | {'**worse**' if each.verdict == 'worse' else each.verdict} |"
            )
        lines.append("")
    if comparison.worse_drives:
        lines += ["| drive | figure | before | after | change |", "|---|---|--:|--:|--:|"]
        for drive in comparison.worse_drives[:_DRIVES_TOLD]:
            cells = (drive.drive, drive.name, f"{drive.before:.4g}", value_text(drive.after), change_text(drive.change))
            lines.append(f"| {' | '.join(map(_cell, cells))} |")
        lines.append("")
    return "\n".join(lines)


def _cell(text: str) -> str:
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")


def sentences(comparison: Comparison) -> Iterator[str]:
    """Yield what readers want to know first."""
    worse = len(comparison.regressions)
    compared = len(comparison.same_bytes) + len(comparison.same_figures) + len(comparison.changed)
    yield (
        f"{worse} of {len(comparison.figures)} figures worse over {compared:,} drives; "
        f"{len(comparison.same_bytes):,} drives the same to the byte, {len(comparison.same_figures):,} with other "
        f"bytes and equal figures, {len(comparison.changed):,} changed."
    )
    tested = [each.drives for each in comparison.figures if not isnan(each.after)]
    fewest = fewest_pairs(len(tested), LEVEL) if tested else 0
    if max(tested, default=0) < fewest and compared > len(comparison.same_bytes):
        yield f"So few drives cannot tell a change of one of {len(tested)} figures from chance; {fewest} or more can."
    if comparison.worse_drives:
        limit = f"{100 * comparison.tolerance:g} %"
        count = len({each.drive for each in comparison.worse_drives})
        yield f"In {count:,} drives a figure is worse by more than {limit}, or gone."
    if comparison.missing:
        names = ", ".join(list(comparison.missing)[:_DRIVES_TOLD])
        yield f"{len(comparison.missing):,} drives are missing: {names}."
    if comparison.other_logs:
        yield f"{len(comparison.other_logs):,} drives have other logs than before and are not compared."
    if comparison.added:
        yield f"{len(comparison.added):,} drives are in the second run alone."
