"""CAN interfaces of a bed."""

from __future__ import annotations

import subprocess
from pathlib import Path

MTU = 16
"""Of a frame of classic CAN."""
MTU_FD = 72


class Link:
    """A vcan interface, which exists from `add` to `delete`.

    Args:
        name: such as vcan0.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    def __str__(self) -> str:
        return self.name

    @property
    def exists(self) -> bool:
        """Whether the kernel has it."""
        return Path("/sys/class/net", self.name).exists()

    def add(self, *, fd: bool = False) -> None:
        """Make it and set it up.

        Args:
            fd: whether it carries CAN FD too.
        """
        _run("ip", "link", "add", "dev", self.name, "mtu", str(MTU_FD if fd else MTU), "type", "vcan")
        self.up()

    def delete(self) -> None:
        """Remove it; those who have it open learn it by ENODEV."""
        _run("ip", "link", "delete", "dev", self.name)

    def up(self) -> None:
        """Set it up."""
        _run("ip", "link", "set", "dev", self.name, "up")

    def down(self) -> None:
        """Set it down; those who read it get ENETDOWN."""
        _run("ip", "link", "set", "dev", self.name, "down")

    def queue(self, *words: str) -> None:
        """Give it a transmit queue in the place of the one it has.

        Args:
            words: a queueing discipline of `tc`, as `"tbf", "rate", "1kbit", "burst", "100", "limit", "1000"`: a full
                one answers ENOBUFS.
        """
        _run("tc", "qdisc", "replace", "dev", self.name, "root", *words)

    def no_queue(self) -> None:
        """Take its transmit queue away."""
        _run("tc", "qdisc", "delete", "dev", self.name, "root")

    def statistic(self, name: str) -> int:
        """Return a counter of the kernel's, such as tx_packets or tx_dropped."""
        return int(Path("/sys/class/net", self.name, "statistics", name).read_text(encoding="ascii"))


def _run(*words: str) -> None:
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(words)}: {done.stderr}"
