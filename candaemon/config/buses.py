"""Buses: where frames come from and go to."""

from __future__ import annotations

from pydantic import Field

from candaemon.config.base import Settings


class BusSettings(Settings):
    """One CAN bus, opened through python-can."""

    interface: str = Field("socketcan", description="python-can interface: socketcan, virtual, udp_multicast, pcan, …")
    channel: str = Field(description="the interface's channel: can0, vcan0, a multicast group, …")
    log_channel: str | None = Field(None, description="this bus's channel name in recorded logs; default: channel")
    dbc: tuple[str, ...] = Field(
        (),
        description="DBC files of what else is on this bus, relative to this YAML; their frames are counted as known",
    )
    fd: bool = Field(False, description="open for CAN FD")
    bitrate: int = Field(500_000, gt=0, description="nominal bit rate in bit/s; sets the load that `check` prints")
    data_bitrate: int = Field(2_000_000, gt=0, description="CAN FD data phase bit rate in bit/s")
    options: dict[str, str | int | float | bool] = Field(
        default_factory=dict, description="further keyword arguments of the python-can interface"
    )

    @property
    def names_in_logs(self) -> tuple[str, ...]:
        """Channel names under which a log may hold this bus."""
        return (self.channel,) if self.log_channel is None else (self.channel, self.log_channel)
