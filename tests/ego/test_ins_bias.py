"""The bias of an INS's yaw rate is told by its headings."""

from __future__ import annotations

from math import degrees, pi, radians
from typing import Any

import numpy as np
import pytest

from candaemon.config.ego import InsSettings
from candaemon.ego.ins import InsMotion
from tests.support.builders import known, ns

SIGNALS = ("velocity_north", "velocity_east", "heading", "yaw_rate")
BIAS = radians(0.25)


def told(seconds: float, *, factor: float = 1.0, late: float = 0.0, **settings: Any) -> float:
    """Return by how much the yaw rate of the last pose is wrong after a drive round alternating bends, deg/s."""
    signals = {name: f"M.{name}" for name in SIGNALS}
    motion = InsMotion(
        InsSettings.model_validate({"kind": "ins", "bus": "b", "dbc": "d", "signals": signals} | settings)
    )
    random, rate = np.random.default_rng(5), 0.0
    for t in np.arange(0.0, seconds, 0.01):
        rate = 0.3 * np.sin(0.7 * t)
        heading = 0.3 / 0.7 * (1.0 - np.cos(0.7 * (t - late))) + radians(0.02) * random.standard_normal()
        motion.update(ns(t), SIGNALS[:2], (15.0 * np.sin(heading), 15.0 * np.cos(heading)))
        motion.update(ns(t), ("yaw_rate",), (factor * rate + BIAS,))
        motion.update(ns(t), ("heading",), (pi / 2 - heading,))
    return degrees(known(motion.pose(motion.known_until_ns)).yaw_rate - rate)


@pytest.mark.parametrize(("seconds", "most"), [(1.0, 0.1), (20.0, 0.05)])
def test_the_headings_tell_the_bias_before_long(seconds: float, most: float) -> None:
    assert abs(told(seconds)) < most


def test_a_yaw_rate_may_be_used_as_it_is_given() -> None:
    assert told(10.0, bias_time=0.0) == pytest.approx(0.25)


def test_another_sign_is_no_bias() -> None:
    """It stays wrong where anybody sees it, but for three of its standard deviations."""
    wrong = told(2.0, factor=-1.0)
    turned = degrees(-2.0 * 0.3 * np.sin(0.7 * 1.99))
    assert wrong == pytest.approx(turned, abs=0.25 + 3 * 0.3 + 0.1)
    assert abs(wrong) > 30.0


def test_headings_that_come_late_are_hardly_taken_for_a_bias() -> None:
    """By 50 ms they are behind all the time, which a bend shows and the next one takes back."""
    assert abs(told(20.0, late=0.05)) < 0.15
