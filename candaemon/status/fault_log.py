"""Faults of sensors and of own motion as lines of the log: when one lasts, and when it is over."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from candaemon.daemon.observer import DaemonView, Observer
from candaemon.ego.odometry import OdometryMotion
from candaemon.ego.pose import EgoStatus
from candaemon.frames.frame import Frame, Tick

logger = logging.getLogger(__name__)

_LOOK_NS: Final = 100_000_000
"""Between two looks."""
_LASTING_NS: Final = 1_000_000_000
"""For which a fault lasts before it is told: shorter ones are counted, and events of a recording."""


@dataclass(slots=True)
class _LastingFault:
    """What has been wrong with a sensor or own motion for a while.

    Attributes:
        since_ns: when it began.
        text: what is wrong at present.
        text_ns: since when that is so.
        told: what was told of it last; empty: nothing.
    """

    since_ns: int
    text: str = ""
    text_ns: int = 0
    told: str = ""


class FaultLogger(Observer):
    """Logs faults that last, a line each; one that turns into another has a second line where that lasts, too."""

    def __init__(self) -> None:
        self._now_ns = self._look_ns = 0
        self._begun_ns: dict[str, int] = {}
        self._lasting: dict[str, _LastingFault] = {}

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
        for about in self._lasting.keys() - found.keys():
            over = self._lasting.pop(about)
            if over.told:
                logger.warning("%s: well again, after %.1f s", about, (now_ns - over.since_ns) * 1e-9)
        for about, text in found.items():
            fault = self._lasting.setdefault(about, _LastingFault(now_ns))
            if fault.text != text:
                fault.text, fault.text_ns = text, now_ns
            begun_ns = fault.text_ns if fault.told else fault.since_ns
            if fault.told != text and now_ns - begun_ns >= _LASTING_NS:
                fault.told = text
                logger.warning("%s: %s", about, text)

    def on_reload_end(self, daemon: DaemonView, error: str) -> None:
        """Forget what the configuration has no longer."""
        if not error:
            there = {_named(sensor.name) for sensor in daemon.binding.sensors} | {_MOTION, _GEAR}
            self._begun_ns = {about: ns for about, ns in self._begun_ns.items() if about in there}
            self._lasting = {about: fault for about, fault in self._lasting.items() if about in there}

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
                yield _named(sensor.name), f"fewer than {least:.0%} of its frames are valid"
        pose = pipeline.ego.pose(now_ns)
        if pose is None:
            yield _MOTION, "not known yet, and nothing is tracked without it"
        elif pose.status is EgoStatus.LOST:
            yield _MOTION, "lost, and nothing is tracked without it"
        elif pose.status is EgoStatus.DEAD_RECKONING:
            yield _MOTION, "silent, obstacles are tracked by dead reckoning"
        if isinstance(pipeline.ego, OdometryMotion) and pipeline.ego.lacks_gear(now_ns):
            yield _GEAR, "silent, speeds count as ahead"


_MOTION: Final = "own motion"
_GEAR: Final = "own motion's signal of reverse"


def _named(sensor: str) -> str:
    return f"sensor '{sensor}'"
