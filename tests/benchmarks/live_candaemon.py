"""The daemon as `candaemon run` has it, which tells at its end how long its cycles took.

`python -m tests.benchmarks.live_candaemon CONFIG` prints JSON when SIGTERM ends it.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path

from candaemon.binding.bind import bind
from candaemon.config.load import load_config
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.observer import CompletedCycle, Observer
from candaemon.daemon.process_signals import ServiceSignals


class Cycles(Observer):
    """Keeps when each cycle was told, ns, and how long it took, s."""

    def __init__(self) -> None:
        self.told_at: list[tuple[int, float]] = []

    def on_cycle(self, completed: CompletedCycle) -> None:
        """Keep a cycle's times."""
        self.told_at.append((completed.cycle.time_ns, completed.seconds))


def main(config: str) -> None:
    """Run until SIGTERM."""
    cycles = Cycles()
    daemon = Daemon(bind(load_config(Path(config))), observers=[cycles])
    with ServiceSignals() as signals, daemon:
        daemon.run(signals.served(stop=daemon.stop, reload=daemon.reload, mark=daemon.mark))
    told = {"buses": {bus.name: asdict(bus.counts) for bus in daemon.buses}, "cycles": cycles.told_at}
    json.dump(told, sys.stdout)


if __name__ == "__main__":
    main(*sys.argv[1:])
