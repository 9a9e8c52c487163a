"""Scenarios with anything in them: refused by name and line, or their frames are those of CAN."""

from __future__ import annotations

from collections import Counter
from functools import cache
from itertools import islice
from pathlib import Path

from candaemon.errors import ConfigError
from candaemon.frames.frame import EXTENDED
from candaemon.frames.frame_block import FD_LENGTHS
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate

from .campaign import binding
from .drawn import Drawn
from .fuzz_configuration import YAML_WORDS
from .invariants import hold_place
from .scratch import scratch

_SCENARIOS = Path(__file__).resolve().parents[2] / "config" / "scenarios"
_CONFIGS = ("demo", "toyota_rav4_ins", "ars408")
_FRAMES = 400
_CYCLES = 5
_WORDS = (*YAML_WORDS, b"1e300", b"-1e300", b"1e-300", b"9007199254740993", b"86400", b"\n  - {", b"}", b"speed: 0",
          b"until: 1", b"duration: 1e-9", b"ax: 1", b"yaw_rate_deg: 90", b"rcs: 1e9", b"spacing: 1e-9")  # fmt: skip


def fuzz_scenarios(data: bytes) -> Counter[str]:
    """Load a scenario and simulate how it begins."""
    drawn = Drawn(data)
    edited, config = drawn.integer(0, 7) > 0, drawn.choice(_CONFIGS)
    path = scratch() / "scenario.yaml"
    path.write_bytes(drawn.edited(drawn.choice(_texts()), _WORDS) if edited else drawn.rest())
    try:
        simulation = simulate(load_scenario(path), binding(config))
        time_ns, frames = -(1 << 62), 0
        for frame in islice(simulation.frames(), _FRAMES):
            assert frame.time_ns >= time_ns, f"time went back from {time_ns} to {frame.time_ns}"
            assert abs(frame.time_ns) < 2**63, frame.time_ns
            assert frame.can_id <= (EXTENDED | 0x1FFF_FFFF), hex(frame.can_id)
            assert len(frame.data) in FD_LENGTHS
            time_ns, frames = frame.time_ns, frames + 1
        cycles = sum(1 for _ in islice(simulation.truth(), _CYCLES))
    except ConfigError as error:
        hold_place(error)
        return Counter(edited=edited, refused=1)
    return Counter(edited=edited, accepted=1, frames=frames, cycles=cycles)


@cache
def _texts() -> tuple[bytes, ...]:
    return tuple(path.read_bytes() for path in sorted(_SCENARIOS.glob("*.yaml")))
