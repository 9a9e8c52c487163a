"""All comparisons, and what the project wants of each."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeAlias

from candaemon.binding.bound import Binding
from candaemon.config.estimators import CsEstimatorSettings, ImmEstimatorSettings

from . import naive, parts
from .chains import count, imm_binding, naive_cycles, reduced_binding, replayed, simulated_log
from .timing import Comparison

Maker: TypeAlias = Callable[[Path], Comparison]
"""Makes a comparison, its files in a folder."""

CS, IMM = CsEstimatorSettings(kind="cs"), ImmEstimatorSettings()


def _chain(
    name: str,
    make: Callable[[], Binding],
    kind: Callable[..., naive.Filter],
    seconds: float,
    folder: Path,
) -> Comparison:
    """Log in, log out, both on the same log: what a user runs, beside the naive chain."""
    binding, log = make(), simulated_log(folder / "in.log", seconds)
    return Comparison(
        name,
        "cycle",
        lambda: replayed(binding, log, folder / "candaemon.log"),
        lambda: count(naive_cycles(kind, log, folder / "naive.log")),
        goal=15,
    )


def _codec(name: str, candaemon: str, cantools: str, goal: float, folder: Path) -> Comparison:
    """All signals of the ESR's target."""
    del folder
    codec = parts.Codec()
    return Comparison(name, "frame", getattr(codec, candaemon), getattr(codec, cantools), goal=goal, against="cantools")


def _reader(name: str, read: Callable[[Path], int], goal: float, folder: Path) -> Comparison:
    """The log's frames alone."""
    log = simulated_log(folder / "in.log", 10.0)
    return Comparison(name, "frame", partial(read, log), partial(parts.read_with_python_can, log), goal, "python-can")


def _estimator(
    name: str,
    settings: CsEstimatorSettings | ImmEstimatorSettings,
    kind: Callable[..., naive.Filter],
    folder: Path,
    *,
    kernels: bool = True,
) -> Comparison:
    """64 tracks predicted and updated with a position each."""
    del folder
    return Comparison(
        name,
        "cycle",
        partial(parts.computed, kernels, lambda: parts.estimate(settings, parts.BATCH, parts.STEPS)),
        lambda: parts.estimate_with_filterpy(kind, parts.BATCH, 15),
        goal=200 if kernels else 50,
        against="filterpy",
    )


def _axes(name: str, folder: Path, *, kernels: bool = True) -> Comparison:
    """64 tracks predicted and updated with a position each, x and y apart."""
    del folder
    axes = parts.Axes()
    return Comparison(
        name,
        "cycle",
        partial(parts.computed, kernels, axes.estimate),
        axes.estimate_with_filterpy,
        goal=200 if kernels else 50,
        against="filterpy",
    )


CHAINS: dict[str, Maker] = {
    "cs": partial(_chain, "chain, CS-KF", reduced_binding, naive.CurrentStatistical, 20.0),
    "imm": partial(_chain, "chain, IMM with its defaults", imm_binding, naive.InteractingModels, 5.0),
}
PARTS: dict[str, Maker] = {
    "decode": partial(_codec, "decode", "decode", "decode_with_cantools", 2.5),
    "encode": partial(_codec, "encode", "encode", "encode_with_cantools", 5),
    "decode-64": partial(_codec, "decode 64 at once", "decode_batch", "decode_with_cantools", 15),
    "encode-64": partial(_codec, "encode 64 at once", "encode_batch", "encode_with_cantools", 30),
    "read": partial(_reader, "read a log by frame", parts.read_frames, 4),
    "read-bulk": partial(_reader, "read a log in bulk", parts.read_blocks, 20),
    "cs": partial(_estimator, "CS-KF, 64 tracks", CS, naive.CurrentStatistical),
    "cs-numpy": partial(_estimator, "the same, numpy alone", CS, naive.CurrentStatistical, kernels=False),
    "cs-axes": partial(_axes, "CS-KF, per axis, 64 tracks"),
    "cs-axes-numpy": partial(_axes, "the same, numpy alone", kernels=False),
    "imm": partial(_estimator, "IMM of three models, 64 tracks", IMM, naive.InteractingModels),
    "imm-numpy": partial(_estimator, "the same, numpy alone", IMM, naive.InteractingModels, kernels=False),
}
GROWTH: dict[str, tuple[CsEstimatorSettings | ImmEstimatorSettings, int]] = {
    "cs-256": (CS, 256),
    "cs-1024": (CS, 1024),
    "imm-256": (IMM, 256),
    "imm-1024": (IMM, 1024),
}
"""Filter and number of tracks, whose cost is compared with that of 64."""
