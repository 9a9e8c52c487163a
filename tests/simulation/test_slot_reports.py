from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from candaemon.simulation.slot_reports import RadarSlots

scan = st.dictionaries(st.integers(0, 12), st.tuples(st.floats(0, 100), st.booleans(), st.booleans()), max_size=10)


def table(capacity: int = 4, *, hold: int = 2, reuse: float = 0.5) -> RadarSlots:
    return RadarSlots(capacity, hold=hold, reuse=reuse, random=np.random.default_rng(3))


@settings(deadline=None)
@given(st.lists(scan, max_size=20))
def test_a_slot_has_one_object_and_only_a_new_one_changes_it(scans: list[dict[int, tuple[float, bool, bool]]]) -> None:
    slots, holder = table(), dict[int, int]()
    for objects in scans:
        seen = [key for key, (_, is_seen, _) in objects.items() if is_seen]
        there = {key for key, (_, is_seen, is_there) in objects.items() if is_seen or is_there}
        given_slots = slots.assign(seen, [objects[key][0] for key in seen], there)
        used = [slot for slot in given_slots.slot if slot >= 0] + given_slots.missed
        assert len(set(used)) == len(used)
        assert all(0 <= slot < 4 for slot in used)
        assert len([slot for slot in given_slots.slot if slot >= 0]) >= min(len(seen), 4 - len(given_slots.missed))
        for key, slot, new in zip(seen, given_slots.slot, given_slots.new, strict=True):
            if slot >= 0:
                assert new == (holder.get(slot) != key)
                holder[slot] = key
        holder = {slot: key for slot, key in holder.items() if slot in used}


def test_an_object_keeps_its_slot_through_a_short_miss_only() -> None:
    slots = table(hold=2)
    assert slots.assign([7], [10.0], {7}).slot == [0]
    assert slots.assign([], [], {7}).missed == [0]
    back = slots.assign([7, 8], [10.0, 20.0], {7, 8})
    assert (back.slot, back.new) == ([0, 1], [False, True])
    for _ in range(2):
        assert slots.assign([8], [20.0], {7, 8}).missed == [0]
    assert slots.assign([8], [20.0], {7, 8}).missed == []
    assert slots.assign([7, 8], [10.0, 20.0], {7, 8}).new == [True, False]


def test_a_slot_is_handed_on_in_the_same_scan() -> None:
    slots = table(reuse=1.0)
    slots.assign([1, 2], [10.0, 20.0], {1, 2})
    passed = slots.assign([2, 3], [20.0, 30.0], {2, 3})
    assert (passed.slot, passed.new) == ([1, 0], [False, True])


def test_a_near_object_pushes_a_far_one_out_of_a_full_table() -> None:
    slots = table(capacity=2)
    slots.assign([1, 2], [50.0, 90.0], {1, 2})
    pushed = slots.assign([1, 2, 3], [50.0, 90.0, 20.0], {1, 2, 3})
    assert (pushed.slot, pushed.new) == ([0, -1, 1], [False, False, True])
    assert slots.assign([1, 3, 4], [50.0, 20.0, 48.0], {1, 3, 4}).slot == [0, 1, -1], "too little nearer"
