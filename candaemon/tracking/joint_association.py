"""How probable it is that detections are of the bodies that they were assigned to, where gates overlap.

Source: Fortmann, Bar-Shalom and Scheffe 1983 (joint probabilistic data association). A joint event gives each
detection to one reflection at most, and each reflection one detection at most. Other than there, each body is updated
with the detection of the best joint event alone, and with the noise that the doubt about it leaves: a mean of the
detections of two neighbours would draw both together.
"""

from __future__ import annotations

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.arrays.rows import distinct
from candaemon.estimation.measurement import Measurement

EXACT = 8
"""Reflections or detections, the fewer of them, up to which all joint events are counted."""
_MOST_DOUBT = 100.0  # times the noise at most: what is most likely of something else tells next to nothing
_FASTEST = 40.0  # m/s; the speed of a false detection is as likely anywhere between this and its opposite
_LARGEST = 1e12  # ratio of likelihoods that no pair exceeds: eight of them are multiplied


def likelihood_ratios(
    mean: Floats, covariance: Floats, measurement: Measurement, probability: float, density: float
) -> Floats:
    """Return how much likelier m aligned pairs are than a missed reflection and a false detection.

    Args:
        mean: predicted states of the reflections (m, 4), local frame.
        covariance: (m, 4, 4).
        measurement: m detections.
        probability: of detection P_D, of what is in sight.
        density: of false detections, per m².
    """
    innovation, jacobian, noise = measurement.linearised(mean)
    s = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2) + noise
    nis = (innovation * np.linalg.solve(s, innovation[..., None])[..., 0]).sum(axis=1)
    likelihood = np.exp(-0.5 * nis) / np.sqrt(np.maximum(np.linalg.det(2 * np.pi * s), 1e-300))
    false = density / np.power(2.0 * _FASTEST, measurement.measured - 2)
    return np.asarray(np.minimum(probability / (1.0 - probability) * likelihood / false, _LARGEST))


def joint_probabilities(ratio: Floats) -> Floats:
    """Return the probability of each pair (n, m) over all joint events.

    Args:
        ratio: of each pair of n reflections and m detections, as `likelihood_ratios` says; 0 out of the gate.
    """
    if min(ratio.shape) > EXACT:
        # each pair beside all that it excludes, as if nothing excluded those (Fitzgerald 1986)
        return np.asarray(ratio / (1.0 + ratio.sum(axis=0) + ratio.sum(axis=1)[:, None] - ratio))
    if ratio.shape[1] > ratio.shape[0]:
        return joint_probabilities(ratio.T).T
    n, m = ratio.shape
    sets = np.arange(1 << m)
    without = [sets[sets >> d & 1 == 0] for d in range(m)]
    before = np.zeros((n + 1, 1 << m))  # sum over the events of the first reflections that use a set of detections
    before[0, 0] = 1.0
    after = np.ones((n + 1, 1 << m))  # likewise of the other reflections, with detections out of that set
    for i in range(n):
        before[i + 1] = before[i]
        for d, free in enumerate(without):
            before[i + 1, free | 1 << d] += ratio[i, d] * before[i, free]
    for i in reversed(range(n)):
        after[i] = after[i + 1]
        for d, free in enumerate(without):
            after[i, free] += ratio[i, d] * after[i + 1, free | 1 << d]
    found = np.zeros((n, m))
    for i in range(n):
        for d, free in enumerate(without):
            found[i, d] = ratio[i, d] * (before[i, free] @ after[i + 1, free | 1 << d])
    return np.asarray(found / after[0, 0])


def doubts(track: Indices, detection: Indices, body: Indices, ratio: Floats, chosen: Indices) -> Floats:
    """Return by how much the noise of assigned detections grows, for they may be another body's: (k,), 1 without doubt.

    With the probability β that it is of its body, a detection has β times the information.

    Args:
        track: reflection of each pair in its gate (p,).
        detection: of each pair (p,).
        body: of each pair's reflection (p,); reflections of one body do not compete.
        ratio: of each pair (p,).
        chosen: pairs that were assigned (k,).
    """
    factor = np.ones(len(chosen))
    for members in _competing(track, detection, body):
        tracks, i = np.unique(track[members], return_inverse=True)
        detections, d = np.unique(detection[members], return_inverse=True)
        table = np.zeros((len(tracks), len(detections)))
        table[i, d] = ratio[members]
        probability = joint_probabilities(table)[i, d]
        for k in np.flatnonzero(np.isin(chosen, members)).tolist():
            pair = chosen[k]
            own = (detection[members] == detection[pair]) & (body[members] == body[pair])
            factor[k] = 1.0 / max(float(probability[own].sum()), 1.0 / _MOST_DOUBT)
    return factor


def _competing(track: Indices, detection: Indices, body: Indices) -> list[Indices]:
    """Return the pairs of each cluster of overlapping gates in which bodies compete for a detection."""
    clusters: list[Indices] = []
    left = np.ones(len(track), dtype=np.bool_)
    while left.any():
        members = np.zeros(len(track), dtype=np.bool_)
        members[left.argmax()] = True
        while True:
            grown = np.isin(track, track[members]) | np.isin(detection, detection[members])
            if (grown == members).all():
                break
            members = grown
        left &= ~members
        rows = np.flatnonzero(members)
        owners = np.unique(np.stack([detection[rows], body[rows]]), axis=1)[0]
        if len(owners) > len(distinct(owners)):
            clusters.append(rows)
    return clusters
