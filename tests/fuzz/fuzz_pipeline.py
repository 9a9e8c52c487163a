"""Frames from the fuzzer's bytes through whole pipelines: identifiers that are asked for, any payload, any time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from candaemon.can_io.reorder import ReorderBuffer
from candaemon.frames.frame import Frame, Tick
from candaemon.pipeline.pipeline import Pipeline

from .campaign import CONFIGS, binding
from .drawn import Drawn
from .invariants import Watch
from .traffic import Kind, kinds_of, protectors_of

_START_NS = 1_700_000_000_000_000_000
_STEPS_NS = (0, 500_000, 500_000, 1_000_000, 3_000_000, 20_000_000, 50_000_000, 300_000_000, -40_000_000,
             -1_000_000_000, 3_600_000_000_000, -3_600_000_000_000)  # fmt: skip
_FRAME_NS = 500_000
_MOST = 400


def fuzz_pipeline(data: bytes) -> Counter[str]:
    """Run a configuration and hold what must be true of every cycle; the same again gives the same."""
    (digest, counts), (again, _) = _ran(data), _ran(data)
    assert digest == again, "the same frames gave something else"
    return counts


def _ran(data: bytes) -> tuple[str, Counter[str]]:
    drawn = Drawn(data)
    bound = binding(drawn.choice(CONFIGS))
    protectors = protectors_of(bound)
    pipeline, watch = Pipeline(bound), Watch(bound)
    sequence = ReorderBuffer(
        round(bound.settings.ordering_window * 1e9), max_gap_ns=drawn.choice((None, 1_000_000_000))
    )
    items = list(_items(drawn, kinds_of(bound)))
    sealed = [
        item._replace(data=protectors[item.bus, item.can_id].seal(item.can_id, item.data))
        if isinstance(item, Frame) and (item.bus, item.can_id) in protectors and len(item.data) >= 8
        else item
        for item in items
    ]
    ordered = [each for item in sealed for each in sequence.push(item)] + sequence.flush()
    for cycle in pipeline.run(ordered):
        watch.take(cycle)
    for cycle in pipeline.finish():
        watch.take(cycle)
    watch.finish()
    assert sum(bus.frames for bus in pipeline.counts.buses) == sum(isinstance(item, Frame) for item in items)
    counts = pipeline.counts
    frames = sum(bus.frames for bus in counts.buses)
    return watch.outputs.hexdigest(), Counter(frames=frames, cycles=counts.cycles, sent=counts.sent)


def _items(drawn: Drawn, kinds: list[Kind]) -> Iterator[Frame | Tick]:
    """Yield what the bytes say: a run of identifiers with payloads that change little, a tick, or a jump in time."""
    time_ns, payload, count = _START_NS, bytes(64), 0
    while drawn and count < _MOST:
        payload = drawn.taken(8) + payload[8:] if drawn.flag() else payload
        step_ns = drawn.choice(_STEPS_NS)
        first, several = drawn.integer(0, len(kinds) - 1), drawn.integer(0, 40)
        time_ns += step_ns
        count += max(several, 10)  # each jump ahead may cost many coasting cycles
        if not several:
            yield Tick(time_ns)
        for kind in (kinds * 2)[first : first + several]:
            time_ns += _FRAME_NS
            yield Frame(time_ns, kind.bus, kind.can_id, payload[: kind.length])
