"""Numbers in a configuration or scenario: each has a least and a greatest value, and none is next to nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from candaemon.config.base import SignalRef
from candaemon.config.load import json_schema
from candaemon.config.numbers import LARGEST_FACTOR, LARGEST_SIGNAL, SMALLEST, SignalValue
from candaemon.simulation.scenario import Scenario
from tests.config.test_load import MINIMAL, loaded, problems

LEAST, GREATEST = {"minimum", "exclusiveMinimum"}, {"maximum", "exclusiveMaximum"}


def _numbers(schema: Any, place: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield each form of a number in a schema, with its place."""
    if isinstance(schema, list):
        for each in schema:
            yield from _numbers(each, place)
    elif isinstance(schema, dict):
        if schema.get("type") in {"number", "integer"} and not schema.keys() & {"const", "enum"}:
            yield place, schema
        for key, each in schema.items():
            if key != "default":
                yield from _numbers(each, f"{place}.{key}")


@pytest.mark.parametrize("schema", [json_schema(), Scenario.model_json_schema()], ids=["configuration", "scenario"])
def test_every_number_has_a_least_and_a_greatest_value(schema: dict[str, Any]) -> None:
    found = list(_numbers(schema))
    assert len(found) > 50
    assert [place for place, form in found if not (form.keys() & LEAST and form.keys() & GREATEST)] == []
    bounds = [abs(form[key]) for _, form in found for key in form.keys() & (LEAST | GREATEST)]
    assert max(bounds) <= LARGEST_SIGNAL


@pytest.mark.parametrize("number", ["1e300", "-1e300", ".inf", ".nan", "1e-300", "-5e-324", "9" * 90])
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("cycle_time: 0.05", "cycle_time: {}"),
        ("x: 0.2", "x: {}"),
        ("x: DistX", "x: {{signal: DistX, scale: {}}}"),
        ("x: DistX", "x: {{signal: DistX, offset: {}}}"),
        ("in: [1]", "in: [1, {}]"),
        ("in: [1]", "min: {}"),
        ("slots: 16", "slots: 16, first: {}"),
        ("slots: 16", "slots: 16, empty: {{Valid: {}}}"),
        ("channel: can0", "channel: can0, bitrate: {}"),
        ("channel: can0", "interface: pcan, channel: a, options: {{x: {}}}"),
        ("ego: ", "tracker: {{estimator: {{kind: cv, noise: {}}}}}\nego: "),
        ("ego: ", "service: {{metrics: {{buckets: [{}]}}}}\nego: "),
        ("ego: ", "service: {{recording: {{events: {{obstacles: [{}]}}}}}}\nego: "),
    ],
)
def test_an_absurd_number_is_refused_with_its_line(tmp_path: Path, old: str, new: str, number: str) -> None:
    found = problems(tmp_path, MINIMAL.replace(old, new.format(number), 1))
    assert all("expected" in line for line in found), found


def test_a_signals_value_may_be_as_large_as_a_float_of_32_bits() -> None:
    value = TypeAdapter[float](SignalValue)
    for good in (LARGEST_SIGNAL, -LARGEST_SIGNAL, 2.0**64, 3.4028235e38):
        assert value.validate_python(good) == good
    with pytest.raises(ValidationError):
        value.validate_python(1.001 * LARGEST_SIGNAL)


def test_a_scale_has_a_magnitude_within_its_limits(tmp_path: Path) -> None:
    for good in (LARGEST_FACTOR, -LARGEST_FACTOR, SMALLEST, -SMALLEST):
        assert SignalRef(signal="x", scale=good, offset=good).scale == good
    for bad in (1.001 * LARGEST_FACTOR, 0.999 * SMALLEST):
        with pytest.raises(ValidationError):
            SignalRef(signal="x", scale=bad)
    (told,) = problems(tmp_path, MINIMAL.replace("x: DistX", "x: {signal: DistX, offset: 9e-13}"))
    assert told == ":10: sensors.front.signals.x.offset: found 9e-13, expected 0 or a magnitude of at least 1e-12"
    assert loaded(tmp_path, MINIMAL.replace("x: DistX", "x: {signal: DistX, offset: 0}")).config.name == ""
