"""The architecture holds: imports run downwards, files stay short, what is exported is what is said to be."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest
from conftest import ROOT

import candaemon

PACKAGE = ROOT / "candaemon"
LONGEST_FILE = 300

LAYERS: tuple[tuple[str, ...], ...] = (
    ("errors",),
    ("config", "share", "files"),
    ("bus", "estimation"),
    ("binding",),
    ("sensing",),
    ("tracking",),
    ("output", "simulation", "evaluation"),
    ("cycle", "receiver"),
    ("pipeline", "papers", "smoother"),
    ("summary", "recorder", "snapshot", "handover"),
    ("recordings",),
    ("replayer", "service"),
    ("arguments", "terminal", "show"),
    ("watch_view",),
    ("check", "demo", "watch"),
    ("cli",),
    ("__main__",),
)
"""Rooms from the bottom to the top; a room imports from those below it and from itself."""
LAYER_OF = {room: layer for layer, rooms in enumerate(LAYERS) for room in rooms}

IGNORANT = {
    "bus": {"config.ego", "config.sensors", "config.output", "config.tracker"},
    "config": {"bus"},
    "estimation": {"bus", "config.ego", "config.sensors", "config.output", "config.buses"},
    "evaluation": {"bus", "binding", "sensing", "estimation", "config"},
    "output": {"estimation"},
    "papers": {"bus", "binding", "sensing", "simulation"},
    "pipeline": {"bus.live", "bus.ports", "bus.logs"},
    "sensing": {"bus.live", "bus.logs"},
    "service": {"estimation", "evaluation", "simulation"},
    "simulation": {"sensing", "tracking", "estimation"},
    "tracking": {"bus", "binding"},
}
"""What a room must know nothing of, though it lies below it."""

READS_NO_CLOCK = ("bus", "sensing", "tracking", "estimation", "binding", "config", "output", "pipeline")
MAY_KNOW_TIME = {"bus.live", "bus.ports", "bus.socketcan", "bus.multicast"}

HEAVY = {"scipy", "filterpy", "matplotlib", "rich", "prometheus_client"}


def modules() -> dict[str, Path]:
    """Return every module of the package by its name below `candaemon`."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        name = ".".join(part for part in parts if part != "__init__")
        if name:
            found[name] = path
    return found


MODULES = modules()


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield all nodes but those that only a type checker runs."""
    for child in ast.iter_child_nodes(tree):
        if isinstance(child, ast.If) and isinstance(child.test, ast.Name) and child.test.id == "TYPE_CHECKING":
            continue
        yield child
        yield from statements(child)


def imported(path: Path) -> set[str]:
    """Return the modules of the package that a file imports."""
    names = set()
    for node in statements(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            assert node.level == 0, f"{path}: a relative import"
            names.add(node.module)
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    below = {name.removeprefix("candaemon.") for name in names if name.startswith("candaemon.")}
    return below & MODULES.keys()


IMPORTS = {name: imported(path) for name, path in MODULES.items()}


def room(module: str) -> str:
    return module.partition(".")[0]


def test_every_room_has_its_layer() -> None:
    assert {room(module) for module in MODULES} == LAYER_OF.keys()


@pytest.mark.parametrize("module", MODULES)
def test_imports_run_downwards(module: str) -> None:
    here = room(module)
    upwards = {
        target for target in IMPORTS[module] if room(target) != here and LAYER_OF[room(target)] >= LAYER_OF[here]
    }
    assert not upwards


def test_there_are_no_circles() -> None:
    # A package's `__init__` gathers its own modules; they may come back to the package only for what is not gathered.
    graph = {module: targets - {module} for module, targets in IMPORTS.items()}
    packages = {module for module, path in MODULES.items() if path.name == "__init__.py"}
    for module, targets in graph.items():
        targets -= {package for package in packages if module.startswith(f"{package}.")}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"a circle: {' → '.join(error.args[1])}")


@pytest.mark.parametrize("here", IGNORANT)
def test_a_room_knows_nothing_of_what_is_not_its_own(here: str) -> None:
    known = {
        (module, target)
        for module, targets in IMPORTS.items()
        if room(module) == here
        for target in targets
        if target in IGNORANT[here] or any(target.startswith(f"{unknown}.") for unknown in IGNORANT[here])
    }
    assert not known


def test_nothing_below_the_service_reads_a_clock() -> None:
    readers = {
        module
        for module, path in MODULES.items()
        if room(module) in READS_NO_CLOCK and module not in MAY_KNOW_TIME
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if (isinstance(node, ast.Import) and any(alias.name == "time" for alias in node.names))
        or (isinstance(node, ast.ImportFrom) and node.module == "time")
        or (isinstance(node, ast.Attribute) and node.attr in {"now", "utcnow", "today"})
    }
    assert not readers


@pytest.mark.parametrize("module", MODULES)
def test_files_are_short(module: str) -> None:
    lines = MODULES[module].read_text(encoding="utf-8").count("\n")
    assert lines <= LONGEST_FILE, f"{lines} lines: split it"


def test_exported_names_are_sorted_and_there() -> None:
    assert sorted(candaemon.__all__) == candaemon.__all__
    assert {name for name in candaemon.__all__ if getattr(candaemon, name, None) is None} == set()
    assert dir(candaemon) == candaemon.__all__


def test_exported_names_are_these() -> None:
    needed = {"load_config", "bind", "Pipeline", "replay", "ReplayRequest", "Imm", "LinearModel", "CurrentStatistical"}
    assert needed <= set(candaemon.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = candaemon.nothing


@pytest.mark.parametrize(
    "module",
    [name for name, path in MODULES.items() if path.name == "__init__.py"],
    ids=lambda name: f"candaemon.{name}",
)
def test_packages_export_what_they_say(module: str) -> None:
    package = import_module(f"candaemon.{module}")
    for name in getattr(package, "__all__", ()):
        assert hasattr(package, name)


def loaded_after(statement: str) -> set[str]:
    """Return the top-level modules that a fresh interpreter has loaded after a statement."""
    code = f"{statement}\nimport sys\nprint(*{{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_import_candaemon_costs_nothing() -> None:
    assert not loaded_after("import candaemon") & (HEAVY | {"numpy", "can", "cantools", "pydantic"})


def test_the_command_line_starts_without_libraries() -> None:
    assert not loaded_after("import candaemon.cli") & (HEAVY | {"numpy", "can", "cantools", "pydantic", "yaml"})


def test_the_tables_of_the_papers_need_no_matplotlib() -> None:
    assert "matplotlib" not in loaded_after("import candaemon.papers.registry, candaemon.papers.report")


def test_the_service_loads_neither_scipy_nor_rich() -> None:
    ready = (
        "from pathlib import Path\nimport candaemon\nfrom candaemon.service.serve import Daemon\n"
        f"Daemon(candaemon.bind(candaemon.load_config(Path({str(ROOT / 'config' / 'demo.yaml')!r}))))"
    )
    assert not loaded_after(ready) & HEAVY
