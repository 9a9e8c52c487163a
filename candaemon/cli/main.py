"""The commands. Results go to standard output, talk to standard error.

Exit codes: 0 done, 1 failed, 2 wrong usage or configuration. Each command imports what it needs when it runs, so that
none waits for another's libraries.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from candaemon.cli import console
from candaemon.cli.arguments import parse
from candaemon.config.shipped import find_config, find_scenario
from candaemon.errors import CandaemonError, ConfigError, InputError
from candaemon.files.atomic import check_writable, make_folder, write_whole

if TYPE_CHECKING:
    from candaemon.binding.bound import Binding
    from candaemon.papers.experiment import Experiment, Result
    from candaemon.playback.replay import ReplayRequest

logger = logging.getLogger(__name__)

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it: 128 and the number of SIGINT."""


def main(argv: list[str] | None = None) -> int:
    """Run a command.

    Args:
        argv: the arguments; default: the process's own.

    Returns:
        The exit code.
    """
    arguments = parse(_COMMANDS, argv)
    console.log_to_stderr()
    try:
        arguments.command(arguments)
        sys.stdout.flush()
    except CandaemonError as error:
        logger.error("error: %s", error)  # noqa: TRY400 - a traceback tells the user nothing
        return error.exit_code
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        console.abandon_stdout()  # whoever reads has read enough
    except OSError as error:  # a full disk, a quota: what was written until then stays
        try:
            sys.stdout.flush()
        except OSError:
            console.abandon_stdout()
        what, why = error.filename or "output", error.strerror or error
        logger.error("error: %s cannot be written: %s", what, why)  # noqa: TRY400 - as above
        return 1
    return 0


def demo(arguments: argparse.Namespace) -> None:
    """Simulate a drive, track it through virtual buses, and compare with the truth."""
    from candaemon.cli.demo import run_demo
    from candaemon.simulation.scenario_file import load_scenario

    scenario = load_scenario(find_scenario(arguments.scenario))
    run_demo(
        _bound(Path("demo")),
        scenario.model_copy(update={"duration": min(arguments.duration, scenario.duration)}),
        seed=arguments.seed,
        speed=arguments.speed,
    )


def run(arguments: argparse.Namespace) -> None:
    """Serve the configured buses until SIGTERM or Ctrl-C; SIGHUP loads the configuration again."""
    from candaemon.cli.run import ServeRequest, serve

    serve(ServeRequest(find_config(arguments.config), arguments.record, arguments.status, arguments.log))


def status(arguments: argparse.Namespace) -> None:
    """Show what a running service does, live on a terminal."""
    from candaemon.cli.status import watch

    watch(arguments.instance, arguments.socket, once=arguments.once, as_json=arguments.json)


def install_service(arguments: argparse.Namespace) -> None:
    """Write the systemd unit that runs a configuration."""
    from candaemon.daemon.install import install

    install(find_config(arguments.config), show=arguments.print)


def replay(arguments: argparse.Namespace) -> None:
    """Replay a recorded drive."""
    from candaemon.playback.replay import ReplayRequest
    from candaemon.playback.replay import replay as replay_log
    from candaemon.playback.summary import summarise

    binding = _bound(arguments.config)
    console.warn(binding.warnings)
    channels = [channel for channel, _ in arguments.map]
    twice = sorted({channel for channel in channels if channels.count(channel) > 1})
    if twice:
        raise ConfigError(f"--map gives {', '.join(twice)} to several buses; a channel has one")
    request = ReplayRequest(
        arguments.log,
        arguments.output,
        arguments.tracks,
        arguments.predictions,
        arguments.horizons,
        arguments.speed,
        dict(arguments.map),
        arguments.smooth,
        arguments.fresh,
    )
    _check_request(request, arguments.summary, binding)
    with console.log_progress(arguments.log.name) as progress:
        replayed = replay_log(binding, request, progress)
    figures = summarise(replayed)
    console.print_figures(arguments.log.name, figures)
    if arguments.summary is not None:
        write_whole(arguments.summary, json.dumps(figures, indent=2, allow_nan=False) + "\n")
    console.say(f"replayed in {replayed.seconds:.2f} s, {replayed.log.frames / replayed.seconds:,.0f} frames/s")
    silent = [name for name, counts in figures["sensors"].items() if not counts["used"]]
    if len(silent) == len(figures["sensors"]):
        others = ", ".join(figures["log"]["other_channels"]) or "none"
        raise InputError(
            f"not one usable frame of any sensor ({', '.join(silent)}); log channels no bus takes: {others}; "
            "check each bus's channel, or use --map CHANNEL=BUS",
            file=arguments.log,
        )
    if silent:
        console.warn([f"sensor '{name}': not one usable frame in this log" for name in silent])


def check(arguments: argparse.Namespace) -> None:
    """Load a configuration, open nothing, and tell what it does."""
    from candaemon.cli.check import check_report

    console.print_sheets(check_report(_bound(arguments.config)))


def simulate(arguments: argparse.Namespace) -> None:
    """Write the frames of a scenario through the sensors of a configuration."""
    from candaemon.simulation.scenario_file import load_scenario
    from candaemon.simulation.simulate import simulate as simulated
    from candaemon.simulation.write import record

    scenario = load_scenario(find_scenario(arguments.scenario))
    binding = _bound(arguments.config)
    frames = record(simulated(scenario, binding, arguments.seed), binding, arguments.output, arguments.truth)
    console.print_figures(arguments.output.name, {"frames": frames, "seconds": scenario.duration})


def evaluate(arguments: argparse.Namespace) -> None:
    """Compare tracks with the truth."""
    from candaemon.evaluation.metrics import evaluate as compared
    from candaemon.evaluation.text import print_evaluation

    evaluation = compared(arguments.tracks, arguments.truth)
    if arguments.json is not None:
        write_whole(arguments.json, evaluation.to_json())
    print_evaluation(console.console(), evaluation)


def papers(arguments: argparse.Namespace) -> None:
    """Run the five papers' experiments again, beside their printed tables."""
    from candaemon.papers.json import to_json
    from candaemon.papers.registry import choose
    from candaemon.papers.text import print_result

    experiments = choose(arguments.names)
    if arguments.list:
        listed = tuple((experiment.name, experiment.title) for experiment in experiments)
        console.print_sheets([console.Sheet("experiments", listed, ("name", "what is compared"))])
        return
    if arguments.json is not None:
        check_writable(arguments.json)
    if arguments.plots is not None:
        make_folder(arguments.plots)
    done: list[tuple[Experiment, Result]] = []
    for number, experiment in enumerate(experiments, start=1):
        with console.share_progress(f"{experiment.name} ({number} of {len(experiments)})") as advance:
            result = experiment.run(arguments.runs, arguments.seed, advance)
        # told and written at once: what is done outlasts an interruption
        print_result(console.console(), experiment, result, arguments.runs, arguments.seed)
        done.append((experiment, result))
        if arguments.json is not None:
            write_whole(arguments.json, to_json(done, arguments.runs, arguments.seed))
        if arguments.plots is not None:
            _plot(result, arguments.plots)


def schema(_arguments: argparse.Namespace) -> None:
    """Print the JSON Schema of the configuration, for editors."""
    from candaemon.config.load import json_schema

    print(json.dumps(json_schema(), indent=2, ensure_ascii=False))


_COMMANDS = {
    "demo": demo,
    "run": run,
    "status": status,
    "install-service": install_service,
    "replay": replay,
    "check": check,
    "simulate": simulate,
    "evaluate": evaluate,
    "papers": papers,
    "schema": schema,
}


def _bound(config: Path) -> Binding:
    """Load a configuration with its DBC files."""
    from candaemon.binding.bind import bind
    from candaemon.config.load import load_config

    return bind(load_config(find_config(config)))


def _plot(result: Result, folder: Path) -> None:
    """Write the drawings of an experiment."""
    from candaemon.papers.plots import draw

    for figure in result.figures:
        for name, content in draw(figure).items():
            write_whole(folder / name, content)


def _check_request(request: ReplayRequest, summary: Path | None, binding: Binding) -> None:
    """Refuse what can be told before the log is read: buses there are not, and files that would be written twice."""
    buses = {bus.name for bus in binding.buses}
    for channel, bus in request.channels.items():
        if bus not in buses:
            raise ConfigError(f"--map {channel}={bus}: no bus '{bus}'; expected one of {', '.join(sorted(buses))}")
    if request.output is not None and binding.output is None:
        raise ConfigError(
            f"-o {request.output}: the configuration has no 'output', so there are no frames to write; add one",
            file=binding.loaded.path,
        )
    if request.smooth is not None and request.tracks is None:
        raise ConfigError("--smooth is for the table of obstacles; name it with --tracks")
    written = [path for path in (request.output, request.tracks, request.predictions, summary) if path is not None]
    paths = [path.resolve() for path in (request.log, *written)]
    if len(set(paths)) < len(paths):
        raise ConfigError("the same file is named twice; give the log and everything written a name of its own")
