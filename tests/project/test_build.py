"""The build: with compiled kernels where there is a compiler, pure Python and a plain word where there is none."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from candaemon import compiled
from tests.support.paths import ROOT


def built(folder: Path, **environment: str) -> tuple[Path, str]:
    """Build a wheel of this checkout; return it and what the build says."""
    pytest.importorskip("hatchling")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | environment, check=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    (wheel,) = folder.iterdir()
    return wheel, done.stdout.decode()


def test_without_a_compiler_the_wheel_is_pure_and_the_build_says_why(tmp_path: Path) -> None:
    wheel, said = built(tmp_path / "dist", PATH=str(tmp_path), CC="missing")
    assert wheel.name.endswith("-py3-none-any.whl")
    assert "no compiled kernels: no C compiler is found" in said
    assert not [name for name in zipfile.ZipFile(wheel).namelist() if name.endswith(".so")]


def test_with_a_compiler_the_wheel_holds_kernels_that_this_code_calls(tmp_path: Path) -> None:
    pytest.importorskip("Cython")
    if not shutil.which("cc") and not shutil.which("gcc"):
        pytest.skip("there is no C compiler")
    wheel, said = built(tmp_path / "dist")
    if "there is no Python.h" in said:
        pytest.skip("Python's headers are not installed")
    assert "no compiled kernels" not in said
    assert "-none-any" not in wheel.name
    (library,) = (name for name in zipfile.ZipFile(wheel).namelist() if name.endswith(".so"))
    zipfile.ZipFile(wheel).extract(library, tmp_path)
    load = (
        "import importlib.util, sys; "
        "spec = importlib.util.spec_from_file_location('candaemon.compiled._kernels', sys.argv[1]); "
        "module = importlib.util.module_from_spec(spec); spec.loader.exec_module(module); print(module.REVISION)"
    )
    done = subprocess.run(
        [sys.executable, "-c", load, str(tmp_path / library)], capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() == str(compiled.REVISION), done.stderr


def test_source_and_caller_have_one_revision() -> None:
    source = (ROOT / "candaemon/compiled/_kernels.pyx").read_text(encoding="utf-8")
    assert re.findall(r"^REVISION = (\d+)$", source, re.MULTILINE) == [str(compiled.REVISION)]
