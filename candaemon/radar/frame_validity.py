"""Valid-frame ratio of a sensor: within a scan, and averaged over the last seconds."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

from candaemon.config.protection import SensorProtectionSettings
from candaemon.radar.scan import ScanCounts


@dataclass(slots=True)
class FrameValidityState:
    """What the valid-frame ratio is computed from.

    Attributes:
        share: of the frames that could be used, averaged exponentially over their own time; 1 before the first.
        failed: the count of failed frames at the latest scan.
        used, dropped: the counts of frames used and dropped at the latest update of the share.
        updated_ns: time of the latest update of the share.
    """

    share: float = 1.0
    failed: int = 0
    used: int = 0
    dropped: int = 0
    updated_ns: int = 0


class FrameValidity:
    """Watches how many of a sensor's frames fail.

    Args:
        settings: of the sensor's protection.
        counts: of the sensor's frames; the owner's.
        longest_gap: s without a scan after which refused frames count at once, for none may ever close again.

    Attributes:
        counts: as given.
        state: what it remembers.
    """

    def __init__(self, settings: SensorProtectionSettings, counts: ScanCounts, longest_gap: float) -> None:
        self.counts = counts
        self.state = FrameValidityState()
        self._max_failed = settings.max_failed
        self._constant_ns = settings.trust_time * 1e9
        self._longest_gap_ns = longest_gap * 1e9

    def damages(self, stored: int) -> bool:
        """Return whether too many frames have failed since the last scan for one of so many good ones."""
        state = self.state
        failed, state.failed = self.counts.failed - state.failed, self.counts.failed
        return failed > self._max_failed * (failed + stored)

    def refused(self, time_ns: int) -> None:
        """Count a frame that was refused."""
        if time_ns - self.state.updated_ns > self._longest_gap_ns:
            self.closed(time_ns)

    def closed(self, time_ns: int) -> None:
        """Average over the frames counted since the last scan, the latest of them of this time."""
        state = self.state
        used, dropped = self.counts.used, self.counts.dropped
        good, bad = used - state.used, dropped - state.dropped
        if good + bad <= 0:
            return
        weight = 1.0 - exp(-max(time_ns - state.updated_ns, 0) / self._constant_ns)
        state.share += weight * (good / (good + bad) - state.share)
        state.used, state.dropped, state.updated_ns = used, dropped, time_ns
