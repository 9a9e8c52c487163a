"""The two chains on the 64-object ESR scenario: log in, log out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.can_io.logs.read import read_log_blocks
from candaemon.can_io.logs.stream import LogCounts
from candaemon.can_io.logs.write import open_log_writer
from candaemon.can_io.reorder import Reorder
from candaemon.config.load import load_config
from candaemon.pipeline.cycle import Cycle
from candaemon.pipeline.pipeline import Pipeline
from candaemon.simulation.scenario_file import load_scenario
from candaemon.simulation.simulate import simulate

from . import naive

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]


def simulated_log(path: Path, seconds: float) -> Path:
    """Write the scenario's frames, shortened, and return the log."""
    binding = full_binding()
    scenario = load_scenario(ROOT / "config/scenarios/dense.yaml").model_copy(update={"duration": seconds})
    with open_log_writer(path, [bus.settings.channel for bus in binding.buses]) as writer:
        writer.write(list(simulate(scenario, binding).frames()))
    return path


def full_binding() -> Binding:
    """Bind the ESR's configuration with all its defaults."""
    return bind(load_config(ROOT / "config/esr_ins.yaml"))


def reduced_binding() -> Binding:
    """Bind the configuration that does what the naive chain does."""
    return bind(load_config(HERE / "esr_bench.yaml"))


def cycles(binding: Binding, log: Path, output: Path) -> Iterator[Cycle]:
    """Run candaemon over a log as `replay` does, without tables and figures."""
    channels = {bus.settings.channel: bus.index for bus in binding.buses}
    pipeline = Pipeline(binding)
    sequence = Reorder(round(binding.settings.ordering_window * 1e9))
    with open_log_writer(output, list(channels)) as writer:
        for cycle in pipeline.run_blocks(sequence.sequenced_blocks(read_log_blocks(log, channels, LogCounts()))):
            writer.write(cycle.frames)
            yield cycle


def naive_cycles(kind: Callable[..., naive.Filter], log: Path, output: Path) -> Iterator[naive.Cycle]:
    """Run the naive chain over a log."""
    return naive.NaiveChain(ROOT / "dbc/esr.dbc", ROOT / "dbc/oxts.dbc", kind).run(log, output)


def count(items: Iterator[object]) -> int:
    """Run through and count."""
    return sum(1 for _ in items)
