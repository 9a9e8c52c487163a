"""`candaemon init`: from a strange radar's DBC files, and a log, to a commented configuration."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from candaemon.cli.arguments import LOG_FORMATS, input_path, output_path
from candaemon.cli.console import say
from candaemon.errors import ConfigError
from candaemon.files.outputs import Outputs, is_standard_output
from candaemon.playback.recording_files import unfolded
from candaemon.printable import printable
from candaemon.wizard.draft import GUESS, Ask, Choice, take_guess
from candaemon.wizard.draft_text import draft_text, relative_path
from candaemon.wizard.proposal import propose
from candaemon.wizard.traffic import read_traffic
from candaemon.wizard.trial import calibrated, fitted_noise


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "dbc", type=input_path, nargs="+", metavar="DBC", help="DBC files: of the radar, and of the car or its INS"
    )
    parser.add_argument(
        "--log",
        type=input_path,
        action="append",
        default=[],
        metavar="LOG",
        help=f"a recorded drive, which tells the most: {LOG_FORMATS}; or the folder of a recording; repeatable: "
        "several are one drive",
    )
    parser.add_argument("-o", "--output", type=output_path, metavar="YAML", help="write it there; default: print it")
    parser.add_argument("--force", action="store_true", help="write over a file that is there")
    parser.add_argument("--yes", action="store_true", help="take the best guess where nothing tells, and ask nothing")


def execute(arguments: argparse.Namespace) -> None:
    """Find the configuration, ask about guesses on a terminal, and write it."""
    if arguments.output is not None and _is_there(arguments.output) and not arguments.force:
        raise ConfigError(
            "it is there, and may have been edited; choose another name, or --force", file=arguments.output
        )
    asks = not arguments.yes and sys.stdin.isatty() and sys.stderr.isatty()
    with Outputs([*arguments.dbc, *arguments.log]) as outputs:
        written = None if arguments.output is None else outputs.open(arguments.output)
        text = _configuration(arguments, _ask if asks else take_guess)
        if written is None:
            print(text, end="")
        else:
            written.stream.write(text.encode("utf-8"))
    count = text.count(f"# {GUESS}")
    name = "CONFIG" if arguments.output is None else str(arguments.output)
    log = "".join(f" --log {log}" for log in arguments.log)
    say(f"{count} guesses, marked in it; next: candaemon check {name}{log}")


def _is_there(path: Path) -> bool:
    """Return whether a file of somebody's is there, and not what standard output was redirected to."""
    return path.is_file() and not is_standard_output(path)


def _configuration(arguments: argparse.Namespace, ask: Ask) -> str:
    """Return the configuration that the files tell, as YAML."""
    traffic = read_traffic(unfolded(arguments.log)) if arguments.log else None
    proposal = calibrated(propose(arguments.dbc, traffic, ask))
    folder = Path.cwd() if arguments.output is None else arguments.output.parent
    factor, why = fitted_noise(proposal)
    return draft_text(proposal, relative_path(folder), factor, why)


def _ask(key: str, choice: Choice) -> Choice:
    """Ask about a guess on the terminal; an empty answer takes it."""
    if not choice.guess or not choice.ask:
        return choice
    print(f"\n{key}: {printable(choice.value)}\n  {printable(choice.why)}", file=sys.stderr)
    for number, option in enumerate(choice.options, 1):
        print(f"  {number}: {printable(option)}", file=sys.stderr)
    print(f"  {choice.ask}? enter takes it, a number another, or type the value: ", end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline().strip()
    if not answer:
        return choice
    if answer.isdigit() and 0 < int(answer) <= len(choice.options):
        answer = choice.options[int(answer) - 1]
    return Choice(answer, "as you said")
