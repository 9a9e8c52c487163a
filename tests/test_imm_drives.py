"""The IMM on the automotive set."""

from __future__ import annotations

from math import pi, radians

import numpy as np
import pytest
from builders import polar_measurement, rotation
from numpy.typing import NDArray

from candaemon.estimation.imm import Imm
from candaemon.estimation.models import CoordinatedTurn, LinearModel

Floats = NDArray[np.float64]

DEFAULT = (LinearModel(1, (1e-3, 1e-3)), LinearModel(2, (5.0, 5.0)), CoordinatedTurn(0.01, 0.1))
START = {"cruise": (40, -1, 1, 0), "brake": (100, 0, 1, 0), "cut_in": (30, 1, 3.5, 0), "turn": (70, 0, -30, 10)}
"""x, vx, y, vy."""


def automotive(name: str) -> Floats:
    """Return the truth of the automotive set: (steps, [x, y, vx, vy]) every 0.05 s."""
    x, vx, y, vy = START[name]
    steps, parts = (180 if name == "turn" else 400), 50
    dt, state, out = 0.05 / parts, np.array([x, y, vx, vy], dtype=np.float64), []
    for k in range(steps * parts):
        if k % parts == 0:
            out.append(state.copy())
        t, a, w = (k + 0.5) * dt, np.zeros(2), 0.0
        if name == "brake":
            a[0] = -6 if 6 <= t < 8 else 3 if 10 <= t < 14 else 0
        elif name == "cut_in":
            a[:] = (-1 if 12 <= t < 15 else 0, -1.556 if 8 <= t < 9.5 else 1.556 if 9.5 <= t < 11 else 0)
        elif name == "turn":
            w = 0.6 if 3 <= t < 3 + pi / 2 / 0.6 else 0.0
        turned = rotation(w * dt) @ state[2:] + a * dt
        state[:2] += dt * (state[2:] + turned) / 2
        state[2:] = turned
    return np.array(out)


@pytest.mark.parametrize(
    ("name", "position_limit", "velocity_limit"),
    [("cruise", 0.085, 0.087), ("brake", 0.235, 0.49), ("cut_in", 0.17, 0.49), ("turn", 0.165, 0.24)],
)
def test_automotive_set_with_range_rate(name: str, position_limit: float, velocity_limit: float) -> None:
    runs, noise, truth = 100, (0.25, radians(0.5), 0.12), automotive(name)
    rng = np.random.default_rng(11)
    imm = Imm(DEFAULT, switch_rate=0.2, acceleration=3.0, turn_rate=0.3)
    axis, every = np.tile([1.0, 0.0], (runs, 1)), np.arange(runs)
    errors, nis = [], []
    for k, (x, y, vx, vy) in enumerate(truth):
        distance = np.hypot(x, y)
        exact = (distance, np.arctan2(y, x), (x * vx + y * vy) / distance)
        z = [value + s * rng.normal(size=runs) for value, s in zip(exact, noise, strict=True)]
        measurement = polar_measurement(z[0], z[1], z[2], noise)
        if k == 0:
            turn = rotation(z[1])
            spread = turn @ np.diag([noise[2] ** 2, 8.0**2]) @ np.swapaxes(turn, 1, 2)
            imm.spawn(measurement.position, measurement.noise, z[2][:, None] * turn[:, :, 0], spread)
            continue
        imm.predict(0.05, axis)
        nis.append(float(imm.update(every, measurement).mean()))
        if k >= 20:
            errors.append(imm.combined()[0][:, :4] - (x, y, vx, vy))
    squared = np.square(errors).mean(axis=(0, 1))
    assert np.sqrt(squared[:2].sum()) <= position_limit
    assert np.sqrt(squared[2:].sum()) <= velocity_limit
    assert 2.7 <= np.mean(nis[20:]) <= 3.3
