"""What an experiment gives: figures with their bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from candaemon.config.tracker import TrackerSettings
from candaemon.evaluation.printing import Section
from tests.accuracy.simulated_runs import with_settings


@dataclass(frozen=True, slots=True)
class Finding:
    """A figure.

    Attributes:
        name: what was measured.
        value: the figure; NaN: there was nothing to measure.
        unit: of the figure.
        least, most: what it should be between; infinite: nothing is asked on that side.
    """

    name: str
    value: float
    unit: str = "m"
    least: float = -math.inf
    most: float = math.inf

    @property
    def asked(self) -> bool:
        """Whether anything is asked."""
        return math.isfinite(self.least) or math.isfinite(self.most)

    @property
    def met(self) -> bool:
        """Whether it is what it should be; NaN is not, where something is asked."""
        return not self.asked or self.least <= self.value <= self.most

    @property
    def bound(self) -> str:
        """What it should be, as text."""
        if not self.asked:
            return ""
        if math.isinf(self.least):
            return f"≤ {self.most:.4g}"
        return f"≥ {self.least:.4g}" if math.isinf(self.most) else f"{self.least:.4g} to {self.most:.4g}"

    def row(self) -> tuple[str, ...]:
        """Return the cells of the table."""
        met = "" if not self.asked else "met" if self.met else "NOT MET"
        return self.name, f"{self.value:.4g}", self.unit, self.bound, met

    def as_json(self) -> dict[str, Any]:
        """Return the figure as a tree for JSON: what is not finite is null."""
        known = {name: getattr(self, name) for name in ("value", "least", "most")}
        told = {name: value if math.isfinite(value) else None for name, value in known.items()}
        return {"name": self.name, "unit": self.unit, **told, "met": self.met if self.asked else None}


@dataclass(frozen=True, slots=True)
class Effort:
    """What an experiment is to run.

    Attributes:
        seeds: of what is simulated, each a run.
        tracker: settings of the tracker in place of the defaults, as (dotted key, value).
        seconds: that a simulated drive is cut to.
    """

    seeds: tuple[int, ...]
    tracker: tuple[tuple[str, Any], ...] = ()
    seconds: float = math.inf

    @property
    def settings(self) -> TrackerSettings:
        """The tracker's defaults with those settings."""
        return with_settings(TrackerSettings(), self.tracker)


@dataclass(frozen=True, slots=True)
class Experiment:
    """An experiment.

    Attributes:
        question: what it asks, one line.
        legend: name and text of what its figures mean.
        seeds: how many runs it takes to answer.
        run: yields the figures.
    """

    question: str
    legend: tuple[tuple[str, str], ...]
    seeds: int
    run: Callable[[Effort], Iterable[Finding]]

    def section(self, name: str, findings: Iterable[Finding]) -> Section:
        """Return its table."""
        rows = tuple(one.row() for one in findings)
        return Section(f"{name}: {self.question}", ("", "measured", "unit", "wanted", ""), rows)
