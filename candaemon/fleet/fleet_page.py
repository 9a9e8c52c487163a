"""A fleet's report: figures over all drives with confidence intervals, by tag, spread, worst drives and moments."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from html import escape
from math import isfinite
from typing import Any, Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.exports.drive_tables import CYCLES
from candaemon.fleet.fleet_figures import PARTS, DriveFigure, DriveFigures, FleetFigures, TableParts, table_parts
from candaemon.fleet.paired_test import mean_interval
from candaemon.fleet.result_store import ResultStore
from candaemon.printable import printable
from candaemon.report.page_parts import drawn, table, tile, whole_page
from candaemon.report.svg_chart import Chart

WORST: Final = 5
"""Worst drives of a figure."""
WORST_MOMENTS: Final = 12
"""Worst moments of all drives, one a drive."""
MOST_TAGS: Final = 20
"""Values of a tag, and failed drives, that are told; the most frequent and the first."""
_BINS: Final = 40
_BEFORE_S: Final = 2.0
"""s that a moment's replay begins before it."""


@dataclass(frozen=True, slots=True)
class FigureSpread:
    """A figure over some drives.

    Attributes:
        key, name, unit: of the figure.
        drives: that have it.
        mean: over the drives, each counting the same.
        low, high: 95 % confidence interval of the mean, by Student's t; None for one drive.
        median, least, most: of the drives; 5 % are below `least`, 5 % above `most`.
    """

    key: str
    name: str
    unit: str
    drives: int
    mean: float
    low: float | None
    high: float | None
    median: float
    least: float
    most: float


@dataclass(frozen=True, slots=True)
class WorstDrive:
    """A drive that is among the worst in a figure."""

    drive: str
    key: str
    value: float
    replay: str
    view: str


@dataclass(frozen=True, slots=True)
class WorstMoment:
    """A scan that fits worst: its NIS over its expectation, at a time s after the drive's first cycle."""

    drive: str
    time: float
    ratio: float
    sensor: str
    replay: str
    view: str


@dataclass(frozen=True, slots=True)
class FleetReport:
    """What a report tells.

    Attributes:
        fleet: figures of all drives.
        spread: over all drives.
        by_tag: likewise by `tag=value`.
        worst: drives, by figure.
        moments: worst first.
        cycles: scans with a NIS, by classes of NIS over its expectation: lower bounds and counts.
    """

    fleet: FleetFigures
    spread: tuple[FigureSpread, ...]
    by_tag: Mapping[str, tuple[FigureSpread, ...]]
    worst: tuple[WorstDrive, ...]
    moments: tuple[WorstMoment, ...]
    cycles: tuple[tuple[float, int], ...]

    def to_json(self) -> dict[str, Any]:
        """Return it for a file; `fleet compare` reads the drives' figures of it."""
        return {
            **self.fleet.to_json(),
            "figures": [asdict(each) for each in self.spread],
            "by_tag": {tag: [asdict(each) for each in spread] for tag, spread in self.by_tag.items()},
            "worst_drives": [asdict(each) for each in self.worst],
            "worst_moments": [asdict(each) for each in self.moments],
            "nis_over_expected": [{"from": low, "scans": count} for low, count in self.cycles],
        }


def report_of(fleet: FleetFigures, store: ResultStore) -> FleetReport:
    """Gather what a report tells.

    Raises:
        InputError: the tables cannot be read.
    """
    figures, drives = fleet.figures(), list(fleet.drives.values())
    tagged: dict[str, list[DriveFigures]] = {}
    for drive in drives:
        for key, value in drive.tags.items():
            tagged.setdefault(f"{key}={value}", []).append(drive)
    frequent = sorted(tagged, key=lambda tag: (tag.partition("=")[0], -len(tagged[tag]), tag))
    with table_parts(store, CYCLES.name, fleet.drives) as parts:
        moments = tuple(_moments(parts, fleet))
        cycles = tuple(_cycles(parts))
    return FleetReport(
        fleet,
        tuple(_spreads(figures, drives)),
        {tag: tuple(_spreads(figures, tagged[tag])) for tag in frequent},
        tuple(_worst(figures, drives)),
        moments,
        cycles,
    )


def _spreads(figures: Iterable[DriveFigure], drives: Sequence[DriveFigures]) -> Iterator[FigureSpread]:
    for figure in figures:
        values = _values(figure, drives)
        if len(values):
            low, high = mean_interval(values)
            least, median, most = np.percentile(values, [5, 50, 95]).tolist()
            known = isfinite(low)
            yield FigureSpread(
                figure.key,
                figure.name,
                figure.unit,
                len(values),
                float(values.mean()),
                low if known else None,
                high if known else None,
                median,
                least,
                most,
            )


def _values(figure: DriveFigure, drives: Iterable[DriveFigures]) -> Floats:
    return np.array([each.values[figure.key] for each in drives if figure.key in each.values], np.float64)


def _worst(figures: Iterable[DriveFigure], drives: Sequence[DriveFigures]) -> Iterator[WorstDrive]:
    """Yield the worst drives of each figure of which one can be better; those without any fault are none."""
    for figure in figures:
        if figure.better == "neither":
            continue
        sign = 1.0 if figure.better == "lower" else -1.0
        having = [each for each in drives if each.values.get(figure.key)]
        having.sort(key=lambda each: (-sign * each.values[figure.key], each.drive))
        for each in having[:WORST]:
            yield WorstDrive(each.drive, figure.key, each.values[figure.key], _command("replay", each), _view(each))


def _moments(parts: TableParts, fleet: FleetFigures) -> Iterator[WorstMoment]:
    """Yield the worst scan of each drive, of the worst drives.

    A replay's range counts from the log's first frame, which comes before the first cycle: it is told by the log's
    clock. The page of `view` counts from the first cycle.
    """
    query = (
        "with scans as (select drive, sensor, time_ns, "  # noqa: S608 - a constant
        "min(time_ns) over (partition by drive) as begin, "
        f"nis / nullif(nis_expected, 0) as ratio from {PARTS}) "
        "select drive, max_by(time_ns, ratio), any_value(begin), max(ratio), max_by(sensor, ratio) "
        f"from scans where ratio is not null group by drive order by 4 desc, 1 limit {WORST_MOMENTS}"
    )
    for drive, time_ns, begin_ns, ratio, sensor in parts.rows(query):
        about, time, at = fleet.drives[drive], (time_ns - begin_ns) * 1e-9, time_ns * 1e-9
        replay = f"{_command('replay', about)} --from @{max(at - _BEFORE_S, 0.0):.2f} --to @{at + _BEFORE_S:.2f}"
        view = f"{_view(about)}  # and #t={max(time - _BEFORE_S, 0.0):.2f} after the address"
        yield WorstMoment(drive, time, ratio, sensor or "", replay, view)


def _cycles(parts: TableParts) -> Iterator[tuple[float, int]]:
    """Yield how often scans have which NIS over its expectation, in steps of a tenth up to 5."""
    query = (
        "select least(floor(nis / nis_expected * 10) / 10, 5.0) as low, count(*) "  # noqa: S608 - likewise
        f"from {PARTS} where nis is not null and nis_expected > 0 group by all order by all"
    )
    for low, count in parts.rows(query):
        yield float(low), count


def _command(name: str, drive: DriveFigures) -> str:
    """Return the command that shows a drive: smoothing alters the table of tracks alone, which it does not write."""
    maps = (word for channel, bus in drive.channels.items() for word in ("--map", f"{channel}={bus}"))
    return shlex.join(["candaemon", name, drive.configuration, *drive.logs, *maps])


def _view(drive: DriveFigures) -> str:
    return _command("view", drive)


def page(report: FleetReport, title: str) -> str:
    """Return a report as one page of HTML that fetches nothing. The same results give the same text."""
    sections = [
        ("At a glance", _glance(report)),
        ("Figures", _figures(report.spread)),
        *([("By tag", _tags(report))] if report.by_tag else []),
        ("Spread over drives", _spread(report)),
        ("Consistency of scans", _consistency(report)),
        ("Worst drives", _worst_drives(report)),
        ("Worst moments", _worst_moments(report)),
        *([("Failed drives", _failed(report))] if report.fleet.failed else []),
        ("All drives", _all(report)),
    ]
    return whole_page(printable(title), sections, "fleet", report.to_json())


def _glance(report: FleetReport) -> str:
    drives = list(report.fleet.drives.values())
    hours, effort = (sum(getattr(each, name) for each in drives) / 3600 for name in ("duration", "effort"))
    tiles = [
        tile(f"{len(drives):,}", "drives"),
        tile(f"{hours:,.2f} h", "driven"),
        tile(f"{effort:,.3f} h", "of a core to compute"),
        tile(f"{len(report.fleet.failed):,}", "drives failed"),
    ]
    for each in report.spread:
        if each.key.startswith("predictions."):
            about = f"{escape(each.name)}, mean {_between(each)}"
            tiles.append(tile(f"{each.mean:.3f} m", about))
    return f'<div class="tiles">{"".join(tiles)}</div>'


def _between(spread: FigureSpread) -> str:
    if spread.low is None or spread.high is None:
        return "of one drive"
    return f"{spread.low:.4g} to {spread.high:.4g}"


def _figures(spread: Sequence[FigureSpread]) -> str:
    rows = (
        (
            escape(f"{each.name} ({each.unit})" if each.unit else each.name),
            f"{each.drives:,}",
            f"{each.mean:.4g}",
            _between(each),
            f"{each.median:.4g}",
            f"{each.least:.4g} to {each.most:.4g}",
        )
        for each in spread
    )
    return table(("figure", "drives", "mean", "95 % interval of the mean", "median", "90 % of the drives"), rows)


def _tags(report: FleetReport) -> str:
    keys = [each.key for each in report.spread]
    told, counts = [], dict[str, int]()
    for tag in report.by_tag:
        key = tag.partition("=")[0]
        counts[key] = counts.get(key, 0) + 1
        if counts[key] <= MOST_TAGS:
            told.append(tag)
    rows = []
    for tag in told:
        of = {each.key: each for each in report.by_tag[tag]}
        drives = max((each.drives for each in of.values()), default=0)
        cells = (f"{of[key].mean:.3g}<br><small>{_between(of[key])}</small>" if key in of else "–" for key in keys)
        rows.append((escape(printable(tag)), f"{drives:,}", *cells))
    left = len(report.by_tag) - len(told)
    more = f"<p>{left:,} rarer values are in the JSON.</p>" if left else ""
    head = ("tag", "drives", *(escape(each.name) for each in report.spread))
    return f"{table(head, rows)}<p>Means over drives with their 95 % intervals.</p>{more}"


def _spread(report: FleetReport) -> str:
    drives = list(report.fleet.drives.values())
    drawings = []
    for figure in report.fleet.figures():
        values = _values(figure, drives)
        if not len(values) or figure.better == "neither" or values.min() == values.max():
            continue
        count, edges = np.histogram(values, _BINS)
        axis = f"{figure.name} ({figure.unit})" if figure.unit else figure.name
        chart = Chart(
            (float(edges[0]), float(edges[-1])),
            (0.0, float(count.max()) * 1.05),
            (axis, "drives"),
            size=(960.0, 150.0),
        )
        for left, right, n in zip(edges[:-1].tolist(), edges[1:].tolist(), count.tolist(), strict=True):
            if n:
                chart.bar(left, right, 0.0, float(n), "first", f"{n} drives {left:.4g} to {right:.4g}")
        drawings.append(drawn(chart.svg(axis), f"{len(values):,} drives."))
    return "".join(drawings) or "<p>All drives are alike.</p>"


def _consistency(report: FleetReport) -> str:
    if not report.cycles:
        return "<p>No scan updated anything.</p>"
    most = max(count for _, count in report.cycles)
    chart = Chart((0.0, 5.1), (0.0, most * 1.05), ("mean NIS of a scan / expected", "scans"), size=(960.0, 180.0))
    for low, count in report.cycles:
        chart.bar(low, low + 0.1, 0.0, float(count), "first", f"{count:,} scans from {low:.1f}")
    chart.line(np.ones(2), np.array([0.0, 1e15]), "expected", dash="4 3", title="expected")
    total = sum(count for _, count in report.cycles)
    return drawn(chart.svg("NIS of scans over its expectation"), f"{total:,} scans; the last bar holds all from 5 on.")


def _worst_drives(report: FleetReport) -> str:
    names = {each.key: each for each in report.fleet.figures()}
    found = []
    for key in dict.fromkeys(each.key for each in report.worst):
        rows = (
            (escape(each.drive), f"{each.value:.4g}", f"<code>{_code(each.replay)}</code>")
            for each in report.worst
            if each.key == key
        )
        found.append(f"<h3>{escape(names[key].name)}</h3>{table(('drive', 'value', 'see it'), rows, ('see it',))}")
    return "".join(found) or "<p>There is none.</p>"


def _worst_moments(report: FleetReport) -> str:
    rows = (
        (
            escape(each.drive),
            f"{each.time:.2f}",
            f"{each.ratio:.1f}",
            escape(printable(each.sensor)),
            f"<code>{_code(each.replay)}</code><br><code>{_code(each.view)}</code>",
        )
        for each in report.moments
    )
    about = (
        "<p>The scan of each drive that fits worst: its mean NIS over what is expected. Times count from the drive's "
        "first cycle.</p>"
    )
    return about + table(("drive", "at (s)", "NIS / expected", "sensor", "see it"), rows, ("sensor", "see it"))


def _code(command: str) -> str:
    return escape(printable(command, len(command) + 1))


def _failed(report: FleetReport) -> str:
    failed = list(report.fleet.failed.items())
    rows = ((escape(name), escape(printable(reason))) for name, reason in failed[:MOST_TAGS])
    more = f"<p>and {len(failed) - MOST_TAGS:,} more, in the JSON.</p>" if len(failed) > MOST_TAGS else ""
    return table(("drive", "reason"), rows, ("reason",)) + more


def _all(report: FleetReport) -> str:
    figures = [each for each in report.fleet.figures() if each.key.startswith("predictions.")]
    rows = (
        (
            escape(each.drive),
            f"{each.duration:,.1f}",
            escape(printable(", ".join(f"{key}={value}" for key, value in each.tags.items()))),
            *(f"{each.values[figure.key]:.3f}" if figure.key in each.values else "–" for figure in figures),
        )
        for each in report.fleet.drives.values()
    )
    head = ("drive", "s", "tags", *(escape(each.name) for each in figures))
    return f"<details><summary>{len(report.fleet.drives):,} drives</summary>{table(head, rows)}</details>"
