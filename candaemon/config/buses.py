"""Buses: where frames come from and go to."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from candaemon.config.base import Settings
from candaemon.config.names import Channel, FilePath, Line, LogChannel, Name, interface_problem, is_log_channel

Option = Line | Annotated[int, Field(ge=-(2**63), lt=2**63)] | Annotated[float, Field(ge=-1e18, le=1e18)] | bool
"""Value of an argument that python-can takes."""

_GIVEN = {"channel", "interface", "ignore_config", "receive_own_messages"}
"""Arguments that candaemon gives python-can itself."""
_OF_MULTICAST = {"port": (1, 65_535), "hop_limit": (0, 255)}
"""Options of `udp_multicast` with their least and greatest values."""


class BusSettings(Settings):
    """One CAN bus: an interface of SocketCAN, or what python-can opens."""

    interface: Name = Field("socketcan", description="python-can interface: socketcan, virtual, udp_multicast, pcan, …")
    channel: Channel = Field(description="the interface's channel: can0, vcan0, a multicast group, …")
    log_channel: LogChannel | None = Field(
        None, description="this bus's channel name in recorded logs; default: channel"
    )
    dbc: tuple[FilePath, ...] = Field(
        (),
        description="DBC files of what else is on this bus, relative to this YAML; their frames are counted as known",
    )
    fd: bool = Field(False, description="open for CAN FD")
    bitrate: int = Field(
        500_000,
        ge=1,
        le=20_000_000,
        description="nominal bit rate in bit/s; sets the load that `check` prints, and how soon a scan can be complete",
    )
    data_bitrate: int = Field(2_000_000, ge=1, le=20_000_000, description="CAN FD data phase bit rate in bit/s")
    options: dict[Name, Option] = Field(
        default_factory=dict,
        description="further keyword arguments of the python-can interface: port and hop_limit for udp_multicast, none "
        "for socketcan",
    )
    time_stamps: Literal["hardware", "kernel"] = Field(
        "hardware",
        description="socketcan: the controller's own receive times, brought to the system's clock, where it gives any,"
        " else the kernel's; kernel: the kernel's always",
    )
    receive_buffer: float = Field(
        1.0,
        gt=0,
        le=60,
        description="s of a full bus that the kernel keeps while the daemon is busy, as far as net.core.rmem_max "
        "allows; less than as many s of the configured traffic is warned of",
    )
    send_queue: int = Field(1000, ge=1, le=100_000, description="frames that wait to be sent at most")
    send_timeout: float = Field(
        0.1, gt=0, le=10, description="s after which a frame that the bus does not take is given up"
    )
    reopen_first: float = Field(
        0.1, ge=0.01, le=60, description="s from a bus going away to the first attempt to open it again; doubles then"
    )
    reopen_longest: float = Field(1.0, ge=0.01, le=3600, description="s between two such attempts at most")

    @property
    def names_in_logs(self) -> tuple[str, ...]:
        """Channel names under which a log may hold this bus."""
        return (self.channel,) if self.log_channel is None else (self.channel, self.log_channel)

    @model_validator(mode="after")
    def _channel_is_an_interface(self) -> BusSettings:
        problem = interface_problem(self.channel) if self.interface == "socketcan" else ""
        if problem:
            raise ValueError(f"channel: found '{self.channel}', but {problem}")
        return self

    @model_validator(mode="after")
    def _has_a_name_in_logs(self) -> BusSettings:
        if self.log_channel is None and not is_log_channel(self.channel):
            raise ValueError(
                f"channel: found '{self.channel}', which has a blank or '#', where a log's channel ends; "
                "give the bus a log_channel without"
            )
        return self

    @model_validator(mode="after")
    def _options_reach_someone(self) -> BusSettings:
        if self.interface == "socketcan" and self.options:
            found = ", ".join(sorted(self.options))
            raise ValueError(
                f"options: found {found}, expected none: socketcan takes the interface as `ip link` set it"
            )
        given = sorted(self.options.keys() & _GIVEN)
        if given:
            raise ValueError(f"options: found {given[0]}, which candaemon sets itself; remove it here")
        if self.interface == "udp_multicast":
            for name, value in self.options.items():
                _check_multicast(name, value)
        return self

    @model_validator(mode="after")
    def _attempts_slow_down(self) -> BusSettings:
        if self.reopen_longest < self.reopen_first:
            raise ValueError(
                f"reopen_longest: found {self.reopen_longest:g} s, expected at least reopen_first: "
                f"{self.reopen_first:g} s"
            )
        return self


def _check_multicast(name: str, value: object) -> None:
    """Raise a ValueError for an option that `udp_multicast` does not take."""
    if name not in _OF_MULTICAST:
        raise ValueError(f"options: found {name}, expected one of {', '.join(_OF_MULTICAST)}")
    least, greatest = _OF_MULTICAST[name]
    if not (type(value) is int and least <= value <= greatest):
        raise ValueError(f"options.{name}: found {value!r}, expected a whole number from {least} to {greatest}")
