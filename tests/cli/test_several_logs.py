"""A drive that was recorded bus by bus, held against a configuration and shown as if it were one log."""

from __future__ import annotations

from pathlib import Path

import pytest

from candaemon.can_io.logs.write import open_log_writer
from candaemon.cli.main import main
from candaemon.files.outputs import Outputs
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from candaemon.wizard.traffic import read_traffic
from tests.support.bound import binding as shipped

DRIVE = {
    "duration": 4,
    "ego": {"start": {"speed": 12}},
    "actors": [{"name": "ahead", "start": {"x": 30, "y": 0, "speed": 13}}],
}


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    """Return a log, and the same bus by bus, the later first."""
    folder = tmp_path_factory.mktemp("buses")
    of = shipped("gm_lrr")
    whole = folder / "whole.log"
    channels = [bus.settings.log_channel or bus.settings.channel for bus in of.buses]
    with Outputs() as outputs, open_log_writer(outputs.open(whole), channels) as writer:
        writer.write(list(simulate(Scenario.model_validate(DRIVE), of, 3).frames()))
    lines = whole.read_text(encoding="utf-8").splitlines(keepends=True)
    parts = []
    for channel in sorted({line.split()[1] for line in lines}, reverse=True):
        parts.append(folder / f"{channel}.log")
        parts[-1].write_text("".join(line for line in lines if line.split()[1] == channel), encoding="utf-8")
    assert len(parts) == 2
    return whole, parts


def test_check_takes_several_logs_as_one_drive(
    logs: tuple[Path, list[Path]], capfd: pytest.CaptureFixture[str]
) -> None:
    whole, parts = logs
    told = []
    for given in ([whole], parts):
        words = ["check", "gm_lrr", *map(str, given), *(word for log in given for word in ("--log", str(log)))]
        assert main(words) == 0
        told.append(capfd.readouterr().out)
    assert told[0] == told[1]
    assert "own motion in the log" in told[0]
    assert "the log contradicts nothing" in told[0]
    assert main(["check", "gm_lrr", "--log", str(parts[0])]) == 0  # a bus alone lacks the other
    assert "no frame came of" in capfd.readouterr().out


def test_a_wizard_reads_several_logs_as_one_drive(logs: tuple[Path, list[Path]]) -> None:
    whole, parts = logs
    one, several = read_traffic([whole]), read_traffic(parts)
    assert one.channels == several.channels
    assert one.streams.keys() == several.streams.keys()
    assert all((one.streams[key].time == several.streams[key].time).all() for key in one.streams)
    assert one.seconds == several.seconds


def test_view_shows_several_logs_as_one_drive(logs: tuple[Path, list[Path]]) -> None:
    pytest.importorskip("aiohttp")
    from candaemon.view.drive_pictures import pictures_of_log

    whole, parts = logs
    of = shipped("gm_lrr")
    one, several = (list(pictures_of_log(of, given)) for given in ([whole], parts))
    assert len(one) == len(several) > 50
    for name in ("id", "x", "y", "vx"):
        assert [each.columns[name].tolist() for each in one] == [each.columns[name].tolist() for each in several]
    assert [each.time_ns for each in one] == [each.time_ns for each in several]
