"""Measurement times of sensors and time stamps of their frames, in whole µs, which every log format preserves."""

from __future__ import annotations

import math

import numpy as np

from candaemon.arrays import Indices
from candaemon.config.sensors import SensorSettings
from candaemon.simulation.random_streams import stream
from candaemon.simulation.scenario import Scenario, Transmission

_MICROSECOND = 1_000
_LARGEST_BURST = 0.4
"""Largest share of a cycle that the frames of one scan may fill."""


def start_ns(scenario: Scenario) -> int:
    """Return the scenario's time 0 in the log's clock, ns."""
    return round(scenario.start_time * 1e6) * _MICROSECOND


def scan_times(scenario: Scenario, sensors: list[SensorSettings], source: int, seed: int) -> Indices:
    """Return the instants at which a sensor measures, ns of the log's clock, in order.

    Several sensors start evenly spread over their cycle. Each instant deviates from the regular raster by a normally
    distributed error, limited to a quarter of a cycle.
    """
    cycle = sensors[source].cycle_time
    lag = cycle * source / len(sensors)
    count = max(math.ceil((scenario.duration - lag) / cycle - 1e-9), 0)
    error = scenario.measurement.cycle_jitter * stream(seed, source, "cycle").standard_normal(count)
    seconds = lag + cycle * np.arange(count) + np.clip(error, -cycle / 4, cycle / 4)
    return np.asarray(start_ns(scenario) + np.rint(seconds * 1e6).astype(np.int64) * _MICROSECOND)


def stamps(
    measured_ns: int, count: int, settings: SensorSettings, frames: Transmission, random: np.random.Generator
) -> Indices:
    """Return the time stamps of a scan's frames, ns, in order, shape (count,).

    The first frame (or the last, according to the sensor's `time_from`) follows the measurement by the sensor's
    latency, and what of it is unknown; the others are spread over the burst at random. Frames of a batch have the time
    at which it ends.
    """
    burst = min(frames.burst, _LARGEST_BURST * settings.cycle_time)
    after = np.sort(random.random(count)) * burst
    if count:
        after -= after[0] if settings.time_from == "first" else after[-1]
    delay = random.exponential(1.0, count) * frames.jitter
    micro = np.rint((after + settings.latency + frames.latency + delay) * 1e6).astype(np.int64)
    return batched(np.asarray(measured_ns + np.sort(micro) * _MICROSECOND), frames)


def batched(times_ns: Indices, frames: Transmission) -> Indices:
    """Return the times at which an adapter hands on frames that come at these times, ns."""
    batch = 0 if frames.faults is None else round(frames.faults.batch * 1e6) * _MICROSECOND
    return np.asarray(-(-times_ns // batch) * batch) if batch else times_ns
