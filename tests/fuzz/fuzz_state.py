"""Stored states and folders of recordings with anything in them: refused as documented, or taken."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cache
from hashlib import sha256
from typing import Any, TypeAlias

import msgpack
import numpy as np

from candaemon.errors import InputError
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state import Snapshots, fingerprint
from candaemon.playback.recording_files import runs

from .campaign import binding
from .drawn import Drawn
from .scratch import scratch
from .traffic import Traffic

Path: TypeAlias = tuple[Any, ...]
"""Keys and indices that lead to a value in a tree."""

_CONFIGS = ("demo", "toyota_rav4_ins", "ars408_to_esr", "toyota_rav4")
_LENGTH = 1500
_AFTER = 300
_WORDS = (b"\xc0", b"\x00", b"\x80", b"\x90", b"\xa0", b"\xc4\x00", b"\xcb\x7f\xf0\x00\x00\x00\x00\x00\x00",
          b"\xcf\xff\xff\xff\xff\xff\xff\xff\xff", b"\xd3\x80\x00\x00\x00\x00\x00\x00\x00", b"\xdd\x7f\xff\xff\xff",
          b"\xdf\x7f\xff\xff\xff", b"\xc6\x7f\xff\xff\xff", b"\x91" * 600, b"\xd4\x00\x00", b"\xc1", b"\xc2", b"\xc3",
          b"\xca\x7f\x80\x00\x00", b"\xa5state", b"\x80\x04\x95cos\nsystem\n")  # fmt: skip
_INTEGERS = (0, 1, -1, 2, 63, 64, 255, 1 << 20, 1 << 32, 1 << 40, (1 << 62) - 1, 1 << 62, (1 << 63) - 1, -(1 << 62),
             -(1 << 63), 1_700_000_000_000_000_000)  # fmt: skip
_NUMBERS = (0.0, -0.0, 1.0, -1.0, 5e-324, 1e-30, 1e9, -1e9, 1e30, 9e74, -9e74, 1e300, math.inf, -math.inf, math.nan)


def fuzz_state(data: bytes) -> Counter[str]:
    """Read a state: anything, or a sound one with other bytes or values; a pipeline goes on with what it takes."""
    drawn = Drawn(data)
    form, config = drawn.integer(0, 5), drawn.choice(_CONFIGS)
    head, _, content = _sound(config).partition(b"\n")
    match form:
        case 0:
            state = drawn.rest()
        case 1:
            state = drawn.edited(_sound(config), _WORDS)
        case 2:
            state = signed(head, drawn.edited(content, _WORDS))
        case _:
            state = signed(head, with_other_values(content, drawn))
    pipeline, taken = Pipeline(binding(config)), False
    with suppress(InputError):
        _snapshots(config).restore(pipeline, state)
        taken = True
        go_on(pipeline, _traffic(config)[_LENGTH:])
    folder = scratch() / "recording"
    folder.mkdir(exist_ok=True)
    (folder / "a-000001.log").write_bytes(drawn.taken(100))
    (folder / "a-000001.state").write_bytes(state)
    with suppress(InputError):
        assert len(runs(folder, fingerprint(binding(config)))) == 1
    return Counter(taken=taken, refused=not taken)


def signed(head: bytes, content: bytes) -> bytes:
    """Return a state whose first line fits its content."""
    return json.dumps(json.loads(head) | {"sha256": sha256(content).hexdigest()}).encode() + b"\n" + content


def with_other_values(content: bytes, drawn: Drawn) -> bytes:
    """Return the content of a state with some of its values changed, and nothing of its form."""
    tree = msgpack.unpackb(content, strict_map_key=False, use_list=False)
    for _ in range(drawn.integer(1, 3)):
        paths = list(leaves(tree))
        # by the name first: thousands of samples stand beside a single flag
        names = sorted({_name(path) for path in paths})
        name = drawn.choice(names)
        path = drawn.choice([path for path in paths if _name(path) == name])
        tree = _replaced(tree, path, drawn)
    packed: bytes = msgpack.packb(tree)
    return packed


def leaves(tree: Any, at: Path = ()) -> Iterator[Path]:
    """Yield the way to each value, and to each list or dictionary."""
    yield at
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from leaves(value, (*at, key))
    elif isinstance(tree, tuple):
        for k, value in enumerate(tree):
            yield from leaves(value, (*at, k))


def go_on(pipeline: Pipeline, frames: Sequence[Frame]) -> None:
    """Let a pipeline take some frames, and end; its numbers may be wrong."""
    with np.errstate(all="ignore"):
        for _ in pipeline.run(frames):
            pass
        for _ in pipeline.finish():
            pass


def _name(path: Path) -> str:
    return ".".join(key for key in path if isinstance(key, str))


def _replaced(tree: Any, path: Path, drawn: Drawn) -> Any:
    """Return a tree with another value at the end of a path."""
    if not path:
        return _other(tree, drawn)
    key, *rest = path
    if isinstance(tree, dict):
        return tree | {key: _replaced(tree[key], tuple(rest), drawn)}
    return (*tree[:key], _replaced(tree[key], tuple(rest), drawn), *tree[key + 1 :])


def _other(value: Any, drawn: Drawn) -> Any:
    """Return another value, of the same kind as a rule."""
    if drawn.integer(0, 9) == 0:
        return drawn.choice((None, True, False, 0, -1, 1.5, "", "x", b"", b"12345678", (), {}, (1, 2), {1: 2}))
    match value:
        case bool():
            return not value
        case int():
            return drawn.choice((*_INTEGERS, value + 1, value - 1, -value))
        case float():
            return drawn.choice((*_NUMBERS, -value, 2 * value))
        case str():
            return drawn.choice(("", "x", value[:-1], value + "x"))
        case bytes():
            return _other_bytes(value, drawn)
        case tuple():
            return drawn.choice((value[:-1], value[1:], value + value[-1:], value[::-1], ()))
        case dict():
            items = list(value.items())
            return dict(drawn.choice((items[:-1], items[1:], items[::-1], [])))
    return drawn.choice((0, 1.5, "", b"", (), {}))


def _other_bytes(value: bytes, drawn: Drawn) -> bytes:
    """Return other bytes: cut, of another order, or with one number of an array changed."""
    form = drawn.integer(0, 7)
    if form == 0 or len(value) < 8:
        return drawn.choice((b"", value[:-1], value[::-1], value + value))
    at = 8 * drawn.integer(0, len(value) // 8 - 1)
    number = np.int64(drawn.choice(_INTEGERS)) if form < 4 else np.float64(drawn.choice(_NUMBERS))
    return value[:at] + number.tobytes() + value[at + 8 :]


@cache
def _snapshots(config: str) -> Snapshots:
    return Snapshots(binding(config))


@cache
def _traffic(config: str) -> list[Frame]:
    frames = [frame for frame in Traffic(binding(config), seed=3).frames(_LENGTH + _AFTER) if frame.bus >= 0]
    return sorted(frames, key=lambda frame: frame.time_ns)


@cache
def _sound(config: str) -> bytes:
    """Return the state of a pipeline that tracks."""
    pipeline = Pipeline(binding(config))
    for _ in pipeline.run(_traffic(config)[:_LENGTH]):
        pass
    return _snapshots(config).dump(pipeline)
