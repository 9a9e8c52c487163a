"""What the documentation says is so: commands and examples run, YAML is good, names, files and links exist."""

from __future__ import annotations

import gzip
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml
from pydantic import TypeAdapter

import candaemon
from candaemon import bind, json_schema, load_config, load_scenario
from candaemon.cli.main import main
from candaemon.config.estimators import EstimatorSettings
from candaemon.config.vehicle import VehicleEstimatorSettings
from tests.beds.waiting import wait_until
from tests.project.pages import PAGES, Page
from tests.project.test_structure import ROOMS
from tests.support.paths import ROOT

NOT_RUN = {
    "python3 -m venv": "sets up an installation of its own; CI begins with the line as it stands",
    ".venv/bin/python -m pytest": "the tests themselves",
    ".venv/bin/ruff": "CI runs it",
    ".venv/bin/mypy": "CI runs it",
    ".venv/bin/mkdocs": "CI runs it",
    ".ci/run": "CI itself",
    "python -m tests.benchmarks": "takes minutes, and the machine to itself; CI runs them",
    "candump": "needs a CAN interface",
    "ip link set": "needs a CAN interface and root",
    "systemctl": "needs systemd and root; tests/systemd runs the service there",
    "journalctl": "needs systemd",
}
"""Beginnings of commands that a test cannot run, and why."""

TOO_LONG = ("python -m tests.",)
"""Beginnings of commands that take minutes: their help must know the options that they are given."""

INSTEAD = {
    "/etc/candaemon/front.yaml": str(ROOT / "config" / "esr_ins.yaml"),
    "/var/tmp/drive": "recording",  # noqa: S108 - to be replaced
}
"""Words of commands, and what stands in for them."""

ADDED = {
    "demo": ["--duration", "1", "--port", "0", "--view-for", "0.01"],
    "papers": ["003", "--runs", "2"],
    "status": ["--once"],
    "view": ["--duration", "0.01", "--port", "0"],
    "watch": ["--duration", "0.01"],
}
"""Arguments that let a command end soon."""

SHORT = "duration: 3\nego: {start: {speed: 20}}\nactors: [{name: lead, start: {x: 40, y: 0, vx: 20, vy: 0}}]\n"


def shipped(name: str) -> str:
    """Return a configuration that comes with candaemon, to be put elsewhere."""
    return (ROOT / "config" / f"{name}.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))


@pytest.fixture(scope="session")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of what the pages take as given."""
    folder = tmp_path_factory.mktemp("given")
    scenario, car = folder / "highway", folder / "my_car.yaml"  # a file goes before the scenario of that name
    scenario.write_text(SHORT, encoding="utf-8")
    car.write_text(shipped("demo"), encoding="utf-8")
    for config, log in (("toyota_rav4", "drive.log.gz"), (str(car), "drive.log"), ("esr_ins", "highway.log")):
        assert main(["simulate", str(scenario), config, "-o", str(folder / log)]) == 0
    lines = gzip.decompress((folder / "drive.log.gz").read_bytes()).decode().splitlines(keepends=True)
    for log, channel in (("radar.log", " can1 "), ("car.log", " can0 ")):
        (folder / log).write_text("".join(line for line in lines if channel in line), encoding="utf-8")
    return folder


@pytest.fixture
def folder(given: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder of a reader."""
    shutil.copytree(given, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def services(monkeypatch: pytest.MonkeyPatch) -> Iterator[ExitStack]:
    """Keep services running until a page is done; their sockets lie where paths are short enough for them."""
    with TemporaryDirectory() as runtime, ExitStack() as running:
        monkeypatch.setenv("XDG_RUNTIME_DIR", runtime)
        monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
        yield running


def serve(words: list[str], running: ExitStack) -> None:
    """Start a service, and have it ended well with the page."""
    service = subprocess.Popen([sys.executable, "-m", "candaemon", *words], stderr=subprocess.PIPE, text=True)

    def end() -> None:
        service.terminate()
        assert service.wait(20) == 0
        assert service.stderr is not None
        service.stderr.close()

    running.callback(end)
    assert service.stderr is not None
    assert any("serving" in line for line in service.stderr)
    if "--record" in words:
        wait_until(lambda: any(Path("recording").glob("*.log")), 20, "a file of the ring")


def check_help(line: str) -> None:
    """Assert that a command exists and knows its options."""
    words = shlex.split(line)
    asked = subprocess.run(
        [sys.executable, *words[1:3], "--help"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    for option in (word for word in words if word.startswith("--")):
        assert option in asked.stdout, line


def run(line: str, running: ExitStack) -> None:
    """Run a command as it stands, or as much of it as a test can."""
    program, *words = (INSTEAD.get(word, word) for word in shlex.split(line))
    if line.startswith(TOO_LONG):
        check_help(line)
    elif program == "python":
        subprocess.run([sys.executable, str(ROOT / words[0]), *words[1:]], check=True, capture_output=True)
    elif program == "candaemon" and words[0] == "run":
        serve(words, running)
    else:
        assert program == "candaemon", f"{line}: neither run nor listed among what is not"
        assert main([*words, *ADDED.get(words[0], [])]) == 0, line


@pytest.mark.parametrize("name", [name for name, page in PAGES.items() if page.commands()])
@pytest.mark.usefixtures("folder")
def test_commands_run_as_written(name: str, services: ExitStack, capsys: pytest.CaptureFixture[str]) -> None:
    page = PAGES[name]
    for block, file in zip(page.blocks("dbc"), ["my_car.dbc"], strict=False):  # the page brings its own car
        Path(file).write_text(block, encoding="utf-8")
        (whole,) = [text for text in page.blocks("yaml") if "sensors:" in text]
        Path("my_car.yaml").write_text(whole, encoding="utf-8")
        assert main(["simulate", "highway", "my_car.yaml", "-o", "drive.log"]) == 0
    for line in page.commands():
        if not left_out(line):
            run(line, services)
    capsys.readouterr()


def left_out(line: str) -> bool:
    """Return whether a command is one that no test runs."""
    return any(f"{line} ".startswith(f"{beginning} ") for beginning in NOT_RUN)


def test_what_is_not_run_is_there() -> None:
    lines = [line for page in PAGES.values() for line in page.commands()]
    for beginning in NOT_RUN:
        assert any(f"{line} ".startswith(f"{beginning} ") for line in lines), beginning


@pytest.mark.parametrize("name", [name for name, page in PAGES.items() if page.blocks("python")])
def test_python_runs_as_written(name: str, folder: Path) -> None:
    for block in PAGES[name].blocks("python"):
        subprocess.run([sys.executable, "-c", block], cwd=folder, capture_output=True, check=True)


def merged(base: Any, part: Any) -> Any:
    """Return a configuration with a part of another in its place."""
    if (
        not isinstance(base, dict)
        or not isinstance(part, dict)
        or base.get("kind") != part.get("kind", base.get("kind"))
    ):
        return part
    return {**base, **{key: merged(base.get(key), value) for key, value in part.items()}}


FRAGMENTS = [
    pytest.param(block, id=f"{name}-{number}")
    for name, page in PAGES.items()
    for number, block in enumerate(page.blocks("yaml"))
    if "duration:" in block or "sensors:" not in block or "buses:" not in block
]


@pytest.mark.parametrize("block", FRAGMENTS)
def test_pieces_of_yaml_are_good(block: str, tmp_path: Path) -> None:
    """A scenario by itself, a part of a configuration in a whole one."""
    path = tmp_path / "piece.yaml"
    part = yaml.safe_load(block)
    if "duration" in part:
        path.write_text(block, encoding="utf-8")
        load_scenario(path)
        return
    whole = merged(yaml.safe_load(shipped("esr_ins")), part)
    path.write_text(yaml.safe_dump(whole).replace("../dbc", str(ROOT / "dbc")), encoding="utf-8")
    bind(load_config(path))


@pytest.mark.parametrize("page", PAGES.values(), ids=list(PAGES))
def test_commands_within_the_text_are_known(page: Page, capsys: pytest.CaptureFixture[str]) -> None:
    for name in {word for text in page.inline() for word in re.findall(r"^candaemon ([\w-]+)", text)}:
        with pytest.raises(SystemExit) as stop:
            main([name, "--help"])
        assert stop.value.code == 0, name
    capsys.readouterr()


@pytest.mark.parametrize("page", PAGES.values(), ids=list(PAGES))
def test_files_and_names_exist(page: Page) -> None:
    for text in page.inline():
        if re.fullmatch(r"(?:config|dbc|candaemon|tests|docs|examples|\.ci)/[\w./@-]*", text):
            assert (ROOT / text).exists(), text
        if re.fullmatch(r"candaemon(?:\.\w+)+", text):
            assert is_there(text), text
    for name in re.findall(r"^::: ([\w.]+)$", page.text, re.MULTILINE):
        assert is_there(name), name


def is_there(dotted: str) -> bool:
    """Return whether a name is a module, or something in one."""
    module, _, name = dotted.rpartition(".")
    if find_spec(module) is not None and hasattr(import_module(module), name):
        return True
    return find_spec(dotted) is not None


@pytest.mark.parametrize("page", PAGES.values(), ids=list(PAGES))
def test_links_lead_somewhere(page: Page) -> None:
    for target, anchor in re.findall(r"\]\(([^)#:]*)(?:#([^)]*))?\)", page.text):
        found = page.path.parent / target if target else page.path
        assert found.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", found.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_page_is_in_the_navigation() -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    assert set(re.findall(r"\S+\.md", text)) == {
        name.removeprefix("docs/") for name in PAGES if name.startswith("docs/")
    }


def test_filters_that_are_named_exist() -> None:
    """And all that exist are named."""
    (table,) = [part for part in PAGES["docs/estimators.md"].text.split("\n\n") if part.startswith("| kind | filter |")]
    named = {kind for row in table.splitlines()[2:] for kind in re.findall(r"`(\w+)`", row.split("|")[1])}
    schema = TypeAdapter(EstimatorSettings).json_schema()
    assert named == set(schema["discriminator"]["mapping"])


def test_configurations_that_are_named_exist() -> None:
    """And all that exist are named."""
    part = PAGES["docs/configuration.md"].text.partition("## Ready to use")[2].partition("\n## ")[0]
    rows = [row for row in part.splitlines() if row.startswith("| `")]
    named = {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}
    assert named - {"_fd"} == {path.stem for path in (ROOT / "config").glob("*.yaml")}


schema_of_all = cache(json_schema)


def resolved(path: str) -> dict[str, Any] | None:
    """Return the schema of a setting, such as `tracker.association.gate`; None if there is none."""
    root = schema_of_all()
    found = [root]
    for key in path.split("."):
        found = [each for schema in found for each in properties(root, schema, key)]
    return found[0] if found else None


def properties(root: dict[str, Any], schema: dict[str, Any], key: str) -> Iterator[dict[str, Any]]:
    """Yield the schemas of a key, in a schema and in its alternatives."""
    if "$ref" in schema:
        yield from properties(root, root["$defs"][schema["$ref"].rpartition("/")[2]], key)
    for each in (*schema.get("anyOf", ()), *schema.get("oneOf", ()), *schema.get("allOf", ())):
        yield from properties(root, each, key)
    if key in schema.get("properties", {}):
        yield schema["properties"][key]
    if isinstance(schema.get("additionalProperties"), dict):  # a name of the user's, such as a bus
        yield from properties(root, schema["additionalProperties"], key)


@pytest.mark.parametrize("page", PAGES.values(), ids=list(PAGES))
def test_settings_that_are_named_exist(page: Page) -> None:
    for text in page.inline():
        if re.fullmatch(r"(?:ego|sensors|tracker|output|supervision|service)(?:\.\w+)+", text):
            assert resolved(text) is not None, text


def test_all_settings_of_vehicles_are_described() -> None:
    part = PAGES["docs/estimators.md"].text.partition("## Vehicles")[2].partition("\n## ")[0]
    cells = re.findall(r"^\| (`[^|]+) \|", part.partition("| key |")[2], re.MULTILINE)
    described = [key for cell in cells for key in re.findall(r"`([\w.]+)`", cell)]
    settings = VehicleEstimatorSettings(kind="vehicle").model_dump(exclude={"kind"})
    leaves = [
        f"{name}.{key}" if key else name
        for name, value in settings.items()
        for key in (value if isinstance(value, dict) else ("",))
    ]
    assert sorted(described) == sorted(leaves)


def test_defaults_are_those_of_the_settings() -> None:
    """In each table of keys below a heading that names a section."""
    tried = 0
    for name, headings in (("docs/configuration.md", {}), ("docs/operating.md", {"Recording": "service.recording"})):
        for part in re.split(r"^## ", PAGES[name].text, flags=re.MULTILINE)[1:]:
            section = re.sub(r"\W.*", "", part.lstrip("`").splitlines()[0])
            section = headings.get(section, section)
            tables = re.findall(r"^\| key[^|]*\| default \|.*?(?=^$|\Z)", part, re.MULTILINE | re.DOTALL)
            for row in re.findall(r"^\| (`[^|]+) \| ([^|]+) \|", "\n".join(tables), re.MULTILINE):
                tried += check_defaults(section, *row)
    assert tried > 20


def check_defaults(section: str, keys: str, values: str) -> int:
    """Compare the defaults in a table's row with those of the settings; return how many there were."""
    tried, above = 0, ""
    for key, value in zip(re.findall(r"`([\w.]+)`", keys), values.split(", "), strict=False):
        above, last = (key.rpartition(".")[0], key.rpartition(".")[2]) if "." in key else (above, key)
        path = ".".join(filter(None, (above, last)))
        schema = resolved(path) if path.startswith(section) else resolved(f"{section}.{path}")
        default = None if schema is None else schema.get("default")
        if not isinstance(default, str | int | float):
            continue
        said = value.strip("` ").partition(" ")[0]
        assert said == str(default).lower() or float(said) == float(default), (path, value)
        tried += 1
    return tried


def test_metrics_that_are_named_exist() -> None:
    """And all that exist are named."""
    source = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "candaemon" / "status").glob("*.py"))
    named = {text for text in PAGES["docs/operating.md"].inline() if text.startswith("candaemon_")}
    assert named == set(re.findall(r'"(candaemon_\w+)"', source))


def test_rooms_are_told_in_the_order_of_imports() -> None:
    table = PAGES["docs/architecture.md"].text.partition("| room |")[2].partition("\n\n")[0]
    told = [room for row in table.splitlines() for room in re.findall(r"`(\w+)`", row.split("|")[1] if row else "")]
    assert told == [room for room in ROOMS if room not in {"candaemon", "__main__"}]


def test_the_return_time_is_the_default() -> None:
    described = PAGES["docs/obstacles.md"].text.partition("with a time constant of ")[2].partition(" s")[0]
    assert load_config(ROOT / "config" / "demo.yaml").config.tracker.reflections.return_time == float(described)


def test_public_names_are_in_the_api() -> None:
    text = PAGES["docs/api/index.md"].text
    assert set(re.findall(r"^::: candaemon\.(\w+)$", text, re.MULTILINE)) == {*candaemon.__all__} - {"__version__"}


@pytest.mark.parametrize("name", ["flow.svg", "scene.svg"])
def test_images_are_pictures(name: str) -> None:
    path = ROOT / "docs" / "images" / name
    assert ET.parse(path).getroot().tag == "{http://www.w3.org/2000/svg}svg"  # noqa: S314 - our own file


def test_the_flow_is_drawn_for_light_and_dark() -> None:
    assert "prefers-color-scheme: dark" in (ROOT / "docs" / "images" / "flow.svg").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_recorded_drive_is_replayed_as_written(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(drive / "drive.log.gz", tmp_path)
    (line,) = [line for line in PAGES["docs/replay.md"].commands() if "replay toyota_rav4 drive" in line]
    assert main(shlex.split(line)[1:]) == 0
    assert {"obstacles.log", "tracks.csv", "predictions.csv", "summary.json"} <= {
        path.name for path in tmp_path.iterdir()
    }
    assert "sensors.front.used: 38400" in capsys.readouterr().out
