"""Slots of the output: sticky, rested between holders, given to what matters most."""

from __future__ import annotations

from functools import partial

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from candaemon.output.slots import MARGIN, OFF_PATH, OutputSlots, SlotAssignment, SlotEncoding

Cycle = dict[int, float]


def cycles(ids: int = 9, longest: int = 12) -> st.SearchStrategy[list[Cycle]]:
    distance = st.floats(0, 200) | st.floats(OFF_PATH, OFF_PATH + 200)
    return st.lists(st.dictionaries(st.integers(1, ids), distance, max_size=ids), max_size=longest)


def assign(table: OutputSlots, cycle: Cycle) -> SlotAssignment:
    return table.assign(list(cycle), list(cycle.values()))


def holders(cycle: Cycle, assigned: SlotAssignment) -> dict[int, int]:
    return {slot: each for each, slot in zip(cycle, assigned.slot, strict=True) if slot >= 0}


@settings(deadline=None)
@given(cycles(), st.integers(1, 5))
def test_a_slot_has_one_holder_and_rests_between_two(drive: list[Cycle], capacity: int) -> None:
    table, before = OutputSlots(capacity), dict[int, int]()
    for cycle in drive:
        assigned = assign(table, cycle)
        held = holders(cycle, assigned)
        assert len(held) == sum(slot >= 0 for slot in assigned.slot)
        assert set(held) <= set(range(capacity))
        for slot, each in held.items():
            assert before.get(slot, each) == each
        assert sorted(assigned.freed) == sorted(set(before) - set(held))
        before = held


@settings(deadline=None)
@given(cycles(), st.integers(1, 5))
def test_new_is_said_once_on_taking_a_slot(drive: list[Cycle], capacity: int) -> None:
    table, before = OutputSlots(capacity), dict[int, int]()
    for cycle in drive:
        assigned = assign(table, cycle)
        held = holders(cycle, assigned)
        fresh = {each for each, new in zip(cycle, assigned.new, strict=True) if new}
        assert fresh == set(held.values()) - set(before.values())
        before = held


@settings(deadline=None)
@given(cycles(ids=5), st.integers(5, 8))
def test_with_slots_enough_an_obstacle_keeps_its_own(drive: list[Cycle], capacity: int) -> None:
    table, slot_of = OutputSlots(2 * capacity), dict[int, int]()
    for cycle in drive:
        assigned = assign(table, cycle)
        now = dict(zip(cycle, assigned.slot, strict=True))
        assert min(now.values(), default=0) >= 0
        assert all(now[each] == slot for each, slot in slot_of.items() if each in now)
        slot_of = now


@settings(deadline=None)
@given(cycles(ids=9, longest=1), st.integers(1, 4))
def test_what_stays_long_enough_is_served_by_urgency(drive: list[Cycle], capacity: int) -> None:
    for cycle in drive:
        table = OutputSlots(capacity)
        assigned = assign(table, cycle)
        assert set(holders(cycle, assigned).values()) == set(sorted(cycle, key=cycle.__getitem__)[:capacity])


@settings(deadline=None)
@given(cycles(ids=9), st.integers(1, 4), cycles(ids=9, longest=1))
def test_in_the_end_nothing_in_the_path_waits_for_something_less_urgent(
    drive: list[Cycle], capacity: int, last: list[Cycle]
) -> None:
    table = OutputSlots(capacity)
    for cycle in drive:
        assign(table, cycle)
    for cycle in last:
        for _ in range(2 * capacity + 2):
            assigned = assign(table, cycle)
        served = set(holders(cycle, assigned).values())
        assert len(served) == min(capacity, len(cycle))
        worst = max((cycle[each] for each in served), default=0.0)
        assert all(cycle[each] >= OFF_PATH or worst <= cycle[each] + MARGIN for each in set(cycle) - served)


@settings(deadline=None)
@given(cycles(), st.integers(1, 5), st.integers(1, 3))
def test_seats_are_as_the_table_has_them_however_often_the_same_obstacles_come(
    drive: list[Cycle], capacity: int, times: int
) -> None:
    table, seating = OutputSlots(capacity), SlotEncoding(capacity, send_all=False, send_freed=True)
    for cycle in (cycle for cycle in drive for _ in range(times)):
        ids, urgency = np.array(list(cycle), np.int64), np.array(list(cycle.values()), np.float64)
        assigned = assign(table, cycle)
        held = holders(cycle, assigned)
        fresh = {slot for slot, new in zip(assigned.slot, assigned.new, strict=True) if new}
        seats = seating.assign(ids, urgency.copy)
        assert ids[seats.order].tolist() == [held[slot] for slot in sorted(held)]
        assert seats.sent.tolist() == sorted([*held, *assigned.freed])
        assert seats.occupied.tolist() == [slot in held for slot in seats.sent.tolist()]
        assert seats.new.tolist() == [slot in fresh for slot in seats.sent.tolist()]


def test_where_nobody_comes_or_waits_urgency_is_not_asked() -> None:
    asked: list[int] = []
    seating = SlotEncoding(2, send_all=True, send_freed=True)

    def urgency(cycle: int, obstacles: int) -> NDArray[np.float64]:
        asked.append(cycle)
        return np.full(obstacles, 50.0)

    for cycle, ids in enumerate(([7, 8], [7, 8], [7, 8], [8, 7], [7, 8, 9], [7, 8, 9])):
        seating.assign(np.array(ids), partial(urgency, cycle, len(ids)))
    assert asked == [0, 1, 3, 4, 5]


def test_a_freed_slot_is_empty_for_one_cycle() -> None:
    table = OutputSlots(1)
    assert table.assign([7], [10.0]) == SlotAssignment([0], [True], [])
    assert table.assign([8], [10.0]) == SlotAssignment([-1], [False], [0])
    assert table.assign([8], [10.0]) == SlotAssignment([0], [True], [])


def test_a_near_obstacle_in_the_path_takes_the_slot_of_the_farthest_outside() -> None:
    table = OutputSlots(2)
    table.assign([1, 2], [OFF_PATH + 5.0, OFF_PATH + 90.0])
    assert table.assign([1, 2, 3], [OFF_PATH + 5.0, OFF_PATH + 90.0, 40.0]) == SlotAssignment(
        [0, -1, -1], [False] * 3, [1]
    )
    assert table.assign([1, 2, 3], [OFF_PATH + 5.0, OFF_PATH + 90.0, 40.0]).slot == [0, -1, 1]


def test_no_obstacle_is_displaced_while_a_slot_becomes_free() -> None:
    table = OutputSlots(2)
    table.assign([1, 2], [OFF_PATH + 5.0, OFF_PATH + 90.0])
    assert table.assign([2, 3], [OFF_PATH + 90.0, 40.0]) == SlotAssignment([1, -1], [False, False], [0])
    assert table.assign([2, 3], [OFF_PATH + 90.0, 40.0]) == SlotAssignment([1, 0], [False, True], [])


def test_outside_the_path_nobody_is_pushed_out() -> None:
    table = OutputSlots(1)
    table.assign([1], [OFF_PATH + 90.0])
    assert table.assign([1, 2], [OFF_PATH + 90.0, OFF_PATH + 5.0]) == SlotAssignment([0, -1], [False, False], [])


def test_two_at_like_distance_do_not_take_turns() -> None:
    table = OutputSlots(1)
    table.assign([1], [50.0])
    for distance in (49.0, 46.0, 50.5):
        assert table.assign([1, 2], [50.0, distance]).slot == [0, -1]
