"""Filters of a GNSS track: where the vehicle is, from fixes of its position in a plane."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias

import numpy as np

from candaemon.arrays import Floats
from candaemon.config.gnss import DriftFilterSettings, FixFilterSettings, ImmFilterSettings, SwitchingFilterSettings
from candaemon.estimation.estimator_state import EstimatorState
from candaemon.estimation.imm import Imm
from candaemon.estimation.manoeuvre_detection import SwitchRule
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.motion_models import CurrentStatistical, LinearModel
from candaemon.estimation.switching import CvCsmSwitch, CvCsmSwitchState

_AT_REST: Floats = np.zeros(2)
_ONLY_TRACK = np.zeros(1, dtype=np.intp)


class FixFilter(Protocol):
    """An estimate of the vehicle's position in a plane, axes east and north, m.

    Attributes:
        state: what it remembers: each filter has a dataclass of its own.
    """

    state: Any

    @property
    def started(self) -> bool:
        """Whether there is an estimate."""
        ...

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
            placed: where the local frame, as it is georeferenced so far, puts the vehicle, (2,), m.
            unseen: s of dt in which the local frame was extrapolated without samples.
        """
        ...

    def update(self, fix: Floats) -> None:
        """Take a fix, (2,), m."""
        ...


@dataclass(slots=True)
class DriftFilterState:
    """Estimate of a drift filter.

    Attributes:
        position: (2,), m.
        variance: of each axis, m².
    """

    position: Floats = field(default_factory=lambda: np.zeros(2))
    variance: float = 0.0

    def validate(self) -> None:
        """Refuse a variance that is none.

        Raises:
            ValueError: it is negative.
        """
        if self.variance < 0.0:
            raise ValueError("a negative variance")


class DriftFilter:
    """A Kalman filter of the difference between fix and local frame, a slow random walk; both axes alike.

    Between fixes the vehicle goes where the local frame says; so smooth as that is, so smooth is the estimate.

    Args:
        settings: of the random walk.
        noise: standard deviation of a fix, each axis, m.

    Attributes:
        state: the estimate.
    """

    def __init__(self, settings: DriftFilterSettings, noise: float) -> None:
        self._walk, self._noise = settings.walk**2, noise**2
        self._unseen_acceleration = settings.unseen_acceleration
        self.state = DriftFilterState()

    @property
    def started(self) -> bool:
        """See `FixFilter.started`; without a fix it is sure of the origin."""
        return True

    @property
    def position(self) -> Floats:
        """See `FixFilter.position`."""
        return self.state.position

    @property
    def covariance(self) -> Floats:
        """See `FixFilter.covariance`."""
        return self.state.variance * np.eye(2)

    def start(self, position: Floats, covariance: Floats, velocity: Floats, speed_variance: float) -> None:
        """See `FixFilter.start`; the velocity is the local frame's own."""
        del velocity, speed_variance
        self.state.position, self.state.variance = position, float(covariance[0, 0])

    def predict(self, dt: float, placed: Floats, unseen: float) -> None:
        """See `FixFilter.predict`; unseen, the vehicle may have braked or turned."""
        state = self.state
        state.position = placed
        state.variance += self._walk * dt + (self._unseen_acceleration * unseen**2 / 2) ** 2

    def update(self, fix: Floats) -> None:
        """See `FixFilter.update`."""
        # Both axes are alike, so that one variance is the whole covariance: 4 µs, `kalman.update` 430 µs.
        state = self.state
        gain = state.variance / (state.variance + self._noise)
        state.position = state.position + gain * (fix - state.position)
        state.variance *= 1.0 - gain


class SwitchingFilter:
    """Constant velocity or the current statistical model on the track of fixes, switched as Zhang et al. 2016 does.

    It knows nothing of the local frame: for an INS whose velocity is poor.

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

    @property
    def state(self) -> CvCsmSwitchState:
        """What it remembers.

        Raises:
            ValueError: a state that is set is of several tracks.
        """
        return self._switch.state

    @state.setter
    def state(self, state: CvCsmSwitchState) -> None:
        self._switch.state = state
        if len(self._switch) > 1:
            raise ValueError(f"{len(self._switch)} tracks of fixes, expected one")

    @property
    def started(self) -> bool:
        """See `FixFilter.started`."""
        return len(self._switch) == 1

    @property
    def position(self) -> Floats:
        """See `FixFilter.position`."""
        position: Floats = self._switch.mean[0, :, 0]
        return position

    @property
    def covariance(self) -> Floats:
        """See `FixFilter.covariance`."""
        return np.diag(self._switch.covariance[0, :, 0, 0])

    def start(self, position: Floats, covariance: Floats, velocity: Floats, speed_variance: float) -> None:
        """See `FixFilter.start`."""
        mean = np.stack([position, velocity, np.zeros(2)], axis=-1)
        variances = np.stack([np.diag(covariance), np.full(2, speed_variance), np.full(2, self._acceleration)], axis=-1)
        self._switch.keep(_ONLY_TRACK[:0])
        self._switch.spawn(mean[None], (variances[..., None] * np.eye(3))[None])

    def predict(self, dt: float, placed: Floats, unseen: float) -> None:
        """See `FixFilter.predict`."""
        del placed, unseen
        self._switch.predict(dt)

    def update(self, fix: Floats) -> None:
        """See `FixFilter.update`."""
        self._switch.update(fix[None], self._noise)


class ImmFilter:
    """An interacting multiple model filter of the track of fixes, constant velocity and constant acceleration.

    It knows nothing of the local frame: for an INS whose velocity is poor.

    Args:
        settings: noise of the two models, and how readily the vehicle changes between them.
        noise: standard deviation of a fix, each axis, m.
    """

    def __init__(self, settings: ImmFilterSettings, noise: float) -> None:
        steady, manoeuvre = settings.steady_noise, settings.manoeuvre_noise
        models = (LinearModel(1, (steady, steady)), LinearModel(2, (manoeuvre, manoeuvre)))
        self._imm = Imm(models, switch_rate=settings.switch_rate, acceleration=settings.first_acceleration)
        self._noise: Floats = noise**2 * np.eye(2)[None]

    @property
    def state(self) -> EstimatorState:
        """What it remembers.

        Raises:
            ValueError: a state that is set is of several tracks.
        """
        return self._imm.state

    @state.setter
    def state(self, state: EstimatorState) -> None:
        self._imm.state = state
        if len(self._imm) > 1:
            raise ValueError(f"{len(self._imm)} tracks of fixes, expected one")

    @property
    def started(self) -> bool:
        """See `FixFilter.started`."""
        return len(self._imm) == 1

    @property
    def position(self) -> Floats:
        """See `FixFilter.position`."""
        return self._imm.combined()[0][0, :2]

    @property
    def covariance(self) -> Floats:
        """See `FixFilter.covariance`."""
        return self._imm.combined()[1][0, :2, :2]

    def start(self, position: Floats, covariance: Floats, velocity: Floats, speed_variance: float) -> None:
        """See `FixFilter.start`."""
        self._imm.keep(_ONLY_TRACK[:0])
        self._imm.spawn(position[None], covariance[None], velocity[None], speed_variance * np.eye(2)[None])

    def predict(self, dt: float, placed: Floats, unseen: float) -> None:
        """See `FixFilter.predict`."""
        del placed, unseen
        self._imm.predict(dt, _AT_REST[None])

    def update(self, fix: Floats) -> None:
        """See `FixFilter.update`."""
        self._imm.update(_ONLY_TRACK, Measurement(fix[None], self._noise, _AT_REST, _AT_REST))


FixFilterState: TypeAlias = DriftFilterState | CvCsmSwitchState | EstimatorState


def make_filter(settings: FixFilterSettings, noise: float) -> FixFilter:
    """Return the filter that the configuration names; noise is a fix's standard deviation, m."""
    match settings:
        case DriftFilterSettings():
            return DriftFilter(settings, noise)
        case SwitchingFilterSettings():
            return SwitchingFilter(settings, noise)
        case ImmFilterSettings():
            return ImmFilter(settings, noise)
