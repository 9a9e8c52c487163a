"""Random payloads under the right ids, through the whole pipeline of every configuration."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator

import pytest
from bound import binding
from builders import assert_sane, ns

from candaemon.bus.frame import Frame
from candaemon.pipeline import Pipeline

CONFIGS = ("toyota_rav4", "toyota_rav4_ins", "demo", "esr_ins", "gm_lrr", "tesla_continental", "ars408")


def noise_frames(config: str, count: int, seed: int) -> Iterator[Frame]:
    """Yield frames of the right ids and lengths, mostly; random payloads; checksums that hold, mostly; time goes on."""
    bound, rng = binding(config), random.Random(seed)  # noqa: S311 - test data
    kinds = [
        (bus.index, can_id, message.length)
        for bus in bound.buses
        for database in bound.databases.values()
        for can_id, message in database.by_id.items()
        if can_id in bus.can_ids
    ]
    protectors = {
        can_id: protector
        for sensor in bound.sensors
        for part, protector in zip(sensor.reader.parts, sensor.protectors, strict=True)
        for can_id in (message.can_id for message in part.messages)
    }
    time_ns, fixed = ns(1.7e9), bytes(64)
    for k in range(count):
        if k % 97 == 0:  # payloads of a scan differ little from one another: scans of many objects come of it
            fixed = rng.randbytes(64)
        time_ns += rng.choice((0, 200_000, 500_000, 500_000, 3_000_000))
        if rng.random() < 1e-3:
            time_ns += rng.choice((ns(0.3), ns(3.0), -ns(0.04)))
        bus, can_id, length = rng.choice(kinds)
        data = bytearray(rng.randbytes(length) if rng.random() < 0.2 else fixed[:length])
        for _ in range(3):
            if data:
                data[rng.randrange(len(data))] = rng.getrandbits(8)
        if rng.random() < 0.01:
            del data[rng.randrange(length + 1) :]
        protector = protectors.get(can_id)
        if protector is not None and len(data) == length and rng.random() < 0.98:
            data = bytearray(protector.seal(can_id, bytes(data)))
        yield Frame(time_ns, bus, can_id, bytes(data))


RANDOM_FRAMES = int(os.environ.get("CANDAEMON_RANDOM_FRAMES", "100000"))
"""Over all configurations; 10⁶ and more are a campaign of their own."""


@pytest.mark.parametrize("config", CONFIGS)
def test_random_payloads_never_break_it(config: str) -> None:
    count = RANDOM_FRAMES // len(CONFIGS)
    pipeline = Pipeline(binding(config))
    largest = 0
    for cycle in pipeline.run(noise_frames(config, count, seed=5)):
        told = cycle.obstacles
        assert_sane(told)
        largest = max(largest, len(told))
        assert len(told) <= binding(config).settings.tracker.max_tracks
        assert all(0 < len(frame.data) <= 8 for frame in cycle.frames)
    assert pipeline.counts.cycles > 100
    assert largest > 3
    assert sum(bus.frames for bus in pipeline.counts.buses) == count
