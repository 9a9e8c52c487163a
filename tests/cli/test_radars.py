"""`candaemon radars` lists what there is to begin from."""

from __future__ import annotations

import pytest

from candaemon.cli.main import main
from tests.support.bound import binding
from tests.support.paths import ROOT


def test_check_says_which_frames_are_of_a_message(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", "smartmicro_umrr"]) == 0
    printed = capsys.readouterr().out
    assert "8 bytes, where Part is 0" in printed
    assert "8 bytes, where Part is 1" in printed


def test_every_configuration_is_listed_with_what_it_shows(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["radars"]) == 0
    printed = capsys.readouterr().out
    listed = [line.split()[0] for line in printed.splitlines()[1:] if line[2] != " "]
    assert listed == sorted(path.stem for path in (ROOT / "config").glob("*.yaml"))
    for name in listed:
        config = binding(name).settings
        assert config.name in printed
        assert config.description in printed
