"""The recorder of a running service: a ring of the pipeline's input, and an archive of events.

Recorded are the frames and ticks that the pipeline processes, with the times that it sees, and its state at the start
of each file. Hence a file from the middle of a drive replays to the same bytes that were sent from there on.
"""

from __future__ import annotations

import logging
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from candaemon._version import __version__
from candaemon.binding.bound import Binding
from candaemon.can_io.logs.candump import candump_text
from candaemon.can_io.logs.stream import TICK_CHANNEL
from candaemon.config.recording import RecordingSettings
from candaemon.daemon.observer import CompletedCycle, DaemonView, Observer
from candaemon.frames.frame import Frame, Tick
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state import Snapshots
from candaemon.playback.recording_files import ENDED, SETTLED
from candaemon.recording.event_archive import Event
from candaemon.recording.event_detector import EventDetector
from candaemon.recording.ring import MEGABYTE, SHARE_OF_A_FILE
from candaemon.recording.writer_thread import WriterThread

logger = logging.getLogger(__name__)

_CHUNK = 1 << 16  # bytes that are written at once
_LOOK_S = 0.1  # between two looks at the buses
_ROTATION_DELAY = 0.1  # of a file's length: how long the next one waits for a moment without frames
_CLOSING_S = 0.4

MARK_INTERVAL_S: Final = 0.1
"""Between two marks by the user; what comes sooner is the same one, s."""


class Recorder(Observer):
    """Records a daemon.

    Args:
        settings: the ring's bounds, and what is kept; a reload changes no more than which events are.
        folder: where it goes; made where it is not there.
        binding: the configuration.
        clock: monotonic seconds.

    Raises:
        InputError: the folder is none, others may write to it, or another service records into it. A disk that
            refuses is no error: it is tried again, and what comes meanwhile is counted as lost.
    """

    def __init__(
        self,
        settings: RecordingSettings,
        folder: Path,
        binding: Binding,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folder = folder
        self._settings = settings
        self._clock = clock
        self._file_ns = round(settings.file_seconds * 1e9)
        self._file_bytes = round(settings.disk * MEGABYTE * SHARE_OF_A_FILE)
        self._disk = WriterThread(folder, settings)
        self._counts = self._disk.counts
        self._text: list[bytes] = []
        self._text_bytes = self._text_items = 0
        self._file_written = 0
        self._begun_ns = self._last_ns = 0
        self._reason = "start"
        self._refusals = 0
        self._flush_s = self._look_s = self._retry_s = self._mark_s = 0.0
        self._adopt(Pipeline(binding))

    def counts(self) -> Mapping[str, int | float | str | bool]:
        """Return what the recording did, for metrics and status."""
        return self._counts.tree()

    def on_start(self, daemon: DaemonView) -> None:
        """Begin with the pipeline of a daemon."""
        self._pipeline = daemon.pipeline
        if self._disk.is_open:  # else it has said that it is not
            logger.info("recorded into %s", self._folder)

    def on_items(self, items: Sequence[Frame | Tick]) -> None:
        """Record what the pipeline is about to take."""
        if not items:
            return
        if self._is_due(items):
            self._begin(items[0][0])
        self._last_ns = items[-1][0]
        if self._paused:
            self._counts.lose(len(items))
            return
        text = candump_text([item if len(item) > 1 else self._tick(item[0]) for item in items], self._channels)
        self._text.append(text)
        self._text_bytes += len(text)
        self._text_items += len(items)
        if self._text_bytes >= _CHUNK:
            self._flush()

    def on_cycle(self, completed: CompletedCycle) -> None:
        """Detect events in a cycle."""
        for event in self._detector.on_cycle(completed):
            self._keep(event)

    def on_iteration(self, daemon: DaemonView) -> None:
        """Write what has waited for long enough, and detect events on buses and sensors."""
        now_s = self._clock()
        if now_s >= self._flush_s:
            self._flush_s = now_s + self._settings.flush
            self._flush()
        if now_s >= self._look_s:
            self._look_s = now_s + _LOOK_S
            for event in self._detector.on_iteration(daemon, self._last_ns):
                self._keep(event)

    def on_mark(self, daemon: DaemonView) -> None:  # noqa: ARG002  # an observer's signature
        """Keep what lies around this moment: the user asks for it, as often as a tenth of a second has passed."""
        now_s = self._clock()
        if now_s >= self._mark_s:
            self._mark_s = now_s + MARK_INTERVAL_S
            self._keep(Event("mark", "", self._last_ns))

    def on_reload_end(self, daemon: DaemonView, error: str) -> None:
        """Begin a file with the configuration that took its place.

        It begins at once where the one before has: should the service be stopped before anything else comes, the file
        holds what is then reported.
        """
        if not error:
            has_begun = not (self._paused or self._reason)
            self._end(SETTLED)
            former = self._detector
            self._adopt(Pipeline(daemon.pipeline.binding))
            self._detector.go_on_from(former)
            self._pipeline = daemon.pipeline
            self._reason = "reload"
            if has_begun and not self._paused and self._disk.refusals == self._refusals:
                self._begin(self._last_ns)

    def on_stop(self, daemon: DaemonView) -> None:  # noqa: ARG002  # an observer's signature
        """Write what waits and close the files."""
        self._end(ENDED)
        self._disk.close(_CLOSING_S)

    def _end(self, mark: int) -> None:
        """Mark where the file ends, if one has begun, and write what waits."""
        if not (self._paused or self._reason):
            self._text.append(candump_text([self._tick(self._last_ns, mark)], self._channels))
        self._flush()

    def _adopt(self, fresh: Pipeline) -> None:
        """Take over what depends on the configuration.

        Args:
            fresh: a pipeline of it that has taken nothing.
        """
        binding = fresh.binding
        self._pipeline = fresh
        self._snapshots = Snapshots(binding)
        self._detector = EventDetector(binding)
        self._follows = ""
        channels = [bus.settings.log_channel or bus.settings.channel for bus in binding.buses]
        self._channels = (*channels, TICK_CHANNEL)
        self._note = {
            "configuration": str(binding.loaded.path),
            "digest": self._snapshots.configuration,
            "candaemon": __version__,
            "python": platform.python_version(),
        }

    @property
    def _paused(self) -> bool:
        return not self._counts.recording

    def _tick(self, time_ns: int, can_id: int = 0) -> Frame:
        """Return the frame that a tick is written as."""
        return Frame(time_ns, len(self._channels) - 1, can_id, b"")

    def _is_due(self, items: Sequence[Frame | Tick]) -> bool:
        """Return whether a file is to begin before these items."""
        if self._disk.refusals > self._refusals:
            self._refusals = self._disk.refusals
            self._pause()
        if self._paused:
            return self._clock() >= self._retry_s and self._disk.has_room
        if self._reason or self._file_written + self._text_bytes >= self._file_bytes:
            return True
        late_ns = items[0][0] - self._begun_ns - self._file_ns
        # storing the state takes some ms: rather while nobody waits for a scan
        return late_ns >= 0 and (len(items[-1]) == 1 or late_ns > _ROTATION_DELAY * self._file_ns)

    def _begin(self, time_ns: int) -> None:
        """Begin a file with what the pipeline knows."""
        self._flush()
        reason = self._reason or ("gap" if self._paused else "rotation")
        state = self._snapshots.dump(self._pipeline, begins=reason, follows=self._follows, time_ns=time_ns)
        self._follows = self._disk.begin(
            time_ns,
            state,
            self._pipeline.binding,
            self._snapshots.configuration,
            goes_on=reason == "rotation",
        )
        self._begun_ns, self._file_written = time_ns, 0
        self._reason, self._counts.recording = "", True

    def _flush(self) -> None:
        """Hand what was gathered to the disk."""
        if not self._text:
            return
        text, items = b"".join(self._text), self._text_items
        self._text.clear()
        self._text_bytes = self._text_items = 0
        if self._disk.write(text, items):
            self._file_written += len(text)
        else:
            self._counts.lose(items)
            self._pause()

    def _pause(self) -> None:
        """Leave input out until the disk may have recovered; a file of its own then begins."""
        self._counts.recording = False
        self._counts.pauses += 1
        self._retry_s = self._clock() + self._settings.retry
        self._counts.lose(self._text_items)
        self._text.clear()
        self._text_bytes = self._text_items = 0

    def _keep(self, event: Event) -> None:
        """Have an event kept."""
        if self._settings.events.kept:
            self._flush()
            self._disk.archive(replace(event, note=self._note))
