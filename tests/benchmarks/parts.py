"""The parts of the chain, and the libraries they take the place of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray

from candaemon import compiled
from candaemon.can_io.logs.candump import read_candump_blocks
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import ChannelMap, LogCounts
from candaemon.config.estimators import CsEstimatorSettings, ImmEstimatorSettings
from candaemon.dbc.batch_codec import BatchDecoder, BatchEncoder
from candaemon.dbc.database import load_database
from candaemon.dbc.single_codec import compile_decoder, compile_encoder
from candaemon.estimation.axis_filter import AxisFilter
from candaemon.estimation.measurement import Measurement
from candaemon.estimation.motion_models import CurrentStatistical
from candaemon.tracking.estimator_factory import make_estimator

from . import naive
from .chains import ROOT, count
from .timing import microseconds

BATCH = 64
STEPS = 1000
"""Of filters of many tracks: a run takes milliseconds, beside which setting them up and cold caches count little, as in
that of filterpy."""
_DT = 0.05
_FRAMES, _BATCHED, _WITH_CANTOOLS = 20_000, 64_000, 3_000
_CHANNELS = {"can1": 0, "can2": 1}


class Codec:
    """All signals of one message, by candaemon and by cantools; each method returns its number of frames."""

    def __init__(self) -> None:
        dbc = ROOT / "dbc/esr.dbc"
        message = load_database(dbc).message("Target1")
        self._payload = bytes.fromhex("2000C51C20812515")
        self._cantools = naive.load_dbc(dbc)
        self._values: dict[str, float] = self._cantools.decode_message("Target1", self._payload, decode_choices=False)
        self._row = list(self._values.values())
        self._decode, self._encode = compile_decoder(message), compile_encoder(message)
        self._decoder, self._encoder = BatchDecoder(message), BatchEncoder(message)
        self._payloads = self._payload * BATCH
        self._table = np.repeat(np.array([self._row]).T, BATCH, axis=1)

    def decode(self) -> int:
        for _ in range(_FRAMES):
            self._decode(self._payload)
        return _FRAMES

    def decode_batch(self) -> int:
        for _ in range(_BATCHED // BATCH):
            self._decoder.decode(self._payloads)
        return _BATCHED

    def decode_with_cantools(self) -> int:
        for _ in range(_WITH_CANTOOLS):
            self._cantools.decode_message("Target1", self._payload, decode_choices=False)
        return _WITH_CANTOOLS

    def encode(self) -> int:
        for _ in range(_FRAMES):
            self._encode(self._row)
        return _FRAMES

    def encode_batch(self) -> int:
        for _ in range(_BATCHED // BATCH):
            self._encoder.encode(self._table)
        return _BATCHED

    def encode_with_cantools(self) -> int:
        for _ in range(_WITH_CANTOOLS):
            self._cantools.encode_message("Target1", self._values)
        return _WITH_CANTOOLS


def read_frames(log: Path) -> int:
    """Read a log frame by frame; return their number, as the others do."""
    return count(read_log(log, _CHANNELS, LogCounts()))


def read_blocks(log: Path) -> int:
    """Read a log as arrays."""
    return sum(len(block) for block in read_candump_blocks(log, ChannelMap(_CHANNELS), LogCounts()))


def read_with_python_can(log: Path) -> int:
    """Read a log with python-can."""
    with can.LogReader(log) as reader:
        return count(iter(reader))


def computed(kernels: bool, work: Callable[[], int]) -> int:
    """Do some work with the compiled kernels, where there are any, or with numpy alone."""
    in_use = compiled.in_use
    compiled.in_use = in_use and kernels
    try:
        return work()
    finally:
        compiled.in_use = in_use


def estimate(settings: CsEstimatorSettings | ImmEstimatorSettings, tracks: int, steps: int) -> int:
    """Predict and update all tracks at once; return the number of steps."""
    estimator = make_estimator(settings)
    position, noise = _scene(tracks)
    estimator.spawn(position, noise, np.zeros((tracks, 2)), np.tile(np.eye(2) * 225.0, (tracks, 1, 1)))
    rows, direction, at_rest = np.arange(tracks), np.tile([1.0, 0.0], (tracks, 1)), np.zeros(2)
    for step in range(steps):
        estimator.predict(_DT, direction)
        estimator.update(rows, Measurement(position + 0.01 * step, noise, at_rest, at_rest))
    return steps


def estimate_with_filterpy(kind: Callable[..., naive.Filter], tracks: int, steps: int) -> int:
    """Predict and update a filter a track; return the number of steps."""
    position, noise = _scene(tracks)
    columns = position[:, :, None]
    filters: list[Any] = [kind(each, r) for each, r in zip(columns, noise, strict=True)]
    for step in range(steps):
        matrices = filters[0].matrices(_DT)
        for each, z, r in zip(filters, columns + 0.01 * step, noise, strict=True):
            each.predict(matrices)
            each.update(z, r)
    return steps


def growth(settings: CsEstimatorSettings | ImmEstimatorSettings, tracks: int) -> float:
    """Return how many times as much as a step of 64 tracks one of so many costs; the median of five."""
    ratios = []
    for _ in range(5):
        few = microseconds(lambda: estimate(settings, BATCH, STEPS))
        ratios.append(microseconds(lambda: estimate(settings, tracks, STEPS)) / few)
    return median(ratios)


class Axes:
    """64 tracks by CS-KF, x and y measured apart, by candaemon and by filterpy; each method returns its steps."""

    _VARIANCE = (0.06, 0.3)

    def __init__(self) -> None:
        self._position, _ = _scene(BATCH)
        self._filter = AxisFilter(CurrentStatistical(naive.ALPHA, naive.LIMIT, naive.FLOOR))
        mean, covariance = np.zeros((2 * BATCH, 3)), np.zeros((2 * BATCH, 3, 3))
        mean[:, 0] = self._position.ravel()
        covariance[:, 0, 0] = np.tile(self._VARIANCE, BATCH)
        covariance[:, 1, 1], covariance[:, 2, 2] = naive.FIRST_SPEED**2, naive.FIRST_ACCELERATION**2
        self._filter.spawn(mean, covariance)
        self._naive = [naive.CurrentStatistical(each[:, None], np.diag(self._VARIANCE)) for each in self._position]

    @property
    def states(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The states of both, (n, 6) of [x, ẋ, ẍ, y, ẏ, ÿ]."""
        return self._filter.mean.reshape(-1, 6), np.array([each.state for each in self._naive])

    def estimate(self, steps: int = STEPS) -> int:
        positions, variance = self._position.ravel(), np.tile(self._VARIANCE, BATCH)
        for step in range(steps):
            self._filter.predict(_DT)
            self._filter.update(positions + 0.01 * step, variance)
        return steps

    def estimate_with_filterpy(self, steps: int = 15) -> int:
        columns, noise = self._position[:, :, None], np.diag(self._VARIANCE)
        for step in range(steps):
            matrices = naive.CurrentStatistical.matrices(_DT)
            for each, z in zip(self._naive, columns + 0.01 * step, strict=True):
                each.predict(matrices)
                each.update(z, noise)
        return steps


def _scene(tracks: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions (n, 2) and their covariances (n, 2, 2)."""
    x, y = np.linspace(20.0, 120.0, tracks), np.linspace(-20.0, 20.0, tracks)
    return np.stack([x, y], axis=1), np.tile([[0.06, 0.02], [0.02, 0.3]], (tracks, 1, 1))
