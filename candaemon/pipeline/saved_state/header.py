"""The first line of a stored state: of which version, configuration and moment it is, as JSON."""

from __future__ import annotations

import json
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, Final

from candaemon._version import __version__
from candaemon.errors import InputError
from candaemon.pipeline.saved_state.codec import MOST_BYTES
from candaemon.pipeline.saved_state.fingerprint import Fingerprint, differences
from candaemon.printable import printable

_FORMAT: Final = "candaemon state 2"
LONGEST_HEADER: Final = 1 << 20
"""Bytes of the first line, its end included."""
_LONGEST_VERSION: Final = 40  # characters that are shown


@dataclass(frozen=True, slots=True)
class StateHeader:
    """What a state says of itself.

    Attributes:
        fingerprint: of the configuration.
        structure: digest of what a state is made of.
        begins: why a recording's file begins with it: `start`, `rotation`, `gap` or `reload`; empty elsewhere.
        follows: name of the file at whose end it was; empty where there is none.
        time_ns: of the first item after it.
        version: of candaemon.
    """

    fingerprint: Fingerprint
    structure: str
    begins: str
    follows: str
    time_ns: int
    version: str = __version__

    def written(self, content: bytes) -> bytes:
        """Return the header and the content after it."""
        line = {
            "format": _FORMAT,
            "version": self.version,
            "structure": self.structure,
            "begins": self.begins,
            "follows": self.follows,
            "time_ns": self.time_ns,
            "sha256": sha256(content).hexdigest(),
            "configuration": dict(self.fingerprint),
        }
        return json.dumps(line).encode() + b"\n" + content

    def require(self, fingerprint: Fingerprint, structure: str) -> None:
        """Refuse a state of something else.

        Raises:
            InputError: it is of another version or configuration; says what differs.
        """
        cure = "replay it with --fresh to do without the state"
        if self.version != __version__:
            version = printable(self.version, _LONGEST_VERSION)
            raise InputError(f"the state is of candaemon {version}, this is {__version__}; use that one, or {cure}")
        differs = differences(self.fingerprint, fingerprint)
        if differs:
            raise InputError(
                f"the state is of another configuration ({differs}); use the one kept beside the recording, or {cure}"
            )
        if self.structure != structure:
            raise InputError(f"the state is of another build of candaemon {self.version}; use that one, or {cure}")


def split(data: bytes) -> tuple[StateHeader, memoryview]:
    """Return a stored state's header and content, which is not copied.

    Raises:
        InputError: it is damaged, or none.
    """
    if len(data) > MOST_BYTES:
        raise InputError(f"the state has more than {MOST_BYTES} bytes, and no state has; use --fresh to do without")
    line = data[:LONGEST_HEADER].partition(b"\n")[0]
    content = memoryview(data)[len(line) + 1 :]
    header, digest = _read(line)
    if sha256(content).hexdigest() != digest:
        raise InputError("the state is damaged: its content is not what its first line says; use --fresh")
    return header, content


def header_of(data: bytes) -> StateHeader:
    """Return a stored state's header; the content may be missing.

    Raises:
        InputError: it is damaged, or none.
    """
    return _read(data.partition(b"\n")[0])[0]


def _is_text(value: object) -> bool:
    """Return whether a value is text that can be written as UTF-8."""
    return isinstance(value, str) and not any("\ud800" <= letter <= "\udfff" for letter in value)


def _read(line: bytes) -> tuple[StateHeader, str]:
    """Return the header in a line and the digest of what follows."""
    cause: Exception | None = None
    try:
        found: Any = json.loads(line) if len(line) < LONGEST_HEADER else None
        if found["format"] != _FORMAT:
            raise InputError(f"found {str(found['format'])[:40]!r}, expected '{_FORMAT}'; use --fresh to do without")
        texts = [found[key] for key in ("structure", "begins", "follows", "version", "sha256")]
        configuration, time_ns = found["configuration"], found["time_ns"]
        if all(map(_is_text, (*texts, *configuration, *configuration.values()))) and type(time_ns) is int:
            structure, begins, follows, version, digest = texts
            return StateHeader(configuration, structure, begins, follows, time_ns, version), digest
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        cause = error
    raise InputError("it is no stored state, or a damaged one; use --fresh to do without") from cause
