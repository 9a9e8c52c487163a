"""Finds the configurations, scenarios and DBC files shipped with candaemon, in a checkout or an installed wheel."""

from __future__ import annotations

from pathlib import Path

from candaemon.errors import ConfigError


def shared_folder() -> Path:
    """Return the folder that holds `config/` and `dbc/`.

    Raises:
        ConfigError: it exists neither in the package nor beside it.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "share", package.parent):
        if (folder / "config" / "demo.yaml").is_file() and (folder / "dbc").is_dir():
            return folder
    raise ConfigError(
        f"found neither 'share/config' in nor 'config' beside the package; expected them at {package}; "
        "install candaemon again"
    )


def find_config(path: Path) -> Path:
    """Return a configuration's path: the given file, or else the shipped one of that name.

    Args:
        path: a path, or the name of a shipped configuration with or without `.yaml`.

    Raises:
        ConfigError: neither exists; the message lists the shipped ones.
    """
    return _find("configuration", path, shared_folder() / "config")


def find_scenario(path: Path) -> Path:
    """Return a scenario's path: the given file, or else the shipped one of that name.

    Raises:
        ConfigError: neither exists; the message lists the shipped ones.
    """
    return _find("scenario", path, shared_folder() / "config" / "scenarios")


def _find(kind: str, path: Path, folder: Path) -> Path:
    """Return the given file, or the one of that name in a folder."""
    if path.exists():
        return path
    shipped = folder / f"{path.name.removesuffix('.yaml')}.yaml"
    if len(path.parts) == 1 and shipped.is_file():
        return shipped
    names = ", ".join(sorted(each.stem for each in folder.glob("*.yaml")))
    raise ConfigError(f"there is no such {kind}; give the path of one, or the name of one of ours: {names}", file=path)
