"""A daemon under test: a process of its own, fed in blocks, with what it took and how late it was."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Timer
from types import TracebackType
from typing import Any, Self

from candaemon.binding.bind import bind
from candaemon.config.load import load_config

from .live_driver import Datagram, Driver, Played, Span, undisturbed
from .live_wire import ROOT, free_wire, on_wire

_STARTING_S = 20.0
_TICKS = os.sysconf("SC_CLK_TCK")


def process_cpu(pid: int) -> float:
    """Return the CPU time of a process so far, s, in user and kernel mode."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


@contextmanager
def ahead_of_others() -> Iterator[None]:
    """Run this thread and the processes it starts before all else on the machine, where that is allowed."""
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    with suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameters)


@dataclass(frozen=True, slots=True)
class Measured:
    """What a daemon showed in one block.

    Attributes:
        scans: scans that closed.
        answered: of these, with obstacles.
        latencies: s from a scan's last frame to the first obstacle frame, where the machine ran all the time.
        stalls: when it did not.
        cpu_seconds: its CPU time.
        seconds: time of the block.
        window: its begin and end, ns of the machine's clock.
        longest_delay: by which the driver sent a frame too late, s.
    """

    scans: int
    answered: int
    latencies: list[float]
    stalls: list[Span]
    cpu_seconds: float
    seconds: float
    window: Span
    longest_delay: float

    @classmethod
    def of(cls, played: Played, cpu_seconds: float, window: Span) -> Self:
        """Read it from what was played."""
        answers = played.answers()
        latencies = [(came - closed) / 1e9 for closed, came in answers if undisturbed((closed, came), played.stalls)]
        return cls(
            len(played.closed),
            len(answers),
            latencies,
            list(played.stalls),
            cpu_seconds,
            played.seconds,
            window,
            played.longest_delay,
        )


class Side:
    """A daemon and the driver of its buses. A context manager.

    Args:
        config: the configuration of candaemon, which tells what the buses carry.
        rate: frames/s.
        folder: for the configuration as it is run.
        kind: of the naive daemon's filter; None: the daemon is candaemon.

    Attributes:
        fed: frames sent to it.
        blocks: what it showed in each of its blocks.

    Raises:
        OSError: there is no multicast on this machine.
    """

    def __init__(self, config: Path, rate: float, folder: Path, *, kind: str | None = None) -> None:
        wire = free_wire()
        folder.mkdir(parents=True)
        path = on_wire(config, wire, rate, folder)
        self.fed = 0
        self.blocks: list[Measured] = []
        self._listening = {wire.radar, wire.ins}
        self._told = folder / "told.json"
        output = bind(load_config(path)).output
        spared = output.status.message.can_id if output is not None and output.status is not None else None
        ports = (wire.radar, wire.ins, wire.obstacles)
        run = ["live_candaemon", str(path)] if kind is None else ["live_naive", kind, *map(str, ports)]
        with ExitStack() as opened:
            self._driver = opened.enter_context(Driver(wire, spared))
            told = opened.enter_context(self._told.open("w", encoding="utf-8"))
            command = [sys.executable, "-m", f"tests.benchmarks.{run[0]}", *run[1:]]
            self._process = subprocess.Popen(command, cwd=ROOT, stdout=told)
            opened.callback(self._end)
            self._opened = opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    def wait_until_it_listens(self) -> None:
        """Wait until every frame that is sent is heard.

        Raises:
            RuntimeError: that takes too long, or the daemon has ended.
        """
        end = time.monotonic() + _STARTING_S
        while not self._listening <= _udp_ports():
            if time.monotonic() > end or self._process.poll() is not None:
                raise RuntimeError(f"it does not listen to its buses: {self._process.args!r}")
            time.sleep(0.05)

    def feed(self, warming: Sequence[Datagram], block: Sequence[Datagram]) -> None:
        """Feed a part of a drive that brings the daemon up to it, and right after it a block that is measured."""
        self._driver.play(warming)
        before, began_ns = process_cpu(self._process.pid), time.time_ns()
        played = self._driver.play(block)
        self._driver.hear_the_rest(played)
        self.fed += len(warming) + len(block)
        self.blocks.append(Measured.of(played, process_cpu(self._process.pid) - before, (began_ns, time.time_ns())))

    @contextmanager
    def paused_from(self, seconds: float | None) -> Iterator[None]:
        """Let the daemon have no time from some seconds on, as long as the context lasts; None: let it run.

        Its end is asked for before it runs again, so that it reads nothing of what has come meanwhile.
        """
        if seconds is None:
            yield
            return
        pause = Timer(seconds, self._process.send_signal, (signal.SIGSTOP,))
        pause.start()
        try:
            yield
        finally:
            pause.join()
            self._process.terminate()
            self._process.send_signal(signal.SIGCONT)

    def stop(self) -> dict[str, Any]:
        """End the daemon; return what candaemon told of itself."""
        self._end()
        text = self._told.read_text(encoding="utf-8")
        return dict(json.loads(text)) if text else {}

    def _end(self) -> None:
        """End the process."""
        if self._process.poll() is None:
            self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _udp_ports() -> set[int]:
    """Return the ports that some process of this machine hears."""
    lines = Path("/proc/net/udp").read_text(encoding="utf-8").splitlines()[1:]
    return {int(line.split()[1].partition(":")[2], 16) for line in lines}
