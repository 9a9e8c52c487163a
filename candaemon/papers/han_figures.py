"""The drawings of Han et al. 2015: path, errors and adaptive variances of one motion."""

from __future__ import annotations

from collections.abc import Mapping

from candaemon.arrays import Floats
from candaemon.papers.experiment import Figure, Line, Panel
from candaemon.papers.han_filters import variances
from candaemon.papers.profiles import ProfileMotion

_ERRORS = (
    "error of position x, m",
    "error of position y, m",
    "error of velocity x, m/s",
    "error of velocity y, m/s",
    "error of acceleration x, m/s²",
    "error of acceleration y, m/s²",
)


def figures(name: str, title: str, motion: ProfileMotion, estimates: Mapping[str, Floats]) -> tuple[Figure, ...]:
    """Return the drawings of a motion's first run.

    Args:
        name: '000-constant-velocity'.
        title: above each of them.
        motion: the truth.
        estimates: of each method (steps, runs, 6); those of 'CS' have the adaptive variances.
    """
    first = {method: each[:, 0] for method, each in estimates.items()}
    return (
        Figure(f"{name}-path", f"{title}: path", (_path(motion, first),)),
        Figure(f"{name}-errors", f"{title}: errors", tuple(_error(motion, first, c) for c in range(6))),
        Figure(f"{name}-variances", f"{title}: adaptive variances", (_variances(motion, first["CS"]),)),
    )


def _path(motion: ProfileMotion, estimates: Mapping[str, Floats]) -> Panel:
    """Return what figures 4, 7, 10 and 15 of the paper show."""
    true = Line("truth", motion.state[:, 0], motion.state[:, 1])
    return Panel("x, m", "y, m", (true, *(Line(method, each[:, 0], each[:, 1]) for method, each in estimates.items())))


def _error(motion: ProfileMotion, estimates: Mapping[str, Floats], component: int) -> Panel:
    """Return what figures 5, 8, 11 and 16 show of one component."""
    lines = (
        Line(method, motion.time, each[:, component] - motion.state[:, component]) for method, each in estimates.items()
    )
    return Panel("time, s", _ERRORS[component], tuple(lines))


def _variances(motion: ProfileMotion, estimates: Floats) -> Panel:
    """Return what figures 6, 9, 12 and 17 show."""
    adaptive = variances(estimates[:, 4:])
    lines = (Line("along x", motion.time, adaptive[:, 0]), Line("along y", motion.time, adaptive[:, 1]))
    return Panel("time, s", "variance of acceleration, (m/s²)²", lines)
