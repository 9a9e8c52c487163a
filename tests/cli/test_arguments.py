"""Numbers on the command line: each has a range, and nothing that is typed ends in a traceback."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib import import_module

import pytest

from candaemon.cli import arguments, demo, papers, replay, run
from candaemon.cli.main import COMMANDS, main
from candaemon.simulation.scenario import LONGEST_DRIVE

ABSURD = (
    *("", " ", "-1", "-0", "nan", "inf", "-inf", "1e300", "1e-300", "-1e300", "9" * 5000, "1e" + "9" * 400),
    *("x", "0x10", "1_0", "²", "٣", "\udcff", "1,,2", ",", "=", "a=", "=b", "\0"),
)


def typed(command: str) -> list[argparse.Action]:
    """Return the arguments of a command that are converted."""
    parser = argparse.ArgumentParser(add_help=False)
    import_module(f"candaemon.cli.{command.replace('-', '_')}").add_arguments(parser)
    return [action for action in parser._actions if callable(action.type)]


def refusal(read: Callable[[str], object], text: str) -> str:
    """Return what is said of a text that is refused; nothing of one that is taken."""
    try:
        read(text)
    except argparse.ArgumentTypeError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("command", COMMANDS)
def test_whatever_is_typed_is_taken_or_refused_with_what_was_expected(command: str) -> None:
    for action in typed(command):
        assert callable(action.type)
        for text in ABSURD:
            said = refusal(action.type, text)
            assert said == "" or "expected" in said
            assert len(said) < 200


@pytest.mark.parametrize(
    ("command", "option", "least", "most"),
    [
        ("simulate", "--seed", 0, arguments.LARGEST_SEED),
        ("demo", "--seed", 0, arguments.LARGEST_SEED),
        ("papers", "--seed", 0, arguments.LARGEST_SEED),
        ("papers", "--runs", 1, papers.MOST_RUNS),
        ("demo", "--duration", demo.SHORTEST_DRIVE, LONGEST_DRIVE),
        ("demo", "--speed", arguments.SLOWEST, arguments.FASTEST),
        ("replay", "--speed", arguments.SLOWEST, arguments.FASTEST),
        ("replay", "--smooth", replay.SHORTEST_LAG, replay.LONGEST_LAG),
        ("run", "--status", 0, run.LONGEST_STATUS_INTERVAL),
    ],
)
def test_a_number_is_taken_up_to_its_limits_and_no_further(
    command: str, option: str, least: float, most: float
) -> None:
    (read,) = (action.type for action in typed(command) if option in action.option_strings)
    assert callable(read)
    assert [read(f"{least}"), read(f"{most}")] == [least, most]
    step = 1 if isinstance(most, int) else 1e-4
    for beyond in (least - step, most + step):
        with pytest.raises(argparse.ArgumentTypeError, match=r"found '.*', expected a (whole )?number from"):
            read(f"{beyond}")


def test_horizons_have_limits_each_and_together() -> None:
    shortest, longest, most = replay.SHORTEST_HORIZON, replay.LONGEST_HORIZON, replay.MOST_HORIZONS
    assert replay.horizons(f"{longest},{shortest},{longest}") == (shortest, longest)
    many = [f"{1 + number}" for number in range(most)]
    assert len(replay.horizons(",".join(many))) == most
    for beyond in (f"{longest + 0.1}", f"{shortest - 1e-4}", ",".join([*many, "0.5"])):
        with pytest.raises(argparse.ArgumentTypeError, match="expected"):
            replay.horizons(beyond)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["chek", "a.yaml"], "; did you mean 'check'?"),
        (["convert", "a", "b", "--force"], "usage: candaemon convert [-h]"),
        (["check", "a", "--zz", "b", "c"], "candaemon check: error: unrecognized arguments: --zz"),
        (["fleet", "compare", "a", "b", "--zz"], "candaemon fleet compare: error: unrecognized arguments: --zz"),
        (["fleet", "compare", "a", "b", "--zz"], "usage: candaemon fleet compare [-h]"),
    ],
)
def test_what_is_mistyped_is_told_beside_what_the_command_takes(
    words: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == 2
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize("before", ["view C --port 0", "fleet run C -o R", "check C --log B", "replay C -o R"])
def test_logs_may_follow_an_option(before: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[argparse.Namespace] = []
    command = before.partition(" ")[0]
    monkeypatch.setattr(f"candaemon.cli.{command}.execute", found.append)
    assert main([*before.split(), "a.log", "b.log"]) == 0
    assert main([*before.split()[:-2], "a.log", "b.log", *before.split()[-2:]]) == 0
    assert [[str(log) for log in each.log] for each in found] == [["a.log", "b.log"]] * 2
