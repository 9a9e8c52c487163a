"""Single messages beside the objects: the output's status, a scan's header."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from candaemon.binding.bind_protection import check_written, counter_period, part_protector
from candaemon.binding.location import SettingLocation, collected, raise_all
from candaemon.config.output import StatusFormat
from candaemon.config.protection import ProtectionSettings
from candaemon.config.sensors import HeaderScan
from candaemon.dbc.batch_codec import compile_encoder
from candaemon.dbc.types import Database, MessageSpec, SignalSpec
from candaemon.errors import ConfigError
from candaemon.objects.conditions import value_limits
from candaemon.objects.layout import find_message, find_signal
from candaemon.objects.signals import field_reader, wraps_at

COUNTING = frozenset({"cycle", "drops", "counter"})
"""Status quantities that go onto the wire modulo the signal's number of values; the others saturate."""


class StatusWriter:
    """Writes the message that is sent once a cycle.

    Args:
        form: its signals and fixed values.
        database: the DBC.
        protection: counter and checksum; each used where the message has that signal.
        where: place of the status in the configuration, whose `protection` is beside it.
        index: which of the data ids is its.

    Attributes:
        message: what the DBC says of it.

    Raises:
        ConfigError: naming every signal that the message lacks.

    """

    def __init__(
        self,
        form: StatusFormat,
        database: Database,
        protection: ProtectionSettings,
        where: SettingLocation | None = None,
        *,
        index: int = 0,
    ) -> None:
        where = where or SettingLocation()
        self.message: MessageSpec = find_message(database, form.message, where.at("message"))
        known = {signal.name for signal in self.message.signals}
        errors: list[ConfigError] = []
        self._fields: list[tuple[str | None, float, int]] = []
        names: list[str] = []
        quantities: dict[str, str | float] = {**form.fixed, **form.signals}
        if protection.counter in known and protection.counter not in quantities:
            quantities[protection.counter] = "counter"
        for name, source in quantities.items():
            kind = "signals" if isinstance(source, str) else "fixed"
            with collected(errors):
                signal = find_signal(self.message, name, where.at(kind, name))
                names.append(name)
                if isinstance(source, str):
                    self._fields.append((source, 0.0, _period(source, signal, protection)))
                else:
                    self._fields.append((None, source, 0))
        raise_all(errors)
        self._encode = compile_encoder(self.message, names)
        place = SettingLocation(where.loaded, where.location[:-1]).at("protection")
        check_written(protection, place)
        protected = protection.e2e is not None or (protection.checksum is not None and protection.checksum in known)
        self._protector = part_protector([self.message], protection, place, order=[index]) if protected else None

    def write(self, values: Mapping[str, float], *, counter: int) -> tuple[int, bytes]:
        """Write the message.

        Args:
            values: quantity → value; one left out is written as 0.
            counter: what the counter shows, modulo its width.

        Returns:
            CAN id and payload.

        """
        given = []
        for quantity, fixed, wrap in self._fields:
            value = fixed if quantity is None else counter if quantity == "counter" else values.get(quantity, 0.0)
            given.append(value % wrap if wrap else value)
        payload, _ = self._encode(given)
        if self._protector is not None:
            payload = self._protector.seal(self.message.can_id, payload)
        return self.message.can_id, payload


def _period(quantity: str, signal: SignalSpec, protection: ProtectionSettings) -> int:
    """Count the values after which a quantity starts again, 0 where it saturates."""
    if quantity not in COUNTING:
        return 0
    return counter_period(protection, signal) if quantity == "counter" else wraps_at(signal)


class ScanHeader:
    """A scan's header message.

    Args:
        scan: how the header tells the number of objects.
        database: the DBC.
        where: place of the scan's settings in the configuration.

    Attributes:
        message: what the DBC says of it.
        can_id: its identifier.
        used_only: whether only the objects counted are sent.

    Raises:
        ConfigError: the DBC lacks the message or a signal.

    """

    def __init__(self, scan: HeaderScan, database: Database, where: SettingLocation | None = None) -> None:
        where = where or SettingLocation()
        self.message: MessageSpec = find_message(database, scan.message, where.at("message"))
        self.can_id = self.message.can_id
        self.used_only = scan.used_only
        count = find_signal(self.message, scan.count, where.at("count"))
        self._count = field_reader(self.message, count)
        self._limit = value_limits(count)[1]
        self._names = [count.name]
        self._counter, self._wrap = None, 0
        if scan.counter is not None:
            counter: SignalSpec = find_signal(self.message, scan.counter, where.at("counter"))
            self._counter, self._wrap = field_reader(self.message, counter), wraps_at(counter)
            self._names.append(counter.name)
        self._encode = compile_encoder(self.message, self._names)
        self._protector = part_protector([self.message], scan.protection, where.at("protection"))

    @property
    def period(self) -> int:
        """Number of values of the measurement counter, 0 where there is none."""
        return self._wrap

    def read(self, data: bytes) -> tuple[int, int]:
        """Read the number of objects that follow and the measurement counter (−1 where there is none)."""
        return self._count(data), -1 if self._counter is None else self._counter(data)

    def write(self, count: int, counter: int) -> tuple[int, bytes]:
        """Write a header: CAN id and payload; a count over the signal's greatest is brought to it."""
        limit = int(self._limit) if math.isfinite(self._limit) else np.iinfo(np.int64).max
        values = [min(count, limit), *([] if self._counter is None else [counter % self._wrap])]
        payload, _ = self._encode(values)
        return self.can_id, payload if self._protector is None else self._protector.seal(self.can_id, payload)
