"""Reads YAML text into plain values and records the line of every key and item.

Scalars are read as YAML 1.2 does: `on`, `no` and `12:30` are text, `1e-3` is a number. A key is always text.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from candaemon.config.settings import Location
from candaemon.errors import ConfigError

TAG = "tag:yaml.org,2002:"


class _CoreLoader(yaml.SafeLoader):
    """PyYAML's safe loader with YAML 1.2's core schema for plain scalars."""


_CoreLoader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?[0-9]+|0x[0-9a-fA-F]+|0o[0-7]+", list("-+0123456789")),
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

    def build(self, node: Node, location: Location) -> Any:
        """Build one node's value: dict, tuple or scalar."""
        if isinstance(node, ScalarNode):
            return self._scalar(node)
        if id(node) in self._open:
            raise self._error(node, "an alias refers to the mapping or list it is in; write the value out")
        if node.tag not in {TAG + "map", TAG + "seq"}:
            raise self._foreign(node)
        self._open.add(id(node))
        try:
            if isinstance(node, MappingNode):
                return self._mapping(node, location)
            return self._sequence(node, location)
        finally:
            self._open.discard(id(node))

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
                    merged = source_values | merged
                continue
            key = key_node.value
            if key in values:
                first = self.lines[*location, key]
                raise self._error(key_node, f"key '{key}' is there twice, first in line {first}; remove one")
            self.lines[*location, key] = _line(key_node)
            values[key] = self.build(value_node, (*location, key))
        return merged | values

    def _scalar(self, node: ScalarNode) -> Any:
        text: str = node.value
        kind = node.tag.removeprefix(TAG)
        try:
            match kind:
                case "str":
                    return text
                case "null":
                    return None
                case "bool":
                    return text.lower() == "true"
                case "int":
                    return int(text, 0) if text.lower().startswith(("0x", "0o")) else int(text)
                case "float":
                    return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        except ValueError:
            raise self._error(node, f"found '{text}', expected a number ({kind})") from None
        raise self._foreign(node)

    def _foreign(self, node: Node) -> ConfigError:
        return self._error(node, f"found the tag '{node.tag}', expected plain values only; remove the tag")

    def _error(self, node: Node, text: str) -> ConfigError:
        return ConfigError(text, file=self.path, line=_line(node))


def _line(node: Node) -> int:
    """1-based line on which a node starts."""
    return int(node.start_mark.line) + 1


def read_yaml(path: Path) -> tuple[dict[str, Any], dict[Location, int]]:
    """Read a YAML file whose root is a mapping.

    Args:
        path: the file, UTF-8.

    Returns:
        The values (lists as tuples), and the 1-based line of each key and list item by its location.

    Raises:
        ConfigError: the file does not exist, is not UTF-8 or YAML, repeats a key, or is not a mapping.

    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError("no such configuration file; check the path", file=path) from None
    except IsADirectoryError:
        raise ConfigError("this is a folder; expected a YAML file", file=path) from None
    except UnicodeDecodeError as error:
        before = error.object[: error.start].count(b"\n")
        raise ConfigError("the text is not UTF-8; save it as UTF-8", file=path, line=before + 1) from None
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=path) from None
    try:
        root = yaml.compose(text, Loader=_CoreLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = error.problem or error.context or "not YAML"
        hint = "; indent with spaces" if "\\t" in problem else ""
        line = None if mark is None else mark.line + 1
        raise ConfigError(f"not valid YAML: {problem}{hint}", file=path, line=line) from None
    except yaml.YAMLError as error:
        raise ConfigError(f"not valid YAML: {error}", file=path) from None
    if not isinstance(root, MappingNode):
        raise ConfigError("expected a mapping with buses, ego and sensors", file=path, line=1)
    builder = _Builder(path)
    return builder.build(root, ()), builder.lines
