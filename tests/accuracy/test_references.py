"""That reference N is what filterpy's filter gives, and that the accuracy command scores a drive."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from candaemon.evaluation.pair_errors import ALL
from candaemon.simulation.scenario import NoiseOverride
from tests.accuracy.__main__ import configurations, main
from tests.accuracy.oracle import informed, sources
from tests.accuracy.scores import scored
from tests.accuracy.simulated_runs import Job, cycles_of, simulated, track_rows, truth_rows
from tests.accuracy.slot_filters import (
    FIRST_PLACE,
    FIRST_SPEED,
    SlotFilters,
    constant_velocity,
    with_simulated_noise,
)
from tests.support.paths import ROOT

SCENARIO = """
duration: 4
ego: {start: {speed: 20}}
actors:
  - {name: lead, start: {x: 30, y: 0, vx: 22, vy: 0}, reflections: 1}
  - {name: beside, start: {x: 15, y: 3.5, vx: 21, vy: 0}, reflections: 1}
measurement: {clutter: 0, detection_probability: 1}
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(SCENARIO)
    return path


@pytest.mark.parametrize("config", ["esr_ins", "ars408"])
def test_n_is_filterpys_filter(config: str, scenario: Path) -> None:
    density = 3.0
    simulation, pipeline = simulated(Job(ROOT / "config" / f"{config}.yaml", scenario, 1))
    ours = SlotFilters((pipeline.binding.sensors[0].settings.cycle_time,), (0.3, density))
    theirs: dict[int, KalmanFilter] = {}
    time_ns = 0
    for cycle in cycles_of(simulation.frames(), pipeline):
        detections = cycle.detections
        if detections is None:
            continue
        ours.step(detections, cycle.pose)
        f, q = constant_velocity((cycle.pose.time_ns - time_ns) * 1e-9)
        time_ns = cycle.pose.time_ns
        for k, key in enumerate(detections.object_id.tolist()):
            one = detections.measurement.take(np.array([k]))
            if key in theirs:
                theirs[key].predict(F=f, Q=density * q)
            else:
                theirs[key] = KalmanFilter(dim_x=4, dim_z=one.degrees_of_freedom)
                theirs[key].x = np.array([*one.position[0], 0.0, 0.0])
                theirs[key].P = np.diag([FIRST_PLACE**2] * 2 + [FIRST_SPEED**2] * 2)
            kf = theirs[key]
            innovation, h, r = one.linearised(kf.x[None])
            kf.update(innovation[0] + h[0] @ kf.x, R=r[0], H=h[0])
    assert len(theirs) == 2
    for row, kf in enumerate(theirs.values()):
        np.testing.assert_allclose(ours.mean[row, 1], kf.x, rtol=1e-9)
        np.testing.assert_allclose(ours.covariance[row, 1], kf.P, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("config", ["esr_ins", "ars408", "toyota_rav4_ins"])
def test_the_noise_of_the_simulation_stands_in_for_that_of_the_configuration(config: str, scenario: Path) -> None:
    simulation, pipeline = simulated(Job(ROOT / "config" / f"{config}.yaml", scenario, 1))
    sensor = pipeline.binding.sensors[0].settings
    stated = sensor.noise.model_dump(exclude_none=True)
    cycle = next(one for one in cycles_of(simulation.frames(), pipeline) if one.detections is not None)
    detections = cycle.detections
    assert detections is not None
    assert len(detections) > 0
    before = detections.measurement
    same = with_simulated_noise(detections, sensor, NoiseOverride(**stated), cycle.pose).measurement
    np.testing.assert_allclose(same.noise, before.noise, rtol=1e-9, atol=1e-12)
    doubled = NoiseOverride(**{name: 2 * value for name, value in stated.items()})
    wider = with_simulated_noise(detections, sensor, doubled, cycle.pose).measurement
    np.testing.assert_allclose(wider.noise, 4 * before.noise, rtol=1e-9, atol=1e-12)
    if before.range_rate_variance is not None:
        assert wider.range_rate_variance is not None
        gained = wider.range_rate_variance - before.range_rate_variance
        np.testing.assert_allclose(gained, 3 * stated["range_rate"] ** 2)
    for one, other, name in zip(wider.projections, before.projections, ("vx", "vy"), strict=False):
        np.testing.assert_allclose(one.variance - other.variance, 3 * stated[name] ** 2)


def test_the_command_tells_figures_and_writes_them(
    scenario: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = tmp_path / "figures.json"
    words = ["--scenarios", str(scenario), "--configs", "ars408", "--seeds", "1", "--processes", "1"]
    assert main([*words, "--json", str(told)]) == 0
    printed = capsys.readouterr()
    assert "1 of 1  tiny ars408 1" in printed.err
    lines = printed.out.splitlines()
    assert any(line.split()[:1] == ["tiny"] for line in lines)
    assert "legend" in lines
    figures = json.loads(told.read_text())
    ours, naive = figures["all"]["candaemon"], figures["all"]["N"]
    assert figures["grid"][f"{figures['naive_density']:g}"] == naive
    assert 0.0 < ours["position"] < 1.5
    assert 0.0 < naive["position"] < 1.5
    samples = {by: sum(group["samples"] for group in groups.values()) for by, groups in ours["groups"].items()}
    assert samples[ALL[0]] > 50
    assert {samples[by] for by in ("age", "range", "manoeuvre", "motion", "target")} == {samples[ALL[0]]}
    assert ours["missed"] == 0.0


@pytest.mark.parametrize("config", ["esr_ins", "ford_mrr", "near_far_radar"])
def test_o_keeps_one_obstacle_of_each_object_and_none_of_what_is_false(config: str, scenario: Path) -> None:
    """Of radars without identities too."""
    noisy = scenario.read_text().replace("clutter: 0", "clutter: 3").replace("reflections: 1", "reflections: 3")
    scenario.write_text(noisy)
    tracker = (("default", None), ("estimator.kind", "vehicle"))
    job = Job(ROOT / "config" / f"{config}.yaml", scenario, 1, tracker)
    simulation, pipeline = simulated(job)
    cycles = list(cycles_of(simulation.frames(), pipeline))
    told = informed(pipeline.binding, cycles, sources(simulation))
    assert told is not None
    assert set(np.concatenate([each.id for each in told]).tolist()) == {1, 2}
    assert sum(len(each.used_row) for each in told) > 4 * len(told)
    score = scored(track_rows(told), truth_rows(simulation))
    assert (score.switches, score.surplus, score.false, score.missed) == (0, 0, 0, 0)
    assert score.value("position") < 1.0


def test_an_actor_without_a_detection_for_three_seconds_is_undetected(scenario: Path) -> None:
    simulation, pipeline = simulated(Job(ROOT / "config" / "esr_ins.yaml", scenario, 1))
    told = [cycle.obstacles for cycle in cycles_of(simulation.frames(), pipeline)]
    truth, detected = truth_rows(simulation), sources(simulation)
    assert scored(track_rows(told), truth, detected).undetected == 0
    begin_ns = min(time_ns for _, time_ns in detected)
    early = {key: of for key, of in detected.items() if key[1] <= begin_ns + 500_000_000}
    late = scored(track_rows(told), truth, early)
    # two actors from 3.5 s on, when they have long been visible, until 4 s
    assert late.undetected == pytest.approx(2 * 10, abs=3)
    never = scored(track_rows(told), truth, {})
    assert never.undetected == late.awaited
    # of two actors that are visible, each 10 m off is worth 50 m²
    assert 10.0 * never.cycles * 0.9 < never.least_gospa <= 10.0 * never.cycles
    always = scored(track_rows(told), truth, detected)
    assert always.least_gospa <= always.gospa
    assert always.least_gospa == pytest.approx(2**0.5 * always.value("position") * always.cycles, rel=0.1)


def test_what_is_no_number_is_counted_and_not_paired(scenario: Path) -> None:
    simulation, pipeline = simulated(Job(ROOT / "config" / "esr_ins.yaml", scenario, 1))
    told = [cycle.obstacles for cycle in cycles_of(simulation.frames(), pipeline)]
    told[40].x[:] = np.nan
    rows = track_rows(told)
    assert rows.broken == len(told[40]) > 0
    score = scored(rows, truth_rows(simulation))
    assert score.figures()["broken"] == rows.broken
    assert np.isfinite(score.gospa)


def test_each_shipped_radar_is_measured_once() -> None:
    names = [path.stem for path in configurations(None)]
    assert {"esr_ins", "ars408", "toyota_rav4", "toyota_rav4_ins"} <= set(names)
    assert not {"demo", "esr_ins_fd", "esr_to_ars408", "ars408_to_esr"} & set(names)
    assert [path.stem for path in configurations(["demo", str(ROOT / "config" / "mando.yaml")])] == ["demo", "mando"]


def test_settings_of_the_tracker_are_replaced_and_checked(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--configs", "esr_ins", "--tracker", "lifecycle.confirm=0"])
    assert "lifecycle.confirm" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["--tracker", "confirm"])
    assert "expected KEY=VALUE" in capsys.readouterr().err
