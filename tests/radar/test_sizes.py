"""Sizes and headings that a sensor tells of its objects: used where they can be, counted where they cannot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml

from candaemon.arrays import Floats
from candaemon.binding.bind_signal import bind_signal
from candaemon.binding.location import SettingLocation
from candaemon.config.base import ObjectSignalRef
from candaemon.config.sensors import Mount, SensorSettings
from candaemon.dbc.types import SignalSpec
from candaemon.errors import ConfigError
from candaemon.objects.object_batch import ObjectBatch
from candaemon.objects.reader import LayoutReader, ObjectReader
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import Mounting
from candaemon.radar.scan import ScanCounts
from candaemon.radar.selection import LONGEST_BODY, WIDEST_BODY, Selection
from tests.support.bound import binding
from tests.support.builders import pose


def seen(mount: Mount | None = None, **told: list[float]) -> tuple[Detections, ScanCounts]:
    """Return the detections of ARS408 objects 20 m ahead, some quantities as told, and what was counted."""
    sensor, counts = binding("ars408").sensors[0], ScanCounts()
    quantities, n = sensor.reader.quantities, len(next(iter(told.values())))
    rows: dict[str, Floats] = {"x": np.full(n, 20.0)} | {name: np.array(column) for name, column in told.items()}
    values = np.array([rows.get(name, np.ones(n)) for name in quantities])
    every = np.ones(n, np.bool_)
    batch = ObjectBatch(np.arange(n), every, every, every, values)
    scan = Selection(sensor, counts).scan(0, batch, np.arange(n), 0)
    settings: SensorSettings = sensor.settings
    if mount is not None:
        settings = settings.model_copy(update={"mount": mount})
    assert np.shares_memory(batch.values, values)  # what was read is not written to
    np.testing.assert_array_equal(batch.values, [rows.get(name, np.ones(n)) for name in quantities])
    return Mounting(settings, quantities).detections(scan, pose(heading=1.0)), counts


def test_a_size_that_cannot_be_is_not_used_and_counted() -> None:
    told, counts = seen(length=[4.5, 0.0, -3.0, math.nan, 12.0], width=[1.8, 1e9, 2.0, math.nan, -0.1])
    np.testing.assert_array_equal(told.length, [4.5, math.nan, math.nan, math.nan, 12.0])
    np.testing.assert_array_equal(told.width, [1.8, math.nan, 2.0, math.nan, math.nan])
    assert counts.odd_sizes == 4  # where nothing was said nothing is odd


def test_a_size_has_a_largest() -> None:
    told, counts = seen(length=[LONGEST_BODY, LONGEST_BODY + 0.2], width=[WIDEST_BODY, WIDEST_BODY + 0.2])
    np.testing.assert_array_equal(told.length, [LONGEST_BODY, math.nan])
    np.testing.assert_array_equal(told.width, [WIDEST_BODY, math.nan])
    assert counts.odd_sizes == 2


@pytest.mark.parametrize(("name", "longest"), [("tesla_continental", 7.875), ("ars408", 51.0), ("acura_ilx", math.inf)])
def test_the_longest_that_can_be_told_is_the_end_of_the_signal(name: str, longest: float) -> None:
    assert binding(name).sensors[0].reader.longest == longest


def test_a_heading_is_turned_to_the_local_frame() -> None:
    told, _ = seen(Mount(yaw_deg=90.0), heading=[0.0, -3.0, math.nan, 3.0])
    assert told.heading is not None
    turned = 1.0 + math.pi / 2
    expected = [turned, turned - 3.0, math.nan, turned + 3.0 - 2 * math.pi]
    np.testing.assert_allclose(told.heading, expected, atol=1e-12)


def test_a_sensor_that_never_tells_has_none() -> None:
    sensor = binding("acura_ilx").sensors[0]
    mounting = Mounting(sensor.settings, sensor.reader.quantities)
    zero, one = np.zeros(1, np.int64), np.ones(1, np.bool_)
    batch = ObjectBatch(zero, one, one, one, np.ones((len(sensor.reader.quantities), 1)))
    told = mounting.detections(Selection(sensor, ScanCounts()).scan(0, batch, zero, 0), pose())
    assert (told.length, told.width, told.heading) == (None, None, None)


def signal(**given: float) -> SignalSpec:
    return SignalSpec(name="Size", start=0, length=8, scale=0.2, **given)  # type: ignore[arg-type]  # by name


@pytest.mark.parametrize("unknown", [51.2, -0.2, 0.1])
def test_what_says_unknown_must_be_a_value_of_the_signal(unknown: float) -> None:
    ref = ObjectSignalRef(signal="Size", unknown=unknown)
    with pytest.raises(ConfigError, match=r"'unknown' has .*'Size' cannot be; expected a value from 0 to 51"):
        bind_signal("length", ref, signal(), SettingLocation())


def test_codes_are_values_of_the_signal_and_of_a_class() -> None:
    codes = (0.0, 0.2, 0.4, 0.6, 0.8, 51.0)
    assert bind_signal("class", ObjectSignalRef(signal="Size", codes=codes), signal(), SettingLocation()).codes == codes
    with pytest.raises(ConfigError, match=r"'codes' has 51\.2, which signal 'Size' cannot be"):
        bind_signal("class", ObjectSignalRef(signal="Size", codes=(*codes[1:], 51.2)), signal(), SettingLocation())
    with pytest.raises(ConfigError, match="'codes' are values for classes, but 'Size' is length"):
        bind_signal("length", ObjectSignalRef(signal="Size", codes=codes), signal(), SettingLocation())


@pytest.mark.parametrize("unknown", [0.0, 0.6, 51.0])
def test_a_value_that_says_unknown_reads_as_no_number(unknown: float) -> None:
    bound = bind_signal("length", ObjectSignalRef(signal="Size", unknown=unknown), signal(), SettingLocation())
    assert bound.unknown == (unknown,)
    sensor = binding("acura_ilx").sensors[0]
    spec = replace(sensor.reader.layouts[0].messages[0], length=1, signals=(signal(),))
    layout = replace(sensor.reader.layouts[0], messages=(spec,))
    reader = ObjectReader(
        slots=1, multiplexed=False, readers=[LayoutReader(layout, ["Size"], [bound], (), ())], routes={}, pairs=(),
        identity=None,
    )  # fmt: skip
    raws = np.arange(256, dtype=np.uint8)
    values = reader.read([raws[:, None]]).values[0]
    assert np.flatnonzero(np.isnan(values)).tolist() == [round(unknown / 0.2)]


def test_the_shipped_ars408_tells_headings() -> None:
    settings = binding("ars408").sensors[0].settings.signals
    assert yaml.safe_load("[length, width, heading]") == [
        name for name in ("length", "width", "heading") if getattr(settings, name) is not None
    ]
