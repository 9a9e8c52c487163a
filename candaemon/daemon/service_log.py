"""The service's log: lines for the journal, for a terminal, or for programs; repetitions at a limited rate.

The journal keeps the time and wants the priority as a prefix, sd-daemon(3); a terminal wants neither.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from types import TracebackType
from typing import Literal, TextIO, TypeAlias

from candaemon.daemon.observer import DaemonView, Observer
from candaemon.log_lines import ANSWER, LineFormatter, text_of

logger = logging.getLogger(__name__)

LogFormat: TypeAlias = Literal["text", "json"]

_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6), (0, 7))
"""Lowest level and syslog priority."""
_KINDS = 256
"""Kinds of lines whose repetitions are counted."""
_OF_EVERY_RECORD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName", "repeated", *ANSWER}


def configure_logging(
    form: LogFormat, stream: TextIO | None = None, *, repetitions: RepetitionFilter | None = None
) -> None:
    """Send log records from INFO on to a stream.

    Args:
        form: a text a line, or a JSON object a line with `time`, `level`, `logger`, `message` and the record's extras.
        stream: default: standard error.
        repetitions: limits their rate; default: one of its own.
    """
    stream = sys.stderr if stream is None else stream
    handler = logging.StreamHandler(stream)
    handler.addFilter(repetitions or RepetitionFilter())
    text = JsonFormatter() if form == "json" else LineFormatter("%(message)s")
    journal = is_journal_stream(stream)
    prefix = "" if journal or form == "json" else "candaemon: "
    handler.setFormatter(JournalFormatter(text, prefix, priorities=journal))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)


def log_uncaught_exceptions() -> None:
    """Let what ends the process, or one of its threads, go to the log, with its traceback."""

    def log_fault(kind: type[BaseException], fault: BaseException | None, trace: TracebackType | None) -> None:
        if fault is not None and not issubclass(kind, SystemExit | KeyboardInterrupt):
            logger.critical("a fault in candaemon, please report it: %s", fault, exc_info=(kind, fault, trace))

    sys.excepthook = log_fault
    threading.excepthook = lambda ended: log_fault(ended.exc_type, ended.exc_value, ended.exc_traceback)


class LogFormatObserver(Observer):
    """Lets the log's form follow the configuration.

    Args:
        form: whatever the configuration says; None: what it says.
        repetitions: goes on limiting the lines' rate: that of a service loaded again and again too.
    """

    def __init__(self, form: LogFormat | None, repetitions: RepetitionFilter) -> None:
        self._form = form
        self._repetitions = repetitions

    def on_reload_end(self, daemon: DaemonView, error: str) -> None:
        """Take the form of the configuration that took its place."""
        if not error:
            configure_logging(self._form or daemon.binding.settings.service.log, repetitions=self._repetitions)


def is_journal_stream(stream: TextIO) -> bool:
    """Return whether a stream is what systemd connected to the journal: `JOURNAL_STREAM` names its device and inode."""
    try:
        found = os.fstat(stream.fileno())
    except (OSError, ValueError):  # it has no file, or is closed
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{found.st_dev}:{found.st_ino}"


class JournalFormatter(logging.Formatter):
    """Puts a prefix before each line of a record.

    Args:
        text: makes the lines.
        prefix: of each.
        priorities: whether the syslog priority goes before it, as `<4>`.
    """

    def __init__(self, text: logging.Formatter, prefix: str = "", *, priorities: bool = False) -> None:
        super().__init__()
        self._text, self._prefix, self._priorities = text, prefix, priorities

    def format(self, record: logging.LogRecord) -> str:
        """Return the record's lines."""
        prefix = self._prefix
        if self._priorities:
            priority = next(number for level, number in _PRIORITIES if record.levelno >= level)
            prefix = f"<{priority}>{prefix}"
        repeated = getattr(record, "repeated", 0)
        more = f" ({repeated} more like it were left out)" if repeated else ""
        return "\n".join(prefix + line for line in (self._text.format(record) + more).split("\n"))


class JsonFormatter(LineFormatter):
    """Makes one JSON object of a record."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the object on one line."""
        fields = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": text_of(record),
        }
        fields |= {name: value for name, value in vars(record).items() if name not in _OF_EVERY_RECORD}
        if record.exc_info:
            fields["error"] = self.formatException(record.exc_info)
        line = json.dumps(fields, ensure_ascii=False, default=str)
        return line if line.isprintable() else json.dumps(fields, default=str)


@dataclass(slots=True)
class _Kind:
    """Lines of one kind in the running span."""

    began_s: float
    lines: int = 0
    left_out: int = 0


class RepetitionFilter(logging.Filter):
    """Lets a few records of a kind through in a span of time; the first of the next span says how many were left out.

    Of a kind are records with the same logger, text and first argument, such as what becomes of one bus. What answers a
    request (`ANSWER`) always goes through: who asked waits for it, and asks no faster than it is answered.

    Args:
        most: records of a kind in a span.
        span_s: its length, s.
        clock: monotonic seconds.

    Attributes:
        left_out: records of all kinds that did not go through.
    """

    def __init__(self, most: int = 5, span_s: float = 60.0, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._most, self._span_s, self._clock = most, span_s, clock
        self.left_out = 0
        self._kinds: OrderedDict[tuple[str, str, str], _Kind] = OrderedDict()

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether a record goes through."""
        if getattr(record, "answer", False):
            return True
        first = str(record.args[0]) if isinstance(record.args, tuple) and record.args else ""
        key, now_s = (record.name, str(record.msg), first), self._clock()
        kind = self._kinds.pop(key, None) or _Kind(now_s)
        if now_s - kind.began_s >= self._span_s:
            record.repeated = kind.left_out
            kind = _Kind(now_s)
        self._kinds[key] = kind
        if len(self._kinds) > _KINDS:
            self._kinds.popitem(last=False)
        kind.lines += 1
        if kind.lines <= self._most:
            return True
        kind.left_out += 1
        self.left_out += 1
        return False
