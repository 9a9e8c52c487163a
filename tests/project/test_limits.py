"""The table of limits says what the code does: each value, where it is set, and a test at it and beyond."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from candaemon import json_schema
from tests.support.paths import ROOT

UNITS = {
    "": 1,
    "KiB": 1 << 10,
    "MiB": 1 << 20,
    "GiB": 1 << 30,
    "ns": 1e-9,
    "µs": 1e-6,
    "ms": 1e-3,
    "min": 60,
    "%": 0.01,
}
"""Factors of the units; any other word, such as `s`, `bytes` or `clients`, counts as 1."""


class Limit(NamedTuple):
    """A row of the table."""

    what: str
    value: str
    place: str
    beyond: str
    test: str


def _rows() -> list[Limit]:
    lines = (ROOT / "docs" / "limits.md").read_text(encoding="utf-8").splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    return [Limit(*row) for row in cells[2:]]


LIMITS = _rows()


def _number(text: str) -> float:
    """Return the number that a cell begins with, times its unit: 4 MiB, 1e39, 1,000 frames."""
    match = re.match(r"([\d,.]+(?:e-?\d+)?)(?: (\S+))?", text)
    assert match is not None, text
    return float(match[1].replace(",", "")) * UNITS.get(match[2] or "", 1)


def _constant(place: str) -> float | None:
    """Return the value of a named constant of the package; None where the place is a setting."""
    if not place.startswith("candaemon."):
        return None
    module, _, name = place.rpartition(".")
    value: Any = getattr(import_module(module), name)
    return float(value)


def _settings() -> set[str]:
    return {key for form in json_schema()["$defs"].values() for key in form.get("properties", {})}


@pytest.mark.parametrize("limit", LIMITS, ids=[limit.what for limit in LIMITS])
def test_a_limit_is_what_the_code_has(limit: Limit) -> None:
    place = limit.place.strip("`")
    constant = _constant(place)
    if constant is None:
        assert place.rpartition(".")[2] in _settings()
    else:
        assert _number(limit.value) == pytest.approx(constant, rel=1e-9)


@pytest.mark.parametrize("limit", LIMITS, ids=[limit.what for limit in LIMITS])
def test_a_limit_has_a_test(limit: Limit) -> None:
    for named in re.findall(r"`([^`]+)`", limit.test):
        file, _, function = named.partition("::")
        assert f"def {function}(" in Path(ROOT / file).read_text(encoding="utf-8"), named
    assert "::" in limit.test
