"""What a log says against a configuration: each contradiction with where it is written, and what to do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from candaemon.arrays import Booleans, Floats, Indices
from candaemon.binding.bound import Binding, BoundSensor
from candaemon.config.sensors import CounterScan, HeaderScan
from candaemon.dbc.batch_codec import BatchDecoder
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.ego.pose import EgoPose
from candaemon.objects.message_layout import MessageLayout
from candaemon.radar.scan import Scan
from candaemon.wizard.frame_checks import steps_of
from candaemon.wizard.layouts import Layout, Part
from candaemon.wizard.object_motion import (
    NO_SLOPE,
    Pairs,
    Slope,
    approach_slope,
    derivative_slope,
    pairs,
    standing_rows,
    turning_slope,
    white_noise,
)
from candaemon.wizard.object_table import ObjectColumn, ObjectTable
from candaemon.wizard.occupancy import Occupancy, occupancy
from candaemon.wizard.own_motion import SLOWEST, OwnMotion
from candaemon.wizard.traffic import LogTraffic, Stream, read_traffic
from candaemon.wizard.trial import LEAST_NIS, Trial, try_on

PROVEN: Final = 6.0
"""Standard deviations from which on a log contradicts a configuration."""
_OBVIOUS: Final = 24.0
"""Likewise, where what was measured is none, which may have other reasons."""
NIS_LEAST: Final = 0.4
"""Mean NIS over the expected one, below which the noise is too large."""
NIS_MOST: Final = 2.2
"""Likewise, beyond which it is too small."""
FEW: Final = 0.02
"""Share of failures that any bus may have."""
SCATTER: Final = 6.0
"""Times the scatter from scan to scan, beyond which noise is too large even for a radar that filters by itself."""
HIDDEN: Final = 3.0
"""Times the noise, beyond which the scatter from scan to scan shows that it is too small."""
STEADIEST: Final = 0.01
"""m, m/s or rad: less scatter than that says nothing."""
YAW_OFF_DEG: Final = 2.0
"""deg by which what stands may seem to come from beside."""

Where = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class LogFinding:
    """A contradiction.

    Attributes:
        where: place in the configuration.
        text: what the log says, and what to do.
    """

    where: Where
    text: str


def findings(binding: Binding, logs: Sequence[Path]) -> list[LogFinding]:
    """Hold a configuration against the first seconds of a log, or of several that are one drive.

    Raises:
        InputError: there is no such log, or no frame in it.
    """
    channels = {name: bus.index for bus in binding.buses for name in bus.settings.names_in_logs}
    traffic = read_traffic(logs, channels)
    found = list(_buses(binding, traffic))
    trial = try_on(binding, logs)
    found += _fd_frames(trial)
    found += _own_motion(binding, trial)
    for sensor in binding.sensors:
        if (sensor.bus, *_some_id(sensor, traffic)) not in traffic.streams:
            if not any(each.where[:2] == ("buses", binding.buses[sensor.bus].name) for each in found):
                found.append(_absent(binding, sensor, traffic))
            continue
        found += _twin(binding, sensor, traffic)
        found += _frames(sensor, traffic, trial)
        found += _scans(sensor, trial)
        found += _motion(binding, sensor, trial)
    return found


def _some_id(sensor: BoundSensor, traffic: LogTraffic) -> tuple[int, ...]:
    """Return an identifier of a sensor's objects that came, in a tuple; empty where none did."""
    ids = (message.can_id for layout in sensor.reader.layouts for message in layout.messages)
    return next(((each,) for each in ids if (sensor.bus, each) in traffic.streams), ())


def _buses(binding: Binding, traffic: LogTraffic) -> Iterator[LogFinding]:
    """Yield buses of which nothing came."""
    came = {bus for bus, _ in traffic.streams}
    read = {sensor.bus for sensor in binding.sensors} | ({binding.ego.bus} if binding.ego is not None else set())
    for index in sorted(read - came):
        bus = binding.buses[index]
        names = ", ".join(traffic.channels[:8])
        yield LogFinding(
            ("buses", bus.name),
            f"no frame came of {' or '.join(bus.settings.names_in_logs)}; "
            f"the log has {names}: set channel or log_channel",
        )


def _fd_frames(trial: Trial) -> Iterator[LogFinding]:
    """Yield buses without `fd` of which CAN FD frames came."""
    pipeline = trial.pipeline
    for bus, counts in zip(pipeline.binding.buses, pipeline.counts.buses, strict=True):
        if counts.fd_unset:
            yield LogFinding(
                ("buses", bus.name, "fd"),
                f"{counts.fd_unset:,} CAN FD frames came, which `run` would not read; set true",
            )


def _absent(binding: Binding, sensor: BoundSensor, traffic: LogTraffic) -> LogFinding:
    ids = {message.can_id for layout in sensor.reader.layouts for message in layout.messages}
    elsewhere = sorted({binding.buses[bus].name for bus, can_id in traffic.streams if can_id in ids})
    cure = f"they came on bus {', '.join(elsewhere)}: set bus" if elsewhere else "check the DBC file and the channel"
    return LogFinding(("sensors", sensor.name, "bus"), f"not one of its objects' messages came on this bus; {cure}")


_FARTHEST_TWIN: Final = 0xFF
"""Most by which the identifiers of two devices of one kind differ."""
_RATE_OF_TWIN: Final = 0.2
"""Share by which the scans of two devices of one kind may differ in number."""


def _twin(binding: Binding, sensor: BoundSensor, traffic: LogTraffic) -> Iterator[LogFinding]:
    """Yield what seems to be a second device of a sensor's kind: unknown identifiers, a number beside the sensor's."""
    known = {can_id for database in binding.buses[sensor.bus].databases for can_id in database.by_id}
    came = {can_id: stream for (bus, can_id), stream in traffic.streams.items() if bus == sensor.bus}
    own = [can_id for can_id in sorted(sensor.can_ids) if can_id in came]
    strange = came.keys() - known
    cycle = sensor.settings.cycle_time
    offsets = range(-_FARTHEST_TWIN, _FARTHEST_TWIN + 1) if len(own) > 1 else range(0)
    for offset in offsets:
        beside = [each + offset for each in own]
        if strange.issuperset(beside) and all(
            _is_alike(came[a], came[b], cycle) for a, b in zip(own, beside, strict=True)
        ):
            yield LogFinding(
                ("sensors", sensor.name),
                f"identifiers {offset:+#x} beside its own came too, of the same lengths and in no DBC: of another "
                "device of its kind? Give that a sensor with "
                f"id_offset: {sensor.settings.id_offset + offset:#x}",
            )
            return


def _is_alike(one: Stream, other: Stream, cycle_time: float) -> bool:
    """Return whether two streams have frames of the same lengths in about as many scans."""
    if set(one.length.tolist()) != set(other.length.tolist()):
        return False
    ours, theirs = _scans_of(one, cycle_time), _scans_of(other, cycle_time)
    return abs(theirs - ours) <= _RATE_OF_TWIN * ours


def _scans_of(stream: Stream, cycle_time: float) -> int:
    """Return in how many scans a stream has frames: a list has as many in each as the radar sees objects."""
    return 1 + int(np.count_nonzero(np.diff(stream.time) > 0.5 * cycle_time))


def _own_motion(binding: Binding, trial: Trial) -> Iterator[LogFinding]:
    """Yield what is wrong with own motion."""
    if binding.ego is None:
        return
    counts = trial.pipeline.counts
    cycles = max(1, sum(map(len, trial.scans)))
    faults = counts.ego_motion
    signals = trial.pipeline.ego_signals
    silent = [name for name, count in signals.items() if not count]
    if silent and len(silent) == len(signals):
        yield LogFinding(("ego",), "none of its signals came: check bus and DBC file")
    else:
        for name in silent:
            yield LogFinding(("ego", "signals", name), "it never came in a usable frame; check its message and bus")
    if faults.refused > FEW * max(1, sum(signals.values())):
        yield LogFinding(
            ("ego", "plausibility"),
            f"{faults.refused:,} frames of own motion were refused; if the DBC's ranges are wrong: {{ranges: false}}",
        )
    elif counts.without_ego > 0.5 * cycles and not silent:
        yield LogFinding(("ego",), f"own motion was not known in {counts.without_ego:,} of {cycles:,} scans")
    unseen = counts.dead_reckoning + counts.ego_lost
    if unseen > 0.1 * counts.cycles and not silent:
        yield LogFinding(
            ("ego",), f"for {unseen:,} of {counts.cycles:,} cycles no velocity of the vehicle came in time"
        )


def _frames(sensor: BoundSensor, traffic: LogTraffic, trial: Trial) -> Iterator[LogFinding]:
    """Yield what the frames say: checks that fail, slots that lack, counters that do not count."""
    place: Where = ("sensors", sensor.name)
    counts = trial.pipeline.assemblers[sensor.index].counts
    frames = max(1, counts.frames)
    for cause, key, cure in (
        ("checksum", "protection", "another kind of checksum, or another signal"),
        ("jumped", "protection", "the counter goes on otherwise: check counter and counter_values, or raise max_step"),
        ("repeated", "protection", "the counter stands still: it is another signal, or leave it out"),
        ("too_fast", "protection", "raise max_rate, or cycle_time"),
        ("short", "dbc", "they are shorter than the DBC says: a DBC of another version"),
    ):
        failed = getattr(counts, cause)
        if failed > FEW * frames:
            yield LogFinding((*place, key), f"{failed / frames:.0%} of the frames fail ({cause}); {cure}")
    if counts.duplicate + counts.late + counts.surplus > 0.1 * frames:
        yield LogFinding(
            (*place, "scan"),
            f"{(counts.duplicate + counts.late + counts.surplus) / frames:.0%} of the frames came twice in a scan, too "
            "late, or of no slot; check what closes a scan, timeout and slots",
        )
    yield from _more_slots(sensor, traffic)
    yield from _closing(sensor, traffic)
    yield from _cycle_time(sensor, traffic)


def _more_slots(sensor: BoundSensor, traffic: LogTraffic) -> Iterator[LogFinding]:
    """Yield messages of the objects' family that came and are configured for no slot."""
    form, scan = sensor.settings.objects, sensor.settings.scan
    are_all_sent = not (isinstance(scan, HeaderScan) and scan.used_only)
    for layout, entry in zip(sensor.reader.layouts, form.messages, strict=True):
        if "{slot" not in entry.message:
            continue
        further = 0
        ends = (form.first + form.step * len(layout.messages), form.step), (form.first - form.step, -form.step)
        for begin, step in ends:
            for number in range(begin, max(-1, begin + 1024 * step), step):
                message = sensor.database.messages.get(entry.named(number))
                if message is None:
                    break
                further += (sensor.bus, message.can_id) in traffic.streams
        silent = sum((sensor.bus, message.can_id) not in traffic.streams for message in layout.messages)
        if further:
            yield LogFinding(
                ("sensors", sensor.name, "objects", "slots"),
                f"{further} further messages such as {entry.message} came that no slot takes; check slots and first",
            )
        elif silent and are_all_sent and not entry.optional:
            yield LogFinding(
                ("sensors", sensor.name, "objects", "slots"),
                f"{silent} of the {len(layout.messages)} messages {entry.message} never came; check slots and first",
            )


def _closing(sensor: BoundSensor, traffic: LogTraffic) -> Iterator[LogFinding]:
    """Yield a counter that does not count, a trigger or a header that never comes."""
    scan, place = sensor.settings.scan, ("sensors", sensor.name, "scan")
    mark = sensor.header.message if sensor.header is not None else sensor.trigger
    if mark is not None and (sensor.bus, mark.can_id) not in traffic.streams:
        yield LogFinding(place, f"message {mark.name} never came, so no scan closes by it; check message and bus")
    if isinstance(scan, CounterScan):
        layout = sensor.reader.layouts[0]
        for message in layout.messages:
            stream = traffic.stream(sensor.bus, message)
            spec = message.find(scan.signal)
            if stream is None or spec is None or len(stream.time) < 10:
                continue
            values = BatchDecoder(message, [spec.name]).decode(stream.payload)[0][_of_one_slot(layout, message, stream)]
            step, share = steps_of(values[np.isfinite(values)], spec.length)
            if step == 0 or share < 0.5:
                yield LogFinding(
                    (*place, "signal"),
                    f"{scan.signal} does not go on from scan to scan, so it is no counter; name the counter, or "
                    "close by trigger or timeout",
                )
            return
    if isinstance(scan, HeaderScan) and sensor.header is not None:
        yield from _header_count(sensor, scan, sensor.header.message, traffic)


def _of_layout(layout: MessageLayout, message: MessageSpec, stream: Stream) -> Booleans:
    """Return which frames of a message are of a layout, where a value in them says so (n,)."""
    if layout.selector is None:
        return np.ones(len(stream.time), np.bool_)
    signal, value = layout.selector
    values: Floats = BatchDecoder(message, [signal.name]).decode(stream.payload)[0]
    mine: Booleans = values == value * signal.scale + signal.offset
    return mine


def _of_one_slot(layout: MessageLayout, message: MessageSpec, stream: Stream) -> Booleans:
    """Return which frames of a message are of one slot, that which came most often (n,)."""
    rows = _of_layout(layout, message, stream)
    if layout.id_signal is None or not rows.any():
        return rows
    numbers = BatchDecoder(message, [layout.id_signal.name]).decode(stream.payload)[0]
    known, counts = np.unique(numbers[rows], return_counts=True)
    mine: Booleans = rows & (numbers == known[counts.argmax()])
    return mine


def _header_count(
    sensor: BoundSensor, scan: HeaderScan, message: MessageSpec, traffic: LogTraffic
) -> Iterator[LogFinding]:
    """Yield a header's count that is not the number of objects."""
    stream = traffic.stream(sensor.bus, message)
    layout = sensor.reader.layouts[0]
    first = [
        each.order[_of_layout(layout, part, each)]
        for part in layout.messages
        if (each := traffic.stream(sensor.bus, part)) is not None
    ]
    if (
        stream is None
        or not first
        or len(stream.time) < 5
        or len(sensor.settings.objects.points) > 1
        or not scan.used_only
    ):
        return
    orders = np.sort(np.concatenate(first))
    following = np.diff(np.append(np.searchsorted(orders, stream.order), len(orders)))
    names = [name for name in scan.count if message.find(name) is not None]
    if len(names) < len(scan.count):
        return  # the rest of the count comes in further messages
    counted = BatchDecoder(message, names).decode(stream.payload).sum(axis=0)
    share = float(np.mean(np.abs(counted[:-1] - following[:-1]) <= 0.5))
    if share < 0.5:
        yield LogFinding(
            ("sensors", sensor.name, "scan", "count"),
            f"{' + '.join(scan.count)} is the number "
            f"of objects that follow in {share:.0%} of the scans; name the count, "
            "or "
            "give used_only: false where all slots are sent",
        )


def _cycle_time(sensor: BoundSensor, traffic: LogTraffic) -> Iterator[LogFinding]:
    """Yield a cycle time that is not the messages'."""
    told = sensor.settings.cycle_time
    mark = sensor.header.message if sensor.header is not None else None
    if mark is None and sensor.reader.multiplexed:
        return
    stream = traffic.stream(sensor.bus, mark or sensor.reader.layouts[0].messages[0])
    if stream is None or len(stream.time) < 10 or sensor.settings.looks is not None:
        return
    found = float(np.median(np.diff(stream.time)))
    if not 0.8 < found / told < 1.25:
        yield LogFinding(
            ("sensors", sensor.name, "cycle_time"), f"found {told:g} s, but scans came every {found:.4g} s; set that"
        )


def _scans(sensor: BoundSensor, trial: Trial) -> Iterator[LogFinding]:
    """Yield what the scans say: none, incomplete ones, conditions that never hold, values out of range, the noise."""
    place: Where = ("sensors", sensor.name)
    counts = trial.pipeline.assemblers[sensor.index].counts
    scans = [scan for scan, _ in trial.scans[sensor.index]]
    if not scans:
        yield LogFinding((*place, "scan"), "not one scan closed; check what closes it, and timeout")
        return
    due = trial.seconds / sensor.settings.cycle_time
    if counts.incomplete > 0.2 * counts.scans:
        yield LogFinding(
            (*place, "timeout"),
            f"{counts.incomplete:,} of {counts.scans:,} scans were incomplete; raise timeout, or check slots "
            "and what closes",
        )
    elif sensor.settings.looks is None and not 0.7 < counts.scans / max(due, 1.0) < 1.4:
        yield LogFinding(
            (*place, "scan"), f"{counts.scans:,} scans closed, expected {due:,.0f}; check what closes a scan"
        )
    held = sum(len(scan.slot) for scan in scans)
    lost = {"rejected": counts.rejected, "not_finite": counts.not_finite, "unpaired": counts.unpaired}
    for cause, count in lost.items():
        if count > 0.2 * (held + count):
            keys = {"rejected": "objects", "not_finite": "signals", "unpaired": "objects"}
            yield LogFinding((*place, keys[cause]), f"{count:,} of {held + count:,} objects are left out ({cause})")
    if counts.out_of_range > 0.05 * (held + counts.out_of_range):
        yield LogFinding(
            (*place, "plausibility"),
            f"{counts.out_of_range:,} of {held + counts.out_of_range:,} objects are outside the DBC's ranges; a wrong "
            "or stale DBC, or give plausibility: {ranges: false}",
        )
    if not held and not any(lost.values()) and not counts.out_of_range:
        yield LogFinding((*place, "objects", "valid"), "its conditions never hold; check the signals and their values")
        return
    yield from _new(sensor, scans, held)
    yield from _constant(sensor, scans)
    nis = trial.score.nis
    if len(trial.scans) == 1 and nis.samples >= LEAST_NIS:
        ratio = nis.mean / nis.expected
        if not NIS_LEAST < ratio < NIS_MOST:
            size, factor = ("small", "raise") if ratio > 1 else ("large", "lower")
            yield LogFinding(
                (*place, "noise"),
                f"the NIS is {ratio:.2f} times the expected one: too {size}; {factor} it by about {ratio**0.5:.2g} "
                "once signs and units are right",
            )


def _new(sensor: BoundSensor, scans: list[Scan], held: int) -> Iterator[LogFinding]:
    """Yield a flag of new objects that is nearly always set, or never."""
    if not sensor.settings.objects.new or held < 200:
        return
    flagged = sum(int(np.count_nonzero(scan.new)) for scan in scans)
    where: Where = ("sensors", sensor.name, "objects", "new")
    if flagged > 0.6 * held:
        yield LogFinding(
            where, f"{flagged / held:.0%} of all objects are new by it, so nothing is tracked; check its value"
        )
    elif not flagged and held > 2000:
        yield LogFinding(where, "it never holds; check signal and value, or leave it out")


def _constant(sensor: BoundSensor, scans: list[Scan]) -> Iterator[LogFinding]:
    """Yield measured signals that never change."""
    values = np.concatenate([scan.values for scan in scans], axis=1)
    if values.shape[1] < 200:
        return
    for name, row in zip(sensor.reader.quantities, values, strict=True):
        known = row[np.isfinite(row)]
        if len(known) > 200 and name not in {"length", "width", "heading", "score", "class"} and np.ptp(known) == 0:
            yield LogFinding(("sensors", sensor.name, "signals", name), "its signal never changes; name another one")


def _motion(binding: Binding, sensor: BoundSensor, trial: Trial) -> Iterator[LogFinding]:
    """Yield signs, units and mountings that contradict the motion."""
    if binding.ego is None or not sensor.settings.identified or sensor.settings.looks is not None:
        return
    table = _table(sensor, trial.scans[sensor.index])
    own = _own(trial.scans[sensor.index])
    if table is None or own is None:
        return
    polar = sensor.settings.signals.polar
    rate = next((table.values(key) for key in ("range_rate", "vx") if key in table.columns), None)
    held = occupancy(table, "far", (), rate, all_held=True)
    yield from _scatter(sensor, table, held)
    yield from _rate(sensor, table)
    yield from _approach(sensor, table, held, own, "range" if polar else "x")
    yield from _turns(sensor, table, held, own)


def _table(sensor: BoundSensor, scans: tuple[tuple[Scan, EgoPose | None], ...]) -> ObjectTable | None:
    """Return a sensor's valid objects in SI units, turned into the vehicle's directions."""
    kept = [(scan, pose) for scan, pose in scans if len(scan.slot)]
    if sum(len(scan.slot) for scan, _ in kept) < 200:
        return None
    start = kept[0][0].time_ns
    time = np.concatenate([np.full(len(scan.slot), (scan.time_ns - start) * 1e-9) for scan, _ in kept])
    number = np.concatenate([scan.object_id for scan, _ in kept]).astype(np.intp)
    values = np.concatenate([scan.values for scan, _ in kept], axis=1)
    rows = np.lexsort((time, number))
    of = {name: values[k, rows] for k, name in enumerate(sensor.reader.quantities)}
    if sensor.settings.signals.polar:
        of["x"], of["y"] = of["range"] * np.cos(of["azimuth"]), of["range"] * np.sin(of["azimuth"])
        of["far"] = of["range"]
    else:
        of["far"] = of["x"]
    spec = SignalSpec("", 0, 16)
    columns = {name: ObjectColumn(name, spec, 0, each) for name, each in of.items()}
    none = Layout((Part("", (), (), (), ()),), 1, 0, 1, "")
    return ObjectTable(none, 0, time[rows], number[rows], rows, columns, sensor.settings.cycle_time)


def _own(scans: tuple[tuple[Scan, EgoPose | None], ...]) -> OwnMotion | None:
    """Return own motion as the pipeline found it."""
    kept = [(scan.time_ns, pose) for scan, pose in scans if pose is not None]
    first = next((scan.time_ns for scan, _ in scans if len(scan.slot)), 0)
    if len(kept) < 20:
        return None
    time = np.array([(time_ns - first) * 1e-9 for time_ns, _ in kept])
    speed = np.array([pose.ve * np.cos(pose.heading) + pose.vn * np.sin(pose.heading) for _, pose in kept])
    yaw = np.array([pose.yaw_rate for _, pose in kept])
    return OwnMotion("odometry", 0, None, {}, time, speed, yaw, side_known=True, extra={})


def _scatter(sensor: BoundSensor, table: ObjectTable, held: Occupancy) -> Iterator[LogFinding]:
    """Yield noise that is far larger or smaller than what values scatter by."""
    noise = sensor.settings.noise
    turn = np.pi / 180
    stated = {"x": noise.x, "y": noise.y, "range": noise.range, "range_rate": noise.range_rate, "vx": noise.vx}
    stated["azimuth"] = None if noise.azimuth_deg is None else noise.azimuth_deg * turn
    for name, value in stated.items():
        if value is None or name not in table.columns:
            continue
        scatter = white_noise(table.values(name), held)
        too_large = value > SCATTER * max(scatter, STEADIEST)
        if np.isfinite(scatter) and (too_large or scatter > HIDDEN * max(value, STEADIEST)):
            shown = 1 / turn if name == "azimuth" else 1.0
            key = "azimuth_deg" if name == "azimuth" else name
            yield LogFinding(
                ("sensors", sensor.name, "noise", key),
                f"found {value * shown:.3g}, but it scatters by {scatter * shown:.2g} from scan to scan; "
                f"{'lower' if too_large else 'raise'} it",
            )


def _rate(sensor: BoundSensor, table: ObjectTable) -> Iterator[LogFinding]:
    """Yield a speed that is not the rate of the distance."""
    key = next((key for key in ("range_rate", "vx") if key in table.columns), None)
    if key is None or sensor.settings.rates != "of_position":
        return
    rate = table.values(key)
    # by slots alone: with a wrong speed no object seems to go on
    loose = occupancy(table, "far", (), None, all_held=True)
    slope = derivative_slope(table.values("far"), rate, pairs(table, loose))
    where: Where = ("sensors", sensor.name, "signals", key)
    if slope.samples < 200:
        return
    if abs(slope.correlation) < 0.5:
        yield LogFinding(
            where, f"the distance does not change by it (correlation {slope.correlation:+.2f}); swapped signals?"
        )
    elif slope.value < 0:
        yield LogFinding(where, f"the distance changes by {slope.value:+.2f} of it: turn its sign round")
    elif not 0.75 < slope.value < 1.33:
        yield LogFinding(where, f"the distance changes by {slope.value:+.2f} of it: wrong unit, or swapped signals")


_STANDING: Final = 0.15
"""Least share of all objects that stand, where most of what nears should."""


def _number(objects: Indices) -> int:
    """Return how many objects some rows are of, by their numbers; −1 is of none."""
    return len(np.unique(objects[objects >= 0]))


def _approach(
    sensor: BoundSensor, table: ObjectTable, held: Occupancy, own: OwnMotion, key: str
) -> Iterator[LogFinding]:
    """Yield own speed that no standing object agrees with."""
    rate = next((table.values(name) for name in ("range_rate", "vx") if name in table.columns), None)
    if rate is None:
        return
    speed = own.speed_at(table.time)
    fast = speed > SLOWEST
    if np.count_nonzero(fast) < 500:
        return
    ratio = (-rate / np.maximum(speed, 1.0))[fast]
    counts, edges = np.histogram(ratio, np.arange(0.1, 3.0, 0.02))
    # the mode of what comes nearer, oncoming traffic apart
    best = int(counts.argmax())
    mode = float(edges[best] + 0.01)
    near = int(np.max(counts[(edges[:-1] > 0.94) & (edges[:-1] < 1.04)]))
    objects = held.chain[fast]
    alike = objects[(ratio >= edges[best]) & (ratio < edges[best + 1])]
    several = _number(alike) > _STANDING * _number(objects)  # one car that is followed for long has one ratio, too
    if several and counts[best] > 0.08 * len(ratio) and near < 0.25 * counts[best] and 0.15 < mode < 2.9:
        yield LogFinding(
            ("ego", "signals"),
            f"what nears the sensor '{sensor.name}' does so with {mode:.2f} of own speed; what stands has 1.00, "
            "and most of it should: check the unit of own speed",
        )
    slope = approach_slope(table.values("far"), pairs(table, held), table, own)
    if slope.samples > 500 and not 0.8 < -slope.value < 1.2 and slope.sigmas > PROVEN:
        yield LogFinding(
            ("sensors", sensor.name, "signals", key),
            f"what stands nears by {-slope.value:.2f} of the way driven: its unit?",
        )


def _turns(sensor: BoundSensor, table: ObjectTable, held: Occupancy, own: OwnMotion) -> Iterator[LogFinding]:
    """Yield a side or a mounting that contradicts own turns."""
    rate = next((table.values(name) for name in ("range_rate", "vx") if name in table.columns), None)
    if rate is None:
        return
    mount = sensor.settings.mount
    turn = np.radians(mount.yaw_deg)
    x, y = table.values("x"), table.values("y")
    x, y = x * np.cos(turn) - y * np.sin(turn) + mount.x, x * np.sin(turn) + y * np.cos(turn) + mount.y
    of = pairs(table, held)
    stands = standing_rows(rate, table, held, own)
    of = of.rows(stands[of.first] & stands[of.last])
    if len(of) < 100:
        return
    if _goes_along(x, of, table, held, own):
        yield LogFinding(
            ("sensors", sensor.name, "mount", "yaw_deg"),
            "what stands goes ahead with the vehicle, not back: the sensor looks the other way; add 180 to yaw_deg",
        )
        return
    ahead = 0.5 * (x[of.first] + x[of.last])
    slope: Slope = turning_slope(y, np.zeros(len(of)), ahead, of, table, own) if len(of) else NO_SLOPE
    key = "azimuth" if sensor.settings.signals.polar else "y"
    where: Where = ("sensors", sensor.name, "signals", key)
    if slope.sigmas > PROVEN and slope.value < -0.2:
        yield LogFinding(
            where,
            f"what stands moves to the wrong side as the vehicle turns ({slope.sigmas:.0f} σ): turn its sign round, or "
            "that of the yaw rate in ego",
        )
        return
    off = abs(slope.value - 1.0) / max(slope.deviation, 1e-12)
    # a yaw rate in a unit far too large shows next to nothing of itself
    if not 0.5 < slope.value < 1.7 and (off > _OBVIOUS if slope.sigmas <= PROVEN else off > PROVEN):
        yield LogFinding(
            where, f"what stands moves by {slope.value:.2f} of own turns: its unit, or that of the yaw rate"
        )
        return
    yield from _from_beside(sensor, x, y, of.first, of.last, table, own)


def _goes_along(x: Floats, of: Pairs, table: ObjectTable, held: Occupancy, own: OwnMotion) -> bool:
    """Return whether much of what nears as fast as the vehicle drives does so from where the vehicle leaves."""
    gone = own.way_at(table.time[of.last]) - own.way_at(table.time[of.first])
    nears = gone > 2.0
    if np.count_nonzero(nears) < 200:
        return False
    along = (x[of.last] - x[of.first])[nears] / gone[nears]
    several = _number(held.chain[of.first[nears]]) > _STANDING * _number(held.chain)
    return bool(several and np.median(along) > 0.5)


def _from_beside(
    sensor: BoundSensor, x: Floats, y: Floats, first: Indices, last: Indices, table: ObjectTable, own: OwnMotion
) -> Iterator[LogFinding]:
    """Yield a mounting by which what stands seems to come from beside."""
    rows, ends = first, last
    turned = own.heading_at(table.time[ends]) - own.heading_at(table.time[rows])
    gone = own.way_at(table.time[ends]) - own.way_at(table.time[rows])
    aside = y[ends] - y[rows] + turned * 0.5 * (x[rows] + x[ends])
    back = x[rows] - x[ends] + turned * 0.5 * (y[rows] + y[ends])
    good = (gone > 2.0) & np.isfinite(aside + back)
    if np.count_nonzero(good) < 200:
        return
    angle = np.degrees(np.arctan2(aside[good], back[good]))
    off = float(np.median(angle))
    if abs(off) > YAW_OFF_DEG and 1.25 * float(np.std(angle)) / np.sqrt(len(angle) / 10) < abs(off) / PROVEN:
        yield LogFinding(
            ("sensors", sensor.name, "mount", "yaw_deg"),
            f"what stands drifts {off:+.1f}° across as the vehicle passes: add {off:.1f} to yaw_deg",
        )
