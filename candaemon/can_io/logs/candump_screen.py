"""What `candump` shows on a terminal, brought into the form in which `candump -L` logs it.

::

     (1533226488.434433)  can0  260   [8]  08 FF FB 00 00 00 18 84
     (2018-08-02 16:14:48.434433)  can0  RX - -  260   [8]  08 FF FB 00 00 00 18 84   '........'

Lines of `-t a`, `-t A` and `-t z` are taken; those of `-t A`, which name no time zone, as UTC. Without a time stamp,
and with the differences that `-t d` writes, nothing can be replayed; the message says so.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import Final

ADVICE_UNTIMED: Final = "its lines have no time stamps; record with `candump -L`, or `-t a`"
"""What to do about lines without time."""
ENDED_DIFFERENCES: Final = "its time stamps are differences (`candump -t d`); record with `candump -L`, or `-t a`"
"""Why such a log is not read."""

_LINE = re.compile(
    rb"^[ \t]*(?:\((?P<stamp>[\d .:-]{1,40})\)[ \t]+)?(?P<channel>[^\s(]\S*)[ \t]+"
    rb"(?:[RT]X[ \t]+[B-][ \t]+[E-][ \t]+)?"
    rb"(?P<id>[0-9A-F]{3}|[0-9A-F]{8})[ \t]+[\[{](?P<length>\d{1,2})[\]}]"
    rb"(?:[ \t]+(?P<remote>remote request)|(?P<data>(?:[ \t]+[0-9A-F]{2})*))"
    rb"(?:[ \t]+(?:ERRORFRAME|'[^\r\n]*'))*[ \t]*(?=\r?$)",
    re.MULTILINE,
)
_EXPLANATION = re.compile(rb"^\t[^\r\n]*(?=\r?$)", re.MULTILINE)
_SECONDS = re.compile(rb"\d{1,10}\.\d{1,9}")
_LEAST_EPOCH = 9  # digits of seconds since 1970; stamps from the start on have three
_ENOUGH = 50  # stamps from which differences are told from times
_FALLING = 0.1  # share of stamps that are less than the one before; times never fall


class ScreenLines:
    """Brings the lines of one log into the form of `candump -L`, each to one line.

    Attributes:
        untimed: whether a line without a time stamp has come.
        are_differences: whether the time stamps are those of `-t d`.
    """

    def __init__(self) -> None:
        self.untimed = False
        self._before = 0.0
        self._short = self._fallen = 0

    @property
    def are_differences(self) -> bool:
        """Whether the time stamps are no times, but differences."""
        return self._short >= _ENOUGH and self._fallen > _FALLING * self._short

    def logged(self, text: bytes) -> bytes:
        """Return whole lines with those of the screen in the form of a log; all others as they are."""
        if b"[" not in text and b"{" not in text:  # as in every log of `candump -L`
            return text
        return _LINE.sub(self._line, _EXPLANATION.sub(b"", text))

    def _line(self, line: re.Match[bytes]) -> bytes:
        """Return one line; as it is where it does not add up."""
        stamp = line["stamp"]
        if stamp is None:
            self.untimed = True
            return line[0]
        seconds = stamp if _SECONDS.fullmatch(stamp) else _epoch(stamp)
        data = b"".join((line["data"] or b"").split())
        length = int(line["length"])
        if not seconds or not (line["remote"] or len(data) == 2 * length):
            return line[0]
        self._watch(seconds)
        fd = len(line["length"]) == 2
        content = b"R" if line["remote"] else (b"#1" if fd else b"") + data
        return b"(%s) %s %s#%s" % (seconds, line["channel"], line["id"], content)

    def _watch(self, seconds: bytes) -> None:
        """Note whether time stamps fall, as only differences do."""
        if seconds.find(b".") >= _LEAST_EPOCH:
            return
        time = float(seconds)
        self._short += 1
        self._fallen += time < self._before
        self._before = time


def _epoch(stamp: bytes) -> bytes:
    """Return a date and time as seconds since 1970; empty where it is none."""
    date, point, fraction = stamp.decode().strip().partition(".")
    try:
        seconds = int(datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp())
    except ValueError:
        return b""
    if not (point and fraction.isdigit()) or seconds < 0:
        return b""
    return f"{seconds:010d}.{fraction}".encode()
