"""A bed's process: user-mode Linux, or a namespace of this machine's kernel; watched until it ends."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from .task import SYSTEM_PATH, BedMissingError, Task

PACKAGES = "user-mode-linux kmod can-utils iproute2"
"""Of Debian, what a guest needs."""
COMPILER_PACKAGES = "gcc libc6-dev"
"""What it needs beside them where the processor has larger registers than it knows of."""
WHOLE_REGISTERS = Path(__file__).with_name("whole_registers.c")
MEMORY_MB = 1024
POLL_S = 0.1

LEASH = 'exec 3<&0; { read -r _ <&3; kill -KILL 0; } & exec "$@" 3<&- </dev/null'
"""Runs a command in the shell's place, and kills it with all its helpers when whoever holds its input dies."""


def absent(*programs: str) -> str:
    """Return which of some programs are not there, nothing if all are."""
    path = tools_environment()["PATH"]
    return ", ".join(each for each in programs if shutil.which(each, path=path) is None)


def tools_environment() -> dict[str, str]:
    """Return this process's environment with the administrator's programs on the PATH, which a user's often lacks."""
    return os.environ | {"PATH": f"{os.environ.get('PATH', '')}:{SYSTEM_PATH}"}


def boot(task: Task, init: Path) -> None:
    """Run user-mode Linux until it powers off; its root is this machine's own, read-only.

    Args:
        task: the tests; the guest's console goes to its file.
        init: a shell script, process 1 of the guest, started from the task's folder. It makes a file `started` beside
            itself once that folder is mounted to be written to.

    Raises:
        BedMissingError: it is not installed, or does not start.
    """
    missing = absent("linux.uml", "modprobe", "ip", "tc", "cansend")
    if missing:
        raise BedMissingError(f"no user-mode Linux: no {missing}; apt-get install {PACKAGES}")
    process_1 = task.folder / "init"
    shutil.copy(init, process_1)
    process_1.chmod(0o755)
    watch(
        [
            *(*_with_whole_registers(task.folder), "linux.uml", f"mem={MEMORY_MB}M", "loglevel=4"),
            *("rootfstype=hostfs", "rootflags=/", "ro", f"init={process_1}"),
            *("con=null", "con0=null,fd:1", "con1=null", f"uml_dir={task.folder}/uml/"),
        ],
        task,
    )
    if not (task.folder / "started").exists():
        console = task.console.read_text(encoding="utf-8", errors="replace")[-500:]
        raise BedMissingError(f"user-mode Linux does not start here: {console or 'it says nothing'}")


def _with_whole_registers(folder: Path) -> list[str]:
    """Return what runs user-mode Linux on this machine's processor: nothing, but for one with AMX.

    Args:
        folder: for the library that is loaded before it.

    Raises:
        BedMissingError: it needs that library, and there is no compiler.
    """
    if "amx_tile" not in Path("/proc/cpuinfo").read_text(encoding="utf-8").split():
        return []
    missing = absent("cc")
    if missing:
        raise BedMissingError(f"no user-mode Linux on a processor with AMX: no cc; apt-get install {COMPILER_PACKAGES}")
    library = folder / "whole_registers.so"
    subprocess.run(["cc", "-O2", "-shared", "-fPIC", "-o", library, WHOLE_REGISTERS], check=True)
    return ["env", f"LD_PRELOAD={library}"]


def watch(words: Sequence[str], task: Task) -> None:
    """Run a command until it ends, or until neither it nor its tests have said anything for too long.

    Args:
        words: the command; what it says goes to the task's console file.
        task: the tests that it runs.
    """
    with (
        task.console.open("wb") as console,
        subprocess.Popen(
            ["sh", "-c", LEASH, "sh", *words],
            stdin=subprocess.PIPE,
            stdout=console,
            stderr=subprocess.STDOUT,
            env=tools_environment() | {"TMPDIR": _memory_folder()},
            start_new_session=True,
        ) as process,
    ):
        try:
            _wait(process, task)
        finally:
            with suppress(ProcessLookupError):  # it ended, with all its helpers
                os.killpg(process.pid, signal.SIGKILL)


def _wait(process: subprocess.Popen[bytes], task: Task) -> None:
    said, since = 0, time.monotonic()
    while process.poll() is None:
        time.sleep(POLL_S)
        now = sum(path.stat().st_size for path in (task.console, task.output, task.reports) if path.exists())
        if now != said:
            said, since = now, time.monotonic()
        elif time.monotonic() - since > task.patience_s:
            with task.console.open("a", encoding="utf-8") as console:
                console.write(f"\nended after {task.patience_s:g} s without a word\n")
            return


def _memory_folder() -> str:
    """Return the folder for the file that is a guest's memory: in a container /dev/shm is often too small for it."""
    shared = Path("/dev/shm")  # noqa: S108 # the kernel's own, in memory
    if shared.is_dir() and shutil.disk_usage(shared).free > 1.2e6 * MEMORY_MB:
        return str(shared)
    return tempfile.gettempdir()
