"""The moments of a drive that deserve a look, worst first of each kind."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from candaemon.arrays import Floats
from candaemon.report.drawings import lives
from candaemon.report.drive_record import DriveRecord
from candaemon.tracking.obstacles import COASTING

OF_A_KIND: Final = 5
"""Moments of one kind."""
_APART: Final = 1.0
"""s between two moments of a kind."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A moment.

    Attributes:
        time: s since the first cycle.
        what: happened, in words.
        obstacle: to whom; None: to the drive.
    """

    time: float
    what: str
    obstacle: int | None = None


def worst_moments(record: DriveRecord, horizons: tuple[float, ...]) -> list[Moment]:
    """Return updates that fit worst, predictions farthest off, losses, silences and long coasting, in order of time."""
    return sorted(
        [
            *_misfits(record),
            *_misses(record, horizons),
            *_losses(record),
            *_silences(record),
            *_coasting(record),
        ],
        key=lambda moment: (moment.time, moment.what),
    )


def _misfits(record: DriveRecord) -> Iterable[Moment]:
    columns = record.moments.arrays()
    for row in _worst(columns["time"], columns["nis"] / np.maximum(columns["freedom"], 1)):
        nis, freedom = columns["nis"][row], int(columns["freedom"][row])
        yield Moment(float(columns["time"][row]), f"NIS {nis:.1f} where {freedom} is expected", int(columns["id"][row]))


def _misses(record: DriveRecord, horizons: tuple[float, ...]) -> Iterable[Moment]:
    columns = record.predictions.arrays()
    far = np.hypot(columns["x"], columns["y"])
    for row in _worst(columns["time"], far):
        ahead = horizons[int(columns["horizon"][row])]
        yield Moment(float(columns["time"][row]), f"predicted {ahead:g} s before, {far[row]:.2f} m off")


def _losses(record: DriveRecord) -> Iterable[Moment]:
    columns = record.cycles.arrays()
    lost = np.diff(columns["lost"], prepend=columns["lost"][:1])
    for row in _worst(columns["time"], np.where(lost > 0, lost, -np.inf)):
        yield Moment(float(columns["time"][row]), f"{lost[row]:.0f} frames lost or refused")


def _silences(record: DriveRecord) -> Iterable[Moment]:
    columns = record.cycles.arrays()
    for k, name in enumerate(record.sensors):
        time = columns["time"][columns["sensor"] == k]
        gap = np.diff(time)
        usual = float(np.median(gap)) if len(gap) else 0.0
        for row in _worst(time[:-1], np.where(gap > 1.5 * usual, gap, -np.inf)):
            yield Moment(float(time[row]), f"no scan of {name} for {gap[row] * 1e3:.0f} ms")


def _coasting(record: DriveRecord) -> Iterable[Moment]:
    columns = record.obstacles.arrays()
    begins, lengths, owners = [], [], []
    for rows in lives(record):
        coasts = columns["state"][rows] == COASTING
        steps = np.diff(np.concatenate([[False], coasts, [False]]).astype(np.int8))
        for first, after in zip(np.flatnonzero(steps > 0), np.flatnonzero(steps < 0), strict=True):
            begins.append(float(columns["time"][rows[first]]))
            lengths.append(float(columns["time"][rows[after - 1]]) - begins[-1])
            owners.append(int(columns["id"][rows[0]]))
    length = np.array(lengths)
    for row in _worst(np.array(begins), np.where(length > 0, length, -np.inf)):
        yield Moment(begins[row], f"coasts for {lengths[row]:.2f} s", owners[row])


def _worst(time: Floats, badness: Floats) -> list[int]:
    """Return the rows of the largest values, some time apart; infinite and unknown ones are left out."""
    found: list[int] = []
    for row in np.argsort(-np.nan_to_num(badness, nan=-np.inf), kind="stable").tolist():
        if len(found) == OF_A_KIND or not np.isfinite(badness[row]):
            break
        if all(abs(time[row] - time[other]) >= _APART for other in found):
            found.append(row)
    return found
