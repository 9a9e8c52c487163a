"""Which obstacle leads in the own path, and when one is reached."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from candaemon.config.sensors import Mount
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.output.quantities import MountView, SeenCycle
from candaemon.tracking.obstacles import no_obstacles

NEVER = float("nan")


def values(name: str, *, yaw_rate: float = 0.0, mount: float = 0.0, **columns: list[float]) -> list[float]:
    """Return a quantity of obstacles that go as fast as the own vehicle, 20 m/s, but for what is given."""
    count = len(columns["x"])
    given: dict[str, Any] = {"y": [0.0] * count, "vx": [20.0] * count, "vy": [0.0] * count, "width": [NEVER] * count}
    arrays: dict[str, Any] = {each: np.array(column) for each, column in (given | columns).items()}
    pose = EgoPose(0, 0.0, 0.0, 0.0, 20.0, 0.0, yaw_rate, 0.01, EgoStatus.VALID)
    view = MountView([SeenCycle(replace(no_obstacles(0), **arrays), slice(None), pose)], Mount(x=mount), half_width=1.8)
    return [float(each) for each in view.quantity(name, polar=False)]


def test_the_nearest_in_the_path_leads() -> None:
    assert values("lead", x=[60.0, 30.0, 10.0, -5.0], y=[0.0, 1.5, 3.5, 0.0]) == [0.0, 1.0, 0.0, 0.0]
    assert values("lead", x=[60.0, 30.0], y=[2.0, -5.0]) == [0.0, 0.0]
    assert values("lead", x=[]) == []


def test_the_path_bends_as_the_vehicle_turns() -> None:
    """At 20 m/s and 0.2 rad/s the radius is 100 m: 40 m ahead the path is 8 m to the left."""
    assert values("lead", x=[40.0, 40.0], y=[0.0, 8.0]) == [1.0, 0.0]
    assert values("lead", x=[40.0, 40.0], y=[0.0, 8.0], yaw_rate=0.2) == [0.0, 1.0]


def test_what_is_slower_ahead_is_reached() -> None:
    found = values("time_to_collision", x=[50.0, 50.0, 50.0, -50.0], vx=[10.0, 20.0, 25.0, 30.0])
    assert found[0] == pytest.approx(5.0)
    assert np.isnan(found[1:]).all()
    assert values("time_to_collision", x=[53.6], vx=[10.0], mount=3.6) == pytest.approx([5.0])


def test_what_is_beside_the_path_by_then_is_not_reached() -> None:
    crossing: dict[str, Any] = {"x": [40.0] * 3, "vx": [10.0] * 3, "y": [-8.0, -8.0, 0.0], "vy": [2.0, 0.0, 2.0]}
    found = values("time_to_collision", **crossing)
    assert found[0] == pytest.approx(4.0)
    assert np.isnan(found[1:]).all()


def test_a_wide_body_is_reached_where_its_middle_passes_beside() -> None:
    found = values("time_to_collision", x=[40.0] * 2, vx=[10.0] * 2, y=[2.5] * 2, width=[NEVER, 2.5])
    assert np.isnan(found[0])
    assert found[1] == pytest.approx(4.0)
