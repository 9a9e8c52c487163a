"""Which signals of a car's bus, or of an INS, tell how it moves: by their names, and by how well they agree."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.binding.bind_signal import UNITS, normalised_unit
from candaemon.config.base import UNIT_FACTORS
from candaemon.dbc.batch_codec import BatchDecoder
from candaemon.dbc.types import MessageSpec, SignalSpec
from candaemon.wizard.draft import Choice
from candaemon.wizard.traffic import LogTraffic
from candaemon.wizard.vocabulary import words

TRACK_WIDTH: Final = 1.6
"""m between the wheels, where nothing says more."""
SLOWEST: Final = 3.0
"""m/s of own speed, below which standing objects tell little."""
FALSE_RANGE: Final = 0.002
"""Share of values outside the DBC's range, from which on it is the range that is wrong."""
_STEP: Final = 0.02
"""s between the instants at which signals are compared."""

_NO_SPEED: Final = frozenset(
    (
        *(
            "set",
            "target",
            "cruise",
            "limit",
            "rel",
            "relative",
            "engine",
            "motor",
            "rpm",
            "fan",
            "wiper",
            "wind",
            "lead",
        ),
        *(
            "steer",
            "steering",
            "sign",
            "max",
            "min",
            "yaw",
            "rot",
            "rotation",
            "north",
            "east",
            "down",
            "rate",
            "fault",
        ),
        *(
            "valid",
            "quality",
            "status",
            "lat",
            "lateral",
            "vertical",
            "error",
            "turbine",
            "gear",
            "output",
            "input",
            "obj",
        ),
        *(
            "object",
            "track",
            "trk",
            "desired",
            "requested",
            "request",
            "sigma",
            "std",
            "ui",
            "shaft",
            "trans",
            "accuracy",
        ),
        *("transmission", "slip", "counter", "cnt", "checksum", "up", "wheels", "lockout", "oncoming"),
    )
)
_FEWEST_SPEEDS: Final = 200
"""Speeds from which on their noise is known."""
_LEAST_SPEED_NOISE: Final = 0.03
"""m/s, of wheels on a road, however little they scatter from frame to frame."""
_MOST_SPEED_NOISE: Final = 1.0
"""m/s; what scatters by more is no noise."""
_LEFT: Final = frozenset(("fl", "lf", "rl", "lr", "left", "lft", "hl", "vl", "lh"))
_RIGHT: Final = frozenset(("fr", "rf", "rr", "right", "rgt", "rght", "hr", "vr", "rh"))


@dataclass(frozen=True, slots=True)
class Heard:
    """A signal in a log.

    Attributes:
        dbc: its file.
        channel: index of the log's.
        message, spec: what the DBC says.
        time: (n,) s.
        values: (n,) in the DBC's unit.
    """

    dbc: Path
    channel: int
    message: MessageSpec
    spec: SignalSpec
    time: Floats
    values: Floats

    @property
    def name(self) -> str:
        """Its name as a configuration has it."""
        return f"{self.message.name}.{self.spec.name}"

    @property
    def dimension(self) -> str:
        """What its unit measures; empty where the DBC names none that is known."""
        return _dimension_of(self.spec)

    @property
    def factor(self) -> float:
        """SI value of its unit."""
        known = UNITS.get(normalised_unit(self.spec.unit)) if self.spec.unit.strip() else None
        return 1.0 if known is None else known[1]

    def at(self, time: Floats) -> Floats:
        """Return its SI values at some times, interpolated."""
        result: Floats = np.interp(time, self.time, self.values * self.factor)
        return result


@dataclass(frozen=True, slots=True)
class OwnMotion:
    """How the vehicle moved in a log, and which signals say so.

    Attributes:
        kind: `ins`, `odometry` or `static`.
        channel: index of the log's; −1 where static.
        dbc: the signals' file; None where static.
        signals: YAML values by the keys of `ego.signals`.
        time: (n,) s.
        speed: (n,) m/s.
        yaw_rate: (n,) rad/s, positive to the left.
        side_known: whether the yaw rate's sign is known.
        extra: further keys of `ego`.
    """

    kind: str
    channel: int
    dbc: Path | None
    signals: Mapping[str, Choice]
    time: Floats
    speed: Floats
    yaw_rate: Floats
    side_known: bool
    extra: Mapping[str, Choice]

    def speed_at(self, time: Floats) -> Floats:
        """Return own speed at some times, m/s."""
        result: Floats = np.interp(time, self.time, self.speed)
        return result

    def yaw_rate_at(self, time: Floats) -> Floats:
        """Return the yaw rate at some times, rad/s to the left."""
        result: Floats = np.interp(time, self.time, self.yaw_rate)
        return result

    def way_at(self, time: Floats) -> Floats:
        """Return the way gone until some times, m."""
        steps = np.diff(self.time, prepend=self.time[0])
        result: Floats = np.interp(time, self.time, np.cumsum(self.speed * steps))
        return result

    def heading_at(self, time: Floats) -> Floats:
        """Return the angle turned to the left until some times, rad."""
        steps = np.diff(self.time, prepend=self.time[0])
        result: Floats = np.interp(time, self.time, np.cumsum(self.yaw_rate * steps))
        return result


def heard_signals(messages: Iterable[tuple[Path, MessageSpec]], traffic: LogTraffic) -> list[Heard]:
    """Return the signals of some messages that came in a log with more than one value."""
    found = []
    for dbc, message in messages:
        names = [signal.name for signal in message.signals if _may_be_motion(signal)]
        channel = traffic.channel_of((message,)) if names else None
        stream = None if channel is None else traffic.stream(channel, message)
        if channel is None or stream is None or len(stream.time) < 10:
            continue
        decoded = BatchDecoder(message, names).decode(stream.payload)
        for name, values in zip(names, decoded, strict=True):
            known = np.isfinite(values)
            if np.count_nonzero(known) >= 10:
                spec = message.signal(name)
                found.append(Heard(dbc, channel, message, spec, stream.time[known], values[known]))
    return found


def named_signals(messages: Iterable[tuple[Path, MessageSpec]]) -> list[Heard]:
    """Return the signals of some messages that are called as own motion is, as if they had stood still in a log."""
    time: Floats = np.arange(20, dtype=np.float64) * 0.05
    return [
        Heard(dbc, -2, message, signal, time, np.multiply(time, 1e-3))
        for dbc, message in messages
        for signal in message.signals
        if _may_be_motion(signal)
    ]


def _may_be_motion(signal: SignalSpec) -> bool:
    kinds = set(_tokens(signal.name))
    turns = "z" in kinds and _dimension_of(signal) == "rate"
    return signal.length >= 8 and (bool(kinds & (_MOTION | _LEFT | _RIGHT)) or turns)


def _dimension_of(signal: SignalSpec) -> str:
    """Return what a signal's unit measures; empty where the DBC names none that is known."""
    known = UNITS.get(normalised_unit(signal.unit)) if signal.unit.strip() else None
    return "" if known is None else known[0]


_MOTION: Final = frozenset(
    (
        *("speed", "spd", "velocity", "vel", "vehspd", "yaw", "heading", "hdg", "curvature", "curv", "latitude"),
        *("longitude", "north", "east", "wheel", "whl", "ws", "wss", "course", "vn", "ve", "lat", "lon"),
    )
)


def _tokens(name: str) -> tuple[str, ...]:
    """Return the words of a name, run-together ones of motion taken apart."""
    text = name
    for joined, apart in (
        ("YAWRATE", "YAW_RATE"), ("WHEELSPEED", "WHEEL_SPEED"), ("WHLSPD", "WHL_SPD"), ("VEHSPD", "VEH_SPD"),
        ("yawrate", "yaw_rate"), ("wheelspeed", "wheel_speed"), ("PosLat", "Pos_latitude"), ("PosLon", "Pos_longitude"),
    ):  # fmt: skip
        text = text.replace(joined, apart)
    return words(text)


def find_own_motion(heard: Sequence[Heard], standing: tuple[Floats, Floats] | None) -> OwnMotion | None:
    """Find out which signals tell the vehicle's motion.

    Args:
        heard: signals of a log.
        standing: times and range rates (m/s, positive away) of a radar's objects, most of which may stand; None where
            they are not known.
    """
    own = _ins(heard) or _odometry(heard, standing)
    return None if own is None else _without_false_ranges(own, heard)


_BACKWARDS: Final = frozenset(("r", "rev", "reverse", "backward", "backwards"))
_GEARS: Final = frozenset(("gear", "prnd", "prndl", "shift", "shifter", "selector", "direction", "transmission"))


_LONG_GAP: Final = 1.0
"""s between two frames that tell reverse, from which on the default of `reverse_age_limit` is too short."""
_MOST_AGE: Final = 86_400.0
"""s: the largest `reverse_age_limit`."""


def with_gear(
    own: OwnMotion | None, messages: Iterable[tuple[Path, MessageSpec]], traffic: LogTraffic | None
) -> OwnMotion | None:
    """Return own motion with what tells that the vehicle drives backwards, by a value table of the DBC.

    Args:
        own: from wheels or a speedometer, which do not tell; any other is returned as it is.
        messages: of no radar, with their files.
        traffic: the log; a gear that does not come in it tells nothing.
    """
    if own is None or own.kind != "odometry":
        return own
    told = []
    for dbc, message in messages:
        if dbc != own.dbc or (traffic is not None and traffic.channel_of((message,)) != own.channel):
            continue
        for signal in message.signals:
            raws = [raw for raw, text in (signal.choices or {}).items() if text.strip().lower() in _BACKWARDS]
            if len(raws) == 1 and set(_tokens(signal.name)) & _GEARS:
                value = raws[0] * signal.scale + signal.offset
                told.append(f"{{signal: {message.name}.{signal.name}, in: [{value:.15g}]}}")
    if not told:
        return own
    why = "by the DBC's table of values; wheels do not tell which way they turn"
    choice = Choice(told[0], why, guess=len(told) > 1, ask="which tells reverse", options=tuple(told))
    return replace(own, signals={**own.signals, "reverse": choice})


def with_gear_age(
    own: OwnMotion | None, messages: Iterable[tuple[Path, MessageSpec]], traffic: LogTraffic
) -> OwnMotion | None:
    """Return own motion with how old what tells reverse may be, where a log shows that it comes seldom.

    Args:
        own: what was found; without `reverse` it is returned as it is.
        messages: of no radar, with their files.
        traffic: the log.
    """
    reverse = None if own is None else own.signals.get("reverse")
    if own is None or reverse is None:
        return own
    for dbc, message in messages:
        stream = traffic.stream(own.channel, message)
        if dbc != own.dbc or f"signal: {message.name}." not in reverse.value or stream is None or len(stream.time) < 2:
            continue
        gap = float(np.max(np.diff(stream.time)))
        if gap > _LONG_GAP:
            limit = min(math.ceil(round(30 * gap, 6)) / 10, _MOST_AGE)
            why = f"s; {message.name} came {gap:.2f} s after the one before at the longest, three times that"
            return replace(own, extra={**own.extra, "reverse_age_limit": Choice(f"{limit:.15g}", why)})
    return own


def outside_share(spec: SignalSpec, values: Floats) -> float:
    """Return the share of values that are outside the range that the DBC gives a signal."""
    low = -np.inf if spec.minimum is None else spec.minimum
    high = np.inf if spec.maximum is None else spec.maximum
    return float(np.mean((values < low - abs(spec.scale)) | (values > high + abs(spec.scale)))) if len(values) else 0.0


def _without_false_ranges(own: OwnMotion, heard: Sequence[Heard]) -> OwnMotion:
    """Switch the check of the DBC's ranges off where what came contradicts them."""
    used = [each for each in heard if any(each.name in choice.value for choice in own.signals.values())]
    worst = max(used, key=lambda each: outside_share(each.spec, each.values), default=None)
    if worst is None or outside_share(worst.spec, worst.values) < FALSE_RANGE:
        return own
    share, spec = outside_share(worst.spec, worst.values), worst.spec
    why = f"{share:.0%} of {worst.name} are outside the DBC's [{spec.minimum:g}|{spec.maximum:g}], which is wrong then"
    return replace(own, extra={**own.extra, "plausibility": Choice("{ranges: false}", why)})


def _first(heard: Sequence[Heard], *wanted: set[str], without: frozenset[str] | set[str] = frozenset()) -> Heard | None:
    """Return the first signal whose name has one of each set of words and none of others."""
    for each in heard:
        kinds = set(_tokens(each.spec.name))
        if all(kinds & some for some in wanted) and not kinds & without:
            return each
    return None


def _grid(signals: Sequence[Heard]) -> Floats:
    begin, end = max(s.time[0] for s in signals), min(s.time[-1] for s in signals)
    return np.arange(begin, max(end, begin + _STEP), _STEP)


_SPOILT: Final = {
    "sigma",
    "std",
    "accuracy",
    "err",
    "error",
    "valid",
    "status",
    "quality",
    "var",
    "offset",
    "bias",
    "raw",
    "dev",
}


def _ins(heard: Sequence[Heard]) -> OwnMotion | None:
    """Return the motion by an INS: velocity's components, or speed, and the heading."""
    north, east = _component(heard, {"north", "vn"}, "n"), _component(heard, {"east", "ve"}, "e")
    heading = _first(heard, {"heading", "hdg"}, without=_SPOILT | {"rate"})
    if north is None or east is None or heading is None or north.channel != heading.channel:
        return None
    same = [each for each in heard if each.channel == heading.channel and each.dbc == heading.dbc]
    time = _grid([north, east, heading])
    vn, ve = north.at(time), east.at(time)
    speed = np.hypot(vn, ve)
    turned = np.unwrap(np.interp(time, heading.time, np.unwrap(heading.values * heading.factor)))
    course = np.unwrap(np.arctan2(ve, vn))
    fast = speed > SLOWEST
    off = float(np.median(np.abs(_wrapped(turned - course)[fast]))) if fast.any() else float("nan")
    agrees = f"within {np.degrees(off):.1f}° of the course by the velocity" if fast.any() else "by name"
    signals = {
        "velocity_north": Choice(north.name, _unit_note(north, "by name")),
        "velocity_east": Choice(east.name, _unit_note(east, "by name")),
        "heading": Choice(heading.name, agrees, guess=not off < 0.35),
    }
    rate = -np.gradient(_smooth(turned, 25), time)  # headings turn clockwise
    fine = [each for each in same if each.spec.length >= _PLACE_BITS]
    for key, short in (("latitude", "lat"), ("longitude", "lon")):
        place = _first(same, {key}, without=_SPOILT) or _first(fine, {short}, without=_SPOILT)
        if place is not None:
            signals[key] = Choice(place.name, "by name")
    if ("latitude" in signals) != ("longitude" in signals):
        signals.pop("latitude", None)
        signals.pop("longitude", None)
    rates = [each for each in same if each.dimension == "rate"]
    yaw = _first(same, {"yaw"}, {"rate"}, without=_SPOILT) or _first(rates, {"z"}, without=_SPOILT)
    curvature = _first(same, {"curvature", "curv"}, without=_SPOILT)
    for key, each, factor in (("yaw_rate", yaw, np.ones(len(time))), ("curvature", curvature, speed)):
        if each is not None:
            signals[key] = _turning(each, each.at(time) * factor, rate)
    return OwnMotion("ins", heading.channel, heading.dbc, signals, time, speed, rate, side_known=True, extra={})


def _component(heard: Sequence[Heard], whole: set[str], letter: str) -> Heard | None:
    """Return a component of the velocity over ground, by a word for it, or by a letter beside a word for velocity."""
    without = _SPOILT | {"acc", "accel", "pos"}
    return _first(heard, whole, without=without) or _first(
        heard, {"v", "vel", "velocity", "speed", "spd"}, {letter}, without=without
    )


_PLACE_BITS: Final = 24
"""Of a latitude; what is called `lat` and has fewer is lateral."""


def _turning(signal: Heard, values: Floats, rate: Floats) -> Choice:
    """Return a signal with the sign, and the unit where the DBC is silent, that makes it agree with a yaw rate."""
    slope, correlation = _slope(rate, values)
    name, known = ("-" + signal.name if slope < 0 else signal.name), abs(correlation) > 0.6
    side = "to the right" if slope < 0 else "to the left"
    why = f"positive {side}: against the yaw rate otherwise known {slope:+.2f}, correlation {correlation:+.2f}"
    if not known:
        return Choice(signal.name, "positive to the left? the log hardly turns", guess=True, ask="sign")
    if not signal.dimension and 40 < abs(slope) < 75:
        return Choice(f"{{signal: {name}, unit: deg/s}}", f"{why}, 57.3 would be deg/s")
    if signal.dimension == "" and signal.spec.name.lower().find("curv") < 0:
        return Choice(f"{{signal: {name}, unit: rad/s}}", why)
    # noise in the reference makes the slope smaller, but not the ratio of the deviations
    return Choice(name, why, guess=not 0.5 < abs(slope / correlation) < 2.0)


def _slope(x: Floats, y: Floats) -> tuple[float, float]:
    """Return slope of y over x, and their correlation, both about their medians."""
    a, b = x - np.median(x), y - np.median(y)
    scale = float(a @ a)
    spread = scale * float(b @ b)
    if scale <= 0 or spread <= 0:
        return 1.0, 0.0
    return float(a @ b) / scale, float(a @ b) / spread**0.5


def _smooth(values: Floats, width: int) -> Floats:
    """Return the moving mean over so many values."""
    if len(values) <= width:
        return values
    padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    smoothed: Floats = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
    return smoothed


def _wrapped(angle: Floats) -> Floats:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _unit_note(signal: Heard, why: str) -> str:
    return why if signal.dimension else f"{why}; the DBC names no unit: SI"


_SPEED_UNITS: Final = ("m/s", "km/h", "mph")


def _odometry(heard: Sequence[Heard], standing: tuple[Floats, Floats] | None) -> OwnMotion | None:
    """Return the motion by the car's own signals: wheels or speed, and the yaw rate."""
    wheels = _wheels(heard)
    speeds = [
        each
        for each in heard
        if set(_tokens(each.spec.name)) & {"speed", "spd", "velocity", "vel", "vehspd"}
        and not set(_tokens(each.spec.name)) & (_NO_SPEED | _LEFT | _RIGHT)
        and each.dimension in {"", "speed"}
        and float(np.ptp(each.values)) > 0
        and float(np.median(np.diff(each.time))) < 0.3
    ]
    signals: dict[str, Choice] = {}
    side = None
    if wheels is not None:
        left, right = wheels
        unit, why, guess = _speed_unit([*left, *right], standing)
        time = _grid([*left, *right])
        scale = UNIT_FACTORS[unit] / left[0].factor if unit else 1.0
        vl = np.mean([each.at(time) for each in left], axis=0) * scale
        vr = np.mean([each.at(time) for each in right], axis=0) * scale
        speed, side = 0.5 * (vl + vr), (vr - vl) / TRACK_WIDTH
        for key, group in (("left_wheels", left), ("right_wheels", right)):
            signals[key] = Choice("[" + ", ".join(_speed_ref(each, unit) for each in group) + "]", why, guess=guess)
        read, channel, dbc = [*left, *right], left[0].channel, left[0].dbc
    elif speeds:
        judged = [(_standing_share(each, unit, standing), each, unit) for each in speeds for unit in _units_of(each)]
        share, best, unit = max(judged, key=lambda item: (item[0], len(item[1].time)))
        time = _grid([best])
        speed = best.at(time) * (UNIT_FACTORS[unit] / best.factor if unit else 1.0)
        proven = share > 0.1
        why = f"{share:.0%} of the radar's objects stand by it" if proven else "by name"
        choices = tuple(_speed_ref(each, each_unit) for _, each, each_unit in sorted(judged, key=lambda i: -i[0])[:5])
        signals["speed"] = Choice(
            _speed_ref(best, unit), why, guess=not proven and (len(judged) > 1), ask="which speed", options=choices
        )
        read, channel, dbc = [best], best.channel, best.dbc
        scale = UNIT_FACTORS[unit] / best.factor if unit else 1.0
    else:
        return None
    own = _with_yaw(heard, signals, channel, dbc, time, speed, side)
    return None if own is None else replace(own, extra={**own.extra, **_speed_noise(read, scale)})


def _speed_noise(read: Sequence[Heard], scale: float) -> dict[str, Choice]:
    """Return the noise of own speed, from its second differences; empty where the log is too short to tell, or too odd.

    Args:
        read: the signals whose mean it is.
        scale: of their SI values.
    """
    time = read[0].time
    if len(time) < _FEWEST_SPEEDS:
        return {}
    bend = np.diff(np.mean([each.at(time) for each in read], axis=0) * scale, 2)
    low, high = np.quantile(bend, [0.1587, 0.8413])
    scatter = float((high - low) / 2 / np.sqrt(6))
    if not scatter <= _MOST_SPEED_NOISE:
        return {}
    beside = "; slip and bumps come on top" if scatter < _LEAST_SPEED_NOISE else ""
    noise = max(scatter, _LEAST_SPEED_NOISE)
    return {"noise": Choice(f"{{speed: {noise:.2g}}}", f"m/s; scatter from frame to frame: {scatter:.2g}{beside}")}


def _with_yaw(
    heard: Sequence[Heard],
    signals: dict[str, Choice],
    channel: int,
    dbc: Path,
    time: Floats,
    speed: Floats,
    side: Floats | None,
) -> OwnMotion | None:
    """Return own motion with the yaw rate that agrees best with the wheels' difference; without wheels, by name."""
    yaws = [
        each
        for each in heard
        if each.channel == channel and each.dbc == dbc and each.dimension in {"", "rate"}
        and "yaw" in _tokens(each.spec.name) and not set(_tokens(each.spec.name)) & (_SPOILT | {"accel", "acc"})
    ]  # fmt: skip
    known = side is not None
    if yaws and side is not None:
        fits = [(abs(_slope(_smooth(side, 25), _smooth(each.at(time), 25))[1]), each) for each in yaws]
        best = max(fits, key=lambda item: item[0])[1]
        choice = _turning(best, _smooth(best.at(time), 25), _smooth(side, 25))
        known = not choice.guess
        rate = best.at(time) * (-1 if choice.value.lstrip("{signal: ").startswith("-") else 1)
        rate *= np.pi / 180 if "unit: deg/s" in choice.value else 1.0
        why = choice.why.replace("the yaw rate otherwise known", "the wheels' difference")
        signals["yaw_rate"] = Choice(choice.value, why, guess=choice.guess, ask=choice.ask)
    elif yaws:
        best, known = yaws[0], False
        unit = "" if best.dimension else ("deg/s" if float(np.quantile(np.abs(best.values), 0.99)) > 1.5 else "rad/s")
        value = f"{{signal: {best.name}, unit: {unit}}}" if unit else best.name
        why = "by name; positive to the left? nothing else tells it" + (f"; {unit} by its size" if unit else "")
        signals["yaw_rate"] = Choice(value, why, guess=True, ask="sign")
        rate = best.at(time) * (np.pi / 180 if unit == "deg/s" else 1.0)
    elif side is not None:
        rate = side
    else:
        return None
    fast = speed > SLOWEST
    rate = rate - (float(np.median(rate[fast])) if fast.any() and known and side is not None and yaws else 0.0)
    if side is not None and yaws:
        rate += float(np.median(_smooth(side, 25)[fast])) if fast.any() else 0.0
    extra = {"track_width": Choice(f"{TRACK_WIDTH:g}", "m; measure it", guess=True)} if side is not None else {}
    return OwnMotion("odometry", channel, dbc, signals, time, speed, rate, side_known=known, extra=extra)


def _wheels(heard: Sequence[Heard]) -> tuple[list[Heard], list[Heard]] | None:
    """Return as many wheel speeds of the left as of the right, of the channel and file with most of them."""
    groups: dict[tuple[int, Path], tuple[list[Heard], list[Heard]]] = {}
    for each in heard:
        kinds = set(_tokens(each.spec.name))
        about = kinds | set(_tokens(each.message.name))
        if (
            each.dimension not in {"", "speed"}
            or not about & {"wheel", "whl", "ws", "wss", "wheels"}
            or np.ptp(each.values) == 0
        ):
            continue
        left, right = groups.setdefault((each.channel, each.dbc), ([], []))
        if kinds & _LEFT and not kinds & _RIGHT:
            left.append(each)
        elif kinds & _RIGHT and not kinds & _LEFT:
            right.append(each)
    best = max(groups.values(), key=lambda sides: min(map(len, sides)), default=([], []))
    count = min(map(len, best))
    if not count:
        return None
    left, right = best[0][:count], best[1][:count]
    means = [float(np.mean(each.values)) * each.factor for each in (*left, *right)]
    return (left, right) if max(means) - min(means) < 0.1 * max(map(abs, means)) + 0.1 else None


def _units_of(signal: Heard) -> tuple[str, ...]:
    """Return the units to try; empty for the DBC's own."""
    return ("",) if signal.dimension else _SPEED_UNITS


def _speed_ref(signal: Heard, unit: str) -> str:
    return f"{{signal: {signal.name}, unit: {unit}}}" if unit else signal.name


def _speed_unit(wheels: Sequence[Heard], standing: tuple[Floats, Floats] | None) -> tuple[str, str, bool]:
    """Return the unit of wheel speeds, empty for the DBC's, the evidence, and whether it is a guess."""
    shares = {unit: _standing_share(wheels[0], unit, standing) for unit in _units_of(wheels[0])}
    unit = max(shares, key=lambda each: shares[each])
    share = shares[unit]
    if share > 0.05:
        return unit, f"{len(wheels)} that agree; {share:.0%} of the radar's objects stand by them", False
    if unit:  # none proven: what a car can drive decides
        unit = "km/h" if float(np.quantile(wheels[0].values, 0.99)) > 60 else "m/s"
        return unit, "the DBC names no unit, and nothing in the log tells it", True
    return unit, f"{len(wheels)} that agree", False


def _standing_share(signal: Heard, unit: str, standing: tuple[Floats, Floats] | None) -> float:
    """Return the share of a radar's objects that stand if a signal in some unit is own speed, by chance taken off."""
    if standing is None or not len(standing[0]):
        return 0.0
    time, rate = standing
    speed = signal.at(time) * (UNIT_FACTORS[unit] / signal.factor if unit else 1.0)
    fast = speed > SLOWEST
    if np.count_nonzero(fast) < 20:
        return 0.0
    ratio = -rate[fast] / speed[fast]
    at, beside = np.mean(np.abs(ratio - 0.99) < 0.03), np.mean(np.abs(ratio - 1.2) < 0.03)
    return float(at - beside)
