"""Units of the bed's systemd, and the installation that they run."""

from __future__ import annotations

import subprocess
from pathlib import Path

from tests.beds.waiting import wait_until

INSTALLED = Path("/opt/candaemon/bin")
"""Of the programs `candaemon` and `python`, as the README installs them."""
PROJECT = Path("/opt/project")
"""The checkout where every sandbox shows it."""
FILES = Path("/etc/systemd/system")


class Unit:
    """A unit.

    Args:
        name: such as `candaemon@front.service`.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    def ask(self, verb: str) -> None:
        """Have `systemctl` do something to it, such as start, stop, reload, kill, and wait for that.

        Raises:
            AssertionError: it fails; with what the unit said.
        """
        done = subprocess.run(["systemctl", verb, self.name], capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{done.stderr}\n{self.journal()}"

    def show(self, name: str) -> str:
        """Return a property, such as ActiveState, SubState, StatusText, MainPID, NRestarts."""
        return output("systemctl", "show", "--value", f"--property={name}", self.name)

    def wait_for(self, name: str, value: str, timeout_s: float = 60.0) -> None:
        """Return as soon as a property has a value.

        Raises:
            AssertionError: it has another for too long; with what the unit said.
        """
        wait_until(
            lambda: self.show(name) == value,
            timeout_s,
            lambda: f"{self.name}: {name} is {self.show(name)!r}, expected {value!r}\n{self.journal()}",
        )

    def journal(self, *options: str) -> str:
        """Return what it has said, a line each, without time and name.

        Args:
            options: of journalctl, as `--output=json` or `--priority=warning`.
        """
        return output("journalctl", f"--unit={self.name}", "--no-pager", "--output=cat", *options)


def output(*words: str) -> str:
    """Return what a command writes.

    Raises:
        AssertionError: it fails; with its errors.
    """
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(words)}: {done.stdout}{done.stderr}"
    return done.stdout.strip()
