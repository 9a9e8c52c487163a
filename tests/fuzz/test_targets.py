"""Every target on the kept inputs, on random bytes, and the campaign in small."""

from __future__ import annotations

import logging
import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from .__main__ import TARGETS as NAMES
from .campaign import CONFIGS, Share, digest_of, run, shares
from .targets import TARGETS

CORPUS = Path(__file__).resolve().parent / "corpus"
KEPT = sorted(path for path in CORPUS.glob("*/*") if path.is_file())
EXAMPLES = {"codec": 60, "configuration": 15, "dbc": 40, "logs": 60, "pipeline": 5, "protection": 100, "state": 15}


@pytest.fixture(autouse=True, scope="module")
def _quiet() -> Iterator[None]:
    """Let candaemon's warnings on broken input out of the way."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def test_the_command_line_knows_the_targets() -> None:
    assert sorted(TARGETS) == list(NAMES)
    assert {path.parent.name for path in KEPT} == set(NAMES)
    assert sum(path.stat().st_size for path in KEPT) < 100_000


@pytest.mark.parametrize("path", KEPT, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_what_was_kept(path: Path) -> None:
    TARGETS[path.parent.name](path.read_bytes())


@pytest.mark.parametrize("name", NAMES)
def test_any_bytes(name: str) -> None:
    @settings(
        max_examples=EXAMPLES[name],
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(st.binary(max_size=300))
    def fuzzed(data: bytes) -> None:
        TARGETS[name](data)

    fuzzed()


@pytest.mark.parametrize("name", ["codec", "dbc", "logs", "protection"])
def test_long_inputs(name: str) -> None:
    chance = random.Random(6)  # noqa: S311 - test data
    for _ in range(20):
        TARGETS[name](chance.randbytes(2000))


@pytest.mark.parametrize("config", CONFIGS)
def test_random_and_mutated_frames(config: str) -> None:
    result = run(Share(config, frames=4000, seed=7))
    assert result.cycles > 10
    assert result.most > 3
    assert result.sent > result.cycles  # obstacles too, not the status alone
    assert result.refused > 100


def test_a_mutated_drive_gives_the_same_twice(drive: Path) -> None:
    share = Share("toyota_rav4_ins", frames=6000, seed=3, drive=drive / "drive_with_ins.log.gz")
    first = run(share)
    assert first.most > 3
    assert first == run(share)
    assert digest_of([first]) != digest_of([run(Share("toyota_rav4_ins", 6000, seed=4, drive=share.drive))])


def test_a_campaign_is_split_whole() -> None:
    for log in (None, Path("drive.log")):
        parts = shares(10_000_003, seed=1, drive=log)
        assert sum(part.frames for part in parts) == 10_000_003
        assert {part.config for part in parts} == set(CONFIGS)
        assert len({part.seed for part in parts}) == len(parts)
