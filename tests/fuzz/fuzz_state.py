"""Stored states and folders of recordings with anything in them: refused as documented, or taken."""

from __future__ import annotations

import json
from contextlib import suppress
from functools import cache
from hashlib import sha256

from candaemon.errors import InputError
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state import Snapshots, fingerprint
from candaemon.playback.recording_files import runs

from .campaign import binding
from .drawn import Drawn
from .scratch import scratch
from .traffic import Traffic

_CONFIG = "demo"
_WORDS = (b".", b"N.", b"K\x00", b"(", b"t", b"R", b"b", b"}", b"]", b"\x8c\x02os", b"\x93", b"h\x00", b"Q", b"\x85",
          b"0", b"cos\nsystem\n", b"I01\n", b"J\xff\xff\xff\x7f", b"\x8e\xff\xff\xff\xff\xff\xff\xff\x7f")  # fmt: skip


def fuzz_state(data: bytes) -> None:
    """Read a state: anything, a sound one with changes, or one whose first line fits its changed content."""
    drawn = Drawn(data)
    form = drawn.integer(0, 2)
    head, _, content = _sound().partition(b"\n")
    match form:
        case 0:
            state = drawn.rest()
        case 1:
            state = drawn.edited(_sound(), _WORDS)
        case _:
            content = drawn.edited(content, _WORDS)
            line = json.loads(head) | {"sha256": sha256(content).hexdigest()}
            state = json.dumps(line).encode() + b"\n" + content
    pipeline = Pipeline(binding(_CONFIG))
    with suppress(InputError):
        _snapshots().restore(pipeline, state)
    folder = scratch() / "recording"
    folder.mkdir(exist_ok=True)
    (folder / "a-000001.log").write_bytes(drawn.taken(100))
    (folder / "a-000001.state").write_bytes(state)
    with suppress(InputError):
        assert len(runs(folder, fingerprint(binding(_CONFIG)))) == 1


@cache
def _snapshots() -> Snapshots:
    return Snapshots(Pipeline(binding(_CONFIG)))


@cache
def _sound() -> bytes:
    """Return the state of a pipeline that tracks."""
    pipeline = Pipeline(binding(_CONFIG))
    frames = [frame for frame in Traffic(binding(_CONFIG), seed=3).frames(3000) if frame.bus >= 0]
    for _ in pipeline.run(sorted(frames, key=lambda frame: frame.time_ns)):
        pass
    return _snapshots().dump(pipeline)
