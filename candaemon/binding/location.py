"""Places in the configuration, so that an error names file, line and key."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from candaemon.config.base import Location
from candaemon.config.load import LoadedConfig
from candaemon.errors import ConfigError


@dataclass(frozen=True, slots=True)
class SettingLocation:
    """A place in the configuration.

    Attributes:
        loaded: the configuration, None where settings were made without a file.
        location: path of keys from its root.

    """

    loaded: LoadedConfig | None = None
    location: Location = ()

    def at(self, *steps: str | int) -> SettingLocation:
        """Return the location that these steps lead to from here."""
        return SettingLocation(self.loaded, (*self.location, *steps))

    def beside(self, key: str) -> SettingLocation:
        """Return the location of another key of the same mapping."""
        return SettingLocation(self.loaded, (*self.location[:-1], key))

    def error(self, text: str) -> ConfigError:
        """Make the error for a problem at this place."""
        if self.loaded is None:
            return ConfigError(f"{'.'.join(map(str, self.location))}: {text}" if self.location else text)
        return self.loaded.error(self.location, text)


@contextmanager
def collected(errors: list[ConfigError]) -> Iterator[None]:
    """Keep a configuration error for later, so that the next problem is found too."""
    try:
        yield
    except ConfigError as error:
        errors.append(error)


def raise_all(errors: Sequence[ConfigError]) -> None:
    """Raise one error that lists all, a line each.

    Raises:
        ConfigError: there is at least one.

    """
    if not errors:
        return
    first, *others = errors
    raise ConfigError(first.message, file=first.file, line=first.line, others=[*first.others, *others])
