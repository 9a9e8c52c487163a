"""A scenario's YAML file into checked settings."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from candaemon.config.load import join_problems
from candaemon.config.settings import Location
from candaemon.config.yaml_text import read_yaml
from candaemon.simulation.scenario import Scenario


def load_scenario(path: Path) -> Scenario:
    """Load and check a scenario.

    Args:
        path: the YAML file.

    Raises:
        ConfigError: naming every problem with file, line, key, what was found and what was expected.

    """
    path = Path(path)
    data, lines = read_yaml(path)
    try:
        return Scenario.model_validate(data, strict=True)
    except ValidationError as error:
        problems = []
        for details in error.errors():
            location: Location = tuple(details["loc"])
            depth = len(location)
            while depth and location[:depth] not in lines:
                depth -= 1
            what = (
                details["ctx"]["error"] if details["type"] == "value_error" else _told(details["type"], details["msg"])
            )
            found = f"; found {details['input']!r}" if isinstance(details["input"], str | int | float) else ""
            key = ".".join(str(step) for step in location) or "the file"
            problems.append((lines.get(location[:depth], 1), f"{key}: {what}{found}"))
        raise join_problems(path, sorted(problems)) from None


def _told(kind: str, message: str) -> str:
    """Say what was expected."""
    match kind:
        case "missing":
            return "missing; add it"
        case "extra_forbidden":
            return "a scenario has no such key here; check its spelling, or remove it"
        case _:
            return message.replace("Input should be", "expected")
