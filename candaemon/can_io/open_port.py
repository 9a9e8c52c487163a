"""Opens a bus: which port serves which interface, what to do where it fails, and a thread for what takes its time."""

from __future__ import annotations

import errno
import re
from collections.abc import Callable
from contextlib import suppress
from threading import Lock, Thread
from typing import TypeAlias

from candaemon.can_io.port import Port, PortRequest, port_errors
from candaemon.can_io.socketcan import SocketCanPort
from candaemon.can_io.threaded_port import ThreadedPort
from candaemon.can_io.udp_multicast import UdpMulticastPort
from candaemon.config.buses import BusSettings
from candaemon.errors import BusError

_WRAPPER_ERRORS = (ImportError, NotImplementedError, TypeError, AttributeError, NameError)
"""Where a driver's library is not installed, some of python-can's wrappers miss the names that it would have had."""

_HINTS = {
    "socketcan": (
        "see `ip link show {channel}`; `ip link set {channel} up type can bitrate {bitrate}` brings a real interface"
        " up, `ip link add dev {channel} type vcan` makes a virtual one"
    ),
    "udp_multicast": (
        "expected a multicast group such as 239.74.163.2 as channel, and `pip install 'candaemon[multicast]'`"
    ),
}
_NO_ROUTE = (
    "no interface leads to the group: bring one up, or give it a route, `ip route add {channel} dev …`;"
    " `ip route get {channel}` shows it"
)
_UNREACHABLE = (errno.ENETUNREACH, errno.ENODEV, errno.EADDRNOTAVAIL)
_HINT = "check buses.{name}.channel and buses.{name}.options, and that the interface's driver is installed"

PortMaker: TypeAlias = Callable[[PortRequest], Port]


def open_through_python_can(request: PortRequest) -> Port:
    """Open a bus through python-can, read by a thread: not every interface can be waited for by a descriptor."""
    from candaemon.can_io.python_can import PythonCanPort  # noqa: PLC0415 - python-can, which no other port needs

    return ThreadedPort(PythonCanPort(request), request.name, request.counts)


PORTS: dict[str, PortMaker] = {"socketcan": SocketCanPort, "udp_multicast": UdpMulticastPort}
"""Ports made for one python-can interface, by its name; the others are served through python-can."""


def open_port(request: PortRequest) -> Port:
    """Open a bus.

    Args:
        request: what to open.

    Raises:
        BusError: it cannot be opened; says why and what to do.
    """
    settings = request.settings
    try:
        return PORTS.get(settings.interface, open_through_python_can)(request)
    except port_errors(*_WRAPPER_ERRORS) as error:
        where = f"bus '{request.name}': cannot open {settings.interface} '{settings.channel}'"
        raise BusError(f"{where}: {_reason(error, settings)}; {_hint(request.name, settings, error)}") from error


def is_known(interface: str) -> bool:
    """Return whether a bus may have an interface of this name."""
    return interface in PORTS or interface in known_interfaces()


def known_interfaces() -> list[str]:
    """Return the names of python-can's interfaces, in order."""
    import can  # noqa: PLC0415 - it takes longer than all else at a start, and most buses are served without it

    return sorted(can.VALID_INTERFACES)


def _reason(error: Exception, settings: BusSettings) -> str:
    """Say why a bus cannot be opened."""
    said = str(error) or type(error).__name__
    if settings.interface in PORTS:
        return said
    if isinstance(error, TypeError):
        unknown = re.search(r"unexpected keyword argument ('\w+')", said)
        if unknown is not None:
            return f"it takes no option {unknown[1]}"
        needed = re.search(r"missing \d+ required .*?arguments?: (.+)", said)
        if needed is not None:
            return f"it needs the options {needed[1]}"
    return f"python-can says: {said}"


def _hint(name: str, settings: BusSettings, error: Exception) -> str:
    """Say what to do about a bus that cannot be opened."""
    if not is_known(settings.interface):
        return f"expected one of python-can's interfaces: {', '.join(known_interfaces())}"
    hint = _HINTS.get(settings.interface, _HINT)
    if settings.interface == "udp_multicast" and isinstance(error, OSError) and error.errno in _UNREACHABLE:
        hint = _NO_ROUTE
    return hint.format(name=name, channel=settings.channel, bitrate=settings.bitrate)


class BackgroundOpening:
    """Opens a bus in a thread of its own: a driver may take seconds to say that there is nothing.

    Args:
        request: what to open.
    """

    def __init__(self, request: PortRequest) -> None:
        self._request = request
        self._lock = Lock()
        self._unwanted = False
        self._port: Port | None = None
        self._error: BusError | None = None
        self._thread = Thread(target=self._open, name=f"opening {request.name}", daemon=True)
        self._thread.start()

    def is_over(self) -> bool:
        """Return whether the bus is open, or could not be opened."""
        return not self._thread.is_alive()

    def port(self) -> Port:
        """Return the open bus once it is over.

        Raises:
            BusError: it cannot be opened; says why and what to do.
        """
        if self._port is None:
            raise self._error or BusError(f"bus '{self._request.name}': opening it has failed")
        return self._port

    def abandon(self) -> None:
        """Close the bus as soon as it is open."""
        with self._lock:
            self._unwanted = True
            _close(self._port)

    def _open(self) -> None:
        """Open the bus; close it at once where nobody waits for it."""
        try:
            port = open_port(self._request)
        except BusError as error:
            self._error = error
            return
        with self._lock:
            self._port = port
            if self._unwanted:
                _close(port)


def _close(port: Port | None) -> None:
    """Close a bus if there is one; what fails then is of no use to anyone."""
    if port is not None:
        with suppress(*port_errors()):
            port.close()
