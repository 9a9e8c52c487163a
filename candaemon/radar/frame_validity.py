"""How far a sensor's frames can be trusted: within a scan, and of late."""

from __future__ import annotations

from math import exp

from candaemon.config.protection import SensorProtectionSettings
from candaemon.radar.scan import ScanCounts


class FrameValidity:
    """Watches how many of a sensor's frames fail.

    Args:
        settings: of the sensor's protection.
        counts: of the sensor's frames.
        patience: s without a scan after which refused frames count at once, for none may ever close again.

    Attributes:
        share: of the frames that could be used, averaged exponentially over their own time; 1 before the first.
    """

    def __init__(self, settings: SensorProtectionSettings, counts: ScanCounts, patience: float) -> None:
        self.share = 1.0
        self._counts = counts
        self._max_failed = settings.max_failed
        self._constant_ns = settings.trust_time * 1e9
        self._patience_ns = patience * 1e9
        self._failed = self._used = self._dropped = 0
        self._looked_ns = 0

    def damages(self, stored: int) -> bool:
        """Tell whether too many frames have failed since the last scan for one of so many good ones."""
        failed, self._failed = self._counts.failed - self._failed, self._counts.failed
        return failed > self._max_failed * (failed + stored)

    def refused(self, time_ns: int) -> None:
        """Take a frame that was refused."""
        if time_ns - self._looked_ns > self._patience_ns:
            self.closed(time_ns)

    def closed(self, time_ns: int) -> None:
        """Take the frames counted since the last scan, the latest of them of this time."""
        used, dropped = self._counts.used, self._counts.dropped
        good, bad = used - self._used, dropped - self._dropped
        if good + bad <= 0:
            return
        weight = 1.0 - exp(-max(time_ns - self._looked_ns, 0) / self._constant_ns)
        self.share += weight * (good / (good + bad) - self.share)
        self._used, self._dropped, self._looked_ns = used, dropped, time_ns
