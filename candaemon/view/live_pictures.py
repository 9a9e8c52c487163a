"""Pictures of live buses: listens like any node, sends nothing.

The frames of the sensors go through a pipeline of this process, which gives detections, the own vehicle's motion and
how the detections fit. Where obstacles come over the output's bus, those are drawn; what the wire does not carry (NIS,
innovations, probabilities of the models) is taken of the obstacle that this process tracks at the same place. Where
none come, the obstacles tracked here are drawn.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from threading import Event
from typing import Any, Final

import numpy as np

from candaemon.binding.bound import Binding, BoundOutput
from candaemon.can_io.live_buses import LiveBuses
from candaemon.can_io.reorder import ReorderBuffer
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.errors import ConfigError
from candaemon.frames.frame import Frame, Tick
from candaemon.output.decoder import DecodedCycle, OutputDecoder
from candaemon.pipeline.pipeline import Pipeline
from candaemon.view.painter import Painter
from candaemon.view.picture import COLUMNS, Column, Picture

WAIT_S: Final = 0.01
"""s of silence after which the obstacles of a cycle have all come."""
SILENT_NS: Final = 1_000_000_000
"""ns without obstacles on the output's bus after which those tracked here are drawn."""

_ALIKE: Final = 1.0
"""Sum of the differences in place (m) and velocity (m/s) up to which two obstacles are the same one."""
_NOT_ON_THE_WIRE: Final = ("sxy", "nis", "innovation_x", "innovation_y")
_SAME_SCAN_NS: Final = 500_000_000


class LiveListener:
    """Listens to the buses of a configuration.

    Args:
        binding: the configuration, bound to its DBC files.
        clock: gives ns since 1970.

    Attributes:
        buses: with what they lost.

    Raises:
        ConfigError: all buses are virtual: those are in one process alone.
    """

    def __init__(self, binding: Binding, clock: Callable[[], int] = time.time_ns) -> None:
        if all(bus.settings.interface == "virtual" for bus in binding.buses):
            raise ConfigError(
                "its buses are virtual, which no other process can hear; name a log to look at, or see "
                "`candaemon demo --view`",
                file=binding.loaded.path,
            )
        self._binding, self._clock = binding, clock
        wanted = {bus.name: set(bus.can_ids) for bus in binding.buses}
        if binding.output is not None:
            wanted[binding.buses[binding.output.bus].name] |= binding.output.can_ids
        rates = {bus.name: bus.rate for bus in binding.buses}
        self.buses = LiveBuses(binding.settings.buses, clock=clock, ids=wanted, rates=rates)

    def pictures(self, stopping: Event) -> Iterator[Picture]:
        """Yield pictures as they come about, until it is to stop; buses that are not there are tried again."""
        mixer = Mixer(self._binding)
        with self.buses as buses:
            buses.open(strict=False)
            while not stopping.is_set():
                now_ns = self._clock()
                frames = buses.read(WAIT_S)
                for picture in mixer.heard(frames) if frames else mixer.silence(now_ns):
                    yield self._counted(picture)

    def _counted(self, picture: Picture) -> Picture:
        """Return a picture that says, where it tells of health, how many frames this process has not heard."""
        if not picture.health:
            return picture
        return replace(picture, health={**picture.health, "unheard": sum(bus.counts.lost for bus in self.buses)})


class Mixer:
    """Makes pictures of the frames of sensors and of the output, as they are heard.

    Args:
        binding: the configuration, bound to its DBC files.
    """

    def __init__(self, binding: Binding) -> None:
        pipeline = Pipeline(binding)
        self._pipeline, self._painter = pipeline, Painter(pipeline)
        step_ns = round(binding.settings.service.clock_step * 1e9)
        self._sequence = ReorderBuffer(round(binding.settings.ordering_window * 1e9), max_gap_ns=step_ns)
        output = binding.output
        self._output = _HeardObstacles(output) if output is not None and _readable(output) else None
        self._waiting: Picture | None = None
        self._heard_ns: int | None = None

    def heard(self, frames: list[Frame]) -> Iterator[Picture]:
        """Yield the pictures that frames lead to."""
        for frame in frames:
            if self._output is not None and self._output.takes(frame):
                yield from self._drawn(self._output.push(frame), frame.time_ns)
            else:
                yield from self._tracked(self._sequence.push(frame))

    def silence(self, now_ns: int) -> Iterator[Picture]:
        """Yield the pictures that no frame leads to: what is open is complete, and sensors may be silent."""
        if self._output is not None:
            yield from self._drawn(self._output.flush(), now_ns)
        yield from self._tracked(self._sequence.push(Tick(now_ns)))

    def _tracked(self, items: list[Frame | Tick]) -> Iterator[Picture]:
        """Yield the pictures of what this process tracks, unless obstacles come over the bus."""
        for cycle in self._pipeline.run(items):
            picture = self._painter.paint(cycle)
            waiting = self._waiting
            if waiting is not None:
                picture = replace(
                    picture, scans=(*waiting.scans, *picture.scans), health=picture.health or waiting.health
                )
            if self._heard_ns is not None and cycle.time_ns - self._heard_ns < SILENT_NS:
                self._waiting = replace(picture, scans=picture.scans[-_MOST_SCANS:])
            else:
                self._waiting = None
                yield picture

    def _drawn(self, cycles: Iterator[DecodedCycle], now_ns: int) -> Iterator[Picture]:
        """Yield the pictures of obstacles that came over the bus."""
        for cycle in cycles:
            self._heard_ns = now_ns
            yield self._mixed(wire_columns(cycle), now_ns)
            if self._waiting is not None:
                self._waiting = replace(self._waiting, scans=(), health={})

    def _mixed(self, columns: dict[str, Column], now_ns: int) -> Picture:
        """Return obstacles of the bus with what is known here besides."""
        tracked = self._waiting
        if tracked is None or abs(tracked.time_ns - now_ns) > _SAME_SCAN_NS:
            pose = EgoPose(now_ns, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, EgoStatus.LOST)
            return Picture(now_ns, pose, columns, np.empty((len(columns["id"]), 0)), heard=True)
        rows, known = counterparts(columns, tracked.columns)
        for name in _NOT_ON_THE_WIRE:
            values = np.full(len(rows), np.nan)
            values[known] = tracked.columns[name][rows[known]]
            columns[name] = values
        modes = np.full((len(rows), tracked.modes.shape[1]), np.nan)
        modes[known] = tracked.modes[rows[known]]
        return replace(tracked, columns=columns, modes=modes, heard=True)


_MOST_SCANS: Final = 32


class _HeardObstacles:
    """Assembles the output's frames into cycles, each told once: when silence follows it, or the next begins."""

    def __init__(self, output: BoundOutput) -> None:
        assert output.status is not None  # noqa: S101 - checked by `_readable`
        self._bus, self._ids = output.bus, output.can_ids
        self._status_id = output.status.message.can_id
        self._decoder = OutputDecoder(output)
        self._open = False

    def takes(self, frame: Frame) -> bool:
        """Return whether a frame is one of the output."""
        return frame.bus == self._bus and frame.can_id in self._ids

    def push(self, frame: Frame) -> Iterator[DecodedCycle]:
        """Yield the cycle that a frame completes."""
        was_open = self._open
        self._open = was_open or frame.can_id == self._status_id
        for cycle in self._decoder.push(frame.can_id, frame.data):
            if was_open:
                yield cycle

    def flush(self) -> Iterator[DecodedCycle]:
        """Yield the cycle that is open."""
        if self._open:
            self._open = False
            yield from self._decoder.flush()


def _readable(output: BoundOutput) -> bool:
    """Return whether obstacles can be read back from an output's frames: they have ids and places in vehicle axes."""
    if output.status is None:
        return False
    mount = output.settings.mount
    return {"id", "state", "x", "y", "vx", "vy"} <= set(output.settings.signals) and (
        mount.x == mount.y == mount.yaw_deg == 0.0
    )


def wire_columns(cycle: DecodedCycle) -> dict[str, Column]:
    """Return obstacles from the wire as columns of a picture."""
    columns: dict[str, Any] = {name: values for name, values in cycle.columns().items() if name in COLUMNS}
    for name, default in (("center_x", "x"), ("center_y", "y")):
        columns.setdefault(name, columns[default])
        columns[name] = np.where(np.isfinite(columns[name]), columns[name], columns[default])
    return columns


def counterparts(columns: dict[str, Column], others: dict[str, Column]) -> tuple[Column, Column]:
    """Return the row of the nearest of others in place and velocity for each obstacle (n,), and whether it is alike."""
    n = len(columns["id"])
    if not n or not len(others["id"]):
        return np.zeros(n, np.intp), np.zeros(n, np.bool_)
    distance = sum(np.abs(columns[name][:, None] - others[name][None]) for name in ("x", "y", "vx", "vy"))
    rows = np.argmin(np.nan_to_num(distance, nan=np.inf), axis=1)
    return rows, np.asarray(np.take_along_axis(np.asarray(distance), rows[:, None], 1)[:, 0] < _ALIKE)
