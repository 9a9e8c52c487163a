from __future__ import annotations

import io
import itertools
import json
import math
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
from candaemon.evaluation.printing import print_evaluation
from candaemon.evaluation.results import Evaluation, Options
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


def test_tables_that_do_not_belong_together_are_told(tmp_path: Path) -> None:
    tracks = saved(tmp_path / "tracks.csv", rows(range(4), 5, "confirmed", still(10.0, 0.0)))
    truth = saved(tmp_path / "truth.csv", rows(range(100, 104), 1, "actor", still(10.0, 0.0)))
    with pytest.raises(InputError, match="expected the clock of the tracks") as caught:
        evaluate(tracks, truth)
    assert caught.value.file == str(truth)
    with pytest.raises(InputError, match="is this the truth"):
        evaluate(truth, tracks)
