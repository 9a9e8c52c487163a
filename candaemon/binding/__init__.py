"""Settings × DBC: every name checked, every signal resolved to a codec's column. Knows nothing of sockets or tracks."""

from candaemon.binding.batch import ObjectBatch
from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding, BoundBus, BoundOutput, BoundSensor
from candaemon.binding.ego import BoundEgo, EgoMessage
from candaemon.binding.load import Traffic, bus_load
from candaemon.binding.objects import ObjectReader
from candaemon.binding.parts import Part
from candaemon.binding.signals import SignalBinding
from candaemon.binding.status import Header, StatusWriter
from candaemon.binding.where import Where
from candaemon.binding.writer import ObjectWriter

__all__ = [
    "Binding",
    "BoundBus",
    "BoundEgo",
    "BoundOutput",
    "BoundSensor",
    "EgoMessage",
    "Header",
    "ObjectBatch",
    "ObjectReader",
    "ObjectWriter",
    "Part",
    "SignalBinding",
    "StatusWriter",
    "Traffic",
    "Where",
    "bind",
    "bus_load",
]
