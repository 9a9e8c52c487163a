"""The command `papers`: which experiments it runs, what it prints, writes and draws."""

from __future__ import annotations

import errno
import json
import math
import re
import sys
from dataclasses import replace
from io import StringIO
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from rich.console import Console

from candaemon.cli.main import main
from candaemon.papers import registry
from candaemon.papers.experiment import Advance, Result, Row
from candaemon.papers.plots import draw
from candaemon.papers.text import print_result, significant
from tests.support.experiments import invented

pytestmark = pytest.mark.usefixtures("logging_as_it_was")


@pytest.fixture
def three(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let there be three experiments of two papers."""
    experiments = tuple(map(invented, ("000-table-1", "000-table-2", "004-sweep")))
    monkeypatch.setattr(registry, "EXPERIMENTS", experiments)


@pytest.mark.usefixtures("three")
@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        ([], ["000-table-1", "000-table-2", "004-sweep"]),
        (["000"], ["000-table-1", "000-table-2"]),
        (["004", "000-table-2", "000-table-2"], ["000-table-2", "004-sweep"]),
        (["000-table-1", "000"], ["000-table-1", "000-table-2"]),
    ],
)
def test_a_name_is_a_paper_or_an_experiment(names: list[str], chosen: list[str]) -> None:
    assert [experiment.name for experiment in registry.choose(names)] == chosen


@pytest.mark.usefixtures("three")
def test_an_unknown_name_is_2_and_names_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["papers", "000", "004-swep"]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert "004-swep" in told.err
    assert "000-table-1, 000-table-2, 004-sweep; did you mean '004-sweep'?" in told.err


@pytest.mark.parametrize("options", [["--runs", "0"], ["--runs", "1.5"], ["--seed", "-1"], ["--runs"]])
def test_wrong_numbers_are_2(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["papers", *options])
    assert stop.value.code == 2
    assert capsys.readouterr().out == ""


@pytest.mark.usefixtures("three")
def test_the_list_runs_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["papers", "000", "--list", "--plots", str(tmp_path / "plots")]) == 0
    assert capsys.readouterr().out.splitlines()[1:] == [
        "  name         what is compared",
        "  000-table-1  three motions (table 1)",
        "  000-table-2  three motions (table 1)",
    ]
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("three")
def test_a_pipe_gets_lines_that_can_be_searched(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["papers", "000-table-1", "--runs", "2", "--seed", "3"]) == 0
    told = capsys.readouterr()
    assert told.err == ""
    title, header, *rows, choice = (re.split(" {2,}", line) for line in told.out.splitlines())
    assert title == ["000-table-1", "three motions (table 1) (2 runs, seed 3)"]
    assert header[1:] == ["case", "quantity (unit)", "method", "printed", "here", "the default estimator", "bound"]
    error = np.sqrt(np.square(np.random.default_rng(3).normal(size=(2, 50))).mean())
    assert [row[1:] for row in rows] == [
        ["constant velocity", "position x (m)", "CA", "0.500", f"{error:#.3g}", "0.0123", "0.0100"],
        ["constant velocity", "position x (m)", "CS", "123000", "nan", "-", "-"],
        ["constant velocity", "share of the time", "CS", "-", "0.250", "-", "-"],
    ]
    assert choice == ["000-table-1", "choice: P(0) is left open: it is the identity."]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"), (0.0, "0"), (0.9996, "1.00"), (0.0321, "0.0321"), (-8.0649, "-8.06"), (26.66, "26.7"),
        (999.6, "1000"), (123456.0, "123000"), (0.00012346, "1.23e-04"), (2.5e9, "2.50e+09"), (math.inf, "inf"),
    ],
)  # fmt: skip
def test_three_digits_are_significant(value: float | None, text: str) -> None:
    assert significant(value) == text


@pytest.mark.usefixtures("three")
def test_a_terminal_gets_a_table_with_the_better_figure_in_bold() -> None:
    experiment = registry.EXPERIMENTS[0]
    drawn = Result(
        (
            Row("cruise", "position x", "m", "CA", 0.5, 0.4),
            Row("cruise", "velocity x", "m/s", "CA", 0.7, 0.7004),
            Row("cruise", "position x", "m", "CS", 0.3, 0.6),
            Row("brake", "velocity x", "m/s", "CS", None, 0.9),
            Row("brake", "variance of velocity x", "(m/s)²", "CS", 0.2, 0.1, error=False),
        ),
        (),
    )
    console = Console(file=StringIO(), force_terminal=True, width=120, color_system="standard")
    print_result(console, experiment, drawn, 1, 3)
    assert isinstance(console.file, StringIO)
    text = console.file.getvalue()
    body = text.partition("┡")[2].partition("└")[0]
    assert re.findall(r"\x1b\[1m([\d.]+)\x1b", body) == ["0.400", "0.300", "0.700", "0.700"]
    plain = re.sub(r"\x1b\[[\d;]*m", "", text)
    cells = [[cell.strip() for cell in line.split("│")[1:4]] for line in plain.splitlines() if line.startswith("│")]
    assert cells == [
        ["cruise", "position x (m)", "CA"], ["", "", "CS"], ["", "velocity x (m/s)", "CA"],
        ["brake", "velocity x (m/s)", "CS"], ["", "variance of velocity x ((m/s)²)", "CS"],
    ]  # fmt: skip
    assert "(1 run, seed 3)" in plain
    assert "• P(0) is left open" in plain
    narrow = Console(file=StringIO(), force_terminal=True, width=40, color_system=None)
    print_result(narrow, experiment, drawn, 1, 3)
    assert isinstance(narrow.file, StringIO)
    lines = narrow.file.getvalue().splitlines()
    assert "    method: CA · printed: 0.500" in lines
    assert "    here: 0.400" in lines[lines.index("    method: CA · printed: 0.500") + 1]
    assert "…" not in narrow.file.getvalue()


@pytest.mark.usefixtures("three")
def test_json_has_the_figures_and_null_for_what_is_not_finite(tmp_path: Path) -> None:
    path = tmp_path / "r.json"
    assert main(["papers", "000-table-2", "--runs", "2", "--seed", "3", "--json", str(path)]) == 0
    read = json.loads(path.read_text(encoding="utf-8"))
    assert (read["runs"], read["seed"]) == (2, 3)
    (experiment,) = read["experiments"]
    rows = experiment.pop("rows")
    assert experiment == {
        "name": "000-table-2", "paper": "000", "title": "three motions (table 1)",
        "choices": ["P(0) is left open: it is the identity."],
    }  # fmt: skip
    assert rows[1] == {
        "case": "constant velocity", "quantity": "position x", "unit": "m", "method": "CS",
        "printed": 123456.0, "here": None, "default": None, "bound": None, "error": True,
    }  # fmt: skip


@pytest.mark.usefixtures("three")
def test_the_same_seed_gives_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = []
    for folder, seed in (("a", "5"), ("b", "5"), ("c", "6")):
        (tmp_path / folder).mkdir()
        monkeypatch.chdir(tmp_path / folder)
        assert main(["papers", "000-table-1", "--seed", seed, "--json", "r.json", "--plots", "."]) == 0
        written.append({path.name: path.read_bytes() for path in Path().iterdir()})
    first, second, other = written
    assert first.keys() == {"r.json", "000-table-1-errors.png", "000-table-1-errors.svg"}
    assert second == first
    assert all(other[name] != first[name] for name in first)


def test_a_drawing_is_the_same_in_any_style_and_explains_each_curve_once() -> None:
    import matplotlib as mpl

    (figure,) = invented("000-table-1").run(1, 1, lambda _share: None).figures
    files = draw(figure)
    with mpl.rc_context({"axes.facecolor": "red", "svg.hashsalt": None}):
        assert draw(figure) == files
        assert mpl.rcParams["axes.facecolor"] == "red"
    assert files["000-table-1-errors.png"].startswith(b"\x89PNG")
    svg = files["000-table-1-errors.svg"].decode()
    assert ET.fromstring(svg).tag == "{http://www.w3.org/2000/svg}svg"  # noqa: S314 - drawn above
    shown = re.findall("<!-- (.*?) -->", svg)  # matplotlib's comment beside each text that it draws
    assert {"Errors of the first run", "x (m)", "y (m)", "time (s)", "error of position x (m)"} <= set(shown)
    assert [text for text in shown if text in {"truth", "measured", "CA"}] == ["truth", "measured", "CA"]


@pytest.mark.usefixtures("three")
def test_what_is_done_outlasts_an_interruption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(_runs: int, _seed: int, _advance: Advance) -> Result:
        raise KeyboardInterrupt

    first, second, third = registry.EXPERIMENTS
    monkeypatch.setattr(registry, "EXPERIMENTS", (first, replace(second, run=stop), third))
    assert main(["papers", "--json", str(tmp_path / "r.json"), "--plots", str(tmp_path / "new" / "plots")]) == 130
    assert {line.split()[0] for line in capsys.readouterr().out.splitlines()} == {"000-table-1"}
    assert not (tmp_path / "r.json").exists()
    read = json.loads((tmp_path / "r.json.part").read_text(encoding="utf-8"))
    assert [experiment["name"] for experiment in read["experiments"]] == ["000-table-1"]
    assert len(list((tmp_path / "new" / "plots").iterdir())) == 2


@pytest.mark.usefixtures("three")
@pytest.mark.parametrize(
    ("failure", "code"), [(BrokenPipeError(), 0), (OSError(errno.ENOSPC, "No space left", "standard output"), 1)]
)
def test_a_standard_output_that_takes_nothing_costs_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: OSError, code: int
) -> None:
    def refuse(*_arguments: object) -> None:
        raise failure

    monkeypatch.setattr("candaemon.cli.papers.print_result", refuse)
    assert main(["papers", "--json", str(tmp_path / "r.json")]) == code
    assert len(json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))["experiments"]) == 3


@pytest.mark.usefixtures("three")
@pytest.mark.parametrize("option", ["--json", "--plots"])
def test_what_cannot_be_written_is_refused_before_anything_runs(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert main(["papers", option, str(tmp_path / "file" / "x")]) == 1
    told = capsys.readouterr()
    assert told.out == ""
    assert f"{tmp_path / 'file' / 'x'}: cannot be written" in told.err


@pytest.mark.usefixtures("three")
def test_progress_is_shown_on_a_terminal_only(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "120")
    assert main(["papers", "000"]) == 0
    told = capsys.readouterr()
    assert "000-table-2 (2 of 2)" in told.err
    assert "100%" in told.err
    assert " of 2)" not in told.out
