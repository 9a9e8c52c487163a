"""`candaemon demo`: a simulated drive through the whole daemon on in-process buses, compared with the truth.

Scenario → frames → virtual buses → daemon → virtual bus → frames → obstacles: the obstacles that are shown and
compared with the truth are read back from their bus, with its DBC. Frames are sent no faster than the daemon receives
them, so that the result is the same at any speed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import groupby
from math import hypot
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import can

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding, BoundOutput
from candaemon.can_io.python_can import to_frame, to_message
from candaemon.cli.arguments import SCENARIO, input_path, number, seed, speed, whole_number
from candaemon.cli.console import can_redraw, console, say, warn
from candaemon.cli.view import LARGEST_PORT, LONGEST_VIEW, PORT, require_extra, show
from candaemon.config.load import load_config
from candaemon.config.shipped import find_config, find_scenario
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.observer import CompletedCycle, Observer
from candaemon.errors import BusError, ConfigError
from candaemon.evaluation.fitted_table import FittedTable
from candaemon.evaluation.metrics import evaluate
from candaemon.evaluation.printing import print_sections, sections
from candaemon.evaluation.tables import TRACK_COLUMNS, TRUTH_COLUMNS, TrackWriter
from candaemon.files.outputs import Outputs
from candaemon.frames.frame import Frame
from candaemon.output.decoder import FIRST_STATE, DecodedCycle, OutputDecoder
from candaemon.simulation.drive_files import write_truth
from candaemon.simulation.scenario import LONGEST_DRIVE, Scenario, load_scenario
from candaemon.simulation.simulate import Simulation, simulate
from candaemon.tracking.obstacles import STATE_NAMES

SHORTEST_DRIVE: Final = 0.001
"""Shortest drive, s."""

_DURATION_S = 20.0
_SPEED = 4.0
"""Times real time on a terminal."""
_HANDOVER_TIMEOUT_S = 10.0
"""s after which a daemon that has not received all frames counts as stuck."""

_COLUMNS = (("x", "m"), ("y", "m"), ("vx", "m/s"), ("vy", "m/s"), ("ax", "m/s²"), ("age", "s"))
_REFRESH_HZ = 10
_SECOND_NS = 1_000_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--scenario", type=input_path, default=Path("highway"), help=f"{SCENARIO}; default: highway")
    parser.add_argument(
        "--duration",
        type=number(SHORTEST_DRIVE, LONGEST_DRIVE, "s"),
        metavar="S",
        help=f"s of the drive, no more than the scenario has; default: {_DURATION_S:g}, with --view all of it",
    )
    parser.add_argument("--seed", type=seed, default=1, help="of all random numbers; default: 1")
    parser.add_argument(
        "--speed",
        type=speed,
        help="times real time; default: 4 on a terminal, 1 with --view, elsewhere as fast as it goes",
    )
    parser.add_argument("--view", action="store_true", help="open a page in the browser that shows the drive")
    parser.add_argument(
        "--view-for",
        type=number(0.001, LONGEST_VIEW, "s"),
        metavar="S",
        help="s after which the page is closed; default: never",
    )
    parser.add_argument(
        "--port", type=whole_number(0, LARGEST_PORT), default=PORT, help=f"of that page; default: {PORT}; 0: any"
    )


def execute(arguments: argparse.Namespace) -> None:
    """Simulate a drive, track it and compare."""
    scenario = load_scenario(find_scenario(arguments.scenario))
    longest = scenario.duration
    if arguments.duration is not None and arguments.duration > longest:
        warn([f"--duration: found {arguments.duration:g} s, and the scenario ends after {longest:g} s"])
    duration = arguments.duration or (longest if arguments.view else _DURATION_S)
    scenario = scenario.model_copy(update={"duration": min(duration, longest)})
    if arguments.view:
        require_extra()
    binding = bind(load_config(find_config(Path("demo"))))
    if arguments.view:
        view_demo(binding, scenario, arguments)
    else:
        run_demo(binding, scenario, seed=arguments.seed, speed=arguments.speed)


def view_demo(binding: Binding, scenario: Scenario, arguments: argparse.Namespace) -> None:
    """Show a drive in the browser, through the pipeline without the buses.

    Args:
        binding: the configuration.
        scenario: the drive.
        arguments: of the command.
    """
    from candaemon.view.drive_pictures import pictures_of_frames  # noqa: PLC0415 - only to look at it
    from candaemon.view.page_server import PageAddress  # noqa: PLC0415 - the room's libraries are an extra

    simulation = simulate(scenario, binding, arguments.seed)
    say(f"{scenario.duration:g} s of a simulated drive")
    show(
        binding,
        lambda _: pictures_of_frames(binding, simulation.frames()),
        f"simulated: {arguments.scenario.stem}",
        PageAddress("127.0.0.1", arguments.port),
        live=False,
        opens=True,
        speed=arguments.speed or 1.0,
        duration=arguments.view_for,
    )


def run_demo(binding: Binding, scenario: Scenario, *, seed: int, speed: float | None) -> None:
    """Run a drive and print it.

    Args:
        binding: a configuration whose buses are virtual, with an output.
        scenario: the drive.
        seed: of all random numbers.
        speed: times real time; None: `_SPEED` on a terminal, as fast as possible elsewhere.
    """
    watched = can_redraw()
    speed = speed or (_SPEED if watched else None)
    simulation = simulate(scenario, binding, seed)
    say(f"{scenario.duration:g} s of a simulated drive, as CAN frames through {len(binding.buses)} virtual buses")
    with tempfile.TemporaryDirectory() as folder:
        tracks, truth = Path(folder, "tracks.csv"), Path(folder, "truth.csv")
        with Outputs() as outputs:
            with (
                TrackWriter(outputs.open(tracks), TRACK_COLUMNS) as table,
                LiveTable() if watched else LinePrinter() as show,
            ):
                for obstacles in DemoDrive(binding, simulation, speed):
                    table.write_cycle(obstacles.time_ns, obstacles.columns())
                    show.cycle(obstacles)
            with TrackWriter(outputs.open(truth), TRUTH_COLUMNS) as table:
                write_truth(simulation, table)
        # The wire rounds standard deviations to 0.1: too coarse for NEES.
        shown = [part for part in sections(evaluate(tracks, truth)) if not part.title.startswith("NEES")]
        print_sections(console(), shown)


class DemoDrive:
    """A simulated drive through the daemon: iterating yields the cycles decoded from the obstacles' bus.

    Args:
        binding: a configuration whose buses are virtual, with an output.
        simulation: the drive.
        speed: times real time; None: as fast as possible.

    Raises:
        ConfigError: a bus is not virtual, or there is no output.
    """

    def __init__(self, binding: Binding, simulation: Simulation, speed: float | None = None) -> None:
        if binding.output is None or any(bus.settings.interface != "virtual" for bus in binding.buses):
            raise ConfigError("a drive through virtual buses needs these, and an output", file=binding.loaded.path)
        self._output: BoundOutput = binding.output
        self._channels = [bus.settings.channel for bus in binding.buses]
        self._binding, self._simulation, self._speed = binding, simulation, speed
        self._now_ns = 0
        self._measured_ns: list[int] = []
        self._sent = 0

    def __iter__(self) -> Iterator[DecodedCycle]:
        with ExitStack() as closing:
            sides = [closing.enter_context(_virtual(channel)) for channel in self._channels]
            times = _CycleTimes(self._measured_ns)
            daemon = closing.enter_context(Daemon(self._binding, clock=self._clock, observers=[times]))
            receiver = OutputDecoder(self._output)
            for bus, burst in groupby(self._paced(), key=lambda frame: frame.bus):
                # One bus at a time: the daemon sees the frames of all in the order of the drive.
                for frame in burst:
                    sides[bus].send(to_message(frame))
                    self._now_ns = frame.time_ns
                    self._sent += 1
                self._drain(daemon)
                yield from self._read(sides[self._output.bus], receiver)
            daemon.finish()
            yield from self._read(sides[self._output.bus], receiver)
            yield from self._timed(receiver.flush())

    def _clock(self) -> int:
        """Return the time of the newest frame sent, which is the drive's clock."""
        return self._now_ns

    def _paced(self) -> Iterator[Frame]:
        """Yield the frames of the drive at the requested speed."""
        started_s, first_ns = time.monotonic(), None
        for frame in self._simulation.frames():
            first_ns = frame.time_ns if first_ns is None else first_ns
            if self._speed is not None:
                ahead_s = (frame.time_ns - first_ns) * 1e-9 / self._speed - (time.monotonic() - started_s)
                if ahead_s > 0.0:
                    time.sleep(ahead_s)
            yield frame

    def _drain(self, daemon: Daemon) -> None:
        """Step the daemon until it has received all frames sent so far."""
        deadline_s = time.monotonic() + _HANDOVER_TIMEOUT_S
        while daemon.received < self._sent:
            daemon.step(_HANDOVER_TIMEOUT_S)
            if time.monotonic() > deadline_s:
                raise BusError(f"the virtual buses delivered {daemon.received} of {self._sent} frames")

    def _read(self, side: can.BusABC, receiver: OutputDecoder) -> Iterator[DecodedCycle]:
        """Yield the cycles that have arrived on the obstacles' bus."""
        while (message := side.recv(0)) is not None:
            frame = to_frame(message, self._output.bus)
            yield from self._timed(receiver.push(frame.can_id, frame.data))

    def _timed(self, cycles: Iterator[DecodedCycle]) -> Iterator[DecodedCycle]:
        """Yield cycles with the times they are valid for."""
        for cycle in cycles:
            yield cycle.at(self._measured_ns[cycle.number])


class _CycleTimes(Observer):
    """Records the time each cycle's obstacles are valid for, which the frames do not carry.

    Args:
        measured_ns: list that the times are appended to.
    """

    def __init__(self, measured_ns: list[int]) -> None:
        self._measured_ns = measured_ns

    def on_cycle(self, completed: CompletedCycle) -> None:
        """Append the time of a cycle."""
        self._measured_ns.append(completed.cycle.obstacles.time_ns)


def _virtual(channel: str) -> can.BusABC:
    """Open the other end of a virtual bus; its messages keep their time stamps."""
    return can.Bus(channel=channel, interface="virtual", ignore_config=True, preserve_timestamps=True)


class LinePrinter:
    """Prints a line when an obstacle appears or disappears, and one per second with all positions."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._next_ns = 0
        self._known: set[int] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Do nothing: no resource is open."""

    def cycle(self, cycle: DecodedCycle) -> None:
        """Print the changes, and once a second the positions."""
        if self._first_ns is None:
            self._first_ns = self._next_ns = cycle.time_ns
        time = f"{(cycle.time_ns - self._first_ns) / _SECOND_NS:6.2f} s"
        quantities = {name: values.tolist() for name, values in cycle.quantities.items()}
        there = {int(identity): row for row, identity in enumerate(quantities["id"])}
        for identity in sorted(there.keys() - self._known):
            print(f"{time}  obstacle {identity} confirmed at {_place(quantities, there[identity])}", flush=True)
        for identity in sorted(self._known - there.keys()):
            print(f"{time}  obstacle {identity} gone", flush=True)
        self._known = set(there)
        if cycle.time_ns >= self._next_ns:
            self._next_ns += _SECOND_NS
            where = "; ".join(f"{identity} {_place(quantities, row)}" for identity, row in sorted(there.items()))
            print(f"{time}  {len(there)} obstacles" + (f": {where}" if where else ""), flush=True)


def _place(quantities: dict[str, list[float]], row: int) -> str:
    """Return an obstacle's position and speed as text."""
    x, y, vx, vy = (quantities[name][row] for name in ("x", "y", "vx", "vy"))
    return f"({x:.1f}, {y:.1f}) m {hypot(vx, vy):.1f} m/s"


class LiveTable:
    """Shows a table of all obstacles, refreshed several times a second."""

    def __init__(self) -> None:
        from rich.live import Live  # noqa: PLC0415 - a slow import that a pipe does not need

        self._first_ns: int | None = None
        self._live = Live(console=console(), auto_refresh=False, refresh_per_second=_REFRESH_HZ)
        self._next_s = 0.0

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def cycle(self, cycle: DecodedCycle) -> None:
        """Redraw the table if it is due."""
        if self._first_ns is None:
            self._first_ns = cycle.time_ns
        now_s = self._live.console.get_time()
        if now_s >= self._next_s:
            self._next_s = now_s + 1 / _REFRESH_HZ
            self._live.update(obstacles_table(cycle, (cycle.time_ns - self._first_ns) / _SECOND_NS), refresh=True)


def obstacles_table(cycle: DecodedCycle, seconds: float) -> FittedTable:
    """Return obstacles as a table, the nearest first.

    Args:
        cycle: the obstacles.
        seconds: of the drive.
    """
    from rich.table import Table  # noqa: PLC0415 - as above

    table = Table(title=f"{seconds:5.1f} s · x ahead, y to the left, speeds over ground", title_justify="left")
    table.add_column("id", justify="right")
    table.add_column("state", min_width=9)
    columns = [(name, unit) for name, unit in _COLUMNS if name in cycle.quantities]
    for name, unit in columns:
        table.add_column(f"{name} ({unit})", justify="right", min_width=6)
    quantities = {name: values.tolist() for name, values in cycle.quantities.items()}
    for row in sorted(range(len(quantities["id"])), key=quantities["x"].__getitem__):
        state = STATE_NAMES[int(quantities["state"][row]) - FIRST_STATE]
        cells = (f"{quantities[name][row]:.1f}" for name, _ in columns)
        table.add_row(f"{quantities['id'][row]:.0f}", state, *cells, style="dim" if state == "coasting" else None)
    return FittedTable(table)
