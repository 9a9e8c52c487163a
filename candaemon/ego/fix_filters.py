"""Filters of a GNSS track: where the vehicle is, from fixes of its position in a plane."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from candaemon.arrays import Floats
from candaemon.config.gnss import DriftFilterSettings, FixFilterSettings, ImmFilterSettings, SwitchingFilterSettings
from candaemon.estimation.cv_csm_switch import CvCsmSwitch
from candaemon.estimation.imm import Imm
from candaemon.estimation.manoeuvre import SwitchRule
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.motion_models import CurrentStatistical, LinearModel

_AT_REST: Floats = np.zeros(2)
_NOWHERE: tuple[Floats, Floats] = np.full(2, np.nan), np.full((2, 2), np.nan)
_ONLY_TRACK = np.zeros(1, dtype=np.intp)


class FixFilter(Protocol):
    """An estimate of the vehicle's position in a plane, axes east and north, m."""

    @property
    def position(self) -> Floats:
        """The estimate, (2,), m."""
        ...

    @property
    def covariance(self) -> Floats:
        """Its covariance, (2, 2), m²."""
        ...

    def start(self, position: Floats, covariance: Floats, velocity: Floats, speed_variance: float) -> None:
        """Begin anew.

        Args:
            position: (2,), m.
            covariance: its covariance, (2, 2), m².
            velocity: over ground (2,), m/s.
            speed_variance: of each of its components, (m/s)².
        """
        ...

    def predict(self, dt: float, placed: Floats, unseen: float) -> None:
        """Predict to the instant of the next fix.

        Args:
            dt: s since the fix before.
            placed: where the level frame, as it is placed so far, puts the vehicle, (2,), m.
            unseen: s of dt in which the level frame was reckoned on without samples.
        """
        ...

    def update(self, fix: Floats) -> None:
        """Take a fix, (2,), m."""
        ...


def make_filter(settings: FixFilterSettings, noise: float) -> FixFilter:
    """Return the filter that the configuration names; noise is a fix's standard deviation, m."""
    match settings:
        case DriftFilterSettings():
            return DriftFilter(settings, noise)
        case SwitchingFilterSettings():
            return SwitchingFilter(settings, noise)
        case ImmFilterSettings():
            return ImmFilter(settings, noise)


class DriftFilter:
    """A Kalman filter of the difference between fix and level frame, which wanders slowly; both axes alike.

    Between fixes the vehicle goes where the level frame says; so smooth as that is, so smooth is the estimate.

    Args:
        settings: how far the difference wanders.
        noise: standard deviation of a fix, each axis, m.
    """

    def __init__(self, settings: DriftFilterSettings, noise: float) -> None:
        self._walk, self._noise = settings.walk**2, noise**2
        self._unseen_acceleration = settings.unseen_acceleration
        self._variance = 0.0
        self.position: Floats = np.zeros(2)

    @property
    def covariance(self) -> Floats:
        """See `FixFilter.covariance`."""
        return self._variance * np.eye(2)

    def start(self, position: Floats, covariance: Floats, velocity: Floats, speed_variance: float) -> None:
        """See `FixFilter.start`; the velocity is the level frame's own."""
        del velocity, speed_variance
        self.position, self._variance = position, float(covariance[0, 0])

    def predict(self, dt: float, placed: Floats, unseen: float) -> None:
        """See `FixFilter.predict`; unseen, the vehicle may have braked or turned."""
        self.position = placed
        self._variance += self._walk * dt + (self._unseen_acceleration * unseen**2 / 2) ** 2

    def update(self, fix: Floats) -> None:
        """See `FixFilter.update`."""
        gain = self._variance / (self._variance + self._noise)
        self.position = self.position + gain * (fix - self.position)
        self._variance *= 1.0 - gain


class SwitchingFilter:
    """Constant velocity or the current statistical model on the track of fixes, switched as paper 003 does.

    It knows nothing of the level frame: for an INS whose velocity is poor.

    Args:
        settings: of the two models and of the switch.
        noise: standard deviation of a fix, each axis, m.
    """

    def __init__(self, settings: SwitchingFilterSettings, noise: float) -> None:
        rule = SwitchRule(
            threshold=settings.threshold,
            least_change=settings.least_change,
            manoeuvre_time=settings.manoeuvre_time,
            steady_time=settings.steady_time,
            interval=settings.interval,
        )
        statistical = CurrentStatistical(settings.alpha, settings.limit, settings.floor)
        self._switch = CvCsmSwitch(2, settings.noise, statistical, rule)
        self._acceleration, self._noise = settings.first_acceleration**2, noise**2
        self.position, self.covariance = _NOWHERE

    def start(self, position: Floats, covariance: Floats, velocity: Floats, speed_variance: float) -> None:
        """See `FixFilter.start`."""
        mean = np.stack([position, velocity, np.zeros(2)], axis=-1)
        variances = np.stack([np.diag(covariance), np.full(2, speed_variance), np.full(2, self._acceleration)], axis=-1)
        self._switch.keep(_ONLY_TRACK[:0])
        self._switch.spawn(mean[None], (variances[..., None] * np.eye(3))[None])
        self._tell()

    def predict(self, dt: float, placed: Floats, unseen: float) -> None:
        """See `FixFilter.predict`."""
        del placed, unseen
        self._switch.predict(dt)
        self._tell()

    def update(self, fix: Floats) -> None:
        """See `FixFilter.update`."""
        self._switch.update(fix[None], self._noise)
        self._tell()

    def _tell(self) -> None:
        self.position = self._switch.mean[0, :, 0]
        self.covariance = np.diag(self._switch.covariance[0, :, 0, 0])


class ImmFilter:
    """An interacting multiple model filter of the track of fixes, constant velocity and constant acceleration.

    It knows nothing of the level frame: for an INS whose velocity is poor.

    Args:
        settings: noise of the two models, and how readily the vehicle changes between them.
        noise: standard deviation of a fix, each axis, m.
    """

    def __init__(self, settings: ImmFilterSettings, noise: float) -> None:
        steady, manoeuvre = settings.steady_noise, settings.manoeuvre_noise
        models = (LinearModel(1, (steady, steady)), LinearModel(2, (manoeuvre, manoeuvre)))
        self._imm = Imm(models, switch_rate=settings.switch_rate, acceleration=settings.first_acceleration)
        self._noise: Floats = noise**2 * np.eye(2)[None]
        self.position, self.covariance = _NOWHERE

    def start(self, position: Floats, covariance: Floats, velocity: Floats, speed_variance: float) -> None:
        """See `FixFilter.start`."""
        self._imm.keep(_ONLY_TRACK[:0])
        self._imm.spawn(position[None], covariance[None], velocity[None], speed_variance * np.eye(2)[None])
        self._tell()

    def predict(self, dt: float, placed: Floats, unseen: float) -> None:
        """See `FixFilter.predict`."""
        del placed, unseen
        self._imm.predict(dt, _AT_REST[None])
        self._tell()

    def update(self, fix: Floats) -> None:
        """See `FixFilter.update`."""
        self._imm.update(_ONLY_TRACK, Measurement(fix[None], self._noise, _AT_REST, _AT_REST))
        self._tell()

    def _tell(self) -> None:
        mean, covariance = self._imm.combined()
        self.position, self.covariance = mean[0, :2], covariance[0, :2, :2]
