"""Types of the texts in a configuration, each bounded by what the text becomes.

===============  ==========================================================================================
`Name`           of a bus, sensor, group or actor: a part of a table's cell (`front:3;rear:7`), a metric's label, a
                 folder's name, a word of a log line
`Channel`        what an interface calls a bus; also its name in logs, unless it has a `LogChannel`
`LogChannel`     a field between two blanks of a candump log, where `#` belongs to the next field
`DbcName`        a signal or message, looked up in a DBC file
`FilePath`       opened, and named in messages
`Line`, `Prose`  shown to people, on one line or several
===============  ==========================================================================================
"""

from __future__ import annotations

import re
from typing import Annotated, Final

from pydantic import AfterValidator, Field

from candaemon.printable import is_one_line

LONGEST_NAME: Final = 64
"""Longest name of a bus, sensor, group or actor, in characters."""
LONGEST_CHANNEL: Final = 128
"""Longest name of a channel, in characters."""
LONGEST_INTERFACE: Final = 15
"""Longest name of a network interface in Linux, in bytes."""
LONGEST_DBC_NAME: Final = 256
"""Longest name of a signal or message, in characters."""
LONGEST_PATH: Final = 1024
"""Longest path of a file, in characters."""
LONGEST_LINE: Final = 256
"""Longest text on one line, in characters."""
LONGEST_PROSE: Final = 10_000
"""Longest text on several lines, in characters."""

RESERVED_CHANNELS: Final = {"tick": "what recordings call their ticks", "*": "every channel, where a log is read"}
"""Channels that a log has no room for, and what they stand for."""

_NAME: Final = re.compile(r"\w([\w .+-]*[\w+])?")
_LOG_CHANNEL: Final = "[^\\s#]+"


def _name(text: str) -> str:
    if _NAME.fullmatch(text) is None:
        raise ValueError(
            f"found {text!r}, expected a name of letters, digits and '_', with '.', '+', '-' or blanks inside"
        )
    return text


def _one_line(text: str) -> str:
    if not is_one_line(text):
        raise ValueError(f"found {text!r}, expected text on one line, without control characters")
    return text


def _prose(text: str) -> str:
    if not is_one_line(text.replace("\n", "").replace("\t", "")):
        raise ValueError(f"found {text!r}, expected text without control characters other than line ends and tabs")
    return text


def _channel(text: str) -> str:
    if not text.isprintable() or text != text.strip():
        raise ValueError(f"found {text!r}, expected printable characters, without a blank at an end")
    if text in RESERVED_CHANNELS:
        raise ValueError(f"'{text}' is {RESERVED_CHANNELS[text]}; give the bus another name there")
    return text


def _log_channel(text: str) -> str:
    if not is_log_channel(text):
        raise ValueError(f"found {text!r}, expected no blank and no '#', which end a channel's name in a log")
    return text


def is_log_channel(text: str) -> bool:
    """Return whether a log can hold a channel of this name."""
    return re.fullmatch(_LOG_CHANNEL, text) is not None


def interface_problem(text: str) -> str:
    """Return why Linux has no network interface of this name; empty where it may."""
    if len(text.encode()) > LONGEST_INTERFACE:
        return f"a network interface has at most {LONGEST_INTERFACE} bytes in its name"
    if text in {".", ".."} or not set(text).isdisjoint("/: "):
        return "a network interface has no blank, '/' or ':' in its name"
    return ""


Name = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME), AfterValidator(_name)]
Channel = Annotated[str, Field(min_length=1, max_length=LONGEST_CHANNEL), AfterValidator(_channel)]
LogChannel = Annotated[Channel, Field(json_schema_extra={"pattern": f"^{_LOG_CHANNEL}$"}), AfterValidator(_log_channel)]
DbcName = Annotated[str, Field(min_length=1, max_length=LONGEST_DBC_NAME), AfterValidator(_one_line)]
FilePath = Annotated[str, Field(min_length=1, max_length=LONGEST_PATH), AfterValidator(_one_line)]
Line = Annotated[str, Field(max_length=LONGEST_LINE), AfterValidator(_one_line)]
Prose = Annotated[str, Field(max_length=LONGEST_PROSE), AfterValidator(_prose)]
