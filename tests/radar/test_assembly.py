"""Frames into scans: any order, lost, repeated, short and late frames, whatever closes the scan."""

from __future__ import annotations

import dataclasses
import gzip
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.frames.times import NEVER_NS
from candaemon.radar.assembler_factory import make_assembler
from tests.support.effort import examples
from tests.support.scan_frames import KINDS, UNMARKED, Sent, cycle, run, same, sensor, timed, whole


@pytest.mark.parametrize("kind", KINDS)
def test_a_cycle_makes_a_scan_of_its_valid_objects(kind: str) -> None:
    scan = whole(kind, 3)
    assert scan.slot.tolist() == list(range(9))
    assert scan.complete
    assert scan.sensor == 0
    assert np.flatnonzero(scan.new).tolist() == ([3] if sensor(kind).settings.objects.new else [])
    row = [name in ("x", "range") for name in sensor(kind).reader.quantities].index(True)
    assert scan.values[row] == pytest.approx(20.0 + np.arange(9) + 3, abs=0.26)


@pytest.mark.parametrize("kind", KINDS)
@settings(deadline=None, max_examples=examples(15))
@given(random=st.randoms(use_true_random=False))
def test_any_order_gives_the_same_scans(kind: str, random: Random) -> None:
    frames: list[Sent] = []
    for number in range(4):
        order = list(cycle(kind, number))
        last = [order.pop()] if kind in ("trigger", "tesla_continental") else []
        random.shuffle(order)
        frames += timed(kind, number, order + last)
    assembler = make_assembler(sensor(kind))
    scans = run(assembler, frames)
    assert len(scans) == 4
    assert all(same(scan, whole(kind, number)) and scan.complete for number, scan in enumerate(scans))
    assert assembler.counts.used == assembler.counts.frames == len(frames)
    assert assembler.counts.scans == 4
    assert assembler.deadline_ns == NEVER_NS


FATES = st.sampled_from(["kept"] * 12 + ["lost", "lost", "twice", "short", "late"])


@pytest.mark.parametrize("kind", KINDS)
@settings(deadline=None, max_examples=examples(25))
@given(data=st.data())
def test_every_frame_is_accounted_for(kind: str, data: st.DataObject) -> None:
    frames: list[Sent] = []
    stragglers: list[tuple[int, bytes]] = []
    for number in range(5):
        now: list[tuple[int, bytes]] = stragglers
        stragglers = []
        for can_id, payload in cycle(kind, number):
            match data.draw(FATES):
                case "kept":
                    now.append((can_id, payload))
                case "twice":
                    now += [(can_id, payload)] * 2
                case "short":
                    now.append((can_id, payload[:-1]))
                case "late":
                    stragglers.append((can_id, payload))
        frames += timed(kind, number, now)
    assembler = make_assembler(sensor(kind))
    scans = run(assembler, frames)
    counts = assembler.counts
    assert counts.frames == len(frames)
    assert counts.scans == len(scans)
    assert counts.incomplete == sum(not scan.complete for scan in scans)
    assert counts.missing == sum(scan.missing for scan in scans)
    assert counts.short == sum(len(payload) < _length(kind, can_id) for _, can_id, payload in frames)
    for scan in scans:
        assert np.isfinite(scan.values[:2]).all()
        assert len(set(scan.slot.tolist())) == len(scan.slot)


def _length(kind: str, can_id: int) -> int:
    return sensor(kind).database.by_id[can_id].length


@pytest.mark.parametrize("kind", UNMARKED)
@settings(deadline=None, max_examples=examples(25))
@given(data=st.data())
def test_a_lost_frame_costs_only_its_object(kind: str, data: st.DataObject) -> None:
    frames: list[Sent] = []
    lost_of = []
    for number in range(4):
        order = list(cycle(kind, number))
        lost = data.draw(st.sets(st.integers(0, len(order) - 1), max_size=len(order) - 1))
        kept = data.draw(st.permutations([frame for k, frame in enumerate(order) if k not in lost]))
        frames += timed(kind, number, kept)
        lost_of.append({order[k][0] for k in lost})
    scans = run(make_assembler(sensor(kind)), frames)
    routes, required = sensor(kind).reader.routes, {p.index for p in sensor(kind).reader.layouts if not p.optional}
    assert len(scans) == 4
    for number, (scan, lost_ids) in enumerate(zip(scans, lost_of, strict=True)):
        gone = {routes[can_id][1] for can_id in lost_ids if routes[can_id][0] in required}
        reference = whole(kind, number)
        keep = [slot not in gone for slot in reference.slot.tolist()]
        assert scan.slot.tolist() == reference.slot[keep].tolist()
        assert np.array_equal(scan.values[:2], reference.values[:2, keep])
        assert scan.missing <= len(lost_ids)
        if required == {part.index for part in sensor(kind).reader.layouts}:
            assert scan.missing == len(lost_ids)


def test_a_scan_is_closed_by_its_last_frame_or_by_time() -> None:
    assembler = make_assembler(sensor("esr_ins"))
    *frames, last = timed("esr_ins", 0, cycle("esr_ins", 0))
    for time_ns, can_id, payload in frames:
        receive, part, slot = assembler.routes[can_id]
        assert receive(part, slot, payload, time_ns) is None
    assert assembler.deadline_ns == frames[0].time_ns + assembler.timeout_ns
    assert assembler.expire(assembler.deadline_ns - 1) is None
    scan = assembler.expire(assembler.deadline_ns)
    assert scan is not None
    assert scan.missing == 1
    receive, part, slot = assembler.routes[last.can_id]
    assert receive(part, slot, last.data, last.time_ns) is None
    assert assembler.counts.late == 1
    assert assembler.flush() is None


def test_a_one_bit_counter_survives_a_lost_cycle() -> None:
    frames = [sent for number in (0, 2, 4) for sent in timed("esr_ins", number, cycle("esr_ins", number))]
    assert [scan.complete for scan in run(make_assembler(sensor("esr_ins")), frames)] == [True] * 3


def test_a_wrong_checksum_is_not_used() -> None:
    frames = [
        (can_id, bytes([payload[0], payload[1] ^ 1, *payload[2:]]) if k == 4 else payload)
        for k, (can_id, payload) in enumerate(cycle("toyota_rav4", 0))
    ]
    assembler = make_assembler(sensor("toyota_rav4"))
    (scan,) = run(assembler, timed("toyota_rav4", 0, frames))
    assert assembler.counts.checksum == 1
    assert 4 not in scan.slot


def test_an_optional_message_is_awaited_only_while_it_comes() -> None:
    routes = sensor("toyota_rav4").reader.routes
    alone = [frame for frame in cycle("toyota_rav4", 0) if routes[frame[0]][0] == 0]
    again = [frame for frame in cycle("toyota_rav4", 1) if routes[frame[0]][0] == 0]
    assembler = make_assembler(sensor("toyota_rav4"))
    (first,) = run(assembler, timed("toyota_rav4", 0, alone))
    assert first.complete
    assert np.isnan(first.values[sensor("toyota_rav4").reader.quantities.index("score")]).all()
    closed = None
    for time_ns, can_id, payload in timed("toyota_rav4", 1, again):
        receive, part, slot = assembler.routes[can_id]
        closed = receive(part, slot, payload, time_ns)
    assert closed is not None
    assert assembler.counts.missing == 0
    both = run(assembler, timed("toyota_rav4", 2, cycle("toyota_rav4", 2)))
    more = run(assembler, timed("toyota_rav4", 3, cycle("toyota_rav4", 3)))
    assert len(both) == len(more) == 1
    assert same(more[0], whole("toyota_rav4", 3))


def test_parts_of_different_cycles_are_no_object() -> None:
    old, now = cycle("tesla_continental", 0), cycle("tesla_continental", 1)
    frames = [old[k] if k == 5 else frame for k, frame in enumerate(now)]
    assembler = make_assembler(sensor("tesla_continental"))
    (scan,) = run(assembler, timed("tesla_continental", 1, frames))
    assert assembler.counts.unpaired == 1
    assert scan.slot.tolist() == [0, 1, 2, 3, 4, 6, 7, 8]


def test_slots_beyond_the_headers_count_do_not_hold() -> None:
    bound = sensor("gm_lrr")
    assert bound.header is not None
    frames = [bound.header.write(4, 0), *cycle("gm_lrr", 0)[1:]]
    (scan,) = run(make_assembler(bound), timed("gm_lrr", 0, frames))
    assert scan.slot.tolist() == [0, 1, 2, 3]


def test_a_header_without_objects_is_a_scan_at_once() -> None:
    bound = sensor("ars408")
    assert bound.header is not None
    assembler = make_assembler(bound)
    receive, part, slot = assembler.routes[bound.header.can_id]
    scan = receive(part, slot, bound.header.write(0, 0)[1], 7)
    assert scan is not None
    assert scan.values.shape == (len(bound.reader.quantities), 0)
    assert scan.time_ns == 7


def test_more_objects_than_the_format_holds_are_surplus() -> None:
    frames = cycle("ars408", 0, objects=105)  # the header's count ends at 100: the scan closes with 300 of 315 frames
    assembler = make_assembler(sensor("ars408"))
    (scan,) = run(assembler, [Sent(k, *frame) for k, frame in enumerate(frames)])
    assert scan.slot.tolist() == list(range(100))
    counts = assembler.counts
    assert (counts.surplus, counts.late, counts.used) == (10, 15, 1 + 290)


def test_scans_that_never_came_are_told_by_the_headers_counter() -> None:
    frames = [sent for number in (0, 1, 4) for sent in timed("ars408", number, cycle("ars408", number))]
    assembler = make_assembler(sensor("ars408"))
    run(assembler, frames)
    assert assembler.counts.skipped == 2


@pytest.mark.parametrize("kind", ["gm_lrr", "ars408"])
def test_without_its_header_a_scan_still_comes(kind: str) -> None:
    frames = [*timed(kind, 0, cycle(kind, 0)[1:]), *timed(kind, 1, cycle(kind, 1))]
    first, second = run(make_assembler(sensor(kind)), frames)
    assert same(first, whole(kind, 0))
    assert first.missing == 1
    assert same(second, whole(kind, 1))


@pytest.mark.parametrize(("time_from", "frame"), [("first", 0), ("last", -1)])
def test_the_stamp_is_the_first_or_last_frames_less_the_latency(time_from: str, frame: int) -> None:
    bound = sensor("esr_ins")
    changed = bound.settings.model_copy(update={"time_from": time_from, "latency": 0.02})
    frames = timed("esr_ins", 1, cycle("esr_ins", 1))
    (scan,) = run(make_assembler(dataclasses.replace(bound, settings=changed)), frames)
    assert scan.time_ns == frames[frame].time_ns - 20_000_000


@settings(deadline=None, max_examples=examples(30))
@given(st.data())
@pytest.mark.parametrize("kind", KINDS)
def test_random_payloads_are_counted_not_raised(kind: str, data: st.DataObject) -> None:
    assembler = make_assembler(sensor(kind))
    ids = st.sampled_from(sorted(assembler.routes))
    frames = data.draw(st.lists(st.tuples(ids, st.binary(max_size=9), st.integers(0, 40_000_000)), max_size=60))
    now, sent = 0, []
    for can_id, payload, step in frames:
        now += step
        sent.append(Sent(now, can_id, payload))
    for scan in run(assembler, sent):
        assert np.isfinite(scan.values[:2]).all()
    assert assembler.counts.frames == len(sent)


def test_on_the_recorded_drive_every_radar_frame_is_used(drive: Path) -> None:
    assembler = make_assembler(sensor("toyota_rav4"))
    frames = []
    with gzip.open(drive / "drive.log.gz", "rt") as lines:
        for line in lines:
            stamp, channel, frame, *_ = line.split()
            can_id, _, payload = frame.partition("#")
            if channel == "can1" and int(can_id, 16) in assembler.routes:
                time_ns = round(float(stamp.strip("()")) * 1e6) * 1000
                frames.append(Sent(time_ns, int(can_id, 16), bytes.fromhex(payload)))
    scans = run(assembler, frames)
    assert len(scans) == 1200
    assert all(scan.complete for scan in scans)
    assert assembler.counts.used == len(frames) == 38_400


@pytest.mark.parametrize("objects", [9, 0])
@pytest.mark.parametrize("kind", [*KINDS, "acura_ilx"])
def test_frames_that_come_twice_make_no_scan_of_their_own(kind: str, objects: int) -> None:
    """As after an error in the last bit of a frame, or through two gateways."""
    frames = [sent for number in range(6) for sent in timed(kind, number, cycle(kind, number, objects=objects))]
    once, twice = make_assembler(sensor(kind)), make_assembler(sensor(kind))
    plain = run(once, frames)
    doubled = run(twice, [each for sent in frames for each in (sent, sent._replace(time_ns=sent.time_ns + 20_000))])
    assert len(plain) == 6
    assert [scan.slot.tolist() for scan in doubled] == [scan.slot.tolist() for scan in plain]
    assert twice.counts.missing == once.counts.missing
    again = twice.counts.duplicate + twice.counts.late + twice.counts.repeated
    assert again == len(frames) + once.counts.late


@pytest.mark.parametrize("objects", [5, 0])
def test_a_header_without_a_counter_may_be_that_of_the_next_scan(objects: int) -> None:
    """Of two scans that come close behind each other, both are used; a header that is sent twice is one."""
    shipped = sensor("ars408")
    assert shipped.header is not None
    bound = dataclasses.replace(shipped, headers=(dataclasses.replace(shipped.header, counter=None),))
    header = shipped.header.write(objects, 0)[1]
    sent = [Sent(k, *frame) for k, frame in enumerate(cycle("ars408", 0, objects=objects))]
    sent = [each._replace(data=header) if each.can_id == shipped.header.can_id else each for each in sent]
    quick = [each._replace(time_ns=each.time_ns + delay) for delay in (0, 20_000_000, 72_000_000) for each in sent]
    assert len(run(make_assembler(bound), quick)) == 3
    doubled = [again for each in quick for again in (each, each._replace(time_ns=each.time_ns + 130_000))]
    assert len(run(make_assembler(bound), sorted(doubled, key=lambda each: each.time_ns))) == 3
