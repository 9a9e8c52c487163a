"""Stored states made by somebody who means harm: nothing in them runs, and they cost little time and memory."""

from __future__ import annotations

import ast
import importlib
import json
import logging
import math
import operator
import pickle
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

from candaemon.binding.bound import Binding
from candaemon.errors import InputError
from candaemon.frames.times import NEVER_NS
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state import dump, header_of, restore
from candaemon.pipeline.saved_state.codec import (
    LARGEST,
    LARGEST_INTEGER,
    LONGEST_TEXT,
    MOST_BYTES,
    MOST_DIMENSIONS,
    MOST_ITEMS,
    decoded,
    encoded,
)
from candaemon.pipeline.saved_state.fingerprint import LONGEST_FINGERPRINT, fingerprint
from candaemon.pipeline.saved_state.header import LONGEST_HEADER
from candaemon.playback.recording_files import stem
from candaemon.playback.replay import ReplayRequest, replay
from candaemon.tracking.stationary import DriftAnchor
from tests.fuzz.campaign import binding as fuzzed
from tests.fuzz.drawn import Drawn
from tests.fuzz.fuzz_state import signed, with_other_values
from tests.support.bound import binding
from tests.support.memory import PEAK_MIB
from tests.support.paths import ROOT
from tests.support.recorded import as_log, highway

fingerprint_module = importlib.import_module("candaemon.pipeline.saved_state.fingerprint")  # a function has its name
PICKLES = {"pickle", "_pickle", "cPickle", "cloudpickle", "dill", "joblib", "jsonpickle", "marshal", "shelve"}
CALLS = {"eval", "exec", "compile", "__import__"}
METHODS = {"os.system", "os.popen", "yaml.load", "yaml.unsafe_load", "yaml.full_load", "pd.read_pickle", "np.fromregex"}
BUILT_FROM_NUMBERS = {"candaemon/dbc/single_codec.py"}
"""Compiles an expression of checked numbers for each signal; no text of a file enters it."""


@pytest.fixture(scope="module")
def of() -> Binding:
    return binding("demo")


@pytest.fixture(scope="module")
def sound(of: Binding) -> bytes:
    return state_of(of)


def state_of(of: Binding) -> bytes:
    """Return the state of a pipeline that tracks."""
    pipeline = Pipeline(of)
    for _ in pipeline.run(highway(of, 0.6)):
        pass
    return dump(pipeline)


def code_from_data(path: Path) -> set[str]:
    """Return what a module uses that can turn data into code."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.Import():
                found |= {each.name for each in node.names if each.name.split(".")[0] in PICKLES}
            case ast.ImportFrom(module=str(module)) if module.split(".")[0] in PICKLES:
                found.add(module)
            case ast.Call(func=ast.Name(id=name)) if name in CALLS:
                found.add(name)
            case ast.Call(func=ast.Attribute()) if ast.unparse(node.func) in METHODS:
                found.add(ast.unparse(node.func))
        if isinstance(node, ast.Call):
            found |= {each.arg for each in node.keywords if each.arg in {"allow_pickle", "shell"}}
            if ast.unparse(node.func) in {"np.load", "numpy.load"}:
                found.add("np.load")
    return found


def test_no_module_turns_data_into_code() -> None:
    used = {str(path.relative_to(ROOT)): code_from_data(path) for path in (ROOT / "candaemon").rglob("*.py")}
    assert {path for path, found in used.items() if found} == BUILT_FROM_NUMBERS
    assert not used["candaemon/dbc/single_codec.py"] - CALLS


def test_the_search_finds_what_it_is_for(tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    for text in (
        "import pickle", "from dill import loads", "import marshal as m", "eval(data)", "np.load(f, allow_pickle=True)",
        "os.system(name)", "yaml.load(text)", "import x.y, shelve", "subprocess.run(text, shell=True)",
    ):  # fmt: skip
        path.write_text(text)
        assert code_from_data(path), text


class Calls:
    """What a pickle may hold: a call with any arguments."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.reduced = function, arguments

    def __reduce__(self) -> tuple[Any, ...]:
        return self.reduced


def attacks(mark: Path) -> dict[str, bytes]:
    run = f"open({str(mark)!r}, 'w')"
    holder = np.empty(2, dtype=object)
    holder[:] = [Calls(exec, run), 1]
    return {
        "a call": pickle.dumps(Calls(exec, run)),
        "opcodes": b"cbuiltins\nexec\n(S" + repr(run).encode() + b"\ntR.",
        "an array of objects": pickle.dumps(holder),
        "a method by name": pickle.dumps(Calls(operator.methodcaller("__call__", run), exec)),
        "an extension type": msgpack.packb(msgpack.ExtType(1, pickle.dumps(Calls(exec, run)))),
        "an array's type": msgpack.packb({"counts": ["object", [1], [0], pickle.dumps(Calls(exec, run))]}),
    }


@pytest.mark.parametrize("kind", [*attacks(Path("x"))])
def test_code_beside_a_recording_does_not_run(
    of: Binding, sound: bytes, tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    folder, mark = tmp_path / "ring", tmp_path / "ran"
    folder.mkdir()
    log = folder / f"{stem(10**18, 1)}.log"
    log.write_bytes(as_log(of, highway(of, 0.2)))
    content = attacks(mark)[kind]
    head = json.loads(sound.partition(b"\n")[0]) | {"sha256": sha256(content).hexdigest()}
    older = json.dumps(head | {"format": "candaemon state 1"}).encode()
    for state in (content, json.dumps(head).encode() + b"\n" + content, older + b"\n" + content):
        log.with_suffix(".state").write_bytes(state)
        with pytest.raises(InputError, match=rf"{log.stem}\.(state|log): .*--fresh"):
            replay(of, ReplayRequest(folder))
        assert not mark.exists()
    with caplog.at_level(logging.WARNING):
        assert replay(of, ReplayRequest(folder, fresh=True)).log.frames > 0


BOMBS: dict[str, Callable[[], bytes]] = {
    "many items": lambda: msgpack.packb({"counts": {"buses": [[1] * 1000] * 30_000}}),
    "items that are not there": lambda: b"\x81\xa6counts\xdf\x7f\xff\xff\xff",
    "bytes that are not there": lambda: b"\x81\xa6counts\xc6\x7f\xff\xff\xff" + bytes(100),
    "lists in lists": lambda: b"\x91" * (MOST_BYTES - 100_000),
    "names": lambda: b"\xdf\x03\x00\x00\x00" + b"\xa1x\xc0" * (MOST_BYTES // 4),
    "zeros": lambda: bytes(MOST_BYTES - 100_000),
}

IN_A_PROCESS = f"""
import sys, time
from pathlib import Path
from candaemon.errors import InputError
from candaemon.pipeline.saved_state import begun
from tests.support.bound import binding
of = binding("demo")
for path in sys.argv[1:]:
    began_s = time.process_time()
    try:
        begun(of, Path(path))
        print("taken:", path)
    except InputError as error:
        assert "--fresh" in str(error), error
        assert len(str(error)) < 1000
    print(time.process_time() - began_s)
print({PEAK_MIB})
"""


def test_a_bomb_costs_little_time_and_memory(sound: bytes, tmp_path: Path) -> None:
    head, _, content = sound.partition(b"\n")
    tree = msgpack.unpackb(content, strict_map_key=False, use_list=False)
    tree["ego"]["history"]["samples"] = [[k, *[0.0] * 8] for k in range(1 << 18)]
    bombs = {name: made() for name, made in BOMBS.items()} | {"a long list where one may be": msgpack.packb(tree)}
    paths = [tmp_path / name for name in bombs]
    for path in paths:
        path.write_bytes(signed(head, bombs[path.name]))
    done = subprocess.run(
        [sys.executable, "-c", IN_A_PROCESS, *paths], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    *seconds, megabytes = map(float, done.stdout.split())
    assert len(seconds) == len(bombs)
    assert max(seconds) < 10.0
    assert megabytes < 400


@dataclass
class Held:
    """What a state may hold."""

    text: str = ""
    number: float = 0.0
    integer: int = 0
    array: np.ndarray[Any, np.dtype[np.float64]] = field(default_factory=lambda: np.zeros(0))
    integers: np.ndarray[Any, np.dtype[np.int64]] = field(default_factory=lambda: np.zeros(0, np.int64))
    lists: list[list[int]] = field(default_factory=list)


def is_taken(**values: Any) -> bool:
    held = Held(**values)
    try:
        found = decoded(Held, encoded(held), Held())
    except ValueError:
        return False
    assert str(found) == str(held)
    return True


def test_what_a_state_holds_is_bounded() -> None:
    assert is_taken(text="x" * (LONGEST_TEXT - 3))  # with the three bytes of its length
    assert not is_taken(text="x" * (LONGEST_TEXT + 1))
    assert is_taken(number=math.nextafter(LARGEST, 0))
    assert not any(is_taken(number=number) for number in (LARGEST, -LARGEST, math.inf, math.nan))
    assert not any(is_taken(array=np.array([0.0, number])) for number in (LARGEST, -LARGEST, math.inf, math.nan))
    for integer in (LARGEST_INTEGER, -LARGEST_INTEGER, NEVER_NS, -NEVER_NS):
        assert is_taken(integer=integer)
        assert is_taken(integers=np.array([0, integer]))
    for integer in (LARGEST_INTEGER + 1, -LARGEST_INTEGER - 1, NEVER_NS - 1, -NEVER_NS - 1):
        assert not is_taken(integer=integer)
        assert not is_taken(integers=np.array([0, integer]))


def test_the_items_of_all_lists_together_are_bounded() -> None:
    fixed = 2 * (4 + 1 + 1)  # of the two arrays: type, shape, order and bytes; the shape; the order
    names = 6
    at = MOST_ITEMS - fixed - names - 2
    assert is_taken(lists=[[0] * (at // 2), [0] * (at - at // 2)])
    assert not is_taken(lists=[[0] * (at // 2), [0] * (at - at // 2 + 1)])


def test_the_dimensions_of_an_array_are_bounded() -> None:
    assert is_taken(array=np.zeros(3))
    kinds = {n: np.zeros((1,) * n) for n in (MOST_DIMENSIONS, MOST_DIMENSIONS + 1)}
    for n, array in kinds.items():
        like = Held(array=array)
        if n == MOST_DIMENSIONS:
            assert decoded(Held, encoded(like), like).array.shape == array.shape
        else:
            with pytest.raises(ValueError, match="has no shape"):
                decoded(Held, encoded(like), like)


def test_a_states_length_is_bounded(of: Binding, sound: bytes) -> None:
    head, _, content = sound.partition(b"\n")
    for longer, message in ((0, "the state cannot be read"), (1, "more than 33554432 bytes")):
        state = signed(head, content)
        state = signed(head, content + bytes(MOST_BYTES - len(state) + longer))
        assert len(state) == MOST_BYTES + longer
        with pytest.raises(InputError, match=message):
            restore(Pipeline(of), state)


def test_a_headers_length_is_bounded(sound: bytes) -> None:
    line = sound.partition(b"\n")[0]
    at = line[:-1] + b" " * (LONGEST_HEADER - len(line) - 1) + b"}"
    assert len(at) == LONGEST_HEADER - 1  # with the end of the line, the longest
    assert header_of(at + b"\n") == header_of(sound)
    with pytest.raises(InputError, match="no stored state"):
        header_of(b" " + at + b"\n")


def test_a_header_has_room_for_any_configuration(of: Binding, monkeypatch: pytest.MonkeyPatch) -> None:
    assert (
        12 * LONGEST_FINGERPRINT < 2 * LONGEST_HEADER
    )  # of a character, JSON makes six bytes, or twelve of one in two
    size = sum(len(key) + len(value) for key, value in fingerprint(of).items())
    monkeypatch.setattr(fingerprint_module, "LONGEST_FINGERPRINT", size)
    assert len(fingerprint(of)) > 100
    monkeypatch.setattr(fingerprint_module, "LONGEST_FINGERPRINT", size - 1)
    assert list(fingerprint(of)) == ["all settings together"]
    restore(Pipeline(of), dump(Pipeline(of)))


def test_a_dbc_file_that_became_endless_is_unreadable(of: Binding, monkeypatch: pytest.MonkeyPatch) -> None:
    largest = max(Path(path).stat().st_size for path in of.databases)
    for bound, count in ((largest, 0), (largest - 1, 1)):
        monkeypatch.setattr(fingerprint_module, "LONGEST_FILE", bound)
        assert list(fingerprint(of).values()).count("unreadable") == count


Tree = dict[str, Any]


def _lists(value: Any) -> Any:
    """Return a tree whose lists can be changed; the keys of its dictionaries stay as they are."""
    if isinstance(value, dict):
        return {key: _lists(each) for key, each in value.items()}
    return [_lists(each) for each in value] if isinstance(value, tuple) else value


def _twice(tree: Tree) -> None:
    numbers = tree["trackers"]["trackers"][0]["tracks"]["obstacles"]["id"]
    numbers[3] = numbers[3][:8] * (len(numbers[3]) // 8)


CONTRADICTIONS: dict[str, Callable[[Tree], object]] = {
    "the obstacles' time is out of range": lambda tree: tree["trackers"]["trackers"][0].update(time_ns=-NEVER_NS),
    "two obstacles have the same number": _twice,
    "beyond 62 bits": lambda tree: tree["trackers"]["identities"].update(given=LARGEST_INTEGER + 1),
}


@pytest.mark.parametrize("message", CONTRADICTIONS)
def test_what_would_fail_later_is_refused(of: Binding, sound: bytes, message: str) -> None:
    head, _, content = sound.partition(b"\n")
    tree = _lists(msgpack.unpackb(content, strict_map_key=False, use_list=False))
    CONTRADICTIONS[message](tree)
    with pytest.raises(InputError, match=message):
        restore(Pipeline(of), signed(head, msgpack.packb(tree)))


@pytest.mark.parametrize("shape", [(), (0,), (1,), (3,), (2, 1)])
def test_a_place_has_two_coordinates(shape: tuple[int, ...]) -> None:
    held = encoded(DriftAnchor(1, 0, 0, np.zeros(shape)))
    with pytest.raises(ValueError, match="position"):
        decoded(DriftAnchor, held, None)  # as where a dictionary holds it
    decoded(DriftAnchor, encoded(DriftAnchor(1, 0, 0, np.zeros(2))), None)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("kind", ["imm", "vehicle"])
def test_a_forged_state_is_refused_or_replayed_to_the_end(tmp_path: Path, kind: str) -> None:
    """All outputs are written: tables, log and figures read the forged numbers, too."""
    of = fuzzed(f"demo of {kind}")
    sound = state_of(of)
    folder = tmp_path / "ring"
    folder.mkdir()
    log = folder / f"{stem(10**18, 1)}.log"
    frames = highway(of, 1.0)
    log.write_bytes(as_log(of, frames[len(frames) * 6 // 10 :]))
    head, _, content = sound.partition(b"\n")
    request = ReplayRequest(folder, tmp_path / "out.log", tmp_path / "t.csv", tmp_path / "p.csv", smooth=0.1)
    taken = 0
    for seed in range(30):
        drawn = Drawn(np.random.default_rng(seed).bytes(64))
        log.with_suffix(".state").write_bytes(signed(head, with_other_values(content, drawn)))
        with suppress(InputError):
            replay(of, request)
            taken += 1
    assert 0 < taken < 30
