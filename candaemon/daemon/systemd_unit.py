"""The systemd unit of one configuration, made from the unit that comes with candaemon."""

from __future__ import annotations

import logging
import re
import shutil
import stat
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from candaemon.binding.bound import Binding
from candaemon.config.buses import BusSettings
from candaemon.config.shipped import shared_folder
from candaemon.daemon.service_config import load_service_config
from candaemon.errors import ConfigError, InputError
from candaemon.files.outputs import write_file
from candaemon.printable import is_one_line

logger = logging.getLogger(__name__)

SYSTEMD_UNITS = Path("/etc/systemd/system")
"""Where an administrator's units lie."""

_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{,20}")
"""A part of the name of the service's user, which has 31 characters at most."""
_HIDDEN = {
    "ProtectHome=yes": (Path("/home"), Path("/root"), Path("/run/user")),
    "PrivateTmp=yes": (Path("/tmp"), Path("/var/tmp")),  # noqa: S108  # names what the unit hides, opens nothing
}
"""Folders that the unit hides from the service, by the setting that does."""


def install(config_path: Path, *, show: bool, units: Path = SYSTEMD_UNITS) -> None:
    """Write the unit that runs a configuration as `candaemon@NAME`, NAME being the file's without `.yaml`.

    Args:
        config_path: the YAML file; it must be one that can be served.
        show: write the unit to standard output, and what the service could not read to standard error as a warning.
        units: folder for the unit.

    Raises:
        ConfigError: the configuration cannot be used, or not as a service.
        InputError: the service could not read what it needs, or the unit cannot be written.
    """
    binding = load_service_config(config_path.resolve())
    name = _instance(binding)
    problems = [problem for path in _needed(binding) for problem in _unreadable(path)]
    unit = unit_text(binding, _program())
    if show:
        for problem in problems:
            logger.warning("warning: %s", problem)
        print(unit, end="")
        return
    if problems:
        raise InputError("the service could not read what it needs:", others=[InputError(each) for each in problems])
    path = units / f"candaemon@{name}.service"
    write_file(path, unit)
    print(f"{path} is written; `systemctl daemon-reload && systemctl enable --now candaemon@{name}` starts it")


def unit_text(binding: Binding, program: Iterable[str]) -> str:
    """Return the unit of a configuration: the one that comes with candaemon, with what this one needs in its place.

    Args:
        binding: the configuration.
        program: the command that runs candaemon, with absolute paths.

    Raises:
        ConfigError: a bus is `virtual`, which ends at the process; or a unit cannot hold the path of the configuration
            or of the program.
    """
    executable, *arguments = program
    words = [_executable(executable), *map(_argument, [*arguments, "run", str(binding.loaded.path)])]
    command = " ".join(words)
    text = (shared_folder() / "config" / "systemd" / "candaemon@.service").read_text(encoding="utf-8")
    settings = {"ExecStart": command}
    interfaces = {bus.settings.interface for bus in binding.buses}
    families = ["AF_UNIX", "AF_INET"] + ["AF_CAN"] * ("socketcan" in interfaces)
    families += ["AF_INET6"] * any(_needs_ipv6(bus.settings) for bus in binding.buses)
    settings["RestrictAddressFamilies"] = " ".join(sorted(families))
    if "udp_multicast" in interfaces:
        settings["IPAddressAllow"] = "localhost multicast"
    settings |= _devices(binding)
    for name, value in settings.items():
        text = _with(text, name, value)
    return text


def _with(unit: str, name: str, value: str) -> str:
    """Return a unit with another value for a setting that it has once."""
    lines = unit.split("\n")
    (place,) = (k for k, line in enumerate(lines) if line.startswith(f"{name}="))
    lines[place] = f"{name}={value}"
    return "\n".join(lines)


def _needs_ipv6(bus: BusSettings) -> bool:
    """Return whether a bus is a multicast group of IPv6, or one by a name that may be."""
    return bus.interface == "udp_multicast" and not re.fullmatch(r"[\d.]+", bus.channel)


def _devices(binding: Binding) -> dict[str, str]:
    """Return the settings that let the drivers of other interfaces reach their devices."""
    needed = {}
    for bus in binding.buses:
        match bus.settings.interface:
            case "socketcan" | "udp_multicast":
                continue
            case "virtual":
                raise binding.loaded.error(
                    ("buses", bus.name, "interface"),
                    "found 'virtual', which no other process can reach; expected an interface that a service can use, "
                    "such as socketcan",
                )
            case _ as interface:
                logger.warning("warning: bus '%s': the unit lets '%s' reach every device", bus.name, interface)
                needed = {"PrivateDevices": "no", "DevicePolicy": "auto"}
    return needed


def _instance(binding: Binding) -> str:
    """Return the unit's instance name.

    Raises:
        ConfigError: the file's name cannot be one.
    """
    path = binding.loaded.path
    if _NAME.fullmatch(path.stem) is None:
        raise ConfigError(
            f"'{path.stem}' cannot be the name of a service; rename the file, with letters, digits, '_' and '-', "
            "21 at most",
            file=path,
        )
    return path.stem


def _program() -> list[str]:
    """Return the command that runs this candaemon."""
    script = Path(sys.executable).with_name("candaemon")
    return [str(script)] if shutil.which(script) else [sys.executable, "-m", "candaemon"]


def _needed(binding: Binding) -> list[Path]:
    """List what the service reads: the configuration, its DBC files, the program, Python and candaemon itself."""
    python = Path(sys.executable)
    program = [Path(_program()[0]), python, python.resolve(), Path(__file__)]
    return list(dict.fromkeys([binding.loaded.path, *map(Path, binding.databases), *program]))


def _unreadable(path: Path) -> Iterator[str]:
    """Yield why the service, with a user of its own and its own view of the files, could not read a path."""
    path = path.absolute()
    for setting, folders in _HIDDEN.items():
        hidden = next((folder for folder in folders if folder in path.parents), None)
        if hidden is not None:
            better = "/etc/candaemon" if path.suffix in {".yaml", ".dbc"} else "/opt/candaemon"
            yield f"{path} lies below {hidden}, which the unit hides ({setting}); put it elsewhere, such as {better}"
    for each in (path, *path.parents):
        needed, letter = (stat.S_IROTH, "r") if each == path else (stat.S_IXOTH, "x")
        if not each.stat().st_mode & needed:
            yield f"{path} cannot be read by all users; `chmod o+{letter} {each}` makes it so"


def _executable(path: str) -> str:
    """Return the path of a program as a unit file takes it; its `$` stand for themselves.

    Raises:
        ConfigError: a unit cannot hold it.
    """
    if not set(path).isdisjoint("\"'\\"):
        raise ConfigError(
            f"'{path}' holds a quote or a backslash, which systemd takes of no program; install candaemon elsewhere, "
            "such as in /opt/candaemon"
        )
    return _quoted(path.replace("%", "%%"))


def _argument(word: str) -> str:
    """Return an argument of a command as a unit file takes it.

    Raises:
        ConfigError: a unit cannot hold it.
    """
    return _quoted(word.replace("%", "%%").replace("$", "$$"))


def _quoted(word: str) -> str:
    if not is_one_line(word):
        raise ConfigError(
            f"'{word}' holds a control character, a line separator or bytes that are not UTF-8, which a unit cannot "
            "hold; rename the file or its folder"
        )
    if re.fullmatch(r"[\w@%+=:,./$-]+", word):
        return word
    return '"' + word.replace("\\", "\\\\").replace('"', '\\"') + '"'
