"""The filters of Gao et al. 2016 on one axis of a vehicle that a lidar and a radar measure, all runs as one batch.

State and measurement are [displacement, velocity, acceleration], m, m/s, m/s²: H of the paper is the unit matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Floats
from candaemon.estimation.adaptive_filter import AdaptiveFilter
from candaemon.estimation.federated import Federated
from candaemon.estimation.innovation_noise import InnovationNoise
from candaemon.estimation.kalman import predict, update
from candaemon.estimation.measurement import Measurement, Projection
from candaemon.estimation.noise_estimator import NoiseEstimator
from candaemon.estimation.variational_noise import VariationalNoise
from candaemon.papers.baselines import linear
from candaemon.papers.experiment import Advance
from candaemon.papers.tracking import default_estimator

DT = 0.01
"""s, Δt: 100 Hz."""
NOMINAL = (0.03, 0.1)
"""R of lidar and radar as the filters assume it, of each component, in its own unit squared."""
SENSORS = ("lidar", "radar")
QUANTITIES = (("displacement", "m", "m²"), ("velocity", "m/s", "(m/s)²"), ("acceleration", "m/s²", "(m/s²)²"))
"""The components, their units, and those of their variances."""
METHODS = (
    "CKF lidar",
    "IAKF lidar",
    "CKF radar",
    "IAKF radar",
    "JAKF",
    "JAKF, variational R",
    "JAKF, wider Q",
    "JAKF, variational R, wider Q",
)
"""The last two only where the vehicle manoeuvres."""
STEADY = 1e-6 * np.eye(3)
"""Q of the paper: next to none."""

_TRANSITION = np.array(((1.0, DT, DT * DT / 2), (0.0, 1.0, DT), (0.0, 0.0, 1.0)))
_UNIT = np.eye(3)
_AT_REST = np.zeros(2)


@dataclass(frozen=True, slots=True)
class SensorRecording:
    """What the sensors measured; lidar first.

    Attributes:
        truth: (steps, runs or 1, 3).
        measured: (2, steps, runs, 3).
        across: position and velocity on the other axis, where the vehicle does not move, (2, steps, runs, 2): the
            daemon's filter is one of the plane.
        variance: true variance of the noise, the same for all components, (2, steps).
        start: state that the filters begin with, (3,); its covariance P₀ is the unit matrix.
        process: Q that suits a motion whose acceleration varies, (3, 3); None: it is constant.
    """

    truth: Floats
    measured: Floats
    across: Floats
    variance: Floats
    start: Floats
    process: Floats | None


def record(
    truth: Floats,
    variance: Floats,
    start: Floats,
    runs: int,
    random: np.random.Generator,
    process: Floats | None = None,
) -> SensorRecording:
    """Draw the noise of runs; see `SensorRecording` for the arrays."""
    steps = len(truth)
    deviation = np.sqrt(variance)[:, :, None, None]
    noise = deviation * random.standard_normal((2, steps, runs, 5))
    return SensorRecording(truth, truth + noise[..., :3], noise[..., 3:], variance, start, process)


@dataclass(frozen=True, slots=True)
class Adaptation:
    """What a joint filter made of the first run: β and R over time.

    Attributes:
        share: β of lidar and radar (steps, 2).
        variance: R̂ of the components (steps, 2, 3).
    """

    share: Floats
    variance: Floats


@dataclass(frozen=True, slots=True)
class Outcome:
    """Estimates (steps, runs, 3) of a recording.

    Attributes:
        methods: of each method of the table.
        default: of the daemon's default estimator.
        bound: of a centralised filter that knows the true start and R of each instant. Where the acceleration is
            constant its Q is zero; else it is the one that suits, and this a reference, no strict bound.
        adaptation: of the joint filter of the paper.
    """

    methods: dict[str, Floats]
    default: Floats
    bound: Floats
    adaptation: Adaptation


def filtered(recording: SensorRecording, advance: Advance) -> Outcome:
    """Run all methods; `advance` is called with the shares of the whole as they are done."""
    estimates: list[Floats] = []
    for sensor in range(len(SENSORS)):
        estimates += [conventional(recording, sensor), adaptive(recording, sensor)]
        advance(0.15)
    nominal = [np.full(3, variance) for variance in NOMINAL]
    adaptations = []
    processes = (STEADY,) if recording.process is None else (STEADY, recording.process)
    for process in processes:
        for kind in (InnovationNoise, VariationalNoise):
            fused, adaptation = joint(recording, [kind(variance) for variance in nominal], process)
            estimates.append(fused)
            adaptations.append(adaptation)
            advance(0.25 / len(processes))
    methods = dict(zip(METHODS, estimates, strict=False))  # where the printed Q suits, the last two were not run
    outcome = Outcome(methods, default(recording), bound(recording), adaptations[0])
    advance(0.2)
    return outcome


def conventional(recording: SensorRecording, sensor: int) -> Floats:
    """Return what the conventional Kalman filter (CKF) makes of one sensor, its R the nominal one.

    Source: Gao et al. 2016, eqs. (1), (2), (3).
    """
    noise, measured = NOMINAL[sensor] * _UNIT, recording.measured[sensor]
    return linear(_TRANSITION, STEADY, _UNIT, noise, recording.start, _UNIT, measured)


def adaptive(recording: SensorRecording, sensor: int) -> Floats:
    """Return what the innovation-based adaptive filter (IAKF) makes of one sensor."""
    measured = recording.measured[sensor]
    tracks = AdaptiveFilter(InnovationNoise(np.full(3, NOMINAL[sensor])))
    tracks.spawn(*_start(recording))
    rows, estimates = np.arange(measured.shape[1]), np.empty(measured.shape)
    for k, seen in enumerate(measured):
        tracks.predict(_TRANSITION, STEADY)
        tracks.update(rows, seen, _UNIT)
        estimates[k] = tracks.mean
    return estimates


def joint(
    recording: SensorRecording, estimators: Sequence[NoiseEstimator], process: Floats
) -> tuple[Floats, Adaptation]:
    """Return what the joint filter (JAKF) makes of both sensors, each with its own estimator of R, and of a Q."""
    sensors, steps, runs, _ = recording.measured.shape
    tracks = Federated(sensors)
    tracks.spawn(*_start(recording))
    for estimator in estimators:
        estimator.spawn(runs)
    rows, estimates = np.arange(runs), np.empty((steps, runs, 3))
    adaptation = Adaptation(np.empty((steps, sensors)), np.empty((steps, sensors, 3)))
    variance = np.empty((runs, sensors, 3))
    for k in range(steps):
        tracks.predict(_TRANSITION, process)
        for sensor, estimator in enumerate(estimators):
            expected, spread = tracks.expected(sensor, rows, _UNIT)
            adapted = estimator.observe(rows, recording.measured[sensor, k] - expected, spread)
            tracks.update(sensor, rows, adapted.innovation, _UNIT, adapted.noise)
            variance[:, sensor] = np.diagonal(adapted.noise, axis1=1, axis2=2)
        estimates[k], _ = tracks.fuse(variance.sum(axis=2))
        adaptation.share[k], adaptation.variance[k] = tracks.share[0], variance[0]
    return estimates, adaptation


def bound(recording: SensorRecording) -> Floats:
    """Return what one filter makes of both sensors that knows the true start, R of each instant, and Q."""
    sensors, steps, runs, _ = recording.measured.shape
    process = np.zeros((3, 3)) if recording.process is None else recording.process
    first = np.linalg.solve(_TRANSITION, recording.truth[0].T).T  # `start` is wrong in most of a sweep
    mean, covariance = np.tile(first, (runs // len(first), 1)), _UNIT[None].copy()
    estimates = np.empty((steps, runs, 3))
    for k in range(steps):
        predict(mean, covariance, _TRANSITION, process)
        for sensor in range(sensors):
            noise = recording.variance[sensor, k] * _UNIT
            update(mean, covariance, recording.measured[sensor, k] - mean, _UNIT, noise)
        estimates[k] = mean
    return estimates


def default(recording: SensorRecording) -> Floats:
    """Return what the daemon's filter makes of position and velocity of both sensors, their noise the nominal one."""
    sensors, steps, runs, _ = recording.measured.shape
    imm, rows, ahead = default_estimator(), np.arange(runs), np.tile([1.0, 0.0], (runs, 1))
    place, speed = (np.tile([value, 0.0], (runs, 1)) for value in recording.start[:2])
    spread = np.tile(np.eye(2), (runs, 1, 1))
    imm.spawn(place, spread, speed, spread)
    estimates = np.empty((steps, runs, 3))
    for k in range(steps):
        imm.predict(DT, ahead)
        for sensor in range(sensors):
            imm.update(rows, _in_the_plane(recording, sensor, k))
        estimates[k] = imm.combined()[0][:, ::2]
    return estimates


def _in_the_plane(recording: SensorRecording, sensor: int, k: int) -> Measurement:
    """Return position and velocity of one instant as the daemon's filter takes them; the studied axis is x."""
    measured, across = recording.measured[sensor, k], recording.across[sensor, k]
    runs, variance = len(measured), NOMINAL[sensor]
    velocity = tuple(
        Projection(np.tile(direction, (runs, 1)), value, np.full(runs, variance))
        for direction, value in zip(np.eye(2), (measured[:, 1], across[:, 1]), strict=True)
    )
    position = np.stack([measured[:, 0], across[:, 0]], axis=-1)
    noise = np.tile(variance * np.eye(2), (runs, 1, 1))
    return Measurement(position, noise, _AT_REST, _AT_REST, projections=velocity, sensor=sensor)


def _start(recording: SensorRecording) -> tuple[Floats, Floats]:
    """Return the state that all runs begin with and its covariance, (runs, 3) and (runs, 3, 3)."""
    runs = recording.measured.shape[2]
    return np.tile(recording.start, (runs, 1)), np.tile(_UNIT, (runs, 1, 1))
