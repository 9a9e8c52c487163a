"""The state of a pipeline, stored and given to another: what comes after it is the same to the byte."""

from __future__ import annotations

import json
import os
import pickle
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass, make_dataclass, replace
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias

import msgpack
import numpy as np
import pytest
from numpy.typing import NDArray

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
from candaemon.pipeline.saved_state.codec import MOST_BYTES, decoded, encoded
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate
from tests.fuzz.fuzz_state import fuzz_state
from tests.support.bound import binding
from tests.support.paths import ROOT

Tree: TypeAlias = dict[str, Any]

CONFIGS = ("demo", "ars408_to_esr", "esr_ins_fd", "toyota_rav4")
ESTIMATORS: tuple[dict[str, Any], ...] = (
    {"kind": "ct"},
    {"kind": "switching"},
    {"kind": "information"},
    {"kind": "federated", "measurement_noise": {"kind": "window"}},
    {"kind": "mlkf"},
    {"kind": "imm", "measurement_noise": {"kind": "variational"}},
)


def simulated(of: Binding, seconds: float = 2.0, name: str = "highway") -> list[Frame]:
    scenario = load_scenario(ROOT / "config" / "scenarios" / f"{name}.yaml")
    return list(simulate(scenario.model_copy(update={"duration": seconds}), of, 5).frames())


def told(pipeline: Pipeline, frames: Sequence[Frame]) -> list[Frame]:
    return [frame for cycle in pipeline.run(frames) for frame in cycle.frames]


def ended(pipeline: Pipeline) -> list[Frame]:
    return [frame for cycle in pipeline.finish() for frame in cycle.frames]


def goes_on_alike(of: Binding, frames: Sequence[Frame], cuts: Sequence[int]) -> None:
    whole = Pipeline(of)
    expected = told(whole, frames) + ended(whole)
    pipeline, found, snapshots = Pipeline(of), [], Snapshots(of)
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


def test_what_was_learnt_of_a_sensors_noise_goes_on() -> None:
    of = binding("toyota_rav4")
    frames = simulated(of, 8.0, "traffic_motorway")
    goes_on_alike(of, frames, range(997, len(frames), 997))


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


def arrays(state: object) -> Iterator[NDArray[Any]]:
    """Yield the arrays that a state holds."""
    if isinstance(state, np.ndarray):
        yield state
    elif is_dataclass(state):
        for field in fields(state):
            yield from arrays(getattr(state, field.name))
    elif isinstance(state, dict):
        for value in state.values():
            yield from arrays(value)
    elif isinstance(state, list | tuple | deque):
        for value in state:
            yield from arrays(value)


@pytest.mark.parametrize("name", ["demo", "toyota_rav4_ins"])
def test_no_array_is_a_window_into_another(name: str) -> None:
    # a window would be an array of its own once it is given back
    pipeline = Pipeline(binding(name))
    told(pipeline, simulated(binding(name), 1.0))
    found = [each for each in arrays(pipeline.state) if each.size]
    assert len(found) > 10
    shared = [(a.shape, b.shape) for k, a in enumerate(found) for b in found[:k] if np.shares_memory(a, b)]
    assert not shared


def written(header: dict[str, Any], content: bytes) -> bytes:
    return json.dumps(header | {"sha256": sha256(content).hexdigest()}).encode() + b"\n" + content


class Foreign:
    """What a pickle may hold."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, (f"touch {self.mark}",)


def test_a_pickle_is_refused(tmp_path: Path) -> None:
    of = binding("demo")
    header = json.loads(dump(Pipeline(of)).partition(b"\n")[0])
    mark = tmp_path / "ran"
    foreign = pickle.dumps(Foreign(mark))
    with pytest.raises(InputError, match=r"the state cannot be read \(state has 0 fields, expected 14\).*--fresh"):
        restore(Pipeline(of), written(header, foreign))
    with pytest.raises(InputError, match="found 'candaemon state 1', expected 'candaemon state 2'; use --fresh"):
        restore(Pipeline(of), written(header | {"format": "candaemon state 1"}, foreign))
    with pytest.raises(InputError, match="no stored state"):
        restore(Pipeline(of), foreign)
    assert not mark.exists()


def test_a_state_that_is_none_is_refused() -> None:
    of = binding("demo")
    sound = dump(Pipeline(of))
    header = json.loads(sound.partition(b"\n")[0])
    longer = sound.partition(b"\n")[2] + b"\x00"
    for content in (b"", b"garbage", b"\x80", b"\xdf\xff\xff\xff\xff", b"\x91" * 100_000, longer):
        with pytest.raises(InputError, match="cannot be read"):
            restore(Pipeline(of), written(header, content))
    for line in (b"[" * 100_000, b"{}", b"1e999", b" " * (1 << 20) + b"{}"):
        with pytest.raises(InputError, match="no stored state"):
            restore(Pipeline(of), line + b"\n")
    with pytest.raises(InputError, match="more than"):
        restore(Pipeline(of), bytes(MOST_BYTES + 1))


REFUSED: dict[str, Callable[[Tree], object]] = {
    "state.health has 2 fields, expected 3": lambda tree: tree["health"].pop("drops"),
    "state.health has 4 fields, expected 3": lambda tree: tree["health"].update(more=1),
    "state.health has a field 'dropps', expected 'drops'": lambda tree: _renamed(tree["health"], "drops", "dropps"),
    "state.schedule.deadline_ns is a float, expected int": lambda tree: tree["schedule"].update(deadline_ns=1.5),
    "state.schedule.deadline_ns is a bool, expected int": lambda tree: tree["schedule"].update(deadline_ns=True),
    "state.schedule.deadline_ns is beyond 62 bits": lambda tree: tree["schedule"].update(deadline_ns=1 << 63),
    "other stages than the configuration's": lambda tree: tree.update(encoder=None),
    "state.trackers is no dictionary": lambda tree: tree.update(trackers=[]),
    "other slots than 0 to 31": lambda tree: tree["encoder"]["slots"]["free"].append(3),
    "is an array of int8, expected int64": lambda tree: _array(tree).__setitem__(0, "int8"),
    "expected int64": lambda tree: _array(tree).__setitem__(0, "float64"),
    "has 8 bytes, which is not its shape": lambda tree: _array(tree).__setitem__(3, bytes(8)),
    "has the shape": lambda tree: _array(tree).__setitem__(slice(1, 4), [[1], [0], bytes(8)]),
    "has no shape": lambda tree: _array(tree).__setitem__(2, [1]),
    "other buses or sensors": lambda tree: tree["counts"]["buses"].pop(),
}


def _renamed(tree: Tree, old: str, new: str) -> None:
    items = [(new if key == old else key, value) for key, value in tree.items()]
    tree.clear()
    tree.update(items)


def _array(tree: Tree) -> list[Any]:
    array: list[Any] = tree["encoder"]["sent"]
    return array


@pytest.mark.parametrize("message", REFUSED)
def test_what_no_pipeline_comes_to_is_refused(message: str) -> None:
    of = binding("demo")
    head, _, content = dump(Pipeline(of)).partition(b"\n")
    tree = msgpack.unpackb(content, strict_map_key=False)
    REFUSED[message](tree)
    with pytest.raises(InputError, match=re.escape(message)):
        restore(Pipeline(of), written(json.loads(head), msgpack.packb(tree)))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_pipeline_goes_on_with_whatever_it_takes() -> None:
    # `python -m tests.fuzz --only state` goes on for as long as it is asked to
    for seed in range(200):
        fuzz_state(np.random.default_rng(seed).bytes(64))


@pytest.mark.parametrize("array", [
    np.arange(24.0).reshape(2, 3, 4).transpose(2, 0, 1), np.asfortranarray(np.eye(3)), np.zeros((0, 3)),
    np.arange(9)[::2], np.array([True, False]), np.array([1 + 2j]), np.array(3.0), np.array([-0.0, 5e-324]),
], ids=str)  # fmt: skip
def test_an_array_comes_back_as_it_lies_in_memory(array: NDArray[Any]) -> None:
    kind = make_dataclass("Kind", [("array", NDArray[array.dtype.type])])  # type: ignore[name-defined]
    found = decoded(kind, encoded(kind(array)), kind(array[:0] if array.ndim else array)).array
    assert found.dtype == array.dtype
    assert found.tobytes() == array.tobytes()
    assert found.flags.writeable

    def order(of: NDArray[Any]) -> list[int]:
        return sorted(range(of.ndim), key=lambda axis: -abs(of.strides[axis]))

    assert order(found) == order(array)


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
