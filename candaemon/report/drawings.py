"""The drawings of a report, each of a drive's record."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.evaluation.chi_square import chi2_quantile
from candaemon.report.drive_record import DriveRecord
from candaemon.report.svg_chart import Chart, limits
from candaemon.tracking.obstacles import STATE_NAMES, TENTATIVE

_BINS: Final = 160
CURVES: Final = ("first", "second", "third")
"""Classes of the style sheet, of the curves of one drawing."""
MOST_BARS: Final = 400
"""Obstacles of a timeline, those that lived longest; others are counted in its caption."""
MOST_PATHS: Final = 400
"""Obstacles of a map, likewise."""


def lives(record: DriveRecord) -> list[Indices]:
    """Return the rows of each obstacle, those that were confirmed, longest life first."""
    columns = record.obstacles.arrays()
    order = np.lexsort((columns["time"], columns["id"]))
    parts = np.split(order, np.flatnonzero(np.diff(columns["id"][order])) + 1) if len(order) else []
    confirmed = [rows for rows in parts if (columns["state"][rows] > TENTATIVE).any()]
    return sorted(confirmed, key=lambda rows: (-len(rows), int(columns["id"][rows[0]])))


def local_map(record: DriveRecord) -> str:
    """Draw the ways of the own vehicle and of confirmed obstacles in the local frame."""
    return _map(record, ("east", "north"), ("east (m)", "north (m)", "west (m)"))


def earth_map(record: DriveRecord) -> str | None:
    """Draw the same on earth; None where no fix places the drive."""
    cycles = record.cycles.arrays()
    if not np.isfinite(cycles["latitude"]).any():
        return None
    return _map(record, ("longitude", "latitude"), ("longitude (deg)", "latitude (deg)", "longitude to the west (deg)"))


def _map(record: DriveRecord, names: tuple[str, str], labels: tuple[str, str, str]) -> str:
    """Draw ways over two columns; what goes farther to the north than to the east is drawn with north to the right.

    Args:
        record: of the drive.
        names: of the columns to the east and to the north.
        labels: of the axes to the east, to the north and to the west.
    """
    obstacles, cycles = record.obstacles.arrays(), record.cycles.arrays()
    own = cycles[names[0]], cycles[names[1]]
    others = [(rows, obstacles[names[0]][rows], obstacles[names[1]][rows]) for rows in lives(record)[:MOST_PATHS]]
    across = limits(own[0], *(each[1] for each in others))
    along = limits(own[1], *(each[2] for each in others))
    on_earth = names[1] == "latitude"
    # a degree of longitude is shorter than one of latitude: distances are drawn to scale at the middle
    squeeze = float(np.cos(np.radians(np.mean(along)))) if on_earth else 1.0
    width, height = (across[1] - across[0]) * squeeze, along[1] - along[0]
    turned = height > width
    ratio = min(width, height) / max(width, height, 1e-9)
    if turned:
        spans, said, ratio_of_units = (along, (-across[1], -across[0])), (labels[1], labels[2]), 1.0 / squeeze
    else:
        spans, said, ratio_of_units = (across, along), (labels[0], labels[1]), squeeze
    chart = Chart(
        *spans,
        said,
        size=(960.0, min(max(900.0 * ratio * 1.15, 160.0), 560.0) + 50.0),
        equal=ratio_of_units,
        decimals=(5, 5) if on_earth else (None, None),
    )
    for rows, east, north in others:
        known = obstacles["state"][rows] > TENTATIVE
        x, y = (north, -east) if turned else (east, north)
        identity = int(obstacles["id"][rows[0]])
        chart.line(np.where(known, x, np.nan), y, "others", width=1.0, title=f"obstacle {identity}")
    x, y = (own[1], -own[0]) if turned else own
    chart.line(x, y, "own", width=2.2, title="own vehicle")
    placed = np.flatnonzero(np.isfinite(x))
    if len(placed):
        for row, name in ((placed[0], "start"), (placed[-1], "end")):
            chart.point(float(x[row]), float(y[row]), "own", name)
            chart.text(float(x[row]), float(y[row]), name)
    return chart.svg("map of the drive, " + ("on earth" if on_earth else "local frame"))


def timeline(record: DriveRecord) -> tuple[str, int]:
    """Draw when each obstacle lived, in which state; return the drawing and how many are left out."""
    columns, shown = record.obstacles.arrays(), lives(record)
    drawn = sorted(shown[:MOST_BARS], key=lambda rows: (columns["time"][rows[0]], int(columns["id"][rows[0]])))
    free: list[float] = []
    placed = []
    for rows in drawn:
        begin, end = float(columns["time"][rows[0]]), float(columns["time"][rows[-1]])
        lane = next((k for k, until in enumerate(free) if until < begin), len(free))
        free[lane : lane + 1] = [end + 0.5]
        placed.append((lane, rows))
    lanes = max(len(free), 1)
    span = limits(record.cycles.arrays()["time"])
    chart = Chart(
        span, (0.0, float(lanes)), ("s since the first cycle", "obstacles"), size=(960.0, 60.0 + 14.0 * lanes)
    )
    for lane, rows in placed:
        time, state, identity = columns["time"][rows], columns["state"][rows], int(columns["id"][rows[0]])
        for first, last in _stretches(state):
            code = int(state[first])
            until = float(time[min(last + 1, len(time) - 1)])
            title = f"obstacle {identity}, {STATE_NAMES[code]}, {time[first]:.2f} to {until:.2f} s"
            chart.bar(float(time[first]), until, lanes - lane - 0.9, lanes - lane - 0.2, STATE_NAMES[code], title)
    return chart.svg("timeline of obstacles"), max(len(shown) - MOST_BARS, 0)


def _stretches(values: Floats) -> Iterator[tuple[int, int]]:
    """Yield first and last index of each stretch of equal values."""
    ends = np.flatnonzero(np.diff(values))
    yield from zip([0, *(ends + 1).tolist()], [*ends.tolist(), len(values) - 1], strict=True)


def nis_over_time(record: DriveRecord) -> str:
    """Draw the mean NIS per degree of freedom in short times, with the 95 % band of a consistent filter."""
    cycles = record.cycles.arrays()
    edges = _edges(cycles["time"])
    total, freedom, _ = (
        np.histogram(cycles["time"], edges, weights=cycles[name])[0] for name in ("nis", "freedom", "updates")
    )
    middle, some = (edges[1:] + edges[:-1]) / 2, freedom > 0
    mean = np.divide(total, freedom, out=np.full(len(total), np.nan), where=some)
    low, high = (
        np.array([chi2_quantile(share, float(round(n))) / n if n else np.nan for n in freedom])
        for share in (0.025, 0.975)
    )
    chart = Chart(
        (edges[0], edges[-1]),
        (0.0, max(2.0, limits(mean)[1] * 1.05)),
        ("s since the first cycle", "NIS / degrees of freedom"),
    )
    chart.band(middle, low, high, "expected")
    chart.line(edges[[0, -1]], np.ones(2), "expected", dash="4 3")
    chart.line(middle, mean, "first", title="mean NIS per degree of freedom")
    return chart.svg("NIS over time")


def prediction_errors(record: DriveRecord, quantity: str, horizons: Sequence[float]) -> str:
    """Draw the RMS error of predictions in short times and, dashed, what the tracks expect without manoeuvre.

    Args:
        record: of the drive.
        quantity: `x`, forward, or `y`, to the left.
        horizons: s.
    """
    columns = record.predictions.arrays()
    edges = _edges(record.cycles.arrays()["time"])
    middle = (edges[1:] + edges[:-1]) / 2
    curves = []
    for k, horizon in enumerate(horizons):
        rows = columns["horizon"] == k
        count = np.histogram(columns["time"][rows], edges)[0]
        pair = []
        for name in (quantity, f"s{quantity}"):
            squares = np.histogram(columns["time"][rows], edges, weights=columns[name][rows] ** 2)[0]
            pair.append(np.sqrt(np.divide(squares, count, out=np.full(len(count), np.nan), where=count > 0)))
        curves.append((horizon, *pair))
    top = limits(*(each for _, *pair in curves for each in pair))[1]
    axis = "forward" if quantity == "x" else "to the left"
    chart = Chart(
        (edges[0], edges[-1]),
        (0.0, top * 1.05),
        ("s since the first cycle", f"RMS error {axis} (m)"),
        size=(960.0, 200.0),
    )
    for colour, (horizon, found, expected) in zip(CURVES, curves, strict=False):
        chart.line(middle, found, colour, title=f"{horizon:g} s ahead")
        chart.line(middle, expected, colour, width=1.0, dash="4 3", title=f"expected, {horizon:g} s ahead")
    return chart.svg(f"errors of predictions {axis}")


def within_band(record: DriveRecord, horizon: int, quantity: str) -> float:
    """Return the share of predictions within ±1.96 of their expected standard deviations; NaN without any."""
    columns = record.predictions.arrays()
    rows = columns["horizon"] == horizon
    if not rows.any():
        return float("nan")
    return float((np.abs(columns[quantity][rows]) <= 1.96 * columns[f"s{quantity}"][rows]).mean())


def scan_intervals(record: DriveRecord, sensor: int, cycle_time: float) -> tuple[str, Floats]:
    """Draw how far apart the scans of a sensor are; return the drawing and the intervals, s."""
    cycles = record.cycles.arrays()
    intervals = np.diff(cycles["time"][cycles["sensor"] == sensor])
    shown = np.clip(intervals, 0.0, 3 * cycle_time) * 1e3
    edges = np.linspace(0.0, 3e3 * cycle_time, 61)
    count, _ = np.histogram(shown, edges)
    chart = Chart(
        (0.0, 3e3 * cycle_time),
        (0.0, max(float(count.max(initial=1)), 1.0) * 1.05),
        ("ms between scans", "scans"),
        size=(960.0, 160.0),
    )
    for left, right, n in zip(edges[:-1], edges[1:], count.tolist(), strict=True):
        if n:
            chart.bar(
                float(left), float(right), 0.0, float(n), "first", f"{n} scans {left:.0f} to {right:.0f} ms apart"
            )
    chart.line(np.full(2, cycle_time * 1e3), np.array([0.0, 1e12]), "expected", dash="4 3", title="configured")
    return chart.svg(f"intervals between scans of {record.sensors[sensor]}"), intervals


def _edges(time: Floats) -> Floats:
    low, high = limits(time)
    return np.linspace(low, max(high, low + 1e-3), _BINS + 1)
