"""The bias of an INS's yaw rate is told by its headings."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, degrees, pi, radians, sin
from typing import Any

import numpy as np
import pytest

from candaemon.config.ego import InsSettings
from candaemon.ego.ins import InsMotion
from tests.support.builders import known, ns

BIAS = radians(0.25)
STEP = 0.01


class Drive:
    """A drive told to an INS's ego motion at 100 Hz: at 15 m/s unless told else, noisy headings, a biased yaw rate.

    Args:
        turn: yaw rate by time, rad/s.
        source: `yaw_rate` or `curvature`.
        every: samples between two headings, which come before the velocity of the last of them.
        late: s, by which headings are those of before.
        factor: of the yaw rate as given.
        settings: of the INS.
    """

    def __init__(
        self,
        turn: Callable[[float], float] = lambda t: 0.02 * sin(0.7 * t),
        source: str = "yaw_rate",
        every: int = 1,
        late: float = 0.0,
        factor: float = 1.0,
        **settings: Any,
    ) -> None:
        names = ("velocity_north", "velocity_east", "heading", "yaw_rate", "curvature")
        used = names if source == "yaw_rate" else (*names[:3], "curvature")
        signals = {name: f"M.{name}" for name in used}
        data = {"kind": "ins", "bus": "b", "dbc": "d", "signals": signals}
        self.motion = InsMotion(InsSettings.model_validate(data | settings))
        self.turn, self.source, self.every, self.factor = turn, source, every, factor
        self.time, self.headings, self.delay = 0.0, [0.0], round(late / STEP)
        self._random = np.random.default_rng(5)

    def go_on(self, seconds: float, *, speed: float = 15.0, silent: str = "", jump: float = 0.0) -> None:
        """Drive on; a quantity is silent, headings have jumped by an angle, rad."""
        for _ in range(round(seconds / STEP)):
            self.time += STEP
            rate = self.turn(self.time)
            heading = self.headings[-1] + rate * STEP
            self.headings.append(heading)
            told = self.headings[max(len(self.headings) - 1 - self.delay, 0)] + jump
            noise = radians(0.02) * self._random.standard_normal()
            if silent != "heading" and len(self.headings) % self.every == 0:
                self.motion.update(ns(self.time - 0.002), ("heading",), (pi / 2 - told - noise,))
            given = self.factor * rate + BIAS
            if self.source == "curvature":
                self.motion.update(ns(self.time - 0.001), ("curvature",), (given / speed if speed else 0.0,))
            elif silent != "yaw_rate":
                self.motion.update(ns(self.time - 0.001), ("yaw_rate",), (given,))
            else:
                self.motion.update(ns(self.time - 0.001), ("curvature",), (rate / speed,))
            self.motion.update(
                ns(self.time), ("velocity_north", "velocity_east"), (speed * sin(heading), speed * cos(heading))
            )

    def error(self) -> float:
        """Return by how much the yaw rate of the last sample is wrong, deg/s."""
        pose = known(self.motion.pose(self.motion.known_until_ns))
        return degrees(pose.yaw_rate - self.turn(self.time))


@pytest.mark.parametrize("source", ["yaw_rate", "curvature"])
@pytest.mark.parametrize("every", [1, 5])
@pytest.mark.parametrize(("seconds", "most"), [(1.0, 0.15), (20.0, 0.03)])
def test_the_headings_tell_the_bias_before_long(seconds: float, most: float, every: int, source: str) -> None:
    """Also those that come less often, and before the velocity."""
    drive = Drive(source=source, every=every)
    drive.go_on(seconds)
    assert abs(drive.error()) < most


def test_the_headings_tell_the_bias_in_a_bend_that_lasts() -> None:
    """Where it begins it may seem to be one of a heading that comes late."""
    drive = Drive(turn=lambda t: 0.1 * min(t, 1.0), late=0.05)
    drive.go_on(12.0)
    assert abs(drive.error()) < 0.03


def test_a_yaw_rate_may_be_used_as_it_is_given() -> None:
    drive = Drive(bias_time=0.0)
    drive.go_on(10.0)
    assert drive.error() == pytest.approx(0.25)


def test_another_sign_is_no_bias() -> None:
    """It stays wrong where anybody sees it, but for three of its standard deviations."""
    drive = Drive(factor=-1.0, turn=lambda _: radians(4.0))
    drive.go_on(20.0)
    assert drive.error() == pytest.approx(0.25 - 8.0 + 3 * 0.3, abs=0.01)


@pytest.mark.parametrize("late", [0.05, 0.1])
def test_headings_that_come_late_are_hardly_taken_for_a_bias(late: float) -> None:
    """Who turns off has headings behind the yaw rate, as long as the turn lasts."""
    drive = Drive(turn=lambda t: 0.5 if 8.0 < t < 11.0 else 0.0, late=late)
    drive.go_on(8.0)
    for _ in range(40):
        drive.go_on(0.1)
        assert abs(drive.error()) < 0.1


def test_a_heading_that_has_been_set_is_not_taken_for_a_bias() -> None:
    drive = Drive()
    drive.go_on(10.0)
    drive.go_on(1.0, jump=radians(2.0))
    assert abs(drive.error()) < 0.05


def test_headings_noisier_than_is_said_tell_the_bias_in_the_end() -> None:
    drive = Drive(noise={"heading_deg": 0.005})
    drive.go_on(30.0)
    assert abs(drive.error()) < 0.1


def test_who_stands_does_not_turn_whatever_the_bias_of_its_curvature() -> None:
    drive = Drive(turn=lambda _: 0.0, source="curvature")
    drive.go_on(10.0)
    drive.go_on(30.0, speed=0.0)
    assert drive.error() == 0.0
    drive.go_on(0.1)
    assert abs(drive.error()) < 0.1  # it is known still


def test_what_stands_in_for_the_yaw_rate_has_not_its_bias() -> None:
    drive = Drive()
    drive.go_on(10.0)
    drive.go_on(1.0, silent="yaw_rate")
    assert drive.error() == pytest.approx(0.0, abs=1e-9)
    drive.go_on(0.1)
    assert abs(drive.error()) < 0.05


def test_the_bias_is_taken_off_while_no_heading_comes_and_stays_when_it_comes_again() -> None:
    drive = Drive()
    drive.go_on(20.0)
    drive.go_on(5.0, silent="heading")
    pose = known(drive.motion.pose(drive.motion.known_until_ns))
    assert degrees(pose.heading - drive.headings[-1]) == pytest.approx(0.0, abs=0.2)  # 1.25° with the bias
    drive.go_on(0.1)
    assert abs(drive.error()) < 0.05
