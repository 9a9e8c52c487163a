"""Faults of sensors and of own motion as lines of the log: when one lasts, and when it is over."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from typing import Final

from candaemon.daemon.observer import DaemonView, Observer
from candaemon.ego.pose import EgoStatus
from candaemon.frames.frame import Frame, Tick

logger = logging.getLogger(__name__)

_LOOK_NS: Final = 100_000_000
"""Between two looks."""
_LASTING_NS: Final = 1_000_000_000
"""For which a fault lasts before it is told: shorter ones are counted, and events of a recording."""


class FaultLogger(Observer):
    """Logs faults that last."""

    def __init__(self) -> None:
        self._now_ns = self._look_ns = 0
        self._begun_ns: dict[str, int] = {}
        self._since_ns: dict[str, int] = {}
        self._told: dict[str, str] = {}

    def on_items(self, items: Sequence[Frame | Tick]) -> None:
        """Note how late it is."""
        if items:
            self._now_ns = items[-1][0]

    def on_iteration(self, daemon: DaemonView) -> None:
        """Look for faults a few times a second."""
        now_ns = self._now_ns
        if abs(now_ns - self._look_ns) < _LOOK_NS:
            return
        self._look_ns = now_ns
        found = dict(self._faults(daemon))
        for about in [each for each in self._since_ns if each not in found]:
            seconds = (now_ns - self._since_ns.pop(about)) * 1e-9
            if self._told.pop(about, None):
                logger.warning("%s: well again, after %.1f s", about, seconds)
        for about, fault in found.items():
            since_ns = self._since_ns.setdefault(about, now_ns)
            if self._told.get(about) != fault and now_ns - since_ns >= _LASTING_NS:
                self._told[about] = fault
                logger.warning("%s: %s", about, fault)

    def on_reload_end(self, daemon: DaemonView, error: str) -> None:
        """Forget what the configuration has no longer."""
        if not error:
            there = {_named(sensor.name) for sensor in daemon.binding.sensors} | {_MOTION}
            for known in (self._begun_ns, self._since_ns, self._told):
                for about in known.keys() - there:
                    del known[about]

    def _faults(self, daemon: DaemonView) -> Iterator[tuple[str, str]]:
        """Yield what is wrong, after what it is wrong with."""
        pipeline, now_ns = daemon.pipeline, self._now_ns
        for sensor, assembler in zip(pipeline.binding.sensors, pipeline.assemblers, strict=True):
            last_ns = pipeline.health.state.last_scan_ns[sensor.index]
            begun_ns = self._begun_ns.setdefault(_named(sensor.name), now_ns)
            silent_ns = now_ns - (last_ns or begun_ns)
            fault = pipeline.trust.fault(sensor.index)
            least = sensor.settings.protection.least_trust
            if silent_ns > round(daemon.binding.lost_after(sensor) * 1e9):
                yield _named(sensor.name), "silent, no scan comes" if last_ns else "no scan has come yet"
            elif fault.cuts_off:
                yield _named(sensor.name), f"found {fault.name.lower()} beside the other sensors, and not used"
            elif assembler.valid_share < least:
                yield (
                    _named(sensor.name),
                    f"{assembler.valid_share:.0%} of its frames are valid, fewer than {least:.0%}",
                )
        pose = pipeline.ego.pose(now_ns)
        if pose is None:
            yield _MOTION, "not known yet, and nothing is tracked without it"
        elif pose.status is EgoStatus.LOST:
            yield _MOTION, "lost, and nothing is tracked without it"
        elif pose.status is EgoStatus.DEAD_RECKONING:
            yield _MOTION, "silent, obstacles are tracked by dead reckoning"


_MOTION: Final = "own motion"


def _named(sensor: str) -> str:
    return f"sensor '{sensor}'"
