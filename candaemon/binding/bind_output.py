"""The output, bound: the writers of its slots and its status."""

from __future__ import annotations

from candaemon.binding.bind_scan_messages import bind_status
from candaemon.binding.bind_writer import bind_writer
from candaemon.binding.bound import BoundOutput
from candaemon.binding.location import SettingLocation, raise_all
from candaemon.config.base import SignalRef
from candaemon.config.output import OutputSettings
from candaemon.dbc.types import Database, MessageSpec
from candaemon.errors import ConfigError
from candaemon.frames.frame_block import FD_LENGTHS


def bind_output(settings: OutputSettings, bus: int, database: Database, location: SettingLocation) -> BoundOutput:
    """Bind the output to its DBC.

    Args:
        settings: from the configuration.
        bus: index of the bus.
        database: the DBC.
        location: the output's place in the configuration.

    Raises:
        ConfigError: naming every message, signal, unit and value that is wrong.

    """
    signals: dict[str, SignalRef | tuple[SignalRef, ...]] = {
        str(quantity): refs for quantity, refs in settings.signals.items()
    }
    writer = bind_writer(
        settings.objects, signals, database, settings.protection, location=location, units=settings.units
    )
    status = None
    if settings.status is not None:
        place = location.at("status")
        status = bind_status(settings.status, database, settings.protection, place, data_id_index=writer.data_ids)
    messages = [message for layout in writer.layouts for message in layout.messages]
    if status is not None:
        messages.append(status.message)
    raise_all([_unsendable(message, location) for message in messages if message.length not in FD_LENGTHS])
    can_ids = frozenset(message.can_id for message in messages)
    fd_ids = frozenset(message.can_id for message in messages if message.is_fd)
    return BoundOutput(settings, bus, database, writer, status, can_ids, fd_ids)


def _unsendable(message: MessageSpec, location: SettingLocation) -> ConfigError:
    """Return the error of a message that no frame carries as it is: a controller would make it longer."""
    longer = [length for length in FD_LENGTHS if length > message.length]
    cure = f"give it {min(longer)}" if longer else f"give it {max(FD_LENGTHS)} at most"
    return location.error(
        f"message '{message.name}' has {message.length} bytes, which no CAN FD frame carries; {cure} in the DBC"
    )
