"""Which part of a drive is meant: moments, counted from its beginning or from 1970."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

from candaemon.frames.times import LATEST_NS

LONGEST_DRIVE_S: Final = 1e9
"""Most seconds from a drive's beginning."""

_SINCE_BEGIN = re.compile(r"\d{1,10}(\.\d{1,9})?", re.ASCII)
_SINCE_1970 = re.compile(r"@(\d{1,10})(?:\.(\d{1,9}))?", re.ASCII)


@dataclass(frozen=True, slots=True)
class DriveMoment:
    """An instant of a drive.

    Attributes:
        time_ns: ns since 1970, or since the drive's first frame.
        since_begin: whether it is the latter.
    """

    time_ns: int
    since_begin: bool

    def from_begin(self, first_ns: int) -> int:
        """Return it in ns since 1970, of a drive that began at `first_ns`."""
        return self.time_ns + first_ns if self.since_begin else self.time_ns


def moment(text: str) -> DriveMoment:
    """Read a moment: `12.5` s from the drive's beginning, `@1533226488.5`, or `2018-08-02T16:14:48.5Z`.

    Raises:
        ValueError: it is none.
    """
    if _SINCE_BEGIN.fullmatch(text) and float(text) <= LONGEST_DRIVE_S:
        return DriveMoment(round(float(text) * 1e9), since_begin=True)
    epoch = _SINCE_1970.fullmatch(text)
    if epoch is not None:
        time_ns = int(epoch[1]) * 1_000_000_000 + int((epoch[2] or "").ljust(9, "0"))
    else:
        date = datetime.fromisoformat(text)
        date = date.replace(tzinfo=UTC) if date.tzinfo is None else date
        since = date - datetime(1970, 1, 1, tzinfo=UTC)
        time_ns = (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000
    if not 0 <= time_ns <= LATEST_NS:
        raise ValueError(f"{text} is out of range")
    return DriveMoment(time_ns, since_begin=False)


@dataclass(frozen=True, slots=True)
class TimeRange:
    """What of a drive is read.

    Attributes:
        begin: the first moment; None: from its beginning.
        end: the first moment that is not; None: to its end.
    """

    begin: DriveMoment | None = None
    end: DriveMoment | None = None

    @property
    def is_all(self) -> bool:
        """Whether nothing is left out."""
        return self.begin is None and self.end is None


WHOLE_DRIVE: Final = TimeRange()
"""All of a drive."""
