"""A configuration as the service takes it."""

from __future__ import annotations

from pathlib import Path

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding, BoundBus
from candaemon.can_io.open_port import is_known, known_interfaces
from candaemon.config.load import load_config
from candaemon.errors import ConfigError
from candaemon.files.bounded import FileReader, read_bounded


def load_service_config(path: Path, read: FileReader = read_bounded) -> Binding:
    """Load a configuration that can be served.

    Args:
        path: the YAML file; a service reads it again at a reload, and so from no pipe.
        read: reads it and its DBC files.

    Raises:
        ConfigError: it cannot be used, or a bus has an interface that python-can does not know.
    """
    binding = bind(load_config(path, read))
    for bus in binding.buses:
        if not is_known(bus.settings.interface):
            raise unknown_interface(binding, bus)
    return binding


def unknown_interface(binding: Binding, bus: BoundBus) -> ConfigError:
    """Return the error of a bus whose interface python-can does not know."""
    return binding.loaded.error(
        ("buses", bus.name, "interface"),
        f"found '{bus.settings.interface}', expected an interface of python-can: {', '.join(known_interfaces())}",
    )
