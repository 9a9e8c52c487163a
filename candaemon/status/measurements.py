"""Measurements of a running service that no counter holds: rates, NIS, time since each sensor's latest scan."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from candaemon.radar.scan import ScanCounts
from candaemon.status.histogram import Histogram
from candaemon.status.snapshot import NisStatus
from candaemon.tracking.update import Update

Counters: TypeAlias = Mapping[Hashable, int]

RATE_S = 1.0
"""A rate is that of the last one to two of these, s."""


class CounterRates:
    """How fast counters rose of late."""

    def __init__(self) -> None:
        self._earlier: tuple[float, Counters] = (0.0, {})
        self._later: tuple[float, Counters] | None = None

    def due(self, now_s: float) -> bool:
        """Return whether the counters are to be noted again."""
        return self._later is None or now_s >= self._later[0] + RATE_S

    def note(self, now_s: float, counters: Counters) -> None:
        """Note the counters as they are."""
        self._earlier = self._later or (now_s, counters)
        self._later = (now_s, counters)

    def of(self, now_s: float, counters: Counters) -> dict[Hashable, float]:
        """Return the rise of each counter, 1/s; 0 for one that was not there before."""
        noted_s, noted = self._earlier
        span_s = now_s - noted_s
        if span_s <= 0.0:
            return dict.fromkeys(counters, 0.0)
        return {key: max(count - noted.get(key, count), 0) / span_s for key, count in counters.items()}


class NisAccumulator:
    """Sums of normalised innovations squared, since the start and of late.

    Args:
        memory: scans that the figure of late looks back on.
    """

    def __init__(self, memory: int) -> None:
        self._kept = 1.0 - 1.0 / memory
        self._samples = self._freedom = 0
        self._sum = self._late_sum = self._late_freedom = 0.0

    def add(self, update: Update) -> None:
        """Take in what a scan updated; a track that began has no innovation."""
        known = np.isfinite(update.nis)
        total, freedom = float(update.nis[known].sum()), int(update.degrees_of_freedom[known].sum())
        self._samples += int(np.count_nonzero(known))
        self._sum += total
        self._freedom += freedom
        self._late_sum = self._kept * self._late_sum + total
        self._late_freedom = self._kept * self._late_freedom + freedom

    def status(self) -> NisStatus:
        """Return what they come to."""
        ratio = self._late_sum / self._late_freedom if self._late_freedom > 0.0 else None
        return NisStatus(self._samples, self._sum, self._freedom, ratio)


class SensorActivity:
    """When a sensor's latest scan was, and how its detections fit.

    Args:
        counts: the sensor's own, which rise with each scan.
        nis: how its detections fitted until now.
    """

    __slots__ = ("_counts", "_scans", "last_ns", "nis")

    def __init__(self, counts: ScanCounts, nis: NisAccumulator) -> None:
        self._counts = counts
        self._scans = counts.scans
        self.last_ns: int | None = None
        self.nis = nis

    def look(self, time_ns: int) -> None:
        """Look whether a cycle was brought by this sensor."""
        if self._counts.scans != self._scans:
            self._scans = self._counts.scans
            self.last_ns = time_ns


@dataclass(slots=True)
class ClientCounts:
    """Clients that were not served; counted where they are.

    Attributes:
        status_clients: of the status socket, hung up on because they did not read or others came.
        scrapes: connections to the metrics endpoint that got no metrics.
    """

    status_clients: int = 0
    scrapes: int = 0


@dataclass(slots=True)
class Measurements:
    """All that is measured.

    Attributes:
        cycle_time, latency: how they are spread.
        started_s: when the service started, monotonic.
        now_ns: time for the pipeline.
        sensors: by name, in the configuration's order.
        rates: of what rises.
        reloads: configurations that took the place of another.
        refused: configurations that were refused.
        reload_error: why the last one was; empty if it was not.
    """

    cycle_time: Histogram
    latency: Histogram
    started_s: float
    now_ns: int = 0
    sensors: dict[str, SensorActivity] = field(default_factory=dict)
    rates: CounterRates = field(default_factory=CounterRates)
    reloads: int = 0
    refused: int = 0
    reload_error: str = ""
