"""Figures as a terminal shows them, and as a pipe gets them."""

from __future__ import annotations

import sys

import pytest

from candaemon.cli.console import print_figures


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
