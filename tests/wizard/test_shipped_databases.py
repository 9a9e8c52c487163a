"""What `init` writes of the DBC file of any radar that we ship, `check` takes."""

from __future__ import annotations

from pathlib import Path

import pytest

from candaemon.cli.main import main
from candaemon.config.load import load_config
from tests.support.paths import ROOT

NO_RADAR = frozenset(("oxts", "toyota_rav4_car", "obstacles", "obstacles_fd"))
"""Files of an INS, a car and our own output."""
NAMELESS = frozenset(("compensated_radar", "unnumbered_list"))
"""Files whose names do not tell what a place is: `init` says so."""
RADARS = sorted(path.stem for path in (ROOT / "dbc").glob("*.dbc") if path.stem not in NO_RADAR)


@pytest.mark.parametrize("name", RADARS)
def test_what_init_writes_check_takes(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "made.yaml"
    words = ["init", *(str(ROOT / "dbc" / f"{each}.dbc") for each in (name, "oxts")), "-o", str(out)]
    if name in NAMELESS:
        assert main(words) == 2
        assert "no radar found" in capsys.readouterr().err
        return
    assert main(words) == 0
    assert main(["check", str(out)]) == 0
    for sensor in load_config(out).config.sensors.values():
        for condition in (*sensor.objects.valid, *sensor.objects.new):
            assert not {"rms", "range", "dist"} & set(condition.signal.lower().split("_")), condition.signal
