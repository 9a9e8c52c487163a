"""A small Debian with systemd in a folder, made once and kept."""

from __future__ import annotations

import fcntl
import os
import platform
import shutil
import subprocess
from pathlib import Path

from tests.beds.guest import absent, tools_environment
from tests.beds.task import BedMissingError

FOLDER = "CANDAEMON_BED"
"""Environment variable: where it is kept, instead of the user's cache."""
PACKAGES = "systemd,systemd-sysv,dbus,udev,kmod,iproute2,can-utils,procps,python3"
"""python3 for the shared libraries that other Pythons want too."""
ALONE = ("unshare", "--mount", "--pid", "--fork", "--kill-child")
"""An interrupted debootstrap must leave no process and no mount behind: what it left is removed next time."""


def debian() -> Path:
    """Return the folder of a Debian, made if need be; it is never written to afterwards.

    Raises:
        BedMissingError: there is none, and it cannot be made.
    """
    suite = _suite()
    folder = _cache() / f"systemd-{suite}"
    if folder.is_dir():
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    with folder.with_name(f"{folder.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.is_dir():
            _make(suite, folder)
    return folder


def _make(suite: str, folder: Path) -> None:
    """Make it beside its place, so that what is in its place is whole."""
    missing = absent("debootstrap", "unshare")
    if missing:
        raise BedMissingError(f"no Debian for systemd: no {missing}; apt-get install debootstrap")
    if os.geteuid() != 0:
        raise BedMissingError(f"no Debian for systemd in {folder}: run the tests as root once, who can make it")
    part = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    environment = tools_environment()
    environment.pop("TMPDIR", None)  # which the new system lacks
    done = subprocess.run(
        [*ALONE, "debootstrap", "--variant=minbase", f"--include={PACKAGES}", suite, str(part)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    if done.returncode != 0:
        last = "\n".join((done.stdout + done.stderr).splitlines()[-10:])
        raise BedMissingError(f"no Debian for systemd: debootstrap failed:\n{last}")
    shutil.rmtree(part / "var/cache/apt", ignore_errors=True)
    part.rename(folder)


def _suite() -> str:
    """Return this machine's own release, so that its Python finds the C library that it was built for."""
    release = platform.freedesktop_os_release()
    return release["VERSION_CODENAME"] if release["ID"] in ("debian", "ubuntu") else "bookworm"


def _cache() -> Path:
    chosen = os.environ.get(FOLDER)
    if chosen:
        return Path(chosen).resolve()
    cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "candaemon-tests"
