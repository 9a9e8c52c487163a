"""What drives propose for the configuration: a row for each quantity, and the settings that follow."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import degrees, radians
from typing import Any, Final

from candaemon.binding.bound import Binding, BoundSensor
from candaemon.calibration.drives import RANGES, SensorFindings
from candaemon.calibration.noise import NoiseParts
from candaemon.calibration.parameters import BIAS, LATENCY, SCALE, YAW
from candaemon.config.ego import OdometrySettings
from candaemon.config.settings import Config
from candaemon.config.vehicle import VehicleEstimatorSettings

STATED: Final = 2.0
"""Standard deviations that a stated uncertainty covers: 95 % of drives."""
_ENOUGH: Final = (0.02, radians(0.3), 0.01, radians(0.15))
"""One standard deviation of each parameter, above which a log has not enough to say of less than `_OBVIOUS` of them."""
_OBVIOUS: Final = 5.0
_SAME: Final = 0.1
"""Share by which a noise must differ from the configured one, beyond its uncertainty, to be proposed."""
_LEAST: Final = (0.002, 0.05)
"""s and deg, below which nothing is proposed."""
_RANGE_MATTERS: Final = 0.25
"""Share by which the noise of two ranges must differ to be told apart."""
_LEAST_NOISE: Final = {"range": 0.02, "x": 0.02, "y": 0.02, "azimuth": 0.02, "range_rate": 0.02, "vx": 0.02, "vy": 0.02}
"""m, deg, m/s: less is that of a radar that repeats what it said."""
_LEAST_WALK: Final = 0.005
"""m²/s, below which a walk is none."""
_FILTER_TIME: Final = 0.3
"""s, over which a filter without a walk of its own averages."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What is said of one quantity.

    Attributes:
        what: the quantity, as its setting is named.
        unit: of all numbers of the row.
        configured: what the configuration says; None where there is no such setting.
        found: what the drives say; None: not enough.
        uncertainty: half the interval that holds the true value in 95 % of drives.
        remark: parts of a noise, or its ranges.
        setting: keys of the setting from the root on; empty where there is none.
        proposed: value for the setting; None: it stays.
    """

    what: str
    unit: str
    configured: float | None
    found: float | None
    uncertainty: float | None
    remark: str = ""
    setting: tuple[str, ...] = ()
    proposed: float | None = None


def proposals(binding: Binding, found: Mapping[str, SensorFindings]) -> list[Finding]:
    """Return the rows of all sensors, and of odometry.

    Args:
        binding: the configuration.
        found: what the drives show, by the sensor's name.
    """
    rows: list[Finding] = []
    for sensor in binding.sensors:
        rows += _pose(sensor, found[sensor.name])
        rows += _noise(sensor, found[sensor.name], walks=_walks(binding.settings, sensor.name))
    if isinstance(binding.settings.ego, OdometrySettings) and found:
        rows += _odometry(max(found.values(), key=lambda each: each.windows))
    return rows


def patch(rows: list[Finding]) -> dict[str, Any]:
    """Return the settings that are proposed, as a tree; empty where all stays."""
    tree: dict[str, Any] = {}
    for row in rows:
        if row.proposed is not None:
            branch = tree
            for key in row.setting[:-1]:
                branch = branch.setdefault(key, {})
            branch[row.setting[-1]] = row.proposed
    return tree


def _pose(sensor: BoundSensor, of: SensorFindings) -> Iterator[Finding]:
    """Yield the rows of latency and yaw."""
    settings, deviation = sensor.settings, of.estimate.deviation
    for index, what, unit, configured, factor, setting, digits in (
        (LATENCY, "latency", "s", settings.latency, 1.0, ("latency",), 3),
        (YAW, "mount.yaw_deg", "deg", settings.mount.yaw_deg, degrees(1.0), ("mount", "yaw_deg"), 2),
    ):
        where = ("sensors", sensor.name, *setting)
        error, uncertainty = factor * of.estimate.mean[index], STATED * factor * deviation[index]
        is_vague = deviation[index] > _ENOUGH[index] and abs(of.estimate.mean[index]) < _OBVIOUS * deviation[index]
        if not of.windows or is_vague:
            yield Finding(f"{sensor.name}.{what}", unit, configured, None, None, "", where)
            continue
        is_off = abs(error) > max(1.5 * uncertainty, _LEAST[index])
        value = round(configured + float(error), digits)
        yield Finding(
            f"{sensor.name}.{what}", unit, configured, value, float(uncertainty), "", where, value if is_off else None
        )


def _noise(sensor: BoundSensor, of: SensorFindings, *, walks: bool) -> Iterator[Finding]:
    """Yield the rows of the noise of each quantity, and of the walk.

    Args:
        sensor: the sensor.
        of: what the drives show of it.
        walks: whether the tracker's filter has a walk of its own; else it is to be part of the noise.
    """
    noise = sensor.settings.noise
    for name, parts in of.noise.items():
        factor, unit = {"azimuth": (degrees(1.0), "deg")}.get(
            name, (1.0, "m/s" if name.startswith(("v", "range_r")) else "m")
        )
        key = "azimuth_deg" if name == "azimuth" else name
        where = ("sensors", sensor.name, "noise", key)
        configured = float(getattr(noise, key))
        if parts is None:
            yield Finding(f"{sensor.name}.noise.{key}", unit, configured, None, None, "", where)
            continue
        value = max(factor * parts.over(0.0 if walks else _FILTER_TIME), _LEAST_NOISE[name])
        uncertainty = STATED * factor * parts.uncertainty(0.0 if walks else _FILTER_TIME)
        differs = abs(value - configured) > max(_SAME * configured, uncertainty)
        rounded = float(f"{value:.3g}")
        remark = ", ".join(filter(None, [_parts(parts, factor, unit), _ranges(of.by_range[name], factor)]))
        yield Finding(
            f"{sensor.name}.noise.{key}", unit, configured, rounded, uncertainty, remark, where,
            rounded if differs else None,
        )  # fmt: skip
    yield from _walk(sensor, of, walks=walks)


def _walk(sensor: BoundSensor, of: SensorFindings, *, walks: bool) -> Iterator[Finding]:
    """Yield the rows of the random walk, of which both are proposed or none: they stand together.

    Where none is given the tracker learns it on line, and how it grows with the range, which no setting tells: it is
    left to that.
    """
    given = sensor.settings.noise.walk
    seen = [parts for parts in of.walk if parts is not None]
    configured = [None, None] if given is None else [given.along, given.across]
    is_off = False
    if given is not None and walks and len(seen) == len(of.walk):
        is_off = any(map(_walk_differs, seen, (given.along, given.across)))
    for name, parts, value in zip(("along", "across"), of.walk, configured, strict=True):
        what, where = f"{sensor.name}.noise.walk.{name}", ("sensors", sensor.name, "noise", "walk", name)
        if parts is None:
            yield Finding(what, "m²/s", value, None, None)
            continue
        found, learnt = float(f"{parts.walk:.3g}"), "learnt by the tracker" if walks and given is None else ""
        yield Finding(
            what, "m²/s", value, found, STATED * parts.walk_sd, learnt if parts.walk else "none seen", where,
            found if is_off else None,
        )  # fmt: skip


def _walk_differs(parts: NoiseParts, configured: float) -> bool:
    """Return whether a walk differs from the configured one."""
    return abs(parts.walk - configured) > max(_SAME * configured, STATED * parts.walk_sd, _LEAST_WALK)


def _walks(settings: Config, sensor: str) -> bool:
    """Return whether the filter of a sensor's group lets its reflections walk."""
    groups = [group.tracker for group in settings.groups.values() if sensor in group.sensors]
    return isinstance((groups or [settings.tracker])[0].estimator, VehicleEstimatorSettings)


def _odometry(of: SensorFindings) -> Iterator[Finding]:
    """Yield the rows of odometry, which has no settings for them: it corrects itself."""
    deviation = of.estimate.deviation
    for index, what, unit, offset, factor in (
        (SCALE, "ego.speed_scale", "1", 1.0, 1.0),
        (BIAS, "ego.yaw_rate_bias", "deg/s", 0.0, degrees(1.0)),
    ):
        if not of.windows or deviation[index] > _ENOUGH[index]:
            yield Finding(what, unit, None, None, None)
            continue
        value = offset + factor * float(of.estimate.mean[index])
        yield Finding(
            what, unit, None, round(value, 5), STATED * factor * float(deviation[index]), "corrected by itself"
        )


def _parts(parts: NoiseParts, factor: float, unit: str) -> str:
    """Return of what a noise is made."""
    told = f"white {factor * parts.white:.3g}"
    if parts.slow:
        told += f", correlated {factor * parts.slow:.3g} for {parts.time:g} s"
    if parts.walk:
        squared = f"({unit})²" if "/" in unit else f"{unit}²"
        told += f", walk {factor**2 * parts.walk:.3g} {squared}/s"
    return told


def _ranges(by_range: list[NoiseParts | None], factor: float) -> str:
    """Return the noise by range where that matters; empty elsewhere."""
    known = [
        (begin, end, factor * each.over(_FILTER_TIME))
        for (begin, end), each in zip(RANGES, by_range, strict=True)
        if each and each.over(_FILTER_TIME) > 0.0
    ]
    values = [value for _, _, value in known]
    if len(values) < 2 or max(values) < (1.0 + _RANGE_MATTERS) * min(values):
        return ""
    return ", ".join(
        f"{value:.3g} from {begin:g} m on" if end == float("inf") else f"{value:.3g} at {begin:g} to {end:g} m"
        for begin, end, value in known
    )
