"""What the wizard found out: values of a configuration, each with its evidence, and whether it is a guess."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

GUESS: Final = "guess: "
"""What the comment of a guess begins with; `candaemon check` repeats such lines."""


@dataclass(frozen=True, slots=True)
class Choice:
    """A value of a configuration.

    Attributes:
        value: as YAML.
        why: the evidence, for the comment beside it.
        guess: whether it is not proven.
        ask: what to ask a user of a guess; empty where there is nothing that a user would know better.
        options: other values that a user may take.
    """

    value: str
    why: str
    guess: bool = False
    ask: str = ""
    options: tuple[str, ...] = ()


Ask: TypeAlias = Callable[[str, Choice], Choice]
"""Asks a user about a guess, by the key it is of; returns it as it is, or another value that is no guess any more."""


def take_guess(_key: str, choice: Choice) -> Choice:
    """Take the best guess without asking."""
    return choice


def guessed_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines of a configuration that `candaemon init` marked as guesses."""
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        text, mark, why = line.partition(f"# {GUESS}")
        if mark and text.strip():
            yield number, f"{text.strip()}: {why.strip()}"
