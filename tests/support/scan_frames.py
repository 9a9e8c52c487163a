"""Frames of simulated cycles for the tests of scans."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from candaemon.binding.bind_sensor import bind_sensor_writer
from candaemon.binding.bound import BoundSensor
from candaemon.config.sensors import TimeoutScan, TriggerScan
from candaemon.radar.assembler_factory import make_assembler
from candaemon.radar.assembly import ScanAssembler
from candaemon.radar.scan import Scan
from tests.support.bound import binding

FRAME_NS = 100_000
"""Between two frames of a cycle."""
KINDS = ("toyota_rav4", "esr_ins", "tesla_continental", "gm_lrr", "ars408", "timeout", "trigger")
UNMARKED = ("toyota_rav4", "esr_ins", "timeout")
"""Kinds whose scans consist of objects' frames only, in any order."""


class Sent(NamedTuple):
    time_ns: int
    can_id: int
    data: bytes


@cache
def sensor(kind: str) -> BoundSensor:
    """Return a sensor of a configuration; `timeout` and `trigger` are an ESR whose scans are told otherwise."""
    if kind == "timeout":
        esr = sensor("esr_ins")
        return dataclasses.replace(
            esr, settings=esr.settings.model_copy(update={"scan": TimeoutScan(close="timeout")}), counters=()
        )
    if kind == "trigger":
        esr = sensor("esr_ins")
        scan = TriggerScan(close="trigger", message="ESR_Status")
        return dataclasses.replace(
            esr,
            settings=esr.settings.model_copy(update={"scan": scan}),
            counters=(),
            trigger=esr.database.message("ESR_Status"),
        )
    return binding(kind).sensors[0]


@cache
def cycle(kind: str, number: int, objects: int = 9) -> tuple[tuple[int, bytes], ...]:
    """Return the frames of a cycle in their natural order; header first, trigger last."""
    bound = sensor(kind)
    listed, writer = bound.reader.multiplexed, bind_sensor_writer(bound)
    slots = np.arange(objects if listed else bound.reader.slots)
    n = len(slots)
    values: dict[str, NDArray[np.float64]] = {name: np.full(n, 1.5) for name in writer.quantities}
    values |= dict.fromkeys({"azimuth"} & set(values), np.full(n, 0.5))  # no signal tells 1.5 rad
    values |= dict.fromkeys({"x", "range"} & set(values), 20.0 + slots + np.float64(number))
    frames = writer.write(slots, values, slots < objects, counter=number, new=slots == number)
    if bound.header is not None:
        frames.insert(0, bound.header.write(objects, number))
    if kind == "trigger" and bound.trigger is not None:
        frames.append((bound.trigger.can_id, bytes(8)))
    return tuple(frames)


def timed(kind: str, number: int, frames: Iterable[tuple[int, bytes]]) -> list[Sent]:
    start = round(number * sensor(kind).settings.cycle_time * 1e9)
    return [Sent(start + k * FRAME_NS, *frame) for k, frame in enumerate(frames)]


def run(assembler: ScanAssembler, frames: Iterable[Sent]) -> list[Scan]:
    scans: list[Scan | None] = []
    for time_ns, can_id, data in frames:
        scans.append(assembler.expire(time_ns))
        receive, part, slot = assembler.routes[can_id]
        scans.append(receive(part, slot, data, time_ns))
    scans.append(assembler.flush())
    return [scan for scan in scans if scan is not None]


def same(a: Scan, b: Scan) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("object_id", "slot", "new", "values"))


@cache
def whole(kind: str, number: int) -> Scan:
    """Return the scan of an undisturbed cycle."""
    (scan,) = run(make_assembler(sensor(kind)), timed(kind, number, cycle(kind, number)))
    return scan
