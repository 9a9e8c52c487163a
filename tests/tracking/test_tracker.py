"""Identity over time: slots, confirmation, coasting, reflections, crowds; scans written by hand."""

from __future__ import annotations

import numpy as np
import pytest

from candaemon.config.sensors import FieldOfView, Mount
from candaemon.radar.mounting import SensorView
from candaemon.tracking.identities import Identities
from candaemon.tracking.obstacles import COASTING, CONFIRMED, TENTATIVE, concatenated
from tests.support.builders import CYCLE, HandFed, HandFedVehicles, Seen, assert_sane, car, place, pose, states, times


def followed(fed: HandFed, cycles: int = 20, x: float = 40.0) -> int:
    """Track one car in slot 5 from x at time 0; return its identity."""
    for t in times(0, cycles):
        told = fed.scan(t, [car(5, t, x)])
    assert states(told) == {told.id[0]: CONFIRMED}
    return int(told.id[0])


@pytest.mark.parametrize("flagged", [True, False], ids=["new flag", "by the gate"])
@pytest.mark.parametrize(("away_x", "away_y", "speed"), [(30.0, 3.5, 25.0), (9.0, 0.0, 20.0), (0.0, -4.0, 20.0)])
def test_a_slot_given_to_another_vehicle_begins_a_new_identity(
    away_x: float, away_y: float, speed: float, flagged: bool
) -> None:
    fed = HandFed()
    first = followed(fed)
    for t in times(20, 30):
        told = fed.scan(t, [Seen(5, 60 + away_x + speed * (t - 1), away_y, speed, new=flagged and t == 1.0)])
    second = first + 1
    assert states(told) == {first: COASTING, second: CONFIRMED}
    assert place(told, first) == pytest.approx((40 + 20 * t, 0.0), abs=0.3)
    assert place(told, second) == pytest.approx((60 + away_x + speed * (t - 1), away_y), abs=0.3)
    for t in times(30, 34):
        told = fed.scan(t, [Seen(5, 60 + away_x + speed * (t - 1), away_y, speed), car(9, t, 40.0)])
    assert states(told) == {first: CONFIRMED, second: CONFIRMED}


@pytest.mark.parametrize("flagged", [True, False])
def test_the_new_flag_decides_where_the_gate_for_a_known_id_would_let_it_pass(flagged: bool) -> None:
    fed = HandFed(reflections={"merge": False})
    first = followed(fed)
    told = fed.scan(1.0, [car(5, 1.0, 40.0, 0.62, new=flagged)])
    nis = fed.tracker.update.nis[0] if fed.tracker.update is not None else np.nan
    association = fed.tracker.settings.association
    assert states(told) == ({first: COASTING, first + 1: TENTATIVE} if flagged else {first: CONFIRMED})
    assert np.isnan(nis) if flagged else association.gate < nis < association.id_gate


def test_a_slot_that_comes_back_stands_for_the_first_vehicle_again() -> None:
    fed = HandFed()
    first = followed(fed)
    for t in times(20, 30):
        fed.scan(t, [car(5, t, 75.0, 3.5)])
    assert fed.tracker.counts.slot_jumps == 1
    for t in times(30, 38):
        told = fed.scan(t, [car(5, t, 40.0)])
    assert fed.tracker.counts.slot_jumps == 2  # one more, and not one a scan
    assert states(told) == {first: CONFIRMED, first + 1: COASTING}


def test_a_vehicle_keeps_its_identity_from_slot_to_slot() -> None:
    fed = HandFed()
    first = followed(fed)
    for k in range(20, 60):
        t = k * CYCLE
        told = fed.scan(t, [car(k % 7, t, 40.0, new=k % 2 == 0), car((k + 3) % 7, t, 80.0, 3.5)])
        assert states(told)[first] == CONFIRMED
    assert len(told) == 2
    assert dict(zip(told.used_object.tolist(), told.id[told.used_row].tolist(), strict=True))[59 % 7] == first


def test_two_vehicles_that_swap_slots_keep_their_identities() -> None:
    fed = HandFed()
    for k in range(40):
        t, swap = k * CYCLE, k >= 20
        told = fed.scan(t, [car(2 if swap else 1, t, 30.0), car(1 if swap else 2, t, 50.0, 3.5)])
        if k == 19:
            before = told.id.tolist()
    assert told.id.tolist() == before
    assert place(told, before[0]) == pytest.approx((30 + 20 * t, 0.0), abs=0.1)
    assert place(told, before[1]) == pytest.approx((50 + 20 * t, 3.5), abs=0.1)


def test_by_id_alone_the_slot_is_the_identity() -> None:
    fed = HandFed(association={"method": "id"}, reflections={"merge": False})
    first = followed(fed)
    told = fed.scan(1.0, [car(5, 1.0, 41.0), car(6, 1.0, 40.0)])
    assert states(told) == {first: CONFIRMED, first + 1: TENTATIVE}
    assert told.id[told.used_row[told.used_object == 5]].tolist() == [first]


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [("111", "ttc"), ("1011", "tttc"), ("10101", "ttttc"), ("11", "tt"), ("1000", "tttx"), ("110111", "tttccc")],
)
def test_three_of_five_scans_confirm(pattern: str, expected: str) -> None:
    fed = HandFed(lifecycle={"confirm": 3, "window": 5, "tentative_coast": 0.12})
    for k, (seen, letter) in enumerate(zip(pattern, expected, strict=True)):
        told = fed.scan(k * CYCLE, [car(5, k * CYCLE, 40.0)] if seen == "1" else [])
        assert told.state.tolist() == {"t": [TENTATIVE], "c": [CONFIRMED], "x": []}[letter], k
    assert fed.tracker.counts.confirmed == (expected[-1] == "c")


def test_a_coasting_obstacle_grows_uncertain_and_ends() -> None:
    fed = HandFed(lifecycle={"coast": 0.72})
    first = followed(fed)
    spreads = []
    for k, t in enumerate(times(20, 40), start=1):
        told = fed.scan(t, []) if k % 2 else fed.coast(t)
        if k * CYCLE > 0.72:
            assert len(told) == 0
            continue
        assert states(told) == {first: COASTING}
        assert place(told, first) == pytest.approx((40 + 20 * t, 0.0), abs=0.5)
        assert told.age[0] == pytest.approx(t)
        spreads.append((told.sx[0], told.sy[0], told.svx[0], told.svy[0]))
    growth = np.diff(spreads, axis=0)
    assert len(spreads) == 14
    assert (growth > 0).all()
    existence = fed.scan(3.0, [car(5, 3.0, 40.0)]).existence[0]
    assert existence == 1.0


def test_existence_is_the_share_of_scans() -> None:
    fed = HandFed()
    first = followed(fed, 20)
    for t in times(20, 30):
        told = fed.scan(t, [])
    assert states(told) == {first: COASTING}
    assert told.existence[0] == pytest.approx(20 / 30)


@pytest.mark.parametrize(("y", "lives"), [(0.0, True), (40.0, False)], ids=["ahead", "beside"])
def test_what_has_left_the_view_ends_early(y: float, lives: bool) -> None:
    view = SensorView(Mount(x=3.6), FieldOfView(range=150, azimuth_deg=30))
    fed = HandFed(views=(view,))
    for t in times(0, 20):
        fed.scan(t, [Seen(5, 40.0, y)])
    for t in times(20, 24):
        told = fed.scan(t, [])
    assert len(told) == lives


def test_trackers_that_share_a_source_of_identities_never_meet() -> None:
    identities = Identities()
    pair = HandFed(identities=identities), HandFed(identities=identities)
    for t in times(0, 5):
        told = [fed.scan(t, [car(5, t, 40.0), car(6, t, 80.0, 3.5)]) for fed in pair]
    both = concatenated(told)
    assert_sane(both)
    assert len(both) == 4
    assert both.used_row.tolist() == [0, 1, 2, 3]


def test_a_scan_from_the_past_breaks_nothing() -> None:
    fed = HandFed()
    first = followed(fed)
    told = fed.scan(0.91, [car(5, 0.91, 40.0), Seen(7, 100.0, 5.0)])
    assert_sane(told)
    assert states(told)[first] == CONFIRMED
    for t in times(20, 24):
        told = fed.scan(t, [car(5, t, 40.0), Seen(7, 100.0, 5.0)])
        assert_sane(told)
    assert states(told) == {first: CONFIRMED, first + 1: CONFIRMED}
    assert place(told, first) == pytest.approx((40 + 20 * t, 0.0), abs=0.3)


def test_two_sensors_see_one_vehicle() -> None:
    fed = HandFed(slack=CYCLE)
    for k, t in enumerate(times(0, 40)):
        sensor = k % 2
        told = fed.scan(t, [car(3 + 20 * sensor, t, 40.0)], sensor=sensor)
    assert states(told) == {1: CONFIRMED}
    assert told.sensors.tolist() == [0b11]
    assert (told.used_sensor.tolist(), told.used_object.tolist()) == ([1], [23])
    told = fed.scan(2.0, [], sensor=0)
    assert states(told) == {1: CONFIRMED}  # the other sensor saw it within the slack
    for t in times(41, 44):
        told = fed.scan(t, [], sensor=0)
    assert states(told) == {1: COASTING}


def test_the_same_id_of_two_sensors_are_two_objects() -> None:
    fed = HandFed(slack=CYCLE)
    for k, t in enumerate(times(0, 20)):
        told = fed.scan(t, [car(5, t, 40.0 + 40 * (k % 2), 3.5 * (k % 2))], sensor=k % 2)
    assert len(told) == 2
    assert fed.tracker.counts.slot_jumps == 0
    assert sorted(told.sensors.tolist()) == [1, 2]


def test_an_id_twice_in_a_scan_is_no_evidence() -> None:
    fed = HandFed()
    first = followed(fed)
    for t in times(20, 25):
        told = fed.scan(t, [car(5, t, 70.0, 3.5), car(5, t, 40.0)])
        assert_sane(told)
    assert states(told) == {first: CONFIRMED, first + 1: CONFIRMED}


def test_from_a_turning_vehicle_what_stands_stands() -> None:
    """A post, seen while the own vehicle drives a circle: no velocity over ground, and the right place."""
    fed, speed, rate = HandFed(), 12.0, 0.3
    radius = speed / rate
    for t in times(0, 60):
        heading = rate * t
        ego = pose(
            t,
            east=radius * np.sin(heading),
            north=radius * (1 - np.cos(heading)),
            heading=heading,
            ve=speed * np.cos(heading),
            vn=speed * np.sin(heading),
            yaw_rate=rate,
        )
        told = fed.scan(t, [Seen(1, 60.0, 30.0)], ego=ego)
    assert states(told) == {1: CONFIRMED}
    np.testing.assert_allclose((told.vx[0], told.vy[0], told.ve[0], told.vn[0]), 0.0, atol=0.05)
    np.testing.assert_allclose((told.east[0], told.north[0]), (60.0, 30.0), atol=0.01)
    expected = ego.to_vehicle(np.array([[60.0, 30.0]]))[0]
    np.testing.assert_allclose((told.x[0], told.y[0]), expected, atol=0.01)


def test_deviations_turn_with_the_vehicle() -> None:
    """A sensor that is sharp along east: seen from a vehicle that heads north, that is across."""
    fed = HandFed(noise=(0.02, 1.0, 0.05))
    for t in times(0, 20):
        told = fed.scan(t, [Seen(1, 0.0, 60.0)], ego=pose(t, heading=np.pi / 2))
    assert told.sy[0] < 0.1 < told.sx[0]
    assert place(told, 1) == pytest.approx((60.0, 0.0), abs=0.1)


def test_expected_positions_are_those_of_the_detections_used() -> None:
    fed = HandFed()
    for t in times(0, 40):
        fed.scan(t, [car(1, t, 40.0), car(2, t, 60.0, 3.5, 15.0)])
    (places,) = fed.tracker.expected_positions((0.5,))
    update = fed.tracker.update
    assert update is not None
    exact = np.array([[40.0 + 20 * (t + 0.5), 0.0], [60.0 + 15 * (t + 0.5), 3.5]])
    np.testing.assert_allclose(places, exact[update.detection], atol=0.1)
    assert (update.degrees_of_freedom == 3).all()
    fed.coast(2.0)
    assert fed.tracker.expected_positions((0.5,))[0].shape == (0, 2)


@pytest.mark.parametrize("kind", [HandFed, HandFedVehicles])
@pytest.mark.parametrize("late", [0.3, 0.6, 1.4])
def test_a_late_scan_of_another_sensor_leaves_what_drives_where_it_drives(
    kind: type[HandFed | HandFedVehicles], late: float
) -> None:
    fed = kind()
    for t in times(1, 60):
        fed.scan(t, [car(1, t, 40.0)])
    told = fed.scan(t - late, [], sensor=1)
    assert told.x[0] == pytest.approx(40 + 20 * (t - late), abs=1.0 + late)
    told = fed.coast(t + 0.05)
    assert told.x[0] == pytest.approx(40 + 20 * (t + 0.05), abs=0.5)


@pytest.mark.parametrize("kind", [HandFed, HandFedVehicles])
def test_existence_by_hits_is_a_share_where_one_that_more_sensors_see_merges(
    kind: type[HandFed | HandFedVehicles],
) -> None:
    fed = kind(lifecycle={"by": "hits"}) if kind is HandFedVehicles else kind()
    for t in times(1, 60):
        told = [fed.scan(t, [car(1, t, 40.0)])]
        for sensor in (1, 2, 3):
            beside, then = max(2.0 - 0.8 * t, 1.0), t + 0.012 * sensor
            told.append(fed.scan(then, [car(5 + sensor, then, 40.3, beside)], sensor=sensor))
        assert all(each.existence.max() <= 1.0 for each in told)
    assert fed.tracker.counts.merged == 1
