"""Boots systemd in user-mode Linux, with this project and its Python in it."""

from __future__ import annotations

import sys
import sysconfig
from pathlib import Path

from tests.beds.guest import boot
from tests.beds.task import BedMissingError, Task
from tests.support.paths import DATA

from .debian import debian

INIT = Path(__file__).with_name("init.sh")
SYSTEM = "/usr"
"""Of a Python that is a part of the distribution, which the guest has too."""


def run(task: Task) -> None:
    """Run tests as a unit of systemd.

    Args:
        task: the tests.

    Raises:
        BedMissingError: there is no user-mode Linux, or no Debian for it.
    """
    root = debian()
    if any(mark in str(root) for mark in ":,"):
        raise BedMissingError(f"no systemd: overlayfs takes no ':' or ',' in a path: {root}")
    (task.folder / "debian").write_text(str(root), encoding="utf-8")
    (task.folder / "mounts").write_text(
        "".join(f"{source}\t{target}\n" for source, target in _mounts(task.project)), encoding="utf-8"
    )
    (task.folder / "home").write_text(f"{SYSTEM if sys.base_prefix == SYSTEM else '/opt/python'}/bin", encoding="utf-8")
    (task.folder / "python").write_text(f"python{sysconfig.get_python_version()}", encoding="utf-8")
    boot(task, INIT)


def _mounts(project: Path) -> list[tuple[str, str]]:
    """Return what the guest sees of this machine, and where.

    The tests have all at the paths of this machine. The service has it below /opt, for no sandbox hides that.
    """
    packages = sysconfig.get_path("purelib")
    mounts = [(str(project), str(project)), (str(project), "/opt/project"), (packages, "/opt/packages")]
    if sys.base_prefix != SYSTEM:
        mounts += [(sys.base_prefix, sys.base_prefix), (sys.base_prefix, "/opt/python")]
    if sys.prefix != sys.base_prefix:
        mounts.append((sys.prefix, sys.prefix))
    if DATA.is_dir():
        mounts.append((str(DATA), str(DATA)))
    return mounts
