"""The LFM-FSK front end: what it resolves, how well it measures, and that a simulated drive through it is tracked."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Floats
from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.config.sensors import LfmFskSettings
from candaemon.config.settings import Config
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.lfm_fsk import LfmFsk, LfmFskReceiver, Peaks
from candaemon.simulation.scenario import Scenario, load_scenario
from candaemon.simulation.simulate import simulate
from tests.support.effort import examples
from tests.support.paths import ROOT

DEFAULT = LfmFskSettings(kind="lfm_fsk")
WAVEFORM = LfmFsk(DEFAULT)


def received(distance: list[float], rate: list[float], azimuth: list[float] | None = None, **more: float) -> Peaks:
    """Return the peaks of echoes without noise."""
    receiver = LfmFskReceiver(LfmFskSettings(kind="lfm_fsk", oversampling=1024, **more))
    return receiver.receive(
        np.array(distance), np.array(rate), np.array(azimuth or [0.0] * len(distance)), np.zeros((2, len(distance)))
    )


def test_the_cells_are_those_of_the_textbook() -> None:
    """c / 2B and λ / 2T; in cells, the beat frequency is speed less range."""
    assert WAVEFORM.range_cell == pytest.approx(0.99931, abs=1e-5)
    assert WAVEFORM.speed_cell == pytest.approx(0.38934, abs=1e-5)
    beat, _ = WAVEFORM.beat(np.array([10 * WAVEFORM.range_cell]), np.array([-3 * WAVEFORM.speed_cell]))
    assert beat[0] == pytest.approx(3.0 - 10.0)


def test_at_the_classical_step_range_and_speed_share_the_phase() -> None:
    """At f = B / 2(N − 1): R/ΔR = (N − 1) Δφ / 2π − κ / 2 and v/Δv = (N − 1) Δφ / 2π + κ / 2, Rohling and Meinecke."""
    classical = LfmFsk(LfmFskSettings(kind="lfm_fsk", steps=256, step_frequency=150e6 / (2 * 255)))
    beat, phase = np.array([-30.25]), np.array([0.9])
    distance, rate = classical.target(beat, phase)
    half = 255 * phase[0] / (2 * math.pi)
    assert distance[0] / classical.range_cell == pytest.approx(half - beat[0] / 2)
    assert -rate[0] / classical.speed_cell == pytest.approx(half + beat[0] / 2)


@settings(deadline=None, max_examples=examples(100))
@given(distance=st.floats(0.0, 245.0), rate=st.floats(-70.0, 70.0))
def test_within_the_unambiguous_interval_a_target_comes_back(distance: float, rate: float) -> None:
    found = WAVEFORM.target(*WAVEFORM.beat(np.array([distance]), np.array([rate])))
    assert found[0][0] == pytest.approx(distance, abs=1e-6)
    assert found[1][0] == pytest.approx(rate, abs=1e-6)


def test_beyond_the_unambiguous_range_a_target_appears_too_near_and_at_a_wrong_speed() -> None:
    assert WAVEFORM.unambiguous_range == pytest.approx(261.4, abs=0.1)
    (distance,), (rate,) = WAVEFORM.target(*WAVEFORM.beat(np.array([300.0]), np.array([-5.0])))
    assert distance == pytest.approx(300.0 - WAVEFORM.unambiguous_range)
    assert rate == pytest.approx(-5.0 + WAVEFORM.unambiguous_range / WAVEFORM.range_cell * WAVEFORM.speed_cell)


def test_a_beat_frequency_that_comes_round_gives_a_wrong_range_too() -> None:
    short = LfmFsk(LfmFskSettings(kind="lfm_fsk", steps=128))
    (near,), _ = short.target(*short.beat(np.array([60.0]), np.array([0.0])))
    (far,), _ = short.target(*short.beat(np.array([70.0]), np.array([0.0])))
    assert near == pytest.approx(60.0)
    assert abs(far - 70.0) > 10.0


def test_two_targets_closer_than_a_cell_at_equal_speed_are_one() -> None:
    peaks = received([50.0, 50.8], [-4.0, -4.0], [0.02, -0.02])
    share = 1 / (1 + (50.0 / 50.8) ** 4)  # the nearer is the stronger, by the fourth power of range
    assert peaks.strongest.tolist() == [0]
    assert peaks.distance[0] == pytest.approx(50.0 * share + 50.8 * (1 - share), abs=0.01)
    assert peaks.rate[0] == pytest.approx(-4.0, abs=0.01)
    assert peaks.azimuth[0] == pytest.approx(0.02 * share - 0.02 * (1 - share), abs=1e-4)


def test_two_targets_a_cell_apart_are_two_in_range_or_in_speed() -> None:
    for distance, rate in (([50.0, 51.2], [-4.0, -4.0]), ([50.0, 50.0], [-4.0, -4.5])):
        peaks = received(distance, rate)
        order = np.argsort(peaks.strongest)
        assert peaks.distance[order] == pytest.approx(distance, abs=0.01)
        assert peaks.rate[order] == pytest.approx(rate, abs=0.01)


def test_echoes_that_follow_each_other_closely_are_as_many_peaks_as_have_room() -> None:
    """A row of posts, each less than a cell from the next, is no single target."""
    posts = np.arange(40.0, 64.0, 0.6)
    peaks = received(posts.tolist(), [-4.0] * len(posts))
    assert 12 <= len(peaks.strongest) <= 24
    assert peaks.strongest[0] == 0, "the nearest is the strongest"
    assert (np.diff(peaks.distance) > 0.5 * WAVEFORM.range_cell).all()
    assert np.abs(peaks.distance[:, None] - posts).min(axis=1).max() < 0.6
    assert np.abs(peaks.distance - posts[peaks.strongest]).max() < WAVEFORM.range_cell
    assert peaks.rate == pytest.approx(np.full(len(peaks.rate), -4.0), abs=0.01)


def test_range_and_speed_that_make_up_for_each_other_are_not_told_apart() -> None:
    cells = 20
    peaks = received([50.0, 50.0 + cells * WAVEFORM.range_cell], [0.0, -cells * WAVEFORM.speed_cell])
    assert len(peaks.strongest) == 1


def test_errors_are_those_of_the_cramer_rao_bound() -> None:
    """50 dB at 50 m; of one measurement each: targets far apart in beat frequency."""
    rng = np.random.default_rng(3)
    receiver = LfmFskReceiver(LfmFskSettings(kind="lfm_fsk", snr_db=50.0))
    distance, rate = np.full(4000, 50.0), np.linspace(-60.0, 60.0, 4000)
    told = [
        receiver.receive(d, r, np.zeros(1), rng.standard_normal((2, 1)))
        for d, r in zip(distance[:, None], rate[:, None], strict=True)
    ]
    error = np.array([each.distance[0] for each in told]) - 50.0
    faster = np.array([each.rate[0] for each in told]) - rate
    cells_a_rad = 1 / (2 * math.pi * 500e3 / 150e6 + math.pi / 1023)
    phase, beat = 10 ** (-50 / 20), math.hypot(math.sqrt(3) / (2 * math.pi) * 10 ** (-50 / 20), 1 / 16 / math.sqrt(12))
    expected = WAVEFORM.range_cell * cells_a_rad * math.hypot(phase, math.pi / 1023 * beat)
    assert error.mean() == pytest.approx(0.0, abs=3 * expected / math.sqrt(4000))
    assert error.std() == pytest.approx(expected, rel=0.05)
    speed = WAVEFORM.speed_cell * math.hypot(cells_a_rad * phase, (1 - cells_a_rad * math.pi / 1023) * beat)
    assert faster.std() == pytest.approx(speed, rel=0.05)
    assert np.corrcoef(error, faster)[0, 1] < -0.9, "both come from one phase"


def test_what_is_too_weak_is_not_seen_and_errors_grow_with_range() -> None:
    assert received([50.0, 700.0], [0.0, 3.0], threshold_db=20.0).strongest.tolist() == [0]
    rng = np.random.default_rng(4)
    receiver = LfmFskReceiver(DEFAULT)

    def spread(distance: float) -> float:
        still = np.zeros(1)
        found = [receiver.receive(still + distance, still, still, rng.standard_normal((2, 1))) for _ in range(400)]
        return float(np.std([each.distance[0] for each in found]))

    assert spread(150.0) / spread(50.0) == pytest.approx(9.0, rel=0.2)


def test_no_echo_is_no_peak() -> None:
    assert len(received([], []).strongest) == 0


def esr(folder: Path, front_end: dict[str, Any] | None, config: str = "esr_ins") -> Binding:
    """Return one of the project's configurations, its first sensor with a front end."""
    told = yaml.safe_load((ROOT / "config" / f"{config}.yaml").read_text(encoding="utf-8"))
    for part in (told["ego"], told["output"], *told["sensors"].values()):
        part["dbc"] = str(ROOT / "config" / part["dbc"])
    (name,) = told["sensors"]
    if front_end is not None:
        told["sensors"][name]["front_end"] = front_end
    path = folder / "vehicle.yaml"
    path.write_text(yaml.safe_dump(told, sort_keys=False), encoding="utf-8")
    return bind(load_config(path))


def scenario(name: str, **changes: Any) -> Scenario:
    told = load_scenario(ROOT / "config" / "scenarios" / f"{name}.yaml").model_dump()
    for key, value in changes.items():
        told[key] = told[key] | value if isinstance(value, dict) else value
    return Scenario.model_validate(told)


def test_a_drive_through_the_front_end_is_tracked(tmp_path: Path) -> None:
    binding = esr(tmp_path, {"kind": "lfm_fsk"})
    told = scenario("automotive_brake", duration=6.0)
    cycles = list(Pipeline(binding).run(simulate(told, binding).frames()))
    truth = {row.time_ns: row.columns for row in simulate(told, binding).truth()}
    errors = []
    for cycle in cycles[40:]:
        obstacles = cycle.obstacles
        exact = truth[min(truth, key=lambda time: abs(time - obstacles.time_ns))]
        confirmed = obstacles.state == 1
        near = np.hypot(obstacles.x - exact["x"][0], obstacles.y - exact["y"][0]) < 4.0
        assert (confirmed & near).sum() == 1
        k = np.flatnonzero(confirmed & near)[0]
        errors.append((obstacles.x[k] - exact["x"][0], obstacles.vx[k] - exact["vx"][0]))
    assert len(errors) > 60
    assert np.sqrt(np.square(errors).mean(axis=0)).max() < 0.6


@pytest.mark.parametrize("config", ["esr_ins", "ars408"])
def test_two_points_a_step_apart_become_one_object(config: str, tmp_path: Path) -> None:
    """Polar and cartesian sensors alike; the same two are two without a front end, and apart in range with it."""

    def objects(gap: float, front_end: dict[str, Any] | None) -> tuple[float, Floats]:
        size = {"length": 0.0, "width": 0.0}
        points = tuple(
            {"name": f"{k}", "size": size, "start": {"x": 60.0 + k * gap, "y": 0.5 * k, "vx": 10.0, "vy": 0.0}}
            for k in range(2)
        )
        ego = {"start": {"speed": 15.0}, "segments": ()}
        quiet = {"clutter": 0.0, "detection_probability": 1.0, "occlusion": False, "cycle_jitter": 0.0}
        told = scenario("automotive_cruise", duration=2.0, actors=points, ego=ego, measurement=quiet)
        reports = [report for _, report in simulate(told, esr(tmp_path, front_end, config)).reports(0)]
        row = {name: k for k, name in enumerate(reports[0].quantities)}
        first = np.concatenate([report.values[:, report.owner == 0] for report in reports], axis=1)
        if "range" not in row:
            return float(np.mean([len(r.slot) for r in reports])), first[[row["x"], row["vx"]]]
        return float(np.mean([len(r.slot) for r in reports])), first[[row["range"], row["range_rate"]]]

    fine = {"kind": "lfm_fsk", "snr_db": 80.0}
    assert objects(0.7, None)[0] == 2.0
    assert objects(3.0, fine)[0] == 2.0
    count, seen = objects(0.7, fine)
    assert count < 1.1
    steps = np.arange(seen.shape[1])
    slope = np.polyfit(steps, seen[0], 1)[0]
    assert seen[1].mean() == pytest.approx(-5.0, abs=0.1)
    assert slope < 0.0
    assert (seen[0] - np.polyval(np.polyfit(steps, seen[0], 2), steps)).std() < 0.1


def test_without_a_front_end_the_bytes_are_as_they_were(tmp_path: Path) -> None:
    told = scenario("highway", duration=1.0)
    plain = bind(load_config(ROOT / "config" / "esr_ins.yaml"))
    assert list(simulate(told, esr(tmp_path, None)).frames()) == list(simulate(told, plain).frames())
    again = [list(simulate(told, esr(tmp_path, {"kind": "lfm_fsk"})).frames()) for _ in range(2)]
    assert again[0] == again[1]
    assert again[0] != list(simulate(told, plain).frames())


def test_only_a_radar_has_a_front_end() -> None:
    told = yaml.safe_load((ROOT / "config" / "esr_ins.yaml").read_text(encoding="utf-8"))
    told["sensors"]["front"] |= {"kind": "lidar", "front_end": {"kind": "lfm_fsk"}}
    with pytest.raises(ValueError, match="front_end is a radar's but kind is lidar"):
        Config.model_validate(told)
