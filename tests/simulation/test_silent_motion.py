"""A simulated source of ego motion that does not send everything all the time."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from candaemon.simulation.scenario import MOST_SILENCES, Scenario
from candaemon.simulation.scene import Scene
from candaemon.simulation.schedule import start_ns
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding

CURVATURE = 0x60A


def scenario(**own_motion: Any) -> Scenario:
    ego = {"start": {"speed": 6}, "segments": [{"speed": 0, "acceleration": 2}], "own_motion": own_motion}
    return Scenario.model_validate({"duration": 6, "ego": ego})


def test_a_signal_is_not_sent_below_its_speed_and_the_others_are_the_same() -> None:
    bound = binding("esr_ins")
    whole = [frame for frame in simulate(scenario(), bound).frames() if frame.bus == bound.ego.bus]  # type: ignore[union-attr]
    described = scenario(silent_below={"curvature": 2.0}, silent=[{"quantity": "heading", "begin": 1, "end": 1.5}])
    part = [frame for frame in simulate(described, bound).frames() if frame.bus == bound.ego.bus]  # type: ignore[union-attr]
    kept = {(frame.time_ns, frame.can_id): frame.data for frame in part}
    assert kept.items() <= {(frame.time_ns, frame.can_id): frame.data for frame in whole}.items()
    lost = Counter(frame.can_id for frame in whole if (frame.time_ns, frame.can_id) not in kept)
    assert lost == {CURVATURE: pytest.approx(400, abs=2), 0x607: 50}
    times = np.array([frame.time_ns - start_ns(described) for frame in part if frame.can_id == CURVATURE]) * 1e-9
    assert np.abs(Scene(described).ego(times).velocity).min() >= 1.99


@pytest.mark.parametrize(
    "wrong",
    [
        {"silent_below": {"curvatur": 2.0}},
        {"silent_below": {"curvature": 0.0}},
        {"silent_below": {"curvature": 101.0}},
        {"silent": [{"quantity": "heading", "begin": 2, "end": 2}]},
    ],
)
def test_a_wrong_silence_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        scenario(**wrong)


def test_a_scenario_may_have_so_many_silences() -> None:
    silence = {"quantity": "heading", "begin": 1, "end": 2}
    assert len(scenario(silent=[silence] * MOST_SILENCES).ego.own_motion.silent) == MOST_SILENCES
    with pytest.raises(ValidationError):
        scenario(silent=[silence] * (MOST_SILENCES + 1))
