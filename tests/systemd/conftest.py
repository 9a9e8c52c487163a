"""The tests here run under a real systemd."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.beds import register

from .bed import run
from .units import FILES, Unit, output


def pytest_configure(config: pytest.Config) -> None:
    register(config, "systemd", Path(__file__).parent, run)


@pytest.fixture(scope="session")
def booted() -> None:
    """Wait until systemd has started all that it starts by itself."""
    assert output("systemctl", "is-system-running", "--wait") == "running"


@pytest.fixture
def install(booted: None) -> Iterator[Callable[[str, str], None]]:
    """Install unit files, by name and text, that go with the test: `install("candaemon@.service", text)`."""
    files: list[Path] = []

    def installing(name: str, text: str) -> None:
        files.append(FILES / name)
        files[-1].write_text(text, encoding="utf-8")
        output("systemctl", "daemon-reload")

    yield installing
    for file in files:
        file.unlink()
    output("systemctl", "daemon-reload")


@pytest.fixture
def unit(install: Callable[[str, str], None]) -> Iterator[Callable[[str], Unit]]:
    """Return services by name, which are stopped with the test and whose journal is shown if it fails."""
    units: list[Unit] = []

    def named(name: str) -> Unit:
        units.append(Unit(name))
        return units[-1]

    yield named
    for each in units:
        each.ask("stop")
        print(f"{each.name}:\n{each.journal()}")
