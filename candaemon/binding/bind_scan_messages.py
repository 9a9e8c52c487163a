"""The single messages beside the objects, bound: the output's status, a scan's header."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from candaemon.binding.bind_protection import bind_protector, check_written, counter_period
from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.binding.look_up import find_message, find_signal, signal_of
from candaemon.binding.numbered_names import valued_view
from candaemon.config.output import StatusFormat
from candaemon.config.protection import ProtectionSettings
from candaemon.config.sensors import HeaderScan
from candaemon.dbc.bits import sendable_values, value_count
from candaemon.dbc.single_codec import compile_encoder, compile_field_reader
from candaemon.dbc.types import Database, MessageSpec, SignalSpec
from candaemon.errors import ConfigError
from candaemon.objects.scan_messages import HeaderCount, ScanHeader, StatusField, StatusWriter
from candaemon.protection.checksums import FrameProtector

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


def bind_headers(
    scan: HeaderScan, database: Database, location: SettingLocation, look: str | None = None
) -> tuple[ScanHeader, ...]:
    """Bind a scan's header messages.

    Args:
        scan: how the headers give the number of objects.
        database: the DBC.
        location: place of the scan's settings in the configuration.
        look: signal that says which look a scan is, of one of these messages or another; None: none does.

    Raises:
        ConfigError: the DBC lacks a message or a signal, or none of the messages has it.

    """
    messages = [find_message(database, name, location.at("message")) for name in scan.message]
    for name, value in scan.when.items():
        messages = [valued_view(message, name, value) for message in messages]
    if len({message.can_id for message in messages}) < len(messages):
        raise location.at("message").error("the same header is listed twice")
    counted = [(index, _owner(messages, name, location.at("count"))) for index, name in enumerate(scan.count)]
    counting = None if scan.counter is None else _owner(messages, scan.counter, location.at("counter"))
    looking = next((message for message in messages if look is not None and signal_of(message, look)), None)
    return tuple(
        _header(
            message,
            scan,
            [(index, signal) for index, (owner, signal) in counted if owner is message],
            counting[1] if counting is not None and counting[0] is message else None,
            signal_of(message, look) if look is not None and looking is message else None,
            location,
            bind_protector([message], scan.protection, location.at("protection")),
        )
        for message in messages
    )


def _owner(messages: Sequence[MessageSpec], name: str, location: SettingLocation) -> tuple[MessageSpec, SignalSpec]:
    """Find a signal in the first of some messages that has it.

    Raises:
        ConfigError: none has.

    """
    for message in messages:
        signal = signal_of(message, name)
        if signal is not None:
            return message, signal
    return messages[-1], find_signal(messages[-1], name, location)


def _header(
    message: MessageSpec,
    scan: HeaderScan,
    counts: Sequence[tuple[int, SignalSpec]],
    counter: SignalSpec | None,
    look: SignalSpec | None,
    location: SettingLocation,
    protector: FrameProtector | None,
) -> ScanHeader:
    """Make what reads and writes one header."""
    extra = [*(signal.name for signal in (counter, look) if signal is not None), *scan.when]
    for name in scan.when:
        find_signal(message, name, location.at("when", name))
    return ScanHeader(
        message=message,
        used_only=scan.used_only,
        counts=tuple(
            HeaderCount(compile_field_reader(message, signal), _greatest(signal), index, len(scan.count))
            for index, signal in counts
        ),
        counter=None if counter is None else compile_field_reader(message, counter),
        period=0 if counter is None else value_count(counter),
        says_look=look is not None,
        encode=compile_encoder(message, [*(signal.name for _, signal in counts), *extra]),
        protector=protector,
        fixed=tuple(map(float, scan.when.values())),
    )


def _greatest(signal: SignalSpec) -> int:
    greatest = sendable_values(signal)[1]
    return int(greatest) if math.isfinite(greatest) else int(np.iinfo(np.int64).max)
