"""What an experiment is: a table's figures and the drawings that go with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from candaemon.arrays import Floats

Advance: TypeAlias = Callable[[float], None]
"""Called with the share of an experiment that was done since the last call; the shares sum to one."""


@dataclass(frozen=True, slots=True)
class Row:
    """One figure of a table.

    Attributes:
        case: what was driven: 'constant velocity'.
        quantity: what is measured, with its axis: 'position x'; always a root mean square error unless it says so.
        unit: of all the figures.
        method: what is compared: 'CS', 'CA'.
        printed: the paper's figure; None where it prints none.
        here: measured here.
        default: the default estimator on the same measurements; None where it does not apply.
        bound: what a filter reaches that knows when the target manoeuvres; None where it does not apply.
        error: whether the figures are errors, so that the smaller is the better.
    """

    case: str
    quantity: str
    unit: str
    method: str
    printed: float | None
    here: float
    default: float | None = None
    bound: float | None = None
    error: bool = True


@dataclass(frozen=True, slots=True)
class Line:
    """A curve: y over x, both (k,)."""

    label: str
    x: Floats
    y: Floats


@dataclass(frozen=True, slots=True)
class Panel:
    """Curves that share their axes; the labels carry the units.

    Attributes:
        x_label, y_label: of the axes.
        lines: in the order of the legend.
        equal: whether a metre is as long on both axes, as for a path.
    """

    x_label: str
    y_label: str
    lines: tuple[Line, ...]
    equal: bool = False


@dataclass(frozen=True, slots=True)
class Figure:
    """A drawing, its panels one below another.

    Attributes:
        name: of the file, without suffix: '000-variance'.
        title: above it.
    """

    name: str
    title: str
    panels: tuple[Panel, ...]


@dataclass(frozen=True, slots=True)
class Result:
    """What an experiment found.

    Attributes:
        rows: the table.
        figures: of the first run.
    """

    rows: tuple[Row, ...]
    figures: tuple[Figure, ...]


@dataclass(frozen=True, slots=True)
class Experiment:
    """One table of a paper.

    Attributes:
        name: '000-table-1'; the part before the first '-' is the paper.
        title: what is compared, and the table or section of the paper.
        choices: a sentence each: what the paper leaves open or misprints, and what was chosen.
        run: of a number of Monte Carlo runs, a seed and a progress; the same arguments give the same result.
    """

    name: str
    title: str
    choices: tuple[str, ...]
    run: Callable[[int, int, Advance], Result]

    @property
    def paper(self) -> str:
        """The paper's number."""
        return self.name.partition("-")[0]
