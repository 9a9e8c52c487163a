"""What a bed is asked to do, and the files by which it answers."""

from __future__ import annotations

import json
import os
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .inside import REPORTS

Report = dict[str, Any]  # as pytest serialises it

SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


class BedMissingError(Exception):
    """The machine cannot make the bed; the text says why and what to install."""


@dataclass(frozen=True)
class Task:
    """Some tests to run. The bed must have its folder, the project and this Python at the same paths as here.

    Attributes:
        tests: node ids.
        project: the folder that they start from.
        folder: where the files below are.
        patience_s: longest time without any progress, after which the bed is ended.
    """

    tests: list[str]
    project: Path
    folder: Path
    patience_s: float

    @property
    def command(self) -> Path:
        """A shell script that runs the tests."""
        return self.folder / "command"

    @property
    def reports(self) -> Path:
        """The tests' reports, a line each."""
        return self.folder / "reports.jsonl"

    @property
    def output(self) -> Path:
        """What pytest says."""
        return self.folder / "output.log"

    @property
    def console(self) -> Path:
        """What the bed says."""
        return self.folder / "console.log"

    @property
    def scratch(self) -> Path:
        """For the tests' own files: a bed may have a file system of its own there."""
        return self.folder / "tmp"

    def prepare(self) -> None:
        """Write the command, and remove what an interrupted run left."""
        for path in (self.reports, self.output, self.console):
            path.unlink(missing_ok=True)
        self.scratch.mkdir(parents=True, exist_ok=True)
        arguments = self.folder / "tests"
        arguments.write_text("\n".join(self.tests) + "\n", encoding="utf-8")
        environment = {
            "PATH": f"{os.environ.get('PATH', '')}:{SYSTEM_PATH}",
            "HOME": str(self.scratch),
            "TMPDIR": str(self.scratch),
            "LANG": "C.UTF-8",
            "PYTHONDONTWRITEBYTECODE": "1",
            "HYPOTHESIS_STORAGE_DIRECTORY": str(self.scratch / "hypothesis"),
            REPORTS: str(self.reports),
        }
        words = ["env", "-i", *(f"{name}={value}" for name, value in environment.items())]
        words += [sys.executable, "-m", "pytest", "-m", "", f"--basetemp={self.scratch / 'pytest'}", f"@{arguments}"]
        self.command.write_text(
            f"cd {shlex.quote(str(self.project))}\n{shlex.join(words)} >{shlex.quote(str(self.output))} 2>&1\n",
            encoding="utf-8",
        )

    def read_reports(self) -> dict[str, list[Report]]:
        """Return the reports by node id; the last line may be half a one."""
        found: dict[str, list[Report]] = {}
        lines = self.reports.read_text(encoding="utf-8").splitlines(keepends=True) if self.reports.exists() else []
        for line in lines:
            if line.endswith("\n"):
                report = json.loads(line)
                if isinstance(report["longrepr"], list):
                    report["longrepr"] = tuple(report["longrepr"])  # of a skipped test; JSON has no tuples
                found.setdefault(report["nodeid"], []).append(report)
        return found
