"""The two chains on the 64-object ESR scenario: log in, log out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.can_io.logs.write import open_log_writer
from candaemon.config.load import load_config
from candaemon.files.outputs import OutputFile
from candaemon.playback.replay import ReplayRequest, replay
from candaemon.simulation.scenario import load_scenario
from candaemon.simulation.simulate import simulate

from . import naive

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]


def simulated_log(path: Path, seconds: float) -> Path:
    """Write the scenario's frames, shortened, and return the log."""
    binding = full_binding()
    scenario = load_scenario(ROOT / "config/scenarios/dense.yaml").model_copy(update={"duration": seconds})
    channels = [bus.settings.channel for bus in binding.buses]
    with OutputFile(path) as file, open_log_writer(file, channels) as writer:
        writer.write(list(simulate(scenario, binding).frames()))
    return path


def full_binding() -> Binding:
    """Bind the ESR's configuration with all its defaults."""
    return bind(load_config(ROOT / "config/esr_ins.yaml"))


def imm_config(folder: Path) -> Path:
    """Write that configuration with the estimator that the naive chain has, too, into a folder; return its path."""
    path = folder / "imm.yaml"
    text = (ROOT / "config/esr_ins.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    path.write_text(f"{text}tracker: {{estimator: {{kind: imm}}}}\n", encoding="utf-8")
    return path


def imm_binding() -> Binding:
    """Bind the ESR's configuration with the IMM and all its defaults."""
    with TemporaryDirectory() as folder:
        return bind(load_config(imm_config(Path(folder))))


def reduced_binding() -> Binding:
    """Bind the configuration that does what the naive chain does."""
    return bind(load_config(HERE / "esr_bench.yaml"))


def replayed(binding: Binding, log: Path, output: Path) -> int:
    """Replay a log as `candaemon replay LOG -o OUTPUT` does; return the number of cycles."""
    return replay(binding, ReplayRequest(log, output)).pipeline.counts.cycles


def naive_cycles(kind: Callable[..., naive.Filter], log: Path, output: Path) -> Iterator[naive.Cycle]:
    """Run the naive chain over a log."""
    return naive.NaiveChain(ROOT / "dbc/esr.dbc", ROOT / "dbc/oxts.dbc", kind).run(log, output)


def count(items: Iterator[object]) -> int:
    """Run through and count."""
    return sum(1 for _ in items)
