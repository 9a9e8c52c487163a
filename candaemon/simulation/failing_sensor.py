"""What a sensor reports while it fails: nothing, the same again, or what is off or noisier than it should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import radians, sqrt

import numpy as np

from candaemon.config.sensors import SensorSettings
from candaemon.simulation.effects import SensorFault
from candaemon.simulation.slot_reports import SlotReport


class FailingSensor:
    """Turns the reports of one sensor into those that it gives while it fails.

    Args:
        faults: of this sensor.
        settings: of the sensor, whose noise a noisy one has many times.
        random: generator to draw from.
    """

    def __init__(self, faults: Sequence[SensorFault], settings: SensorSettings, random: np.random.Generator) -> None:
        self._faults, self._random = faults, random
        noise = settings.noise
        self._deviations = {
            "range": noise.range,
            "azimuth": None if noise.azimuth_deg is None else radians(noise.azimuth_deg),
            **{name: getattr(noise, name) for name in ("x", "y", "range_rate", "vx", "vy")},
        }
        self._latest: SlotReport | None = None

    def reported(self, report: SlotReport, time: float) -> SlotReport | None:
        """Return what it reports; None where it is silent.

        Args:
            report: what it would report.
            time: s of the scenario.
        """
        now = [each for each in self._faults if each.begin <= time < each.end]
        kinds = {each.kind for each in now}
        if "silent" in kinds:
            return None
        if "frozen" in kinds and self._latest is not None:
            return self._latest
        for each in now:
            match each.kind:
                case "biased":
                    report = self._farther(report, each.size)
                case "drifting":
                    report = self._farther(report, each.size * (time - each.begin))
                case "noisy":
                    report = self._noisier(report, each.size)
                case _:
                    pass
        self._latest = report
        return report

    def _farther(self, report: SlotReport, distance: float) -> SlotReport:
        """Return the objects farther along the line of sight."""
        values = report.values.copy()
        rows = dict(zip(report.quantities, values, strict=True))
        if "range" in rows:
            rows["range"] += distance
        else:
            stretched = 1.0 + distance / np.maximum(np.hypot(rows["x"], rows["y"]), 1.0)
            rows["x"] *= stretched
            rows["y"] *= stretched
        return replace(report, values=values)

    def _noisier(self, report: SlotReport, factor: float) -> SlotReport:
        """Return the objects with so many times the variance."""
        values = report.values.copy()
        for name, row in zip(report.quantities, values, strict=True):
            deviation = self._deviations.get(name)
            if deviation is not None:
                row += sqrt(factor - 1.0) * deviation * self._random.standard_normal(len(row))
        return replace(report, values=values)
