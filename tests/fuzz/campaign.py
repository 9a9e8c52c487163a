"""Very many frames, random and mutated, through whole pipelines as the service runs them."""

from __future__ import annotations

import os
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from itertools import islice
from pathlib import Path

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.can_io.reorder import ReorderBuffer
from candaemon.config.load import load_config
from candaemon.config.tracker import TrackerSettings
from candaemon.frames.frame import Frame, Tick
from candaemon.pipeline.pipeline import Pipeline
from candaemon.pipeline.saved_state import dump, restore

from .invariants import Watch
from .traffic import BLOCK, Traffic

CONFIG = Path(__file__).resolve().parents[2] / "config"
CONFIGS = tuple(sorted(path.stem for path in CONFIG.glob("*.yaml")))
DRIVEN = ("toyota_rav4", "toyota_rav4_ins")
"""Configurations that a recorded drive of the RAV4 fits."""

_SAMPLED = 16
_LAST = 1000
_LARGEST_STATE = 4_000_000
_CHECKPOINT = 50 * BLOCK
_WARMING = 0.25  # share of the frames until memory is taken as warm
_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True, slots=True)
class Share:
    """A part of a campaign: one pipeline.

    Attributes:
        config: name of the configuration.
        frames: how many.
        seed: of chance.
        drive: log that is mutated; None: random payloads.
    """

    config: str
    frames: int
    seed: int
    drive: Path | None = None


@dataclass(frozen=True, slots=True)
class Result:
    """What a share came to.

    Attributes:
        share: which one.
        cycles: told.
        sent: frames.
        refused: frames of sensors and own motion that were lost, or failed and were not used.
        most: obstacles at once.
        state: bytes of the pipeline's state, at most: every queue, history and track.
        grown: bytes that the process grew by after the first quarter.
        digest: SHA-256 of all that was sent, in hexadecimal.
        error: what was not as it must be; empty where all was.
    """

    share: Share
    cycles: int
    sent: int
    refused: int
    most: int
    state: int
    grown: int
    digest: str
    error: str = ""


def shares(frames: int, seed: int, drive: Path | None) -> list[Share]:
    """Split a campaign: half of it a mutated drive, where there is one, the rest random payloads for all."""
    driven = frames // 2 if drive is not None else 0
    parts = [Share(name, driven // len(DRIVEN), seed + k, drive) for k, name in enumerate(DRIVEN) if drive is not None]
    rest = frames - sum(part.frames for part in parts)
    each = rest // len(CONFIGS)
    counts = [rest - each * (len(CONFIGS) - 1), *[each] * (len(CONFIGS) - 1)]
    return parts + [
        Share(name, count, seed + 100 + k) for k, (name, count) in enumerate(zip(CONFIGS, counts, strict=True))
    ]


def split(frames: int, seed: int, drive: Path | None, parts: int) -> list[list[Share]]:
    """Split a campaign into smaller ones, each a campaign by its own seed: 1000 more than that of the one before."""
    each = frames // parts
    counts = [frames - each * (parts - 1), *[each] * (parts - 1)]
    return [shares(count, seed + 1000 * k, drive) for k, count in enumerate(counts)]


@cache
def binding(name: str) -> Binding:
    """Bind a configuration of `config/` by its name, after which `of KIND` may name another estimator."""
    name, _, kind = name.partition(" of ")
    loaded = load_config(CONFIG / f"{name}.yaml")
    if kind:
        tracker = TrackerSettings.model_validate({"estimator": {"kind": kind}})
        loaded = replace(loaded, config=loaded.config.model_copy(update={"tracker": tracker}))
    return bind(loaded)


def run(share: Share, progress: Callable[[int], None] | None = None) -> Result:
    """Let the frames of a share through a pipeline and hold what must be true.

    Args:
        share: which.
        progress: told of how many frames there were more.

    Raises:
        AssertionError: something is not as it must be.
    """
    bound = binding(share.config)
    pipeline, watch = Pipeline(bound), Watch(bound, _SAMPLED)
    frames = _Counted(Traffic(bound, share.seed, share.drive).frames(share.frames), progress)
    items = _sequenced(frames, bound)
    largest, warm = 0, 0
    for cycle in pipeline.run(islice(items, share.frames - _LAST)):
        watch.take(cycle)
        if frames.count >= frames.checked + _CHECKPOINT:
            frames.checked = frames.count
            largest = max(largest, len(dump(pipeline)))
            assert largest <= _LARGEST_STATE, f"{share}: its state has {largest} bytes"
            if not warm and frames.count > _WARMING * share.frames:
                warm = _resident()
    grown = _resident() - warm if warm else 0
    largest = max(largest, _hold_state(bound, pipeline, watch, list(items)))
    _hold_counts(pipeline, frames)
    counts = pipeline.counts
    return Result(
        share, counts.cycles, counts.sent, pipeline.drops, watch.most, largest, grown, watch.outputs.hexdigest()
    )


def attempt(share: Share, progress: Callable[[int], None] | None = None) -> Result:
    """Run a share; one that fails is a result too, so that the others go on."""
    try:
        return run(share, progress)
    except Exception as error:  # noqa: BLE001 - whatever it is, it is what is looked for
        place = traceback.extract_tb(error.__traceback__)[-1]
        told = f"{type(error).__name__} at {place.filename}:{place.lineno}: {error}"
        return Result(share, 0, 0, 0, 0, 0, 0, "", told)


def digest_of(results: Sequence[Result]) -> str:
    """Return one SHA-256 for all that was sent, from those of the shares in order."""
    return sha256("".join(result.digest for result in results).encode("ascii")).hexdigest()


class _Counted:
    """Counts what passes, and tells it a block at a time."""

    def __init__(self, frames: Iterator[Frame], progress: Callable[[int], None] | None) -> None:
        self._frames = frames
        self._progress = progress
        self.count = 0
        self.data = 0
        self.checked = 0

    def __iter__(self) -> Iterator[Frame]:
        for frame in self._frames:
            self.count += 1
            self.data += frame.bus >= 0
            if self._progress is not None and self.count % BLOCK == 0:
                self._progress(BLOCK)
            yield frame
        if self._progress is not None:
            self._progress(self.count % BLOCK)


def _sequenced(frames: _Counted, bound: Binding) -> Iterator[Frame | Tick]:
    """Put frames in order as the service does; those of no bus are ticks."""
    settings = bound.settings
    sequence = ReorderBuffer(round(settings.ordering_window * 1e9), max_gap_ns=round(settings.service.clock_step * 1e9))
    for frame in frames:
        yield from sequence.push(frame if frame.bus >= 0 else Tick(frame.time_ns))
    yield from sequence.flush()


def _hold_counts(pipeline: Pipeline, frames: _Counted) -> None:
    """Hold that every frame was counted, once."""
    assert sum(bus.frames for bus in pipeline.counts.buses) == frames.data
    assert all(bus.used >= 0 for bus in pipeline.counts.buses)


def _hold_state(bound: Binding, pipeline: Pipeline, watch: Watch, last: Sequence[Frame | Tick]) -> int:
    """Hold that a pipeline with the state of this one does the same with the last frames; return the state's size."""
    stored, other, other_watch = dump(pipeline), Pipeline(bound), Watch(bound, _SAMPLED)
    restore(other, stored)
    other_watch.outputs = watch.outputs.copy()
    for each, watching in ((pipeline, watch), (other, other_watch)):
        for cycle in each.run(last):
            watching.take(cycle)
        watching.finish()
    assert other.counts == pipeline.counts
    assert other_watch.outputs.digest() == watch.outputs.digest(), "a pipeline with the same state sends something else"
    return len(stored)


def _resident() -> int:
    """Return the bytes of memory that the process holds; 0 where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * _PAGE
    except OSError:
        return 0
