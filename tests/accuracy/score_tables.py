"""The scores as tables one can act on, and as JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

from candaemon.evaluation.printing import Section
from tests.accuracy.measured import DEFAULT, ORACLE, Measured, naive_name
from tests.accuracy.scores import LEGEND, PAIR_FIGURES, Score
from tests.accuracy.slot_filters import GRID


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the table of figures.

    Attributes:
        title: heading.
        figure: of `Score.figures`.
        form: writes the figure.
        over: reference that it is divided by; None: the figure itself.
        least, most: what it should be between; NaN: nothing is asked.
    """

    title: str
    figure: str
    form: Callable[[float], str]
    over: str | None = None
    least: float = math.nan
    most: float = math.nan

    def missed_by(self, value: float) -> bool:
        """Return whether a figure is not what it should be."""
        return value < self.least or value > self.most

    @property
    def wanted(self) -> str:
        """What the figure should be, as text."""
        if math.isnan(self.most):
            return ""
        if math.isnan(self.least):
            return f"≤ {self.form(self.most)}"
        return f"{self.form(self.least)}–{self.form(self.most)}"


def _two(value: float) -> str:
    return f"{value:.2f}"


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %"


NAIVE: Final = "N"
COLUMNS: Final = (
    Column("pos", "position", _two),
    Column("× N", "position", _two, NAIVE, most=1.0),
    Column("× O", "position", _two, ORACLE, most=1.1),
    Column("vel", "velocity", _two),
    Column("× N", "velocity", _two, NAIVE, most=0.8),
    Column("× O", "velocity", _two, ORACLE, most=1.15),
    Column("GOSPA", "gospa", _two),
    Column("× N", "gospa", _two, NAIVE, most=0.3),
    Column("least", "least_gospa", _two),
    Column("switch", "switches", _two),
    Column("× N", "switches", _two, NAIVE, most=0.1),
    Column("dupl", "duplicates", _percent, most=0.03),
    Column("false", "false", _two, most=1.0),
    Column("missed", "missed", _percent, most=0.005),
    Column("undet", "undetected", _percent),
    Column("head", "heading", _two, most=4.0),
    Column("length", "length", _percent, most=0.25),
    Column("width", "width", _percent, most=0.25),
    Column("NEES", "nees_state", _two, least=2.5, most=6.0),
    Column("95 %", "within_state", _percent, least=0.88, most=0.99),
)
GROUP_COLUMNS: Final = (
    Column("pos", "position", _two),
    Column("× N", "position", _two, NAIVE, most=1.0),
    Column("× O", "position", _two, ORACLE, most=1.1),
    Column("along", "along", _two),
    Column("across", "across", _two),
    Column("vel", "velocity", _two),
    Column("× N", "velocity", _two, NAIVE, most=0.8),
    Column("× O", "velocity", _two, ORACLE, most=1.15),
    Column("along", "v_along", _two),
    Column("across", "v_across", _two),
    Column("head", "heading", _two, most=4.0),
    Column("known", "heading_known", _percent),
    Column("length", "length", _percent, most=0.25),
    Column("width", "width", _percent, most=0.25),
    Column("NEES", "nees_state", _two, least=2.5, most=6.0),
    Column("95 %", "within_state", _percent, least=0.88, most=0.99),
    Column("pos 2", "nees_position", _two),
    Column("vel 2", "nees_velocity", _two),
)


@dataclass(frozen=True, slots=True)
class Trio:
    """The project's score and those of the references, over the same runs."""

    project: Score
    references: dict[str, Score]

    def cell(self, column: Column, figures: Callable[[Score], dict[str, float]]) -> str:
        """Return a figure as text, marked where it is not what it should be; a dash where there is none."""
        value = figures(self.project).get(column.figure, math.nan)
        if column.over is not None:
            reference = self.references.get(column.over)
            below = math.nan if reference is None else figures(reference)[column.figure]
            value = value / below if below else math.nan
        if math.isnan(value):
            return "-"
        return column.form(value) + ("!" if column.missed_by(value) else "")


def trio(result: Measured, density: float, **where: str) -> Trio | None:
    """Return the scores of a scenario, a configuration, both or all; None where there are none."""
    project = result.total(DEFAULT, **where)
    if project is None:
        return None
    references = {NAIVE: result.total(naive_name(density), **where), ORACLE: result.total(ORACLE, **where)}
    return Trio(project, {name: score for name, score in references.items() if score is not None})


def sections(result: Measured) -> Iterator[Section]:
    """Yield the tables."""
    density = result.best_density()
    yield _grid(result, density)
    configs = sorted({config for _, config in result.scores})
    scenarios = sorted({scenario for scenario, _ in result.scores})
    places: list[tuple[str, dict[str, str]]] = [("all", {})]
    places += [(config, {"config": config}) for config in configs]
    places += [(scenario, {"scenario": scenario}) for scenario in scenarios]
    yield _figures("over all, by configuration, by scenario", result, density, places)
    cells = [(f"{one} {other}", {"scenario": one, "config": other}) for one, other in sorted(result.scores)]
    yield _figures("each scenario with each configuration", result, density, cells)
    whole = trio(result, density)
    if whole is not None:
        yield from _groups(whole)


def notes(result: Measured) -> Iterator[str]:
    """Yield what the figures mean, and what could not be run, as lines of text."""
    yield from _listed("legend", (("!", "not what it should be"), *LEGEND))
    broken = [
        (f"{scenario} {config}, {name}", f"{score.broken} samples whose place or velocity is no number")
        for (scenario, config), found in sorted(result.scores.items())
        for name, score in found.items()
        if score.broken
    ]
    yield from _listed("broken", broken)
    refused = [(f"{scenario} {config}", why) for (scenario, config), why in sorted(result.refused.items())]
    yield from _listed("cannot be run", refused)


def _listed(title: str, entries: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Yield names and texts side by side under a title; nothing of none."""
    if entries:
        yield title
    width = max((len(name) for name, _ in entries), default=0)
    yield from (f"  {name.ljust(width)}  {text}" for name, text in entries)


def _grid(result: Measured, chosen: float) -> Section:
    """Return the process noises of N, and which one is taken."""
    rows = []
    for density in GRID:
        total = result.total(naive_name(density))
        if total is not None:
            figures = total.figures()
            mark = "taken" if density == chosen else ""
            rows.append((f"{density:g}", *(_two(figures[name]) for name in ("position", "velocity", "gospa")), mark))
    return Section("N: white acceleration, m²/s³", ("", "pos", "vel", "GOSPA", ""), tuple(rows))


def _figures(title: str, result: Measured, density: float, places: list[tuple[str, dict[str, str]]]) -> Section:
    rows = [("wanted", *(column.wanted for column in COLUMNS))]
    for name, where in places:
        found = trio(result, density, **where)
        if found is not None:
            rows.append((name, *(found.cell(column, Score.figures) for column in COLUMNS)))
    return Section(title, ("", *(column.title for column in COLUMNS)), tuple(rows))


def _groups(whole: Trio) -> Iterator[Section]:
    """Yield what all pairs are made of: by age, range, visibility, manoeuvre and motion of the target."""
    sums = whole.project.sums
    rows = [("wanted", "", *(column.wanted for column in GROUP_COLUMNS))]
    for group in sums.groups:
        pairs = int(sums.pairs[sums.groups.index(group)])
        if not pairs:
            continue

        def figures(score: Score, group: tuple[str, str] = group) -> dict[str, float]:
            return {name: score.value(name, group) for name in PAIR_FIGURES}

        cells = (whole.cell(column, figures) for column in GROUP_COLUMNS)
        by, which = group
        rows.append((which if by == which else f"{by}: {which}", f"{pairs:,}", *cells))
    yield Section(
        "what the pairs are made of", ("", "samples", *(column.title for column in GROUP_COLUMNS)), tuple(rows)
    )


def as_json(result: Measured) -> dict[str, Any]:
    """Return all figures as a tree for JSON: NaN is null."""
    density = result.best_density()
    return {
        "naive_density": density,
        "grid": {f"{each:g}": _told(result.total(naive_name(each))) for each in GRID},
        "all": _trackers(result, density),
        "configurations": {
            config: _trackers(result, density, config=config) for config in sorted({c for _, c in result.scores})
        },
        "scenarios": {
            scenario: _trackers(result, density, scenario=scenario)
            for scenario in sorted({s for s, _ in result.scores})
        },
        "runs": {
            f"{scenario} {config}": _trackers(result, density, scenario=scenario, config=config)
            for scenario, config in sorted(result.scores)
        },
        "refused": {f"{one} {other}": why for (one, other), why in sorted(result.refused.items())},
    }


def _trackers(result: Measured, density: float, **where: str) -> dict[str, Any]:
    found = trio(result, density, **where)
    if found is None:
        return {}
    return {DEFAULT: _told(found.project), **{name: _told(score) for name, score in found.references.items()}}


def _told(score: Score | None) -> dict[str, Any] | None:
    """Return a score's figures, and those of each group of pairs."""
    if score is None:
        return None
    groups: dict[str, dict[str, dict[str, float | int | None]]] = {}
    for (by, which), pairs in zip(score.sums.groups, score.sums.pairs.tolist(), strict=True):
        told = {name: _known(score.value(name, (by, which))) for name in PAIR_FIGURES}
        groups.setdefault(by, {})[which] = {"samples": pairs, **told}
    figures = {name: _known(value) for name, value in score.figures().items()}
    return {"runs": score.runs, "seconds": score.seconds, "cycles": score.cycles, **figures, "groups": groups}


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
