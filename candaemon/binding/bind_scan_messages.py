"""The single messages beside the objects, bound: the output's status, a scan's header."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from candaemon.binding.bind_protection import bind_protector, check_written, counter_period
from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.binding.look_up import find_message, find_signal, signal_of
from candaemon.config.output import StatusFormat
from candaemon.config.protection import ProtectionSettings
from candaemon.config.sensors import HeaderScan
from candaemon.dbc.bits import sendable_values, value_count
from candaemon.dbc.single_codec import compile_encoder, compile_field_reader
from candaemon.dbc.types import Database, SignalSpec
from candaemon.errors import ConfigError
from candaemon.objects.scan_messages import ScanHeader, StatusField, StatusWriter

COUNTING: Final = frozenset({"cycle", "drops", "counter"})
"""Status quantities that are written modulo the signal's number of values; the others saturate."""


def bind_status(
    form: StatusFormat,
    database: Database,
    protection: ProtectionSettings,
    location: SettingLocation,
    *,
    data_id_index: int = 0,
) -> StatusWriter:
    """Bind the writer of the message that is sent once a cycle.

    Args:
        form: its signals and fixed values.
        database: the DBC.
        protection: counter and checksum; each used where the message has that signal.
        location: place of the status in the configuration, whose `protection` is beside it.
        data_id_index: which of the protection's data ids is its.

    Raises:
        ConfigError: naming every signal that the message lacks.

    """
    message = find_message(database, form.message, location.at("message"))
    known = {signal.name for signal in message.signals}
    errors: list[ConfigError] = []
    fields: list[StatusField] = []
    names: list[str] = []
    sources: dict[str, str | float] = {**form.fixed, **form.signals}
    if protection.counter in known and protection.counter not in sources:
        sources[protection.counter] = "counter"
    for name, source in sources.items():
        kind = "signals" if isinstance(source, str) else "fixed"
        with collected(errors):
            signal = find_signal(message, name, location.at(kind, name))
            names.append(name)
            if isinstance(source, str):
                fields.append(StatusField(source, wrap=_wrap(source, signal, protection)))
            else:
                fields.append(StatusField(None, source))
    raise_all(errors)
    encode = compile_encoder(message, names)
    place = location.beside("protection")
    check_written(protection, place)
    protected = protection.e2e is not None or (protection.checksum is not None and protection.checksum in known)
    protector = bind_protector([message], protection, place, order=[data_id_index]) if protected else None
    return StatusWriter(message, tuple(fields), encode, protector)


def _wrap(quantity: str, signal: SignalSpec, protection: ProtectionSettings) -> int:
    """Count the values after which a quantity starts again, 0 where it saturates."""
    if quantity not in COUNTING:
        return 0
    return counter_period(protection, signal) if quantity == "counter" else value_count(signal)


def bind_header(scan: HeaderScan, database: Database, location: SettingLocation, look: str | None = None) -> ScanHeader:
    """Bind a scan's header message.

    Args:
        scan: how the header gives the number of objects.
        database: the DBC.
        location: place of the scan's settings in the configuration.
        look: signal that says which look a scan is, of this message or another; None: none does.

    Raises:
        ConfigError: the DBC lacks the message or a signal.

    """
    message = find_message(database, scan.message, location.at("message"))
    count = find_signal(message, scan.count, location.at("count"))
    names = [count.name]
    greatest = sendable_values(count)[1]
    read_counter, period = None, 0
    if scan.counter is not None:
        counter = find_signal(message, scan.counter, location.at("counter"))
        read_counter, period = compile_field_reader(message, counter), value_count(counter)
        names.append(counter.name)
    says_look = None if look is None else signal_of(message, look)
    if says_look is not None:
        names.append(says_look.name)
    return ScanHeader(
        message=message,
        used_only=scan.used_only,
        count=compile_field_reader(message, count),
        greatest_count=int(greatest) if math.isfinite(greatest) else int(np.iinfo(np.int64).max),
        counter=read_counter,
        period=period,
        says_look=says_look is not None,
        encode=compile_encoder(message, names),
        protector=bind_protector([message], scan.protection, location.at("protection")),
    )
