"""The table of equations leads to code that names its source, and every work that is cited is in the bibliography."""

from __future__ import annotations

import ast
import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CELLS = re.compile(r"^\| (\w+) \| ([^|]+) \| ([^|]+) \| ([^|]*) \|", re.MULTILINE)
WORKS = {
    key: short.strip()
    for key, short, _ in re.findall(
        r"^\| (\w+\d{4}) \| ([^|]+) \| ([^|]+) \|$",
        (ROOT / "docs" / "bibliography.md").read_text("utf-8"),
        re.MULTILINE,
    )
}
TEXT = (ROOT / "docs" / "equations.md").read_text("utf-8")
ROWS = [row for row in CELLS.findall(TEXT.partition("## Not implemented")[0]) if "::" in row[3]]
LEFT_OUT = CELLS.findall(TEXT.partition("## Not implemented")[2])
NUMBERED = {"Han2015": 29, "Avatirak2012": 30, "KimHong2004": 17, "Zhang2016": 8, "Gao2016": 28}


def numbers(cell: str) -> set[int]:
    return {int(each) for each in cell.split(",")}


@pytest.mark.parametrize(("key", "equations", "target"), [(row[0], row[1], row[3]) for row in ROWS])
def test_a_target_names_the_equations_that_lead_to_it(key: str, equations: str, target: str) -> None:
    file, _, name = target.strip("`").partition("::")
    found = import_module(file.removesuffix(".py").replace("/", "."))
    for part in name.split("."):
        found = getattr(found, part)
    text = " ".join((found.__doc__ or "").split())
    cited = re.search(rf"{re.escape(WORKS[key])}, eqs?\. ((?:\(\d+\)(?:, )?)+)", text)
    assert cited is not None, f"{target} does not name {WORKS[key]}"
    assert numbers(equations) <= {int(each) for each in re.findall(r"\d+", cited[1])}


@pytest.mark.parametrize("key", NUMBERED)
def test_every_numbered_equation_is_in_the_table(key: str) -> None:
    listed = set().union(*(numbers(row[1]) for row in (*ROWS, *LEFT_OUT) if row[0] == key))
    assert listed == set(range(1, NUMBERED[key] + 1))


def test_what_is_cited_stands_in_the_bibliography() -> None:
    pattern = re.compile(r"[A-Z]\w+(?: and [A-Z]\w+| et al\.),? (?:19|20)\d\d\b")
    known = set(WORKS.values()) | {"Bar-Shalom et al. 2012"}
    unknown = set()
    for path in (ROOT / "candaemon").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                cited = pattern.findall(" ".join((ast.get_docstring(node) or "").split()))
                unknown |= {(path.name, each) for each in cited if not any(work.endswith(each) for work in known)}
    assert not unknown
