"""Membership of a socket in a multicast group, and the interface that it goes by.

The kernel picks the interface by its routes at the moment of joining, and keeps to it. Where that interface is deleted,
the membership goes along, silently, and does not come back with another one of the same name.
"""

from __future__ import annotations

import errno
import socket
import struct
from pathlib import Path
from typing import Any, Final

_INDEX = struct.Struct("@I")
_IP_MULTICAST_ALL, _IPV6_MULTICAST_ALL = 49, 29  # Linux; the socket module does not name them
_MEMBERS: Final = {socket.AF_INET: Path("/proc/self/net/igmp"), socket.AF_INET6: Path("/proc/self/net/igmp6")}


class GroupMembership:
    """A socket's membership in a group; made, it has joined.

    Args:
        hearing: the socket.
        address: of the group, as `getaddrinfo` gives it.

    Raises:
        OSError: no interface leads to the group.
    """

    def __init__(self, hearing: socket.socket, address: Any) -> None:
        self._hearing, self._address = hearing, address
        before = self._members()
        if hearing.family == socket.AF_INET:
            hearing.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, self._request())
        else:
            hearing.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, self._request())
        more = (index for index, members in self._members().items() if members > before.get(index, 0))
        self._interface = next(more, None)

    def check(self) -> None:
        """Look whether there is still the interface that it goes by; where that is not known, nothing is told.

        Raises:
            OSError: there is not: nothing will be heard any more.
        """
        if self._interface is None:
            return
        try:
            socket.if_indextoname(self._interface)
        except OSError as error:
            told = "the interface that the group came by was deleted"
            raise OSError(errno.ENODEV, told) from error

    def leave(self) -> None:
        """Let the socket hear nothing more, even where others of this machine are members of the group.

        Raises:
            OSError: the network is gone.
        """
        hearing = self._hearing
        if hearing.family == socket.AF_INET:
            hearing.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
            hearing.setsockopt(socket.IPPROTO_IP, socket.IP_DROP_MEMBERSHIP, self._request())
        else:
            hearing.setsockopt(socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)
            hearing.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_LEAVE_GROUP, self._request())

    def _request(self) -> bytes:
        """Return the group as a socket joins and leaves it."""
        any_interface = socket.INADDR_ANY if self._hearing.family == socket.AF_INET else self._address[3]
        return self._packed() + _INDEX.pack(any_interface)

    def _packed(self) -> bytes:
        return socket.inet_pton(self._hearing.family, self._address[0].partition("%")[0])

    def _members(self) -> dict[int, int]:
        """Return how many members the group has by each interface, by the interface's index; none where nobody says."""
        try:
            lines = _MEMBERS[socket.AddressFamily(self._hearing.family)].read_text(encoding="ascii").splitlines()
        except OSError:
            return {}
        if self._hearing.family == socket.AF_INET6:
            wanted = self._packed().hex()
            rows = (line.split() for line in lines)
            return {int(row[0]): int(row[3]) for row in rows if row[2] == wanted}
        wanted, found, index = f"{_INDEX.unpack(self._packed())[0]:08X}", {}, 0
        for line in lines[1:]:  # an interface, and behind it its groups, indented
            row = line.split()
            if not line.startswith("\t"):
                index = int(row[0])
            elif row[0] == wanted:
                found[index] = int(row[1])
        return found
