"""The tests here run on a real vcan."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol

import pytest

from candaemon.binding.bind import bind
from candaemon.config.load import load_config
from candaemon.frames.frame import Frame
from tests.beds import register
from tests.beds.fixtures import Start
from tests.beds.links import Link
from tests.beds.service import config_on

from .bed import run
from .drives import lap, light
from .heard import Ears
from .traffic import Traffic
from .whole import PLACES, Whole


class Drive(Protocol):
    """Starts a service that tracks some vehicles, and waits until it does."""

    def __call__(
        self,
        change: Callable[[dict[str, Any]], None] = light,
        places: Sequence[tuple[float, float]] = PLACES,
    ) -> Whole: ...


def pytest_configure(config: pytest.Config) -> None:
    register(config, "vcan", Path(__file__).parent, run)


@pytest.fixture(scope="session")
def laps() -> dict[tuple[str, tuple[tuple[float, float], ...]], list[Frame]]:
    """Keep what has been simulated, by configuration and vehicles."""
    return {}


@pytest.fixture
def drive(
    laps: dict[tuple[str, tuple[tuple[float, float], ...]], list[Frame]],
    start: Start,
    vcan0: Link,
    vcan1: Link,
    vcan2: Link,
    tmp_path: Path,
) -> Iterator[Drive]:
    """Start services with traffic on their buses: radar on vcan0, INS on vcan1, obstacles on vcan2."""
    channels = {"radar": vcan0.name, "ins": vcan1.name, "obstacles": vcan2.name}
    with ExitStack() as ending:

        def driving(
            change: Callable[[dict[str, Any]], None] = light,
            places: Sequence[tuple[float, float]] = PLACES,
        ) -> Whole:
            config = config_on("esr_ins", tmp_path, channels, change)
            key = config.read_text(encoding="utf-8"), tuple(places)
            if key not in laps:
                laps[key] = lap(bind(load_config(config)), places)
            service = start(config, RUNTIME_DIRECTORY=str(tmp_path))
            buses = load_config(config).config.buses.values()
            onto = {index: bus.channel for index, bus in enumerate(buses)}
            traffic = ending.enter_context(Traffic(laps[key], onto))
            whole = Whole(service, tmp_path, traffic, ending.enter_context(Ears()))
            whole.track(count=len(places))
            return whole

        yield driving
