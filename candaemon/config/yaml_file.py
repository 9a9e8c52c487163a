"""A YAML file's text, read within limits; apart from what parses it, which a file that was checked before spares."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from candaemon.errors import ConfigError
from candaemon.files.bounded import FileReader, read_anything

LARGEST_FILE: Final = 262_144
"""Longest YAML file, bytes."""


def read_yaml_file(path: Path, read: FileReader = read_anything) -> str:
    """Return a file's text.

    Args:
        path: the file, UTF-8.
        read: reads it.

    Raises:
        ConfigError: it does not exist, cannot be read, or is not UTF-8.
    """
    try:
        return read(path, LARGEST_FILE).decode("utf-8")
    except FileNotFoundError:
        raise ConfigError("no such configuration file; check the path", file=path) from None
    except IsADirectoryError:
        raise ConfigError("this is a folder; expected a YAML file", file=path) from None
    except UnicodeDecodeError as error:
        before = error.object[: error.start].count(b"\n")
        raise ConfigError("the text is not UTF-8; save it as UTF-8", file=path, line=before + 1) from None
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=path) from None
