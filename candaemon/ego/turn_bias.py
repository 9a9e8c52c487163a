"""The bias of the yaw rate that an INS gives, as the change of its headings tells it."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians, sqrt
from typing import Final, NamedTuple

from candaemon.config.ego import InsSettings

STANDING_SPEED: Final = 0.2
"""m/s; a vehicle that is slower keeps its heading while none comes."""
_LARGEST_BIAS = 3.0
"""Standard deviations of a yaw rate; what differs more from the heading's is no bias, but another sign or scale."""
_STRAIGHT = radians(5.0)
"""rad/s; what turns faster drives along a bend."""
_STEADY = radians(1.0)
"""rad/s; a bend begins or ends where the yaw rate differs from that of late by as much: there the heading tells how
late it comes rather than a bias …"""
_SETTLED = 0.5
"""s, … and for so long afterwards; and the time constant of the yaw rate of late."""
_LARGEST_CHANGE = 6.0 * sqrt(2.0)
"""Standard deviations of a heading; what stays changed by more beside the yaw rate has been set."""
_EARLIEST = 0.5
"""s; the change of the first headings tells less of a bias than of noise, and of how late they come in a bend."""


class GivenTurn(NamedTuple):
    """A yaw rate that an INS gives.

    Attributes:
        rate: as it is given, rad/s.
        speed: of the INS then, m/s.
        by_curvature: whether it is the path's curvature times the speed.
        is_usual: whether it comes from where it comes from usually, and headings tell its bias.
    """

    rate: float
    speed: float
    by_curvature: bool
    is_usual: bool


@dataclass(slots=True)
class TurnBiasState:
    """What is known of the bias.

    Attributes:
        given: yaw rate as it was given with the latest heading, rad/s; None: none was whose bias headings tell.
        bias: rad/s.
        speed: at which that was told, m/s.
        followed: s over which headings have told it, up to `bias_time`.
        lately: given yaw rate, smoothed with the time constant `_SETTLED`, rad/s.
        steady: s since a bend began or ended.
        excess: what the given yaw rate has turned more than the heading and the bias has not followed yet, rad.
        excess_time: in which it has, s.
    """

    given: float | None = None
    bias: float = 0.0
    speed: float = 0.0
    followed: float = 0.0
    lately: float = 0.0
    steady: float = _SETTLED
    excess: float = 0.0
    excess_time: float = 0.0


class TurnBias:
    """Follows the bias.

    Args:
        settings: of the INS.

    Attributes:
        state: what is known.
        limits: what bounds it, in the order that the kernel takes.
    """

    def __init__(self, settings: InsSettings) -> None:
        self.state = TurnBiasState()
        self._time = settings.bias_time
        self._largest_bias = _LARGEST_BIAS * radians(settings.noise.yaw_rate_deg)
        self._largest_change = _LARGEST_CHANGE * radians(settings.noise.heading_deg)
        self._earliest = min(_EARLIEST, settings.bias_time)
        self.limits = (
            self._time,
            self._largest_bias,
            self._largest_change,
            _STRAIGHT,
            _STEADY,
            _SETTLED,
            STANDING_SPEED,
            self._earliest,
        )

    def unbiased(self, given: GivenTurn | None) -> float | None:
        """Return a given yaw rate without its bias, rad/s.

        An INS that says at rest that it does not turn knows it. The bias of a curvature may be one of the curvature,
        or of the yaw rate that it was made of: at lower speeds the smaller of the two is taken off.
        """
        if given is None:
            return None
        speed, state = abs(given.speed), self.state
        if not given.is_usual or (given.rate == 0.0 and speed < STANDING_SPEED):
            return given.rate
        slower = given.by_curvature and speed < state.speed
        return given.rate - (state.bias * (speed / state.speed) if slower else state.bias)

    def note(self, given: GivenTurn | None) -> None:
        """Note the yaw rate that comes with a heading."""
        self.state.given = given.rate if given is not None and given.is_usual else None

    def follow(self, given: GivenTurn, change: float, dt: float) -> None:
        """Follow by how much more a given yaw rate turns than a change of the heading, rad, in a time, s.

        The error of a heading is bounded, and counts for less the longer it is watched; that of a bias adds up. Where a
        bend begins or ends, a heading that comes a little late seems to err as a bias does, and one that has been set
        does anywhere: a large change waits for the next one to take it back. An INS that says at rest that it does not
        turn tells nothing.
        """
        state, most, before = self.state, self._largest_bias, self.state.given
        if before is None:
            state.excess = state.excess_time = 0.0
            return
        if given.rate == 0.0 and abs(given.speed) < STANDING_SPEED:
            return
        state.lately += dt / (dt + _SETTLED) * (given.rate - state.lately)
        turns = max(abs(given.rate), abs(before)) >= _STRAIGHT
        state.steady = 0.0 if turns and abs(given.rate - state.lately) >= _STEADY else state.steady + dt
        state.excess += (given.rate + before) / 2 * dt - change
        state.excess_time += dt
        excess, time = state.excess, state.excess_time
        is_steady = state.steady >= _SETTLED and self._time > 0.0
        is_large = abs(excess) >= self._largest_change + most * time
        if is_steady and is_large and time < _SETTLED:
            return
        state.excess = state.excess_time = 0.0
        if not is_steady or is_large:
            return
        state.followed = min(state.followed + time, self._time)
        share = time / (time + max(state.followed, self._earliest))
        state.bias = max(-most, min(state.bias + share * (excess / time - state.bias), most))
        state.speed += share * (abs(given.speed) - state.speed)
