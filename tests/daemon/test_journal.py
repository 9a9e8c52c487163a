"""The service's log: for the journal, for a terminal, for programs, and never a flood."""

from __future__ import annotations

import io
import json
import logging
import os
import re
import sys
from pathlib import Path

import pytest

from candaemon.config.metrics import MetricsSettings
from candaemon.daemon.daemon import Daemon
from candaemon.daemon.service_log import LogFormat, RepetitionFilter, configure_logging, log_uncaught_exceptions
from candaemon.errors import ConfigError
from candaemon.printable import printable
from candaemon.status.health_summary import StatusLogger
from candaemon.status.service_monitor import ServiceMonitor
from tests.support.bound import binding

logger = logging.getLogger("candaemon.test")

METER = ServiceMonitor(MetricsSettings())

HOSTILE = ["\n", "\r\n", "\x0b", "\x0c", "\x1c", "\x1b[2J", "\x85", "\u2028", "\u2029", "\u202e", "\udcff", "\x00"]
"""What ends a line somewhere, acts on a terminal, or is no UTF-8."""

pytestmark = pytest.mark.usefixtures("logging_as_it_was")


def test_a_terminal_gets_plain_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    stream = io.StringIO()
    configure_logging("text", stream)
    logger.info("12 obstacles")
    logger.debug("not of interest")
    assert stream.getvalue() == "candaemon: 12 obstacles\n"


def test_the_journal_gets_a_priority_before_each_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with (tmp_path / "journal").open("w+") as stream:
        found = os.fstat(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{found.st_dev}:{found.st_ino}")
        configure_logging("text", stream)
        logger.info("up")
        logger.warning("bus '%s' is down", "can0")
        logger.error("refused: %s", ConfigError("two", others=[ConfigError("found 'x'", file="my.yaml", line=7)]))
        stream.seek(0)
        assert stream.read() == "<6>up\n<4>bus 'can0' is down\n<3>refused: two\n<3>my.yaml:7: found 'x'\n"


@pytest.mark.parametrize("form", ["text", "json"])
@pytest.mark.parametrize("breaks", HOSTILE)
def test_no_record_makes_two_lines_or_a_priority_of_its_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, form: LogFormat, breaks: str
) -> None:
    with (tmp_path / "journal").open("w+", encoding="utf-8", newline="") as stream:
        found = os.fstat(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{found.st_dev}:{found.st_ino}")
        configure_logging(form, stream)
        logger.warning("bus '%s' is down", f"a{breaks}<0>panic", extra={"bus": breaks})
        stream.seek(0)
        text = stream.read()
    assert len(text.splitlines()) == 1
    assert text.startswith("<4>")
    assert text[:-1].isprintable()
    said = json.loads(text[3:])["message"] if form == "json" else text[3:-1]
    assert said == f"bus 'a{printable(breaks)}<0>panic' is down"


def test_a_traceback_keeps_its_lines_and_shows_no_escape(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    stream = io.StringIO()
    configure_logging("text", stream)

    def fail() -> None:
        raise ValueError("red \x1b[31m\nforged")

    with pytest.raises(ValueError, match="red") as fault:
        fail()
    logger.error("a fault", exc_info=fault.value)
    first, *lines = stream.getvalue().splitlines()
    assert first == "candaemon: a fault"
    assert lines[0] == "candaemon: Traceback (most recent call last):"
    assert lines[-2:] == ["candaemon: ValueError: red \\x1b[31m", "candaemon: forged"]


def test_a_fault_goes_to_the_journal_as_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with (tmp_path / "journal").open("w+") as stream:
        found = os.fstat(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{found.st_dev}:{found.st_ino}")
        configure_logging("text", stream)
        log_uncaught_exceptions()
        with pytest.raises(ValueError, match="nobody foresaw") as fault:
            int("what nobody foresaw")
        sys.excepthook(fault.type, fault.value, fault.tb)
        stream.seek(0)
        lines = stream.read().splitlines()
    assert re.match("<2>a fault in candaemon, please report it: .*'what nobody foresaw'", lines[0])
    assert lines[-1].startswith("<2>ValueError: ")
    assert len(lines) > 3


def test_json_is_an_object_a_line_with_the_extras() -> None:
    stream = io.StringIO()
    configure_logging("json", stream)
    logger.warning("bus '%s' is down for good", "can0", extra={"bus": "can0"})
    (line,) = stream.getvalue().splitlines()
    told = json.loads(line)
    assert told["time"].endswith("+00:00")
    del told["time"]
    assert told == {
        "level": "warning",
        "logger": "candaemon.test",
        "message": "bus 'can0' is down for good",
        "bus": "can0",
    }


def test_what_repeats_is_counted_and_told_with_the_next_one() -> None:
    now_s = 0.0
    stream = io.StringIO()
    configure_logging("text", stream)
    handler = logging.getLogger().handlers[0]
    handler.filters[:] = [RepetitionFilter(most=3, span_s=60.0, clock=lambda: now_s)]
    for _ in range(100):
        logger.warning("bus '%s' is down", "can0")
    logger.warning("bus '%s' is down", "can1")
    now_s = 60.0
    logger.warning("bus '%s' is down", "can0")
    down = "candaemon: bus 'can0' is down"
    assert stream.getvalue().splitlines() == [
        *[down] * 3,
        "candaemon: bus 'can1' is down",
        f"{down} (97 more like it were left out)",
    ]


def test_kinds_of_lines_without_end_take_no_memory_without_end() -> None:
    limit = RepetitionFilter()
    for k in range(10_000):
        assert limit.filter(logging.LogRecord("x", logging.INFO, "", 0, "%s", (k,), None))
    assert len(limit._kinds) == 256


def test_the_status_line_comes_at_its_rate(caplog: pytest.LogCaptureFixture) -> None:
    now_s = 0.0
    daemon = Daemon(binding("demo"))
    status, silent = StatusLogger(1.0, METER, lambda: now_s), StatusLogger(0.0, METER, lambda: now_s)
    with caplog.at_level(logging.INFO):
        for line in (status, silent):
            line.on_start(daemon)
        for _ in range(1000):
            now_s += 0.01
            status.on_iteration(daemon)
            silent.on_iteration(daemon)
    lines = [message for message in caplog.messages if "frames/s" in message]
    assert 9 <= len(lines) <= 10
    assert "own motion unknown" in lines[0]
    assert "down: radar, ins, obstacles" in lines[0]


def test_the_status_line_follows_the_configuration(caplog: pytest.LogCaptureFixture) -> None:
    now_s = 0.0
    daemon = Daemon(binding("demo"))
    status = StatusLogger(None, METER, lambda: now_s)
    status.on_start(daemon)
    with caplog.at_level(logging.INFO):
        for _ in range(121):
            now_s += 1.0
            status.on_iteration(daemon)
    assert len(caplog.messages) == 121 // int(binding("demo").settings.service.status_interval)


def test_what_was_lost_is_told_with_its_cause(caplog: pytest.LogCaptureFixture) -> None:
    now_s = 0.0
    daemon = Daemon(binding("demo"))
    status = StatusLogger(1.0, ServiceMonitor(MetricsSettings()), lambda: now_s)
    status.on_start(daemon)
    daemon.buses[0].counts.kernel_lost = 5
    daemon.buses[0].counts.malformed = 2
    daemon.buses[2].counts.send_dropped = 7
    daemon.sequence.backward_steps = 1
    with caplog.at_level(logging.INFO):
        now_s = 1.0
        status.on_iteration(daemon)
        status.on_stop(daemon)
    since = (
        "since the start 0 cycles, 0 frames received, 7 lost, 0 unusable, 7 unsent "
        "(kernel lost 5, malformed 2, send dropped 7), 1 steps of the clock"
    )
    assert since in caplog.messages[0]
    assert caplog.messages[-1] == f"stopped; {since}"
