"""The report of a drive: it fetches nothing, its figures are those of the summary, its drawings show the drive."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from candaemon.cli.main import main
from candaemon.evaluation.drive_score import PredictionScore
from candaemon.exports.drive_tables import summary_rows
from candaemon.playback.replay import HORIZONS, ReplayRequest, replay
from candaemon.report import drive_record
from candaemon.report.drawings import lives
from candaemon.report.drive_page import figure, loss_keys
from candaemon.report.drive_record import Columns, DriveRecord
from candaemon.report.noise_found import noise_found
from candaemon.report.svg_chart import Chart, limits, ticks
from candaemon.report.worst_moments import worst_moments
from tests.support.bound import binding
from tests.support.paths import ROOT

CONFIG = "esr_ins_fd"
SCENE = (
    "duration: 8\nego: {start: {speed: 20}}\nactors: [{name: lead, start: {x: 40, y: 0, vx: 20, vy: 0}},"
    "{name: van, start: {x: 25, y: 3.5, vx: 22, vy: 0}}]\n"
)
RECORDED = ROOT.parent / "shared" / "data" / "rav4_drive" / "drive_with_ins.log.gz"


ADDRESSES = ("src", "href", "srcset", "data", "action", "poster")
"""Attributes that can make a browser fetch something."""


class Elements(HTMLParser):
    """Gathers what a page names and shows."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.figures: dict[str, list[tuple[str, str]]] = {}
        self._of: tuple[str, str] | None = None
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = {name: value or "" for name, value in attrs}
        self.addresses += [
            found[name] for name in ("src", "href", "srcset", "data", "action", "poster") if name in found
        ]
        self.ids += [found["id"]] if "id" in found else []
        if tag == "data":
            self._of = found["data-key"], found["value"]

    def handle_data(self, data: str) -> None:
        if self._of is not None:
            key, value = self._of
            self.figures.setdefault(key, []).append((value, data))
            self._of = None


@dataclass(frozen=True)
class Reported:
    """A report and what it is of."""

    folder: Path
    text: str
    figures: dict[str, object]
    page: Elements = field(repr=False)


def outputs(folder: Path) -> list[str]:
    return ["-o", str(folder / "report.html"), "--summary", str(folder / "summary.json")]


def read(folder: Path) -> Reported:
    text = (folder / "report.html").read_text(encoding="utf-8")
    figures = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return Reported(folder, text, figures, Elements(text))


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Reported:
    """Return a report of a short drive, with its truth."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "short.yaml").write_text(SCENE, encoding="utf-8")
    log, truth = str(folder / "drive.log"), str(folder / "truth.csv")
    assert main(["simulate", str(folder / "short.yaml"), CONFIG, "-o", log, "--truth", truth]) == 0
    assert main(["report", CONFIG, log, *outputs(folder), "--truth", truth]) == 0
    return read(folder)


@pytest.fixture(scope="module")
def record(reported: Reported) -> DriveRecord:
    """Return what the same drive's drawings are made of."""
    found = DriveRecord(("front",))
    replay(binding(CONFIG), ReplayRequest(reported.folder / "drive.log"), sinks=[found])
    return found


def check_alone(text: str) -> None:
    """Hold that a page names nothing outside of itself."""
    page = Elements(text)
    assert all(address.startswith("#") for address in page.addresses), page.addresses
    assert {address[1:] for address in page.addresses} <= set(page.ids)
    assert "url(" not in text.replace("url(#", "")
    assert "@import" not in text
    assert "default-src 'none'" in text


def check_figures(reported: Reported) -> None:
    """Hold that every figure is the summary's, whole for programs and rounded for readers, and none left out."""
    _, columns = summary_rows(reported.figures)
    assert isinstance(columns["key"], list)
    for key, shown in reported.page.figures.items():
        whole: object = reported.figures
        for part in key.split("."):
            whole = whole[int(part)] if isinstance(whole, list) else whole[part]  # type: ignore[index]
        for value, text in shown:
            assert json.loads(value) == whole, key
            if whole is None or isinstance(whole, bool):
                assert text == {None: "–", False: "no", True: "yes"}[whole]
            elif isinstance(whole, (int, float)):
                number = float(text.rstrip("%").replace(",", "")) / (100 if text.endswith("%") else 1)
                decimals = len(text.rstrip("%").partition(".")[2]) + (2 if text.endswith("%") else 0)
                room = max(0.51 * 10**-decimals, 1e-5 * abs(whole) if "e" in text else 0.0)
                assert abs(number - whole) <= room, (key, text, whole)
    assert reported.page.figures.keys() == set(columns["key"])
    embedded = re.search(r'<script type="application/json" id="summary">(.*?)</script>', reported.text)
    assert embedded is not None
    assert json.loads(embedded[1]) == reported.figures


def test_the_page_names_nothing_outside_of_itself(reported: Reported) -> None:
    check_alone(reported.text)


def test_every_figure_is_the_summarys(reported: Reported, tmp_path: Path) -> None:
    check_figures(reported)
    assert main(["replay", CONFIG, str(reported.folder / "drive.log"), "--summary", str(tmp_path / "s.json")]) == 0
    assert json.loads((tmp_path / "s.json").read_text(encoding="utf-8")) == reported.figures


def test_every_section_is_there(reported: Reported) -> None:
    headings = re.findall(r"<h2>(.*?)</h2>", reported.text)
    assert headings == [
        "At a glance",
        "Map",
        "Obstacles over time",
        "Consistency",
        "Predictions",
        "Noise and latency, found and configured",
        "Losses by cause",
        "Cycle times",
        "Errors against the truth",
        "Worst moments",
        "Configuration",
        "All figures",
    ]
    assert "prefers-color-scheme:dark" in reported.text
    assert "@media print" in reported.text


def test_drawings_are_well_formed_and_named(reported: Reported) -> None:
    drawn = re.findall(r"<svg.*?</svg>", reported.text, re.DOTALL)
    names = [ET.fromstring(svg).attrib["aria-label"] for svg in drawn]  # noqa: S314 - the project's own
    assert names == [
        "map of the drive, local frame",
        "map of the drive, on earth",
        "timeline of obstacles",
        "NIS over time",
        "errors of predictions forward",
        "errors of predictions to the left",
        "intervals between scans of front",
    ]
    assert "nan" not in "".join(re.findall(r' (?:d|points|x|y|cx|cy|width|height)="([^"]*)"', reported.text))


@pytest.mark.slow
def test_errors_are_those_of_evaluate(reported: Reported, tmp_path: Path) -> None:
    tracks, found = str(tmp_path / "t.csv"), tmp_path / "e.json"
    assert main(["replay", CONFIG, str(reported.folder / "drive.log"), "--tracks", tracks]) == 0
    assert main(["evaluate", tracks, str(reported.folder / "truth.csv"), "--json", str(found)]) == 0
    errors = json.loads(found.read_text(encoding="utf-8"))["errors"]
    for name in ("position", "x", "velocity"):
        assert f"<td>errors.{name}</td><td class=n>{errors[name]:,.4g}</td>" in reported.text


def test_the_configuration_is_there_as_it_was_read(reported: Reported) -> None:
    text = (ROOT / "config" / f"{CONFIG}.yaml").read_text(encoding="utf-8")
    (shown,) = re.findall(r"<pre>(.*?)</pre>", reported.text, re.DOTALL)
    unescaped = shown.replace("&lt;", "<").replace("&gt;", ">").replace("&quot;", '"').replace("&#x27;", "'")
    assert unescaped.replace("&amp;", "&").splitlines() == text.splitlines()


def test_moments_lead_into_the_view(reported: Reported, record: DriveRecord) -> None:
    moments = worst_moments(record, HORIZONS)
    assert moments
    assert [moment.time for moment in moments] == sorted(moment.time for moment in moments)
    links = re.findall(r'data-at="#t=([\d.]+)(?:&amp;id=(\d+))?"', reported.text)
    assert [other for _, other in links] == [str(moment.obstacle or "") for moment in moments]
    times = [max(moment.time - 1, 0) for moment in moments]
    assert [float(time) for time, _ in links] == pytest.approx(times, abs=0.006)


@pytest.mark.slow
def test_the_same_drive_gives_the_same_page(reported: Reported, tmp_path: Path) -> None:
    log, truth = reported.folder / "drive.log", reported.folder / "truth.csv"
    assert main(["report", CONFIG, str(log), *outputs(tmp_path), "--truth", str(truth)]) == 0
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == reported.text


def test_logs_bus_by_bus_and_a_part_of_a_drive(reported: Reported, tmp_path: Path) -> None:
    lines = (reported.folder / "drive.log").read_text(encoding="utf-8").splitlines(keepends=True)
    logs = []
    for channel in sorted({line.split()[1] for line in lines}):
        logs.append(tmp_path / f"{channel}.log")
        logs[-1].write_text("".join(line for line in lines if line.split()[1] == channel), encoding="utf-8")
    summary, page = tmp_path / "part.json", tmp_path / "part.html"
    words = [str(CONFIG), *map(str, logs), "-o", str(page), "--summary", str(summary), "--from", "1", "--to", "3"]
    assert main(["report", *words]) == 0
    assert json.loads(summary.read_text(encoding="utf-8"))["seconds"] == pytest.approx(2.0, abs=0.1)
    text = page.read_text(encoding="utf-8")
    assert f"{logs[0].name} and {len(logs) - 1} more" in text
    assert "candaemon view" not in text  # which would show the whole drive, with other times
    assert main(["report", *words[:-4]]) == 0
    assert f"{logs[0]} {logs[1]}</code>" in page.read_text(encoding="utf-8")


def test_a_name_from_outside_is_text(tmp_path: Path, reported: Reported) -> None:
    log = tmp_path / "<img src=x onerror=alert(1)>&.log"
    log.write_bytes((reported.folder / "drive.log").read_bytes())
    assert main(["report", CONFIG, str(log), *outputs(tmp_path)]) == 0
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<img" not in text
    assert "&lt;img" in text
    check_alone(text)


def test_a_log_without_a_usable_frame_gives_no_report(tmp_path: Path) -> None:
    (tmp_path / "drive.log").write_text("(1.000000) can0 123#00\n", encoding="utf-8")
    assert main(["report", CONFIG, str(tmp_path / "drive.log"), *outputs(tmp_path)]) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"drive.log"}


def test_losses_are_told_by_cause(reported: Reported) -> None:
    figures = json.loads(json.dumps(reported.figures))
    keys = dict(loss_keys(figures))
    assert {"sensors.front.checksum", "sensors.front.impossible", "own_motion.out_of_range", "log.malformed"} <= set(
        keys
    )
    assert all(isinstance(json.loads(re.findall('value="(.*?)"', figure(figures, key))[0]), int) for key in keys)


def test_what_is_drawn_is_what_was_tracked(reported: Reported, record: DriveRecord) -> None:
    cycles, moments = record.cycles.arrays(), record.moments.arrays()
    assert cycles["nis"].sum() == pytest.approx(moments["nis"].sum())
    assert cycles["updates"].sum() == len(moments["nis"]) > 100
    way = np.hypot(np.diff(cycles["east"]), np.diff(cycles["north"]))
    assert np.nansum(way) == pytest.approx(20.0 * (cycles["time"][-1] - cycles["time"][0]), rel=0.05)
    tracks = reported.figures["tracks"]
    assert isinstance(tracks, dict)
    assert len(lives(record)) == tracks["confirmed"]


def test_expected_errors_grow_with_the_horizon(record: DriveRecord) -> None:
    columns = record.predictions.arrays()
    near, far = (columns["horizon"] == k for k in (0, 1))
    assert near.any()
    assert far.any()
    assert columns["sx"][far].mean() > columns["sx"][near].mean() > 0
    assert (np.abs(columns["x"]) <= 1.96 * columns["sx"]).mean() > 0.6


def test_errors_told_to_a_listener_are_those_that_are_scored() -> None:
    score, told = PredictionScore((0.5,), (0.1,)), []
    score.listener = lambda *each: told.append(each)
    for k in range(60):
        score.measure(0, k * 100_000_000, np.array([4, 9]), np.array([1.0 * k, 2.0]), np.array([0.0, 1.0]))
        score.predict(0, k * 100_000_000, 0, np.array([9, 4]), np.array([2.5, k + 5.0]), np.array([1.0, 0.3]))
    (result,) = score.result()
    x = np.concatenate([each[4] for each in told])
    assert np.sqrt((x**2).mean()) == pytest.approx(result.x)
    assert len(x) == result.samples
    sensor, made, horizon, rows, first_x, first_y = told[0]
    assert (sensor, made, horizon, rows.tolist()) == (0, 0, 0, [0, 1])
    assert first_x.tolist() == [0.5, 0.0]
    assert first_y.tolist() == pytest.approx([0.0, 0.3])


def test_rows_are_kept_up_to_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drive_record, "MOST_ROWS", 10)
    columns = Columns(("a", "b"))
    for _ in range(3):
        columns.add(np.arange(5.0), np.arange(5))
    assert (columns.rows, columns.left_out) == (10, 5)
    assert columns.arrays()["b"].tolist() == [0, 1, 2, 3, 4] * 2


def test_white_noise_is_found_beside_motion_and_jumps() -> None:
    rng, n = np.random.default_rng(3), 4000
    time = np.arange(n) * 0.05
    settings = binding("toyota_rav4").sensors[0].settings
    raw: dict[str, Any] = {
        "time": time,
        "sensor": np.zeros(n),
        "object": np.full(n, 7.0),
        "new": (np.arange(n) % 100 == 0).astype(np.float64),
        "first": 30.0 + 5 * np.sin(time / 3) + 0.03 * rng.normal(size=n) + 10 * (np.arange(n) // 100),
        "second": 0.2 * time + 0.5 * rng.normal(size=n),
        "rate": np.full(n, np.nan),
    }
    x, y = noise_found(raw, 0, "front", settings)
    assert (x.quantity, y.quantity) == ("x", "y")
    assert x.found == pytest.approx(0.03, rel=0.1)
    assert y.found == pytest.approx(0.5, rel=0.1)
    assert noise_found({name: values[:3] for name, values in raw.items()}, 0, "front", settings) == []


def test_ticks_are_round_and_few() -> None:
    assert ticks(0.0, 10.0) == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    assert all(len(ticks(low, low + span)) <= 9 for low in (-3.3, 0.0, 1e6) for span in (1e-3, 0.7, 13.0, 4e5))
    assert limits(np.array([np.nan, np.inf])) == (0.0, 1.0)


def test_equal_axes_are_to_scale() -> None:
    chart = Chart((0.0, 100.0), (0.0, 1.0), ("x", "y"), equal=1.0)
    chart.point(0.0, 0.0, "own", "a")
    chart.point(30.0, 40.0, "own", "b")
    (ax, ay), (bx, by) = re.findall(r'cx="([\d.]+)" cy="([\d.-]+)"', chart.svg("scale"))
    assert (float(bx) - float(ax)) / (float(ay) - float(by)) == pytest.approx(0.75, rel=0.01)


@pytest.mark.slow
@pytest.mark.skipif(not RECORDED.exists(), reason="the recorded drive is not there")
def test_the_recorded_drives_report_is_small_and_true(tmp_path: Path) -> None:
    assert main(["report", "toyota_rav4_ins", str(RECORDED), *outputs(tmp_path)]) == 0
    whole = read(tmp_path)
    assert len(whole.text.encode()) < 5_000_000
    check_alone(whole.text)
    check_figures(whole)
