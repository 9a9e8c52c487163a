"""Where a vcan can be made: in a network of its own on this machine, else in user-mode Linux."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from tests.beds.guest import absent, boot, tools_environment, watch
from tests.beds.task import BedMissingError, Task

INIT = Path(__file__).with_name("init.sh")
READY = 'mount -t sysfs sysfs /sys && ip link set lo up && exec "$@"'
"""In a new network: /sys tells of its interfaces, and loopback is up."""


def run(task: Task) -> None:
    """Run tests where vcan interfaces can be made, none of which this machine sees.

    Args:
        task: the tests.

    Raises:
        BedMissingError: neither way is open.
    """
    why_not = _refusal()
    if not why_not:
        watch([*_network(), "sh", str(task.command)], task)
        return
    try:
        boot(task, INIT)
    except BedMissingError as error:
        raise BedMissingError(f"no vcan: {why_not}; and {error}") from error


def _refusal() -> str:
    """Return why this machine makes no vcan, nothing where it does."""
    missing = absent("ip", "tc", "unshare", "cansend")
    if missing:
        return f"no {missing} (apt-get install iproute2 util-linux can-utils)"
    done = subprocess.run(
        [*_network(), "ip", "link", "add", "dev", "vcan0", "type", "vcan"],
        capture_output=True,
        text=True,
        check=False,
        env=tools_environment(),
    )
    return "" if done.returncode == 0 else done.stderr.strip().replace("\n", " ")


def _network() -> list[str]:
    """Return the command that runs another in a network of its own."""
    user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    return ["unshare", *user, "--mount", "--net", "sh", "-c", READY, "sh"]
