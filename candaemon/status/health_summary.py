"""The health summary: what `systemctl status` shows of the service, and a line in the log at a limited rate."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable

from candaemon.daemon.observer import DaemonView, Observer
from candaemon.status.service_monitor import ServiceMonitor
from candaemon.tracking.obstacles import TENTATIVE

logger = logging.getLogger(__name__)

_SHORTEST_SILENCE_S = 1.0


def obstacle_count(daemon: DaemonView) -> int:
    """Count the obstacles of the latest cycle without the tentative ones."""
    return 0 if daemon.last is None else int((daemon.last.obstacles.state > TENTATIVE).sum())


def ego_motion(daemon: DaemonView) -> str:
    """Return the status of ego motion in words."""
    if daemon.last is None:
        return "unknown"
    return {"VALID": "ok"}.get(daemon.last.pose.status.name, daemon.last.pose.status.name.lower().replace("_", " "))


def buses_down(daemon: DaemonView) -> list[str]:
    """List the buses that are down."""
    return [daemon.buses[k].name for k in range(len(daemon.buses)) if not daemon.buses[k].state.up]


class HealthSummary:
    """Summarises the service's health in a line; remembers which sensors are active.

    Args:
        meter: knows what was lost; it observes the same daemon.
        clock: monotonic seconds.
    """

    def __init__(self, meter: ServiceMonitor, clock: Callable[[], float] = time.monotonic) -> None:
        self._meter = meter
        self._clock = clock
        self._scans: dict[str, tuple[int, float]] = {}

    def brief(self, daemon: DaemonView) -> str:
        """Return such as `12 obstacles, 4 sensors, ego ok, 0 lost`; to be asked every second or so.

        Lost are all frames that came to nothing, whether they were never read, not usable, or not sent.
        """
        sensors = daemon.pipeline.binding.sensors
        heard = self._heard(daemon)
        told = f"{heard}" if heard == len(sensors) else f"{heard} of {len(sensors)}"
        line = (
            f"{obstacle_count(daemon)} obstacles, {told} sensors, ego {ego_motion(daemon)}, "
            f"{self._meter.losses(daemon).frames} lost"
        )
        missing = buses_down(daemon)
        return line + (f"; down: {', '.join(missing)}" if missing else "")

    def _heard(self, daemon: DaemonView) -> int:
        """Count the sensors that have brought a scan of late."""
        now_s, heard = self._clock(), 0
        for sensor, assembler in zip(daemon.pipeline.binding.sensors, daemon.pipeline.assemblers, strict=True):
            scans = assembler.counts.scans
            before, at_s = self._scans.get(sensor.name, (0, now_s))
            if scans != before:
                at_s = now_s
            self._scans[sensor.name] = scans, at_s
            patience_s = max(_SHORTEST_SILENCE_S, daemon.binding.lost_after(sensor))
            heard += scans > 0 and now_s - at_s <= patience_s
        return heard


class StatusLogger(Observer):
    """Logs what the service does, every so often, and at its end what became of everything.

    Args:
        interval_s: between two lines, 0: none but the last; None: what the configuration says.
        meter: knows what was lost; it observes the same daemon.
        clock: monotonic seconds.
        shadow: whether nothing is sent though there is an output.
    """

    def __init__(
        self,
        interval_s: float | None,
        meter: ServiceMonitor,
        clock: Callable[[], float] = time.monotonic,
        *,
        shadow: bool = False,
    ) -> None:
        self._asked_s, self._shadow = interval_s, shadow
        self._meter = meter
        self._clock = clock
        self._last_s = clock()
        self._interval_s, self._due_s = 0.0, math.inf
        self._frames = self._cycles = 0

    def on_start(self, daemon: DaemonView) -> None:
        """Say what is served; begin to count the time."""
        binding = daemon.binding
        sensors, buses = (", ".join(each.name for each in some) for some in (binding.sensors, binding.buses))
        logger.info("serving %s: sensors %s; buses %s", binding.loaded.path, sensors, buses)
        if binding.output is None and not self._shadow:
            logger.warning("there is no `output`: obstacles are tracked, and none is sent")
        self._set_interval(daemon)

    def on_reload_end(self, daemon: DaemonView, error: str) -> None:
        """Follow the configuration's interval."""
        if not error:
            self._set_interval(daemon)

    def on_iteration(self, daemon: DaemonView) -> None:
        """Log a line if one is due; cheap if not."""
        now_s = self._clock()
        if now_s >= self._due_s:
            self._due_s = now_s + self._interval_s
            logger.info("%s", self._line(daemon, now_s))

    def on_stop(self, daemon: DaemonView) -> None:
        """Log the last counts: the buses are closed, nothing more comes."""
        logger.info("stopped; %s", self._since_the_start(daemon))

    def _set_interval(self, daemon: DaemonView) -> None:
        asked_s, configured_s = self._asked_s, daemon.binding.settings.service.status_interval
        self._interval_s = configured_s if asked_s is None else asked_s
        self._due_s = self._clock() + self._interval_s if self._interval_s else math.inf

    def _line(self, daemon: DaemonView, now_s: float) -> str:
        """Say what happened since the last line, and what was lost since the start."""
        pipeline = daemon.pipeline
        frames, cycles = sum(bus.frames for bus in pipeline.counts.buses), pipeline.counts.cycles
        span_s = max(now_s - self._last_s, 1e-9)
        line = (
            f"{max(frames - self._frames, 0) / span_s:.0f} frames/s, {(cycles - self._cycles) / span_s:.1f} cycles/s, "
            f"{obstacle_count(daemon)} obstacles, own motion {ego_motion(daemon)}; {self._since_the_start(daemon)}"
        )
        missing = buses_down(daemon)
        self._last_s, self._frames, self._cycles = now_s, frames, cycles
        return line + (f"; down: {', '.join(missing)}" if missing else "")

    def _since_the_start(self, daemon: DaemonView) -> str:
        """Say what came of everything."""
        losses = self._meter.losses(daemon)
        line = (
            f"since the start {daemon.pipeline.counts.cycles} cycles, {daemon.received} frames received, "
            f"{losses.lost} lost, {losses.unusable} unusable, {losses.unsent} unsent"
        )
        causes = str(losses)
        line += f" ({causes})" if causes else ""
        return line + "".join(f", {count} {what}" for what, count in _rare(daemon).items() if count)


def _rare(daemon: DaemonView) -> dict[str, int]:
    """Return what is worth a word only where it happened."""
    pipeline, sequence = daemon.pipeline, daemon.sequence
    scans = [assembler.counts for assembler in pipeline.assemblers]
    return {
        "frames missing": sum(each.missing for each in scans),
        "scans distrusted": sum(each.distrusted for each in scans),
        "steps of the clock": sequence.backward_steps + sequence.forward_steps,
        "output values beyond their signal": pipeline.saturated,
    }
