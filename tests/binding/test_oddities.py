"""What is valid and hardly meant is told when it is bound, with its place; what can never work is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from candaemon.binding.bind import bind
from candaemon.cli.main import main
from candaemon.config.load import load_config
from candaemon.config.output import StatusFormat
from candaemon.errors import ConfigError
from tests.support import small_car
from tests.support.small_car import DBC, YAML


def written(folder: Path, old: str, new: str) -> Path:
    """Write the configuration and its DBC, with one text in either replaced; return the path."""
    assert (old in YAML) != (old in DBC)
    return small_car.written(folder, YAML.replace(old, new), DBC.replace(old, new))


def test_what_is_meant_draws_no_remark(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, "slots: 16", "slots: 12")
    assert bind(load_config(path)).warnings == ()
    assert main(["check", str(path)]) == 0
    assert "nothing: there is no `output`" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("bitrate: 500000", "bitrate: 500", "car.yaml:2: buses.car.bitrate: found 500 bit/s, and no CAN is slower"),
        ("ego:", "  spare: {channel: can1}\nego:", "car.yaml:3: buses.spare: nothing is read from this bus or sent"),
        ("{channel: can0", "{interface: udp_multicast, channel: can0", "no multicast group; expected one such as 239"),
        ("{channel: can0", "{interface: udp_multicast, channel: 192.168.1.1", "channel: found '192.168.1.1', which"),
        ("slots: 16", "slots: 64", "objects.messages[0]: 'INDEX' has 4 bits, so 16 numbers at most, for 64 places"),
        ("timeout: 0.03", "timeout: 0.3", "sensors.front.timeout: found 0.3 s, longer than the cycle of 0.05 s"),
        ('"km/h"', '""', "signal 'SPEED' has no unit in the DBC, and is taken as m/s; say so, or what it is"),
        (
            'SG_ INDEX : 0|4@1+ (1,0) [0|15] "" CAR\n SG_ STATUS : 4|2@1+ (1,0) [0|2] "" CAR\n SG_ DIST_LONG :',
            'SG_ INDEX M : 0|4@1+ (1,0) [0|15] "" CAR\n SG_ STATUS : 4|2@1+ (1,0) [0|2] "" CAR\n SG_ DIST_LONG m0 :',
            "car.dbc:9: signal 'DIST_LONG' of 'OBJECT' is there only where INDEX is 0; objects of other frames are not",
        ),
    ],
)
def test_what_is_hardly_meant_is_told(tmp_path: Path, old: str, new: str, told: str) -> None:
    warnings = bind(load_config(written(tmp_path, old, new))).warnings
    assert len(warnings) == 1
    assert told in warnings[0]


def test_numbers_are_those_of_a_page(tmp_path: Path) -> None:
    path = written(tmp_path, "slots: 16", "slots: 32\n      pages: {signal: STATUS, count: 2}")
    assert bind(load_config(path)).warnings == ()


def test_an_interface_that_nobody_knows_is_told_by_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, "{channel: can0", "{interface: socktcan, channel: can0")
    assert main(["check", str(path)]) == 0
    assert "buses.car.interface: found 'socktcan', expected an interface of python-can: " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "12@1+ (0.0625,0)",
            "12@1+ (0,0)",
            "signal 'DIST_LONG' has the factor 0 in line 9 of the DBC, so all its values are one",
        ),
        ("BO_ 1025", "BO_ 1024", "message 'OBJECT' has the identifier of 'HEADER', in line 3 of 'car.dbc'"),
    ],
)
def test_what_can_never_work_is_refused(tmp_path: Path, old: str, new: str, told: str) -> None:
    with pytest.raises(ConfigError, match=r"car\.yaml:\d+: sensors\.front") as caught:
        bind(load_config(written(tmp_path, old, new)))
    assert told in str(caught.value)


def test_a_factor_of_0_of_a_signal_that_nobody_reads_costs_nothing(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        'SG_ COUNTER : 8|8@1+ (1,0) [0|255] "" CAR',
        'SG_ COUNTER : 8|8@1+ (1,0) [0|255] "" CAR\n SG_ X : 16|8@1+ (0,0) [0|9] "" CAR',
    )
    assert len(bind(load_config(path)).warnings) == 1


def test_a_dbc_of_ours_is_found_by_the_hint(tmp_path: Path) -> None:
    path = written(tmp_path, "  dbc: car.dbc\n  signals:", "  dbc: obstacles.dbc\n  signals:")
    with pytest.raises(ConfigError, match=r"the one that comes with candaemon is .*obstacles\.dbc"):
        bind(load_config(path))


def test_a_status_that_names_the_quantity_first_is_told_how_to_turn_it_round() -> None:
    with pytest.raises(ValueError, match=r"write \{Cycle: cycle\}"):
        StatusFormat(message="OBSTACLE_STATUS", signals={"cycle": "Cycle"})
