"""Where nothing is wrong, calibration corrects nothing: every shipped scenario with every sensor as configured."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from candaemon.binding.bound import Binding
from candaemon.config.calibration import CalibrationSettings
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.radar.scan import Scan
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding
from tests.support.paths import ROOT

WRONG = {"late_and_turned", "failing_lidar"}
SCENARIOS = sorted(path for path in (ROOT / "config" / "scenarios").glob("*.yaml") if path.stem not in WRONG)
LONGEST = 20.0
LATENCY, YAW = 0.020, 0.0053
"""s and rad, .3 deg: within that, a correction is none."""


class CorrectedScans(Pipeline):
    """A pipeline as far as its scans, which it corrects. No tracks are needed to tell what stands.

    Attributes:
        largest: latency (s) and yaw (rad) that ever were in force.
    """

    def __init__(self, of: Binding) -> None:
        super().__init__(of)
        self.largest = [0.0, 0.0]

    def _cycle(self, scan: Scan, now_ns: int) -> Iterator[Cycle]:
        self.schedule.coast_due_ns = now_ns + self._coast_after_ns
        assert self.calibrator is not None
        self.calibrator.corrected(scan)
        self.calibrator.learn(scan)
        in_force = self.calibrator.state.sensors[scan.sensor].in_force
        self.largest = [max(one, abs(other)) for one, other in zip(self.largest, in_force, strict=True)]
        return iter(())


@pytest.mark.slow
@pytest.mark.parametrize(
    "radar", ["demo", "ars408", "toyota_rav4"] if os.environ.get("CANDAEMON_THOROUGH") else ["demo"]
)
@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda path: path.stem)
def test_nothing_is_corrected_where_nothing_is_wrong(scenario: Path, radar: str) -> None:
    of = binding(radar)
    config = of.settings.model_copy(update={"calibration": CalibrationSettings(apply=True)})
    pipeline = CorrectedScans(replace(of, loaded=replace(of.loaded, config=config)))
    drive = load_scenario(scenario)
    drive = drive.model_copy(update={"duration": min(drive.duration, LONGEST)})
    for _ in pipeline.run(simulate(drive, of).frames()):
        pass
    assert pipeline.largest[0] < LATENCY
    assert pipeline.largest[1] < YAW
