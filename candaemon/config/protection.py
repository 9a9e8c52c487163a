"""Protection of frames and values: counter, checksum, rate, plausibility."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from candaemon.config.base import Settings
from candaemon.config.names import DbcName

DataId = Annotated[int, Field(ge=0, le=0xFFFF)]
DataIds = DataId | Annotated[tuple[DataId, ...], Field(min_length=1)]
DataIdByte = Annotated[int, Field(ge=0, le=0xFF)]
DataIdList = Annotated[tuple[DataIdByte, ...], Field(min_length=16, max_length=16)]

DATA_ID = "of the messages in their order (the first of each slot, then the second …): one for all, or a list"
DATA_ID_STEP = "added to data_id from one message to the next"
OFFSET = "bytes before the profile's header"


class _SingleDataId(Settings):
    """What the profiles with one data id a message have."""

    data_id: DataIds = Field(description=DATA_ID)
    step: int = Field(0, ge=0, le=0xFFFF, description=DATA_ID_STEP)
    offset: int = Field(0, ge=0, le=61, description=OFFSET)

    @model_validator(mode="after")
    def _list_needs_no_step(self) -> _SingleDataId:
        if self.step and isinstance(self.data_id, tuple):
            raise ValueError("step goes with a single data_id; give one of step and a list")
        return self

    def data_ids(self, count: int) -> tuple[int, ...]:
        """Return the data ids of `count` messages; fewer if the list is too short."""
        if isinstance(self.data_id, tuple):
            return self.data_id[:count]
        return tuple((self.data_id + self.step * index) & 0xFFFF for index in range(count))


class E2eProfile1(_SingleDataId):
    """AUTOSAR E2E profile 1: CRC-8 in the header's byte 0, counter 0 … 14 in the low nibble of byte 1."""

    profile: Literal[1]
    data_id_mode: Literal["both", "alternating", "low", "nibble"] = Field(
        "both", description="what of the data id the CRC covers; variant 1A: both, 1B: alternating, 1C: nibble"
    )

    @model_validator(mode="after")
    def _fits_a_nibble(self) -> E2eProfile1:
        _check_nibble(self, self.data_id_mode)
        return self


class E2eProfile2(Settings):
    """AUTOSAR E2E profile 2: CRC-8 in byte 0, counter 0 … 15 in the low nibble of byte 1, a data id for each count."""

    profile: Literal[2]
    data_id_list: DataIdList | Annotated[tuple[DataIdList, ...], Field(min_length=1)] = Field(
        description="16 bytes, one for each value of the counter; or such a list for each message in order"
    )
    offset: Literal[0] = Field(0, description="bytes before the profile's header: it has none")

    def data_ids(self, count: int) -> tuple[bytes, ...]:
        """Return the data id lists of `count` messages; fewer if too few are configured."""
        first = self.data_id_list[0]
        if isinstance(first, int):
            return (bytes(each for each in self.data_id_list if isinstance(each, int)),) * count
        return tuple(bytes(each) for each in self.data_id_list[:count] if isinstance(each, tuple))


class E2eProfile5(_SingleDataId):
    """AUTOSAR E2E profile 5: CRC-16 in the header's bytes 0 and 1, low byte first, counter 0 … 255 in byte 2."""

    profile: Literal[5]


class E2eProfile11(_SingleDataId):
    """AUTOSAR E2E profile 11: as profile 1, of the newer protocol's state machine."""

    profile: Literal[11]
    data_id_mode: Literal["both", "nibble"] = Field(
        "both", description="what of the data id the CRC covers; variant 11A: both, 11C: nibble"
    )

    @model_validator(mode="after")
    def _fits_a_nibble(self) -> E2eProfile11:
        _check_nibble(self, self.data_id_mode)
        return self


E2eSettings = Annotated[E2eProfile1 | E2eProfile2 | E2eProfile5 | E2eProfile11, Field(discriminator="profile")]


def _check_nibble(settings: _SingleDataId, mode: str) -> None:
    ids = settings.data_id if isinstance(settings.data_id, tuple) else (settings.data_id,)
    if mode == "nibble" and max(ids) > 0xFFF:
        raise ValueError("data_id_mode nibble sends 4 bits beside the CRC's 8: data_id goes up to 0xFFF")


class ProtectionSettings(Settings):
    """Counter and checksum of a frame."""

    counter: DbcName | None = Field(None, description="counter signal")
    counter_values: int | None = Field(
        None,
        ge=2,
        le=65_536,
        description="values the counter goes through; default: all its bits hold, or the profile's",
    )
    checksum: DbcName | None = Field(None, description="checksum signal: a byte of its own, for honda half a byte")
    kind: Literal["none", "toyota", "honda", "xor", "additive", "crc8_sae_j1850"] = Field(
        "none", description="how the checksum is made"
    )
    e2e: E2eSettings | None = Field(
        None, description="AUTOSAR end-to-end profile, in place of kind; counter and checksum, if named, must lie there"
    )

    @model_validator(mode="after")
    def _one_kind(self) -> ProtectionSettings:
        if self.e2e is not None and self.kind != "none":
            raise ValueError(f"kind {self.kind} and e2e both make the checksum; give one")
        return self


class InputProtectionSettings(ProtectionSettings):
    """What a frame must be to be used. A frame that fails is counted by cause and not used."""

    max_step: int | None = Field(
        None,
        ge=1,
        le=65_535,
        description="greatest step of the counter from one frame of a message to the next, the frames between being "
        "lost; default: 3 with e2e, else the counter is not watched",
    )
    on_jump: Literal["refuse", "use"] = Field(
        "refuse", description="what becomes of a frame whose counter steps farther; used, it counts as frames lost"
    )
    settle: int = Field(
        1, ge=1, le=15, description="frames whose counters follow one another, until they are used again after a jump"
    )
    timeout: float | None = Field(
        None,
        gt=0,
        le=60,
        description="s without a frame of a message, after which its counter may start anywhere; default: none",
    )
    max_rate: float | None = Field(
        None,
        gt=1,
        le=100,
        description="times the nominal rate of a message, what comes faster is not used; default: any",
    )
    cycle_time: float | None = Field(
        None, gt=0, le=10, description="s between two frames of a message; default: the sensor's, or the DBC's"
    )

    @model_validator(mode="after")
    def _steps_need_a_counter(self) -> InputProtectionSettings:
        if self.max_step is not None and self.counter is None and self.e2e is None:
            raise ValueError("max_step watches a counter; give counter, or leave max_step out")
        return self

    @property
    def greatest_step(self) -> int | None:
        """Greatest step of the counter; None where it is not checked."""
        return E2E_STEP if self.max_step is None and self.e2e is not None else self.max_step


E2E_STEP = 3
"""Default greatest step of an E2E profile's counter: two frames in a row may be lost."""


class SensorProtectionSettings(InputProtectionSettings):
    """What a sensor's frames must be to be used, and how many of them may fail."""

    max_failed: float = Field(
        0.5, ge=0, le=1, description="share of a scan's frames that may fail; beyond it the whole scan is discarded"
    )
    trust_time: float = Field(
        1.0, gt=0, le=60, description="s over which the share of used frames is the sensor's trust"
    )
    least_trust: float = Field(0.5, ge=0, le=1, description="below which the sensor counts as lost")


class PlausibilitySettings(Settings):
    """Which objects of a sensor cannot be true. One that cannot is counted by cause and not used."""

    ranges: bool = Field(True, description="refuse values outside the DBC's [min|max], where it gives a range")
    max_speed: float | None = Field(
        200.0,
        gt=0,
        le=2000,
        description="m/s relative to the sensor, from scan to scan, of an object that the sensor says is the same; "
        "null: any",
    )


class MotionPlausibilitySettings(Settings):
    """Which values of ego motion cannot be true. A frame with one is counted by cause and not used."""

    ranges: bool = Field(True, description="refuse values outside the DBC's [min|max], where it gives a range")
    max_acceleration: float | None = Field(
        100.0, gt=0, le=1000, description="m/s², of every speed and velocity; null: any"
    )
    max_yaw_acceleration_deg: float | None = Field(
        1000.0, gt=0, le=100_000, description="deg/s², of the yaw rate; null: any"
    )
