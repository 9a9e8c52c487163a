"""Reads YAML text into plain values and records the line of every key and item.

Scalars are read as YAML 1.2 does: `on`, `no` and `12:30` are text, `1e-3` is a number. A key is always text.
Beyond it, hexadecimal numbers may have a sign, as differences of identifiers do: `-0x10`.

A text of a few lines can stand for more values than a memory holds, by aliases and merges, and for more levels than a
program can follow. So values and levels are counted as they come, those that an alias repeats as often as it does.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from yaml.reader import ReaderError

from candaemon.config.base import Location
from candaemon.config.yaml_file import read_yaml_file
from candaemon.errors import ConfigError
from candaemon.files.bounded import FileReader, read_anything
from candaemon.printable import LONGEST_SHOWN, printable

MOST_NODES: Final = 20_000
"""Most keys, values, lists and mappings in a file, each as often as aliases and merges repeat it."""
MOST_LEVELS: Final = 32
"""Most levels of lists and mappings, those that aliases and merges lead to among them."""
LONGEST_KEY: Final = 200
"""Longest key, characters."""
LONGEST_NUMBER: Final = 100
"""Longest number, characters."""

TAG = "tag:yaml.org,2002:"


class _Limits:
    """What a YAML text has used of its limits.

    Attributes:
        nodes: so far.
        level: of lists and mappings, of the node at hand.
    """

    def __init__(self) -> None:
        self.nodes = 0
        self.level = 0

    def exceeded(self) -> str:
        """Count a node; return what is wrong with it, empty for nothing."""
        self.nodes += 1
        if self.nodes > MOST_NODES:
            return f"more than {MOST_NODES:,} keys and values, those that aliases repeat among them; write less"
        if self.level >= MOST_LEVELS:
            return f"more than {MOST_LEVELS} levels of lists and mappings; nest less"
        return ""


class _CoreLoader(yaml.SafeLoader):
    """PyYAML's safe loader with YAML 1.2's core schema for plain scalars, and with limits."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._limits = _Limits()

    def compose_node(self, parent: Node | None, index: Any) -> Node | None:
        """Compose a node as PyYAML does, within the limits."""
        exceeded = self._limits.exceeded()
        if exceeded:
            raise yaml.MarkedYAMLError(problem=exceeded, problem_mark=self.get_mark())
        self._limits.level += 1
        node = super().compose_node(parent, index)
        self._limits.level -= 1
        return node


_CoreLoader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?[0-9]+|[-+]?0x[0-9a-fA-F]+|0o[0-7]+", list("-+0123456789")),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", list("-+.0123456789")),
    ("float", r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", list("-+.")),
    ("merge", "<<", ["<"]),
):
    _CoreLoader.add_implicit_resolver(TAG + _tag, re.compile(rf"^(?:{_pattern})$"), _first)


class _Builder:
    """Builds plain values from YAML nodes, and the map from key path to line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines: dict[Location, int] = {}
        self._open: set[int] = set()
        self._limits = _Limits()

    def build(self, node: Node, location: Location) -> Any:
        """Build one node's value: dict, tuple or scalar."""
        exceeded = self._limits.exceeded()
        if exceeded:
            raise self._error(node, exceeded)
        if isinstance(node, ScalarNode):
            return self._scalar(node)
        if id(node) in self._open:
            raise self._error(node, "an alias refers to the mapping or list it is in; write the value out")
        if node.tag not in {TAG + "map", TAG + "seq"}:
            raise self._foreign(node)
        self._open.add(id(node))
        self._limits.level += 1
        value = self._mapping(node, location) if isinstance(node, MappingNode) else self._sequence(node, location)
        self._limits.level -= 1
        self._open.discard(id(node))
        return value

    def _sequence(self, node: Node, location: Location) -> tuple[Any, ...]:
        items = []
        for position, item in enumerate(node.value if isinstance(node, SequenceNode) else ()):
            self.lines[*location, position] = _line(item)
            items.append(self.build(item, (*location, position)))
        return tuple(items)

    def _mapping(self, node: MappingNode, location: Location) -> dict[str, Any]:
        merged: dict[str, Any] = {}
        values: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, ScalarNode):
                raise self._error(key_node, "found a mapping or list as a key, expected text")
            if key_node.tag == TAG + "merge":
                # A merged key never overrides, and of several merges the first wins.
                for source in value_node.value if isinstance(value_node, SequenceNode) else [value_node]:
                    source_values = self.build(source, location)
                    if not isinstance(source_values, dict):
                        raise self._error(source, "found a merge '<<' of something that is not a mapping")
                    for key, value in source_values.items():
                        merged.setdefault(key, value)
                continue
            key = key_node.value
            if len(key) > LONGEST_KEY:
                raise self._error(key_node, f"found a key of {len(key):,} characters, expected {LONGEST_KEY} at most")
            if key in values:
                first = self.lines[*location, key]
                raise self._error(key_node, f"key '{key}' is there twice, first in line {first}; remove one")
            self.lines[*location, key] = _line(key_node)
            values[key] = self.build(value_node, (*location, key))
        return merged | values

    def _scalar(self, node: ScalarNode) -> Any:
        text: str = node.value
        kind = node.tag.removeprefix(TAG)
        if kind in {"int", "float"} and len(text) > LONGEST_NUMBER:
            raise self._error(
                node, f"found a number of {len(text):,} characters, expected {LONGEST_NUMBER} at most; shorten it"
            )
        try:
            match kind:
                case "str":
                    return text
                case "null":
                    return None
                case "bool":
                    return text.lower() == "true"
                case "int":
                    return int(text, 0) if text.lower().lstrip("-+").startswith(("0x", "0o")) else int(text)
                case "float":
                    return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        except ValueError:
            raise self._error(node, f"found '{text}', expected a number ({kind})") from None
        raise self._foreign(node)

    def _foreign(self, node: Node) -> ConfigError:
        tag = printable(node.tag, LONGEST_SHOWN)
        return self._error(node, f"found the tag '{tag}', expected plain values only; remove the tag")

    def _error(self, node: Node, text: str) -> ConfigError:
        return ConfigError(text, file=self.path, line=_line(node))


def _line(node: Node) -> int:
    """1-based line on which a node starts."""
    return int(node.start_mark.line) + 1


def read_yaml(path: Path, read: FileReader = read_anything) -> tuple[dict[str, Any], dict[Location, int]]:
    """Read a YAML file whose root is a mapping.

    Args:
        path: the file, UTF-8.
        read: reads it.

    Returns:
        The values (lists as tuples), and the 1-based line of each key and list item by its location.

    Raises:
        ConfigError: the file does not exist, is not UTF-8 or YAML, exceeds a limit, repeats a key, or is not a mapping.

    """
    return parse_yaml(read_yaml_file(path, read), path)


def parse_yaml(text: str, path: Path) -> tuple[dict[str, Any], dict[Location, int]]:
    """Return what `read_yaml` does of a file's text.

    Args:
        text: of the file.
        path: the file, for messages.

    Raises:
        ConfigError: as for `read_yaml`.
    """
    root = _composed(text, path)
    if not isinstance(root, MappingNode):
        raise ConfigError("expected a mapping with buses, ego and sensors", file=path, line=1)
    builder = _Builder(path)
    return builder.build(root, ()), builder.lines


_LINE_END: Final = re.compile("\r\n|[\r\n\x85\u2028\u2029]")
"""What ends a line for PyYAML, which counts them."""
_BARE: Final = re.compile(r"""[\w}]\{(slot|point|object)[^}]*\}(?![^"']*["'])""")
"""A number's place in a name that stands without quotes."""
_MOST_LOOKED_AT: Final = 1000
"""Characters of a line in which that is looked for: the time grows with their square."""


def _composed(text: str, path: Path) -> Node | None:
    """Return the root of a YAML text."""
    try:
        loader = _CoreLoader(text)
    except ReaderError as error:
        line: int | None = len(_LINE_END.split(text[: error.position]))
        raise ConfigError(f"not valid YAML: the character U+{error.character:04X}", file=path, line=line) from None
    try:
        return loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = printable(error.problem or error.context or "", LONGEST_SHOWN)
        line = None if mark is None else mark.line + 1
        hint = "; indent with spaces" if "\\t" in problem else ""
        if line is not None and _BARE.search(_LINE_END.split(text)[line - 1][:_MOST_LOOKED_AT]):
            hint = '; a name with {…} is text in quotes, such as "TRACK_{slot}"'
        raise ConfigError(f"not valid YAML: {problem}{hint}", file=path, line=line) from None
    except (ValueError, OverflowError):  # PyYAML converts the numbers of `\U` and `%YAML` as they are
        raise ConfigError("not valid YAML: a number that is too large", file=path, line=loader.line + 1) from None
