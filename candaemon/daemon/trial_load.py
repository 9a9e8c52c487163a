"""A configuration is loaded in a process of its own first: whatever that costs, the core loop goes on beside it.

Threads of one process take turns, so a load that is long or large would hold up the frames. In the other process time
and memory are limited. It answers with the digests of the files that it read, or with what is wrong; the service
then loads what has proved small, and no other bytes than those.

    python -m candaemon.daemon.trial_load CONFIG
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from subprocess import DEVNULL, PIPE
from typing import Final, TypeAlias

from candaemon.binding.bound import Binding
from candaemon.daemon.service_config import load_service_config
from candaemon.errors import CandaemonError, ConfigError
from candaemon.files.bounded import read_bounded
from candaemon.pipeline.pipeline import Pipeline

LONGEST_TRIAL_S: Final = 50.0
"""Longest time that a trial may take, the start of its process included, s."""
LONGEST_LOAD_S: Final = 10
"""Longest time of a processor that a trial may take for the load, s."""
LARGEST_LOAD: Final = 268_435_456
"""Most memory that a trial may take for the load, bytes."""

_NICE = 10
_TOO_LARGE = f"to load it takes more than {LARGEST_LOAD >> 20} MiB of memory; make it smaller"
_TOO_LONG = f"to load it takes more than {LONGEST_LOAD_S} s; make it smaller"

Digests: TypeAlias = Mapping[str, str]
"""SHA-256 by path, of the files that a load has read."""


class TriedConfig:
    """A configuration that is tried in a process of its own before it is loaded.

    Args:
        path: the YAML file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._process: subprocess.Popen[bytes] | None = None
        self._cancelled = False

    def load(self) -> Binding:
        """Load it as it is in the files at present.

        Raises:
            ConfigError: it cannot be used, takes too long or too much memory, or was changed meanwhile.
        """
        digests = self._try()

        def read(path: Path, longest: int) -> bytes:
            content = read_bounded(path, longest)
            if digests.get(str(path)) != _digest(content):
                raise OSError(errno.EBUSY, "it was changed during the reload; reload again", str(path))
            return content

        return load_service_config(self._path, read)

    def cancel(self) -> None:
        """End a trial that is under way, and let none begin; for other threads."""
        self._cancelled = True
        process = self._process
        if process is not None:
            process.kill()

    def _try(self) -> Digests:
        """Return the digests of the files, once loading them has succeeded."""
        command = [sys.executable, "-P", "-m", "candaemon.daemon.trial_load", str(self._path)]
        # Where this process finds its modules, so does the other, and nowhere else.
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OPENBLAS_NUM_THREADS": "1"}
        with subprocess.Popen(  # noqa: S603 - a module of ours
            command, stdin=DEVNULL, stdout=PIPE, env=environment, process_group=0
        ) as process:
            self._process = process
            if self._cancelled:
                process.kill()
            try:
                answer, _ = process.communicate(timeout=LONGEST_TRIAL_S)
            except subprocess.TimeoutExpired:
                raise ConfigError(f"to try it takes more than {LONGEST_TRIAL_S:g} s", file=self._path) from None
            finally:
                process.kill()
                self._process = None
        if process.returncode == -signal.SIGXCPU:
            raise ConfigError(_TOO_LONG, file=self._path)
        return _digests_of(answer, self._path, process.returncode)


def _digests_of(answer: bytes, path: Path, status: int) -> Digests:
    """Return the digests in an answer of the other process.

    Args:
        answer: one of `_answer`, or what is left of it where the process has died.
        path: the YAML file.
        status: of the process.

    Raises:
        ConfigError: the configuration is refused, or there is no whole answer.
    """
    try:
        match json.loads(answer):
            case {"refused": [str(first), *others]}:
                raise ConfigError(first, others=[ConfigError(str(each)) for each in others])
            case {"read": dict(digests)} if all(isinstance(each, str) for each in digests.values()):
                return digests
    except (ValueError, RecursionError):
        pass
    raise ConfigError(
        f"the process that tried it ended without a result (status {status}); the log tells why", file=path
    )


def main() -> None:
    """Load the configuration that the command names, within limits; answer on standard output."""
    signal.alarm(math.ceil(LONGEST_TRIAL_S))  # whatever becomes of the service
    sys.modules["asammdf"] = None  # type: ignore[assignment] # python-can would import it, and pandas: no log is read here
    _limit()
    print(json.dumps(_answer(Path(sys.argv[1]))))


def _limit() -> None:
    """Limit what this process takes from here on; let others go first, and this one end first where memory is short."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + LARGEST_LOAD
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    seconds = math.ceil(time.process_time()) + LONGEST_LOAD_S
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    with suppress(OSError):  # a sandbox may forbid it
        os.nice(_NICE)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500", encoding="ascii")


def _answer(path: Path) -> dict[str, object]:
    """Return the digests of the files that a configuration needs, or why it is refused."""
    digests: dict[str, str] = {}

    def read(path: Path, longest: int) -> bytes:
        content = read_bounded(path, longest)
        digests[str(path)] = _digest(content)
        return content

    try:
        Pipeline(load_service_config(path, read))
    except (CandaemonError, OSError) as error:
        return {"refused": str(error).splitlines()}
    except MemoryError:
        return {"refused": [f"{path}: {_TOO_LARGE}"]}
    return {"read": digests}


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


if __name__ == "__main__":
    main()
