"""What holds of every cycle, whatever the frames were: numbers are numbers, frames as the DBC says, time goes on."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from hashlib import sha256
from math import inf, isfinite
from struct import Struct

import cantools
import numpy as np
from cantools.database.can import Database, Message

from candaemon.arrays import Floats
from candaemon.binding.bound import Binding
from candaemon.dbc.batch_codec import BatchDecoder
from candaemon.dbc.types import MessageSpec
from candaemon.ego.pose import EgoPose
from candaemon.errors import CandaemonError
from candaemon.frames.frame import EXTENDED
from candaemon.pipeline.cycle import Cycle
from candaemon.tracking.obstacles import CLASS_NAMES, COASTING, CONFIRMED, TENTATIVE, Obstacles

_COLUMNS = tuple(field.name for field in fields(Obstacles))
_HEAD = Struct("<qHIB")
"""Of a frame that is sent: its time, bus, CAN id and length."""
_GATHERED = 200
"""Frames of an identifier that are decoded together."""
_NOT_NEGATIVE = ("sx", "sy", "svx", "svy", "age", "existence", "length", "width", "kind_likelihood")
_ROUNDING = 1e-6
"""Of a covariance's greatest element."""
_NAN_WHERE_UNKNOWN = {"heading", "yaw_rate", "length", "width", "kind_likelihood"}


class Watch:
    """Holds what must be true of the cycles of one pipeline.

    Args:
        binding: of the pipeline.
        sampled: of so many cycles, the frames of one are decoded by cantools too.

    Attributes:
        cycles: seen so far.
        most: obstacles in one of them.
        outputs: SHA-256 of all that was sent, to be gone on with.
    """

    def __init__(self, binding: Binding, sampled: int = 1) -> None:
        self.cycles = 0
        self.most = 0
        self.outputs = sha256()
        self._sampled = sampled
        self._limit = _limit(binding)
        self._messages = _messages(binding)
        self._output = output = binding.output
        self._sent = {can_id: _Sent(output.database.by_id[can_id]) for can_id in output.can_ids} if output else {}
        self._time_ns = 0

    def take(self, cycle: Cycle) -> None:
        """Hold one cycle.

        Raises:
            AssertionError: it is not as it must be.
        """
        assert cycle.time_ns >= self._time_ns, f"time went back from {self._time_ns} to {cycle.time_ns}"
        self._time_ns = cycle.time_ns
        hold_obstacles(cycle.obstacles)
        _hold_pose(cycle.pose)
        assert len(cycle.obstacles) <= self._limit, f"{len(cycle.obstacles)} obstacles"
        self._hold_frames(cycle, decoded=self.cycles % self._sampled == 0)
        self.most = max(self.most, len(cycle.obstacles))
        self.cycles += 1

    def finish(self) -> None:
        """Hold the ranges of the frames that are left.

        Raises:
            AssertionError: a signal is beyond its range.
        """
        for sent in self._sent.values():
            sent.hold()

    def _hold_frames(self, cycle: Cycle, *, decoded: bool) -> None:
        """Hold that every frame is one of the output's DBC, and all its signals are numbers."""
        if self._output is None:
            assert not cycle.frames
            return
        for time_ns, bus, can_id, data, fd in cycle.frames:
            message = self._messages[can_id]
            assert (time_ns, bus) == (cycle.time_ns, self._output.bus)
            assert len(data) == message.length, f"{message.name} of {len(data)} bytes"
            assert fd == (can_id in self._output.fd_ids), message.name
            self.outputs.update(_HEAD.pack(time_ns, bus, can_id, len(data)) + data)
            self._sent[can_id].take(data)
            if decoded:
                values = message.decode(data, decode_choices=False)
                assert isinstance(values, dict)
                for name, value in values.items():
                    assert isinstance(value, int | float), f"{message.name}.{name} is {value}"
                    assert isfinite(value), f"{message.name}.{name} is {value}"


class _Sent:
    """Frames of one identifier, whose signals are held to the ranges that the DBC gives.

    Args:
        message: what they are.
    """

    def __init__(self, message: MessageSpec) -> None:
        self._message = message
        self._decoder: BatchDecoder | None = None
        bounds = [_range(signal.minimum, signal.maximum) for signal in message.signals]
        self._least, self._greatest = (np.array([pair[k] for pair in bounds]).reshape(-1, 1) for k in (0, 1))
        self._payloads: list[bytes] = []

    def take(self, data: bytes) -> None:
        """Hold one more frame, together with some others."""
        self._payloads.append(data)
        if len(self._payloads) >= _GATHERED:
            self.hold()

    def hold(self) -> None:
        """Hold what is gathered."""
        if not self._payloads:
            return
        if self._decoder is None:  # to make one takes longer than most inputs
            self._decoder = BatchDecoder(self._message)
        values = self._decoder.decode(b"".join(self._payloads))
        self._payloads = []
        beyond = (values < self._least) | (values > self._greatest) | np.isinf(values)  # a signal not sent is NaN
        assert not beyond.any(), f"{self._message.name}: {values[beyond.any(axis=1)]} is out of range"


def hold_obstacles(obstacles: Obstacles) -> None:
    """Hold that every column is of one length and possible, and finite where it cannot be unknown.

    Raises:
        AssertionError: it is not.
    """
    count = len(obstacles)
    for name in _COLUMNS:
        column = getattr(obstacles, name)
        if isinstance(column, np.ndarray):
            possible = ~np.isinf(column) if name in _NAN_WHERE_UNKNOWN else np.isfinite(column)
            assert possible.all(), f"{name}: {column}"
            shape = (count, 4, 4) if name == "covariance" else (count,)
            assert name.startswith("used_") or column.shape == shape, name
    if count:
        assert len(set(obstacles.id.tolist())) == count, "an id is there twice"
        assert not any((getattr(obstacles, name) < 0).any() for name in _NOT_NEGATIVE)
        assert not any((getattr(obstacles, name) > 1).any() for name in ("existence", "kind_likelihood"))
        assert set(obstacles.state.tolist()) <= {TENTATIVE, CONFIRMED, COASTING}
        assert set(obstacles.kind.tolist()) <= set(range(len(CLASS_NAMES)))
        _hold_covariance(obstacles.covariance)
    if len(obstacles.used_row):
        assert 0 <= obstacles.used_row.min() <= obstacles.used_row.max() < count


def _hold_covariance(covariance: Floats) -> None:
    """Hold that covariances (n, 4, 4) are symmetric and not negative, but for rounding."""
    scale = np.abs(covariance).max(axis=(1, 2), keepdims=True)
    assert (np.abs(covariance - np.swapaxes(covariance, 1, 2)) <= _ROUNDING * scale).all(), "covariances lean"
    least = np.linalg.eigvalsh(covariance)[:, 0]
    assert (least >= -_ROUNDING * scale[:, 0, 0]).all(), f"covariances are negative: {least.min()}"


def hold_place(error: CandaemonError) -> None:
    """Hold that an error says in which file it is, and all that in one line.

    Raises:
        AssertionError: it does not.
    """
    assert error.file is not None, f"it does not say where: {error}"
    hold_printable(str(error))


def hold_printable(text: str) -> None:
    """Hold that lines of text hold nothing that a terminal obeys.

    Raises:
        AssertionError: they do.
    """
    for line in text.split("\n"):
        assert line.isprintable(), ascii(line[:1000])


def _hold_pose(pose: EgoPose) -> None:
    for field in fields(EgoPose):
        assert isfinite(getattr(pose, field.name)), f"own {field.name} is {getattr(pose, field.name)}"


def _range(least: float | None, greatest: float | None) -> tuple[float, float]:
    """Return the range of a signal, with what rounding a raw value adds; without an end where the DBC gives none."""
    if least is None or greatest is None or not least < greatest:
        return -inf, inf
    slack = 1e-9 * max(abs(least), abs(greatest))
    return least - slack, greatest + slack


def _limit(binding: Binding) -> int:
    """Return how many obstacles there may be: those of every group's tracker."""
    config = binding.settings
    grouped = {name for group in config.groups.values() for name in group.sensors}
    ungrouped = any(sensor.name not in grouped for sensor in binding.sensors)
    return sum(group.tracker.max_tracks for group in config.groups.values()) + ungrouped * config.tracker.max_tracks


@cache
def _database(path: str) -> Database:
    loaded = cantools.database.load_file(path, strict=False)
    assert isinstance(loaded, Database)
    return loaded


def _messages(binding: Binding) -> dict[int, Message]:
    """Return what cantools knows of the messages that the output sends, by CAN id."""
    output = binding.output
    if output is None:
        return {}
    known = {
        message.frame_id | (EXTENDED if message.is_extended_frame else 0): message
        for message in _database(str(output.database.path)).messages
    }
    return {can_id: known[can_id] for can_id in output.can_ids}
