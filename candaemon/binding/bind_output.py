"""The output, bound: the writers of its slots and its status."""

from __future__ import annotations

from candaemon.binding.bind_scan_messages import bind_status
from candaemon.binding.bind_writer import bind_writer
from candaemon.binding.bound import BoundOutput
from candaemon.binding.location import SettingLocation
from candaemon.config.base import SignalRef
from candaemon.config.output import OutputSettings
from candaemon.dbc.types import Database


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
    can_ids = frozenset(message.can_id for message in messages)
    fd_ids = frozenset(message.can_id for message in messages if message.is_fd)
    return BoundOutput(settings, bus, database, writer, status, can_ids, fd_ids)
