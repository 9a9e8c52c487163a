"""The architecture holds: imports run downwards, names are unique, every room says what it is, exports exist."""

from __future__ import annotations

import ast
import subprocess
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import candaemon
from tests.support.paths import ROOT

PACKAGE = ROOT / "candaemon"

ROOMS: tuple[str, ...] = (
    "printable",
    "similar_names",
    "errors",
    "log_lines",
    "_version",
    "arrays",
    "compiled",
    "files",
    "frames",
    "config",
    "dbc",
    "can_io",
    "protection",
    "estimation",
    "objects",
    "binding",
    "ego",
    "radar",
    "tracking",
    "calibration",
    "output",
    "pipeline",
    "evaluation",
    "exports",
    "playback",
    "daemon",
    "recording",
    "status",
    "simulation",
    "papers",
    "report",
    "view",
    "wizard",
    "fleet",
    "cli",
    "candaemon",
    "__main__",
)
"""Rooms from the bottom to the top; a room imports from those below it and from itself.

`candaemon` is the package's own `__init__.py`, which names for type checkers what it imports on first use.
"""
LAYER_OF = {room: layer for layer, room in enumerate(ROOMS)}

IGNORANT = {
    "can_io": {"config.ego", "config.sensors", "config.output", "config.tracker", "dbc"},
    "dbc": {"config", "can_io"},
    "evaluation": {"can_io"},
    "exports": {"can_io", "dbc", "cli"},
    "estimation": {"can_io", "dbc", "config.ego", "config.sensors", "config.output", "config.buses"},
    "files": {"arrays"},
    "frames": {"files"},
    "objects": {"can_io", "config"},
    "binding": {"can_io"},
    "output": {"estimation", "can_io"},
    "papers": {"can_io", "dbc", "binding", "radar", "ego", "simulation"},
    "pipeline": {"can_io"},
    "radar": {"can_io"},
    "ego": {"can_io"},
    "daemon": {"estimation", "evaluation"},
    "recording": {"estimation", "evaluation"},
    "status": {"estimation", "evaluation"},
    "simulation": {"radar", "tracking", "estimation"},
    "tracking": {"can_io", "dbc", "binding", "protection"},
}
"""What a room must know nothing of, though it lies below it."""
DEFINED_ONCE = {("simulation", "estimation.outline")}
"""A definition that both have to share: truth and estimate are of the same point."""

SAME_ROLE = {"__init__.py", "settings.py"}
"""Names of files that several rooms may have, for what has the same role in each."""
NAMED_AFTER_OTHERS = {"config", "cli"}
"""Rooms whose files are named after what they set or call."""

READS_NO_CLOCK = ROOMS[: ROOMS.index("evaluation")]
MAY_KNOW_TIME = {"can_io.live_buses", "can_io.port", "can_io.socketcan", "can_io.udp_multicast"}

HEAVY = {"scipy", "filterpy", "matplotlib", "rich", "prometheus_client", "pyarrow"}


def modules() -> dict[str, Path]:
    """Return every module of the package by its name below `candaemon`."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        found[".".join(part for part in parts if part != "__init__") or "candaemon"] = path
    return found


MODULES = modules()


def imported(path: Path) -> set[str]:
    """Return the modules of the package that a file imports, for a type checker alone or at run time."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            assert node.level == 0, f"{path}: a relative import"
            parts = {f"{node.module}.{alias.name}" for alias in node.names}
            inner = {part for part in parts if part.removeprefix("candaemon.") in MODULES}
            names |= inner if len(inner) == len(parts) else {*parts, node.module}
    return {name.removeprefix("candaemon.") for name in names if name.partition(".")[0] == "candaemon"} & MODULES.keys()


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
        if (here, target) not in DEFINED_ONCE
        and (target in IGNORANT[here] or any(target.startswith(f"{unknown}.") for unknown in IGNORANT[here]))
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


def test_exported_names_are_sorted_and_there() -> None:
    assert sorted(candaemon.__all__) == candaemon.__all__
    assert {name for name in candaemon.__all__ if getattr(candaemon, name, None) is None} == set()
    assert dir(candaemon) == candaemon.__all__


def test_exported_names_are_these() -> None:
    needed = {"load_config", "bind", "Pipeline", "replay", "ReplayRequest", "Imm", "LinearModel", "CurrentStatistical"}
    assert needed <= set(candaemon.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = candaemon.nothing


@pytest.mark.parametrize("here", [name for name in ROOMS if (PACKAGE / name).is_dir()])
def test_a_room_says_what_it_holds_and_what_it_knows_nothing_of(here: str) -> None:
    described = ast.get_docstring(ast.parse(MODULES[here].read_text(encoding="utf-8")))
    assert described is not None
    held, _, unknown = described.partition("Knows nothing ")
    assert len(held.split()) > 3
    assert len(unknown.split()) > 1


def test_no_module_lies_outside_a_room() -> None:
    assert {path.stem for path in PACKAGE.glob("*.py")} == {
        "__init__",
        "__main__",
        "errors",
        "log_lines",
        "_version",
        "printable",
        "similar_names",
    }


def test_file_names_are_unique() -> None:
    files: dict[str, list[str]] = {}
    for module, path in MODULES.items():
        if room(module) not in NAMED_AFTER_OTHERS:
            files.setdefault(path.name, []).append(module)
    assert {name: found for name, found in files.items() if len(found) > 1 and name not in SAME_ROLE} == {}


def test_class_names_are_unique() -> None:
    classes: dict[str, list[str]] = {}
    for module, path in MODULES.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                classes.setdefault(node.name, []).append(module)
    assert {name: found for name, found in classes.items() if len(found) > 1} == {}


def loaded_after(statement: str) -> set[str]:
    """Return the top-level modules that a fresh interpreter has loaded after a statement."""
    code = f"{statement}\nimport sys\nprint(*{{name.partition('.')[0] for name in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_import_candaemon_costs_nothing() -> None:
    assert not loaded_after("import candaemon") & (HEAVY | {"numpy", "can", "cantools", "pydantic"})


def test_the_command_line_starts_without_libraries() -> None:
    assert not loaded_after("import candaemon.cli.main") & (HEAVY | {"numpy", "can", "cantools", "pydantic", "yaml"})


def test_the_tables_of_the_papers_need_no_matplotlib() -> None:
    assert "matplotlib" not in loaded_after("import candaemon.papers.registry, candaemon.papers.text")


def test_the_service_loads_neither_scipy_nor_rich() -> None:
    ready = (
        "from pathlib import Path\nimport candaemon\nfrom candaemon.cli.serve import Daemon\n"
        f"Daemon(candaemon.bind(candaemon.load_config(Path({str(ROOT / 'config' / 'demo.yaml')!r}))))"
    )
    # A DBC that the cache does not know takes cantools, which takes what python-can reads logs with.
    loaded_after(ready)
    assert not loaded_after(ready) & HEAVY


def test_no_exported_function_has_the_name_of_a_room() -> None:
    # A room that is imported becomes an attribute of the package, in the place of the function.
    assert not set(candaemon.__all__) & {room(module) for module in MODULES}
