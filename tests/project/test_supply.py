"""What is installed and built: lower bounds that work, equal bytes from every build, licences that are listed."""

from __future__ import annotations

import importlib.metadata
import os
import random
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.support.paths import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
LICENCES = ROOT / "docs" / "licences.md"
QUICK = (
    "binding",
    "config",
    "dbc",
    "evaluation",
    "objects",
    "output",
    "pipeline",
    "protection",
)
"""Rooms whose tests are enough to notice a library that is too old; `can_io` beside them."""
LOGS = ("e2e", "mdf", "zst")
"""Extras that those tests need."""
SPDX = {
    "MIT": {"MIT"},
    "MIT License": {"MIT"},
    "3-Clause BSD License": {"BSD-3-Clause"},
    "BSD": {"BSD-2-Clause", "BSD-3-Clause"},
    "BSD License": {"BSD-2-Clause", "BSD-3-Clause"},
    "Apache 2.0": {"Apache-2.0"},
    "Apache-2.0": {"Apache-2.0"},
    "Apache Software License": {"Apache-2.0"},
    "Python Software Foundation License": {"PSF-2.0"},
    "Mozilla Public License 2.0 (MPL 2.0)": {"MPL-2.0"},
    "ISC License (ISCL)": {"ISC"},
    "BSD-3-Clause": {"BSD-3-Clause"},
    "GNU Lesser General Public License v3 or later (LGPLv3+)": {"LGPL-3.0-or-later"},
}
"""What metadata without an SPDX expression may mean."""


def lowest(*extras: str) -> Iterator[str]:
    """Yield the lowest version that is named of each direct dependency, as a constraint of pip."""
    for text in (*PROJECT["dependencies"], *(each for extra in extras for each in EXTRAS[extra])):
        requirement = Requirement(text)
        if requirement.name != PROJECT["name"] and requirement.specifier:
            (bound,) = requirement.specifier
            assert bound.operator == ">=", f"{text}: expected a lower bound alone"
            yield f"{requirement.name}=={bound.version}"


@pytest.mark.slow
def test_the_lowest_versions_that_are_named_work_together(tmp_path: Path) -> None:
    python = str(tmp_path / "venv" / "bin" / "python")
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    constraints = tmp_path / "constraints.txt"
    constraints.write_text("\n".join(lowest(*LOGS, "dev")), encoding="utf-8")
    pip = [python, "-m", "pip", "--disable-pip-version-check"]
    asked = [*pip, "download", "--no-deps", "-d", str(tmp_path), "iniconfig"]
    if subprocess.run(asked, capture_output=True, check=False).returncode:
        pytest.skip("no package index can be reached")
    wanted = ["-c", str(constraints), f"{ROOT}[{','.join(LOGS)}]", "pytest", "hypothesis", "jsonschema"]
    installed = subprocess.run([*pip, "install", "--quiet", *wanted], capture_output=True, text=True, check=False)
    assert installed.returncode == 0, installed.stderr[-3000:]
    folders = [f"tests/{room}" for room in (*QUICK, "can_io")]
    command = [python, "-m", "pytest", "-q", "-x", *folders]
    # all examples of each property are for the versions that are installed: a library that is too old fails the first
    usual = {key: value for key, value in os.environ.items() if key != "CANDAEMON_THOROUGH"}
    ended = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, env=usual)
    assert ended.returncode == 0, ended.stdout[-5000:]


@pytest.mark.slow
def test_a_build_gives_the_same_bytes_wherever_and_whenever_it_is_made(tmp_path: Path) -> None:
    pytest.importorskip("hatchling")
    builds = []
    for name, umask in (("here", 0o022), ("elsewhere at another time", 0o077)):
        folder = tmp_path / name
        _copy(folder)
        environment = {key: value for key, value in os.environ.items() if key != "SOURCE_DATE_EPOCH"}
        subprocess.run(
            [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-t", "wheel", "-d", "dist"],
            cwd=folder,
            env=environment,
            umask=umask,
            check=True,
            capture_output=True,
        )
        builds.append({path.name: path.read_bytes() for path in (folder / "dist").iterdir()})
    assert sorted(path.rpartition(".")[2] for path in builds[0]) == ["gz", "whl"]
    assert builds[0] == builds[1]


def _copy(folder: Path) -> None:
    """Copy what git knows, with times of its own."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    chance = random.Random(str(folder))  # noqa: S311 - test data
    for name in listed.rstrip("\0").split("\0"):
        if (ROOT / name).is_file():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, path)
            os.utime(path, (chance.randint(10**9, 2 * 10**9),) * 2)


def rows() -> dict[str, str]:
    """Return the licence of each package in the page."""
    text = LICENCES.read_text(encoding="utf-8")
    found = re.findall(r"^\| ([\w.-]+) \| ([^|]+) \| [^|]{5,} \|$", text, re.MULTILINE)
    assert len(found) == len(dict(found)), "a package is there twice"
    return dict(found)


def needed() -> dict[str, importlib.metadata.Distribution]:
    """Return what candaemon and its extras need, directly and further on, as far as it is installed."""
    found: dict[str, importlib.metadata.Distribution] = {}
    waiting = [
        Requirement(text) for text in (*PROJECT["dependencies"], *(each for extra in EXTRAS.values() for each in extra))
    ]
    while waiting:
        requirement = waiting.pop()
        name = canonicalize_name(requirement.name)
        try:
            distribution = importlib.metadata.distribution(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            continue
        fresh = name not in found and name != PROJECT["name"]
        if fresh:
            found[name] = distribution
        if fresh or (requirement.extras and name != PROJECT["name"]):
            for text in distribution.requires or []:
                further = Requirement(text)
                if any(
                    further.marker is None or further.marker.evaluate({"extra": extra})
                    for extra in ("", *requirement.extras)
                ) and not (further.marker and canonicalize_name(further.name) in found):
                    waiting.append(further)
    return found


def test_the_licence_of_every_dependency_is_listed_as_it_says_itself() -> None:
    listed, every = rows(), needed()
    assert not every.keys() - listed.keys(), "not in docs/licences.md"
    direct = {canonicalize_name(Requirement(text).name) for extra in EXTRAS.values() for text in extra}
    direct |= {canonicalize_name(Requirement(text).name) for text in PROJECT["dependencies"]}
    assert not direct - {PROJECT["name"]} - listed.keys()
    for name, distribution in every.items():
        assert listed[name] in _possible(distribution), f"{name}: {listed[name]} is listed"


def _possible(distribution: importlib.metadata.Distribution) -> set[str]:
    """Return the SPDX expressions that a distribution's metadata allows."""
    metadata = distribution.metadata
    if "License-Expression" in metadata:
        return {metadata["License-Expression"]}
    classifiers = [each.split(" :: ")[-1] for each in metadata.get_all("Classifier", []) if each.startswith("License")]
    said = [*classifiers, *metadata.get_all("License", [])]
    return {spdx for each in said for spdx in SPDX.get(each, ())}
