"""Integrated probability of existence: how probable it is that an obstacle is there, over time, n obstacles at once.

Source: Mušicki et al. 1994 (IPDA, Markov chain one). The chain has two states, there or not; an obstacle that is there
leaves for good at a constant rate.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from candaemon.arrays import Floats

LEAST: Final = 1e-6
"""Probability that is left of any obstacle, so that evidence can raise it again; 1 less it is the greatest."""
LARGEST_RATIO: Final = 1e12
"""Likelihood ratio that no detection exceeds."""


def predicted(existence: Floats, dt: float, mean_life: float) -> Floats:
    """Return the probabilities of existence after a time without evidence.

    Args:
        existence: of each obstacle (n,).
        dt: s; nothing changes backwards in time.
        mean_life: s, after which an obstacle that nobody looks at is still there with a probability of 1/e.
    """
    return bounded(existence * kept(dt, mean_life))


def kept(dt: float, mean_life: float) -> float:
    """Return the factor of the probabilities of existence after a time without evidence, as in `predicted`."""
    return float(np.exp(-max(dt, 0.0) / mean_life))


def detected(existence: Floats, detection_probability: Floats, likelihood_ratio: Floats) -> Floats:
    """Return the probabilities of existence (n,) after a scan with detections in the obstacles' gates.

    Λ = 1 − P_D + P_D Σ ℓ_j / λ; the odds of existence are multiplied by it.

    Args:
        existence: predicted (n,).
        detection_probability: P_D, with which each is detected inside its gate (n,).
        likelihood_ratio: Σ ℓ_j / λ, the likelihood of the detections in its gate over the density of clutter, in the
            same units (n,); 0 where there is none, as is one that is no number.
    """
    ratio = np.fmin(np.fmax(likelihood_ratio, 0.0), LARGEST_RATIO)
    probability = np.fmin(np.fmax(detection_probability, 0.0), 1.0)
    evidence = 1.0 - probability + probability * ratio
    prior = bounded(existence)
    present = evidence * prior
    return bounded(present / (present + 1.0 - prior))


def bounded(existence: Floats) -> Floats:
    """Return probabilities within `LEAST` and 1 − `LEAST`; what is no number becomes the least."""
    return np.asarray(np.fmin(np.fmax(existence, LEAST), 1.0 - LEAST))
