"""The compiled kernels give the bits that numpy gives without them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from candaemon import compiled
from candaemon.arrays import Floats, Indices, Integers
from candaemon.binding.bound import Binding
from candaemon.calibration.ego_path import ego_path
from candaemon.calibration.readings import HeldScan, SensorReader
from candaemon.calibration.window import WindowReader
from candaemon.can_io.logs.candump import ChunkDecoder, candump_text
from candaemon.can_io.logs.stream import ChannelMap, LogCounts
from candaemon.config.ego import InsSettings
from candaemon.config.estimators import CsEstimatorSettings, ImmEstimatorSettings, SingerEstimatorSettings
from candaemon.config.sensors import FieldOfView
from candaemon.config.tracker import (
    AloneSettings,
    AssociationSettings,
    LifecycleSettings,
    ReflectionSettings,
    TrackerSettings,
)
from candaemon.config.vehicle import VehicleEstimatorSettings
from candaemon.ego.ins import InsMotion
from candaemon.ego.motion import MotionHistory
from candaemon.ego.pose import EgoPose, EgoStatus
from candaemon.estimation.axis_filter import AxisFilter, WhiteAxis
from candaemon.estimation.body_filter import BIAS, SEEN, TURN, BodyFilter, BodyFilterState, BodyMode, motion, shown
from candaemon.estimation.body_rates import BodyRates
from candaemon.estimation.discretisation import directed
from candaemon.estimation.filter_bank import FilterBank
from candaemon.estimation.imm import mix
from candaemon.estimation.kalman import propagate, symmetrise, update_position, update_scalar
from candaemon.estimation.measurement import Measurement, Projection
from candaemon.estimation.motion_models import CurrentStatistical
from candaemon.estimation.outline import facing_point
from candaemon.evaluation.duplicates import duplicated
from candaemon.evaluation.number_text import joined_lines, number_lines, text_lines
from candaemon.evaluation.object_runs import last_rows
from candaemon.frames.frame import EXTENDED
from candaemon.frames.frame_batch import FrameBatch
from candaemon.frames.frame_block import FrameBlock
from candaemon.pipeline.saved_state import dump
from candaemon.playback.replay import ReplayRequest, replay
from candaemon.radar.detections import Detections
from candaemon.radar.mounting import _placed, sensor_views
from candaemon.radar.scan import ScanCounts
from candaemon.radar.selection import Selection
from candaemon.tracking import box
from candaemon.tracking.association import pair_nis
from candaemon.tracking.body_association import Association, associate
from candaemon.tracking.body_axes import turned_axes
from candaemon.tracking.body_existence import BodyExistence
from candaemon.tracking.body_measurement import of_bodies
from candaemon.tracking.body_merging import alongside_long, merge_candidates, split_candidates
from candaemon.tracking.body_modes import dynamics_of, modes_of
from candaemon.tracking.body_report import report
from candaemon.tracking.body_riders import any_far_along
from candaemon.tracking.body_sizes import WALKER
from candaemon.tracking.body_store import UNUSED, Bodies
from candaemon.tracking.body_width import extent_across
from candaemon.tracking.columns import longer_ago
from candaemon.tracking.estimator_factory import make_estimator
from candaemon.tracking.id_rows import IdRows
from candaemon.tracking.identities import Identities
from candaemon.tracking.innovation_correlation import _innovations
from candaemon.tracking.majority import contradicting
from candaemon.tracking.reflection_noise import SensorWalks
from candaemon.tracking.reflections import from_travel_axes, near_pairs, to_travel_axes
from candaemon.tracking.sensor_visibility import Visibility
from candaemon.tracking.straying import note_strays, strays
from candaemon.tracking.turning import Turning
from candaemon.tracking.update import Used
from candaemon.tracking.vehicle_tracker import VehicleTracker, _standing, expected_places
from tests.benchmarks.chains import full_binding, imm_binding, reduced_binding, simulated_log

pytestmark = pytest.mark.skipif(not compiled.in_use, reason="the kernels are not compiled: no compiler or no Cython")

TRACKS = 9
UNLIKE_MODELS = ImmEstimatorSettings.model_validate(
    {
        "models": [
            {"kind": "cv", "noise": 1.0},
            {"kind": "ca", "noise": {"along": 3.0, "across": 0.5}, "settling": {"along": 8.0, "across": 1.0}},
            {"kind": "jerk", "noise": 2.0},
            {"kind": "cs"},
            {"kind": "ct", "noise": 0.1, "turn_noise": 0.1},
        ]
    }
)
"""Some alone have a component and several have another; F and Q of all tracks or of each."""


def both(monkeypatch: pytest.MonkeyPatch, compute: Callable[[], list[Floats]]) -> None:
    """Compute with the kernels and without, and compare to the last bit."""
    found = compute()
    with monkeypatch.context() as patch:
        patch.setattr(compiled, "in_use", False)
        expected = compute()
    for one, other in zip(found, expected, strict=True):
        assert np.isfinite(one).any()
        np.testing.assert_array_equal(one.view(np.int64), other.view(np.int64))


def states(models: int, width: int) -> tuple[Floats, Floats]:
    """Return means and covariances, the first one of no rank."""
    random = np.random.default_rng(models * 10 + width)
    root = random.normal(size=(TRACKS, models, width, width)) * 10.0 ** random.integers(-3, 3, (TRACKS, models, 1, 1))
    root[0] = 0.0
    covariance = root @ np.swapaxes(root, -1, -2)
    symmetrise(covariance)
    return random.normal(size=(TRACKS, models, width)), covariance


@pytest.mark.parametrize("memory", [None, 0.5])
@pytest.mark.parametrize("some", [False, True])
@pytest.mark.parametrize("model", [WhiteAxis(1, 2.0), WhiteAxis(3, 0.5), CurrentStatistical(0.5, 8.0, 0.1)])
def test_a_filter_of_axes_over_many_cycles(
    model: WhiteAxis | CurrentStatistical, memory: float | None, some: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = model.order + 1 if isinstance(model, WhiteAxis) else 3
    chosen = model if isinstance(model, WhiteAxis) else replace(model, innovation_memory=memory)

    def computed() -> list[Floats]:
        random = np.random.default_rng(5)
        axes = AxisFilter(chosen)
        root = random.normal(size=(TRACKS, size, size))
        root[0] = 0.0
        axes.spawn(random.normal(size=(TRACKS, size)), root @ np.swapaxes(root, 1, 2))
        rows = np.array([7, 0, 3]) if some else None
        for k in range(20):
            axes.predict(0.05)
            positions = random.normal(size=3 if some else TRACKS)
            axes.update(positions, 0.0 if k == 3 else 0.2 if k % 2 else np.full(positions.shape, 0.1), rows)
        return [axes.state.columns, axes.state.mean_nis, axes.fit.nis, axes.fit.log_likelihood]

    both(monkeypatch, computed)


@pytest.mark.parametrize("width", [4, 6, 7, 9])
@pytest.mark.parametrize("models", [1, 3])
def test_each_kernel_alone(models: int, width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(1)
    position, noise = random.normal(size=(TRACKS, 1, 2)), np.tile([[0.3, 0.1], [0.1, 0.2]], (TRACKS, 1, 1, 1))
    noise[0] = 0.0
    position[1], position[2] = np.nan, 1e200
    row, innovation = random.normal(size=(TRACKS, models, 4)), random.normal(size=(TRACKS, models))

    def computed() -> list[Floats]:
        mean, covariance = states(models, width)
        first = update_position(mean, covariance, position, noise)
        second = update_scalar(mean, covariance, row, innovation, np.full((TRACKS, 1), 0.1))
        skew = covariance + np.arange(width)
        symmetrise(skew)
        fits = [first.nis, first.log_likelihood, second.nis, second.log_likelihood]
        return [mean, covariance, *fits, skew]

    both(monkeypatch, computed)


@pytest.mark.parametrize(
    "settings",
    [ImmEstimatorSettings(), UNLIKE_MODELS, CsEstimatorSettings(kind="cs"), SingerEstimatorSettings(kind="singer")],
    ids=["imm", "imm-unlike", "cs", "singer"],
)
def test_a_filter_over_many_cycles(
    settings: ImmEstimatorSettings | CsEstimatorSettings | SingerEstimatorSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    def computed() -> list[Floats]:
        random, estimator = np.random.default_rng(2), make_estimator(settings)
        noise, at_rest = np.tile([[0.06, 0.02], [0.02, 0.3]], (TRACKS, 1, 1)), np.zeros(2)
        place = random.normal(scale=30.0, size=(TRACKS, 2))
        estimator.spawn(place, noise, np.zeros((TRACKS, 2)), np.tile(np.eye(2) * 225.0, (TRACKS, 1, 1)))
        assert isinstance(estimator, FilterBank)
        out: list[Floats] = []
        for step in range(50):
            estimator.predict(0.05, np.tile([0.6, 0.8], (TRACKS, 1)))
            rows = np.flatnonzero(random.random(TRACKS) < (0.8 if step % 3 else 2.0))
            rate = np.where(random.random(len(rows)) < 0.2, np.nan, random.normal(size=len(rows)))
            measured = place[rows] + 0.3 * step + random.normal(scale=0.3, size=(len(rows), 2))
            along = Projection(np.tile([0.6, 0.8], (len(rows), 1)), rate[::-1], np.full(len(rows), 0.2))
            further = (along,) if step % 4 == 0 else ()
            rated, variance = (rate, np.full(len(rows), 0.01)) if step % 5 else (None, None)
            measurement = Measurement(measured, noise[rows], at_rest, at_rest + 0.1, rated, variance, further)
            nis = estimator.update(rows, measurement)
            out += [*(each.copy() for each in estimator.combined()), nis, estimator.probability.copy()]
        return out

    both(monkeypatch, computed)


@pytest.mark.parametrize("width", [4, 7, 9])
def test_prediction_and_mixing_with_components_that_some_models_lack(
    width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(4)
    one, each = (np.where(random.random((n, width, width)) < 0.4, random.normal(size=1), 0.0) for n in (1, TRACKS))
    noise, has = np.eye(width)[None] * 1e-3, random.random((3, width)) < 0.6
    probability, switch = random.dirichlet(np.ones(3), TRACKS), random.dirichlet(np.ones(3), 3)

    def computed() -> list[Floats]:
        mean, covariance = states(3, width)
        covariance[1, 0, 2, 2] = -1.0
        propagate(covariance[:, 0], one, noise)
        propagate(covariance[:, 1], each, np.tile(noise, (TRACKS, 1, 1)))
        assert (covariance[1, 0].diagonal() >= 0.0).all()
        return [covariance, *mix(mean, covariance, probability, switch, has)]

    both(monkeypatch, computed)


@pytest.mark.parametrize("with_rate", [True, False])
def test_how_well_pairs_fit(with_rate: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(5)
    mean, covariance = (each[:, 0] for each in states(1, 6))
    rate, variance = random.normal(size=TRACKS), np.full(TRACKS, 0.04)
    rate[2] = np.nan
    position, noise, origin = random.normal(size=(TRACKS, 2)), np.tile(np.eye(2), (TRACKS, 1, 1)), np.array([3.0, -1.0])
    speed = (rate, variance) if with_rate else (None, None)
    measurement = Measurement(position, noise, origin, np.array([7.0, 0.1]), *speed)
    both(monkeypatch, lambda: [pair_nis(mean, covariance, measurement)])


MODES = modes_of(VehicleEstimatorSettings(kind="vehicle"))
DYNAMICS = dynamics_of(VehicleEstimatorSettings(kind="vehicle"))


def bodies_of(n: int, modes: Sequence[BodyMode]) -> BodyFilter:
    """Return a filter of n bodies; one is at rest, one knows nothing or all of itself, one races."""
    random, m = np.random.default_rng(n), len(modes)
    mean = random.normal(size=(n, m, 8)) * [40.0, 20.0, 12.0, 6.0, 0.5, 1.0, 0.3, 0.3]
    root = random.normal(size=(n, m, 8, 8))
    mean[1:2, :, 2:4], mean[2:3] = 0.0, 0.0
    root[2:3] = 0.0
    mean[3:4], root[4:5] = mean[3:4] * 1e6, root[4:5] * 1e9
    bodies = BodyFilter(modes, DYNAMICS)
    bodies.state = BodyFilterState(mean, root @ np.swapaxes(root, -1, -2), random.dirichlet(np.ones(m), n))
    return bodies


def told(bodies: BodyFilter) -> list[Floats]:
    """Return all that a filter of bodies remembers, and the number one, which no filter without bodies is."""
    state = bodies.state
    np.testing.assert_array_equal(state.covariance, np.swapaxes(state.covariance, -1, -2))
    return [np.append(each, 1.0) for each in (state.mean, state.covariance, state.probability)]


@pytest.mark.parametrize("modes", [MODES, MODES[:1], MODES[3:4], MODES[2:4]], ids=["all", "one", "standing", "two"])
@pytest.mark.parametrize("bodies", [0, 1, 5, 8, 19])
def test_mixing_of_bodies(bodies: int, modes: Sequence[BodyMode], monkeypatch: pytest.MonkeyPatch) -> None:
    hidden = np.random.default_rng(5).random(bodies)

    def computed() -> list[Floats]:
        tracked = bodies_of(bodies, modes)
        tracked._interact(0.05, hidden)
        return told(tracked)

    both(monkeypatch, computed)


@pytest.mark.parametrize("linking", [False, True])
@pytest.mark.parametrize("settling", [0.0, 1.0])
@pytest.mark.parametrize("modes", [MODES, MODES[:1], MODES[3:4]], ids=["all", "one", "standing"])
@pytest.mark.parametrize("bodies", [0, 1, 8, 19])
def test_prediction_of_bodies(
    bodies: int, modes: Sequence[BodyMode], settling: float, linking: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = np.random.default_rng(6)
    angle, walk, hidden = random.uniform(-3.0, 3.0, bodies), random.random((bodies, 2)), random.random(bodies)
    axis = np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def computed() -> list[Floats]:
        tracked = bodies_of(bodies, modes)
        tracked.linking = linking
        tracked.state.mean[::5, :, TURN] = 99.0  # an estimate that ran away
        tracked.state.mean[1::5, :, TURN] = -99.0
        for _ in range(3):
            tracked.predict(0.07, axis, walk, hidden * settling, 0.5 + hidden)
        return told(tracked)

    both(monkeypatch, computed)


@pytest.mark.parametrize("modes", [MODES, MODES[:1]], ids=["all", "one"])
@pytest.mark.parametrize("bodies", [0, 1, 8, 19])
def test_what_all_modes_say_of_bodies(bodies: int, modes: Sequence[BodyMode], monkeypatch: pytest.MonkeyPatch) -> None:
    def computed() -> list[Floats]:
        filter_ = bodies_of(bodies, modes)
        mean, covariance = filter_.combined()
        np.testing.assert_array_equal(covariance, np.swapaxes(covariance, 1, 2))
        moments, seen = filter_.moments(), covariance[:, SEEN][:, :, SEEN]
        told = (mean, covariance[:, :4, :4], *shown(mean, seen))
        for each, same in zip(moments, told, strict=True):
            np.testing.assert_array_equal(each, same)
        found = (mean, covariance, *moments, motion(mean))
        assert all(len(each) == bodies for each in found)
        return [np.append(each, 1.0) for each in found]

    both(monkeypatch, computed)


@pytest.mark.parametrize("parts", [0, 2])
@pytest.mark.parametrize(("rated", "turning"), [(False, False), (True, False), (True, True)])
@pytest.mark.parametrize("modes", [MODES, MODES[:1]], ids=["all", "one"])
@pytest.mark.parametrize(
    ("bodies", "rows"), [(0, []), (1, [0]), (9, []), (9, [7, 2]), (19, range(19)), (19, range(5, 18))]
)
def test_updates_of_bodies(
    bodies: int,
    rows: Sequence[int],
    modes: Sequence[BodyMode],
    rated: bool,
    turning: bool,
    parts: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    random, n = np.random.default_rng(7), len(rows)

    def some(count: int) -> Floats:
        return np.where(random.random(count) < 0.4, np.nan, random.normal(size=count))

    projections = tuple(Projection(random.normal(size=(n, 2)), some(n), np.full(n, 0.1)) for _ in range(parts))
    root = random.normal(size=(n, 2, 2))
    noise, place = root @ np.swapaxes(root, 1, 2) + np.eye(2) * 1e-4, random.normal(size=(n, 2)) * 30.0
    measurement = Measurement(place, noise, np.zeros(2), np.ones(2), projections=projections)
    body = np.repeat(np.arange(n), 3)
    offset = random.normal(size=(3 * n, 2)) * 4.0
    spread, sensor = random.random(3 * n), (np.zeros(2), np.ones(2))
    arm = random.normal(size=(3 * n, 2)) if turning else None
    rates = BodyRates(some(3 * n), np.full(3 * n, 0.04), body, offset, spread, *sensor, arm=arm) if rated else None

    def computed() -> list[Floats]:
        tracked = bodies_of(bodies, modes)
        nis = tracked.update(np.array(rows, dtype=np.intp), measurement, 0.5, rates)
        return [*told(tracked), np.append(nis, 1.0)]

    both(monkeypatch, computed)


def test_links_of_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    def computed() -> list[Floats]:
        tracked = bodies_of(2, MODES)
        tracked.linking = True
        hidden, bias_time = np.array([0.0, 0.4]), np.array([0.5, 2.0])
        tracked.predict(0.05, np.tile([0.6, 0.8], (2, 1)), np.full((2, 2), 0.1), hidden, bias_time)
        assert tracked.link is not None
        return [tracked.link.mean, tracked.link.covariance, tracked.link.gain]

    both(monkeypatch, computed)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_lines_of_logs_and_tables(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    payloads = [(0x7FF, bytes(range(8))), (0x1ABCDEF | EXTENDED, b""), (0x12, bytes(64))][:count]
    batch = FrameBatch(1_000_000_001, 0, payloads, frozenset({0x12}))
    parts = [text_lines([f"é{k}" for k in range(count)]), number_lines(np.arange(2.0 * count).reshape(-1, 2) / 3, 4)]

    def computed() -> list[Floats]:
        written = (candump_text(batch, ["can0"]), joined_lines("1.5,", parts, count))
        return [np.frombuffer(b"0" + each, dtype=np.uint8).astype(np.float64) for each in written]

    both(monkeypatch, computed)
    with pytest.raises(ValueError, match="different length"):
        joined_lines("", parts, count + 1)


def test_the_same_frames_are_in_a_log(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(11)
    lines = []
    for number in range(600):
        data = random.bytes(8).hex().upper()
        line = f"({1_600_000_000 + number}.{number:06d}) can{number % 3} {0x100 + number % 700:03X}#{data}"
        at = int(random.integers(1, len(line)))
        lines.append(line if random.random() < 0.7 else line[:at] + chr(random.integers(32, 127)) + line[at + 1 :])
    lines += [f"(1600000700.5{number:02d}000) can0 1234567{number % 16:X}##1{'0a' * 12}" for number in range(40)]
    lines += [f"(1600000800.000000) can1 {number:03x}#" for number in range(40)]
    lines += [f"(1600000900.000000) can1 {number:03X}#R8" for number in range(40)]

    def decoded() -> tuple[FrameBlock, LogCounts]:
        counts = LogCounts(tells=False)
        text = "\n".join(lines).encode()
        return ChunkDecoder(text, ChannelMap({"can0": 0, "can1": 1}), counts).decode(), counts

    block, counts = decoded()
    monkeypatch.setattr(compiled, "in_use", False)
    expected, expected_counts = decoded()
    assert counts == expected_counts
    assert len(block) > 300
    assert counts.malformed > 20
    for name in FrameBlock.__slots__:
        np.testing.assert_array_equal(getattr(block, name), getattr(expected, name))


INS_MESSAGES = (
    ("velocity_north", "velocity_east"),
    ("heading", "latitude"),
    ("curvature",),
    ("yaw_rate", "ax"),
    ("latitude",),
    ("valid",),
)


def ins_frames(seed: int) -> tuple[Integers, Indices, Floats]:
    """Return times, messages and values of frames at rates of their own, some lost and some bursts late."""
    random = np.random.default_rng(seed)
    times, message = [], []
    for number, step in enumerate((0.01, 0.01, 0.02, 0.05, 0.01, 0.1)):
        at = np.arange(0.0, 12.0, step) + 0.0003 * number + random.uniform(0.0, 1e-4, round(12.0 / step))
        kept = random.random(len(at)) < 0.97
        for _ in range(random.integers(0, 3)):
            begin = random.uniform(0.0, 11.0)
            kept &= (at < begin) | (at > begin + random.choice([0.1, 0.6, 1.5]))
        times.append((at[kept] * 1e9).astype(np.int64) + 10**18)
        message.append(np.full(np.count_nonzero(kept), number))
    order = np.argsort(np.concatenate(times), kind="stable")
    of = np.concatenate(message)[order]
    values = np.full((len(of), 3), np.nan)
    values[:, 0], values[:, 1] = random.normal(3.0, 0.3, len(of)), random.normal(8.0, 0.3, len(of))
    values[of == 2, 0] = 0.01
    values[of == 3, 0] = -0.09  # the heading turns by −0.1 rad/s
    values[of == 1, 0] = 1.0 + 0.001 * np.arange(np.count_nonzero(of == 1))
    values[of == 5, 0] = random.random(np.count_nonzero(of == 5)) < 0.9
    values[random.random(len(of)) < 0.01, 0] = np.nan
    return np.concatenate(times)[order], of, values


@pytest.mark.parametrize("given", [("heading",), ("heading", "curvature"), ("heading", "yaw_rate", "ax", "valid")])
@pytest.mark.parametrize("components", [False, True])
def test_frames_of_an_ins_one_by_one_and_together(given: tuple[str, ...], components: bool) -> None:
    names = (*given, *(INS_MESSAGES[0] if components else ("speed",)))
    signals = {name: f"M.{name}" for name in names}
    settings = InsSettings.model_validate(
        {"kind": "ins", "bus": "b", "dbc": "d", "signals": signals, "lever_arm": {"x": 1.2, "y": -0.3}, "latency": 0.02}
    )
    messages = INS_MESSAGES if components else (("speed",), *INS_MESSAGES[1:])
    for seed in range(8):
        one, other = InsMotion(settings), InsMotion(settings)
        columns, random = other.columns(messages), np.random.default_rng(seed)
        times, of, values = ins_frames(seed)
        other.keep(times, of, values, columns)
        end = together = 0
        while end < len(times):
            begin, end = end, min(end + int(random.integers(1, 40)), len(times))
            taken = other.update_together(begin, end)
            together += taken - begin
            for k in range(begin, end):
                if (columns[of[k]] >= 0).any():
                    frame = int(times[k]), messages[of[k]], values[k, : len(messages[of[k]])].tolist()
                    one.update(*frame)
                    if k >= taken:
                        other.update(*frame)
            if random.random() < 0.2:
                assert one.state == other.state
        assert one.state == other.state
        assert together > len(times) / 2


def test_the_same_points_are_near_one_another(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = np.random.default_rng(3).uniform(0.0, 30.0, (2, 60))
    x[7] = np.nan
    found = near_pairs(x, y, 6.0)
    monkeypatch.setattr(compiled, "in_use", False)
    expected = near_pairs(x, y, 6.0)
    assert len(found[0]) > 100
    assert (found[1] < found[0]).all()
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_same_obstacles_are_duplicates(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y, vx = np.random.default_rng(4).uniform(0.0, [[60.0], [8.0], [6.0]], (3, 80))
    x[7], vx[9] = np.nan, np.inf
    x[20], y[20], vx[20] = x[21] + 3.0, y[21] - 1.0, vx[21] + 1.0
    found = duplicated(x, y, vx)
    monkeypatch.setattr(compiled, "in_use", False)
    assert 10 < np.count_nonzero(found) < 70
    np.testing.assert_array_equal(found, duplicated(x, y, vx))
    assert not len(duplicated(x[:0], y[:0], vx[:0]))


@pytest.mark.parametrize("count", [0, 1, 3, 64, 1000])
@pytest.mark.parametrize("spread", [5, 100, 2**62])
def test_the_same_rows_have_a_number(count: int, spread: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(count)
    known = rng.integers(-spread, spread, count)
    wanted = rng.permutation(np.concatenate((known, rng.integers(-spread, spread, 9), [0, 2**63 - 1, -(2**63)])))
    found = last_rows(known, wanted)
    for row, number in zip(found.tolist(), wanted.tolist(), strict=True):
        assert row == max(np.flatnonzero(known == number), default=-1)
    monkeypatch.setattr(compiled, "in_use", False)
    np.testing.assert_array_equal(found, last_rows(known, wanted))


def test_travel_axes_and_the_points_that_face_us(monkeypatch: pytest.MonkeyPatch) -> None:
    vectors, axis = np.random.default_rng(6).normal(size=(2, 40, 2)) * 10.0
    vectors[0], vectors[1], vectors[2] = 0.0, np.nan, [1e100, -3.0]
    size = np.abs(axis)
    size[3] = 0.0

    def computed() -> list[Floats]:
        turned = to_travel_axes(vectors, axis)
        return [turned, from_travel_axes(turned, axis), facing_point(vectors, size[:, 0], size[:, 1])]

    both(monkeypatch, computed)


def bodies_on_road(k: int, extra: int) -> Bodies:
    """Return k bodies, some side by side, of every kind; the first `extra` of them have a second reflection."""
    random, bodies = np.random.default_rng(k + extra), Bodies(VehicleEstimatorSettings(kind="vehicle"), Identities())
    modes = len(bodies.filter.probability.T)
    place, velocity = random.uniform(-25.0, 25.0, (k, 2)), np.tile(random.normal(size=(k, 1, 2)) * 6.0, (1, modes, 1))
    place[1::4] = place[0 : len(place[1::4]) * 4 : 4] + 1.0
    velocity[1::4] = velocity[0 : len(velocity[1::4]) * 4 : 4] + 0.1
    spread, probability = np.tile(np.eye(2) * 0.1, (k, modes, 1, 1)), random.dirichlet(np.ones(modes), k)
    bodies.filter.spawn(place, np.tile(np.eye(2) * 0.2, (k, 1, 1)), velocity, spread, probability)
    angle = random.uniform(-3.0, 3.0, k)
    for each in angle:
        row = bodies.add(0, np.array([np.cos(each), np.sin(each)]), 4.5, 1.8)
        bodies.add_reflection(row, 0, row, 0, np.zeros(2))
    for row in range(extra):
        bodies.add_reflection(row, 0, None, 10**9 * (row % 2), random.normal(size=2))
    obstacles, reflections = bodies.obstacles, bodies.reflections
    obstacles.confirmed = random.random(k) < 0.7
    obstacles.length, obstacles.width = random.uniform(0.5, 14.0, k), random.uniform(0.5, 2.6, k)
    obstacles.length_variance, obstacles.width_variance = random.uniform(0.0, 4.0, k), random.uniform(0.0, 0.2, k)
    obstacles.alone, obstacles.fastest = random.uniform(-1.0, 3.0, k), random.uniform(0.0, 12.0, k)
    obstacles.facing, obstacles.interval = random.normal(size=(k, 2)), random.uniform(0.0, 0.2, k)
    obstacles.last_ns = np.where(random.random(k) < 0.8, 10**9, 0)
    reflections.last_ns = np.where(random.random(k + extra) < 0.7, 10**9, 0)
    reflections.offset, reflections.variance = random.normal(size=(k + extra, 2)), random.random(k + extra)
    return bodies


def scan_of(rows: int, speeds: bool) -> Detections:
    """Return a scan of as many detections, at 1 s."""
    random = np.random.default_rng(rows)
    place, noise = random.uniform(-25.0, 25.0, (rows, 2)), np.tile([[0.3, 0.1], [0.1, 0.2]], (rows, 1, 1))
    rate = np.where(random.random(rows) < 0.2, np.nan, random.normal(size=rows)) if speeds else None
    measurement = Measurement(place, noise, np.ones(2), np.array([9.0, 1.0]), rate, np.full(rows, 0.01))
    unsaid = np.zeros(rows, dtype=np.bool_)
    return Detections(10**9, 0, np.arange(rows), unsaid, measurement, place[:, 0], place[:, 1])


POSE = EgoPose(10**9, 3.0, -1.0, 0.4, 9.0, 1.0, 0.1, 0.01, EgoStatus.VALID, 1e-4)


def test_detections_in_the_local_frame_and_in_vehicle_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    offset, origin = np.random.default_rng(3).normal(size=(30, 2)) * 50.0, np.array([4.5, -1.5])
    both(monkeypatch, lambda: list(_placed(offset, origin, POSE)))


@pytest.mark.parametrize("extra", [0, 9])
def test_axes_reports_and_reference_points_of_bodies(extra: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def computed() -> list[Floats]:
        bodies = bodies_on_road(20, extra)
        obstacles, moments = bodies.obstacles, bodies.moments()
        part, passed, facing = np.linspace(0.0, 1.0, 20), np.linspace(0.1, 0.0, 20), obstacles.facing
        known, directed = (moments.mean, moments.covariance), obstacles.directed
        obstacles.ahead = np.linspace(0.0, 5.0, 20)
        assert bodies.turning() is None
        tightest = np.where(np.arange(20) % 2, np.inf, 0.01)
        obstacles.axis, _ = turned_axes(
            *known, obstacles.axis, directed, obstacles.ahead, part, passed, facing, None, 5.0, 0.1, tightest
        )
        bodies.filter.state.mean[:, :, TURN] = 0.1
        bodies.changed()
        turning = bodies.turning()
        assert turning is not None
        assert 0 < np.count_nonzero(turning.rate) < 20
        obstacles.axis, _ = turned_axes(
            *known, obstacles.axis, directed, obstacles.ahead, part, passed, facing, turning, 5.0, 0.1, tightest
        )
        assert 0 < np.count_nonzero(obstacles.directed) < 20
        bodies.return_reference(10**9, 0.5, 10**8)
        obstacles.facing = box.facing_offsets(bodies, POSE)
        obstacles.length_variance[::2] = 0.1
        before = bodies.moments().mean.copy()
        box.follow_aspect(bodies, replace(POSE, east=9.0, north=-5.0, ve=30.0), 0.3)
        assert 0 < np.count_nonzero((bodies.moments().mean != before).any(axis=1)) < 20
        told = report(bodies, POSE, Used(np.zeros(0, np.intp), 0, np.zeros(0, np.int64)), 0, 0.5, obstacles.id > 0)
        columns = [
            getattr(told, name)
            for name in ("x", "vy", "ax", "sx", "svy", "heading", "center_x", "covariance", "width", "age")
        ]
        moved, codes = bodies.moments(), [each.astype(np.float64) for each in (told.state, told.kind)]
        assert all(len(np.unique(each)) > 1 for each in codes)
        return [
            obstacles.axis,
            obstacles.directed * 1.0,
            obstacles.ahead,
            obstacles.facing,
            bodies.reflections.offset,
            moved.mean,
            *columns,
        ]

    both(monkeypatch, computed)


def test_how_fast_bodies_that_pass_slide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(box, "_BESIDE", 60.0)  # so that there are some of each kind

    def computed() -> list[Floats]:
        bodies, found = bodies_on_road(60, 60), list[Floats]()
        bodies.obstacles.directed[::2] = True
        bodies.obstacles.length_variance[:] = np.where(np.arange(60) % 3, 0.01, 4.0)
        bodies.reflections.last_ns[:] = bodies.obstacles.last_ns[bodies.reflections.body]
        for shown_before in (len(bodies.reflections), len(bodies)):  # all in the last scan, or of each body one
            bodies.reflections.last_ns[shown_before:] -= 1
            sliding = box.slides(bodies, POSE)
            assert sliding is not None
            found.append(sliding)
        assert 3 < np.count_nonzero(found[0]) < np.count_nonzero(found[1]) < 60
        assert box.slides(bodies, replace(POSE, east=1000.0)) is None
        return found

    both(monkeypatch, computed)


def test_what_walks_hide_of_the_motion_across(monkeypatch: pytest.MonkeyPatch) -> None:
    tracker = VehicleTracker(TrackerSettings(estimator=VehicleEstimatorSettings(kind="vehicle")), {})
    tracker._bodies = bodies = bodies_on_road(60, 9)
    bodies.obstacles.drift = np.random.default_rng(2).normal(size=(60, 2)) * 0.2
    bodies.reflections.sensor[::3], bodies.reflections.sensor[::7] = 1, -1
    none = np.zeros((3, 2))

    def computed() -> list[Floats]:
        hidden = list[Floats]()
        for surely in (np.zeros(3), np.array([0.3, 0.0, 0.8])):
            tracker._noise._walks = SensorWalks(none, none, surely, some=False, surely_some=True)
            hidden.append(tracker._hidden())
        assert len(np.unique(hidden[1])) > 20
        return hidden

    both(monkeypatch, computed)


def test_reference_points_that_follow_biases_beyond_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    def computed() -> list[Floats]:
        bodies, random = bodies_on_road(20, 9), np.random.default_rng(4)
        state, drift = bodies.filter.state, random.normal(size=(20, 2)) * (random.random((20, 1)) < 0.3)
        state.mean[:, :, BIAS] = random.normal(size=(20, 1, 2)) * 3.0
        bodies.obstacles.drift = drift.copy()
        bodies.changed()
        before = state.mean.copy()
        bodies.return_reference(10**9, 0.5, 10**8)
        assert 0 < np.count_nonzero((state.mean[:, :, BIAS] != before[:, :, BIAS]).any(axis=(1, 2))) < 20
        assert np.count_nonzero(bodies.obstacles.drift.any(axis=1)) > np.count_nonzero(drift.any(axis=1)) > 0
        return [bodies.obstacles.drift, state.mean, state.covariance]

    both(monkeypatch, computed)


@pytest.mark.parametrize("alike", [False, True])
@pytest.mark.parametrize(("size", "width"), [(3, 4), (3, 6), (3, 9), (4, 9)])
def test_an_axis_spread_over_the_plane(size: int, width: int, alike: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(size + width)
    along, angle = random.normal(size=(size, size)), random.uniform(-np.pi, np.pi, TRACKS)
    across = along.copy() if alike else random.normal(size=(size, size))
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    both(monkeypatch, lambda: [directed(along, across, direction, width)])


def stood(**settings: float) -> ReflectionSettings:
    return ReflectionSettings.model_validate({"stood": settings})


def riders(**settings: float) -> ReflectionSettings:
    return ReflectionSettings.model_validate({"riders": settings})


@pytest.mark.parametrize("confirmed", [True, False])
def test_bodies_to_merge(confirmed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def computed() -> list[Floats]:
        bodies = bodies_on_road(60, 0)
        bodies.obstacles.confirmed |= confirmed
        bodies.obstacles.fastest[::3] = 0.3
        bodies.obstacles.last_ns += 4 * 10**9  # some in this scan, some lost sight of
        bodies.obstacles.first_ns[::2] = 3 * 10**9  # the others have been apart for long
        older, needed = merge_candidates(bodies, ReflectionSettings(), 5 * 10**9)
        bodies.filter.state.mean[::2, :, 2:4] *= 0.01
        bodies.obstacles.fastest[::2] = 0.2
        bodies.obstacles.directed[::4] = True
        bodies.changed()
        across, _ = merge_candidates(bodies, ReflectionSettings(), 5 * 10**9)
        assert np.count_nonzero(across != older) > 3
        assert 3 < np.count_nonzero(older >= 0) < 50
        bodies = bodies_on_road(60, 30)
        bodies.filter.state.mean[:, :, :2] *= 0.3
        bodies.filter.state.mean[:, :, 2:4] *= 0.01
        bodies.obstacles.fastest[:], bodies.obstacles.confirmed[:] = 0.2, True
        bodies.obstacles.last_ns[:] = bodies.reflections.last_ns[:] = 10**9
        bodies.changed()
        apart, close = (merge_candidates(bodies, stood(apart=each), 10**9)[0] for each in (0.0, 3.0))
        assert (apart != close).any()
        bodies.filter.state.mean[:, :, 2:4] = (9.0, 0.0)
        bodies.obstacles.fastest[:], bodies.obstacles.axis[:] = 9.0, (1.0, 0.0)
        bodies.changed()
        behind, abreast = (merge_candidates(bodies, ReflectionSettings(beside=each), 10**9)[0] for each in (0.0, 3.0))
        assert (behind != abreast).any()
        bodies.obstacles.first_ns[::2], bodies.obstacles.extent[:], bodies.obstacles.length[::3] = -4 * 10**9, 0.0, 1.8
        bodies.obstacles.length_variance[:] = 4.0
        bodies.filter.state.mean[:, :, 1] *= 0.2
        bodies.changed()
        fast, slow = (merge_candidates(bodies, riders(fastest=each), 10**9)[0] for each in (5.0, 10.0))
        assert (fast != slow).any()
        bodies = bodies_on_road(60, 0)
        bodies.filter.state.mean[:, :, :2] *= 0.1
        bodies.filter.state.mean[:, :, 2:4] = (1.0, 0.0)
        bodies.obstacles.length[:], bodies.obstacles.width[:] = WALKER
        bodies.obstacles.confirmed[:], bodies.obstacles.fastest[:], bodies.obstacles.alone[:] = True, 1.2, 2.0
        bodies.changed()
        people, _ = merge_candidates(bodies, ReflectionSettings(), 10**9)
        bodies.obstacles.length_variance[:], bodies.obstacles.alone[:] = 0.5, 0.0  # small, as told by a sensor
        parts, _ = merge_candidates(bodies, ReflectionSettings(), 10**9)
        assert 0 < np.count_nonzero(people >= 0) < np.count_nonzero(parts >= 0)
        alongside_ns = np.arange(60) * 10**7
        merging = alongside_long(alongside_ns, older, needed, 5 * 10**7)
        assert 0 < len(merging) < np.count_nonzero(older >= 0)
        assert not alongside_ns[older < 0].any()
        return [
            older.astype(np.float64),
            across.astype(np.float64),
            *(each.astype(np.float64) for each in (apart, close, behind, abreast, fast, slow, people, parts)),
            needed,
            alongside_ns.astype(np.float64),
            np.array(merging, np.float64),
        ]

    both(monkeypatch, computed)


def test_reflections_to_split_and_places_expected(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(5)
    share, difference = random.random((2, 20)), random.normal(size=29) * 4.0

    def computed() -> list[Floats]:
        bodies = bodies_on_road(20, 9)
        assert split_candidates(bodies, ReflectionSettings(across=5.0)) is None
        bodies.reflections.offset *= 6.0
        bodies.reflections.rate_difference = difference
        bodies.filter.state.mean[::2, :, 2:4] *= 0.01
        bodies.obstacles.fastest[::2] = 0.2
        bodies.obstacles.directed[::4] = True
        bodies.changed()
        splitting = split_candidates(bodies, ReflectionSettings())
        assert splitting is not None
        assert 0 < np.count_nonzero(splitting) < 9
        expected = expected_places(
            bodies.moments().mean, bodies.obstacles.axis, share, share[::-1], np.array([0.5, 0.7])
        )
        return [splitting.astype(np.float64), expected]

    both(monkeypatch, computed)


@pytest.mark.parametrize("speeds", [False, True])
def test_reflections_are_followed_for_themselves_and_stray(speeds: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(6)
    trail = np.concatenate([random.uniform(-25.0, 25.0, (29, 2)), random.normal(size=(29, 2)) * 0.7], axis=1)
    trail_ns = random.choice([9 * 10**8, 2 * 10**8], 29, p=[0.9, 0.1])
    walked, stood = random.random((2, 29))
    rows, leads = random.permutation(29)[:25], np.arange(20)
    steps = random.normal(size=(25, 2)) * np.where(random.random(25) < 0.8, 0.1, 3.0)[:, None]

    def computed() -> list[Floats]:
        bodies, settings = bodies_on_road(20, 9), ReflectionSettings()
        reflections, scan = bodies.reflections, scan_of(25, speeds)
        reflections.trail, reflections.trail_ns = trail.copy(), trail_ns.copy()
        reflections.walked, reflections.stood = walked.copy(), stood.copy()
        bodies.obstacles.fastest[::2] = 1.4
        measurement = replace(scan.measurement, position=trail[rows, :2] + steps)
        if speeds:  # of some nothing is known
            driving = Projection(np.tile([1.0, 0.0], (25, 1)), np.where(rows % 3, 0.1, np.nan), np.full(25, 0.01))
            measurement = replace(measurement, velocity=np.array([0.5, 0.1]), projections=(driving,))
        note_strays(bodies, rows, reflections.body[rows], measurement, 10**9, settings)
        assert 3 < np.count_nonzero(reflections.walked > 0.0) < 25
        assert 3 < np.count_nonzero(reflections.stood > 0.0) < 25
        followed = [each.astype(np.float64) for each in (reflections.trail, reflections.trail_ns)]
        noted = [reflections.walked.copy(), reflections.stood.copy()]
        reflections.last_ns[:], reflections.walked[:], reflections.stood[:] = 10**9, 0.0, 0.0
        assert strays(bodies, settings, 10**9) is None
        reflections.trail[:, 2:] = np.where(np.arange(29)[:, None] % 4 < 2, (1.0, 0.2), (-0.2, 1.0))
        found = list[Floats]()
        for walking, standing in ((leads, slice(20, 29)), (slice(20, 29), leads)):
            reflections.walked[:], reflections.stood[:] = 0.0, 0.0
            reflections.walked[walking], reflections.stood[standing] = 2.0, 1.0
            straying = strays(bodies, settings, 10**9)
            assert straying is not None
            assert 0 < len(straying) < 9
            found.append(straying.astype(np.float64))
        return [*followed, *noted, *found]

    both(monkeypatch, computed)


@pytest.mark.parametrize("turning", [True, False])
@pytest.mark.parametrize("measured", ["range rates", "components", "both", "nothing"])
def test_what_most_of_a_vehicle_contradicts(turning: bool, measured: str, monkeypatch: pytest.MonkeyPatch) -> None:
    random, body = np.random.default_rng(11), np.repeat([3, 0, -1, 7, 5, 9, 2], [3, 4, 5, 2, 8, 3, 1])[::-1].copy()
    rows = len(body)
    angle, value = random.uniform(-3.0, 3.0, rows), random.normal(size=rows) * 3.0
    value[::9] = np.nan
    part = Projection(np.stack([np.cos(angle), np.sin(angle)], axis=1), value, np.ones(rows))
    scan = scan_of(rows, speeds=measured in ("range rates", "both")).measurement
    scan.projections = (part,) * (measured in ("components", "both"))
    settings = ReflectionSettings.model_validate({"speed": 2.0})

    def computed() -> list[Floats]:
        bodies = bodies_on_road(20, 9)
        bodies.obstacles.fastest[[3, 0, 7, 5, 2]], bodies.obstacles.fastest[9] = 9.0, 0.5
        bodies.obstacles.directed[:], bodies.obstacles.alone[:] = turning, -1.0 * turning
        assert (bodies.turning() is not None) == turning
        found = contradicting(bodies, body, scan, settings)
        assert (len(found) == 0) == (measured == "nothing")
        assert set(body[found].tolist()) <= {3, 0, 5}
        return [np.append(found, -1).astype(np.float64)]

    both(monkeypatch, computed)


def test_reflections_of_what_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, random = np.array([28, 3, 0, 11, 22]), np.random.default_rng(8)
    rate, variance = random.normal(size=20), np.where(np.arange(20) % 3 > 0, random.random(20), 0.0)
    pivot = random.uniform(-25.0, 25.0, (20, 2))

    def computed() -> list[Floats]:
        bodies = bodies_on_road(20, 9)
        body, shown = bodies.reflections.body[rows], bodies.moments().shown
        offset = bodies.offsets(rows)
        np.testing.assert_array_equal(offset, bodies.offsets()[rows])
        arm = Turning(rate, variance, pivot).arms(body, shown, offset)
        assert 0 < np.count_nonzero(arm) < arm.size
        return [offset, arm]

    both(monkeypatch, computed)


@pytest.mark.parametrize("turning", [True, False])
def test_reference_points_swing_with_what_turns(turning: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def computed() -> list[Floats]:
        bodies = bodies_on_road(20, 9)
        bodies.obstacles.directed[:], bodies.obstacles.length[:] = True, 4.5
        bodies.obstacles.length_variance[:] = 0.5
        bodies.filter.state.mean[::2, :, TURN] = 0.9 if turning else 0.0
        bodies.filter.state.covariance[:, :, TURN, TURN] = 0.01
        bodies.changed()
        before = bodies.moments().mean.copy()
        bodies.swing_references(0.05)
        moved = (bodies.moments().mean != before).any(axis=1)
        assert np.count_nonzero(moved) == (10 if turning else 0)
        return [*told(bodies.filter), bodies.moments().mean, bodies.moments().shown]

    both(monkeypatch, computed)


@pytest.mark.parametrize("by_kernels", [True, False])
def test_whether_reflections_lie_far_from_one_another(by_kernels: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "in_use", by_kernels)
    bodies = bodies_on_road(20, 9)
    obstacles, reflections = bodies.obstacles, bodies.reflections
    reflections.offset[:] = 0.0
    reflections.offset[25, 0] = -2.0
    body, span = int(reflections.body[25]), 2.5
    obstacles.confirmed[:], obstacles.directed[:], obstacles.fastest[:] = True, True, 4.0
    assert any_far_along(bodies, 5.0, 1.9)
    assert not any_far_along(bodies, 5.0, 2.0)
    assert not any_far_along(bodies, 4.0, 1.9)
    for column in (obstacles.confirmed, obstacles.directed):
        column[body] = False
        assert not any_far_along(bodies, 5.0, 1.9)
        column[body] = True
    reflections.offset[3, 1], reflections.offset[7, 1] = -1.0, span - 1.0
    assert extent_across(reflections.offset) == span


def test_what_leads_is_confirmed_forgotten_and_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(9)
    first, last = random.integers(0, 10**9, 20), random.choice([10**9, 19 * 10**8, 2 * 10**9, 3 * 10**9], 20)
    sight, body = random.normal(size=(30, 2)) * 20.0, random.integers(0, 20, 30)

    def computed() -> list[Floats]:
        tracker = VehicleTracker(TrackerSettings(estimator=VehicleEstimatorSettings(kind="vehicle")), {})
        tracker._bodies = bodies = bodies_on_road(20, 9)
        tracker._state.time_ns = 3 * 10**9
        obstacles = bodies.obstacles
        obstacles.first_ns, obstacles.last_ns, obstacles.existence = (
            first.copy(),
            last.copy(),
            np.linspace(0.8, 1.0, 20),
        )
        bodies.reflections.last_ns = np.where(bodies.reflections.last_ns > 0, 3 * 10**9, 10**9)
        bodies.filter.state.covariance[3, :, 0, 0] = 1e4
        bodies.changed()
        before = obstacles.leader.copy()
        tracker._hand_over()
        assert 0 < np.count_nonzero(obstacles.leader != before) < 9
        now_ns = tracker.state.time_ns
        silent, forgotten, promoted = longer_ago(last, now_ns, 1.05), tracker._forgotten(), tracker._promoted(None)
        assert longer_ago(last, now_ns, 2.5) is None
        assert silent is not None
        assert forgotten is not None
        assert 0 < np.count_nonzero(forgotten) < np.count_nonzero(last < 3 * 10**9)
        assert 0 < len(promoted) < np.count_nonzero(last == 3 * 10**9)
        velocity = bodies.moments().mean[:, 2:4] * 0.2
        standing = _standing(velocity, sight, np.hypot(sight[:, 0], sight[:, 1]), body, obstacles.confirmed)
        assert 0 < np.count_nonzero(standing) < 30
        bodies.note_detections(np.array([3, 7, 3, 12]), 31 * 10**8)
        tracker._let_wander(0.05)
        assert not bodies.reflections.variance[obstacles.leader].any()
        assert np.count_nonzero(bodies.reflections.variance) == 9
        found = (obstacles.leader, silent, forgotten, promoted, standing, obstacles.last_ns)
        times = [obstacles.interval, bodies.detected_after(31 * 10**8)]
        return [*(each.astype(np.float64) for each in found), *times, bodies.reflections.variance]

    both(monkeypatch, computed)


@pytest.mark.parametrize(
    "ids",
    [[], [0, 3, 9], [9, 3, 0], [3, 3, 9], [-1, 3], [-5, 2**63 - 1], [10**6, -(2**63)], [5, 5]],
    ids=["none", "ascending", "descending", "twice", "minus one", "beyond above", "beyond below", "unknown twice"],
)
def test_rows_of_ids_at_the_edges(ids: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    row_of, keys = {(0, 3): 7, (0, 9): 2, (0, 0): 4, (1, 3): 1}, np.array(ids, dtype=np.int64)
    rows, distinct = IdRows().of(row_of, 0, keys)
    assert rows.tolist() == [row_of.get((0, key), -1) for key in ids]
    assert distinct == (len(set(ids)) == len(ids))
    monkeypatch.setattr(compiled, "in_use", False)
    expected, expected_distinct = IdRows().of(row_of, 0, keys)
    np.testing.assert_array_equal(rows, expected)
    assert distinct == expected_distinct


@pytest.mark.parametrize("identified", [True, False])
def test_marks_of_what_is_detected(identified: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    row, keys = np.array([2, 7, 0, 25, 11]), np.array([2, 40, 1, 3, 11])

    def computed() -> list[Floats]:
        bodies = bodies_on_road(20, 9)
        obstacles, reflections = bodies.obstacles, bodies.reflections
        reflections.sensor[11] = 3
        bodies.mark_detected(row, keys if identified else None, 0, 2 * 10**9)
        assert bodies.rows_of(0, keys)[0].tolist() == ([2, 7, 0, 25, 11] if identified else [2, -1, 1, 3, 11])
        assert np.count_nonzero(reflections.last_ns == 2 * 10**9) == 5
        columns = (reflections.sensor, reflections.object_id, reflections.last_ns)
        return [each.astype(np.float64) for each in (*columns, obstacles.last_ns, obstacles.history, obstacles.sensors)]

    both(monkeypatch, computed)


@pytest.mark.parametrize("speeds", [True, False])
@pytest.mark.parametrize("twice", [True, False])
@pytest.mark.parametrize("turning", [True, False])
def test_what_detections_are_of_by_their_ids(
    turning: bool, twice: bool, speeds: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    vague, ids = np.arange(20) == 2, np.arange(15)
    ids[14] = 13 if twice else 99

    def computed() -> list[Floats]:
        bodies, scan = bodies_on_road(20, 9), scan_of(15, speeds)
        bodies.obstacles.directed[::3] = turning
        states, _ = bodies.reflection_states()
        scan.measurement.position[:] = states[:15, :2] + np.linspace(0.0, 4.0, 15)[:, None]
        scan.new[5] = True
        scan = replace(scan, object_id=ids)
        found = associate(bodies, scan, AssociationSettings(), ReflectionSettings(merge=False), vague)
        assert found.slot_jumps > 0
        assert 2 < np.count_nonzero(np.isfinite(found.nis)) < 15
        assert (bodies.turning() is not None) == turning
        turns = [] if (of := bodies.turning()) is None else [of.rate, of.variance, of.pivot]
        return [found.body.astype(np.float64), found.reflection.astype(np.float64), found.nis, states, *turns]

    both(monkeypatch, computed)


@pytest.mark.parametrize("speeds", [True, False])
@pytest.mark.parametrize("extra", [0, 9])
def test_measurements_of_bodies(extra: int, speeds: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def computed() -> list[Floats]:
        bodies = bodies_on_road(20, extra)
        row = np.concatenate([np.arange(20, 20 + extra), np.arange(15 - extra)])
        measurement, body = scan_of(15, speeds).measurement, bodies.reflections.body[row]
        offset, variance = 4.0 * bodies.offsets(row), bodies.reflections.variance[row]
        seen, combined, rates = of_bodies(measurement, body, offset, variance, 2.0)
        if rates is not None:
            assert len(rates.components(bodies.moments().shown[seen])) == (2 if extra else 1)
        bodies.filter.update(seen, combined, 0.5, rates)
        bodies.learn_offsets(row, measurement.position, measurement.noise, offset)
        found = (combined.position, combined.noise, *told(bodies.filter))
        return [seen.astype(np.float64), *found, bodies.reflections.offset, bodies.reflections.variance]

    both(monkeypatch, computed)


def test_factors_by_the_scans_between_detections(monkeypatch: pytest.MonkeyPatch) -> None:
    tracker = VehicleTracker(
        TrackerSettings.model_validate({"estimator": {"kind": "vehicle"}}), {0: full_binding().sensors[0].settings}
    )
    tracker._bodies = bodies_on_road(60, 0)
    tracker._bodies.obstacles.interval = np.concatenate([np.arange(30) * 0.025, np.full(30, 9.0)])
    measurement = scan_of(60, speeds=True).measurement

    def computed() -> list[Floats]:
        counted = tracker._as_alike(measurement, np.arange(60)[::-1].copy())
        assert counted.range_rate_variance is not None
        assert len(np.unique(counted.noise[:, 0, 0])) > 5
        return [counted.noise, counted.range_rate_variance]

    both(monkeypatch, computed)


@pytest.mark.parametrize("extra", [0, 9])
def test_what_innovations_tell(extra: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def computed() -> list[Floats]:
        bodies, random = bodies_on_road(60, extra), np.random.default_rng(5)
        bodies.obstacles.first_ns[::5] = 9 * 10**8
        bodies.reflections.sensor[::7] = 1
        bodies.reflections.innovation = random.normal(size=(60 + extra, 2)) * 2.0
        rows, measurement = np.arange(10, 60 + extra), scan_of(50 + extra, speeds=False).measurement
        measurement.position[:] = bodies.moments().shown[bodies.reflections.body[rows], :2]
        measurement.position[:] += random.normal(size=(50 + extra, 2)) * 0.6
        sums = _innovations(bodies, rows, measurement, 5 * 10**8, 8 * 10**8)
        assert sums[0] != 0.0 < sums[1]
        unused = (bodies.reflections.innovation == UNUSED).all(axis=1)
        assert 5 < np.count_nonzero(unused) < 40
        return [np.array(sums), bodies.reflections.innovation]

    both(monkeypatch, computed)


@pytest.mark.parametrize("extra", [0, 9])
def test_what_boxes_learn(extra: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def computed() -> list[Floats]:
        bodies, names = bodies_on_road(20, extra), ("length", "width", "extent", "alone", "fastest")
        bodies.obstacles.first_ns[::5] = 9 * 10**8
        bodies.reflections.last_ns[::3] = 95 * 10**7
        small = bodies.obstacles
        small.alone[::2], small.fastest[::2], small.length_variance[::2], small.width_variance[::2] = 5.0, 8.9, 1.0, 1.0
        small.length[1::4], small.extent[1::4], small.width[1::4] = 3.0, 3.0, 0.7
        rows, reflections, in_sight = np.arange(15), np.arange(extra, 15 + extra), np.linspace(0.0, 1.0, 20)
        box.learn(bodies, rows, reflections, scan_of(15, speeds=False), in_sight, 0.1, AloneSettings(), 5.0)
        assert (bodies.obstacles.fastest[::2] < 8.9).any()
        return [getattr(bodies.obstacles, name) for name in names]

    both(monkeypatch, computed)


@pytest.mark.parametrize("extra", [0, 9])
def test_where_reflections_are_and_what_a_scan_says_of_existence(extra: int, monkeypatch: pytest.MonkeyPatch) -> None:
    random, settings = np.random.default_rng(8), full_binding().sensors[0].settings
    settings = settings.model_copy(update={"field_of_view": FieldOfView(range=100.0, azimuth_deg=160.0)})
    reflection = np.where(random.random(15) < 0.7, np.arange(15), -1)
    nis, missed, confirmed = random.uniform(0.0, 30.0, 15), random.random(20) < 0.5, random.random(20) < 0.5
    first, unseen = random.uniform(0.001, 0.999, 20), random.random(20)
    first[confirmed] *= 0.1  # some were given up for lost

    def computed() -> list[Floats]:
        bodies = bodies_on_road(20, extra)
        obstacles, body = bodies.obstacles, np.where(reflection < 0, -1, bodies.reflections.body[reflection])
        obstacles.existence, obstacles.unseen, obstacles.confirmed = first.copy(), unseen.copy(), confirmed
        obstacles.history = missed.astype(np.int64)
        existence = BodyExistence(LifecycleSettings(), {0: settings}, list(sensor_views(settings, 0).values()))
        existence.observe(bodies, Association(body, reflection, nis), scan_of(15, speeds=False), POSE)
        assert 0 < np.count_nonzero(obstacles.existence > first) < 15
        assert (obstacles.existence < first).any()
        existence.predict(bodies, 0.3)
        states = (*bodies.reflection_states(), *bodies.reflection_states(np.arange(5, 12)))
        return [obstacles.existence, obstacles.in_sight, obstacles.unseen, *states]

    both(monkeypatch, computed)


def test_sizes_that_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.random.default_rng(5).uniform(-1.0, 7.0, (4, 40))
    values[2, 3::9], values[2, 5] = np.nan, 6.0

    def computed() -> list[Floats]:
        selection = Selection(full_binding().sensors[0], ScanCounts())
        assert selection._with_sizes(values, 3, np.inf)[:, values[3] > 0.0].shape[1] < 40
        counted = selection.counts.odd_sizes
        sized = selection._with_sizes(values, 2, 6.0)
        assert 3 < np.count_nonzero(np.isnan(sized)) < 30
        some = values[:, values[1] > 0.0]
        assert selection._with_sizes(some, 1, 7.0) is some
        return [sized, np.array([counted, selection.counts.odd_sizes], np.float64)]

    both(monkeypatch, computed)


@pytest.mark.parametrize("azimuth", [60.0, 180.0])
def test_what_hides_what(azimuth: float, monkeypatch: pytest.MonkeyPatch) -> None:
    random, settings = np.random.default_rng(7), full_binding().sensors[0].settings
    settings = settings.model_copy(update={"field_of_view": FieldOfView(range=100.0, azimuth_deg=azimuth)})
    centre, (length, width) = random.uniform(-30.0, 30.0, (40, 2)), random.uniform(0.5, 2.0, (2, 40))
    heading = random.uniform(-3.0, 3.0, 40)
    axis, surely, missed = np.stack([np.cos(heading), np.sin(heading)], axis=1), heading < 2.0, heading < 0.0
    axis[3], centre[4] = np.nan, [settings.mount.x, settings.mount.y]

    def computed() -> list[Floats]:
        visibility = Visibility({0: settings})
        share, distance = visibility.in_sight(centre, 0.95 * centre, axis, length, width, 0)
        assert np.count_nonzero((share > 0.0) & (share < 1.0)) > 4
        visibility.learn(0, share, np.arange(40) % 4 > 0, distance, missed, surely)
        learnt = visibility.state.sensors[0]
        assert learnt.expected.sum() >= learnt.detected.sum() > 0.0
        probability = visibility.detection_probability(0, share, distance, missed)
        seen = sensor_views(settings)[-1].sees(np.concatenate([centre, 4.0 * centre]))
        assert 0 < np.count_nonzero(seen) < 80
        return [share, distance, learnt.expected, learnt.detected, probability, seen.astype(np.float64)]

    both(monkeypatch, computed)


@pytest.mark.parametrize("gap_ns", [0, 40_000_000], ids=["even", "with a gap"])
def test_ego_motion_over_a_window(gap_ns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    limits = {"age_limit": 0.03, "dead_reckoning": 3.0, "unseen_acceleration": 1.0}
    history = MotionHistory(**limits, speed_variance=0.01, smoothing=0.1)
    motion = np.random.default_rng(8).normal([15.0, 8.0, 0.2], [0.5, 0.5, 0.05], (200, 3))
    for k, (ve, vn, turn) in enumerate(motion.tolist()):
        history.add(k * 10**7 + (gap_ns if k > 100 else 0), 0.002 * k + turn, ve, vn, turn)
    scales, biases = np.array([[0.0, 0.4, 1.0], [1.0, 1.01, 1.02]]), np.array([[0.0, 0.4, 1.0], [0.0, 0.002, 0.001]])

    def computed() -> list[Floats]:
        assert history.course(100 * 10**7, 10**7, 200) is None
        path = ego_path(history.course, 4 * 10**8, 14 * 10**8, scales, biases)
        assert path is not None
        moments = path.at(np.linspace(0.0, 0.9e9, 20), 1.01, 0.002)
        columns = [getattr(moments, each.name) for each in fields(moments)]
        return [path.distance, path.heading, *(np.ascontiguousarray(each).view(np.float64) for each in columns)]

    both(monkeypatch, computed)


def test_which_measurements_of_a_window_are_of_one_return(monkeypatch: pytest.MonkeyPatch) -> None:
    random, sensor = np.random.default_rng(9), full_binding().sensors[0]
    reader = SensorReader(sensor.settings, sensor.reader.quantities)
    window, ids = WindowReader(reader), np.arange(12)
    scans = [
        HeldScan(
            k, 1.0, 0.0, np.sort(random.permutation(ids)[:9]), random.random(9) < 0.1, np.ones((len(reader.taken), 9))
        )
        for k in range(20)
    ]

    def computed() -> list[Floats]:
        readings = reader.read(scans)
        place = readings.object_id * (10.0 + 1j) + 0.5 * readings.scan + 2.6 * (readings.scan % 5 == 0)
        order, first, counts = window._by_identity(readings, np.linspace(0.0, 2.0, 20), place)
        assert 40 < len(first) < counts.sum() == len(order) == 180
        return [each.astype(np.float64) for each in (order, first, counts)]

    both(monkeypatch, computed)


@pytest.mark.parametrize("bound", [full_binding, imm_binding, reduced_binding], ids=["vehicle", "imm", "cs"])
def test_a_replay_and_the_saved_state_at_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bound: Callable[[], Binding]
) -> None:
    log, outputs = simulated_log(tmp_path / "in.log", 3.0), iter((tmp_path / "a.log", tmp_path / "b.log"))
    binding = bound()

    def computed() -> list[Floats]:
        output = next(outputs)
        replayed = replay(binding, ReplayRequest(log, output, scored=False))
        assert replayed.pipeline.counts.sent > 1000
        written = (output.read_bytes(), dump(replayed.pipeline))
        return [np.frombuffer(each, dtype=np.uint8).astype(np.float64) for each in written]

    both(monkeypatch, computed)
