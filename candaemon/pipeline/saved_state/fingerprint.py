"""What a state belongs to: the settings and DBC files that decide what the same frames lead to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import Any, Final, TypeAlias

from candaemon.binding.bound import Binding
from candaemon.dbc.database_bytes import LONGEST_FILE
from candaemon.files.bounded import read_bounded
from candaemon.printable import printable

Fingerprint: TypeAlias = Mapping[str, str]
"""Each setting by its dotted name, as text, and the digest of each DBC file."""


LONGEST_FINGERPRINT: Final = 1 << 17
"""Characters of all its names and values; of a longer one its digest stands in the header, which has so room for it."""

_ONLY_NAMED = frozenset({"name", "description", "service"})
_SHOWN = 3
_LONGEST = 100  # characters of a name or value that is shown


def fingerprint(binding: Binding) -> Fingerprint:
    """Return what decides what the frames of a recording lead to.

    Names of files and channels, bit rates and the service's own settings are left out: they may differ where a
    recording is replayed. A DBC file that is gone since it was loaded counts as one of its own.
    """
    settings = binding.settings.dumped()
    settings["buses"] = list(settings["buses"])
    found = {key: value for key, value in _flat(settings, ()) if key.split(".")[0] not in _ONLY_NAMED}
    for path in map(Path, binding.databases):
        key = f"DBC {path.name}"
        while key in found:  # of another folder
            key += "'"
        try:
            found[key] = sha256(read_bounded(path, LONGEST_FILE)).hexdigest()[:16]
        except OSError:
            found[key] = "unreadable"
    if sum(len(key) + len(value) for key, value in found.items()) > LONGEST_FINGERPRINT:
        return {"all settings together": digest(found)}
    return found


def digest(of: Fingerprint) -> str:
    """Return a fingerprint's short name."""
    return sha256("\n".join(f"{key}: {value}" for key, value in sorted(of.items())).encode()).hexdigest()[:12]


def differences(recorded: Fingerprint, here: Fingerprint) -> str:
    """Say what differs, the first few; empty where nothing does."""
    keys = [key for key in {**recorded, **here} if recorded.get(key) != here.get(key)]
    shown = [
        f"{printable(key, _LONGEST)} was {printable(recorded.get(key, 'not set'), _LONGEST)},"
        f" is {printable(here.get(key, 'not set'), _LONGEST)}"
        for key in islice(keys, _SHOWN)
    ]
    more = f", and {len(keys) - _SHOWN} more" if len(keys) > _SHOWN else ""
    return "; ".join(shown) + more


def _flat(value: Any, at: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yield each setting with its dotted name; the paths of DBC files are left out."""
    if isinstance(value, Mapping):
        for key, each in value.items():
            if key != "dbc":
                yield from _flat(each, (*at, str(key)))
    elif isinstance(value, list | tuple):
        for k, each in enumerate(value):
            yield from _flat(each, (*at, str(k)))
    else:
        yield ".".join(at), str(value)
