"""Buses: where frames come from and go to."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from candaemon.config.base import Settings


class BusSettings(Settings):
    """One CAN bus: an interface of SocketCAN, or what python-can opens."""

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
        default_factory=dict, description="further keyword arguments of the python-can interface; none for socketcan"
    )
    time_stamps: Literal["hardware", "kernel"] = Field(
        "hardware",
        description="socketcan: the controller's own receive times, brought to the system's clock, where it gives any,"
        " else the kernel's; kernel: the kernel's always",
    )
    receive_buffer: float = Field(
        1.0, gt=0, le=60, description="s of the configured traffic that the kernel keeps while the daemon is busy"
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
    def _name_is_no_ticks(self) -> BusSettings:
        if "tick" in self.names_in_logs:
            raise ValueError("'tick' is what recordings call their ticks; give the bus another log_channel")
        return self

    @model_validator(mode="after")
    def _options_reach_someone(self) -> BusSettings:
        if self.interface == "socketcan" and self.options:
            found = ", ".join(sorted(self.options))
            raise ValueError(
                f"options: found {found}, expected none: socketcan takes the interface as `ip link` set it"
            )
        return self

    @model_validator(mode="after")
    def _attempts_slow_down(self) -> BusSettings:
        if self.reopen_longest < self.reopen_first:
            raise ValueError(
                f"reopen_longest: found {self.reopen_longest:g} s, expected at least reopen_first: "
                f"{self.reopen_first:g} s"
            )
        return self
