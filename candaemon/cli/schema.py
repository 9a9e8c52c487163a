"""`candaemon schema`: the JSON Schema of the configuration."""

from __future__ import annotations

import argparse
import json

from candaemon.cli.standard_streams import use_utf8
from candaemon.config.load import json_schema


def add_arguments(_parser: argparse.ArgumentParser) -> None:
    """Add nothing: the command has no arguments."""


def execute(_arguments: argparse.Namespace) -> None:
    """Print the schema."""
    use_utf8()
    print(json.dumps(json_schema(), indent=2, ensure_ascii=False))
