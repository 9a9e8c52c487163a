"""What is valid, and hardly meant: told when a configuration is bound, before a drive shows it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from ipaddress import ip_address
from typing import Final

from candaemon.binding.bound import BoundBus, BoundEgo, BoundOutput, BoundSensor
from candaemon.binding.location import SettingLocation
from candaemon.config.buses import BusSettings
from candaemon.dbc.bits import value_count

_SLOWEST: Final = 5_000
"""bit/s of CAN, at least."""


def oddities(
    location: SettingLocation,
    buses: Iterable[BoundBus],
    ego: BoundEgo | None,
    sensors: Iterable[BoundSensor],
    output: BoundOutput | None,
) -> Iterator[str]:
    """Yield a sentence on each, with its place in the configuration.

    Args:
        location: the configuration's root.
        buses: of the configuration.
        ego: ego motion.
        sensors: the sensors.
        output: the output.
    """
    sensors = list(sensors)
    used = {each.bus for each in (*sensors, ego, output) if each is not None}
    for bus in buses:
        at = location.at("buses", bus.name)
        if bus.index not in used and not bus.settings.dbc:
            yield str(
                at.error("nothing is read from this bus or sent to it; leave it out, or name it where it is meant")
            )
        if bus.settings.bitrate < _SLOWEST:
            yield str(
                at.at("bitrate").error(
                    f"found {bus.settings.bitrate} bit/s, and no CAN is slower than {_SLOWEST}; is it in kbit/s?"
                )
            )
        if bus.settings.interface == "udp_multicast" and not _is_group(bus.settings):
            yield str(
                at.at("channel").error(
                    f"found '{bus.settings.channel}', which is no multicast group; expected one such as 239.74.163.2"
                )
            )
    for sensor in sensors:
        yield from _of_sensor(sensor, location.at("sensors", sensor.name))


def _of_sensor(sensor: BoundSensor, at: SettingLocation) -> Iterator[str]:
    settings = sensor.settings
    if settings.timeout > settings.cycle_time:
        yield str(
            at.at("timeout").error(
                f"found {settings.timeout:g} s, longer than the cycle of {settings.cycle_time:g} s: where a frame is "
                "lost, the next scan is awaited first; expected the time that the frames of a scan take, and some more"
            )
        )
    for index, layout in enumerate(sensor.reader.layouts):
        id_signal, places = layout.id_signal, settings.objects.places_on_page
        if id_signal is None or layout.keys or layout.step != 1:
            continue
        numbers = value_count(id_signal) - layout.first
        if places > numbers:
            yield str(
                at.at("objects", "messages", index).error(
                    f"'{id_signal.name}' has {id_signal.length} bits, so {numbers} numbers at most, for {places} places"
                )
            )


def _is_group(settings: BusSettings) -> bool:
    """Return whether a channel is a multicast group, or a name of which nothing can be told before it is looked up."""
    try:
        return ip_address(settings.channel.partition("%")[0]).is_multicast
    except ValueError:
        return "." in settings.channel
