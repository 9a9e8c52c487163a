"""Two radars of one kind on one bus: one DBC, and identifiers that differ by a number."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from candaemon.binding.bind import bind
from candaemon.cli.main import main
from candaemon.config.load import load_config
from candaemon.errors import ConfigError
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario import Scenario
from candaemon.simulation.simulate import simulate
from tests.support.paths import ROOT
from tests.support.small_car import YAML, written

_BEFORE, _FRONT = YAML.split("  front:\n")
SCENE = {
    "duration": 4,
    "ego": {"start": {"speed": 10}},
    "actors": [
        {"name": "ahead", "start": {"x": 40, "y": 0, "speed": 10}},
        {"name": "behind", "start": {"x": -40, "y": 0, "speed": 10}},
    ],
}


def with_rear(offset: str) -> str:
    """Return the small car's configuration with a second radar that looks back."""
    rear = _FRONT.replace("mount: {x: 3.6}", "mount: {x: -1, yaw_deg: 180}")
    return f"{_BEFORE}  front:\n{_FRONT}  rear:\n{rear.replace('dbc: car.dbc', f'dbc: car.dbc{offset}')}"


def test_each_hears_its_own_frames(tmp_path: Path) -> None:
    bound = bind(load_config(written(tmp_path, with_rear("\n    id_offset: 0x10"))))
    frames = list(simulate(Scenario.model_validate(SCENE), bound, 1).frames())
    assert {0x400, 0x401, 0x410, 0x411} < Counter(frame.can_id for frame in frames).keys()
    pipeline = Pipeline(bound)
    *_, last = pipeline.run(frames)
    assert [assembler.counts.scans > 70 for assembler in pipeline.assemblers] == [True, True]
    assert {-1, 1} <= {round(x / 40) for x in last.obstacles.x.tolist()}
    (counts,) = pipeline.counts.buses
    assert (counts.unknown, counts.frames) == (0, len(frames))


def test_check_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(written(tmp_path, with_rear("\n    id_offset: 0x10")))]) == 0
    told = capsys.readouterr().out
    assert "car.dbc, identifiers +0x10" in told
    assert "OBJECT, 0x411, 8 bytes" in told


@pytest.mark.parametrize(
    ("offset", "expected"),
    [
        ("", r"sensors\.rear: .*belongs to sensor 'front' already; .*device of the same kind, give its id_offset"),
        ("\n    id_offset: 1", r"rear: on bus 'car' id 0x401 \(and 1 more\) belongs to sensor 'front' already"),
        ("\n    id_offset: 2", r"sensors\.rear: on bus 'car' id 0x402 \(and 1 more\) belongs to ego already"),
        ("\n    id_offset: 0x400", r"car\.yaml:27: sensors\.rear\.id_offset: found 0x400, with which 0x400 of"),
        ("\n    id_offset: -1025", r"sensors\.rear\.id_offset: found -0x401, with which 0x400 of"),
    ],
)  # fmt: skip
def test_identifiers_that_cannot_be_are_refused(tmp_path: Path, offset: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        bind(load_config(written(tmp_path, with_rear(offset))))


def test_an_offset_is_hexadecimal_with_a_sign_too(tmp_path: Path) -> None:
    _, rear = bind(load_config(written(tmp_path, with_rear("\n    id_offset: -0x10")))).sensors
    assert rear.can_ids == {0x3F0, 0x3F1}


@pytest.mark.parametrize("offset", ["0x2g", '"0x20"', "1.5"])
def test_what_is_no_offset_is_told_with_an_example(tmp_path: Path, offset: str) -> None:
    with pytest.raises(ConfigError, match=r"id_offset: found .*, expected a valid integer \(.*such as 0x20 or -32"):
        load_config(written(tmp_path, with_rear(f"\n    id_offset: {offset}")))


OUTPUT = """output:
  bus: car
  dbc: car.dbc
  objects: {messages: [{message: OBJECT, id_signal: INDEX}], slots: 16}
  signals: {x: DIST_LONG, y: DIST_LAT}
"""


@pytest.mark.parametrize(("offset", "owner"), [(0x10, ""), (-1, "message 'MOTION' of 'car.dbc'")])
def test_what_the_same_dbc_shifted_has_is_anothers_to_the_output(tmp_path: Path, offset: int, owner: str) -> None:
    yaml = YAML.replace("    dbc: car.dbc\n", f"    dbc: car.dbc\n    id_offset: {offset}\n") + OUTPUT
    if not owner:
        bind(load_config(written(tmp_path, yaml)))
        return
    with pytest.raises(ConfigError, match=rf"output: on bus 'car' id 0x401 belongs to {owner} already"):
        bind(load_config(written(tmp_path, yaml)))


def toyota_shifted(folder: Path, offset: int) -> Path:
    """Write toyota_rav4.yaml, whose frames' checksums count their identifiers, with an offset for its radar."""
    text = (ROOT / "config" / "toyota_rav4.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    dbc = f"    dbc: {ROOT}/dbc/toyota_rav4_radar.dbc\n"
    assert text.count(dbc) == 1
    path = folder / "shifted.yaml"
    path.write_text(text.replace(dbc, f"{dbc}    id_offset: {offset}\n"), encoding="utf-8")
    return path


def test_an_offset_below_0_of_checksums_that_count_identifiers_is_refused(tmp_path: Path) -> None:
    path = toyota_shifted(tmp_path, -2047)
    line = path.read_text(encoding="utf-8").splitlines().index("    id_offset: -2047") + 1
    with pytest.raises(ConfigError) as caught:
        bind(load_config(path))
    assert str(caught.value) == (
        f"{path}:{line}: sensors.front.id_offset: found -0x7ff, with which 0x210 of 'TRACK_A_0' is no identifier any "
        "more; they go up to 0x7FF"
    )


def test_messages_that_the_sensor_does_not_need_may_lead_beyond(tmp_path: Path) -> None:
    spare = 'BO_ 5 SPARE: 8 Radar\n SG_ Value : 0|8@1+ (1,0) [0|0] "" Vector__XXX\n\n'
    path = written(tmp_path, with_rear("\n    id_offset: -16"))
    dbc = tmp_path / "car.dbc"
    text = dbc.read_text(encoding="utf-8")
    dbc.write_text(text[: text.index("BO_ ")] + spare + text[text.index("BO_ ") :], encoding="utf-8")
    _, rear = bind(load_config(path)).sensors
    assert rear.can_ids == {0x3F0, 0x3F1}
