"""`candaemon check`: shows what a configuration does, without opening a bus."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

from candaemon.binding.bind import bind
from candaemon.binding.bind_signal import DIMENSIONS, SI_NAMES
from candaemon.binding.bound import Binding, BoundEgo, BoundOutput, BoundSensor
from candaemon.cli.arguments import CONFIG, LOG_FORMATS, input_path, logs_name
from candaemon.cli.console import Sheet, log_progress, print_sheets
from candaemon.config.base import Condition
from candaemon.config.ego import InsSettings, InsSignals, OdometrySettings
from candaemon.config.estimators import (
    CsEstimatorSettings,
    EstimatorSettings,
    FederatedEstimatorSettings,
    ImmEstimatorSettings,
    InformationEstimatorSettings,
    MlkfEstimatorSettings,
    ModelSettings,
    SwitchingEstimatorSettings,
)
from candaemon.config.gnss import DriftFilterSettings, GnssSettings, ImmFilterSettings, SwitchingFilterSettings
from candaemon.config.load import load_config
from candaemon.config.protection import InputProtectionSettings, ProtectionSettings
from candaemon.config.sensors import (
    CounterScan,
    HeaderScan,
    LookSettings,
    ObjectFormat,
    ScanSettings,
    TimeoutScan,
    TriggerScan,
)
from candaemon.config.shipped import find_config
from candaemon.config.tracker import TrackerSettings
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.dbc.types import MessageSpec
from candaemon.frames.frame import EXTENDED
from candaemon.objects.message_layout import MessageLayout
from candaemon.objects.signals import SignalBinding
from candaemon.wizard.draft import guessed_lines

if TYPE_CHECKING:
    from candaemon.playback.replay import Replayed
    from candaemon.wizard.findings import LogFinding

_STAMPS = {"age": "the time since the measurement", "clock": "the sensor's own clock"}


_COMMON = frozenset({"socketcan", "udp_multicast", "virtual"})
"""Interfaces that every python-can has."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", type=input_path, metavar="CONFIG", help=CONFIG)
    parser.add_argument(
        "--log",
        dest="against",
        type=input_path,
        action="append",
        default=[],
        metavar="LOG",
        help="hold the configuration against the first seconds of a log: one line a contradiction, with the cure; "
        "repeatable: several are one drive; or the folder of a recording",
    )
    parser.add_argument(
        "log",
        type=input_path,
        nargs="*",
        metavar="LOG",
        help=f"what came of ego motion in it: {LOG_FORMATS}; several are one drive",
    )


def execute(arguments: argparse.Namespace) -> None:
    """Load a configuration, open no bus, and print what it does, and what a log holds of its ego motion."""
    binding = bind(load_config(find_config(arguments.config)))
    sheets = list(check_report(binding))
    if arguments.log:
        from candaemon.playback.replay import ReplayRequest, replay  # noqa: PLC0415 - only a log needs the pipeline
        from candaemon.playback.summary import doubts, summarise  # noqa: PLC0415 - as above

        with log_progress(logs_name(arguments.log)) as progress:
            replayed = replay(binding, ReplayRequest(arguments.log[0], further=tuple(arguments.log[1:])), progress)
        found = (*binding.warnings, *_unknown_interfaces(binding), *doubts(summarise(replayed)))
        sheets[-1:] = [_buses_in_log(replayed), *_ego_in_log(replayed), _warnings(found)]
    if arguments.against:
        from candaemon.playback.recording_files import unfolded  # noqa: PLC0415 - as above
        from candaemon.wizard.findings import findings  # noqa: PLC0415 - as above

        sheets.append(_contradictions(binding, findings(binding, unfolded(arguments.against))))
    guesses = tuple((f"line {line}", text) for line, text in guessed_lines(binding.loaded.path))
    if guesses:
        sheets.append(Sheet("guesses of candaemon init, to confirm or to mend", guesses))
    print_sheets(sheets)


def _contradictions(binding: Binding, found: Sequence[LogFinding]) -> Sheet:
    """Return what a log says against a configuration."""
    loaded = binding.loaded
    rows = tuple(
        (f"{loaded.path.name}:{loaded.line_of(each.where)}", f"{'.'.join(map(str, each.where))}: {each.text}")
        for each in found
    )
    return Sheet("what the log contradicts", rows or (("the log contradicts nothing",),))


def check_report(binding: Binding) -> Iterator[Sheet]:
    """Yield everything that a configuration binds, and last the warnings."""
    config = binding.settings
    yield Sheet("configuration", (("file", str(binding.loaded.path)), ("name", config.name or "-")))
    yield _buses(binding)
    yield from _ego(binding)
    for sensor in binding.sensors:
        yield from _sensor(binding, sensor)
    yield _tracker("tracker", config.tracker)
    for name, group in config.groups.items():
        tracker = group.fused_tracker if group.fusion == "trilateration" else group.tracker
        mode = group.fusion if group.align == "prediction" else f"{group.fusion}, aligned by interpolation"
        yield _tracker(f"tracker of group {name} ({', '.join(group.sensors)}), {mode}", tracker)
    if binding.output is None:
        yield Sheet("output", (("sent", "nothing: there is no `output`"),))
    else:
        yield from _output(binding, binding.output)
    yield _warnings((*binding.warnings, *_unknown_interfaces(binding)))


def _unknown_interfaces(binding: Binding) -> Iterator[str]:
    """Yield a sentence on each bus that `run` would refuse."""
    others = [bus for bus in binding.buses if bus.settings.interface not in _COMMON]
    if others:
        from candaemon.can_io.open_port import is_known  # noqa: PLC0415 - python-can, only for what it alone knows
        from candaemon.daemon.service_config import unknown_interface  # noqa: PLC0415 - as above

        yield from (str(unknown_interface(binding, bus)) for bus in others if not is_known(bus.settings.interface))


def _buses(binding: Binding) -> Sheet:
    rows = (
        (
            bus.name,
            bus.settings.interface,
            bus.settings.channel,
            ", ".join(bus.settings.names_in_logs),
            f"{bus.settings.bitrate / 1000:g}" + (f"/{bus.settings.data_bitrate / 1000:g}" if bus.settings.fd else ""),
            str(len(bus.can_ids)),
            f"{bus.load:.1%}",
            f"{bus.output_load:.1%}",
        )
        for bus in binding.buses
    )
    header = ("", "interface", "channel", "in logs", "kbit/s", "ids read", "load in", "output adds")
    return Sheet("buses", tuple(rows), header)


def _ego(binding: Binding) -> Iterator[Sheet]:
    ego = binding.ego
    if ego is None:
        yield Sheet("own motion", (("kind", "static: the vehicle stands for good"),))
        return
    settings = ego.settings
    rows = [
        ("kind", settings.kind),
        ("bus", settings.bus),
        ("DBC", settings.dbc),
        ("age limit", f"{settings.age_limit:g} s, then dead reckoning for {settings.dead_reckoning:g} s"),
    ]
    if isinstance(settings, InsSettings):
        rows.append(("lever arm", f"x {settings.lever_arm.x:g} m, y {settings.lever_arm.y:g} m"))
        rows += [("place on earth", "not told")] if settings.gnss is None else _georeference(settings.gnss)
    rows += [(f"protection of {name}", _protection(each)) for name, each in settings.protection.items()]
    rows.append(("yaw rate", _yaw_rate(settings)))
    if isinstance(settings, OdometrySettings):
        reverse = settings.signals.reverse
        rows.append(("backwards", "where the speed is below 0" if reverse is None else _conditions([reverse])))
    yield Sheet("own motion", tuple(rows))
    yield _signals("own motion's signals", _ego_signals(ego))


def _yaw_rate(settings: InsSettings | OdometrySettings) -> str:
    """Say where the yaw rate comes from, and from what it is derived while that is silent."""
    signals = settings.signals
    sources = ["as sent"] if signals.yaw_rate is not None else []
    if signals.curvature is not None:
        sources.append("curvature × speed")
    if isinstance(signals, InsSignals):
        sources.append("successive headings")
    elif signals.left_wheels:
        sources.append("the wheels' difference")
    return ", else ".join(sources)


def _buses_in_log(replayed: Replayed) -> Sheet:
    """Return what became of the frames of each bus in a log."""
    pipeline = replayed.pipeline
    rows = (
        (
            bus.name,
            *map(str, (each.frames, each.used, each.spare, each.spare_short, each.unknown, each.short, each.fd_unset)),
        )
        for bus, each in zip(pipeline.binding.buses, pipeline.counts.buses, strict=True)
    )
    header = (
        "",
        "frames",
        "used",
        "not asked for",
        "of them short",
        "in no DBC",
        "too short for own motion",
        "FD without `fd`",
    )
    return Sheet("buses in the log", tuple(rows), header)


def _ego_in_log(replayed: Replayed) -> Iterator[Sheet]:
    """Yield which signals of ego motion came in a log, and what was derived for want of one."""
    ego, seconds = replayed.pipeline.binding.ego, (replayed.last_ns - replayed.first_ns) * 1e-9
    if ego is None:
        return
    names = (f"{message.name}.{each.signal.name}" for message, each in _ego_signals(ego))
    rows = (
        (quantity, name, f"{count}" if count else "never", f"{count / seconds:.4g}" if seconds > 0.0 else "-")
        for (quantity, count), name in zip(replayed.pipeline.ego_signals.items(), names, strict=True)
    )
    yield Sheet("own motion in the log", tuple(rows), ("", "signal", "came", "Hz"))
    counts = replayed.pipeline.ego.counts
    derived = ((name.replace("_", " "), f"{count}") for name, count in asdict(counts).items() if count)
    yield Sheet("its samples", tuple(derived) or (("samples", "none"),))


def _georeference(gnss: GnssSettings) -> Iterator[tuple[str, str]]:
    """Yield rows on the georeference of the local frame."""
    match gnss.filter:
        case DriftFilterSettings():
            yield "place on earth", f"by fixes, the level frame drifting {gnss.filter.walk:g} m per √s"
        case SwitchingFilterSettings():
            yield "place on earth", "by fixes, smoothed by CV or CS, switched"
        case ImmFilterSettings():
            yield "place on earth", "by fixes, smoothed by an IMM of CV, CA"
    gate = f"refused beyond a NIS of {gnss.gate:g}, believed again after {gnss.reacquire:g} s"
    yield "fixes", f"{gnss.noise:g} m; {gate}; good for {gnss.hold:g} s"


def _ego_signals(ego: BoundEgo) -> Iterator[tuple[MessageSpec, SignalBinding]]:
    for each in ego.messages.values():
        for binding in each.bindings:
            yield each.message, binding


def _sensor(binding: Binding, sensor: BoundSensor) -> Iterator[Sheet]:
    settings, mount = sensor.settings, sensor.settings.mount
    rows = [
        ("bus", settings.bus),
        ("DBC", settings.dbc + (f", identifiers {settings.id_offset:+#x}" if settings.id_offset else "")),
        ("mount", f"x {mount.x:g} m, y {mount.y:g} m, yaw {mount.yaw_deg:g}°"),
        ("scans", f"{1 / settings.cycle_time:.4g} Hz, closed {_closing(settings.scan)}"),
        ("time-out", f"{settings.timeout:g} s after a scan's first frame"),
        *_format(settings.objects, sensor.reader.layouts),
        *_protections(settings.objects, settings.protection),
        ("failed frames", f"over {settings.protection.max_failed:.0%} of a scan discard it"),
        ("plausible", _plausible(sensor)),
        ("tracked by", _group_of(binding, sensor.name)),
    ]
    if settings.time_stamp is not None:
        rows.insert(4, ("measured", f"by {settings.time_stamp.signal}, {_STAMPS[settings.time_stamp.kind]}"))
    if settings.looks is not None:
        rows.insert(4, ("looks", _looks(settings.looks)))
    yield Sheet(f"{settings.kind} {sensor.name}", tuple(rows))
    bound = [
        (part.shortest, each)
        for part in sensor.reader.layouts
        for each in sensor.reader.bindings
        if each.signal in part.shortest.signals
    ]
    yield _signals(f"{sensor.name}'s signals", bound)


def _format(form: ObjectFormat, parts: Iterable[MessageLayout]) -> Iterator[tuple[str, str]]:
    """Yield rows on the layout of objects in frames."""
    for part in parts:
        first, last = part.messages[0], part.messages[-1]
        names = " … ".join(dict.fromkeys((first.name, last.name)))
        ids = (
            _identifier(first.can_id) if first is last else f"{_identifier(first.can_id)} … {_identifier(last.can_id)}"
        )
        which = "" if part.selector is None else f", where {part.selector[0].name} is {part.selector[1]}"
        yield "messages", f"{names}, {ids}, {part.length} bytes{which}" + (", optional" if part.optional else "")
    told = ", told apart by an id in the payload" if form.multiplexed else ""
    if any(entry.id_signal is False for entry in form.messages):
        told = ", in the order of their frames"
    yield "slots", f"{form.slots}" + told
    if len(form.points) > 1:
        yield "points", f"{len(form.points)} in each message"
    if form.pages is not None:
        yield "pages", f"{form.pages.count}, by {form.pages.signal}"
    yield "identity", "none" if form.identity is False else form.identity or "the slot"
    yield "valid", _conditions(form.valid) or "always"
    if form.new:
        yield "new", _conditions(form.new)
    if form.pair:
        yield "pairs", " = ".join(form.pair)


def _output(binding: Binding, output: BoundOutput) -> Iterator[Sheet]:
    settings, bus = output.settings, binding.buses[output.bus]
    parts = output.writer.layouts
    frames = output.writer.places * len(parts) + (output.status is not None)
    rows = [
        ("bus", settings.bus),
        ("DBC", settings.dbc),
        *_format(settings.objects, parts),
        ("status", "-" if output.status is None else output.status.message.name),
        ("frames a cycle", f"{frames} at most; sent: {settings.send}"),
        ("sent", _every(binding.settings.output_cycle_time)),
        ("load added", f"{bus.output_load:.1%} with every slot occupied"),
        *_protections(settings.objects, settings.protection),
    ]
    yield Sheet("output", tuple(rows))


def _every(cycle_time: float) -> str:
    """Return when obstacles are sent, as text."""
    return f"every {cycle_time:g} s, with the nearest scan" if cycle_time else "after each scan"


def _estimator(settings: EstimatorSettings) -> str:
    """Describe a filter in a line."""
    match settings:
        case VehicleEstimatorSettings():
            return "IMM of a vehicle's motion: driving, standing, sliding reflection, free"
        case ImmEstimatorSettings():
            how = f"IMM of {_named(settings.models)}"
        case InformationEstimatorSettings():
            how = f"IMM of information filters on {_named(settings.models)}"
        case SwitchingEstimatorSettings():
            how = "Kalman filter that switches between CV and CS"
        case FederatedEstimatorSettings():
            how = f"federated filter, {_named([settings.model])} for each sensor"
        case MlkfEstimatorSettings():
            how = "modified linear Kalman filter along the line of sight, Kalman filter across it"
        case CsEstimatorSettings():
            how = f"adaptive Kalman filter on the current statistical model, α {settings.alpha:g} 1/s"
        case _:
            how = f"Kalman filter, {settings.kind.upper()}"
    noise = settings.measurement_noise.kind
    return how if noise == "fixed" else f"{how}; measurement noise from innovations ({noise})"


def _named(models: Sequence[ModelSettings]) -> str:
    return ", ".join(model.kind.upper() for model in models)


def _tracker(title: str, settings: TrackerSettings) -> Sheet:
    merge = settings.reflections
    rows = (
        ("estimator", _estimator(settings.estimator)),
        ("association", settings.association.method),
        ("reflections", f"joined within {merge.along:g} m × {merge.across:g} m" if merge.merge else "kept apart"),
        *_lifecycle(settings),
    )
    return Sheet(title, rows)


def _lifecycle(settings: TrackerSettings) -> Iterator[tuple[str, str]]:
    """Yield when obstacles are confirmed, and for how long one lives undetected."""
    life = settings.lifecycle
    if settings.estimator.kind == "vehicle" and life.by == "existence":
        yield "confirmed", f"by existence above {life.sure:g}, {life.earliest} detections in succession at least"
        yield "coasts", f"{life.coast:g} s in sight, {life.hidden:g} s hidden, at an existence above {life.doubtful:g}"
        return
    yield "confirmed", f"by {life.confirm} of {life.window} scans"
    yield "coasts", f"{life.coast:g} s"


def _signals(title: str, bound: Iterable[tuple[MessageSpec, SignalBinding]]) -> Sheet:
    """Return the mapping of signals to quantities, with the value of one quantisation step."""
    rows = tuple(
        (
            each.quantity,
            f"{message.name}.{each.signal.name}",
            each.signal.unit or "-",
            f"{each.gain * each.signal.scale:.6g}",
            _unit(each.quantity),
            "-" if message.cycle_time is None else f"{1 / message.cycle_time:.4g}",
        )
        for message, each in bound
    )
    return Sheet(title, rows, ("", "signal", "DBC unit", "one step is", "SI unit", "Hz by DBC"))


def _unit(quantity: str) -> str:
    dimension = DIMENSIONS.get(quantity, "number")
    return SI_NAMES[dimension].rpartition("or ")[2]


def _looks(looks: LookSettings) -> str:
    """Return the looks that a sensor takes in turn as text."""
    views = (
        f"{look}: {view.min_range:g} to {view.range:g} m, {view.yaw_deg:+g} ± {view.azimuth_deg:g}°"
        for look, view in looks.fields_of_view.items()
    )
    return f"by {looks.signal}; {'; '.join(views)}"


def _closing(scan: ScanSettings) -> str:
    match scan:
        case CounterScan():
            return f"by counter {scan.signal}"
        case TriggerScan():
            return f"by message {scan.message}"
        case HeaderScan():
            return f"by the count {' + '.join(scan.count)} in header {', '.join(scan.message)}"
        case TimeoutScan():
            return "by time-out"


def _conditions(conditions: Iterable[Condition]) -> str:
    return " and ".join(_condition(each) for each in conditions)


def _condition(test: Condition) -> str:
    """Return a condition as text."""
    bounds = (("≥", test.min), ("≤", test.max), ("<", test.below), (">", test.above))
    texts = [f"{test.signal} {sign} {bound:g}" for sign, bound in bounds if bound is not None]
    if test.values is not None:
        texts.insert(0, f"{test.signal} in {', '.join(f'{value:g}' for value in test.values)}")
    return " and ".join(texts)


def _protections(form: ObjectFormat, settings: ProtectionSettings) -> Iterator[tuple[str, str]]:
    """Yield rows on how the frames of objects are protected."""
    yield "protection", _protection(settings)
    for entry in form.messages:
        if entry.protection is not None:
            yield f"protection of {entry.message}", _protection(entry.protection)


def _protection(settings: ProtectionSettings) -> str:
    """Return a protection as text."""
    texts = [] if settings.counter is None else [f"counter {settings.counter}"]
    if settings.checksum is not None and settings.e2e is None:
        texts.append(f"checksum {settings.checksum} ({settings.kind})")
    if settings.e2e is not None:
        texts.append(f"AUTOSAR E2E profile {settings.e2e.profile}")
    if isinstance(settings, InputProtectionSettings):
        bounds = (
            ("steps up to", settings.greatest_step, ""),
            ("time-out", settings.timeout, " s"),
            ("rate up to", settings.max_rate, " × nominal"),
        )
        texts += [f"{name} {bound:g}{unit}" for name, bound, unit in bounds if bound is not None]
    return ", ".join(texts) or "none"


def _plausible(sensor: BoundSensor) -> str:
    """Return the plausibility limits of a sensor's objects as text."""
    settings = sensor.settings.plausibility
    within = "within the DBC's ranges" if settings.ranges else "of any value"
    if settings.max_speed is None:
        return within
    if not sensor.reader.reports_new:
        return f"{within}; jumps are not watched, for objects do not say if they are new"
    return f"{within}, up to {settings.max_speed:g} m/s from scan to scan"


def _group_of(binding: Binding, sensor: str) -> str:
    groups = binding.settings.groups
    return next((f"group {name}" for name, group in groups.items() if sensor in group.sensors), "tracker")


def _identifier(can_id: int) -> str:
    return f"0x{can_id & ~EXTENDED:X}" + (" (29 bits)" if can_id & EXTENDED else "")


def _warnings(warnings: tuple[str, ...]) -> Sheet:
    rows = tuple((text,) for text in warnings) or (("nothing looks wrong",),)
    title = "1 warning" if len(warnings) == 1 else f"{len(warnings)} warnings" if warnings else "warnings"
    return Sheet(title, rows)
