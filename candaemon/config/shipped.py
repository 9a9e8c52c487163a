"""Finds the configurations, scenarios and DBC files that come with candaemon: in a checkout, in an installed wheel."""

from __future__ import annotations

from pathlib import Path

from candaemon.errors import ConfigError


def shared_folder() -> Path:
    """Return the folder that holds `config/` and `dbc/`.

    Raises:
        ConfigError: it is neither in the package nor beside it.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "share", package.parent):
        if (folder / "config" / "demo.yaml").is_file() and (folder / "dbc").is_dir():
            return folder
    raise ConfigError(
        f"found neither 'share/config' in nor 'config' beside the package; expected them at {package}; "
        "install candaemon again"
    )


def find_config(given: Path) -> Path:
    """Return a configuration's path: the file given, or else the one that comes with candaemon under that name.

    Args:
        given: a path, or the name of a shipped configuration with or without `.yaml`.

    Raises:
        ConfigError: there is neither; lists those that come with candaemon.
    """
    return _find("configuration", given, shared_folder() / "config")


def find_scenario(given: Path) -> Path:
    """Return a scenario's path: the file given, or else the one that comes with candaemon under that name.

    Raises:
        ConfigError: there is neither; lists those that come with candaemon.
    """
    return _find("scenario", given, shared_folder() / "config" / "scenarios")


def _find(kind: str, given: Path, folder: Path) -> Path:
    """Return the file given, or the one of that name in a folder."""
    if given.exists():
        return given
    shipped = folder / f"{given.name.removesuffix('.yaml')}.yaml"
    if len(given.parts) == 1 and shipped.is_file():
        return shipped
    names = ", ".join(sorted(path.stem for path in folder.glob("*.yaml")))
    raise ConfigError(f"there is no such {kind}; give the path of one, or the name of one of ours: {names}", file=given)
