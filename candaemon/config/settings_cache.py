"""Configurations that were checked before, kept in the user's cache folder.

To check a configuration takes a quarter of the time that a command needs before it begins, most of it to build
pydantic's validators. What comes of it depends on the text, on the versions of its readers and on the modules that say
what a configuration may hold, which together name the entry. Only what passed is kept: of what is wrong, the messages
are made anew.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import pydantic

from candaemon._version import __version__
from candaemon.config.base import Location, Settings
from candaemon.config.settings import Config
from candaemon.files import entry_cache
from candaemon.files.entry_cache import EntryCache

LONGEST_ENTRY: Final = 4 << 20
"""Bytes of an entry, at most; of a configuration that makes more, none is kept."""

MOST_ENTRIES: Final = 64
"""Entries of the folder, at most; those that were written first go first."""

_FORM: Final = "1"
"""Of an entry; another one's entries are not read."""
_KIND: Final = ""
"""Key of a section's class, which no field has."""


class CheckedConfigs:
    """The configurations that were checked before.

    Args:
        folder: of the cache.
        text: of a YAML file.
    """

    def __init__(self, folder: Path, text: str) -> None:
        self._cache = EntryCache(folder, LONGEST_ENTRY, MOST_ENTRIES)
        self._name = entry_name(text)

    def find(self) -> tuple[Config, dict[Location, int]] | None:
        """Return the settings and the line of each key and item, as reading the text gives them; None if unknown."""
        known = self._cache.find(self._name)
        if known is None:
            return None
        return from_plain(known["config"]), {tuple(location): line for *location, line in known["lines"]}

    def keep(self, config: Config, lines: Mapping[Location, int]) -> None:
        """Keep what the text was read as, for the next start."""
        plain = {"config": to_plain(config), "lines": [[*location, line] for location, line in lines.items()]}
        self._cache.keep(self._name, plain)


def entry_name(text: str) -> str:
    """Return the name of the entry of a YAML file's text, as these versions read it."""
    return entry_cache.entry_name(text.encode(), _FORM, __version__, pydantic.VERSION, version("pyyaml"), _sources())


def to_plain(value: Any) -> Any:
    """Return settings as lists, mappings, numbers and text: of each section what was given, not its defaults.

    A section becomes a mapping that names its class, a mapping a list of pairs in a mapping, a tuple a list.
    """
    if isinstance(value, Settings):
        given = value.model_fields_set
        return {_KIND: type(value).__name__} | {
            name: to_plain(each) for name, each in value.__dict__.items() if name in given
        }
    if isinstance(value, dict):
        return {_KIND: None, "pairs": [[key, to_plain(each)] for key, each in value.items()]}
    return [to_plain(each) for each in value] if isinstance(value, tuple) else value


def from_plain(plain: Any) -> Any:
    """Return the settings of what `to_plain` gave."""
    if isinstance(plain, list):
        return tuple(from_plain(each) for each in plain)
    if not isinstance(plain, dict):
        return plain
    kind = plain.pop(_KIND)
    if kind is None:
        return {key: from_plain(each) for key, each in plain["pairs"]}
    return _sections()[kind].model_construct(set(plain), **{name: from_plain(each) for name, each in plain.items()})


@cache
def _sections() -> dict[str, type[Settings]]:
    """Return the classes of a configuration's sections by their names."""

    def below(kind: type[Settings]) -> Iterator[type[Settings]]:
        for each in kind.__subclasses__():
            yield each
            yield from below(each)

    return {each.__name__: each for each in below(Settings) if each.__module__.startswith(f"{__package__}.")}


@cache
def _sources() -> str:
    """Return a digest of the modules that say what a configuration may hold: a checkout changes without its version."""
    package = Path(__file__).parents[1]
    found = sha256()
    for path in sorted([*(package / "config").glob("*.py"), *(package / "frames").glob("*.py")]):
        found.update(path.read_bytes())
    return found.hexdigest()
