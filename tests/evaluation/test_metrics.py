from __future__ import annotations

import io
import itertools
import json
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from candaemon.arrays import Floats
from candaemon.errors import InputError
from candaemon.evaluation.matching import assign, gospa, resample
from candaemon.evaluation.metrics import compare, evaluate
from candaemon.evaluation.printing import print_evaluation, sections
from candaemon.evaluation.results import Evaluation, GroupErrors, Options
from candaemon.evaluation.tables import BODY_NUMBERS, NUMBERS, STATES, TrackTable, TrackWriter
from candaemon.files.outputs import OutputFile

CYCLE = 0.05
Row = tuple[float, int, str, dict[str, float]]


def table(rows: Iterable[Row]) -> TrackTable:
    ordered = sorted(rows, key=lambda row: (row[0], row[1]))
    named = (*NUMBERS, *BODY_NUMBERS)
    numbers = {name: np.array([row[3].get(name, math.nan) for row in ordered]) for name in named}
    return TrackTable(
        time_ns=np.array([round(row[0] * 1e9) for row in ordered], dtype=np.int64),
        id=np.array([row[1] for row in ordered], dtype=np.int64),
        state=np.array([STATES.index(row[2]) for row in ordered], dtype=np.int8),
        objects=np.array([""] * len(ordered), dtype=np.str_),
        kind=np.zeros(len(ordered), dtype=np.int8),
        **numbers,
    )


def still(x: float, y: float, **more: float) -> dict[str, float]:
    return {"x": x, "y": y, "vx": 0.0, "vy": 0.0, "ax": 0.0, "ay": 0.0, **more}


def rows(cycles: Iterable[int], identity: int, state: str, numbers: dict[str, float]) -> list[Row]:
    return [(k * CYCLE, identity, state, numbers) for k in cycles]


def straight(tracks: Sequence[Row], truth: Sequence[Row], **options: float) -> Evaluation:
    return compare(table(tracks), table(truth), Options(**{"settle": 0.0, **options}))


def test_errors_and_nees_by_hand() -> None:
    told = still(10.3, 0.4, vx=1.0, vy=-2.0, ax=0.5, sx=0.3, sy=0.4, svx=0.5, svy=2.0)
    result = straight(rows(range(10), 5, "confirmed", told), rows(range(10), 1, "actor", still(10.0, 0.0)))
    errors = result.errors
    assert errors.samples == 10
    assert (errors.x, errors.y, errors.position) == pytest.approx((0.3, 0.4, 0.5))
    assert (errors.vx, errors.vy, errors.velocity) == pytest.approx((1.0, 2.0, math.sqrt(5.0)))
    assert (errors.ax, errors.ay, errors.acceleration) == pytest.approx((0.5, 0.0, 0.5))
    # 1 + 1 + 4 + 1, below the 95 % quantile of 9.49
    assert result.nees.mean == pytest.approx(7.0)
    assert result.nees.coverage == 1.0
    assert result.nees.lower < 4.0 < result.nees.upper
    assert result.actors[0].errors == errors
    assert result.gospa.mean == pytest.approx(0.5)


def test_errors_leave_out_settling_and_hidden_actors() -> None:
    truth = rows(range(30), 1, "actor", still(10.0, 0.0)) + rows(range(30, 40), 1, "hidden", still(10.0, 0.0))
    tracks = rows(range(5), 5, "tentative", still(10.0, 0.0)) + rows(range(5, 40), 5, "confirmed", still(10.0, 0.0))
    result = compare(table(tracks), table(truth))
    # confirmed at cycle 5, settled from cycle 25 on, hidden from cycle 30 on
    assert result.errors.samples == 5
    assert result.actors[0].visible == 30
    assert result.actors[0].tracked == pytest.approx(25 / 30)
    assert result.time_to_confirm.mean == pytest.approx(0.25)
    assert result.false_tracks.samples == 0
    # missed in the first five cycles; a track of a hidden actor is not false
    assert result.gospa.missed == pytest.approx(8.0 * 5 / 40)
    assert result.gospa.false == 0.0


def test_time_to_confirm_starts_when_an_actor_is_visible() -> None:
    truth = rows(range(10), 1, "hidden", still(10.0, 0.0)) + rows(range(10, 40), 1, "actor", still(10.0, 0.0))
    truth += rows(range(40), 2, "actor", still(80.0, 0.0)) + rows(range(40), 3, "hidden", still(90.0, 0.0))
    result = straight(rows(range(16, 40), 5, "confirmed", still(10.0, 0.0)), truth)
    assert [actor.id for actor in result.actors] == [1, 2]
    assert result.actors[0].time_to_confirm == pytest.approx(0.3)
    assert result.actors[1].time_to_confirm is None
    assert result.time_to_confirm.unconfirmed == 1
    assert result.time_to_confirm.max == pytest.approx(0.3)


def test_id_switches_and_fragments_are_counted_once_each() -> None:
    tracks = (
        rows(range(10), 5, "confirmed", still(10.0, 0.0))
        + rows(range(10, 20), 6, "coasting", still(10.0, 0.0))
        + rows(range(25, 30), 6, "confirmed", still(10.0, 0.0))
    )
    result = straight(tracks, rows(range(30), 1, "actor", still(10.0, 0.0)))
    assert (result.id_switches, result.fragments) == (1, 1)
    assert result.cycles == 30
    assert result.actors[0].tracked == pytest.approx(25 / 30)


def test_a_pair_is_kept_while_another_track_comes_nearer() -> None:
    tracks = rows(range(20), 5, "confirmed", still(12.0, 0.0)) + rows(range(10, 20), 6, "confirmed", still(10.0, 0.0))
    result = straight(tracks, rows(range(20), 1, "actor", still(10.0, 0.0)))
    assert result.id_switches == 0
    assert result.errors.x == pytest.approx(2.0)


def test_an_actor_that_passes_a_post_is_not_paired_with_the_posts_track() -> None:
    passing = [(k * CYCLE, 1, "actor", still(10.0 + 1.5 * k, 3.0, vx=30.0)) for k in range(20)]
    post = rows(range(20), 2, "stationary", still(25.0, 2.0))
    alone = straight(rows(range(20), 7, "confirmed", still(25.0, 1.8)), passing + post)
    assert alone.errors.samples == 0
    assert alone.false_tracks.samples == alone.surplus.samples == 0
    # its own track stays its own, though the post's is nearer for a while
    own = [(k * CYCLE, 8, "confirmed", still(10.0 + 1.5 * k, 2.2, vx=30.0)) for k in range(20)]
    both = straight([*own, *rows(range(20), 7, "confirmed", still(25.0, 1.8))], passing + post)
    assert (both.errors.samples, both.id_switches, both.errors.vx) == (20, 0, 0.0)


def test_an_actor_that_passes_a_lorry_is_not_paired_with_the_lorrys_second_track() -> None:
    """Where the lorry's reference point is out of the gate, its box is not."""
    lorry = body(20.0, 0.0, length=12.0, width=2.5, center_x=26.0)
    rider = {"vx": 5.0, "length": 1.8, "width": 0.6}
    places = [25.0 + 0.25 * k for k in range(20)]
    passing = [(k * CYCLE, 1, "actor", body(x, 2.5, center_x=x + 0.9, **rider)) for k, x in enumerate(places)]
    truth = passing + rows(range(20), 2, "actor", lorry)
    first, second = (rows(range(20), key, "confirmed", still(x, 1.4)) for key, x in ((7, 20.0), (8, 29.0)))
    result = straight(first + second, truth)
    assert result.errors.samples == 20
    assert result.errors.vx == 0.0
    # its own track is nearest to it
    own = [(k * CYCLE, 9, "confirmed", still(x, 2.1, vx=5.0)) for k, x in enumerate(places)]
    both = straight([*first, *second, *own], truth)
    assert (both.errors.samples, both.id_switches, both.errors.vx) == (40, 0, 0.0)


def test_what_drives_through_an_actor_is_not_its_track() -> None:
    oncoming = rows(range(20), 1, "actor", still(10.0, 0.0, vx=-20.0))
    against = straight(rows(range(20), 7, "confirmed", still(10.5, 0.0, vx=-4.9)), oncoming)
    assert against.errors.samples == 0
    assert against.gospa.missed > 0
    assert straight(rows(range(20), 7, "confirmed", still(10.5, 0.0, vx=-5.1)), oncoming).errors.samples == 20
    # its own track stays its own, though a mirror image that drives the other way is nearer
    own = rows(range(20), 8, "confirmed", still(12.0, 0.0, vx=-20.0))
    both = straight([*own, *rows(range(20), 7, "confirmed", still(10.0, 0.0, vx=19.0))], oncoming)
    assert (both.errors.samples, both.errors.vx, both.surplus.samples) == (20, 0.0, 20)


def test_false_tracks_are_far_from_everything_true() -> None:
    truth = (
        rows(range(10), 1, "actor", still(10.0, 0.0))
        + rows(range(10), 2, "stationary", still(30.0, 5.0))
        + rows(range(10), 3, "hidden", still(60.0, 0.0))
    )
    tracks = [
        row
        for identity, (x, y) in enumerate([(10.0, 0.0), (30.0, 1.1), (60.0, 3.9), (30.0, 0.9), (90.0, 0.0)])
        for row in rows(range(10), identity, "confirmed", still(x, y))
    ]
    tracks += rows(range(10), 9, "tentative", still(99.0, 0.0))
    result = straight(tracks, truth)
    assert (result.false_tracks.ids, result.false_tracks.samples) == (2, 20)
    assert result.false_tracks.share == pytest.approx(20 / 50)
    assert (result.confirmed_ids, result.confirmed_samples) == (5, 50)
    assert result.gospa.false == pytest.approx(2 * 8.0)
    assert result.gospa.mean == pytest.approx(4.0)
    # tracks 1 and 3 stand 0.2 m apart
    assert (result.duplicates.ids, result.duplicates.samples) == (2, 20)


def test_cycles_without_tracks_count_and_tracks_without_truth_do_not() -> None:
    truth = rows(range(20), 1, "actor", still(10.0, 0.0))
    offset = [(k * CYCLE + 0.011, 5, "confirmed", still(10.0, 0.0)) for k in range(10, 24)]
    result = straight(offset, truth)
    # cycles 0 to 9 are told by truth alone; from 19.2 on there is no truth
    assert (result.cycles, result.skipped) == (10 + 9, 5)
    assert result.gospa.missed == pytest.approx(8.0 * 10 / 19)
    nothing = compare(table([]), table(truth))
    assert nothing.cycles == 20
    assert math.isnan(nothing.errors.position)
    empty_road = compare(table(rows(range(4), 5, "confirmed", still(10.0, 0.0))), table([]))
    assert (empty_road.false_tracks.ids, empty_road.cycles) == (1, 4)


def test_truth_is_bridged_by_its_own_curve_but_not_over_a_gap() -> None:
    # an actor that brakes from 20 m/s with 4 m/s², seen from a vehicle at a steady 15 m/s
    def at(time: float) -> dict[str, float]:
        return still(30.0 + 5.0 * time - 2.0 * time**2, 1.0, vx=20.0 - 4.0 * time, ax=-4.0)

    truth = table([(0.1 * k, 1, "actor", at(0.1 * k)) for k in (0, 1, 2, 5, 6)])
    times = np.array([-0.05, 0.0, 0.03, 0.13, 0.3, 0.52, 0.6, 0.61])
    result = resample(truth, np.round(times * 1e9).astype(np.int64), 200_000_000)
    kept = times[[1, 2, 3, 5, 6]]
    assert result.time_ns.tolist() == np.round(kept * 1e9).astype(np.int64).tolist()
    np.testing.assert_allclose(result.x, [at(time)["x"] for time in kept], atol=1e-12)
    np.testing.assert_allclose(result.vx, [at(time)["vx"] for time in kept], atol=1e-12)


def test_an_actor_is_hidden_next_to_a_hidden_instant() -> None:
    truth = table([(0.0, 1, "actor", still(1, 0)), (0.1, 1, "hidden", still(1, 0)), (0.2, 1, "actor", still(1, 0))])
    times = np.array([0, 50_000_000, 150_000_000, 200_000_000])
    states = [STATES[code] for code in resample(truth, times, 200_000_000).state]
    assert states == ["actor", "hidden", "hidden", "actor"]
    assert len(resample(truth, times[:0], 200_000_000)) == 0


def test_assignment_prefers_many_pairs_and_old_ones() -> None:
    distance = np.array([[0.0, 3.0], [3.9, 9.0]])
    ids = np.array([1, 2]), np.array([7, 8])
    # actor 1 gives up the nearest track so that both have one
    chosen, taken = assign(distance, *ids, {}, 4.0)
    assert sorted(zip(chosen.tolist(), taken.tolist(), strict=True)) == [(0, 1), (1, 0)]
    chosen, taken = assign(distance, *ids, {1: 7}, 4.0)
    assert (chosen.tolist(), taken.tolist()) == ([0], [0])


# on a grid of 1 cm, so that what differs at all differs measurably
coordinate = st.integers(-600, 600).map(lambda centimetres: centimetres / 100)
points = st.lists(st.tuples(coordinate, coordinate), max_size=5).map(lambda some: np.array(some).reshape(-1, 2))


def between(a: Floats, b: Floats) -> Floats:
    return np.hypot(a[:, None, 0] - b[:, 0], a[:, None, 1] - b[:, 1])


def brute_gospa(distance: Floats, cutoff: float, order: float) -> float:
    """Equation (1) of the paper with α = 2: the best over all ways to give each of the fewer one of the more."""
    small = distance if distance.shape[0] <= distance.shape[1] else distance.T
    fewer, more = small.shape
    best = min(
        sum(min(small[row, column], cutoff) ** order for row, column in enumerate(chosen))
        for chosen in itertools.permutations(range(more), fewer)
    )
    return float((best + cutoff**order / 2 * (more - fewer)) ** (1 / order))


@given(points, points, st.sampled_from([1.0, 2.0]), st.floats(0.5, 8.0))
@settings(deadline=None)
def test_gospa_is_the_best_of_all_assignments_and_symmetric(a: Floats, b: Floats, order: float, cutoff: float) -> None:
    score = gospa(between(a, b), cutoff=cutoff, order=order)
    assert score.value == pytest.approx(brute_gospa(between(a, b), cutoff, order), abs=1e-9)
    assert score.value == pytest.approx(gospa(between(b, a), cutoff=cutoff, order=order).value, abs=1e-9)
    assert len(a) - score.missed == len(b) - score.false
    assert len(score.unpaired) == score.false


@given(points, points, points)
@settings(deadline=None)
def test_gospa_is_a_metric(a: Floats, b: Floats, c: Floats) -> None:
    assert gospa(between(a, a)).value == 0.0
    through = gospa(between(a, c)).value + gospa(between(c, b)).value
    assert gospa(between(a, b)).value <= through + 1e-9
    assert (gospa(between(a, b)).value == 0.0) == (sorted(a.tolist()) == sorted(b.tolist()))


def test_gospa_by_hand() -> None:
    score = gospa(np.array([[1.0, 9.0, 9.0], [9.0, 4.5, 9.0]]))
    assert (score.localisation, score.missed, score.false) == (1.0, 1, 2)
    assert score.value == pytest.approx(math.sqrt(1 + 8 + 16))
    assert score.unpaired.tolist() == [1, 2]


def saved(path: Path, rows_: Sequence[Row]) -> Path:
    with OutputFile(path) as file, TrackWriter(file) as writer:
        for time, identity, state, numbers in rows_:
            writer.write_cycle(
                round(time * 1e9), {"id": [identity], "state": [state], **{n: [v] for n, v in numbers.items()}}
            )
    return path


def test_files_are_evaluated_and_reported(tmp_path: Path) -> None:
    tracks = saved(tmp_path / "tracks.csv", rows(range(40), 5, "confirmed", still(10.25, 0.0)))
    truth = saved(tmp_path / "truth.csv", rows(range(40), 1, "actor", still(10.0, 0.0)))
    result = evaluate(tracks, truth)
    told = json.loads(result.to_json())
    assert told["errors"]["position"] == 0.25
    assert told["nees"]["mean"] is None
    assert told["actors"][0]["time_to_confirm"] == 0.0
    assert told["options"]["gate"] == 4.0

    plain = io.StringIO()
    print_evaluation(Console(file=plain, width=100), result)
    lines = plain.getvalue().splitlines()
    assert "GOSPA (c = 4 m, p = 2, α = 2)" in lines
    assert any(line.split() == ["position", "(m)", "0.250", "0.250", "0.000"] for line in lines)
    assert not any("\x1b" in line or "│" in line for line in lines)
    terminal = io.StringIO()
    print_evaluation(Console(file=terminal, width=100, force_terminal=True), result)
    assert "│" in terminal.getvalue()


@pytest.mark.parametrize("columns", [30, 40, 60, 80, 100, 120])
def test_no_number_is_cut_on_a_narrow_terminal(columns: int, tmp_path: Path) -> None:
    tracks = saved(tmp_path / "tracks.csv", rows(range(400), 5, "confirmed", still(110.25, 0.0)))
    truth = saved(tmp_path / "truth.csv", rows(range(400), 1, "actor", still(110.0, 0.0)))
    result = evaluate(tracks, truth)
    terminal = io.StringIO()
    print_evaluation(Console(file=terminal, width=columns, force_terminal=True, color_system=None), result)
    text = terminal.getvalue()
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= columns
    told = set(re.findall(r"[\d.]+", text))
    for section in sections(result):
        assert set(re.findall(r"[\d.]+", " ".join(cell for row in section.rows for cell in row))) <= told


def test_tables_that_do_not_belong_together_are_told(tmp_path: Path) -> None:
    tracks = saved(tmp_path / "tracks.csv", rows(range(4), 5, "confirmed", still(10.0, 0.0)))
    truth = saved(tmp_path / "truth.csv", rows(range(100, 104), 1, "actor", still(10.0, 0.0)))
    with pytest.raises(InputError, match="expected the clock of the tracks") as caught:
        evaluate(tracks, truth)
    assert caught.value.file == str(truth)
    with pytest.raises(InputError, match="is this the truth"):
        evaluate(truth, tracks)


def body(x: float, y: float, **more: float) -> dict[str, float]:
    box = {"heading": 0.0, "yaw_rate": 0.0, "length": 4.0, "width": 2.0, "center_x": x + 2.0, "center_y": y}
    return still(x, y, **{**box, "sides": 2.0, **more})


def group(result: Evaluation, by: str, which: str) -> GroupErrors:
    return next(one for one in result.groups if (one.by, one.group) == (by, which))


def test_errors_are_split_along_the_course_and_by_group() -> None:
    # drives to the left at 10 m/s: what is off in y is off along
    truth = rows(range(60), 1, "actor", still(30.0, 0.0, vy=10.0)) + rows(range(60, 80), 1, "hidden", still(30.0, 0.0))
    told = still(30.3, 0.4, vx=1.0, vy=12.0, sx=0.3, sy=0.2, svx=1.0, svy=1.0)
    tracks = rows(range(50), 5, "confirmed", told) + rows(range(50, 80), 5, "coasting", told)
    result = straight(tracks, truth)
    whole = group(result, "all", "all")
    assert whole.samples == 60
    assert (whole.along, whole.across) == pytest.approx((0.4, 0.3))
    assert (whole.velocity_along, whole.velocity_across) == pytest.approx((2.0, 1.0))
    ages = [one.samples for one in result.groups if one.by == "age"]
    assert ages == [10, 10, 20, 20]
    assert group(result, "visibility", "coasting").samples == 10
    assert group(result, "visibility", "hidden").samples == 20
    assert group(result, "motion", "crossing").samples == 60
    assert group(result, "target", "point").samples == 60
    assert group(result, "range", "20 to 40 m").samples == 60
    assert group(result, "manoeuvre", "0 to 0.5 m/s²").position == pytest.approx(0.5)
    assert {name: nees.mean for name, nees in result.nees_of.items()} == pytest.approx(
        {"x": 1.0, "y": 4.0, "vx": 1.0, "vy": 4.0, "position": 5.0, "velocity": 5.0}
    )
    assert result.nees_of["y"].coverage == 0.0
    assert result.nees_of["position"].coverage == 1.0
    # settling is left out of all groups but those of age
    settled = compare(table(tracks), table(truth), Options(settle=1.0))
    assert group(settled, "all", "all").samples == settled.errors.samples == 40
    assert [one.samples for one in settled.groups if one.by == "age"] == [10, 10, 20, 20]


def test_the_box_is_judged_where_two_sides_were_seen() -> None:
    truth = rows(range(40), 1, "actor", body(20.0, 0.0, vx=5.0, sides=1.0))
    truth += rows(range(40, 100), 1, "actor", body(20.0, 0.0, vx=5.0))
    told = body(20.0, 0.0, vx=5.0, length=5.0, width=1.9, heading=2 * math.pi + 0.1, center_y=0.3)
    box = straight(rows(range(100), 5, "confirmed", told), truth).groups[0].box
    assert box.heading == pytest.approx(math.degrees(0.1))
    assert box.heading_known == 1.0
    assert (box.length, box.width) == pytest.approx((0.25, 0.05))
    assert (box.length_right, box.width_right) == (1.0, 1.0)
    assert box.center == pytest.approx(0.3)
    # one side only: nothing is said of sizes; at rest nothing of the heading
    aside = straight(
        rows(range(100), 5, "confirmed", told), rows(range(100), 1, "actor", body(20.0, 0.0, vx=1.0, sides=1.0))
    )
    assert math.isnan(aside.groups[0].box.length)
    assert math.isnan(aside.groups[0].box.heading)
    assert json.loads(aside.to_json())["groups"][0]["box"]["length"] is None
    # too young
    young = straight(rows(range(50), 5, "confirmed", told), rows(range(50), 1, "actor", body(20.0, 0.0, vx=5.0)))
    assert math.isnan(young.groups[0].box.length)


def test_a_second_track_on_a_long_body_is_surplus_and_not_false() -> None:
    long = body(10.0, 0.0, length=14.0, width=2.5, center_x=17.0)
    tracks = rows(range(10), 5, "confirmed", still(10.0, 0.0)) + rows(range(10), 6, "confirmed", still(22.0, 0.5))
    result = straight(tracks, rows(range(10), 1, "actor", long))
    assert (result.false_tracks.samples, result.surplus.samples, result.surplus.ids) == (0, 10, 1)
    assert result.surplus.share == pytest.approx(0.5)
    # without a box its end is out of the gate; alone it is no surplus
    bare = straight(tracks, rows(range(10), 1, "actor", still(10.0, 0.0)))
    assert (bare.false_tracks.samples, bare.surplus.samples) == (10, 0)
    alone = straight(rows(range(10), 6, "confirmed", still(22.0, 0.5)), rows(range(10), 1, "actor", long))
    assert (alone.false_tracks.samples, alone.surplus.samples) == (0, 0)


def test_an_actor_is_missed_from_a_second_of_sight_on() -> None:
    truth = rows(range(30), 1, "actor", still(10.0, 0.0)) + rows(range(30, 40), 1, "hidden", still(10.0, 0.0))
    truth += rows(range(40, 65), 1, "actor", still(10.0, 0.0))
    result = straight(rows(range(25), 5, "confirmed", still(10.0, 0.0)), truth)
    # visible for a second at cycles 20 to 29, and, after the break, at 60 to 64
    assert (result.missed.awaited, result.missed.samples) == (15, 10)
    assert result.missed.share == pytest.approx(10 / 15)
    assert straight([], []).missed.share == 0.0


points_of_time = st.lists(st.sampled_from(["none", "seen", "tracked", "other", "hidden"]), min_size=1, max_size=30)


@given(points_of_time)
@settings(deadline=None)
def test_histories_are_those_of_a_walk_through_the_cycles(states: list[str]) -> None:
    truth = [(k * CYCLE, 1, "hidden" if state == "hidden" else "actor", still(10, 0)) for k, state in enumerate(states)]
    tracks = [
        (k * CYCLE, 5 + (state == "other"), "confirmed", still(10, 0))
        for k, state in enumerate(states)
        if state in {"tracked", "other"}
    ]
    # one far away gives every cycle its time
    result = straight(tracks + rows(range(len(states)), 9, "confirmed", still(90.0, 0.0)), truth)
    visible = [state for state in states if state != "hidden"]
    tracked = [state in {"tracked", "other"} for state in visible]
    ids = [state for state in states if state in {"tracked", "other"}]
    fragments = sum(
        here and not before and any(tracked[:k])
        for k, (before, here) in enumerate(itertools.pairwise(tracked), start=1)
    )
    assert result.id_switches == (sum(a != b for a, b in itertools.pairwise(ids)) if visible else 0)
    assert result.fragments == fragments
    assert sum(actor.visible for actor in result.actors) == len(visible)
    if any(tracked):
        assert result.actors[0].tracked == pytest.approx(sum(tracked) / len(visible))
