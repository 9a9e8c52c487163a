"""What a service learnt, kept in a file over restarts: of each sensor by its name, with what it was learnt of.

The file is JSON. It is read within a limit and checked in whole; one that is damaged, or of which a sensor's settings
have changed since, is not used.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Final

import numpy as np
from pydantic import Field, ValidationError

from candaemon.binding.bound import Binding
from candaemon.calibration.calibrator import Calibrator
from candaemon.calibration.parameters import COUNT, LARGEST_YAW, LATENCY, LONGEST_LATENCY, YAW, Estimate
from candaemon.calibration.windows import is_covariance
from candaemon.config.base import Settings
from candaemon.config.names import Name
from candaemon.errors import InputError
from candaemon.files.bounded import read_bounded
from candaemon.files.outputs import write_file

NAME: Final = "calibration.json"
"""Of the file, in the state folder of a service."""
LONGEST_FILE: Final = 1 << 20
"""Bytes of the file."""
_MOST_SENSORS: Final = 1024
_FORM: Final = 1

_Number = Annotated[float, Field(ge=-1e6, le=1e6)]
_Row = Annotated[tuple[_Number, ...], Field(min_length=COUNT, max_length=COUNT)]


class KeptSensor(Settings):
    """What was learnt of one sensor."""

    of: str = Field(max_length=64, description="digest of the settings that it was learnt of")
    mean: _Row = Field(description="latency s, yaw rad, speed scale − 1, yaw rate bias rad/s")
    covariance: tuple[_Row, ...] = Field(min_length=COUNT, max_length=COUNT, description="of the mean")


class KeptCalibration(Settings):
    """The file."""

    form: int = Field(ge=_FORM, le=_FORM, description="version of this format")
    sensors: dict[Name, KeptSensor] = Field(max_length=_MOST_SENSORS, description="by name")


@dataclass(frozen=True, slots=True)
class Begun:
    """What became of a kept file.

    Attributes:
        used: names of the sensors that begin with what was learnt.
        changed: names of those whose settings have changed since.
    """

    used: tuple[str, ...]
    changed: tuple[str, ...]


def write(path: Path, calibrator: Calibrator, binding: Binding) -> None:
    """Write what is known of each sensor; whole or not at all.

    Raises:
        InputError: it cannot be written; names the path.
    """
    sensors = {
        sensor.name: {
            "of": _digest(binding, sensor.index),
            "mean": calibrator.state.sensors[sensor.index].mean.tolist(),
            "covariance": calibrator.state.sensors[sensor.index].covariance.tolist(),
        }
        for sensor in binding.sensors
        if calibrator.is_known(sensor.index)
    }
    write_file(path, json.dumps({"form": _FORM, "sensors": sensors}, indent=1) + "\n")


def begin(path: Path, calibrator: Calibrator, binding: Binding) -> Begun:
    """Let a calibrator begin with what a file keeps of its sensors; without a file, with nothing.

    Raises:
        InputError: the file is damaged or cannot be read, and nothing of it is used; names the path.
    """
    try:
        kept = _read(path)
    except FileNotFoundError:
        return Begun((), ())
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}; calibration begins anew", file=path) from error
    known = [each for each in binding.sensors if each.name in kept]
    used = [each for each in known if kept[each.name][0] == _digest(binding, each.index)]
    for each in used:
        calibrator.begin_with(each.index, kept[each.name][1])
    names = tuple(each.name for each in used)
    return Begun(names, tuple(each.name for each in known if each.name not in names))


def _read(path: Path) -> Mapping[str, tuple[str, Estimate]]:
    """Read a file: of each sensor the digest of its settings, and the estimate."""
    data = read_bounded(path, LONGEST_FILE)
    try:
        kept = KeptCalibration.model_validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise _damaged(path, f"{where}: {first['msg']}") from None
    found = {}
    for name, sensor in kept.sensors.items():
        estimate = Estimate(np.array(sensor.mean), np.array(sensor.covariance))
        if not is_covariance(estimate.covariance):
            raise _damaged(path, f"sensors.{name}.covariance is none")
        if abs(estimate.mean[LATENCY]) > LONGEST_LATENCY or abs(estimate.mean[YAW]) > LARGEST_YAW:
            raise _damaged(path, f"sensors.{name}.mean is beyond what is ever estimated")
        found[name] = (sensor.of, estimate)
    return found


def _damaged(path: Path, why: str) -> InputError:
    return InputError(f"is damaged ({why}); calibration begins anew, remove the file", file=path)


def _digest(binding: Binding, sensor: int) -> str:
    """Return what the estimates of a sensor belong to: its settings, and those of ego motion."""
    settings = binding.settings
    text = binding.sensors[sensor].settings.model_dump_json() + settings.ego.model_dump_json()
    return sha256(text.encode()).hexdigest()[:16]
