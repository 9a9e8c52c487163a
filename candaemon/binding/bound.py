"""What binding gives: settings with every name resolved, ready for the hot path."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from candaemon.config.buses import BusSettings
from candaemon.config.ego import InsSettings, OdometrySettings
from candaemon.config.load import LoadedConfig
from candaemon.config.output import OutputSettings
from candaemon.config.sensors import SensorSettings
from candaemon.config.settings import Config
from candaemon.dbc.single_codec import Decoder
from candaemon.dbc.types import Database, MessageSpec
from candaemon.objects.conditions import CompiledCondition
from candaemon.objects.reader import Claim, ObjectReader
from candaemon.objects.scan_messages import LookReader, ScanHeader, StatusWriter, TimeStampField
from candaemon.objects.signals import SignalBinding
from candaemon.objects.writer import ObjectWriter
from candaemon.protection.checksums import FrameProtector
from candaemon.protection.monitor import FrameMonitorSettings


@dataclass(frozen=True, slots=True)
class BoundBus:
    """A bus and what is expected on it.

    Attributes:
        index: position in the configuration, which `Frame.bus` holds.
        name: as configured.
        settings: from the configuration.
        can_ids: identifiers that sensors and ego motion read from it.
        rate: frames of those that are expected in a second.
        load: share of its time that the configured input takes, from 0 to 1.
        output_load: share that our own output adds with every slot occupied.
        databases: DBC files that describe what is on it: the sensors', ego motion's and those of the bus itself.

    """

    index: int
    name: str
    settings: BusSettings
    can_ids: frozenset[int]
    rate: float
    load: float
    output_load: float
    databases: tuple[Database, ...]


@dataclass(frozen=True, slots=True)
class BoundSensor:
    """A sensor, its DBC and the readers that its scans need.

    Attributes:
        index: position in the configuration.
        name: as configured.
        settings: from the configuration.
        bus: index of the bus.
        database: the DBC.
        reader: payloads → quantities.
        can_ids: every identifier it reads: the objects', the header's, the trigger's.
        counters: per layout, payload → scan counter; empty unless a counter marks the frames of one scan.
        trigger: the message that closes a scan, None unless one does.
        headers: the messages that open a scan; empty unless some do.
        monitors: per layout, what its frames must be to be used, None where anything will do.
        mark_monitor: the same of the header or the trigger, where it is no message of the objects'.
        look: what says which look a scan is, None where all are alike.
        stamp: what says when a scan was measured, None where its frames' arrival does.
        mark_claims: of headers or a trigger of which a value in the frame says that it is one, by CAN id.

    """

    index: int
    name: str
    settings: SensorSettings
    bus: int
    database: Database
    reader: ObjectReader
    can_ids: frozenset[int]
    counters: tuple[Callable[[bytes], int], ...]
    trigger: MessageSpec | None
    headers: tuple[ScanHeader, ...]
    monitors: tuple[FrameMonitorSettings | None, ...]
    mark_monitor: FrameMonitorSettings | None
    look: LookReader | None = None
    stamp: TimeStampField | None = None
    mark_claims: Mapping[int, Claim] = field(default_factory=dict)

    def claimed_values(self, can_id: int) -> tuple[int, ...]:
        """Return the values of a signal by which frames of an identifier are the sensor's; none where all are."""
        mark = self.mark_claims.get(can_id)
        values = [claim.value for claim in self.reader.claims.get(can_id, ())]
        return tuple(values if mark is None else [*values, mark.value])

    @property
    def protectors(self) -> tuple[FrameProtector | None, ...]:
        """Per layout, the checksum of its frames, None where they carry none."""
        return tuple(None if monitor is None else monitor.protector for monitor in self.monitors)

    @property
    def header(self) -> ScanHeader | None:
        """The first message that opens a scan, None unless one does."""
        return self.headers[0] if self.headers else None

    @property
    def trigger_id(self) -> int | None:
        """CAN id of the trigger message."""
        return None if self.trigger is None else self.trigger.can_id


@dataclass(frozen=True, slots=True)
class EgoMessage:
    """A message that carries ego motion.

    Attributes:
        message: as the DBC describes it.
        decode: payload → the quantities, SI units (angles, latitude and longitude too in radians); None for a payload
            that is too short.
        scaled: the message with its signals in those units, for decoding many payloads at once.
        quantities: name of each value's quantity; one that has several signals (wheel speeds) is there for each.
        bindings: quantities with their signals, for writing them.
        monitor: what a frame must be to be used, None where anything will do.

    """

    message: MessageSpec
    decode: Decoder
    scaled: MessageSpec
    quantities: tuple[str, ...]
    bindings: tuple[SignalBinding, ...]
    monitor: FrameMonitorSettings | None


@dataclass(frozen=True, slots=True)
class BoundEgo:
    """The settings of ego motion, bound to a DBC.

    Attributes:
        settings: from the configuration.
        bus: index of the bus.
        database: the DBC.
        messages: by CAN id.
        reverse: of the quantity of that name, in the DBC's unit, while the vehicle drives backwards; None: it never
            does, or the speed says so.

    """

    settings: InsSettings | OdometrySettings
    bus: int
    database: Database
    messages: Mapping[int, EgoMessage]
    reverse: CompiledCondition | None = None

    def count(self, quantity: str) -> int:
        """Count the signals that give a quantity."""
        return sum(message.quantities.count(quantity) for message in self.messages.values())


@dataclass(frozen=True, slots=True)
class BoundOutput:
    """The output, its DBC and its writers.

    Attributes:
        settings: from the configuration.
        bus: index of the bus.
        database: the DBC.
        writer: obstacles → payloads.
        status: the message once a cycle, None where there is none.
        can_ids: every identifier it sends.
        fd_ids: those of them that are CAN FD frames.

    """

    settings: OutputSettings
    bus: int
    database: Database
    writer: ObjectWriter
    status: StatusWriter | None
    can_ids: frozenset[int]
    fd_ids: frozenset[int]


@dataclass(frozen=True, slots=True)
class Binding:
    """A whole configuration, bound to its DBC files.

    Attributes:
        loaded: the configuration and where it was written.
        buses: in the configuration's order; `Frame.bus` is an index into it.
        sensors: in the configuration's order.
        ego: ego motion, None where the vehicle never moves.
        output: None where obstacles do not go onto a bus.
        databases: every DBC used, by path.
        warnings: what looks wrong but can be used.

    """

    loaded: LoadedConfig
    buses: tuple[BoundBus, ...]
    sensors: tuple[BoundSensor, ...]
    ego: BoundEgo | None
    output: BoundOutput | None
    databases: Mapping[str, Database]
    warnings: tuple[str, ...]

    @property
    def settings(self) -> Config:
        """The configuration itself."""
        return self.loaded.config

    @property
    def files(self) -> tuple[Path, ...]:
        """The files it was read from: the YAML, then the DBC files."""
        return (self.loaded.path, *map(Path, self.databases))

    def lost_after(self, sensor: BoundSensor) -> float:
        """Return the s without a scan after which a sensor is lost."""
        return self.settings.supervision.lost_after * sensor.settings.cycle_time
