"""Objects written and read back, for every configured shape of radar."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.arrays import Booleans, Floats, Integers
from candaemon.binding.bind_sensor import bind_sensor_writer
from candaemon.binding.bound import BoundSensor
from candaemon.dbc.bits import sendable_values
from candaemon.objects.object_batch import ObjectBatch
from candaemon.objects.reader import BOUNDED
from candaemon.objects.writer import ObjectWriter
from tests.support.bound import binding
from tests.support.effort import examples

SENSORS = ("toyota_rav4", "esr_ins", "gm_lrr", "tesla_continental", "acura_ilx", "mando", "ars408")


def written(
    sensor: BoundSensor, seed: int, count: int
) -> tuple[ObjectWriter, ObjectBatch, dict[str, Floats], Integers, Booleans, Booleans]:
    """Write random objects within the sensor's ranges, some slots empty, and read them."""
    rng = np.random.default_rng(seed)
    reader, writer = sensor.reader, bind_sensor_writer(sensor)
    slot = np.sort(rng.choice(reader.slots, min(count, reader.slots), replace=False))
    occupied = rng.random(len(slot)) < 0.7
    new = rng.random(len(slot)) < 0.3
    values = {}
    for bound in reader.bindings:
        ends = sorted(bound.gain * end + bound.bias for end in sendable_values(bound.signal))
        if bound.quantity in BOUNDED:  # what is told as an end may lie beyond it
            step = abs(bound.gain * bound.signal.scale)
            ends = [ends[0] + step, ends[1] - step]
        low, high = (0.5, min(ends[1], 200.0)) if bound.quantity in {"x", "range"} else ends
        values[bound.quantity] = rng.uniform(low, high, len(slot))
    frames = writer.write(slot, values, occupied, counter=int(rng.integers(1000)), new=new)
    columns: list[list[bytes | None]] = [[] for _ in reader.layouts]
    for can_id, data in frames:
        part, routed = reader.routes[can_id]
        protector = sensor.protectors[part]
        assert protector is None or protector.verify(can_id, data)
        if routed < 0:
            assert reader.object_key(part, data) in {*slot.tolist(), 0}
        columns[part].append(data)
    return writer, reader.read(columns), values, slot, occupied, new


@pytest.mark.parametrize("name", SENSORS)
@settings(deadline=None, max_examples=examples(25))
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 64))
def test_objects_read_back_as_written(name: str, seed: int, count: int) -> None:
    sensor = binding(name).sensors[0]
    writer, batch, values, slot, occupied, new = written(sensor, seed, count)
    assert batch.valid.tolist() == occupied.tolist()
    assert batch.paired.all()
    if sensor.settings.objects.new:
        assert batch.new[occupied].tolist() == new[occupied].tolist()
    if sensor.settings.objects.identity is not None:
        assert batch.identity[occupied].tolist() == slot[occupied].tolist()
    for row, bound in enumerate(sensor.reader.bindings):
        step = abs(bound.gain * bound.signal.scale)
        error = np.abs(batch.values[row] - values[bound.quantity])[occupied]
        assert (error <= step * 0.500001).all(), bound.quantity
    assert writer.saturated == 0


@pytest.mark.parametrize("name", SENSORS)
def test_an_empty_scan_has_no_objects(name: str) -> None:
    reader = binding(name).sensors[0].reader
    batch = reader.read([[] for _ in reader.layouts])
    assert batch.values.shape == (len(reader.quantities), 0)
    assert not len(batch.valid)


def test_missing_messages() -> None:
    sensor = binding("toyota_rav4").sensors[0]
    frames = bind_sensor_writer(sensor).write(
        np.arange(3), {"x": np.full(3, 30.0), "score": np.full(3, 0.5)}, np.ones(3, np.bool_), counter=7
    )
    a, b = [data for _, data in frames[:3]], [data for _, data in frames[3:]]
    batch = sensor.reader.read([[a[0], None, a[2]], [None, b[1], b[2]]])
    score = sensor.reader.quantities.index("score")
    assert batch.valid.tolist() == [True, False, True]
    assert np.isnan(batch.values[score]).tolist() == [True, False, False]
    assert batch.values[score, 2] == pytest.approx(0.5)
    assert [counter(frame) for counter, frame in zip(sensor.counters, (a[0], b[0]), strict=True)] == [7, 7]


def test_messages_of_a_part_may_differ_in_length() -> None:
    sensor = binding("toyota_rav4").sensors[0]
    frames = bind_sensor_writer(sensor).write(
        np.arange(16), {"score": np.linspace(0, 1, 16)}, np.ones(16, np.bool_), counter=1
    )
    lengths = {can_id: len(data) for can_id, data in frames}
    assert [lengths[0x220 + slot] for slot in range(16)] == [8] * 8 + [6] * 8
    batch = sensor.reader.read([[data for _, data in frames[:16]], [data for _, data in frames[16:]]])
    assert batch.values[-1] == pytest.approx(np.linspace(0, 1, 16), abs=0.0051)


def test_unequal_pairs_are_found() -> None:
    sensor = binding("tesla_continental").sensors[0]
    writer = bind_sensor_writer(sensor)
    occupied = np.ones(2, np.bool_)
    first = writer.write(np.arange(2), {}, occupied, counter=0)
    second = writer.write(np.arange(2), {}, occupied, counter=1)
    batch = sensor.reader.read([[data for _, data in first[:2]], [first[2][1], second[3][1]]])
    assert batch.paired.tolist() == [True, False]


def test_values_out_of_range_saturate_and_count() -> None:
    sensor = binding("toyota_rav4").sensors[0]
    writer = bind_sensor_writer(sensor)
    values = {"x": np.array([400.0, 10.0]), "y": np.array([0.0, -90.0])}
    frames = writer.write(np.arange(2), values, np.ones(2, np.bool_), counter=0)
    assert writer.saturated == 2
    batch = sensor.reader.read([[data for _, data in frames[:2]], [data for _, data in frames[2:]]])
    assert batch.valid.all(), "an object out of range is brought to where it still reads valid"
    assert batch.values[0].tolist() == pytest.approx([254.99, 10.0])


def test_obstacles_carry_id_in_every_message_of_their_motion_and_wrap() -> None:
    output = binding("demo").output
    assert output is not None
    values = {"id": np.array([70]), "state": np.array([2]), "x": np.array([12.3]), "sensors": np.array([17])}
    frames = output.writer.write(np.array([4]), values, np.ones(1, np.bool_), counter=np.array([300]))
    names = ("OBSTACLE_04_A", "OBSTACLE_04_B", "OBSTACLE_04_C", "OBSTACLE_04_D")
    for (can_id, data), name in zip(frames, names, strict=True):
        assert output.database.by_id[can_id].name == name
        assert data[2] == 300 % 256
        assert name == names[-1] or data[3] & 0x3F == 70 % 64
    status = output.status
    assert status is not None
    can_id, data = status.write({"cycle": 258, "occupied": 40, "drops": 65537}, counter=5)
    assert (can_id, data[2], data[3], data[6]) == (status.message.can_id, 5, 2, 1)


def test_header_tells_and_counts() -> None:
    header = binding("gm_lrr").sensors[0].header
    assert header is not None
    can_id, data = header.write(13, 7)
    assert can_id == 0x460
    assert header.read(data) == (13, 7 % 4)
    assert header.period == 4
    assert header.read(header.write(99, 0)[1])[0] == 20, "a count beyond the signal's range is its greatest"


def test_sensors_are_bound_as_their_scans_close() -> None:
    assert len(binding("toyota_rav4").sensors[0].counters) == 2
    tesla = binding("tesla_continental").sensors[0]
    assert tesla.trigger_id == 0x45F
    assert tesla.trigger_id in tesla.reader.routes
    ars = binding("ars408").sensors[0]
    assert ars.can_ids == {0x60A, 0x60B, 0x60C, 0x60D}
    assert set(ars.reader.routes.values()) == {(0, -1), (1, -1), (2, -1)}


def test_obstacles_written_in_vendor_formats_read_back() -> None:
    """The output of one configuration is the input of another."""
    for writing, reading, given_as in (
        ("esr_to_ars408", "ars408", ("x", "y")),
        ("ars408_to_esr", "esr_ins", ("range", "azimuth")),
    ):
        output = binding(writing).output
        assert output is not None
        sensor = binding(reading).sensors[0]
        values = {given_as[0]: np.array([20.0, 30.0]), given_as[1]: np.array([0.1, -0.2]), "id": np.array([3, 5])}
        frames = output.writer.write(
            np.array([3, 5]), values, np.ones(2, np.bool_), counter=1, identity=np.array([3, 5])
        )
        columns: list[list[bytes | None]] = [[] for _ in sensor.reader.layouts]
        for can_id, data in frames:
            part, _ = sensor.reader.routes[can_id]
            columns[part].append(data)
        batch = sensor.reader.read(columns)
        assert batch.valid.all()
        for name in given_as:
            row = sensor.reader.quantities.index(name)
            assert batch.values[row] == pytest.approx(values[name], abs=0.11)
