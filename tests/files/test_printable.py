"""Text from outside cannot act on a terminal, nor begin a line."""

from __future__ import annotations

import pytest

from candaemon.errors import ConfigError
from candaemon.printable import LONGEST_SHOWN, printable


@pytest.mark.parametrize("harmless", ["", "can0", "Straße, 東京: 12 °C", "[bold]", "a\\b"])
def test_text_without_control_characters_stays(harmless: str) -> None:
    assert printable(harmless) == harmless


@pytest.mark.parametrize(
    ("character", "shown"),
    [
        ("\x1b", r"\x1b"),
        ("\n", r"\n"),
        ("\r", r"\r"),
        ("\x85", r"\x85"),
        ("\u2028", r"\u2028"),
        ("\u2029", r"\u2029"),
        ("\u202e", r"\u202e"),
        ("\udcff", r"\udcff"),
        ("\0", r"\x00"),
    ],
)
def test_what_acts_on_a_terminal_is_escaped(character: str, shown: str) -> None:
    assert printable(f"a{character}b") == f"a{shown}b"


def test_a_long_text_is_cut() -> None:
    assert printable("x" * LONGEST_SHOWN, LONGEST_SHOWN) == "x" * LONGEST_SHOWN
    assert printable("x" * (LONGEST_SHOWN + 1), LONGEST_SHOWN) == "x" * LONGEST_SHOWN + "..."


def test_an_error_has_one_line_whatever_it_quotes() -> None:
    error = ConfigError("found '\n<0>forged\x1b[2J'", file="a\nb.yaml", line=3)
    assert str(error) == r"a\nb.yaml:3: found '\n<0>forged\x1b[2J'"


def test_errors_found_together_have_a_line_each() -> None:
    second = ConfigError("second\n", file="a.yaml", line=9)
    assert str(ConfigError("first", file="a.yaml", line=3, others=[second])) == "a.yaml:3: first\na.yaml:9: second\\n"
