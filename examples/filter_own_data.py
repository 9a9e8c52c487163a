"""A filter of the library on your own data: the IMM on noisy positions of a car that drives straight on, then turns.

`python examples/filter_own_data.py` prints the RMS error of the raw positions beside that of the filter's.
"""

from __future__ import annotations

import numpy as np

from candaemon import CoordinatedTurn, Imm, LinearModel, Measurement

DT, STEPS, SIGMA = 0.1, 200, 1.0  # s, scans, m of noise in each coordinate

yaw_rate = np.where(np.arange(STEPS) > STEPS / 2, 0.15, 0.0)  # rad/s, to the left in the second half
heading = np.cumsum(yaw_rate * DT)
velocity = 15.0 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
truth = np.cumsum(velocity * DT, axis=0)
measured = truth + np.random.default_rng(1).normal(scale=SIGMA, size=truth.shape)

# Constant velocity, constant acceleration and coordinated turn; noise is the power spectral density along and across.
models = [LinearModel(1, (0.1, 0.1)), LinearModel(2, (5.0, 5.0)), CoordinatedTurn(0.01, 0.1)]
imm = Imm(models, switch_rate=0.2, acceleration=2.0, turn_rate=0.2)
noise = SIGMA**2 * np.eye(2)[None]
at_rest = np.zeros(2)

# One row is one track; here there is one. Its first velocity is unknown within 20 m/s.
imm.spawn(measured[:1], noise, np.zeros((1, 2)), 400.0 * np.eye(2)[None])
filtered = [measured[0]]
for position in measured[1:]:
    direction = imm.combined()[0][:, 2:4]
    imm.predict(DT, direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9))
    imm.update(np.array([0]), Measurement(position[None], noise, at_rest, at_rest))
    filtered.append(imm.combined()[0][0, :2])

for name, positions in (("measured", measured), ("filtered", np.array(filtered))):
    error = np.hypot(*(positions - truth)[20:].T)
    print(f"{name}: {np.sqrt(np.mean(error**2)):.2f} m")
