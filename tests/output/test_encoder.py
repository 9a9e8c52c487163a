"""Obstacles into frames: what goes onto the bus is what the DBC says, in any configured format."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from functools import cache
from typing import Any

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database as CanDatabase
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from candaemon.binding.bind_output import bind_output
from candaemon.binding.bind_reader import bind_reader
from candaemon.binding.bound import BoundOutput, BoundSensor
from candaemon.binding.location import SettingLocation
from candaemon.config.base import ObjectSignalRef
from candaemon.config.sensors import Mount
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.frames.bodies import CLASSES
from candaemon.output.decoder import OutputDecoder
from candaemon.output.encoder import TOGETHER, OutputEncoder, OutputStatus
from candaemon.output.quantities import EgoAcceleration, MountView, SeenCycle
from candaemon.protection.checksums import crc8_sae_j1850
from candaemon.radar.assembler_factory import make_assembler
from candaemon.radar.scan import Scan
from candaemon.tracking.obstacles import COASTING, CONFIRMED, TENTATIVE, Obstacles
from tests.support.bound import binding
from tests.support.effort import examples
from tests.support.paths import ROOT

POSE = EgoPose(0, 5.0, 6.0, 0.0, 20.0, 0.0, 0.0, 0.01, EgoStatus.VALID)
STATUS = OutputStatus(ego=2, health=1, drops=70_000)
Frames = list[tuple[int, bytes]]


def output(config: str) -> BoundOutput:
    bound = binding(config).output
    assert bound is not None
    return bound


def sensor(config: str) -> BoundSensor:
    return binding(config).sensors[0]


@cache
def dbc(name: str) -> CanDatabase:
    loaded = cantools.database.load_file(ROOT / "dbc" / name)
    assert isinstance(loaded, CanDatabase)
    return loaded


def obstacles(n: int, **given: Any) -> Obstacles:
    """Return n confirmed obstacles ahead, 10 m apart, some columns as given."""
    columns: dict[str, Any] = {name: np.zeros(n) for name in Obstacles.__dataclass_fields__ if name != "time_ns"}
    columns |= {"id": np.arange(1, n + 1), "state": np.full(n, CONFIRMED, np.int8)}
    columns |= {"x": 10.0 * np.arange(1, n + 1), "existence": np.ones(n), "sensors": np.ones(n, np.int64)}
    columns |= {name: np.empty(0, np.int64) for name in ("used_row", "used_sensor", "used_object")}
    columns |= {name: np.asarray(value) for name, value in given.items()}
    return Obstacles(time_ns=0, **columns)


def decoded(frames: Frames, name: str) -> dict[str, dict[str, Any]]:
    database = dbc(name)
    return {
        database.get_message_by_frame_id(can_id).name: dict(
            database.decode_message(can_id, payload, decode_choices=False)  # type: ignore[arg-type]  # plain, not multiplexed
        )
        for can_id, payload in frames
    }


def scans(bound: BoundSensor, frames: Iterable[tuple[int, bytes]]) -> list[Scan]:
    assembler = make_assembler(bound)
    found = []
    for k, (can_id, payload) in enumerate(frames):
        receive, part, slot = assembler.routes[can_id]
        found.append(receive(part, slot, payload, 1000 * k))
    found.append(assembler.flush())
    return [scan for scan in found if scan is not None]


def test_an_obstacle_is_what_the_dbc_says() -> None:
    seen = obstacles(
        2, x=[42.13, 90.0], y=[-1.4, 3.0], vx=[-7.7, 20.0], vy=[0.6, 0.0], ax=[-3.1, 0.0], id=[70, 5], sx=[0.3, 0.3],
        state=[COASTING, CONFIRMED], existence=[0.75, 1.0], age=[4.0, 900.0], sensors=[5, 1],
    )  # fmt: skip
    found = decoded(OutputEncoder(output("esr_ins")).encode(seen, STATUS, POSE), "obstacles.dbc")
    assert list(found)[:3] == ["OBSTACLE_STATUS", "OBSTACLE_00_A", "OBSTACLE_01_A"]
    a = found["OBSTACLE_00_A"]
    assert (a["State"], a["Id"]) == (3, 70 % 64)
    assert a["X"] == pytest.approx(42.13, abs=0.05)
    assert a["Y"] == pytest.approx(-1.4, abs=0.07)
    assert a["Vx"] == pytest.approx(-7.65)
    assert found["OBSTACLE_00_B"]["Ax"] == pytest.approx(-3.1, abs=0.1)
    c = found["OBSTACLE_00_C"]
    assert (c["Age"], c["Sensors"]) == (4.0, 5)
    assert c["Existence"] == pytest.approx(75, abs=5)
    assert found["OBSTACLE_01_A"]["State"] == 2


@pytest.mark.parametrize("config", ["surround", "radar_lidar"])
def test_the_optional_message_tells_who_leads_when_it_is_reached_and_who_of_many_saw_it(config: str) -> None:
    """The vehicle drives at 20 m/s; what is beside the path is never reached, and comes last."""
    mask = 1 << 11 | 1 << 4 | 1
    seen = obstacles(
        4, x=[30.0, 50.0, 90.0, 20.0], y=[0.0, 0.0, 0.5, 5.0], vx=[10.0, 0.0, 25.0, 0.0], sensors=[mask, 1, 1 << 31, 2]
    )  # fmt: skip
    encoder = OutputEncoder(output(config))
    encoded = encoder.encode(seen, STATUS, POSE)
    found = decoded(encoded, "obstacles.dbc")
    parts = [found[f"OBSTACLE_{slot:02d}_E"] for slot in range(4)]
    assert [part["Lead"] for part in parts] == [1, 0, 0, 0]
    assert [part["TimeToCollision"] for part in parts] == pytest.approx([3.0, 2.5, 25.5, 25.5])
    assert [part["SeenBy"] for part in parts] == [mask, 1, 0, 2]
    assert [found[f"OBSTACLE_{slot:02d}_C"]["Sensors"] for slot in range(4)] == [mask & 15, 1, 0, 2]


def test_who_does_not_map_the_optional_message_sends_as_before() -> None:
    frames = OutputEncoder(output("esr_ins")).encode(obstacles(2), STATUS, POSE)
    assert not [name for name in decoded(frames, "obstacles.dbc") if name.endswith("_E")]


def test_the_status_tells_cycle_slots_and_validity() -> None:
    encoder = OutputEncoder(output("esr_ins"))
    for cycle in range(300):
        status = decoded(encoder.encode(obstacles(40), STATUS, POSE)[:1], "obstacles.dbc")["OBSTACLE_STATUS"]
        assert status["Cycle"] == status["Counter"] == cycle % 256
    assert (status["Occupied"], status["Unreported"]) == (32, 8)
    assert (status["Ego"], status["Health"], status["Drops"]) == (2, 1, 70_000 % 65_536)
    assert encoder.state.unreported == 8


def test_counters_count_frames_of_their_slot_and_the_crc_covers_them() -> None:
    encoder = OutputEncoder(output("esr_ins"))
    encoder.encode(obstacles(1), STATUS, POSE)
    frames = encoder.encode(obstacles(2), STATUS, POSE)
    found = decoded(frames, "obstacles.dbc")
    assert [found[f"OBSTACLE_00_{part}"]["Counter"] for part in "ABCD"] == [1, 1, 1, 1]
    assert found["OBSTACLE_01_A"]["Counter"] == 0
    assert all(payload[0] == crc8_sae_j1850(payload[1:]) for _, payload in frames)


def test_a_freed_slot_is_sent_once_as_empty() -> None:
    encoder = OutputEncoder(output("esr_ins"))
    encoder.encode(obstacles(2), STATUS, POSE)
    left = obstacles(1, id=[2])
    found = decoded(encoder.encode(left, STATUS, POSE), "obstacles.dbc")
    assert (found["OBSTACLE_00_A"]["State"], found["OBSTACLE_01_A"]["State"]) == (0, 2)
    assert found["OBSTACLE_STATUS"]["Occupied"] == 1
    assert "OBSTACLE_00_A" not in decoded(encoder.encode(left, STATUS, POSE), "obstacles.dbc")


@pytest.mark.parametrize(("tentative", "names"), [(False, 1), (True, 5)])
def test_tentative_obstacles_are_told_on_demand(tentative: bool, names: int) -> None:
    bound = output("esr_ins")
    bound = dataclasses.replace(bound, settings=bound.settings.model_copy(update={"tentative": tentative}))
    encoder = OutputEncoder(bound)
    assert len(encoder.encode(obstacles(1, state=[TENTATIVE]), STATUS, POSE)) == names
    assert encoder.state.unreported == 0


@settings(deadline=None, max_examples=examples(50))
@given(st.data())
def test_any_obstacles_are_encoded_as_numbers_in_range(data: st.DataObject) -> None:
    wild = st.floats(width=64) | st.sampled_from([math.nan, math.inf, -math.inf, 1e300])
    n = data.draw(st.integers(0, 6))
    names = ("x", "y", "vx", "vy", "ax", "ay", "sx", "sy", "svx", "svy", "age", "existence")
    drawn = {name: np.array(data.draw(st.lists(wild, min_size=n, max_size=n)), np.float64) for name in names}
    encoder = OutputEncoder(output("esr_ins"))
    for message in decoded(encoder.encode(obstacles(n, **drawn), STATUS, POSE), "obstacles.dbc").values():
        assert all(math.isfinite(value) for value in message.values())
        assert message.get("State") != 1
    lost = sum(not np.isfinite([drawn[name][k] for name in names[:4]]).all() for k in range(n))
    assert encoder.state.unreported >= lost


@pytest.mark.parametrize("config", ["esr_ins", "ars408_to_esr", "esr_to_ars408"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
@pytest.mark.parametrize("name", ["x", "vy", "ax", "ay", "svx", "existence", "age"])
def test_what_is_no_number_never_reaches_the_bus(config: str, value: float, name: str) -> None:
    bound = output(config)
    seen = obstacles(2, **{name: [value, 0.5]})
    for message in decoded(OutputEncoder(bound).encode(seen, STATUS, POSE), bound.database.path.name).values():
        assert all(math.isfinite(number) for number in message.values())


def test_without_a_number_a_deviation_is_the_greatest() -> None:
    found = decoded(OutputEncoder(output("esr_ins")).encode(obstacles(1, sx=[math.nan]), STATUS, POSE), "obstacles.dbc")
    signal = dbc("obstacles.dbc").get_message_by_name("OBSTACLE_00_C").get_signal_by_name("SdX")
    assert found["OBSTACLE_00_C"]["SdX"] == signal.maximum


BODIES: dict[str, list[Any]] = {
    "heading": [-1.2, math.nan, math.pi], "yaw_rate": [0.4, math.nan, -9.0], "length": [4.6, math.nan, 90.0],
    "width": [1.9, math.nan, 0.01], "kind": [CLASSES.index("truck"), 0, CLASSES.index("standing")],
    "kind_likelihood": [0.8, math.nan, 0.0], "center_x": [12.2, 20.0, 30.0], "center_y": [-0.8, 0.0, 0.0],
}  # fmt: skip
STEPS = {
    "esr_ins": {
        "heading": math.radians(3),
        "yaw_rate": math.radians(3),
        "length": 0.4,
        "width": 0.25,
        "likelihood": 0.2,
        "center": 0.4,
    },
    "mando": {
        "heading": math.radians(0.1),
        "yaw_rate": math.radians(0.1),
        "length": 0.1,
        "width": 0.1,
        "likelihood": 0.005,
        "center": 0.02,
    },
}
"""Of the signals on classic CAN, and on CAN FD."""


@pytest.mark.parametrize("config", STEPS)
def test_a_body_comes_back_and_what_is_unknown_stays_so(config: str) -> None:
    bound, step = output(config), STEPS[config]
    decoder, seen = OutputDecoder(bound), obstacles(3, **BODIES)
    for can_id, payload in OutputEncoder(bound).encode(seen, STATUS, POSE):
        assert list(decoder.push(can_id, payload)) == []
    (told,) = decoder.flush()
    columns, reach = told.columns(), 0.5001
    assert columns["class"].tolist() == BODIES["kind"]
    for name in ("heading", "yaw_rate", "length", "width"):
        expected = BODIES[name]
        assert columns[name][0] == pytest.approx(expected[0], abs=reach * step[name]), name
        assert np.isnan(columns[name]).tolist() == [False, True, False], name
    likely = columns["class_likelihood"].tolist()
    assert likely == pytest.approx([0.8, math.nan, 0.0], abs=reach * step["likelihood"], nan_ok=True)
    place = reach * (step["center"] + (0.125 if config == "esr_ins" else 0.01))
    assert columns["center_x"].tolist() == pytest.approx(BODIES["center_x"], abs=place)
    assert columns["center_y"].tolist() == pytest.approx(BODIES["center_y"], abs=place)
    # what is beyond a signal's range is at its end, which says something
    assert abs(columns["heading"][2]) == pytest.approx(math.pi, abs=step["heading"])
    assert columns["yaw_rate"][2] == pytest.approx(np.radians(-45 if config == "esr_ins" else -102.3))
    assert columns["length"][2] > 25.0
    assert columns["width"][2] == pytest.approx(step["width"])


def test_without_a_value_for_unknown_it_is_the_greatest() -> None:
    bound = output("esr_ins")
    signals = bound.settings.signals | {"heading": (ObjectSignalRef(signal="Heading"),)}
    told = bound.settings.model_copy(update={"signals": signals})
    bound = bind_output(told, bound.bus, bound.database, SettingLocation())
    found = decoded(OutputEncoder(bound).encode(obstacles(1, heading=[math.nan]), STATUS, POSE), "obstacles.dbc")
    assert found["OBSTACLE_00_D"]["Heading"] == 189


def test_a_configuration_without_the_body_sends_the_same_frames_without_it() -> None:
    bound = output("esr_ins")
    form = bound.settings.objects
    body = {"heading", "yaw_rate", "length", "width", "class", "class_likelihood", "center_dx", "center_dy"}
    without = bound.settings.model_copy(
        update={
            "objects": form.model_copy(update={"messages": form.messages[:3]}),
            "signals": {name: refs for name, refs in bound.settings.signals.items() if name not in body},
        }
    )
    seen = obstacles(3, **BODIES)
    told = OutputEncoder(bind_output(without, bound.bus, bound.database, SettingLocation())).encode(seen, STATUS, POSE)
    more = OutputEncoder(bound).encode(seen, STATUS, POSE)
    assert told == more[: len(told)]
    assert [bound.database.by_id[can_id].name[-1] for can_id, _ in more[len(told) :]] == ["D"] * 3


def test_a_body_turns_with_the_mount() -> None:
    seen = obstacles(2, heading=[3.0, math.nan], center_x=[5.0, 0.0], center_y=[1.0, 0.0], x=[4.0, 0.0], y=[1.0, 0.0])
    view = MountView([SeenCycle(seen, np.array([0, 1]), POSE)], Mount(x=1.0, yaw_deg=-90))
    heading = view.quantity("heading", polar=False)
    assert heading[0] == pytest.approx(3.0 + math.pi / 2 - 2 * math.pi)
    assert math.isnan(heading[1])
    names = ("center_x", "center_y", "center_dx", "center_dy")
    assert [view.quantity(name, polar=False)[0] for name in names] == pytest.approx([-1.0, 4.0, 0.0, 1.0])


def test_an_ars408s_list_tells_orientation_size_and_class() -> None:
    seen = obstacles(3, **BODIES)
    bound = output("esr_to_ars408")
    frames = OutputEncoder(bound).encode(seen, STATUS, POSE)
    reader = bind_reader(bound.settings.objects, {"class": bound.settings.signals["class"][0]}, bound.database)
    columns = [[data for can_id, data in frames if can_id == part.messages[0].can_id] for part in reader.layouts]
    told = [dbc("ars408.dbc").decode_message("Obj_3_Extended", data)["Obj_Class"] for data in columns[2]]  # type: ignore[call-overload]  # plain
    assert [str(kind) for kind in told] == ["truck", "point", "point"]
    # what has no code of its own is unknown to who reads it
    assert reader.read(columns).values.tolist() == [[CLASSES.index("truck"), 0, 0]]
    (scan,) = scans(sensor("ars408"), frames)
    rows = dict(zip(sensor("ars408").reader.quantities, scan.values, strict=True))
    assert rows["heading"][:2].tolist() == pytest.approx([-1.2, 0.0], abs=math.radians(0.2))
    assert rows["length"].tolist() == pytest.approx([4.6, math.nan, math.nan], abs=0.1001, nan_ok=True)
    assert rows["width"].tolist() == pytest.approx([1.9, math.nan, 0.2], abs=0.1001, nan_ok=True)


def test_what_is_no_number_leaves_the_other_axis_alone() -> None:
    found = decoded(
        OutputEncoder(output("esr_ins")).encode(obstacles(1, ax=[math.inf], ay=[-2.0]), STATUS, POSE), "obstacles.dbc"
    )
    assert found["OBSTACLE_00_B"]["Ax"] == pytest.approx(0, abs=0.1)
    assert found["OBSTACLE_00_B"]["Ay"] == pytest.approx(-2.0, abs=0.1)


def moving(n: int, seed: int) -> tuple[Obstacles, EgoPose]:
    """Return obstacles before a turning vehicle, and its pose."""
    random = np.random.default_rng(seed)
    x = 8 + 1.3 * random.permutation(n) + random.uniform(0, 0.5, n)  # apart, so that each is found again by its place
    y = random.uniform(-0.9, 0.9, n) * (x - 4)
    vx, vy = random.uniform(-15, 15, (2, n))
    seen = obstacles(n, x=x, y=y, vx=vx, vy=vy)
    return seen, EgoPose(0, 1.0, 2.0, 0.7, 9.0, 4.0, 0.2, 0.01, EgoStatus.VALID)


@settings(deadline=None, max_examples=examples(25))
@given(seed=st.integers(0, 1000), n=st.integers(0, 64))
def test_written_as_esr_targets_obstacles_read_back(seed: int, n: int) -> None:
    seen, pose = moving(n, seed)
    bound = output("ars408_to_esr")
    frames = OutputEncoder(bound).encode(seen, STATUS, pose)
    assert len(frames) == 64
    (scan,) = scans(sensor("esr_ins"), frames)
    assert len(scan.slot) == n
    assert scan.new.all()
    rows = dict(zip(sensor("esr_ins").reader.quantities, scan.values, strict=True))
    x = 3.6 + rows["range"] * np.cos(rows["azimuth"])
    y = rows["range"] * np.sin(rows["azimuth"])
    nearest = np.array(
        [np.argmin(np.hypot(at_x - seen.x, at_y - seen.y)) for at_x, at_y in zip(x, y, strict=True)], int
    )
    assert sorted(nearest.tolist()) == list(range(n))
    assert np.hypot(x - seen.x[nearest], y - seen.y[nearest]) == pytest.approx(0, abs=0.15)
    view = MountView([SeenCycle(seen, nearest, pose)], bound.settings.mount)
    assert rows["range_rate"] == pytest.approx(view.quantity("range_rate", polar=True), abs=0.006)


@settings(deadline=None, max_examples=examples(25))
@given(seed=st.integers(0, 1000), n=st.integers(0, 40))
def test_written_as_ars408_objects_obstacles_read_back(seed: int, n: int) -> None:
    seen, pose = moving(n, seed)
    bound = output("esr_to_ars408")
    encoder = OutputEncoder(bound)
    n = min(n, bound.writer.slots)
    frames = encoder.encode(seen, STATUS, pose)
    assert len(frames) == 1 + 3 * n
    (scan,) = scans(sensor("ars408"), frames)
    assert scan.complete
    rows = dict(zip(sensor("ars408").reader.quantities, scan.values, strict=True))
    everyone = MountView([SeenCycle(seen, np.arange(len(seen)), pose)], bound.settings.mount)
    places = [everyone.quantity(name, polar=False) for name in ("x", "y")]
    told = np.array(
        [np.argmin(np.hypot(places[0] - x, places[1] - y)) for x, y in zip(rows["x"], rows["y"], strict=True)], int
    )
    assert len(set(told.tolist())) == n
    view = MountView([SeenCycle(seen, told, pose)], bound.settings.mount)
    for name, quantity, step in (("x", "x", 0.2), ("y", "y", 0.2), ("vx", "rel_vx", 0.25), ("vy", "rel_vy", 0.25)):
        assert rows[name] == pytest.approx(view.quantity(quantity, polar=False), abs=0.51 * step)
    again = encoder.encode(obstacles(1), STATUS, pose)
    assert len(again) == 4  # a list names what there is; nothing is sent for what left


@settings(deadline=None, max_examples=examples(60))
@given(
    st.tuples(*[st.floats(-60, 60)] * 2, *[st.floats(-30, 30)] * 4),
    st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-0.6, 0.6)),
    st.tuples(*[st.floats(*ends).map(lambda value: round(value, 9)) for ends in ((-3, 4), (-1, 1), (-180, 180))]),
)
def test_relative_quantities_are_the_rates_of_what_the_mount_sees(
    motion: tuple[float, ...], ego: tuple[float, ...], place: tuple[float, ...]
) -> None:
    x, y, vx, vy, own_vx, own_vy = motion
    heading, _, turn = ego
    mount = Mount(x=place[0], y=place[1], yaw_deg=place[2])
    assume(math.hypot(x - mount.x, y - mount.y) >= 2.0)
    own = complex(own_vx, own_vy) * np.exp(1j * heading)
    over_ground = complex(vx, vy) * np.exp(1j * heading)
    step = 1e-4

    def at(time: float) -> complex:
        """Return the position in the mount's axes, the vehicle turning steadily."""
        axes = np.exp(-1j * (heading + turn * time))
        offset = complex(x, y) * np.exp(1j * heading) + (over_ground - own) * time
        seen = (offset * axes - complex(mount.x, mount.y)) * np.exp(-1j * math.radians(mount.yaw_deg))
        return complex(seen)

    rate = (at(step) - at(-step)) / (2 * step)
    pose = EgoPose(0, 0.0, 0.0, heading, own.real, own.imag, turn, 0.01, EgoStatus.VALID)
    view = MountView([SeenCycle(obstacles(1, x=[x], y=[y], vx=[vx], vy=[vy]), np.array([0]), pose)], mount)
    assert complex(view.position[0]) == pytest.approx(at(0.0), abs=1e-9)
    assert view.quantity("rel_vx", polar=False)[0] == pytest.approx(rate.real, abs=1e-4)
    assert view.quantity("rel_vy", polar=False)[0] == pytest.approx(rate.imag, abs=1e-4)
    closing = (abs(at(step)) - abs(at(-step))) / (2 * step)
    assert view.quantity("range_rate", polar=True)[0] == pytest.approx(closing, abs=1e-4)
    assert abs(complex(view.velocity[0])) == pytest.approx(math.hypot(vx, vy))


def test_deviations_turn_with_the_mount() -> None:
    seen = obstacles(1, sx=[0.5], sy=[0.2], svx=[1.0], svy=[0.0])
    view = MountView([SeenCycle(seen, np.array([0]), POSE)], Mount(yaw_deg=90))
    assert [view.quantity(name, polar=False)[0] for name in ("sx", "sy", "svx", "svy")] == pytest.approx(
        [0.2, 0.5, 0, 1]
    )


@pytest.mark.parametrize("config", ["esr_ins", "esr_ins_fd", "ars408_to_esr", "esr_to_ars408", "surround"])
def test_cycles_written_together_are_those_written_one_by_one(config: str) -> None:
    bound, random = output(config), np.random.default_rng(7)
    one_by_one, together = OutputEncoder(bound), OutputEncoder(bound)
    alive, youngest = list(range(1, 40)), 39
    planned, expected = [], []
    for cycle in range(2 * TOGETHER + 5):
        alive = [each for each in alive if random.random() > 0.05]
        youngest += (born := int(random.integers(0, 4)))
        alive += range(youngest - born + 1, youngest + 1)
        x, y, vx, vy = random.uniform(-300, 300, (4, len(alive)))
        seen = obstacles(len(alive), id=alive, x=x, y=y, vx=vx, vy=vy, heading=np.where(x > 0, vx, np.nan))
        status = OutputStatus(ego=2, health=cycle % 3, drops=cycle)
        expected.append(one_by_one.encode(seen, status, POSE))
        planned.append(together.plan(seen, status, POSE))
        assert len(planned[-1]) == len(expected[-1])
        if cycle == TOGETHER + 3:  # somebody asks for a cycle in the middle of those that wait
            assert planned[-2][:3] == expected[-2][:3]
    assert [list(each) for each in planned] == expected
    assert together.saturated == one_by_one.saturated > 0


def test_a_state_holds_what_was_planned_before() -> None:
    planning, following = OutputEncoder(output("esr_ins")), OutputEncoder(output("esr_ins"))
    payloads = planning.plan(obstacles(3, vx=[1e3, 0.0, 0.0]), STATUS, POSE)
    following.state = planning.state
    assert following.saturated == planning.saturated > 0
    assert len(payloads) == len(list(payloads)) == 13


def test_own_acceleration_follows_a_braking_turning_vehicle() -> None:
    own = EgoAcceleration()
    for k in range(100):
        time, speed = 0.05 * k, 20.0 - 2.0 * 0.05 * k
        heading = 1.0 + 0.1 * time
        pose = EgoPose(
            round(time * 1e9), 0.0, 0.0, heading, speed * math.cos(heading), speed * math.sin(heading), 0.1, 0.01,
            EgoStatus.VALID,
        )  # fmt: skip
        acceleration = own.update(pose)
    assert acceleration == pytest.approx(complex(-2.0, 0.1 * speed), abs=0.15)
    assert own.update(dataclasses.replace(pose, time_ns=pose.time_ns + 5_000_000_000)) == 0


def test_own_acceleration_begins_with_own_motion_whenever_that_is() -> None:
    """Before, a pose says 0 m/s of a vehicle that may drive; a log may begin at 0."""
    own = EgoAcceleration()
    pose = EgoPose(0, 0.0, 0.0, 0.0, 15.0, 0.0, 0.0, 0.01, EgoStatus.VALID)
    unknown = dataclasses.replace(pose, ve=0.0, status=EgoStatus.LOST)
    for k in range(40):
        here = unknown if k < 10 or 20 <= k < 30 else pose
        assert own.update(dataclasses.replace(here, time_ns=k * 50_000_000)) == 0
    assert EgoAcceleration().update(dataclasses.replace(pose, time_ns=50_000_000)) == 0
