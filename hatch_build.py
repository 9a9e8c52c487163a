"""Compiles the kernels where a compiler and Cython are found; without them the wheel is pure Python.

The kernels only save time: `candaemon.compiled` finds out whether they are there. An editable install gets
them beside their source.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SOURCE = Path("candaemon/compiled/_kernels.pyx")
CYTHON = "cython>=3.1"
FLAGS = ("-O3", "-fPIC", "-shared", "-g0", "-ffp-contract=off", "-fno-math-errno", "-Wl,--build-id=none", "-Wl,-s")
"""No fused multiply-add and no reordering: the kernels give the bits that numpy gives. No debugging information and no
identity of a build: the bytes depend on source and compiler alone."""


class NotCompiled(Exception):  # noqa: N818 - it is no error: numpy computes instead
    """Why there are no compiled kernels."""


class KernelsHook(BuildHookInterface):  # type: ignore[type-arg, misc, unused-ignore]
    """Adds the compiled kernels to a wheel, or to the checkout of an editable install."""

    def dependencies(self) -> list[str]:
        """Return what building needs: Cython, where it is of use."""
        return [CYTHON] if compiler() else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, or say why not."""
        root = Path(self.root)
        self._scratch = TemporaryDirectory(prefix="candaemon-kernels-")
        try:
            built = compile_kernels(root, Path(self._scratch.name))
        except NotCompiled as reason:
            self.app.display_warning(f"no compiled kernels: {reason}; numpy computes what they would, in more time")
            return
        place = SOURCE.with_name(built.name)
        if version == "editable":
            put(built, root / place)
            return
        build_data["pure_python"] = False
        build_data["infer_tag"] = True
        build_data["force_include"][str(built)] = str(place)

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Clean up."""
        del version, build_data, artifact_path
        self._scratch.cleanup()


def put(built: Path, place: Path) -> None:
    """Put a module in the place of another, whose file stays as it is for those that have it open."""
    beside = place.with_name(f"{place.name}.{os.getpid()}")
    shutil.copyfile(built, beside)
    beside.replace(place)


def compiler() -> str | None:
    """Return the C compiler that there is."""
    return next(filter(None, map(shutil.which, (os.environ.get("CC", "cc"), "gcc", "clang"))), None)


def compile_kernels(root: Path, folder: Path) -> Path:
    """Compile the kernels of a checkout into a folder; return the extension module.

    Raises:
        NotCompiled: there is no compiler, no Cython or no Python.h, or the compiler fails.
    """
    found = compiler()
    if found is None:
        raise NotCompiled("no C compiler is found")
    try:
        from Cython.Compiler.Main import CompilationOptions, compile_single  # noqa: PLC0415 - may be missing
    except ImportError:
        raise NotCompiled("Cython is not installed") from None
    include = sysconfig.get_path("include")
    if not (Path(include) / "Python.h").is_file():
        raise NotCompiled(f"there is no Python.h in {include}; Debian has it in python3-dev")
    shutil.copyfile(root / SOURCE, folder / SOURCE.name)
    module = ".".join(SOURCE.with_suffix("").parts)
    name = f"{SOURCE.stem}{sysconfig.get_config_var('EXT_SUFFIX')}"
    before = Path.cwd()
    os.chdir(folder)  # so that neither Cython nor the compiler writes the folder's name
    try:
        translated = compile_single(SOURCE.name, CompilationOptions(language_level=3), module)
        if translated.num_errors:
            raise NotCompiled("Cython refuses the source")
        command = [found, *FLAGS, f"-I{include}", f"{SOURCE.stem}.c", "-o", name, "-lm"]
        compiled = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - the compiler that the user has
    finally:
        os.chdir(before)
    if compiled.returncode:
        raise NotCompiled(f"{Path(found).name} fails: {compiled.stderr.strip().splitlines()[-1:]}")
    return folder / name


if __name__ == "__main__":  # compiles into the checkout, as an editable install does
    here = Path(__file__).resolve().parent
    with TemporaryDirectory() as scratch:
        module_file = compile_kernels(here, Path(scratch))
        target = (here / SOURCE).with_name(module_file.name)
        put(module_file, target)
        print(target, file=sys.stderr)
