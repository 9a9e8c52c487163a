"""A log taken block by block gives what it gives frame by frame, whatever was lost, doubled, late or cut short."""

from __future__ import annotations

import random
import re
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.can_io.logs.candump import ChunkDecoder, candump_text
from candaemon.can_io.logs.read import read_log, read_log_blocks
from candaemon.can_io.logs.stream import TICK_BUS, TICK_CHANNEL, ChannelMap, LogCounts
from candaemon.can_io.logs.write import open_log_writer
from candaemon.can_io.reorder import ItemBlock, ReorderBuffer, TimedItem
from candaemon.config.load import load_config
from candaemon.files.outputs import OutputFile
from candaemon.frames.frame import Frame, Tick
from candaemon.frames.frame_block import FrameBlock, block_of
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.ego_frames import EgoFrames
from candaemon.pipeline.pipeline import Pipeline
from candaemon.radar.counter_assembler import CounterAssembler
from candaemon.simulation.scenario import Scenario, load_scenario
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding
from tests.support.effort import examples
from tests.support.paths import ROOT

CONFIGS = ("esr_ins", "two_radars", "toyota_rav4", "gm_lrr", "ars408", "tesla_continental")
BUSES = ["can0", "can1", "can2", "can3"]
NAMES = [*BUSES, TICK_CHANNEL, "none"]  # a tick's bus counts from the end

DAMAGE = ("loss", "twice", "late", "short", "change", "gap", "foreign", "tick")


@cache
def bound(config: str) -> Binding:
    return two_radars() if config == "two_radars" else binding(config)


def two_radars() -> Binding:
    """Bind an ESR and a slower one beside it, on a bus of its own."""
    text = (ROOT / "config" / "esr_ins.yaml").read_text().replace("../dbc", str(ROOT / "dbc"))
    told = yaml.safe_load(text)
    told["buses"]["other"] = {"channel": "can9"}
    told["sensors"]["second"] = told["sensors"]["front"] | {"bus": "other", "cycle_time": 0.07}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "two.yaml"
        path.write_text(yaml.safe_dump(told))
        return bind(load_config(path))


def long_messages(folder: Path) -> Binding:
    """Bind a radar whose messages have 12 bytes, the last one a checksum."""
    shutil.copytree(ROOT / "dbc", folder / "dbc")
    dbc = folder / "dbc" / "chrysler_pacifica.dbc"
    text = re.sub(r"(BO_ \d+ [cd]_\d+: )8", r"\g<1>12", dbc.read_text())
    dbc.write_text(re.sub(r"(BO_ \d+ [cd]_\d+: 12.*\n)", r'\g<1> SG_ SUM : 88|8@1+ (1,0) [0|255] "" XXX\n', text))
    told = yaml.safe_load((ROOT / "config" / "chrysler_pacifica.yaml").read_text())
    told["buses"]["radar"]["fd"] = True
    told["sensors"]["front"]["protection"] = {"kind": "additive", "checksum": "SUM"}
    path = folder / "config" / "long.yaml"
    path.parent.mkdir()
    path.write_text(yaml.safe_dump(told))
    return bind(load_config(path))


@cache
def drive(config: str) -> tuple[Frame, ...]:
    """Return two seconds of traffic."""
    told = load_scenario(ROOT / "config" / "scenarios" / "turning_ego.yaml").model_dump() | {"duration": 2.0}
    return tuple(simulate(Scenario.model_validate(told), bound(config)).frames())


def damaged(frames: Sequence[Frame], seed: int) -> Iterator[Frame]:
    """Lose, double, swap, cut short, change, delay and hold back a few frames; put in ticks and foreign ones."""
    rng = random.Random(seed)  # noqa: S311 - test data
    share = rng.choice((0.0, 0.001, 0.01))
    silent_until_ns = 0
    late: list[Frame] = []
    for frame in frames:
        if frame.time_ns < silent_until_ns:
            continue
        for each in [each for each in late if frame.time_ns > each.time_ns + 2_000_000]:
            late.remove(each)
            yield each._replace(time_ns=frame.time_ns)
        kind = rng.choice(DAMAGE) if rng.random() < share else ""
        if kind == "late":
            late.append(frame)
        elif kind == "short":
            yield frame._replace(data=frame.data[: rng.randrange(len(frame.data))])
        elif kind == "change":
            data = bytearray(frame.data)
            data[rng.randrange(len(data))] = rng.getrandbits(8)
            yield frame._replace(data=bytes(data))
        elif kind == "gap":
            silent_until_ns = frame.time_ns + rng.choice((20, 60, 200, 700)) * 1_000_000
        elif kind != "loss":
            yield frame
        if kind == "twice":
            yield frame
        elif kind == "foreign":
            yield frame._replace(can_id=0x7FE)
        elif kind == "tick":
            yield Frame(frame.time_ns, TICK_BUS, 0, b"")


def blocks_of(frames: Sequence[Frame], size: int = 1000) -> Iterator[FrameBlock]:
    """Cut frames into blocks."""
    channels = ChannelMap({name: bus for bus, name in enumerate(BUSES)})
    for begin in range(0, len(frames), size):
        yield ChunkDecoder(candump_text(frames[begin : begin + size], NAMES), channels, LogCounts()).decode()


def told(pipeline: Pipeline, cycles: Iterable[Cycle]) -> list[object]:
    """Return all that a pipeline says, and what it counts."""
    said: list[object] = [
        (cycle.time_ns, cycle.pose, tuple(cycle.frames), cycle.obstacles.id.tobytes(), cycle.obstacles.x.tobytes())
        for cycle in (*cycles, *pipeline.finish())
    ]
    return [*said, asdict(pipeline.counts), *(asdict(each.counts) for each in pipeline.assemblers)]


def sent(scans: Iterable[tuple[int, int, int]]) -> list[Frame]:
    """Send the first frames of an ESR's scans, of any counter and faster than its cycle, as several senders would.

    Args:
        scans: of each its counter, 0 or 1, how many frames come, and the ms until the next.
    """
    radar = [frame for frame in drive("esr_ins") if 0x500 <= frame.can_id < 0x540]
    time_ns, frames = radar[0].time_ns, list[Frame]()
    for counter, count, gap in scans:
        for frame in radar[64 * counter :][:count]:
            frames.append(frame._replace(time_ns=time_ns))
            time_ns += 50_000
        time_ns += gap * 1_000_000
    return frames


GIVEN_UP = [(0, 1, 0), (1, 1, 29), (0, 64, 0), (1, 64, 0), (0, 64, 0), (1, 64, 0)]
"""A scan that waits, and is given up in the middle of another one."""


@settings(deadline=None, max_examples=examples(40, fewest=20))
@example(scans=GIVEN_UP)
@given(
    scans=st.lists(
        st.tuples(st.integers(0, 1), st.sampled_from((1, 2, 63, 64, 64, 64)), st.sampled_from((0, 0, 20, 29))),
        min_size=20,
        max_size=60,
    )
)
def test_both_ways_tell_the_same_of_a_flood(scans: list[tuple[int, int, int]]) -> None:
    frames = sent(scans)
    by_frame, by_block = Pipeline(bound("esr_ins")), Pipeline(bound("esr_ins"))
    assert told(by_frame, by_frame.run(frames)) == told(by_block, by_block.run_blocks(blocks_of(frames)))


def test_what_is_optional_and_comes_late_is_taken_as_it_is_frame_by_frame(tmp_path: Path) -> None:
    """A scan whose optional frames are not awaited is complete before they come, and they may open another."""
    text = (ROOT / "config" / "toyota_rav4.yaml").read_text().replace("../dbc", str(ROOT / "dbc"))
    path = tmp_path / "patient.yaml"
    path.write_text(text.replace("timeout: 0.035", "timeout: 0.2"))
    of = bind(load_config(path))
    radar = [frame for frame in drive("toyota_rav4") if frame.bus == of.sensors[0].bus]
    part = {can_id: number for can_id, (number, _) in of.sensors[0].reader.routes.items()}
    scans = [radar[begin : begin + 32] for begin in range(0, 160, 32)]
    first, second = ([[each for each in scan if part[each.can_id] == number] for scan in scans] for number in (0, 1))
    sent: list[tuple[list[Frame], float]] = [
        (first[0] + second[0], 0.05), (first[1], 0.4), (first[2], 0.12), (second[2], 0.02), (first[3] + second[3], 0.05)
    ]  # fmt: skip
    frames, time_ns = list[Frame](), radar[0].time_ns
    for some, pause in sent:
        for frame in some:
            frames.append(frame._replace(time_ns=time_ns))
            time_ns += 100_000
        time_ns += round(pause * 1e9)
    by_frame, by_block = Pipeline(of), Pipeline(of)
    assert told(by_frame, by_frame.run(frames)) == told(by_block, by_block.run_blocks(blocks_of(frames)))


@pytest.mark.parametrize("config", CONFIGS)
@settings(deadline=None, max_examples=examples(5, fewest=2))
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from((50, 700, 3000)))
def test_both_ways_tell_the_same(config: str, seed: int, size: int) -> None:
    frames = sorted(damaged(drive(config), seed), key=lambda frame: frame.time_ns)
    by_frame, by_block = Pipeline(bound(config)), Pipeline(bound(config))
    assert told(by_frame, by_frame.run(frames)) == told(by_block, by_block.run_blocks(blocks_of(frames, size)))


@pytest.mark.parametrize("config", ["esr_ins", "two_radars", "toyota_rav4"])
def test_what_came_whole_is_taken_together(config: str, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[int] = []
    begin = CounterAssembler.begin_whole

    def noted(self: CounterAssembler, part: int, slot: int, data: bytes, time_ns: int) -> None:
        taken.append(time_ns)
        begin(self, part, slot, data, time_ns)

    monkeypatch.setattr(CounterAssembler, "begin_whole", noted)
    pipeline = Pipeline(bound(config))
    list(pipeline.run_blocks(blocks_of(drive(config))))
    assert len(taken) > 0.6 * sum(each.counts.scans for each in pipeline.assemblers) > 20


def with_damaged_ego(frames: Sequence[Frame], of: Binding, seed: int) -> Iterator[Frame]:
    """Change, cut short and lose some of the frames of ego motion: by little, or by more than can be."""
    rng = random.Random(seed)  # noqa: S311 - test data
    ego = of.ego
    assert ego is not None
    for frame in frames:
        if frame.bus != ego.bus or frame.can_id not in ego.messages or rng.random() > 0.1:
            yield frame
        elif (kind := rng.choice(("change", "change", "short", "loss"))) == "change":
            data = bytearray(frame.data)
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            yield frame._replace(data=bytes(data))
        elif kind == "short":
            yield frame._replace(data=frame.data[: rng.randrange(len(frame.data))])


@pytest.mark.parametrize("config", ["esr_ins", "toyota_rav4", "toyota_rav4_ins"])
@settings(deadline=None, max_examples=examples(4, fewest=2))
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from((50, 700, 3000)))
def test_frames_of_ego_motion_are_judged_together_as_they_are_alone(config: str, seed: int, size: int) -> None:
    frames = list(with_damaged_ego(drive(config), bound(config), seed))
    by_frame, by_block = Pipeline(bound(config)), Pipeline(bound(config))
    assert told(by_frame, by_frame.run(frames)) == told(by_block, by_block.run_blocks(blocks_of(frames, size)))
    assert by_frame.counts.ego_motion.refused + by_frame.counts.ego_motion_short > 0
    assert by_frame.state.ego_frames == by_block.state.ego_frames
    assert by_frame.ego_signals == by_block.ego_signals


def test_what_is_sure_of_ego_motion_is_not_judged_again(monkeypatch: pytest.MonkeyPatch) -> None:
    alone: list[int] = []
    receive = EgoFrames.receive

    def noted(self: EgoFrames, part: int, slot: int, data: bytes, time_ns: int) -> None:
        alone.append(time_ns)
        receive(self, part, slot, data, time_ns)

    monkeypatch.setattr(EgoFrames, "receive", noted)
    pipeline = Pipeline(bound("esr_ins"))
    list(pipeline.run_blocks(blocks_of(drive("esr_ins"))))
    assert pipeline.ego_signals["heading"] > 100
    assert len(alone) <= len(pipeline.ego_frames)  # the first of each follows nothing


def test_messages_that_are_all_too_short_are_counted(tmp_path: Path) -> None:
    of = long_messages(tmp_path)
    sensor = of.sensors[0]
    frames = [
        Frame(1_000_000_000 + 50_000_000 * scan + 1_000_000 * number, sensor.bus, can_id, bytes([17 * scan]) * 8)
        for scan in range(3)
        for number, can_id in enumerate(sorted(sensor.reader.routes))
    ]
    by_frame, by_block = Pipeline(of), Pipeline(of)
    assert told(by_frame, by_frame.run(frames)) == told(by_block, by_block.run_blocks([block_of(frames)]))
    assert by_block.assemblers[0].counts.short == len(frames)


def items_of(passed: Iterable[ItemBlock]) -> list[TimedItem]:
    """Return what blocks hold, item by item."""
    return [item for each in passed for item in (each.frames() if isinstance(each, FrameBlock) else each)]


def agree(blocks: Sequence[ItemBlock], window_ns: int, max_gap_ns: int | None = None) -> ReorderBuffer:
    """Assert that blocks are put in order as their items one by one are; return what did it."""
    sequence, other = (ReorderBuffer(window_ns, max_gap_ns=max_gap_ns) for _ in range(2))
    passed = items_of(sequence.sequenced_blocks(blocks))
    assert passed == [due for item in items_of(blocks) for due in other.push(item)] + other.flush()
    names = ("late", "reordered", "backward_steps", "forward_steps", "offset_ns")
    assert [getattr(sequence, name) for name in names] == [getattr(other, name) for name in names]
    return sequence


@pytest.mark.parametrize("window_ns", [0, 5_000_000])
def test_a_block_stays_one(window_ns: int) -> None:
    blocks: list[ItemBlock] = [*blocks_of(drive("esr_ins")), [Tick(drive("esr_ins")[-1].time_ns)]]
    agree(blocks, window_ns)
    passed = list(ReorderBuffer(window_ns).sequenced_blocks(blocks))
    assert all(isinstance(each, FrameBlock) for each in passed[:-2])
    assert len(passed) == len(blocks) + 1


@pytest.mark.parametrize("window_ns", [0, 5_000_000])
def test_a_block_out_of_order_is_sorted_as_its_frames_are(window_ns: int) -> None:
    frames = list(drive("esr_ins"))
    frames[700], frames[701] = frames[701], frames[700]
    frames[2000:] = [frame._replace(time_ns=frame.time_ns - 3_600_000_000_000) for frame in frames[2000:]]
    sequence = agree(list(blocks_of(frames)), window_ns)
    assert sequence.backward_steps == 1


@settings(deadline=None, max_examples=examples(200))
@given(
    steps=st.lists(
        st.one_of(
            st.integers(0, 3),
            st.sampled_from((-400, -201, -200, -199, -11, -10, -9, -1, 199, 200, 201, 1500, -3_600_000, 3_600_000)),
        ),
        min_size=1,
        max_size=60,
    ),
    size=st.integers(1, 20),
    window_ms=st.sampled_from((0, 1, 10, 300)),
    max_gap_ns=st.sampled_from((None, 1_000_000_000)),
    tick=st.booleans(),
)
def test_blocks_are_put_in_order_as_their_frames_are(
    steps: list[int], size: int, window_ms: int, max_gap_ns: int | None, tick: bool
) -> None:
    times = 1_533_226_488_000_000_000 + np.cumsum([0, *steps]) * 1_000_000
    frames = [Frame(int(time_ns), index % 4, index, bytes([index])) for index, time_ns in enumerate(times)]
    blocks: list[ItemBlock] = list(blocks_of(frames, size))
    if tick:
        blocks.insert(len(blocks) // 2, [Tick(frames[len(frames) // 2].time_ns)])
    agree(blocks, window_ms * 1_000_000, max_gap_ns)


@pytest.mark.parametrize("suffix", [".log", ".blf", ".asc"])
def test_every_format_comes_in_blocks(tmp_path: Path, suffix: str) -> None:
    path, channels = tmp_path / f"drive{suffix}", {name: bus for bus, name in enumerate(BUSES)}
    with OutputFile(path) as file, open_log_writer(file, BUSES) as writer:
        writer.write(drive("toyota_rav4"))
    counts, others = LogCounts(), LogCounts()
    read: list[Any] = []
    for block in read_log_blocks(path, channels, counts):
        read += block.frames() if isinstance(block, FrameBlock) else block
    assert read == list(read_log(path, channels, others))
    assert counts == others
