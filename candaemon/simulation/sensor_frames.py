"""Encodes a sensor's reports as the frames of a real one: headers, triggers, counters, empty slots, bursts."""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.binding.bind_sensor import bind_sensor_writer
from candaemon.binding.bound import BoundSensor
from candaemon.binding.location import SettingLocation
from candaemon.config.sensors import HeaderScan, TriggerScan
from candaemon.frames.frame import Frame
from candaemon.simulation.faults import FrameLosses
from candaemon.simulation.message_writer import MessageWriter
from candaemon.simulation.random_streams import stream
from candaemon.simulation.scenario import Transmission
from candaemon.simulation.schedule import stamps
from candaemon.simulation.slot_reports import SlotReport


class SensorEncoder:
    """Writes one sensor's scans.

    An object keeps its slot. Where the DBC has an identity signal, the objects are instead packed into the first slots
    and only the identity is constant, as with such radars. An identity that is a signal of its own is the slot assigned
    by the simulation, plus 1: such radars call an empty place 0. Where there is no identity, the objects are listed by
    their distance, and nothing is constant. Where a header counts the objects that follow, or all share one message,
    only occupied slots are sent; otherwise all are.

    Args:
        sensor: of the configuration, bound to its DBC.
        transmission: burst, order, jitter and loss.
        seed: of the simulation.
        where: location of the sensor in the configuration.

    Raises:
        ConfigError: a slot cannot be written as configured.

    """

    def __init__(self, sensor: BoundSensor, transmission: Transmission, *, seed: int, where: SettingLocation) -> None:
        form, scan = sensor.settings.objects, sensor.settings.scan
        self._settings, self._bus, self._transmission = sensor.settings, sensor.bus, transmission
        self._looks = tuple(sensor.settings.views)
        self._writers = {look: bind_sensor_writer(sensor, where, look) for look in self._looks}
        self._writer = self._writers[self._looks[0]]
        counted = isinstance(scan, HeaderScan) and len(form.points) > 1  # the count says which points are used
        self._packed = bool(form.identity) and (counted or not form.multiplexed)
        self._listed = form.identity is False
        self._order_counts = any(entry.id_signal is False for entry in form.messages)
        self._used_only = form.multiplexed or (isinstance(scan, HeaderScan) and scan.used_only)
        objects = {message.can_id: (part.index, message) for part in self._writer.layouts for message in part.messages}
        self._fd = frozenset(can_id for can_id, (_, message) in objects.items() if message.is_fd)
        own = self._packed or all(part.id_signal is None for part in self._writer.layouts)
        self._first_identity = int(bool(form.identity) and own)
        self._rank = {can_id: part for can_id, (part, _) in objects.items()} if form.multiplexed else {}
        self._headers = sensor.headers
        self._last_id = sensor.trigger_id
        self._triggers: dict[int, MessageWriter] = {}
        is_marked = sensor.trigger_id in sensor.mark_claims
        if sensor.trigger is not None and (is_marked or sensor.trigger.can_id not in objects):
            when = scan.when if isinstance(scan, TriggerScan) else {}
            says = None if sensor.look is None or sensor.look.part is not None else sensor.look.signal
            self._triggers = {
                look: MessageWriter(sensor.trigger, [], {**when, **({} if says is None else {says: look})})
                for look in self._looks
            }
        self._stamp, self._claims = sensor.stamp, sensor.mark_claims
        self._stamped = (
            frozenset[int]()
            if sensor.stamp is None
            else frozenset(message.can_id for message in self._writer.layouts[sensor.stamp.part].messages)
            if sensor.stamp.part is not None
            else frozenset({sensor.stamp.message.can_id})
        )
        self._monitored = {can_id: sensor.protectors[part] for can_id, (part, _) in objects.items()} | {
            header.can_id: header.protector for header in sensor.headers
        }
        self._clock_start_ns = int(stream(seed, sensor.index, "clock").integers(1 << 40)) if self._stamped else 0
        self._order = stream(seed, sensor.index, "frames")
        self._loss = stream(seed, sensor.index, "loss")
        self._faults = FrameLosses(transmission.faults, stream(seed, sensor.index, "faults"))

    @property
    def saturated(self) -> int:
        """Number of values so far that were outside the range of their signal."""
        return sum(writer.saturated for writer in self._writers.values())

    def frames(self, report: SlotReport, index: int, measured_ns: int) -> list[Frame]:
        """Return the frames of one scan in order of time, lost ones left out.

        Args:
            report: the occupied slots.
            index: number of the scan; counters carry it modulo their width.
            measured_ns: measurement time, log clock.

        """
        look = self._looks[index % len(self._looks)]
        self._writer = self._writers[look]
        sent = self._in_order(self._objects(report, index))
        if self._stamp is not None and self._stamp.own:
            sent.insert(0, (self._stamp.message.can_id, bytes(self._stamp.message.length)))
        sent[:0] = [header.write(len(report.slot), index, look) for header in self._headers]
        if self._triggers:
            trigger = self._triggers[look]
            sent.append((trigger.message.can_id, trigger.payloads(np.empty((0, 1)))[0]))
        times = stamps(measured_ns, len(sent), self._settings, self._transmission, self._order)
        kept = self._loss.random(len(sent)) >= self._transmission.loss
        kept &= ~self._faults.lost(times, whole=True)
        if self._stamp is not None:
            sent = self._with_stamps(sent, times, measured_ns)
        bus, fd = self._bus, self._fd
        return [
            Frame(time, bus, can_id, data, can_id in fd)
            for time, (can_id, data), keep in zip(times.tolist(), sent, kept.tolist(), strict=True)
            if keep
        ]

    def _with_stamps(self, sent: list[tuple[int, bytes]], times: Indices, measured_ns: int) -> list[tuple[int, bytes]]:
        """Write into frames when they were measured, as the sensor tells it."""
        stamp = self._stamp
        assert stamp is not None, "asked before"  # noqa: S101  # a promise within this file
        latency_ns = round(self._settings.latency * 1e9)  # of which the sensor knows nothing
        clock_ns = self._clock_start_ns + round(measured_ns * (1.0 + self._transmission.clock_drift))
        # Frames of objects have one stamp, that of the first: a sensor writes them together.
        first_ns = int(times[0])
        stamped = []
        for (can_id, data), time_ns in zip(sent, times.tolist(), strict=True):
            claim = self._claims.get(can_id)
            if can_id in self._stamped and (claim is None or claim.read(data) == claim.value):
                came_ns = time_ns if stamp.part is None else first_ns
                age_ns = came_ns - measured_ns - latency_ns
                data = stamp.written(data, clock_ns if stamp.wrap_ns else age_ns)
                protector = self._monitored.get(can_id)
                data = data if protector is None else protector.seal(can_id, data)
            stamped.append((can_id, data))
        return stamped

    def identities(self, report: SlotReport) -> Indices:
        """Return the object id with which each occupied slot is read, shape (n,)."""
        if self._listed:
            return _ranks(report)
        return report.slot + self._first_identity

    def _objects(self, report: SlotReport, index: int) -> list[tuple[int, bytes]]:
        """Return the object messages, in order of the message layout's parts."""
        held = _ranks(report) if self._listed else report.slot
        count = len(held)
        place = np.arange(count) if self._packed else held
        values = dict(zip(report.quantities, report.values, strict=True))
        if self._used_only:
            occupied = np.ones(count, dtype=bool)
            identity = held + self._first_identity
            return self._writer.write(place, values, occupied, counter=index, new=report.new, identity=identity)
        slots = self._writer.slots
        spread = {name: _spread(row, place, slots) for name, row in values.items()}
        occupied, new = np.zeros(slots, dtype=bool), np.zeros(slots, dtype=bool)
        occupied[place], new[place] = True, report.new
        identity = np.arange(slots)
        if self._packed:
            identity[place] = held + self._first_identity
        return self._writer.write(np.arange(slots), spread, occupied, counter=index, new=new, identity=identity)

    def _in_order(self, sent: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
        """Return frames in sending order: by part where objects share messages, the trigger frame last."""
        if self._transmission.order == "shuffled" and not self._order_counts:
            sent = [sent[k] for k in self._order.permutation(len(sent)).tolist()]
        if self._rank:
            sent.sort(key=lambda frame: self._rank[frame[0]])
        if self._last_id is not None:
            sent.sort(key=lambda frame: frame[0] == self._last_id)
        return sent


def _ranks(report: SlotReport) -> Indices:
    """Return the place of each object among those of its scan, the nearest first, shape (n,)."""
    values = dict(zip(report.quantities, report.values, strict=True))
    distance = values["range"] if "range" in values else np.hypot(values["x"], values["y"])
    ranks: Indices = distance.argsort(kind="stable").argsort()
    return ranks


def _spread(row: Floats, place: Indices, slots: int) -> Floats:
    """Return a quantity over all slots, 0 where there is no object."""
    spread = np.zeros(slots)
    spread[place] = row
    return spread
