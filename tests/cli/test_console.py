"""Figures as a terminal shows them, and as a pipe gets them."""

from __future__ import annotations

import re
import sys

import pytest

from candaemon.cli.console import Sheet, can_redraw, print_figures, print_sheets


def test_figures_are_tables_on_a_terminal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    tree = {
        "buses": {"car": {"frames": 3, "used": 1}, "radar": {"frames": 70, "used": 64}},
        "predictions": [{"horizon": 0.5, "x": None}],
        "log": {"truncated": False, "examples": [], "other": {"can7": 2}},
        "seconds": 1.25,
    }
    print_figures("a.log", tree)
    lines = capsys.readouterr().out.splitlines()
    assert dict(line.split(": ", 1) for line in lines) == {
        "buses.car.frames": "3", "buses.car.used": "1", "buses.radar.frames": "70", "buses.radar.used": "64",
        "predictions.0.horizon": "0.5", "predictions.0.x": "-",
        "log.truncated": "no", "log.examples": "-", "log.other.can7": "2", "seconds": "1.25",
    }  # fmt: skip
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    print_figures("a.log", tree)
    shown = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["│", "radar", "│", "70", "│", "64", "│"] in shown
    assert ["│", "no", "│", "-", "│", "can7", "2", "│"] in shown
    assert ["│", "0.5", "│", "-", "│"] in shown


@pytest.mark.parametrize("columns", [40, 80, 200])
def test_no_number_of_a_wide_table_is_cut(
    columns: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", str(columns))
    names = [f"objects_of_kind_{k}" for k in range(30)]
    counts = {
        sensor: dict(zip(names, range(first, first + 30), strict=True)) for sensor, first in (("a", 51200), ("b", 700))
    }
    print_figures("a.log", {"sensors": counts})
    lines = re.sub(r"\x1b\[\d*m", "", capsys.readouterr().out).splitlines()
    for k, name in enumerate(names):
        assert [name, f"{51200 + k}", f"{700 + k}"] in [line.replace("│", " ").split() for line in lines]
    assert max(map(len, lines)) <= columns


def test_words_fold_between_blanks_and_short_ones_last(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "60")
    print_sheets([Sheet("", (("compensated_radar", "range rates over ground, the slope of the angle, headers"),))])
    assert "│ compensated_radar │ range rates over ground, the slope" in capsys.readouterr().out


def test_a_dumb_terminal_is_written_to_as_a_pipe_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    assert can_redraw()
    monkeypatch.setenv("TERM", "dumb")
    assert not can_redraw()
