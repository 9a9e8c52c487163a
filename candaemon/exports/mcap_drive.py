"""A drive as MCAP for Foxglove: frames as they came, and what each cycle made of them.

=========================  =======================================  =============================================
topic                      schema                                   holds
=========================  =======================================  =============================================
`/obstacles`               `foxglove.SceneUpdate`                   boxes, arrows, uncertainty, names
`/obstacles/states`        `candaemon.Obstacles` (JSON)             the same as numbers, for plots and tables
`/obstacles/locations`     `foxglove.LocationFixes`                 where fixes place the drive on earth
`/detections/SENSOR`       `foxglove.PointCloud`                    of a scan
`/pose`, `/tf`             `foxglove.PoseInFrame`, `FrameTransforms` the own vehicle in the local frame
`/location`                `foxglove.LocationFix`                   the own vehicle on earth
`/own_vehicle`             `foxglove.SceneUpdate`                   its body and the fields of view, once
`/can/BUS`                 `candaemon.CanFrame` (JSON)              frames as they came
`/sent/BUS`                `candaemon.CanFrame` (JSON)              the obstacles' frames
`/cycles`                  `candaemon.Cycle` (JSON)                 figures of each cycle
`/diagnostics`             `foxglove.Log`                           losses, silence, own motion
=========================  =======================================  =============================================

Messages are in order of their log time: that of the frame, or of the frame that completed the cycle. Their own time
stamp is that of the measurement. The same drive gives the same bytes with the same version of the SDK.
"""

from __future__ import annotations

import io
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any, BinaryIO, Final

from candaemon.binding.bound import Binding
from candaemon.ego.pose import EgoStatus
from candaemon.exports.drive_sink import DriveSink
from candaemon.exports.drive_tables import cycle_row, track_rows
from candaemon.exports.extras import import_extra
from candaemon.exports.json_forms import CAN_FRAME, CYCLE_ROW, OBSTACLE_ROWS, can_frame, obstacle_rows
from candaemon.exports.json_forms import cycle_row as cycle_text
from candaemon.exports.scene_messages import SceneMessages
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import Frame, Tick
from candaemon.frames.frame_block import FrameBlock
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.radar.mounting import sensor_views
from candaemon.tracking.obstacles import Obstacles

CHUNK_BYTES: Final = 1 << 20
"""Bytes of messages that are held in memory and compressed at once."""


class McapDrive(DriveSink):
    """Writes a drive as MCAP while it is replayed.

    Args:
        binding: the configuration.
        file: where it is written.

    Raises:
        ConfigError: foxglove-sdk is not installed.
    """

    takes_frames = True

    def __init__(self, binding: Binding, file: OutputFile) -> None:
        foxglove = import_extra("foxglove", "foxglove", "a file in MCAP")
        options = import_extra("foxglove.mcap", "foxglove", "a file in MCAP")
        self._messages = SceneMessages()
        self._binding = binding
        self._sensors = [sensor.name for sensor in binding.sensors]
        self._mounts = {sensor.name: sensor.settings.mount for sensor in binding.sensors}
        self._stream = _Forward(file.stream)
        self._context = context = foxglove.Context()  # closes its channels when nobody holds it
        self._writer = foxglove.open_mcap(
            self._stream,
            context=context,
            writer_options=options.MCAPWriteOptions(
                profile="candaemon", chunk_size=CHUNK_BYTES, disable_seeking=True, compression_threads=0
            ),
        )
        self._channels = _channels(binding, context)
        self._waiting: deque[Iterator[Frame | Tick]] = deque()
        self._next: Frame | Tick | None = None
        self._latest_ns = 0
        self._begun = False
        self._watch = _Watch(binding)

    def add_frames(self, block: FrameBlock | Sequence[Frame | Tick]) -> None:
        """Keep frames until the cycle that they complete."""
        self._waiting.append(block.frames() if isinstance(block, FrameBlock) else iter(block))

    def add_cycle(self, cycle: Cycle, pipeline: Pipeline) -> None:
        """Write the frames up to a cycle, and the cycle."""
        self._write_frames(cycle.time_ns)
        self._latest_ns = max(self._latest_ns, cycle.time_ns)
        messages, obstacles, pose = self._messages, cycle.obstacles, cycle.pose
        if not self._begun:
            self._begun = True
            views = {sensor.name: tuple(sensor_views(sensor.settings).values()) for sensor in self._binding.sensors}
            self._log("/own_vehicle", messages.own_vehicle(obstacles.time_ns, views))
        if pose.status is not EgoStatus.LOST:
            self._log("/tf", messages.transforms(pose, self._mounts))
            self._log("/pose", messages.pose(pose))
            if cycle.georeference is not None:
                self._log("/location", messages.location(pose, cycle.georeference))
        if cycle.detections is not None:
            sensor = self._sensors[cycle.detections.sensor]
            self._log(f"/detections/{sensor}", messages.detections(cycle, self._sensors))
        self._write_obstacles(cycle, obstacles)
        self._log("/cycles", cycle_text(obstacles.time_ns, cycle_row(cycle, pipeline, self._sensors)))
        self._write_sent(cycle.frames)
        for source, text, warning in self._watch.news(cycle, pipeline):
            self._log("/diagnostics", messages.log(cycle.time_ns, source, text, warning=warning))
        self._stream.check()

    def finish(self) -> None:
        """Write the frames that are left, and the file's end."""
        self._write_frames(None)
        self._writer.close()
        for channel in self._channels.values():
            channel.close()
        self._stream.check()

    def _write_obstacles(self, cycle: Cycle, obstacles: Obstacles) -> None:
        self._log("/obstacles", self._messages.obstacles(obstacles))
        self._log("/obstacles/states", obstacle_rows(obstacles.time_ns, *track_rows(cycle, self._sensors)))
        if cycle.georeference is not None:
            self._log("/obstacles/locations", self._messages.locations(obstacles, cycle.georeference))

    def _write_sent(self, frames: Sequence[Frame]) -> None:
        for frame in frames:
            bus = self._binding.buses[frame.bus].name
            self._channels[f"/sent/{bus}"].log(can_frame(frame, bus), log_time=self._latest_ns)

    def _write_frames(self, until_ns: int | None) -> None:
        """Write the frames that came up to a time; None: all."""
        while True:
            if self._next is None:
                while self._waiting and self._next is None:
                    self._next = next(self._waiting[0], None)
                    if self._next is None:
                        self._waiting.popleft()
                if self._next is None:
                    return
            if until_ns is not None and self._next[0] > until_ns:
                return
            if isinstance(self._next, Frame) and self._next.bus >= 0:
                bus = self._binding.buses[self._next.bus].name
                self._latest_ns = max(self._latest_ns, self._next.time_ns)
                self._channels[f"/can/{bus}"].log(can_frame(self._next, bus), log_time=self._latest_ns)
            self._next = None

    def _log(self, topic: str, message: Any) -> None:
        self._channels[topic].log(message, log_time=self._latest_ns)


def topics(binding: Binding) -> dict[str, str | dict[str, Any]]:
    """Return the topics of a drive, each with the name of Foxglove's message or a JSON Schema."""
    found: dict[str, str | dict[str, Any]] = {
        "/obstacles": "SceneUpdate",
        "/obstacles/states": OBSTACLE_ROWS,
        "/obstacles/locations": "LocationFixes",
        **{f"/detections/{sensor.name}": "PointCloud" for sensor in binding.sensors},
        "/pose": "PoseInFrame",
        "/tf": "FrameTransforms",
        "/location": "LocationFix",
        "/own_vehicle": "SceneUpdate",
        **{f"/can/{bus.name}": CAN_FRAME for bus in binding.buses},
        "/cycles": CYCLE_ROW,
        "/diagnostics": "Log",
    }
    if binding.output is not None:
        found[f"/sent/{binding.buses[binding.output.bus].name}"] = CAN_FRAME
    return found


def _channels(binding: Binding, context: Any) -> dict[str, Any]:
    """Open a channel for each topic."""
    foxglove = import_extra("foxglove", "foxglove", "a file in MCAP")
    of_messages = import_extra("foxglove.channels", "foxglove", "a file in MCAP")
    return {
        topic: getattr(of_messages, f"{schema}Channel")(topic, context=context)
        if isinstance(schema, str)
        else foxglove.Channel(topic, schema=schema, context=context)
        for topic, schema in topics(binding).items()
    }


class _Watch:
    """Notices what a driver of the test car wants to be told."""

    def __init__(self, binding: Binding) -> None:
        self._sensors = [sensor.name for sensor in binding.sensors]
        self._drops = 0
        self._counts: list[dict[str, int]] = [{} for _ in self._sensors]
        self._ego: EgoStatus | None = None
        self._coasting = False

    def news(self, cycle: Cycle, pipeline: Pipeline) -> Iterator[tuple[str, str, bool]]:
        """Yield who tells what since the last cycle, and whether something is wrong."""
        status = cycle.pose.status
        if status is not self._ego:
            self._ego = status
            yield "ego", f"own motion is {status.name.lower().replace('_', ' ')}", status is EgoStatus.LOST
        coasting = cycle.detections is None and status is not EgoStatus.LOST
        if coasting is not self._coasting:
            self._coasting = coasting
            yield "tracker", "every sensor is silent, obstacles coast" if coasting else "scans come again", coasting
        if pipeline.drops == self._drops:
            return
        self._drops = pipeline.drops
        for k, (name, assembler) in enumerate(zip(self._sensors, pipeline.assemblers, strict=True)):
            counts = asdict(assembler.counts)
            more = {key: value - self._counts[k].get(key, 0) for key, value in counts.items() if key not in _NO_LOSS}
            self._counts[k] = counts
            lost = ", ".join(f"{count} {key.replace('_', ' ')}" for key, count in more.items() if count)
            if lost:
                yield name, f"frames and objects lost: {lost}", True


_NO_LOSS: Final = frozenset({"used", "scans"})
"""Counts of a sensor that tell no loss."""


class _Forward(io.RawIOBase):
    """A stream that only goes forward, for a writer in another language: an error is kept until `check`."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._position = 0
        self._error: BaseException | None = None

    def write(self, data: Any, /) -> int:
        """Write; after an error, nothing."""
        if self._error is None:
            try:
                self._stream.write(data)
            except BaseException as error:  # noqa: BLE001 - raised by `check`, out of the other language's hands
                self._error = error
        self._position += len(data)
        return len(data)

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        """Say where it is; it goes nowhere else."""
        if (whence, offset) not in {(io.SEEK_CUR, 0), (io.SEEK_SET, self._position)}:
            raise io.UnsupportedOperation("seek")
        return self._position

    def flush(self) -> None:
        """Leave that to the file."""

    def check(self) -> None:
        """Raise the error that writing had, if any."""
        if self._error is not None:
            raise self._error
