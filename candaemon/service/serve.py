"""The service as a command: what systemd starts."""

from __future__ import annotations

import can

from candaemon.binding.bound import Binding
from candaemon.service.daemon import Daemon
from candaemon.service.signals import stopping_on_signals
from candaemon.service.status import StatusLine


def serve(binding: Binding, *, status_interval_s: float) -> None:
    """Serve until SIGTERM or SIGINT.

    Args:
        binding: the configuration, bound to its DBC files.
        status_interval_s: between two status lines; 0: none.

    Raises:
        ConfigError: a bus has an interface that python-can does not know.
    """
    for bus in binding.buses:
        if bus.settings.interface not in can.VALID_INTERFACES:
            raise binding.loaded.error(
                ("buses", bus.name, "interface"),
                f"found '{bus.settings.interface}', expected an interface of python-can: "
                f"{', '.join(sorted(can.VALID_INTERFACES))}",
            )
    daemon = Daemon(binding)
    with stopping_on_signals(daemon.stop), daemon:
        daemon.run(StatusLine(status_interval_s))
