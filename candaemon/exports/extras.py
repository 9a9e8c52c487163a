"""Libraries that not everyone needs, imported when they are first used."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from candaemon.errors import ConfigError


def import_extra(module: str, extra: str, what: str) -> ModuleType:
    """Import a module of an optional library.

    Args:
        module: its name, such as `pyarrow.parquet`.
        extra: of candaemon, which installs it.
        what: needs it, for the message.

    Raises:
        ConfigError: it is not installed; says what to install.
    """
    try:
        return import_module(module)
    except ImportError:
        library = module.partition(".")[0]
        raise ConfigError(f"{what} needs {library}; install it: pip install 'candaemon[{extra}]'") from None
