"""The baseline, frozen: the chain as one glues it from python-can, cantools and filterpy, a filter an object.

It is written to be read and to be quick as far as its libraries allow: plain floats go into cantools, matrices that all
objects share are made once a cycle, nothing is decoded twice. It is the oracle too: with association by slot and no
merging candaemon's states must be these. Do not tune it and do not let it import candaemon.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import can
import cantools
import numpy as np
from filterpy.kalman import IMMEstimator, KalmanFilter

from candaemon.arrays import Floats

MOUNT_X = 3.6
SIGMA_RANGE, SIGMA_AZIMUTH = 0.25, math.radians(0.5)
COAST_NS = 520_000_000
FIRST_SPEED, FIRST_ACCELERATION = 15.0, 3.0
ALPHA, LIMIT, FLOOR = 0.5, 10.0, 1.0
SWITCH_RATE = 0.2
SLOTS = 64
POSITION = np.zeros((2, 6))
POSITION[0, 0] = POSITION[1, 3] = 1.0


class CurrentStatistical:
    """The adaptive Kalman filter of paper 000 for one object; state [x, ẋ, ẍ, y, ẏ, ÿ] in the level frame."""

    def __init__(self, position: Floats, noise: Floats) -> None:
        self.filter = _first_filter(position, noise)

    @staticmethod
    def matrices(dt: float) -> tuple[Floats, Floats, Floats]:
        """Return F (15), U (16) and Q (18), (19) for a variance of one on both axes."""
        a, decay = ALPHA, math.exp(-ALPHA * dt)
        f = np.array([[1, dt, (a * dt - 1 + decay) / a**2], [0, 1, (1 - decay) / a], [0, 0, decay]])
        u = np.array([(-dt + a * dt * dt / 2 + (1 - decay) / a) / a, dt - (1 - decay) / a, 1 - decay])
        q11 = (1 - decay**2 + 2 * a * dt + 2 * (a * dt) ** 3 / 3 - 2 * (a * dt) ** 2 - 4 * a * dt * decay) / (2 * a**5)
        q12 = (decay**2 + 1 - 2 * decay + 2 * a * dt * decay - 2 * a * dt + (a * dt) ** 2) / (2 * a**4)
        q13 = (1 - decay**2 - 2 * a * dt * decay) / (2 * a**3)
        q22 = (4 * decay - 3 - decay**2 + 2 * a * dt) / (2 * a**3)
        q23 = (decay**2 + 1 - 2 * decay) / (2 * a**2)
        q33 = (1 - decay**2) / (2 * a)
        q = 2 * a * np.array([[q11, q12, q13], [q12, q22, q23], [q13, q23, q33]])
        return np.kron(np.eye(2), f), np.kron(np.eye(2), u[:, None]), q

    def predict(self, matrices: tuple[Floats, Floats, Floats]) -> None:
        f, u, axis = matrices
        acceleration = self.filter.x[2::3]
        q = np.zeros((6, 6))
        q[:3, :3] = _variance(acceleration[0, 0]) * axis
        q[3:, 3:] = _variance(acceleration[1, 0]) * axis
        self.filter.predict(u=acceleration, B=u, F=f, Q=q)

    def update(self, position: Floats, noise: Floats) -> None:
        self.filter.update(position, R=noise)

    @property
    def state(self) -> Floats:
        state: Floats = self.filter.x[:, 0]
        return state


class InteractingModels:
    """filterpy's IMM of three models for one object. Its filters need one state size: the turn is a livelier CA."""

    def __init__(self, position: Floats, noise: Floats) -> None:
        filters = [_first_filter(position, noise) for _ in range(3)]
        self.imm = IMMEstimator(filters, [1 / 3] * 3, np.eye(3))

    @staticmethod
    def matrices(dt: float) -> tuple[Floats, list[tuple[Floats, Floats]]]:
        """Return the switching probabilities, and F and Q of each model."""
        cv = np.array([[1, dt, 0], [0, 1, 0], [0, 0, 0]])
        ca = np.array([[1, dt, dt * dt / 2], [0, 1, dt], [0, 0, 1]])
        cv_noise = np.array([[dt**3 / 3, dt**2 / 2, 0], [dt**2 / 2, dt, 0], [0, 0, 0]])
        ca_noise = np.array(
            [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
        )
        models: list[tuple[Any, Any]] = [(cv, 1e-3 * cv_noise), (ca, 5.0 * ca_noise), (ca, 50.0 * ca_noise)]
        leave = 1 - math.exp(-SWITCH_RATE * dt)
        switch = np.full((3, 3), leave / 2)
        np.fill_diagonal(switch, 1 - leave)
        return switch, [(np.kron(np.eye(2), f), np.kron(np.eye(2), q)) for f, q in models]

    def predict(self, matrices: tuple[Floats, list[tuple[Floats, Floats]]]) -> None:
        self.imm.M, models = matrices
        for each, (f, q) in zip(self.imm.filters, models, strict=True):
            each.F, each.Q = f, q
        self.imm.predict()

    def update(self, position: Floats, noise: Floats) -> None:
        for each in self.imm.filters:
            each.R = noise
        self.imm.update(position)

    @property
    def state(self) -> Floats:
        state: Floats = self.imm.x[:, 0]
        return state


Filter: TypeAlias = CurrentStatistical | InteractingModels


def _first_filter(position: Floats, noise: Floats) -> KalmanFilter:
    kf = KalmanFilter(dim_x=6, dim_z=2)
    kf.H = POSITION
    kf.x[::3] = position
    kf.P = np.diag([0.0, FIRST_SPEED**2, FIRST_ACCELERATION**2] * 2)
    kf.P[::3, ::3] = noise
    return kf


def _variance(acceleration: float) -> float:
    """Return the acceleration's variance, (8) and (20), with a floor."""
    return max((4 - math.pi) / math.pi * max(LIMIT - abs(acceleration), 0.0) ** 2, FLOOR)


@dataclass
class Pose:
    """Own motion at one instant, level frame."""

    time_ns: int
    east: float
    north: float
    heading: float
    ve: float
    vn: float
    yaw_rate: float


class Ins:
    """Own motion from the INS: positions integrated from velocity, poses interpolated between samples."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self.samples: list[Pose] = []

    def take(self, time_ns: int, signals: dict[str, Any]) -> None:
        """Take a message; the four of one instant come together, the curvature last."""
        self.values.update(signals)
        if "Curvature" not in signals:
            return
        value = self.values
        heading = math.pi / 2 - math.radians(value["AngleHeading"])
        ve, vn = value["VelEast"], value["VelNorth"]
        yaw_rate = -value["Curvature"] * math.hypot(ve, vn)
        east = north = 0.0
        if self.samples:
            last = self.samples[-1]
            dt = (time_ns - last.time_ns) * 1e-9
            east = last.east + dt * (last.ve + ve) / 2
            north = last.north + dt * (last.vn + vn) / 2
            heading = last.heading + math.remainder(heading - last.heading, math.tau)
        self.samples.append(Pose(time_ns, east, north, heading, ve, vn, yaw_rate))

    def pose(self, time_ns: int) -> Pose:
        after = len(self.samples) - 1
        while self.samples[after - 1].time_ns > time_ns:
            after -= 1
        a, b = self.samples[after - 1], self.samples[after]
        dt = (time_ns - a.time_ns) * 1e-9
        share = (time_ns - a.time_ns) / (b.time_ns - a.time_ns)
        ve, vn = a.ve + share * (b.ve - a.ve), a.vn + share * (b.vn - a.vn)
        return Pose(
            time_ns,
            a.east + dt * (a.ve + ve) / 2,
            a.north + dt * (a.vn + vn) / 2,
            a.heading + share * (b.heading - a.heading),
            ve,
            vn,
            a.yaw_rate + share * (b.yaw_rate - a.yaw_rate),
        )


@dataclass
class Track:
    filter: Filter
    last_ns: int


@dataclass
class Cycle:
    """One cycle: its time, and the track of each slot."""

    time_ns: int
    tracks: dict[int, Track]


def load_dbc(path: Path) -> Any:
    return cantools.database.load_file(path)


class NaiveChain:
    """Log in, log out, with the DBC of the radar, whose targets are written too, that of the INS, and a filter."""

    def __init__(self, radar_dbc: Path, ins_dbc: Path, kind: Callable[..., Filter]) -> None:
        self.radar, self.ins = load_dbc(radar_dbc), load_dbc(ins_dbc)
        self.kind: Any = kind
        self.targets = {self.radar.get_message_by_name(f"Target{n + 1}").frame_id: n for n in range(SLOTS)}
        self.own = {message.frame_id for message in self.ins.messages}
        self.motion = Ins()
        self.tracks: dict[int, Track] = {}
        self.time_ns = 0

    def run(self, log: Path, output: Path) -> Iterator[Cycle]:
        scan: dict[int, dict[str, Any]] = {}
        first_ns = 0
        with can.LogReader(log) as reader, can.CanutilsLogWriter(output) as writer:
            for message in reader:
                can_id = message.arbitration_id
                if message.channel == "can2" and can_id in self.own:
                    signals = self.ins.decode_message(can_id, message.data, decode_choices=False)
                    self.motion.take(_nanoseconds(message.timestamp), signals)
                elif message.channel == "can1" and can_id in self.targets:
                    if not scan:
                        first_ns = _nanoseconds(message.timestamp)
                    scan[self.targets[can_id]] = self.radar.decode_message(can_id, message.data, decode_choices=False)
                    if len(scan) == SLOTS:
                        pose = self.motion.pose(first_ns)
                        self.step(scan, pose)
                        for each in self.frames(pose, message.timestamp):
                            writer.on_message_received(each)
                        yield Cycle(first_ns, self.tracks)
                        scan = {}

    def step(self, scan: dict[int, dict[str, Any]], pose: Pose) -> None:
        """Predict, update, begin and end tracks."""
        if self.tracks:
            matrices: Any = self.kind.matrices((pose.time_ns - self.time_ns) * 1e-9)
            for track in self.tracks.values():
                track.filter.predict(matrices)
        self.time_ns = pose.time_ns
        origin_x = pose.east + math.cos(pose.heading) * MOUNT_X
        origin_y = pose.north + math.sin(pose.heading) * MOUNT_X
        for slot, signals in scan.items():
            if signals["CAN_TX_TRACK_STATUS"] not in (1, 2, 3, 5):
                continue
            distance = signals["CAN_TX_TRACK_RANGE"]
            direction = pose.heading - math.radians(signals["CAN_TX_TRACK_ANGLE"])
            c, s = math.cos(direction), math.sin(direction)
            along, across = SIGMA_RANGE**2, (distance * SIGMA_AZIMUTH) ** 2
            mixed = (along - across) * c * s
            noise = np.array([[along * c * c + across * s * s, mixed], [mixed, along * s * s + across * c * c]])
            position = np.array([[origin_x + distance * c], [origin_y + distance * s]])
            if slot not in self.tracks:
                self.tracks[slot] = Track(self.kind(position, noise), pose.time_ns)
                continue
            known = self.tracks[slot]
            known.filter.update(position, noise)
            known.last_ns = pose.time_ns
        self.tracks = {slot: each for slot, each in self.tracks.items() if pose.time_ns - each.last_ns <= COAST_NS}

    def frames(self, pose: Pose, timestamp: float) -> Iterator[can.Message]:
        """Encode every track as a target of the same radar."""
        c, s = math.cos(pose.heading), math.sin(pose.heading)
        x0, y0 = pose.east + c * MOUNT_X, pose.north + s * MOUNT_X
        vx0, vy0 = pose.ve - pose.yaw_rate * s * MOUNT_X, pose.vn + pose.yaw_rate * c * MOUNT_X
        for slot, track in self.tracks.items():
            x, vx, _, y, vy, _ = track.filter.state.tolist()
            dx, dy = x - x0, y - y0
            distance = math.hypot(dx, dy)
            azimuth = math.remainder(math.atan2(dy, dx) - pose.heading, math.tau)
            name = f"Target{slot + 1}"
            data = self.radar.encode_message(
                name,
                {
                    "CAN_TX_TRACK_ONCOMING": 0,
                    "CAN_TX_TRACK_GROUPING_CHANGED": 0,
                    "CAN_TX_TRACK_LAT_RATE": 0,
                    "CAN_TX_TRACK_ANGLE": -math.degrees(azimuth),
                    "CAN_TX_TRACK_STATUS": 3,
                    "CAN_TX_TRACK_RANGE": distance,
                    "CAN_TX_TRACK_RANGE_ACCEL": 0,
                    "CAN_TX_TRACK_WIDTH": 0,
                    "CAN_TX_TRACK_ROLLING_COUNT": 0,
                    "CAN_TX_TRACK_BRIDGE_OBJECT": 0,
                    "CAN_TX_TRACK_RANGE_RATE": (dx * (vx - vx0) + dy * (vy - vy0)) / distance,
                    "CAN_TX_TRACK_MED_RANGE_MODE": 0,
                },
            )
            can_id = self.radar.get_message_by_name(name).frame_id
            yield can.Message(
                timestamp=timestamp, arbitration_id=can_id, is_extended_id=False, data=data, channel="can3"
            )


def _nanoseconds(seconds: float) -> int:
    """Return a log's time stamp, which has six decimals, without what the float added."""
    return round(seconds * 1e6) * 1000
