"""What the sensors of ego motion read wrongly: the speed's factor, the yaw rate's bias, the wheels' mismatch.

Three numbers are estimated by a Kalman filter: k with speed = k × wheel speed, the bias b of the yaw rate sensor, and
the bias m of the yaw rate that the wheels' difference gives. The wheels see m − b, a stationary return sees k by its
range rate and b by its apparent drift across.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians

from candaemon.config.ego import BiasSettings
from candaemon.ego.motion import StationaryReturns

_SCALE, _BIAS, _MISMATCH = 0, 1, 2


@dataclass(slots=True)
class MotionBiasState:
    """Estimate of [speed factor, yaw rate bias (rad/s), wheel mismatch (rad/s)].

    Three numbers are too few for arrays, which take four times as long.

    Attributes:
        mean: of each.
        covariance: its rows.
    """

    mean: list[float]
    covariance: list[list[float]]


class MotionBias:
    """Estimates the three numbers.

    Args:
        settings: initial standard deviations and noise.
        yaw_rate_noise: standard deviation of what the yaw rate sensor reads, rad/s.

    Attributes:
        state: the estimate.
    """

    def __init__(self, settings: BiasSettings, yaw_rate_noise: float = radians(0.3)) -> None:
        self._settings = settings
        deviations = (
            settings.speed_scale_sd,
            radians(settings.yaw_rate_bias_sd_deg),
            radians(settings.wheel_mismatch_deg),
        )
        scale, bias, mismatch = (deviation**2 for deviation in deviations)
        self.state = MotionBiasState([1.0, 0.0, 0.0], [[scale, 0.0, 0.0], [0.0, bias, 0.0], [0.0, 0.0, mismatch]])
        self._learnt = settings.learnt**2 * scale, settings.learnt**2 * bias
        self._drift = radians(settings.yaw_rate_drift_deg) ** 2
        self._wheel_variance = radians(settings.wheel_noise_deg) ** 2
        self._rest_variance = settings.shared_returns * yaw_rate_noise**2
        self._return_variance = settings.shared_returns * settings.stationary_noise**2

    @property
    def scale(self) -> float:
        """Speed over ground divided by wheel speed."""
        return self.state.mean[_SCALE]

    @property
    def yaw_rate(self) -> float:
        """Bias of the yaw rate sensor, rad/s."""
        return self.state.mean[_BIAS]

    @property
    def mismatch(self) -> float:
        """Bias of the yaw rate that the wheels' difference gives, rad/s."""
        return self.state.mean[_MISMATCH]

    @property
    def learnt(self) -> bool:
        """Whether the speed factor and the yaw rate bias are known well enough."""
        covariance, (scale, bias) = self.state.covariance, self._learnt
        return covariance[_SCALE][_SCALE] <= scale and covariance[_BIAS][_BIAS] <= bias

    def age(self, dt: float) -> None:
        """Let the yaw rate's bias drift for a time, s."""
        of_bias = self.state.covariance[_BIAS]
        if of_bias[_BIAS] > 0.0:
            of_bias[_BIAS] += self._drift * dt

    def learn_from_wheels(self, difference: float) -> None:
        """Learn from one difference of yaw rates, wheels minus sensor, rad/s."""
        self._update((0.0, -1.0, 1.0), difference, self._wheel_variance)

    def learn_at_rest(self, yaw_rate: float) -> None:
        """Learn from what the yaw rate sensor reads while the vehicle stands, rad/s."""
        self._update((0.0, 1.0, 0.0), yaw_rate, self._rest_variance)

    def learn_from_returns(self, returns: StationaryReturns, wheel_speed: float, *, by_wheels: bool = False) -> None:
        """Learn from what stands still: the speed over ground that it implies, and its drift to the side.

        Args:
            returns: what stands still.
            wheel_speed: m/s.
            by_wheels: whether the yaw rate is that of the wheels' difference, and the sensor is silent.
        """
        for speed, cosine in returns.speeds:
            self._update((wheel_speed * cosine, 0.0, 0.0), speed, self._return_variance)
        row = (0.0, 0.0, 1.0) if by_wheels else (0.0, 1.0, 0.0)
        for moved, swept in returns.drifts:
            variance = 2 * (self._settings.drift_noise / swept) ** 2
            self._update(row, (self.mismatch if by_wheels else self.yaw_rate) + moved / swept, variance)

    def set_scale(self, scale: float, deviation: float) -> None:
        """Set the speed's factor, and how well it is known."""
        self._set(_SCALE, scale, deviation)

    def set_yaw_rate(self, yaw_rate: float, deviation: float) -> None:
        """Set the yaw rate's bias, rad/s, and how well it is known."""
        self._set(_BIAS, yaw_rate, deviation)

    def _set(self, index: int, value: float, deviation: float) -> None:
        state = self.state
        state.mean[index] = value
        state.covariance[index] = [0.0, 0.0, 0.0]
        for row in state.covariance:
            row[index] = 0.0
        state.covariance[index][index] = deviation**2

    def _update(self, row: tuple[float, float, float], value: float, variance: float) -> None:
        """Update with one scalar measurement: value = row · state + noise."""
        state = self.state
        x, y, z = state.mean
        first, second, third = state.covariance
        u, v, w = cross = _product(first, row), _product(second, row), _product(third, row)
        spread = _product(cross, row) + variance
        rest = value - _product(state.mean, row)
        f, g, h = u / spread, v / spread, w / spread
        state.mean = [x + f * rest, y + g * rest, z + h * rest]
        state.covariance = [
            [first[0] - f * u, first[1] - f * v, first[2] - f * w],
            [second[0] - g * u, second[1] - g * v, second[2] - g * w],
            [third[0] - h * u, third[1] - h * v, third[2] - h * w],
        ]


def _product(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
