"""A report as one page of HTML: it fetches nothing, and every figure of the summary in it says which one it is."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html import escape
from math import isfinite
from typing import Any, Final

import numpy as np

from candaemon.binding.bound import Binding
from candaemon.exports.drive_tables import summary_rows
from candaemon.printable import printable
from candaemon.report import drawings
from candaemon.report.drive_record import DriveRecord
from candaemon.report.noise_found import noise_found
from candaemon.report.page_parts import drawn, table, tile, whole_page
from candaemon.report.worst_moments import worst_moments
from candaemon.status.losses import EGO_UNUSABLE_CAUSES, OBJECT_CAUSES, UNUSABLE_CAUSES
from candaemon.tracking.obstacles import STATE_NAMES

VIEW: Final = "http://127.0.0.1:8765/"
"""Where `candaemon view` serves its page unless told otherwise."""


@dataclass(frozen=True, slots=True)
class ReportedDrive:
    """What a report is of.

    Attributes:
        binding: the configuration.
        name: of the drive.
        view: command that shows the drive in the browser, from its beginning on; empty: none does.
        figures: of `candaemon.playback.summary.summarise`.
        record: for the drawings.
        horizons: of the predictions, s.
        config_text: the YAML.
        errors: figures of `evaluate`, where the truth is known.
    """

    binding: Binding
    name: str
    view: str
    figures: Mapping[str, Any]
    record: DriveRecord
    horizons: tuple[float, ...]
    config_text: str
    errors: Mapping[str, Any] | None = None


def page(drive: ReportedDrive) -> str:
    """Return the report. The same drive gives the same text."""
    title = f"{printable(drive.name)} · {printable(drive.binding.loaded.path.name)}"
    sections = [
        ("At a glance", _glance(drive)),
        ("Map", _maps(drive.record)),
        ("Obstacles over time", _timeline(drive.record)),
        ("Consistency", _consistency(drive)),
        ("Predictions", _predictions(drive)),
        ("Noise and latency, found and configured", _noise(drive)),
        ("Losses by cause", _losses(drive.figures)),
        ("Cycle times", _cycle_times(drive)),
        *([] if drive.errors is None else [("Errors against the truth", _errors(drive.errors))]),
        ("Worst moments", _moments(drive)),
        ("Configuration", f"<pre>{escape(printable_lines(drive.config_text))}</pre>"),
        ("All figures", _all(drive.figures)),
    ]
    return whole_page(title, sections, "summary", drive.figures)


def figure(figures: Mapping[str, Any], key: str, form: str = "{:,.6g}") -> str:
    """Return a figure of the summary: as text for readers, whole for programs (`data-key`, `value`)."""
    found: Any = figures
    for part in key.split("."):
        found = found[int(part)] if isinstance(found, list) else found[part]
    text = "–" if found is None else ("no", "yes")[found] if isinstance(found, bool) else form.format(found)
    return f'<data data-key="{escape(key)}" value="{escape(json.dumps(found))}">{escape(text)}</data>'


def printable_lines(text: str) -> str:
    """Return a text with its lines, each safe to show."""
    return "\n".join(printable(line, len(line) + 1) for line in text.splitlines())


def _glance(drive: ReportedDrive) -> str:
    def shown(key: str, form: str = "{:,}") -> str:
        return figure(drive.figures, key, form)

    tiles = [
        tile(f"{shown('seconds', '{:.1f}')} s", "duration of the log"),
        tile(shown("log.frames"), "frames"),
        tile(shown("cycles.told"), "cycles"),
        tile(shown("tracks.confirmed"), f"obstacles confirmed, of {shown('tracks.obstacles')} begun"),
        tile(
            shown("nis.coverage_95", "{:.1%}"),
            f"of the updates within their 95 % quantile (NIS {shown('nis.mean', '{:.2f}')}, "
            f"expected {shown('nis.expected', '{:.2f}')})",
        ),
        *(
            tile(
                f"{shown(f'predictions.{k}.x', '{:.2f}')} · {shown(f'predictions.{k}.y', '{:.2f}')} m",
                f"RMSE forward · to the left, {horizon:g} s ahead",
            )
            for k, horizon in enumerate(drive.horizons)
        ),
        tile(f"{shown('stationary.speed', '{:.2f}')} m/s", "RMS speed of what stands"),
        tile(shown("duplicates.share", "{:.1%}"), "of the samples beside another obstacle"),
    ]
    return f'<div class="tiles">{"".join(tiles)}</div>'


def _maps(record: DriveRecord) -> str:
    own = "The own vehicle (thick) and confirmed obstacles over ground"
    more = len(drawings.lives(record)) - drawings.MOST_PATHS
    if more > 0:
        own += f"; {more:,} that lived shorter are not drawn"
    earth = drawings.earth_map(record)
    on_earth = "" if earth is None else drawn(earth, "The same on earth (WGS 84), to scale at its middle.")
    return drawn(drawings.local_map(record), f"{own}.{_left_out(record)}") + on_earth


def _left_out(record: DriveRecord) -> str:
    rows = record.obstacles.left_out + record.predictions.left_out + record.moments.left_out + record.raw.left_out
    return f" The drive is long: {rows:,} rows at its end are in the figures, and not in the drawings." if rows else ""


def _timeline(record: DriveRecord) -> str:
    svg, left = drawings.timeline(record)
    legend = "".join(f'<i class="{name}"></i>{name}' for name in STATE_NAMES)
    more = f" {left:,} that lived shorter are not drawn." if left else ""
    return drawn(svg, f"Obstacles that were confirmed, {legend}.{more}")


def _consistency(drive: ReportedDrive) -> str:
    return drawn(
        drawings.nis_over_time(drive.record),
        "Normalised innovation squared over its degrees of freedom; the band holds 95 % of the means of a "
        f"consistent filter with independent samples. In all: mean {figure(drive.figures, 'nis.mean', '{:.3f}')}, "
        f"expected {figure(drive.figures, 'nis.expected', '{:.3f}')}, "
        f"{figure(drive.figures, 'nis.coverage_95', '{:.1%}')} within the 95 % quantile, "
        f"{figure(drive.figures, 'nis.samples', '{:,}')} updates.",
    )


def _predictions(drive: ReportedDrive) -> str:
    rows = [
        (
            f"{axis}, {horizon:g} s ahead",
            figure(drive.figures, f"predictions.{k}.{name}", "{:.3f}"),
            _share(drawings.within_band(drive.record, k, name)),
            figure(drive.figures, f"predictions.{k}.samples", "{:,}"),
        )
        for name, axis in (("x", "forward"), ("y", "to the left"))
        for k, horizon in enumerate(drive.horizons)
    ]
    legend = "".join(
        f'<i class="{colour}"></i>{horizon:g} s ahead'
        for colour, horizon in zip(drawings.CURVES, drive.horizons, strict=False)
    )
    about = (
        "Against the sensors' own later measurements. Dashed, and the 95 % band: what the tracks' covariances and the "
        f"noise expect if nobody manoeuvres. {legend}"
    )
    charts = [drawings.prediction_errors(drive.record, name, drive.horizons) for name in ("x", "y")]
    head = ("quantity", "RMSE (m)", "within the 95 % band", "samples")
    return table(head, rows) + "".join(drawn(svg, about) for svg in charts)


def _share(value: float) -> str:
    return f"{value:.1%}" if isfinite(value) else "–"


def _noise(drive: ReportedDrive) -> str:
    raw = drive.record.raw.arrays()
    rows = []
    for k, sensor in enumerate(drive.binding.sensors):
        for each in noise_found(raw, k, sensor.name, sensor.settings):
            told = [f"{value:.3g}" if isfinite(value) else "–" for value in (each.configured, each.found)]
            rows.append((escape(f"{each.sensor}: {each.quantity} ({each.unit})"), *told, f"{each.samples:,}"))
    deviations = table(("one standard deviation", "configured", "white part found", "samples"), rows)
    latency = table(
        ("latency", "configured (s)", "beyond it, found (s)", "± (s)", "turned, found (deg)", "± (deg)"),
        (
            (
                escape(sensor.name),
                f"{sensor.settings.latency:g}",
                *(
                    figure(drive.figures, f"calibration.{sensor.name}.{key}", "{:.4f}")
                    if "calibration" in drive.figures
                    else "–"
                    for key in ("latency", "latency_sd", "yaw_deg", "yaw_sd_deg")
                ),
            )
            for sensor in drive.binding.sensors
        ),
    )
    return (
        f"{deviations}<p>The white part is what changes from scan to scan. What wanders slowly (a filter in the "
        f"sensor, a reflection on a body) is no part of it, but of what is configured.</p>{latency}"
    )


def loss_keys(figures: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the summary's keys of what was lost, each with its name for readers."""
    yield "log.malformed", "log: lines that are no frame"
    yield "log.error_frames", "log: error frames"
    for sensor, counts in figures["sensors"].items():
        for cause in (*UNUSABLE_CAUSES, "missing", *OBJECT_CAUSES):
            if cause in counts:
                kind = "objects" if cause in OBJECT_CAUSES else "frames"
                yield f"sensors.{sensor}.{cause}", f"{sensor}: {kind} {cause.replace('_', ' ')}"
    for cause in ("short", *EGO_UNUSABLE_CAUSES):
        if cause in figures["own_motion"]:
            yield f"own_motion.{cause}", f"own motion: frames {cause.replace('_', ' ')}"
    yield "cycles.without_ego", "scans without own motion"
    yield "tracks.crowded", "detections beyond the most tracks"
    yield "output.saturated", "output: values limited to their signal's range"


def _losses(figures: Mapping[str, Any]) -> str:
    listed = []
    for key, name in loss_keys(figures):
        found: Any = figures
        for part in key.split("."):
            found = found[part]
        if found:
            listed.append((found, (escape(name), figure(figures, key, "{:,}"))))
    if not listed:
        return "<p>Nothing was lost.</p>"
    listed.sort(key=lambda each: -each[0])
    return table(("cause", "how many"), [row for _, row in listed])


def _cycle_times(drive: ReportedDrive) -> str:
    parts = []
    for k, sensor in enumerate(drive.binding.sensors):
        svg, intervals = drawings.scan_intervals(drive.record, k, sensor.settings.cycle_time)
        said = "no two scans"
        if len(intervals):
            middle, late, most = np.percentile(intervals, [50, 99, 100]) * 1e3
            said = f"median {middle:.1f} ms, 99 % below {late:.1f} ms, longest {most:.1f} ms"
        parts.append(
            drawn(svg, f"{escape(sensor.name)}: {said}; configured {sensor.settings.cycle_time * 1e3:g} ms (dashed).")
        )
    return "".join(parts)


def _errors(errors: Mapping[str, Any]) -> str:
    _, columns = summary_rows(errors)
    keys, values = columns["key"], columns["value"]
    if not isinstance(keys, list) or not isinstance(values, np.ndarray):
        raise TypeError("rows of a summary are columns")
    rows = [
        (escape(printable(key)), f"{value:,.4g}")
        for key, value in zip(keys, values.tolist(), strict=True)
        if isfinite(value) and not key.startswith(("options.", "actors."))
    ]
    return table(("figure of evaluate", "value"), rows)


def _moments(drive: ReportedDrive) -> str:
    rows = []
    for moment in worst_moments(drive.record, drive.horizons):
        of = "" if moment.obstacle is None else str(moment.obstacle)
        at = f"#t={max(moment.time - 1.0, 0.0):.2f}" + (f"&id={of}" if of else "")
        button = f'<button class="screen" data-at="{escape(at)}">view</button> ' if drive.view else ""
        rows.append((escape(moment.what), of, f"{button}{moment.time:.2f}"))
    if not rows:
        return "<p>There is none.</p>"
    listed = table(("what", "obstacle", "at (s)"), rows)
    if not drive.view:
        return listed
    return (
        f"{listed}<p><label class=screen>With <code>{escape(printable(drive.view))}</code> running, "
        f'the buttons show a moment, from a second before it, at <input id="view" value="{VIEW}" size="28"></label></p>'
    )


def _all(figures: Mapping[str, Any]) -> str:
    _, columns = summary_rows(figures)
    keys = columns["key"]
    if not isinstance(keys, list):
        raise TypeError("rows of a summary are columns")
    rows = [(escape(printable(key)), figure(figures, key, "{}")) for key in keys]
    return f"<details><summary>All figures of --summary</summary>{table(('key', 'value'), rows)}</details>"
