"""`candaemon run` as a process of its own, and configurations for it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from tests.support.paths import ROOT

from .waiting import wait_until

START_S = 40.0
"""Longest start: the imports alone take some seconds in user-mode Linux."""
STOP_S = 30.0
"""Longest end after SIGTERM: a second on a machine that does nothing else."""


class Service:
    """A running `candaemon run`.

    Args:
        config: its configuration.
        arguments: further ones of the command.
        log: the file for what it says.
        environment: variables beside this process's own.
    """

    def __init__(self, config: Path, *arguments: str, log: Path, environment: Mapping[str, str] | None = None) -> None:
        self.log = log
        with log.open("wb") as file:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "candaemon", "run", *arguments, str(config)],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                env=os.environ | dict(environment or {}),
            )

    @property
    def pid(self) -> int:
        """The process."""
        return self.process.pid

    @property
    def said(self) -> str:
        """All that it has said so far."""
        return self.log.read_text(encoding="utf-8")

    def wait_for(self, text: str, timeout_s: float = START_S, *, times: int = 1) -> str:
        """Return the line in which a text is said, as soon as it is.

        Args:
            text: a part of the line.
            timeout_s: longest wait, s.
            times: how many lines must have it; the last of them is returned.
        """

        def there() -> bool:
            assert self.process.poll() is None or len(found()) >= times, f"it ended without {text!r}:\n{self.said}"
            return len(found()) >= times

        def found() -> list[str]:
            return [line for line in self.said.splitlines() if text in line]

        wait_until(there, timeout_s, lambda: f"{text!r} {times} times in\n{self.said}")
        return found()[times - 1]

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal."""
        self.process.send_signal(number)

    def stop(self) -> tuple[int, float]:
        """Return the exit status after SIGTERM, and how long the end took, s."""
        asked = time.monotonic()
        self.signal(signal.SIGTERM)
        status = self.process.wait(STOP_S)
        return status, time.monotonic() - asked

    def resident_kb(self) -> int:
        """Return its resident memory, kB."""
        return int(self._status("VmRSS").split()[0])

    def close(self) -> None:
        """End it for good; no matter if it has ended."""
        self.process.kill()
        self.process.wait()

    def _status(self, field: str) -> str:
        assert self.process.poll() is None, f"it ended:\n{self.said}"
        for line in Path("/proc", str(self.pid), "status").read_text(encoding="utf-8").splitlines():
            name, _, value = line.partition(":")
            if name == field:
                return value.strip()
        raise AssertionError(f"no {field} of process {self.pid}")


def config_on(
    name: str,
    folder: Path,
    channels: Mapping[str, str],
    change: Callable[[dict[str, Any]], None] | None = None,
    project: Path = ROOT,
) -> Path:
    """Write a configuration of the project's for other interfaces.

    Args:
        name: of a file in `config/`.
        folder: where it is written.
        channels: interface by bus.
        change: changes the rest of its settings.
        project: where the service finds the project, whose DBC files are named.

    Returns:
        Its path.
    """
    settings: dict[str, Any] = yaml.safe_load((ROOT / "config" / f"{name}.yaml").read_text(encoding="utf-8"))
    for bus, channel in channels.items():
        settings["buses"][bus]["channel"] = channel
    for part in (
        *settings["buses"].values(),
        settings["ego"],
        *settings["sensors"].values(),
        settings.get("output", {}),
    ):
        if "dbc" in part:
            part["dbc"] = _absolute(part["dbc"], project / "config")
    if change is not None:
        change(settings)
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(settings, sort_keys=False), encoding="utf-8")
    return path


def _absolute(dbc: str | list[str], start: Path) -> str | list[str]:
    if isinstance(dbc, str):
        return os.path.normpath(start / dbc)
    return [os.path.normpath(start / each) for each in dbc]
