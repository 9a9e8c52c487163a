"""Output: assignment of obstacles to slots, and of slots to frames."""

from __future__ import annotations

from typing import Literal, get_args

from pydantic import Field, field_validator

from candaemon.config.base import ListedObjectSignals, Settings, Units
from candaemon.config.names import DbcName, FilePath, Name
from candaemon.config.numbers import SignalValue
from candaemon.config.protection import ProtectionSettings
from candaemon.config.sensors import Mount, ObjectFormat
from candaemon.similar_names import meant

Quantity = Literal[
    "id", "state", "x", "y", "vx", "vy", "ax", "ay", "range", "azimuth", "range_rate", "rel_vx", "rel_vy",
    "rel_ax", "sx", "sy", "svx", "svy", "existence", "age", "sensors", "counter", "latitude", "longitude", "heading",
    "yaw_rate", "length", "width", "center_x", "center_y", "center_dx", "center_dy", "class", "class_likelihood",
    "lead", "time_to_collision",
]  # fmt: skip
StatusQuantity = Literal["cycle", "occupied", "unreported", "ego", "health", "drops", "count", "counter"]


class StatusFormat(Settings):
    """The message sent once a cycle, before the slots."""

    message: DbcName = Field(description="message name")
    signals: dict[DbcName, StatusQuantity] = Field(default_factory=dict, description="signal: quantity")
    fixed: dict[DbcName, SignalValue] = Field(default_factory=dict, description="signal: value")

    @field_validator("signals", mode="before")
    @classmethod
    def _names_signals_first(cls, value: object) -> object:
        known = get_args(StatusQuantity)
        for signal, quantity in value.items() if isinstance(value, dict) else ():
            mistyped = str(quantity).casefold() not in known and meant(str(quantity), known)
            if signal in known and quantity not in known and not mistyped:
                raise ValueError(f"here it is the signal, then the quantity: write {{{quantity}: {signal}}}")
        return value


class OutputSettings(Settings):
    """How obstacles go onto a bus."""

    bus: Name = Field(description="name of the bus")
    dbc: FilePath = Field(description="DBC file, relative to this YAML")
    objects: ObjectFormat
    signals: dict[Quantity, ListedObjectSignals] = Field(description="quantity: the signal, or signals, it goes into")
    units: Units = Field(default_factory=Units.defaults, description="of signals without a unit of their own")
    status: StatusFormat | None = Field(None, description="message sent once a cycle")
    mount: Mount = Field(
        default_factory=Mount.defaults, description="axes the obstacles are written in; default: vehicle axes"
    )
    send: Literal["occupied", "all"] = Field(
        "occupied", description="occupied slots and freed ones once, or every slot each cycle"
    )
    tentative: bool = Field(False, description="send tentative obstacles too")
    cycle_time: float | None = Field(
        None,
        ge=0,
        le=2,
        description="s between two outputs, 0: one after each scan; default: one after each scan of a single sensor, "
        "0.05 where there are several",
    )
    path_half_width: float = Field(
        1.8, gt=0, le=20, description="m, half the width of the path in which obstacles come first"
    )
    protection: ProtectionSettings = Field(default_factory=ProtectionSettings.defaults)
