"""Cycles of a pipeline into pictures."""

from __future__ import annotations

from collections.abc import Hashable
from math import radians
from typing import Any, Final

from candaemon.binding.bound import Binding
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.radar.mounting import sensor_views
from candaemon.status.collect import EGO_STATUS_NAMES
from candaemon.status.measurements import CounterRates, NisAccumulator
from candaemon.tracking.obstacles import CLASS_NAMES, STATE_NAMES
from candaemon.view.diagnostics import FitObserver, mode_names, obstacle_columns
from candaemon.view.picture import Picture, scan_marks

_NIS_MEMORY: Final = 200
"""Scans that the NIS of a sensor looks back on."""
_CYCLES: Final = "cycles"


class Painter:
    """Makes a picture of each cycle of one pipeline.

    Args:
        pipeline: whose cycles they are.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._fit = FitObserver(len(mode_names(pipeline.binding)))
        self._rates = CounterRates()
        self._nis = [NisAccumulator(_NIS_MEMORY) for _ in pipeline.binding.sensors]

    def paint(self, cycle: Cycle) -> Picture:
        """Return the picture of a cycle; to be called before the pipeline's next one."""
        fit = self._fit.fit(cycle)
        detections = cycle.detections
        if detections is not None and cycle.update is not None:
            self._nis[detections.sensor].add(cycle.update)
        now_s = cycle.time_ns * 1e-9
        health = self._health(cycle, now_s) if self._rates.due(now_s) else {}
        return Picture(
            cycle.obstacles.time_ns,
            cycle.pose,
            obstacle_columns(cycle.obstacles, fit),
            fit.modes,
            () if detections is None else (scan_marks(detections),),
            health=health,
        )

    def _health(self, cycle: Cycle, now_s: float) -> dict[str, Any]:
        """Return how sensors and buses are doing, and note the counters for the next time."""
        pipeline, counts = self._pipeline, self._pipeline.counts
        sensors = list(zip(pipeline.binding.sensors, pipeline.assemblers, self._nis, strict=True))
        counters: dict[Hashable, int] = {
            _CYCLES: counts.cycles,
            **{("bus", k): each.frames for k, each in enumerate(counts.buses)},
            **{("sensor", sensor.index): assembler.counts.scans for sensor, assembler, _ in sensors},
        }
        rates = self._rates.of(now_s, counters)
        self._rates.note(now_s, counters)
        return {
            "cycles": {"rate": round(rates[_CYCLES], 2), "told": counts.cycles, "without_ego": counts.without_ego},
            "own_motion": EGO_STATUS_NAMES[cycle.pose.status],
            "drops": pipeline.drops,
            "buses": {
                bus.name: {
                    "rate": round(rates["bus", bus.index], 1),
                    "received": each.frames,
                    "used": each.used,
                    "unknown": each.unknown,
                    "short": each.short,
                }
                for bus, each in zip(pipeline.binding.buses, counts.buses, strict=True)
            },
            "sensors": {
                sensor.name: {
                    "rate": round(rates["sensor", sensor.index], 1),
                    "used": assembler.counts.used,
                    "dropped": assembler.counts.dropped,
                    "missing": assembler.counts.missing,
                    "trust": round(assembler.valid_share, 3),
                    "nis": _rounded(nis.status().ratio),
                }
                for sensor, assembler, nis in sensors
            },
        }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def stage_of(binding: Binding) -> dict[str, Any]:
    """Return what does not change from picture to picture: sensors, what they see, and the names behind numbers."""
    return {
        "name": binding.settings.name or binding.loaded.path.stem,
        "config": binding.loaded.path.name,
        "sensors": [
            {
                "name": sensor.name,
                "kind": sensor.settings.kind,
                "x": sensor.settings.mount.x,
                "y": sensor.settings.mount.y,
                "views": [
                    {
                        "yaw": view.yaw,
                        "half": radians(view.field.azimuth_deg),
                        "near": min(view.field.min_range, view.field.range),
                        "far": view.field.range,
                    }
                    for view in sensor_views(sensor.settings, sensor.index).values()
                ],
            }
            for sensor in binding.sensors
        ],
        "modes": list(mode_names(binding)),
        "states": list(STATE_NAMES),
        "classes": list(CLASS_NAMES),
        "own_motion": [EGO_STATUS_NAMES[status] for status in sorted(EGO_STATUS_NAMES)],
    }
