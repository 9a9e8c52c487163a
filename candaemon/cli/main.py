"""The command line. Results go to standard output, messages to standard error.

Exit codes: 0 done, 1 failed, 2 wrong usage or configuration. Each command is a module of this room with `add_arguments`
and `execute`. Only the requested command is imported, so that none waits for another's libraries.
"""

from __future__ import annotations

import argparse
import logging
import sys
from importlib import import_module
from typing import NoReturn

from candaemon._version import __version__
from candaemon.cli import console
from candaemon.errors import CandaemonError
from candaemon.printable import printable

logger = logging.getLogger(__name__)

INTERRUPTED = 130
"""Exit code after Ctrl-C, by the convention of shells: 128 + the number of SIGINT."""

COMMANDS = {
    "demo": "Simulate a drive, track it through virtual buses, and compare with the truth.",
    "run": "Serve the configured buses until SIGTERM or Ctrl-C; SIGHUP loads the configuration again.",
    "status": "Show what a running service does, live on a terminal.",
    "install-service": "Write the systemd unit that runs a configuration.",
    "replay": "Replay a recorded drive.",
    "check": "Load a configuration, open nothing, and tell what it does.",
    "simulate": "Write the frames of a scenario through the sensors of a configuration.",
    "evaluate": "Compare tracks with the truth.",
    "papers": "Run the five papers' experiments again, beside their printed tables.",
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
    console.log_to_stderr()
    try:
        arguments = _parsed(sys.argv[1:] if argv is None else argv)
        arguments.execute(arguments)
        sys.stdout.flush()
    except CandaemonError as error:
        logger.error("error: %s", error)  # noqa: TRY400 - a traceback does not help the user
        return error.exit_code
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        console.abandon_stdout()  # the reader of the pipe has closed it
    except OSError as error:  # a full disk, a quota: what was written until then stays
        try:
            sys.stdout.flush()
        except OSError:
            console.abandon_stdout()
        what, why = error.filename or "output", error.strerror or error
        logger.error("error: %s cannot be written: %s", what, why)  # noqa: TRY400 - as above
        return 1
    return 0


class _Parser(argparse.ArgumentParser):
    """A parser whose complaints are safe to print: a shell puts names of files among the arguments."""

    def error(self, message: str) -> NoReturn:
        super().error(printable(message))


def _parsed(argv: list[str]) -> argparse.Namespace:
    """Return the arguments; `execute` is the function of the command."""
    parser = _Parser(
        prog="candaemon",
        description="Radar objects on a CAN bus in, obstacles with a lasting identity out.",
        epilog="Exit code: 0 done, 1 failed, 2 wrong usage or configuration.",
    )
    parser.add_argument("--version", action="version", version=f"candaemon {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, about in COMMANDS.items():
        command = commands.add_parser(name, help=about, description=about)
        if name in argv:
            module = import_module(f"candaemon.cli.{name.replace('-', '_')}")
            module.add_arguments(command)
            command.set_defaults(execute=module.execute)
    return parser.parse_args(argv)
