"""Fixtures of the tests in a bed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from itertools import count
from pathlib import Path
from typing import Protocol

import pytest

from .links import Link
from .own_kernel import OwnClock, Sysctl, is_own_kernel
from .service import Service


class Start(Protocol):
    """Starts a service that ends with the test at the latest."""

    def __call__(self, config: Path, *arguments: str, **environment: str) -> Service: ...


@pytest.fixture
def make_link() -> Iterator[Callable[..., Link]]:
    """Make vcan interfaces that go with the test: `make_link("vcan0", fd=True)`."""
    links: list[Link] = []

    def make(name: str, *, fd: bool = False) -> Link:
        links.append(Link(name))
        links[-1].add(fd=fd)
        return links[-1]

    yield make
    for link in links:
        if link.exists:
            link.delete()


@pytest.fixture
def vcan0(make_link: Callable[..., Link]) -> Link:
    return make_link("vcan0")


@pytest.fixture
def vcan1(make_link: Callable[..., Link]) -> Link:
    return make_link("vcan1")


@pytest.fixture
def vcan2(make_link: Callable[..., Link]) -> Link:
    return make_link("vcan2")


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start `candaemon run`; what it says is shown if the test fails."""
    numbers = count()
    with ExitStack() as ending:
        started: list[Service] = []

        def starting(config: Path, *arguments: str, **environment: str) -> Service:
            log = tmp_path / f"service{next(numbers)}.log"
            service = Service(config, *arguments, log=log, environment=environment)
            started.append(ending.enter_context(closing(service)))
            return service

        yield starting
        for service in started:
            print(f"{service.log.name}:\n{service.said}")


@pytest.fixture
def own_kernel() -> None:
    """Skip where the kernel is this machine's, which is not the tests' to change."""
    if not is_own_kernel():
        pytest.skip("the test changes the kernel's clock or limits: only in user-mode Linux")


@pytest.fixture
def own_clock(own_kernel: None) -> Iterator[OwnClock]:
    """The guest's clock; its steps are undone."""
    clock = OwnClock()
    yield clock
    clock.restore()


@pytest.fixture
def sysctl(own_kernel: None) -> Iterator[Sysctl]:
    """The guest's kernel settings; changes are undone."""
    settings = Sysctl()
    yield settings
    settings.restore()
