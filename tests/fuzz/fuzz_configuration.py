"""Configurations with anything in them: refused by name and line, or they take frames."""

from __future__ import annotations

from collections import Counter
from functools import cache
from itertools import islice
from pathlib import Path
from unittest.mock import patch

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.dbc.database import load_database
from candaemon.dbc.types import Database
from candaemon.errors import ConfigError
from candaemon.files.bounded import FileReader
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline

from .bombs import YAML_BOMBS
from .drawn import Drawn
from .invariants import Watch, hold_place
from .scratch import scratch

_ROOT = Path(__file__).resolve().parents[2]
_FRAMES = 100
_START_NS = 1_700_000_000_000_000_000
YAML_WORDS = (b"0", b"-1", b"1e400", b".nan", b".inf", b"null", b"true", b"[]", b"{}", b"1", b"0.001", b"64",
               b"1000000", b"&a ", b"*a", b"<<: *a", b"!!python/object:os.system ", b"'", b'"', b"\n", b"  ", b"- ",
               b": ", b"#", b"\t", b"\xff", b"timeout", b"counter", b"imm", b"cv", b"odometry", b"-X",
               b"{slot}", b"0x10", *YAML_BOMBS)  # fmt: skip


def fuzz_configuration(data: bytes) -> Counter[str]:
    """Load and bind a configuration; one that is accepted takes frames."""
    drawn = Drawn(data)
    edited = drawn.integer(0, 7) > 0
    text = drawn.edited(drawn.choice(_configurations()), YAML_WORDS) if edited else drawn.rest()
    path = scratch() / "config.yaml"
    path.write_bytes(text)
    try:
        bound = _bound(path)
    except ConfigError as error:
        hold_place(error)
        return Counter(edited=edited, refused=1)
    pipeline, watch = Pipeline(bound), Watch(bound)
    kinds = [
        (bus.index, can_id, database.by_id[can_id].length)
        for bus in bound.buses
        for database in bus.databases
        for can_id in sorted(bus.can_ids & database.by_id.keys())
    ]
    payload = drawn.rest().ljust(64, b"\x5a")
    frames = [
        Frame(_START_NS + k * 2_000_000, bus, can_id, (payload[k % 32 :] + payload)[:length])
        for k, (bus, can_id, length) in enumerate(islice(kinds * _FRAMES, _FRAMES))
    ]
    for cycle in pipeline.run(frames):
        watch.take(cycle)
    watch.finish()
    return Counter(edited=edited, accepted=1, frames=len(frames), sent=pipeline.counts.sent)


@cache
def _parsed(path: Path) -> Database:
    return load_database(path)


def _database(path: Path, _read: FileReader, _folder: Path | None) -> Database:
    return _parsed(path)


def _bound(path: Path) -> Binding:
    """Bind a configuration; a DBC file is parsed once in the process, which is most of the time that it would take."""
    with patch("candaemon.binding.bind.load_cached", _database):
        return bind(load_config(path))


@cache
def _configurations() -> tuple[bytes, ...]:
    """Return the shipped configurations, with paths from anywhere."""
    dbc = str(_ROOT / "dbc").encode()
    return tuple(path.read_bytes().replace(b"../dbc", dbc) for path in sorted((_ROOT / "config").glob("*.yaml")))
