"""Both daemons live, side by side: CPU, latency, and how even candaemon's cycles are.

`python -m tests.benchmarks.live` prints the comparisons, each of them long; `--rate 8000 --seconds 60` feeds candaemon
alone, and tells what it lost.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from candaemon.status.losses import LOSS_CAUSES

from .chains import imm_config
from .live_driver import Datagram, make_drive, undisturbed
from .live_sides import Measured, Side, ahead_of_others
from .live_wire import HERE, ROOT, cycle_time, free_wire, on_wire

CPU, LATENCY, EVENNESS = 0.5, 0.35, 2.0
"""Goals on an idle machine: CPU time and p99 latency by the naive daemon's, and p99 by p50 of candaemon's cycles."""
FULL_BUS: Final = 8500.0
"""Frames/s of 8 bytes on a bus of 1 Mbit/s that is full: 111 to 135 bits each."""
FULL = ROOT / "config/esr_ins.yaml"
_WARMING_CYCLES = 20
"""Until a daemon that heard nothing for a while has its obstacles back."""


@dataclass(frozen=True, slots=True)
class Case:
    """A comparison.

    Attributes:
        name: what is compared.
        config: candaemon's configuration; None: that of the IMM with its defaults.
        kind: of the naive daemon's filter.
        rate: frames/s, which the naive daemon can take.
    """

    name: str
    config: Path | None
    kind: str
    rate: float


CASES = {
    "cs": Case("live, CS-KF", HERE / "esr_bench.yaml", "cs", 4000),
    "imm": Case("live, IMM with its defaults", None, "imm", 1200),
}
"""The naive daemon takes 15 to 30 ms for a cycle of its IMM: at 4,000 frames/s, 50 cycles/s, it would fall behind."""


@dataclass(frozen=True, slots=True)
class Compared:
    """Figures of both daemons from one run: medians over its blocks, for what else runs hits some of them.

    Attributes:
        case: what was compared.
        cpu: share of one core that candaemon and the naive daemon took.
        p50, p99: of the latency of both, s.
        answered: share of the scans that each answered.
        evenness: p99 by p50 of candaemon's cycles.
        stalled: share of the time in which the machine did not even run the driver.
        sent, received: frames that candaemon was sent, and took.
        lost: frames by cause, of causes that there were.
    """

    case: Case
    cpu: tuple[float, float]
    p50: tuple[float, float]
    p99: tuple[float, float]
    answered: tuple[float, float]
    evenness: float
    stalled: float
    sent: int
    received: int
    lost: dict[str, int]

    def __str__(self) -> str:
        return (
            f"{self.case.name}, {self.case.rate:,.0f} frames/s: CPU {_pair(self.cpu, 100, '%')}, goal {CPU:g};"
            f" latency p50 {_pair(self.p50, 1e3, 'ms')}, p99 {_pair(self.p99, 1e3, 'ms')}, goal {LATENCY:g};"
            f" cycle p99/p50 {self.evenness:.2f}, goal {EVENNESS:g};"
            f" answered {self.answered[0]:.1%} and {self.answered[1]:.1%}, stalled {self.stalled:.1%};"
            f" sent {self.sent:,}, received {self.received:,}, lost {_told(self.lost)}"
        )


def compare(case: Case, folder: Path, *, blocks: int, seconds: float) -> Compared:
    """Feed both daemons the same drive, block by block in turns, so that what slows the machine slows both.

    Args:
        case: what to compare.
        folder: for the daemons' files.
        blocks: that each is fed.
        seconds: of a block that is measured.
    """
    warming = _WARMING_CYCLES * cycle_time(case.rate)
    span = warming + seconds
    config = case.config or imm_config(folder)
    drive = _drive(config, case.rate, blocks * span, folder)
    with (
        ahead_of_others(),
        Side(config, case.rate, folder / "candaemon") as ours,
        Side(config, case.rate, folder / "naive", kind=case.kind) as naive,
    ):
        sides = (ours, naive)
        for side in sides:
            side.wait_until_it_listens()
        for k in range(blocks):
            parts = _part(drive, k * span, warming), _part(drive, k * span + warming, seconds)
            for side in sides:
                side.feed(*parts)
        report = ours.stop()
    both = ours.blocks, naive.blocks
    cpu, p50, p99 = (
        (_typical(figure, both[0]), _typical(figure, both[1]))
        for figure in (_cpu, lambda block: _quantile(block.latencies, 50), lambda block: _quantile(block.latencies, 99))
    )
    return Compared(
        case,
        cpu,
        p50,
        p99,
        (_answered(both[0]), _answered(both[1])),
        _typical(lambda block: _evenness(_cycles(report["cycles"], block)), both[0]),
        _stalled([*both[0], *both[1]]),
        ours.fed,
        *_received(report),
    )


@dataclass(frozen=True, slots=True)
class Endured:
    """What candaemon alone took.

    Attributes:
        rate: frames/s that it was fed with.
        sent, received: frames.
        lost: frames by cause, of causes that there were.
        cpu: share of one core.
        p50, p99: of the latency, s.
        longest_delay: by which a frame was sent too late, s.
    """

    rate: float
    sent: int
    received: int
    lost: dict[str, int]
    cpu: float
    p50: float
    p99: float
    longest_delay: float

    @property
    def cpu_a_frame(self) -> float:
        """CPU time of each frame that was taken, s."""
        return self.cpu / self.rate * self.sent / max(self.received, 1)

    def __str__(self) -> str:
        return (
            f"live alone, {self.rate:,.0f} frames/s: sent {self.sent:,}, received {self.received:,},"
            f" lost {_told(self.lost)}; CPU {self.cpu:.0%}, {self.cpu_a_frame * 1e6:.0f} µs a frame:"
            f" a core for {1.0 / self.cpu_a_frame / FULL_BUS:.1f} full buses of 1 Mbit/s;"
            f" latency p50 {self.p50 * 1e3:.2f} ms, p99 {self.p99 * 1e3:.2f} ms;"
            f" sent up to {self.longest_delay * 1e3:.0f} ms late"
        )


def endure(rate: float, seconds: float, folder: Path, *, paused_from: float | None = None) -> Endured:
    """Feed candaemon with all its defaults.

    Args:
        rate: frames/s.
        seconds: for how long.
        folder: for its files.
        paused_from: s from the first frame until it gets no time at all, up to the last frame; None: never.
    """
    warming = 1.0
    drive = _drive(FULL, rate, warming + seconds, folder)
    with ahead_of_others(), Side(FULL, rate, folder / "candaemon") as side:
        side.wait_until_it_listens()
        with side.paused_from(paused_from):
            side.feed(_part(drive, 0.0, warming), _part(drive, warming, seconds))
        report = side.stop()
    (it,) = side.blocks
    return Endured(
        rate,
        side.fed,
        *_received(report),
        it.cpu_seconds / it.seconds,
        _quantile(it.latencies, 50),
        _quantile(it.latencies, 99),
        it.longest_delay,
    )


def _received(report: Mapping[str, Any]) -> tuple[int, dict[str, int]]:
    """Return the frames that candaemon took, and those it lost by cause."""
    buses = report["buses"].values()
    lost = {cause: sum(bus[cause] for bus in buses) for cause in LOSS_CAUSES}
    return sum(bus["received"] for bus in buses), {cause: count for cause, count in lost.items() if count}


def _told(lost: Mapping[str, int]) -> str:
    return ", ".join(f"{cause} {count:,}" for cause, count in lost.items()) or "0"


def _drive(config: Path, rate: float, seconds: float, folder: Path) -> list[Datagram]:
    """Simulate what a configuration's radar and INS send."""
    folder.mkdir(exist_ok=True)
    return make_drive(on_wire(config, free_wire(), rate, folder), rate, seconds)


def _part(drive: list[Datagram], start: float, seconds: float) -> list[Datagram]:
    """Return the datagrams from a time of the drive on, both in s."""
    return [each for each in drive if start <= each.at_ns * 1e-9 < start + seconds]


def _typical(figure: Callable[[Measured], float], blocks: Sequence[Measured]) -> float:
    """Return the median of a figure over the blocks."""
    return statistics.median(map(figure, blocks))


def _cpu(block: Measured) -> float:
    """Return the share of one core that a daemon took."""
    return block.cpu_seconds / block.seconds


def _answered(blocks: Sequence[Measured]) -> float:
    """Return the share of the scans that were answered with obstacles."""
    return sum(block.answered for block in blocks) / sum(block.scans for block in blocks)


def _stalled(blocks: Sequence[Measured]) -> float:
    """Return the share of the time in which the machine did not even run the driver."""
    stalls = [span for block in blocks for span in block.stalls]
    return sum(ended - began for began, ended in stalls) / 1e9 / sum(block.seconds for block in blocks)


def _cycles(told: Iterable[tuple[int, float]], block: Measured) -> list[float]:
    """Return what the cycles took that were told in a block while the machine ran all the time, s."""
    first, last = block.window
    spans = [(time_ns, time_ns + int(seconds * 1e9)) for time_ns, seconds in told if first <= time_ns < last]
    return [(ended - began) / 1e9 for began, ended in spans if undisturbed((began, ended), block.stalls)]


def _evenness(cycles: list[float]) -> float:
    return _quantile(cycles, 99) / _quantile(cycles, 50)


def _quantile(values: list[float], percent: int) -> float:
    """Return a percentile; NaN of no values."""
    return statistics.quantiles(values, n=100, method="inclusive")[percent - 1] if len(values) > 1 else math.nan


def _ratio(pair: tuple[float, float]) -> float:
    return pair[0] / pair[1]


def _pair(pair: tuple[float, float], factor: float, unit: str) -> str:
    """Write candaemon's and the naive daemon's figure, and their ratio."""
    return f"{pair[0] * factor:.3g} of {pair[1] * factor:.3g} {unit} ({_ratio(pair):.2f} x)"


def print_comparisons(blocks: int) -> None:
    """Measure and print every case, each daemon fed with so many blocks of 2 s; then candaemon on a full bus."""
    for case in CASES.values():
        with TemporaryDirectory() as folder:
            print(compare(case, Path(folder), blocks=blocks, seconds=2.0), flush=True)
    with TemporaryDirectory() as folder:
        print(endure(FULL_BUS, 10.0, Path(folder)), flush=True)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.live", description="Live benchmarks.")
    parser.add_argument("--rate", type=float, help="frames/s to feed candaemon alone; without it: compare")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to feed it; default: 60")
    parser.add_argument("--blocks", type=int, default=6, help="of 2 s, that each side is fed to compare; default: 6")
    arguments = parser.parse_args()
    if arguments.rate is None:
        print_comparisons(arguments.blocks)
        return
    with TemporaryDirectory() as folder:
        print(endure(arguments.rate, arguments.seconds, Path(folder)))


if __name__ == "__main__":
    main()
