"""The baseline as a daemon: the naive chain around live buses. As frozen as the chain itself.

`python -m tests.benchmarks.live_naive KIND RADAR INS OUT` takes the kind of filter and the ports of the buses; SIGTERM
ends it. One loop over the buses' sockets is the quickest that python-can gives: its Notifier reads each bus in a thread
of its own, and the threads fight for the interpreter.
"""

from __future__ import annotations

import contextlib
import select
import signal
import sys
from typing import Any

import can

from . import naive
from .live_wire import ESR_DBC, INS_DBC, Wire

KINDS: dict[str, Any] = {"cs": naive.CurrentStatistical, "imm": naive.InteractingModels}


class NaiveDaemon:
    """Takes what radar and INS send, one message at a time, and sends the targets of every cycle.

    Args:
        chain: decodes, tracks and encodes.
        wire: the ports of the buses.
    """

    def __init__(self, chain: naive.NaiveChain, wire: Wire) -> None:
        self._chain = chain
        self._radar, self._ins, self._out = (
            can.Bus(interface="udp_multicast", channel=group, port=port, fd=False, ignore_config=True)
            for group, port in wire.addresses()
        )
        self._scan: dict[int, dict[str, Any]] = {}
        self._first_ns = 0

    def run(self) -> None:
        """Serve without end."""
        while True:
            ready, _, _ = select.select([self._ins, self._radar], [], [])
            for bus in ready:
                message = bus.recv(0)
                if message is not None:
                    self._take(message, bus is self._ins)

    def close(self) -> None:
        """Close the buses."""
        for bus in (self._radar, self._ins, self._out):
            bus.shutdown()

    def _take(self, message: can.Message, own: bool) -> None:
        """Take a message, and track when it completes a scan."""
        chain, can_id, time_ns = self._chain, message.arbitration_id, round(message.timestamp * 1e9)
        if own and can_id in chain.own:
            chain.motion.take(time_ns, chain.ins.decode_message(can_id, message.data, decode_choices=False))
        elif not own and can_id in chain.targets:
            if not self._scan:
                self._first_ns = time_ns
            target = chain.radar.decode_message(can_id, message.data, decode_choices=False)
            self._scan[chain.targets[can_id]] = target
            if len(self._scan) == naive.SLOTS:
                self._track(message.timestamp)
                self._scan = {}

    def _track(self, timestamp: float) -> None:
        """Run one cycle and send it."""
        samples = self._chain.motion.samples
        if len(samples) > 1 and samples[0].time_ns <= self._first_ns:
            pose = self._chain.motion.pose(self._first_ns)
            self._chain.step(self._scan, pose)
            for message in self._chain.frames(pose, timestamp):
                self._out.send(message)


def main(kind: str, *ports: str) -> None:
    """Run until SIGTERM."""
    daemon = NaiveDaemon(naive.NaiveChain(ESR_DBC, INS_DBC, KINDS[kind]), Wire(*map(int, ports)))
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with contextlib.suppress(KeyboardInterrupt):
        daemon.run()
    daemon.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
