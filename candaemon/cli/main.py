"""The command line. Results go to standard output, messages to standard error.

Exit codes: 0 done, 1 failed, 2 wrong usage or configuration, 128 + N ended by signal N. Each command is a module of
this room with `add_arguments` and `execute`. Only the requested command is imported, so that none waits for another's
libraries.
"""

from __future__ import annotations

import argparse
import gc
import logging
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from types import FrameType
from typing import Any, NoReturn

from candaemon._version import __version__
from candaemon.cli import console, standard_streams
from candaemon.daemon.process_signals import ServiceSignals
from candaemon.errors import CandaemonError
from candaemon.printable import printable
from candaemon.similar_names import meant

logger = logging.getLogger(__name__)

COMMANDS = {
    "demo": "Simulate a drive, track it through virtual buses, and compare with the truth.",
    "run": "Serve the configured buses until SIGTERM or Ctrl-C; SIGHUP loads the configuration again.",
    "status": "Show what a running service does, live on a terminal.",
    "install-service": "Write the systemd unit that runs a configuration.",
    "replay": "Replay a recorded drive.",
    "report": "Replay a recorded drive and write a page about it.",
    "fleet": "Replay many drives into one dataset, report it, and compare two.",
    "view": "Show live buses or a recorded drive in the browser.",
    "watch": "Show the obstacles of live buses in the terminal.",
    "convert": "Write logs of a drive as one log of another format.",
    "calibrate": "Tell from recorded drives what the configuration says wrongly of each sensor.",
    "check": "Load a configuration, open nothing, and tell what it does.",
    "simulate": "Write the frames of a scenario through the sensors of a configuration.",
    "evaluate": "Compare tracks with the truth.",
    "papers": "Run the five papers' experiments again, beside their printed tables.",
    "radars": "List the configurations that come with candaemon, and what each shows.",
    "init": "Make a configuration of a strange radar's DBC files, and of a log.",
    "schema": "Print the JSON Schema of the configuration, for editors.",
}
"""The commands and their descriptions. The module of a command has its name, with `_` for `-`."""


def main(argv: list[str] | None = None) -> int:
    """Run a command.

    Args:
        argv: the arguments; default: the process's own.

    Returns:
        The exit code.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices this small give its threads no work
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # else it asks each package there is for some
    standard_streams.prepare()
    console.log_to_stderr()
    try:
        code = _execute(sys.argv[1:], _loaded) if argv is None else _execute(argv, _parsed)
    except SystemExit as stop:  # help, version, wrong usage
        stop.code = standard_streams.finish(int(stop.code or 0))
        raise
    return standard_streams.finish(code)


def _execute(argv: list[str], parsed: Callable[[list[str], ServiceSignals | None], argparse.Namespace]) -> int:
    """Execute a command, parsed by a function, and say why it failed, if it did; return the exit code."""
    try:
        with ServiceSignals() if argv[:1] == ["run"] else _ended_by_signals() as signals:
            arguments = parsed(argv, signals)
            with standard_streams.prints_beside(vars(arguments).values()):
                arguments.execute(arguments)
    except CandaemonError as error:
        logger.error("error: %s", error)  # noqa: TRY400 - a traceback does not help the user
        return error.exit_code
    except KeyboardInterrupt as interruption:
        number = interruption.number if isinstance(interruption, Ended) else signal.SIGINT
        notes = getattr(interruption, "__notes__", [])
        logger.warning("%s", "; ".join([f"ended by {signal.Signals(number).name}", *notes]))
        return 128 + number  # by the convention of shells
    except BrokenPipeError:
        return 0  # the reader of standard output has what it wanted
    except OSError as error:
        what, why = error.filename or "the system refuses", error.strerror or error
        logger.error("error: %s: %s", what, why)  # noqa: TRY400 - as above
        return 1
    return 0


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints are safe to print: a shell puts names of files among the arguments.

    The arguments have, as `parser`, the one that read the last of them: where a command has commands, that one's.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.set_defaults(parser=self)

    def _match_arguments_partial(self, actions: Sequence[argparse.Action], arg_strings_pattern: str) -> list[int]:
        """Return how many words each argument takes; one that may do without any waits for those after an option.

        As argparse does from Python 3.12.7 on: before, `view CONFIG --port 0 LOG` had no LOG, and one word too many.
        """
        counts = super()._match_arguments_partial(actions, arg_strings_pattern)
        if arg_strings_pattern[sum(counts) :].startswith("O"):
            while counts and not counts[-1]:
                counts.pop()
        return counts

    def error(self, message: str) -> NoReturn:
        wrong = re.match(r"argument COMMAND: invalid choice: '([^']*)'", message)
        super().error(printable(message + (meant(wrong[1], list(COMMANDS)) if wrong else "")))


class Ended(KeyboardInterrupt):
    """A signal other than Ctrl-C's that ends the process.

    Args:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Let the signals that end a process do so as Ctrl-C does, unless they are ignored or handled already."""

    def end(number: int, _frame: FrameType | None) -> None:
        raise Ended(number)

    ending = [each for each in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(each) is signal.SIG_DFL]
    if threading.current_thread() is not threading.main_thread():
        ending = []
    for number in ending:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ending:
            signal.signal(number, signal.SIG_DFL)


class _Version(argparse.Action):
    """Shows the version, and whether the filters' kernels are compiled, for which numpy is imported."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Show it and end."""
        from candaemon.compiled import description  # noqa: PLC0415 - other commands need no numpy to start

        print(f"candaemon {__version__} ({description()})")
        parser.exit()


def _loaded(argv: list[str], signals: ServiceSignals | None) -> argparse.Namespace:
    """Return the arguments; the modules, which stay for the process's life, are not searched for garbage."""
    gc.disable()
    try:
        return _parsed(argv, signals)
    finally:
        gc.freeze()
        gc.enable()


def _parsed(argv: list[str], signals: ServiceSignals | None) -> argparse.Namespace:
    """Return the arguments; `execute` is the function of the command, `signals` those that come to a service."""
    parser = _Parser(
        prog="candaemon",
        description="Radar objects on a CAN bus in, obstacles with a lasting identity out.",
        epilog="Exit code: 0 done, 1 failed, 2 wrong usage or configuration, 128 + N ended by signal N.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version, and what computes")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True, dest="command")
    for name, about in COMMANDS.items():
        command = commands.add_parser(name, help=about, description=about)
        if name in argv:
            module = import_module(f"candaemon.cli.{name.replace('-', '_')}")
            module.add_arguments(command)
            command.set_defaults(execute=module.execute)
    arguments, further = parser.parse_known_args(argv, argparse.Namespace(signals=signals))
    if further:  # the command's own usage says what it takes, and where
        arguments.parser.error(f"unrecognized arguments: {' '.join(further)}")
    return arguments
