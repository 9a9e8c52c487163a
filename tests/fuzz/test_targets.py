"""Every target on the kept inputs, on random bytes, and the campaign in small."""

from __future__ import annotations

import logging
import random
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from _pytest.mark import ParameterSet
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from .campaign import CONFIGS, Share, digest_of, run, shares, split
from .targets import WEIGHTS, load

CORPUS = Path(__file__).resolve().parent / "corpus"
KEPT = sorted(path for path in CORPUS.glob("*/*") if path.is_file())
EXAMPLES = {
    "captures": 40,
    "codec": 60,
    "configuration": 15,
    "datagrams": 40,
    "dbc": 40,
    "http": 5,
    "logs": 60,
    "page": 15,
    "pipeline": 5,
    "protection": 100,
    "scenarios": 20,
    "state": 15,
    "status": 20,
    "tables": 30,
}
LIVE = pytest.param("signals", marks=pytest.mark.slow)
"""Its service takes seconds to start."""


@pytest.fixture(autouse=True, scope="module")
def _quiet() -> Iterator[None]:
    """Let candaemon's warnings on broken input out of the way."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def test_what_is_kept_is_small_and_of_a_target() -> None:
    assert {path.parent.name for path in KEPT} == set(WEIGHTS)
    assert sum(path.stat().st_size for path in KEPT) < 150_000


def kept(path: Path) -> ParameterSet:
    marks = [pytest.mark.slow] if path.parent.name == "signals" else []
    return pytest.param(path, marks=marks, id=f"{path.parent.name}-{path.name}")


@pytest.mark.parametrize("path", [kept(path) for path in KEPT])
def test_what_was_kept(path: Path) -> None:
    load(path.parent.name)(path.read_bytes())


@pytest.mark.parametrize("name", [*EXAMPLES, LIVE])
def test_any_bytes(name: str) -> None:
    @settings(
        max_examples=EXAMPLES.get(name, 10),
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(st.binary(max_size=300))
    def fuzzed(data: bytes) -> None:
        load(name)(data)

    fuzzed()


@pytest.mark.parametrize("name", ["captures", "codec", "datagrams", "dbc", "logs", "protection", "tables"])
def test_long_inputs(name: str) -> None:
    chance = random.Random(6)  # noqa: S311 - test data
    for _ in range(20):
        load(name)(chance.randbytes(2000))


FEW_FRAMES = {"ford_mrr_fd", "volkswagen_meb"}
"""Their objects come in few long frames without counter or checksum, of which hardly any is lost or fails."""


@pytest.mark.parametrize("config", [*CONFIGS, "demo of imm", "demo of vehicle", "toyota_rav4_ins of vehicle"])
def test_random_and_mutated_frames(config: str) -> None:
    result = run(Share(config, frames=4000, seed=1))
    assert result.cycles > 10
    assert result.most > 3
    assert result.sent > result.cycles  # obstacles too, not the status alone
    assert result.refused > (0 if config in FEW_FRAMES else 100)


def test_a_mutated_drive_gives_the_same_twice(drive: Path) -> None:
    share = Share("toyota_rav4_ins", frames=6000, seed=3, drive=drive / "drive_with_ins.log.gz")
    vehicles = replace(share, config="toyota_rav4_ins of vehicle")
    assert run(vehicles) == run(vehicles)
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
        campaigns = split(10_000_003, 1, log, 3)
        assert campaigns[1] == shares(3_333_334, 1001, log)
        assert sum(part.frames for campaign in campaigns for part in campaign) == 10_000_003
