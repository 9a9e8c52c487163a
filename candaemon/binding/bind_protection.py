"""Protection settings × DBC: the signals they name, found; what checks and what writes a frame, made."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from candaemon.binding.location import SettingLocation
from candaemon.binding.look_up import find_signal
from candaemon.config.protection import InputProtectionSettings, ProtectionSettings
from candaemon.config.sensors import ObjectFormat, SensorSettings
from candaemon.dbc.bits import value_count
from candaemon.dbc.single_codec import compile_field_reader
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.errors import ConfigError
from candaemon.objects.message_layout import MessageLayout
from candaemon.objects.reader import ObjectReader
from candaemon.protection.checksums import FrameProtector, Protector
from candaemon.protection.e2e import HEADERS, E2eProtector, check_header
from candaemon.protection.monitor import UNWATCHED, FrameMonitorSettings

Protection = TypeVar("Protection", bound=ProtectionSettings)


@dataclass(frozen=True, slots=True)
class LayoutProtection(Generic[Protection]):
    """The protection of one of an object's messages.

    Attributes:
        settings: its own, or those of the sensor or the output.
        place: where they are configured.
        first: data ids that go to messages before it.
    """

    settings: Protection
    place: SettingLocation
    first: int

    def order(self, slots: Iterable[int]) -> list[int]:
        """Return which of the data ids are those of some slots' messages."""
        return [self.first + slot for slot in slots]


def layout_protections(
    layouts: Sequence[MessageLayout], form: ObjectFormat, default: Protection, location: SettingLocation
) -> list[LayoutProtection[Protection | InputProtectionSettings]]:
    """List the protection of each of an object's messages; those without one of their own share the data ids."""
    found: list[LayoutProtection[Protection | InputProtectionSettings]] = []
    first, entries = 0, location.at("objects", "messages")
    for layout, entry in zip(layouts, form.messages, strict=True):
        if entry.protection is not None:
            found.append(LayoutProtection(entry.protection, entries.at(layout.index, "protection"), 0))
        else:
            found.append(LayoutProtection(default, location.at("protection"), first))
            first += len(layout.messages)
    return found


def check_written(protection: ProtectionSettings, place: SettingLocation) -> None:
    """Check that frames can be written with a protection.

    Raises:
        ConfigError: a profile's counter has no signal by whose name it is written.

    """
    if protection.e2e is not None and protection.counter is None:
        raise place.at("e2e").error(
            f"profile {protection.e2e.profile} sends a counter; name its signal as counter beside e2e"
        )


def bind_protector(
    messages: Sequence[MessageSpec],
    protection: ProtectionSettings,
    place: SettingLocation,
    *,
    order: Sequence[int] | None = None,
) -> FrameProtector | None:
    """Make what checks and writes the checksums of some messages, None where the configuration asks for none.

    Args:
        messages: the messages.
        protection: as configured.
        place: where it is configured.
        order: which of the data ids is each message's; default: in their order.

    Raises:
        ConfigError: a kind without a signal or the other way round, no such signal, or it lies elsewhere than its kind
            or profile asks for.

    """
    if protection.e2e is not None:
        return _e2e_protector(messages, protection, place, order)
    if (protection.kind == "none") != (protection.checksum is None):
        raise place.error("checksum and kind go together; give both or neither")
    if protection.kind == "none" or protection.checksum is None:
        return None
    for message in messages:
        find_signal(message, protection.checksum, place.at("checksum"))
    try:
        return Protector(protection.kind, messages, protection.checksum)
    except ConfigError as error:
        raise place.at("checksum").error(error.message) from None


def _e2e_protector(
    messages: Sequence[MessageSpec], protection: ProtectionSettings, place: SettingLocation, order: Sequence[int] | None
) -> E2eProtector:
    """Make a profile's protector; signals that are named must lie where the profile has them."""
    profile = protection.e2e
    assert profile is not None  # noqa: S101  # the caller asked
    for role, name in (("counter", protection.counter), ("checksum", protection.checksum)):
        for message in messages if name is not None else ():
            problem = check_header(profile, find_signal(message, name or "", place.at(role)), role)
            if problem is not None:
                raise place.at(role).error(f"in message '{message.name}' ({_dbc_line(message)}) {problem}")
    try:
        return E2eProtector(profile, messages, range(len(messages)) if order is None else order)
    except ConfigError as error:
        raise place.at("e2e").error(error.message) from None


def bind_frame_monitor(
    messages: Sequence[MessageSpec],
    protection: InputProtectionSettings,
    place: SettingLocation,
    *,
    cycle_time: float,
    order: Sequence[int] | None = None,
) -> FrameMonitorSettings | None:
    """Work out what frames of some messages laid out alike must be to be used, None where anything will do.

    Args:
        messages: the messages.
        protection: as configured.
        place: where it is configured.
        cycle_time: s between two frames of a message, unless the configuration gives another time.
        order: which of the data ids is each message's; default: in their order.

    Raises:
        ConfigError: as `bind_protector`; no such counter.

    """
    protector = bind_protector(messages, protection, place, order=order)
    max_step, counter, values = protection.greatest_step, None, 0
    if max_step is not None:
        counter, values = _counter(messages[0], protection, place, protector)
    cycle_ns = round((protection.cycle_time or cycle_time) * 1e9)
    monitor = FrameMonitorSettings(
        protector,
        counter,
        counter_values=values,
        max_step=max_step or 0,
        settle=protection.settle,
        use_jumps=protection.on_jump == "use",
        timeout_ns=UNWATCHED if protection.timeout is None else round(protection.timeout * 1e9),
        spacing_ns=0 if protection.max_rate is None else round(cycle_ns / protection.max_rate),
        slack_ns=cycle_ns,
    )
    return monitor if monitor.protector is not None or monitor.watches else None


def bind_frame_monitors(
    reader: ObjectReader, settings: SensorSettings, location: SettingLocation
) -> tuple[FrameMonitorSettings | None, ...]:
    """Work out for each of an object's messages what its frames must be to be used.

    Raises:
        ConfigError: as `bind_frame_monitor`.

    """
    # where all objects share a message it comes as many times a cycle; with pages, once for each
    pages = 1 if settings.objects.pages is None else settings.objects.pages.count
    cycle_time = settings.cycle_time / (reader.places if reader.multiplexed else pages)
    protections = layout_protections(reader.layouts, settings.objects, settings.protection, location)
    return tuple(
        bind_frame_monitor(
            layout.messages,
            each.settings,
            each.place,
            cycle_time=cycle_time,
            order=each.order(range(len(layout.messages))),
        )
        for layout, each in zip(reader.layouts, protections, strict=True)
    )


def _counter(
    message: MessageSpec, protection: InputProtectionSettings, place: SettingLocation, protector: FrameProtector | None
) -> tuple[Callable[[bytes], int], int]:
    """Find what reads the counter, and how many values it goes through."""
    if protection.counter is None:
        assert isinstance(protector, E2eProtector)  # noqa: S101  # the settings ask for a counter or a profile
        return protector.counter, protector.header.counter_values
    signal = find_signal(message, protection.counter, place.at("counter"))
    return compile_field_reader(message, signal), counter_period(protection, signal)


def counter_period(protection: ProtectionSettings, signal: SignalSpec) -> int:
    """Count the values that a counter signal goes through under a protection."""
    if protection.counter_values is not None:
        return min(protection.counter_values, value_count(signal))
    if protection.e2e is not None and signal.name == protection.counter:
        return HEADERS[protection.e2e.profile].counter_values
    return value_count(signal)


def _dbc_line(message: MessageSpec) -> str:
    return "DBC" if message.file is None else f"{message.file}:{message.line}"
