"""Which drives a fleet consists of: by logs, patterns and folders, or by a manifest."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from candaemon.can_io.logs.compression import COMPRESSIONS
from candaemon.can_io.logs.formats import LOG_SUFFIXES
from candaemon.config.shipped import find_config
from candaemon.errors import MOST_PROBLEMS, ConfigError, InputError
from candaemon.exports.extras import import_extra
from candaemon.files.bounded import read_bounded
from candaemon.fleet.locations import absolute, asked, beside, drives_at, file_system, is_local, local_path
from candaemon.printable import printable
from candaemon.similar_names import similar_names

LARGEST_MANIFEST: Final = 256 << 20
"""Longest manifest, bytes."""
MOST_DRIVES: Final = 1_000_000
"""Most drives of one run."""
LONGEST_NAME: Final = 150
"""Longest name of a drive, characters; it is part of the names of files."""
_NAME: Final = re.compile(r"[A-Za-z0-9_+][A-Za-z0-9_.+-]*")
_NO_NAME: Final = re.compile(r"[^A-Za-z0-9_.+-]")
_OWN_COLUMNS: Final = ("drive", "log", "configuration", "tags")


@dataclass(frozen=True, slots=True)
class FleetDrive:
    """A drive of a fleet.

    Attributes:
        name: unique in the fleet; letters, digits and `_.+-`.
        logs: locations; several are one drive.
        configuration: path of the YAML.
        tags: such as weather → rain.
    """

    name: str
    logs: tuple[str, ...]
    configuration: Path
    tags: Mapping[str, str] = field(default_factory=dict)


def drives_of(logs: Sequence[str], manifests: Sequence[str], configuration: Path) -> list[FleetDrive]:
    """Return all drives that are asked for.

    Args:
        logs: locations of logs, patterns, folders.
        manifests: locations of manifests.
        configuration: of drives that name none.

    Raises:
        ConfigError: there are none or too many, two have one name, or a manifest is wrong.
        InputError: something cannot be read.
    """
    found = [*_named(dict.fromkeys(each for log in logs for each in drives_at(absolute(log))), configuration)]
    for manifest in manifests:
        found += _listed(absolute(manifest), configuration)
    if not found:
        raise ConfigError("there is no drive; name logs, patterns, folders, or a --manifest")
    if len(found) > MOST_DRIVES:
        raise ConfigError(f"found {len(found):,} drives, expected {MOST_DRIVES:,} at most; make several runs of them")
    twice = [name for name, count in Counter(drive.name for drive in found).items() if count > 1]
    if twice:
        called = printable(", ".join(twice[:5]))
        raise ConfigError(f"two drives are called {called}; give each a name of its own in a manifest's column 'drive'")
    return found


def _named(locations: Iterable[str], configuration: Path) -> Iterator[FleetDrive]:
    """Yield a drive for each log: named by its file, with as many folders before it as tell it from others."""
    parts = {each: _parts(each) for each in locations}
    names = {each: part[-1] for each, part in parts.items()}
    for depth in range(2, max(map(len, parts.values()), default=0) + 1):
        counts = Counter(names.values())
        names = {each: name if counts[name] == 1 else "-".join(parts[each][-depth:]) for each, name in names.items()}
    for location, name in names.items():
        yield FleetDrive(_shortened(name), (location,), configuration)


def _parts(location: str) -> list[str]:
    *above, last = re.split(r"[/\\]+", location.partition("://")[2] or location)
    for suffixes in (COMPRESSIONS, LOG_SUFFIXES):
        for suffix in suffixes:
            last = last.removesuffix(suffix)
    parts = [_NO_NAME.sub("_", each) for each in (*above, last) if each]
    return [f"_{each}" if each[0] in ".-" else each for each in parts] or ["drive"]


def _shortened(name: str) -> str:
    """Return the end of a name, which says most, where it is too long."""
    return name if len(name) <= LONGEST_NAME else f"_{name[1 - LONGEST_NAME :]}"


def _listed(manifest: str, configuration: Path) -> list[FleetDrive]:
    """Return the drives of a manifest, a row each."""
    content = _content(manifest)
    rows = _parquet_rows(content, manifest) if manifest.lower().endswith(".parquet") else _csv_rows(content, manifest)
    drives, problems = [], []
    for line, row in rows:
        try:
            drives.append(_drive(row, manifest, configuration))
        except ConfigError as error:
            problems.append(ConfigError(error.message, file=manifest, line=line))
            if len(problems) > MOST_PROBLEMS:
                break
    if problems:
        first, *others = problems
        raise ConfigError(first.message, file=first.file, line=first.line, others=others)
    if not drives:
        raise ConfigError("it names no drive; expected a row for each", file=manifest)
    return drives


def _content(manifest: str) -> bytes:
    if is_local(manifest):
        try:
            return read_bounded(local_path(manifest), LARGEST_MANIFEST, special=True)
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}", file=manifest) from error
    system, path = file_system(manifest)
    with asked(manifest), system.open(path, "rb") as file:
        content: bytes = file.read(LARGEST_MANIFEST + 1)
    if len(content) > LARGEST_MANIFEST:
        raise InputError(f"it is longer than {LARGEST_MANIFEST:,} bytes, the most that is read", file=manifest)
    return content


def _csv_rows(content: bytes, manifest: str) -> Iterator[tuple[int, dict[str, str]]]:
    try:
        reader = csv.reader(io.StringIO(content.decode("utf-8-sig"), newline=""), strict=True)
        header = next(reader, [])
        _check_columns(header, manifest)
        for cells in reader:
            if not cells:
                continue
            if len(cells) != len(header):
                raise ConfigError(
                    f"found {len(cells)} cells, expected {len(header)} as in the header",
                    file=manifest,
                    line=reader.line_num,
                )
            yield reader.line_num, dict(zip(header, cells, strict=True))
    except (csv.Error, UnicodeDecodeError) as error:
        raise ConfigError(f"it is no CSV in UTF-8: {error}", file=manifest) from error


def _parquet_rows(content: bytes, manifest: str) -> Iterator[tuple[int, dict[str, str]]]:
    arrow = import_extra("pyarrow", "fleet", "a manifest in Parquet")
    parquet = import_extra("pyarrow.parquet", "fleet", "a manifest in Parquet")
    try:
        table = parquet.read_table(io.BytesIO(content))
    except (arrow.ArrowException, OSError) as error:
        raise ConfigError(f"it is no Parquet: {error}", file=manifest) from error
    _check_columns(table.column_names, manifest)
    for number, row in enumerate(table.to_pylist(), 1):
        yield number, {key: "" if value is None else str(value) for key, value in row.items()}


def _check_columns(names: Sequence[str], manifest: str) -> None:
    if "log" not in names:
        raise ConfigError(
            f"found the columns {', '.join(names) or 'none'}, expected 'log', and as you like 'drive', "
            f"'configuration', 'tags' and tags of your own{_renamed(names)}",
            file=manifest,
            line=1,
        )
    if len(set(names)) != len(names):
        raise ConfigError("a column is there twice", file=manifest, line=1)


def _renamed(names: Sequence[str]) -> str:
    """Return which column is to be renamed to 'log', to follow a message; empty where none is like it."""
    near = similar_names("log", list(names))
    return f"; rename '{near[0]}' to 'log'" if near else ""


def _drive(row: Mapping[str, str], manifest: str, configuration: Path) -> FleetDrive:
    """Return the drive of a row; relative paths start from the manifest's folder.

    Raises:
        ConfigError: it is not what is expected.
    """
    logs = tuple(beside(manifest, each.strip()) for each in row["log"].split(";") if each.strip())
    if not logs:
        raise ConfigError("'log' is empty; expected a location, or several with ; between")
    name = row.get("drive", "").strip() or _shortened(_parts(logs[0])[-1])
    if not _NAME.fullmatch(name) or len(name) > LONGEST_NAME:
        raise ConfigError(
            f"drive: found '{printable(name)}', expected letters, digits and _.+- (no . or - first), "
            f"{LONGEST_NAME} characters at most"
        )
    named = row.get("configuration", "").strip()
    if named:
        own = Path(beside(manifest, named))
        configuration = find_config(own if own.exists() else Path(named))
    tags = {key: value.strip() for key, value in row.items() if key not in _OWN_COLUMNS and value.strip()}
    for each in filter(None, (part.strip() for part in row.get("tags", "").split(";"))):
        key, sign, value = (part.strip() for part in each.partition("="))
        if not (key and sign and value):
            raise ConfigError(f"tags: found '{printable(each)}', expected key=value with ; between, as weather=rain")
        tags[key] = value
    return FleetDrive(name, logs, configuration, tags)
