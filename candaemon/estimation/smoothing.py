"""Fixed-lag smoothing: the estimate of an instant from the measurements up to a lag after it.

The Rauch–Tung–Striebel smoother (1965) in incremental form. Let the filter say x_k, P_k of instant k, predict x⁻_{k+1}
and P⁻_{k+1} from it with the gain G_k = C_k (P⁻_{k+1})⁻¹, C_k the covariance of the two, and then say x_{k+1}, P_{k+1}.
What the update taught it of k + 1 is d = x_{k+1} − x⁻_{k+1} and D = P_{k+1} − P⁻_{k+1}; of an earlier instant i, with
B_i = G_i … G_k, it is B_i d and B_i D B_iᵀ. So every instant of the window learns as soon as there is something to
learn, and no pass goes backwards.

For a linear model whose whole state is reported this is the exact smoother. An IMM reports the moments of its mixture,
and is smoothed as the one filter that has these moments. They differ before and after mixing where a model takes over
from others the components that it lacks, so P_k − G P⁻ Gᵀ, what would be left of P_k if all that comes were known, need
not be positive semidefinite: it is lifted to be, and so is every smoothed covariance.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Self

import numpy as np

from candaemon.arrays import Floats, Indices, Integers

_LEAST_SHARE = 1e-6  # of a component's standard deviation that those before it leave unexplained


@dataclass(frozen=True, slots=True)
class Link:
    """What ties an instant of a filter's run to the next: one prediction, n tracks, D reported components.

    Attributes:
        mean: predicted x⁻ (n, D).
        covariance: predicted P⁻ (n, D, D).
        gain: G (n, D, D): what is learnt of the predicted state, times G, is learnt of the state before.
    """

    mean: Floats
    covariance: Floats
    gain: Floats

    @classmethod
    def of_model(cls, before: Floats, transition: Floats, mean: Floats, covariance: Floats) -> Self:
        """Return the link of a single model's prediction, whose cross covariance is P Fᵀ.

        Args:
            before: covariance P before the prediction (n, D, D).
            transition: F, or its Jacobian (n or 1, D, D).
            mean: predicted (n, D).
            covariance: predicted (n, D, D).
        """
        return cls(mean, covariance, smoothing_gain(before @ np.swapaxes(transition, -2, -1), covariance))


def smoothing_gain(cross: Floats, covariance: Floats) -> Floats:
    """Return the smoothing gain G = C (P⁻)⁻¹.

    Components that P⁻ knows for certain, and combinations of them, teach nothing: the inverse is a pseudo-inverse.

    Args:
        cross: covariance C of the state before with the predicted state (n, D, D).
        covariance: predicted covariance P⁻ (n, D, D), symmetric, positive semidefinite.

    Returns:
        G (n, D, D).
    """
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    certain = variance <= 0.0
    scale = np.where(certain, 0.0, 1.0 / np.sqrt(np.where(certain, 1.0, variance)))
    correlation = covariance * scale[:, :, None] * scale[:, None, :]
    correlation += certain[:, :, None] * np.eye(covariance.shape[-1])
    weighted = _solved(correlation, np.swapaxes(cross * scale[:, None, :], -2, -1))
    return np.swapaxes(weighted, -2, -1) * scale[:, None, :]


def _solved(correlation: Floats, right: Floats) -> Floats:
    """Solve for matrices of correlations (n, D, D), in the sense of least squares where they are singular."""
    try:
        lower = np.linalg.cholesky(correlation)
    except np.linalg.LinAlgError:
        singular = True
    else:
        singular = bool(np.diagonal(lower, axis1=-2, axis2=-1).min(initial=1.0) < _LEAST_SHARE)
    if singular:
        return np.asarray(np.linalg.pinv(correlation, rcond=_LEAST_SHARE**2, hermitian=True) @ right)
    return np.asarray(np.linalg.solve(correlation, right))


@dataclass(frozen=True, slots=True)
class Smoothed:
    """What is known of one instant from all that was measured until the lag had passed, n chains, D components.

    Attributes:
        time_ns: the instant.
        keys: of its chains (n,), in the order in which they were given.
        mean: (n, D).
        covariance: (n, D, D).
    """

    time_ns: int
    keys: Integers
    mean: Floats
    covariance: Floats


class FixedLag:
    """Fixed-lag smoother of many chains at once; a chain is a filter's run, and begins and ends at any instant.

    An instant is returned when one comes that is more than the lag younger; its estimate then includes all those that
    are not. Instants are returned in the order they were given: one that is older than the one before it waits for
    that one, and its lag is so much longer. A time that goes back by more than the lag ends all chains.

    Args:
        lag_ns: time after an instant whose measurements enter its estimate.
        size: D, components of a state.
    """

    def __init__(self, lag_ns: int, size: int = 6) -> None:
        self._lag_ns = lag_ns
        self._newest_ns = 0
        self._waiting: deque[tuple[int, Integers]] = deque()
        self._keys: Integers = np.zeros(0, dtype=np.int64)
        # one row a chain and instant, in the order they were given; `chain` is a row of `keys`, −1 once it has ended
        self._chain: Indices = np.zeros(0, dtype=np.intp)
        self._mean: Floats = np.zeros((0, size))
        self._covariance: Floats = np.zeros((0, size, size))
        self._gain: Floats = np.zeros((0, size, size))

    def __len__(self) -> int:
        return len(self._waiting)

    def add(
        self, time_ns: int, keys: Integers, mean: Floats, covariance: Floats, linked: Integers, link: Link | None
    ) -> list[Smoothed]:
        """Add the filtered estimate of an instant; return the smoothed instants before it that are due.

        Args:
            time_ns: the instant.
            keys: of its chains (n,), each once.
            mean: filtered (n, D).
            covariance: filtered (n, D, D).
            linked: keys (m,) of the link's rows. A chain goes on where its key is in the instant before, in the link
                and in this one; else it ends, and another one begins.
            link: the prediction that led here, (m, …); None: every chain begins here.
        """
        due = self._take_due(time_ns)
        if link is None:
            self._chain = np.full(len(self._chain), -1)
        else:
            self._learn(keys, mean, covariance, linked, link)
        n, d = mean.shape
        self._chain = np.concatenate([self._chain, np.arange(n)])
        self._mean = np.concatenate([self._mean, mean])
        self._covariance = np.concatenate([self._covariance, covariance])
        self._gain = np.concatenate([self._gain, np.broadcast_to(np.eye(d), (n, d, d))])
        self._waiting.append((time_ns, keys))
        self._keys = keys
        return due

    def finish(self) -> list[Smoothed]:
        """Return the instants that are left, at the end of all runs."""
        return self._take(len(self._waiting))

    def _learn(self, keys: Integers, mean: Floats, covariance: Floats, linked: Integers, link: Link) -> None:
        """Learn of the latest instant what the update taught, and hand it down every chain that goes on."""
        before, after = _rows_of(self._keys, linked), _rows_of(self._keys, keys)
        on = np.flatnonzero((before >= 0) & (after >= 0))
        before, after = before[on], after[on]
        gain, predicted = link.gain[before], link.covariance[before]
        latest = self._covariance[len(self._covariance) - len(self._keys) + on]
        taught = _applied(gain, mean[after] - link.mean[before])
        change = _through(gain, covariance[after] - predicted) + _lift(latest - _through(gain, predicted))
        place = np.full(len(self._keys) + 1, -1)  # the last one for chains that have ended
        place[on] = np.arange(len(on))
        chain = place[self._chain]
        going = np.flatnonzero(chain >= 0)
        at, down = chain[going], self._gain[going]
        self._mean[going] += _applied(down, taught[at])
        self._covariance[going] += _through(down, change[at])
        self._gain[going] = down @ gain[at]
        self._chain = np.append(after, -1)[chain]

    def _take_due(self, time_ns: int) -> list[Smoothed]:
        """Take the instants that are due when another one comes."""
        if time_ns < self._newest_ns - self._lag_ns:
            self._newest_ns = time_ns
            return self.finish()
        self._newest_ns = max(self._newest_ns, time_ns)
        first_ns = self._newest_ns - self._lag_ns
        old = takewhile(lambda instant: instant[0] < first_ns, self._waiting)
        return self._take(sum(1 for _ in old))

    def _take(self, count: int) -> list[Smoothed]:
        """Take so many instants from the front."""
        taken, first = [], 0
        for _ in range(count):
            time_ns, keys = self._waiting.popleft()
            rows = slice(first, first + len(keys))
            covariance = (self._covariance[rows] + np.swapaxes(self._covariance[rows], 1, 2)) / 2
            taken.append(Smoothed(time_ns, keys, self._mean[rows].copy(), covariance))
            first += len(keys)
        self._chain, self._mean = self._chain[first:], self._mean[first:]
        self._covariance, self._gain = self._covariance[first:], self._gain[first:]
        if not self._waiting:
            self._keys = self._keys[:0]
        return taken


def _applied(gain: Floats, vector: Floats) -> Floats:
    """Return G v of vectors (n, D)."""
    return np.asarray(np.matmul(gain, vector[:, :, None])[:, :, 0])


def _lift(left: Floats) -> Floats:
    """Return what covariances (n, D, D) lack to be positive semidefinite; nothing of those that are no numbers."""
    value, vector = np.linalg.eigh(np.where(np.isfinite(left).all(axis=(1, 2), keepdims=True), left, 0.0))
    return np.asarray((vector * np.maximum(-value, 0.0)[:, None, :]) @ np.swapaxes(vector, -2, -1))


def _through(gain: Floats, covariance: Floats) -> Floats:
    """Return G P Gᵀ."""
    return np.asarray(gain @ covariance @ np.swapaxes(gain, -2, -1))


def _rows_of(keys: Integers, among: Integers) -> Indices:
    """Return where each key is among others that are each there once; −1 where it is not."""
    if not len(among):
        return np.full(len(keys), -1, dtype=np.intp)
    order = np.argsort(among)
    place = order[np.minimum(np.searchsorted(among, keys, sorter=order), len(among) - 1)]
    return np.where(among[place] == keys, place, -1)


@dataclass(frozen=True, slots=True)
class Step:
    """One instant of a recorded filter run of n tracks.

    Attributes:
        time_ns: the instant.
        mean: filtered (n, D).
        covariance: filtered (n, D, D).
        link: the prediction that led here; None at the first.
    """

    time_ns: int
    mean: Floats
    covariance: Floats
    link: Link | None


def smooth(steps: Sequence[Step], lag_ns: int) -> tuple[Floats, Floats]:
    """Smooth a recorded run; all tracks live from its first step to its last.

    `Imm` leaves links where its `linking` is on, and a link of any other filter is `Link.of_model`.

    Args:
        steps: at least one, in order of time.
        lag_ns: time after an instant whose measurements enter its estimate; the whole run at most.

    Returns:
        Smoothed means (steps, n, D) and covariances (steps, n, D, D).
    """
    tracks, size = steps[0].mean.shape
    keys = np.arange(tracks)
    smoother, smoothed = FixedLag(lag_ns, size), []
    for step in steps:
        smoothed += smoother.add(step.time_ns, keys, step.mean, step.covariance, keys, step.link)
    smoothed += smoother.finish()
    return np.stack([each.mean for each in smoothed]), np.stack([each.covariance for each in smoothed])
