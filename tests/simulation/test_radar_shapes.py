"""Each shape of radar, simulated through its DBC and replayed back to the truth."""

from __future__ import annotations

import pytest

from tests.support.simulated import drive, scenario

POSITION, VELOCITY = (
    0.6,
    0.45,
)  # m and m/s RMSE: what the sensors' noise and quanta allow on vehicles of many reflections
SECONDS = 15.0
CONFIGS = (
    "toyota_rav4",
    "esr_ins_fd",
    "tesla_continental",
    "ars408",
    "ars408_to_esr",
    "ford_mrr_fd",
    "multiplexed_radar",
    "unnumbered_list",
)
MORE = (
    "toyota_rav4_ins",
    "esr_ins",
    "gm_lrr",
    "acura_ilx",
    "mando",
    "esr_to_ars408",
    "demo",
    "ford_mrr",
    "volkswagen_meb",
    "chrysler_pacifica",
    "smartmicro_umrr",
    "mazda_radar",
    "near_far_radar",
    "ars408_clusters",
    "compensated_radar",
)


@pytest.mark.parametrize("config", [*CONFIGS, *(pytest.param(each, marks=pytest.mark.slow) for each in MORE)])
def test_a_drive_comes_back_to_its_truth(config: str) -> None:
    drama = scenario("highway").model_copy(update={"duration": SECONDS})
    run, pipeline = drive(config, drama, seed=1)
    assert run.errors.position <= POSITION
    assert run.errors.velocity <= VELOCITY
    assert run.time_to_confirm.unconfirmed == 0
    assert run.false_tracks.ids == 0
    if not config.endswith("_to_esr"):  # whose acceleration a radar's noise may well exceed
        assert pipeline.saturated == 0
    for sensor, assembler in zip(pipeline.binding.sensors, pipeline.assemblers, strict=True):
        assert assembler.counts.scans == pytest.approx(SECONDS / sensor.settings.cycle_time, rel=0.02)
        assert assembler.counts.dropped == assembler.counts.missing == 0
