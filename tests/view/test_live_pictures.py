"""Listening: what the service sends is drawn, with what is known of it here; else what is tracked here."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from threading import Event

import numpy as np
import pytest

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.config.load import load_config
from candaemon.errors import ConfigError
from candaemon.frames.frame import Frame
from candaemon.pipeline.pipeline import Pipeline
from candaemon.tracking.obstacles import TENTATIVE
from candaemon.view.live_pictures import SILENT_NS, LiveListener, Mixer, counterparts
from candaemon.view.picture import Picture
from tests.support.paths import ROOT
from tests.support.recorded import highway
from tests.support.viewing import demo_binding, demo_pictures

LATE_NS = 2_000_000
"""How long after a scan its obstacles come."""


def service_frames(frames: list[Frame]) -> list[tuple[int, list[Frame]]]:
    """Return what a service sends of frames: when, and what."""
    pipeline = Pipeline(demo_binding())
    return [(cycle.time_ns + LATE_NS, list(cycle.frames)) for cycle in pipeline.run(frames)]


def on_the_bus(seconds: float = 3.0, *, until_s: float = 1e9) -> list[Frame]:
    """Return the frames of a drive and those of the service, in order of time.

    Args:
        seconds: of the drive.
        until_s: after which the service is silent.
    """
    frames = highway(demo_binding(), seconds)
    end_ns = frames[0].time_ns + round(until_s * 1e9)
    sent = [
        frame._replace(time_ns=time_ns)
        for time_ns, batch in service_frames(frames)
        for frame in batch
        if time_ns < end_ns
    ]
    return sorted([*frames, *sent], key=lambda frame: frame.time_ns)


def heard(frames: list[Frame]) -> list[Picture]:
    """Return what is seen of frames that come one by one, with silence where there is some."""
    mixer = Mixer(demo_binding())
    before_ns = frames[0].time_ns
    found: list[Picture] = []
    for frame in frames:
        if frame.time_ns - before_ns > 5_000_000:
            found += mixer.silence(before_ns + 4_000_000)
        found += mixer.heard([frame])
        before_ns = frame.time_ns
    return found


def test_the_obstacles_of_the_bus_are_drawn_once_a_cycle() -> None:
    frames = highway(demo_binding(), 3.0)
    cycles = {
        cycle.obstacles.time_ns: cycle.obstacles
        for cycle in Pipeline(demo_binding()).run(frames)
        if len(cycle.obstacles)
    }
    pictures = [picture for picture in heard(on_the_bus()) if picture.heard and len(picture)]
    assert len(pictures) > 40
    assert len({picture.time_ns for picture in pictures}) == len(pictures)
    for picture in pictures:
        obstacles = cycles[picture.time_ns]
        sent = obstacles.state != TENTATIVE
        order = np.argsort(picture.columns["id"])
        np.testing.assert_array_equal(picture.columns["id"][order], np.sort(obstacles.id[sent]))
        expected = obstacles.x[sent][np.argsort(obstacles.id[sent])]
        np.testing.assert_allclose(picture.columns["x"][order], expected, atol=0.06)


def test_what_the_wire_does_not_carry_is_taken_of_the_same_obstacle_here() -> None:
    pictures = [picture for picture in heard(on_the_bus()) if picture.heard and len(picture)]
    nis = np.concatenate([picture.columns["nis"] for picture in pictures])
    assert np.isfinite(nis).mean() > 0.8
    assert 0.2 < np.nanmean(nis) < 3.0
    assert all(picture.pose.ve != 0.0 or picture.pose.vn != 0.0 for picture in pictures)


def test_every_scan_is_drawn_once() -> None:
    pictures = heard(on_the_bus())
    drawn = [scan.x.tobytes() for picture in pictures for scan in picture.scans if len(scan.x)]
    scans = [
        cycle.detections.x.tobytes()
        for cycle in Pipeline(demo_binding()).run(highway(demo_binding(), 3.0))
        if cycle.detections is not None and len(cycle.detections)
    ]
    assert len(drawn) == len(set(drawn))
    assert set(drawn) <= set(scans)
    assert len(drawn) >= len(scans) - 2


def test_where_the_service_falls_silent_what_is_tracked_here_is_drawn() -> None:
    pictures = heard(on_the_bus(4.0, until_s=1.5))
    first_ns = pictures[0].time_ns
    last_heard = max(picture.time_ns for picture in pictures if picture.heard)
    assert last_heard - first_ns < 1.7e9
    own = [picture for picture in pictures if not picture.heard and picture.time_ns > last_heard]
    assert len(own) > 20
    assert min(picture.time_ns for picture in own) - last_heard <= SILENT_NS + 100_000_000


def test_without_a_service_every_cycle_is_drawn() -> None:
    frames = highway(demo_binding(), 2.0)
    pictures = list(chain(Mixer(demo_binding()).heard(frames)))
    cycles = list(Pipeline(demo_binding()).run(frames))
    assert [picture.time_ns for picture in pictures] == [cycle.obstacles.time_ns for cycle in cycles]
    assert not any(picture.heard for picture in pictures)


def test_obstacles_without_own_motion_are_drawn_where_the_wire_says() -> None:
    frames = highway(demo_binding(), 2.0)
    sent = [frame for _, batch in service_frames(frames) for frame in batch]
    mixer = Mixer(demo_binding())
    pictures = [picture for frame in sent for picture in mixer.heard([frame])]
    assert all(picture.heard for picture in pictures)
    assert any(len(picture) for picture in pictures)
    assert pictures[-1].modes.shape[0] == len(pictures[-1])


def test_counterparts_are_the_nearest_within_a_bound() -> None:
    columns = {
        name: np.array(values)
        for name, values in {
            "id": [1, 2],
            "x": [0.0, 50.0],
            "y": [0.0, 0.0],
            "vx": [1.0, 1.0],
            "vy": [0.0, 0.0],
        }.items()
    }
    others = {
        name: np.array(values)
        for name, values in {
            "id": [7, 8],
            "x": [49.5, 0.9],
            "y": [0.0, 0.0],
            "vx": [1.0, 1.0],
            "vy": [0.0, 0.0],
        }.items()
    }
    rows, alike = counterparts(columns, others)
    assert rows.tolist() == [1, 0]
    assert alike.tolist() == [True, True]
    others["vx"] = np.array([9.0, 9.0])
    assert counterparts(columns, others)[1].tolist() == [False, False]
    assert counterparts(columns, {**others, "id": np.array([])})[1].tolist() == [False, False]


def test_buses_of_one_process_cannot_be_listened_to() -> None:
    with pytest.raises(ConfigError, match="virtual"):
        LiveListener(demo_binding())


def test_frames_that_the_view_missed_are_told(tmp_path: Path) -> None:
    listener = LiveListener(none_there(tmp_path))
    listener.buses[1].counts.kernel_lost = 7
    told = [picture.health for picture in map(listener._counted, demo_pictures()) if picture.health]
    assert {health["unheard"] for health in told} == {7}


def none_there(folder: Path) -> Binding:
    """Return a configuration whose interfaces are not there."""
    text = (ROOT / "config" / "toyota_rav4_ins.yaml").read_text(encoding="utf-8").replace("../dbc", str(ROOT / "dbc"))
    path = folder / "car.yaml"
    path.write_text(text.replace("channel: can", "channel: none"), encoding="utf-8")
    return bind(load_config(path))


def test_a_bus_that_is_not_there_is_waited_for(tmp_path: Path) -> None:
    stopping = Event()
    stopping.set()
    assert list(LiveListener(none_there(tmp_path)).pictures(stopping)) == []
