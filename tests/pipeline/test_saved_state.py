"""The state of a pipeline, stored and given to another: what comes after it is the same to the byte."""

from __future__ import annotations

import json
import os
import pickle
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from itertools import islice
from operator import itemgetter
from pathlib import Path
from types import MethodType
from typing import Any

import numpy as np
import pytest

import candaemon
from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.can_io.logs.read import read_log
from candaemon.can_io.logs.stream import LogCounts
from candaemon.config.tracker import TrackerSettings
from candaemon.errors import InputError
from candaemon.frames.frame import Frame
from candaemon.pipeline.handover import hand_over
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state import Snapshots, begun, dump, header_of, restore
from candaemon.pipeline.saved_state.places import FUNCTIONS
from candaemon.pipeline.saved_state.skeleton import Skeleton
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate
from tests.support.bound import binding
from tests.support.paths import ROOT

CONFIGS = ("demo", "ars408_to_esr", "esr_ins_fd", "toyota_rav4")
ESTIMATORS: tuple[dict[str, Any], ...] = (
    {"kind": "ct"},
    {"kind": "switching"},
    {"kind": "information"},
    {"kind": "federated", "measurement_noise": {"kind": "window"}},
    {"kind": "imm", "measurement_noise": {"kind": "variational"}},
)


def simulated(of: Binding, seconds: float = 2.0) -> list[Frame]:
    scenario = load_scenario(ROOT / "config" / "scenarios" / "highway.yaml")
    return list(simulate(scenario.model_copy(update={"duration": seconds}), of, 5).frames())


def told(pipeline: Pipeline, frames: Sequence[Frame]) -> list[Frame]:
    return [frame for cycle in pipeline.run(frames) for frame in cycle.frames]


def ended(pipeline: Pipeline) -> list[Frame]:
    return [frame for cycle in pipeline.finish() for frame in cycle.frames]


def goes_on_alike(of: Binding, frames: Sequence[Frame], cuts: Sequence[int]) -> None:
    whole = Pipeline(of)
    expected = told(whole, frames) + ended(whole)
    pipeline, found, snapshots = Pipeline(of), [], Snapshots(Pipeline(of))
    for begin, end in zip((0, *cuts), (*cuts, len(frames)), strict=True):
        state = snapshots.dump(pipeline)
        pipeline = Pipeline(of)
        snapshots.restore(pipeline, state)
        found += told(pipeline, frames[begin:end])
    assert found + ended(pipeline) == expected
    assert len(expected) > 100
    assert pipeline.counts == whole.counts
    assert [each.counts for each in pipeline.assemblers] == [each.counts for each in whole.assemblers]


@pytest.mark.parametrize("name", CONFIGS)
def test_a_drive_goes_on_as_if_nothing_had_been(name: str) -> None:
    frames = simulated(binding(name))
    n = len(frames)
    goes_on_alike(binding(name), frames, [n // 20, n // 3 + 7, n // 2 + 1, 4 * n // 5 + 3])


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda each: str(each["kind"]))
def test_a_restored_pipeline_continues_to_the_byte_with_every_estimator(estimator: dict[str, Any]) -> None:
    loaded = binding("demo").loaded
    tracker = TrackerSettings.model_validate({"estimator": estimator})
    of = bind(replace(loaded, config=loaded.config.model_copy(update={"tracker": tracker})))
    frames = simulated(of, 1.2)
    goes_on_alike(of, frames, [len(frames) // 3 + 7, 2 * len(frames) // 3 + 2])


def test_recorded_traffic_goes_on_alike(drive: Path) -> None:
    loaded = binding("toyota_rav4_ins").loaded
    watched = {"max_step": 1, "timeout": 0.3, "max_rate": 1.5}
    sensors = {
        name: sensor.model_copy(update={"protection": sensor.protection.model_copy(update=watched)})
        for name, sensor in loaded.config.sensors.items()
    }
    of = bind(replace(loaded, config=loaded.config.model_copy(update={"sensors": sensors})))
    channels = {name: bus.index for bus in of.buses for name in bus.settings.names_in_logs}
    log = drive / "drive_with_ins.log.gz"
    frames = list(islice(read_log(log, channels, LogCounts()), 16_000))
    goes_on_alike(of, frames, [5_999, 11_001])


def test_a_pipeline_that_took_over_from_another_configuration_is_stored_alike() -> None:
    of = binding("demo")
    other = bind(replace(of.loaded, config=of.settings.model_copy(update={"name": "other"})))
    frames = simulated(of)
    half = len(frames) // 2 + 7
    former, successor = Pipeline(of), Pipeline(other)
    told(former, frames[:half])
    hand_over(former, successor)
    restored = Pipeline(other)
    restore(restored, dump(successor))
    assert told(restored, frames[half:]) == told(successor, frames[half:])


def test_storing_changes_nothing() -> None:
    of = binding("demo")
    frames = simulated(of, 1.0)
    pipeline, other = Pipeline(of), Pipeline(of)
    found = []
    for k in range(0, len(frames), 400):
        dump(pipeline)
        found += told(pipeline, frames[k : k + 400])
    assert found == told(other, frames)
    assert dump(pipeline) == dump(other)


@pytest.mark.parametrize("name", CONFIGS)
def test_every_part_is_of_a_kind_whose_content_is_known(name: str) -> None:
    pipeline = Pipeline(binding(name))
    for part in Skeleton(pipeline, pipeline.binding).parts(pipeline):
        kind = type(part)
        ours = kind.__module__.startswith("candaemon.")
        assert ours or issubclass(kind, (dict, list, set, tuple, deque, MethodType, itemgetter, *FUNCTIONS)), kind


@pytest.mark.parametrize("name", ["demo", "toyota_rav4_ins"])
def test_no_array_is_a_window_into_another(name: str) -> None:
    # a window would be an array of its own once it is given back
    pipeline = Pipeline(binding(name))
    told(pipeline, simulated(binding(name), 1.0))
    skeleton = Skeleton(Pipeline(binding(name)), pipeline.binding)
    contents = [content for _, content in skeleton.contents(skeleton.parts(pipeline))]
    arrays = {
        id(value): value
        for content in contents
        for value in (content.values() if isinstance(content, dict) else content)
        if isinstance(value, np.ndarray) and value.size and value.flags.writeable
    }
    listed = list(arrays.values())
    shared = [(a.shape, b.shape) for k, a in enumerate(listed) for b in listed[:k] if np.shares_memory(a, b)]
    assert not shared


def written(header: dict[str, Any], content: bytes) -> bytes:
    return json.dumps(header | {"sha256": sha256(content).hexdigest()}).encode() + b"\n" + content


class Foreign:
    """What a file from somebody else may hold."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.mark}",)


def test_a_state_from_somebody_else_runs_no_code(tmp_path: Path) -> None:
    of = binding("demo")
    header = json.loads(dump(Pipeline(of)).partition(b"\n")[0])
    mark = tmp_path / "ran"
    with pytest.raises(InputError, match=r"it asks for posix\.system"):
        restore(Pipeline(of), written(header, pickle.dumps(Foreign(mark))))
    assert not mark.exists()
    for name in (
        "builtins\neval",
        "candaemon.can_io.logs.write\nCandumpWriter",
        "candaemon.ego.motion\nhypot",
        "candaemon.config.load\nPath",
    ):
        with pytest.raises(InputError, match=r"it asks for .*--fresh"):
            restore(Pipeline(of), written(header, b"c" + name.encode() + b"\n."))
    for content in (b"", b"garbage", pickle.dumps([(0, {"nothing": 1})]), pickle.dumps([(10**6, {})]), pickle.dumps(7)):
        with pytest.raises(InputError, match="cannot be read"):
            restore(Pipeline(of), written(header, content))


def called(what: bytes, *arguments: str) -> bytes:
    """Return a pickle that puts an object on the stack and calls it with texts."""
    texts = b"".join(b"X" + len(text).to_bytes(4, "little") + text.encode() for text in arguments)
    return b"\x80\x02" + what + b"(" + texts + b"tR."


def at(*way: tuple[str, str]) -> bytes:
    """Return the opcodes that put on the stack what lies at a place of the binding."""
    return pickle.dumps(("binding", way), protocol=2)[2:-1] + b"Q"


def test_a_state_from_somebody_else_leads_nowhere_but_to_the_pipeline(tmp_path: Path) -> None:
    of = binding("demo")
    header = json.loads(dump(Pipeline(of)).partition(b"\n")[0])
    mark = tmp_path / "ran"
    builtins = [("attribute", name) for name in ("__class__", "__init__", "__globals__")]
    method_of = b"ccandaemon.pipeline.saved_state.pickling\nmethod_of\n"
    path = at(("attribute", "loaded"), ("attribute", "path"))
    for content in (
        called(at(*builtins, ("item", "__builtins__"), ("item", "exec")), f"open({str(mark)!r}, 'w')"),
        called(at(("attribute", "__class__"))),
        called(method_of + path, "unlink"),
        b"\x80\x02" + method_of + path + b"X\x04\0\0\0stat\x86R)R.",
        b"\x80\x02" + method_of + b"ccandaemon.config.settings\nConfig\nX\x09\0\0\0parse_raw\x86R.",
        pickle.dumps(("part", 10**6), protocol=2)[:-1] + b"Q.",
        pickle.dumps(("part", 0, 0), protocol=2)[:-1] + b"Q.",
    ):
        with pytest.raises(InputError, match="cannot be read"):
            restore(Pipeline(of), written(header, content))
    assert not mark.exists()


def test_what_does_not_fit_is_refused_with_what_differs(tmp_path: Path) -> None:
    of = binding("demo")
    state = dump(Pipeline(of))
    assert header_of(state).version == candaemon.__version__
    slower = of.settings.sensors["front"].model_copy(update={"cycle_time": 0.06})
    other = bind(replace(of.loaded, config=of.settings.model_copy(update={"sensors": {"front": slower}})))
    with pytest.raises(InputError, match=r"sensors\.front\.cycle_time was 0\.05, is 0\.06.*--fresh"):
        restore(Pipeline(other), state)
    header, content = state.split(b"\n", 1)
    for key, text in (("version", "9.9.9"), ("structure", "another build")):
        changed = json.loads(header) | {key: "9.9.9"}
        with pytest.raises(InputError, match=text):
            restore(Pipeline(of), written(changed, content))
    with pytest.raises(InputError, match="damaged"):
        restore(Pipeline(of), state[:-1])
    with pytest.raises(InputError, match="no stored state"):
        restore(Pipeline(of), b"\x00garbage")
    path = tmp_path / "a.state"
    with pytest.raises(InputError, match=r"a\.state: the state cannot be read"):
        begun(of, path)
    path.write_bytes(state[:-1])
    with pytest.raises(InputError, match=r"a\.state: .*damaged"):
        begun(of, path)


def test_what_a_replay_may_change_is_no_difference() -> None:
    of = binding("demo")
    buses = {name: bus.model_copy(update={"channel": f"v{name}"}) for name, bus in of.settings.buses.items()}
    other = bind(replace(of.loaded, config=of.settings.model_copy(update={"buses": buses, "description": "mine"})))
    restore(Pipeline(other), dump(Pipeline(of)))
