"""Loads a YAML file as checked settings; every problem is reported with file and line."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from candaemon.config.base import CrossReferenceError, Location
from candaemon.config.settings import Config
from candaemon.config.settings_cache import CheckedConfigs
from candaemon.config.yaml_file import read_yaml_file
from candaemon.errors import MOST_PROBLEMS, ConfigError
from candaemon.files.bounded import FileReader, read_anything, read_bounded
from candaemon.files.entry_cache import cache_folder
from candaemon.printable import LONGEST_SHOWN, printable
from candaemon.similar_names import listed_names, meant, similar_names

SCHEMA_DIALECT = "https://json-schema.org/draft/2020-12/schema"


@dataclass(frozen=True, slots=True)
class LoadedConfig:
    """A configuration, with the line of each part in its YAML file.

    Attributes:
        config: the settings.
        path: the YAML file.
        lines: 1-based line of each key and list item.
        read: reads the files that the YAML names.

    """

    config: Config
    path: Path
    lines: Mapping[Location, int] = field(repr=False)
    read: FileReader = field(default=read_bounded, repr=False)

    def line_of(self, location: Location) -> int:
        """Return the line of the deepest part of a location that exists in the YAML; 1 if none does."""
        known = _existing(location, self.lines)
        return self.lines.get(known, 1)

    def resolve(self, relative: str) -> Path:
        """Return the path of a file named in the YAML, relative to the YAML's folder."""
        return self.path.parent / relative

    def error(self, location: Location, text: str) -> ConfigError:
        """Return the error for a problem at a location."""
        return ConfigError(f"{_dotted(location)}: {text}", file=self.path, line=self.line_of(location))


def load_config(path: Path, read: FileReader | None = None) -> LoadedConfig:
    """Load and check a configuration. DBC files are not opened here.

    Args:
        path: the YAML file.
        read: reads it, and the DBC files that are loaded for it; None: it may be a pipe, and they may not.

    Raises:
        ConfigError: names every problem with file, line, key, what was found and what was expected.

    """
    path = Path(path)
    text, folder = read_yaml_file(path, read or read_anything), cache_folder("config")
    before = None if folder is None else CheckedConfigs(folder, text)
    known = None if before is None else before.find()
    config, lines = known or _checked(text, path)
    if before is not None and known is None:
        before.keep(config, lines)
    return LoadedConfig(config, path, lines, read or read_bounded)


def _checked(text: str, path: Path) -> tuple[Config, dict[Location, int]]:
    """Return the settings of a YAML file's text, and the line of each key and item."""
    from candaemon.config.yaml_text import parse_yaml  # noqa: PLC0415  # a file that was checked before needs no parser

    data, lines = parse_yaml(text, path)
    try:
        # Strict: no conversion between text and numbers; `parse_yaml` returns tuples for lists.
        return Config.model_validate(data, strict=True), lines
    except ValidationError as error:
        raise join_problems(path, error, lines, _problems) from None


def join_problems(
    path: Path,
    error: ValidationError,
    lines: Mapping[Location, int],
    problems: Callable[[ErrorDetails, Mapping[Location, int]], Iterable[tuple[Location, str]]],
) -> ConfigError:
    """Return one error for all that pydantic found in a file, each problem on a line of its own.

    Args:
        path: the file.
        error: pydantic's.
        lines: 1-based line of each key and list item.
        problems: gives the (location, text) of one of pydantic's errors.
    """
    found = sorted(error.errors(include_url=False), key=lambda each: lines.get(_existing(each["loc"], lines), 1))
    told = sorted(
        {
            (lines.get(_existing(where, lines), 1), f"{_dotted(where)}: {text}")
            for details in found[:MOST_PROBLEMS]
            for where, text in problems(details, lines)
        }
    )
    first, *others = (ConfigError(text, file=path, line=line) for line, text in told)
    left_out = len(found) - MOST_PROBLEMS
    if left_out > 0:
        others.append(ConfigError(f"and {left_out:,} more", file=path))
    return ConfigError(first.message, file=path, line=first.line, others=others)


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of the configuration file, for editors."""
    return {"$schema": SCHEMA_DIALECT} | Config.model_json_schema(by_alias=True)


def _existing(location: Location, lines: Mapping[Location, int]) -> Location:
    """Return the deepest part of a location that exists in the YAML, without pydantic's extra steps (union tags)."""
    known: Location = ()
    for step in location:
        if (*known, step) in lines:
            known = (*known, step)
    return known


def _dotted(location: Location) -> str:
    """Return a location as text, such as `sensors.front.messages[0]`."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in location)
    return text.removeprefix(".") or "the file"


def _problems(details: ErrorDetails, lines: Mapping[Location, int]) -> Iterator[tuple[Location, str]]:
    """Convert one of pydantic's errors to (location, text)."""
    location = details["loc"]
    where = _existing(location, lines)
    found, context = details["input"], details.get("ctx", {})
    match details["type"]:
        case "missing":
            key = str(location[-1])
            about = _keys_at(location[:-1]).get(key, "")
            yield (*where, key), "missing" + (f"; expected: {about}" if about else "; add it")
        case "extra_forbidden":
            known = sorted(_keys_at(location[:-1]))
            yield (
                where,
                f"found an unknown key '{location[-1]}', expected one of {', '.join(known)}"
                + meant(str(location[-1]), known),
            )
        case "value_error" if isinstance(context.get("error"), CrossReferenceError):
            yield from (((*location, *place), text) for place, text in context["error"].problems)
        case "value_error":
            yield where, str(context.get("error", details["msg"]))
        case "too_short" if len(found) >= context["min_length"]:
            return  # one of its items is at fault, and told
        case "union_tag_not_found":
            key = context["discriminator"].strip("'")
            text = f"missing; it says which settings follow, expected one of {', '.join(_kinds_at(location)[1])}"
            instead = similar_names(key, [each for each in found if isinstance(each, str)])
            yield (*where, key), text + (f"; found '{instead[0]}', did you mean '{key}'?" if instead else "")
        case "union_tag_invalid":
            key = context["discriminator"].strip("'")
            tags = re.findall(r"'([^']+)'", context["expected_tags"])
            yield (
                (*where, key),
                f"found '{printable(str(context['tag']), LONGEST_SHOWN)}', expected one of {', '.join(tags)}"
                + meant(context["tag"], tags),
            )
        case "greater_than" | "greater_than_equal" | "less_than" | "less_than_equal":
            yield where, f"found {_shown(found)}, {_expected(details)}{_about(location)}"
        case "model_attributes_type":
            key, kinds = _kinds_at(location)
            text = f"found {_shown(found)}, expected a mapping with {key}, one of {', '.join(kinds)}"
            yield where, text + (_meant_kind(found, key, kinds) if isinstance(found, str) else "")
        case "model_type":
            yield where, f"found {_shown(found)}, expected a mapping of {listed_names(sorted(_keys_at(location)))}"
        case "tuple_type":
            hint = "; write [a, b], also of one" if isinstance(found, str | int | float | dict) else ""
            yield where, f"found {_shown(found)}, {_expected(details)}{hint}{_about(location)}"
        case "float_type" | "int_type" | "dict_type":
            yield where, f"found {_shown(found)}, {_expected(details)}{_about(location)}"
        case _:
            yield where, f"found {_shown(found)}, {_expected(details)}"


def _about(location: Location) -> str:
    """Return what the value at a location, or the list it is in, is, in parentheses; empty where nothing says so."""
    keys = location[:-1] if isinstance(location[-1], int) else location
    about = _keys_at(keys[:-1]).get(str(keys[-1]), "")
    return f" ({about})" if about else ""


def _meant_kind(found: str, key: str, kinds: Sequence[str]) -> str:
    """Return a suggestion where somebody wrote the kind of settings alone; empty where it is near to none."""
    near = similar_names(found, kinds)
    return f"; did you mean '{{{key}: {near[0]}}}'?" if near else ""


def _expected(details: ErrorDetails) -> str:
    """Return what was expected of a value, as text."""
    text = re.sub("^(Input|String|Tuple|Dictionary) should (be|have) ", "expected ", details["msg"])
    text = re.sub(" after validation, not .*", "", text)
    text = (
        text.replace("a valid string", "text")
        .replace("a valid tuple", "a list")
        .replace("a valid boolean", "true or false")
    )
    text = re.sub(r"a valid dictionary( or instance of \w+)?|an instance of \w+", "a mapping", text)
    found = details["input"]
    if details["type"] == "string_type" and isinstance(found, int | float):
        return f"{text}; write it in quotes"
    if isinstance(found, str):
        text += meant(found, re.findall(r"'([^']+)'", details["msg"]))
    return text[0].lower() + text[1:]


def _shown(value: object) -> str:
    """Return a value as text, as in the YAML."""
    match value:
        case None:
            return "nothing"
        case bool():
            return str(value).lower()
        case dict():
            return "a mapping"
        case tuple() | list():
            return f"a list of {len(value)}"
        case _:
            return printable(repr(value), LONGEST_SHOWN)


@cache
def _schema() -> dict[str, Any]:
    return json_schema()


def _keys_at(location: Location) -> dict[str, str]:
    """Return the keys that the settings at a location can have, with their descriptions."""
    return {
        key: str(schema.get("description", ""))
        for form in _forms_at(location)
        for key, schema in form.get("properties", {}).items()
    }


def _kinds_at(location: Location) -> tuple[str, list[str]]:
    """Return the key that says which kind of settings are at a location, and its values."""
    kinds = [
        (key, str(schema["const"]))
        for form in _forms_at(location)
        for key, schema in form.get("properties", {}).items()
        if "const" in schema
    ]
    return kinds[0][0], [kind for _, kind in kinds]


def _forms_at(location: Location) -> list[dict[str, Any]]:
    """Return the schemas of the settings that a location can have."""
    definitions = _schema()["$defs"]

    def forms(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
        if "$ref" in schema:
            yield from forms(definitions[schema["$ref"].rpartition("/")[2]])
        alternatives = schema.get("anyOf", []) + schema.get("oneOf", [])
        for alternative in alternatives:
            yield from forms(alternative)
        if not alternatives and "$ref" not in schema:
            yield schema

    here = list(forms(_schema()))
    for step in location:
        tagged = [form for form in here if step in _tags(form)]
        below = [form["properties"][str(step)] for form in here if str(step) in form.get("properties", {})]
        below += [form["additionalProperties"] for form in here if isinstance(form.get("additionalProperties"), dict)]
        below += [form["items"] for form in here if isinstance(step, int) and "items" in form]
        here = tagged or [form for schema in below for form in forms(schema)]
    return here


def _tags(form: dict[str, Any]) -> set[str]:
    """Return the values that identify one of several kinds of settings."""
    return {str(value["const"]) for value in form.get("properties", {}).values() if "const" in value}
