"""Summary of a replay for a user without ground truth: input read and lost, and scores of the tracks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from candaemon.calibration.report import ego_figures, sensor_figures
from candaemon.ego.georeference import Georeferencer
from candaemon.errors import InputError
from candaemon.evaluation.drive_score import DriveScore
from candaemon.pipeline.pipeline import Pipeline
from candaemon.playback.replay import Replayed

_CHANNELS_NAMED: Final = 10
"""Channels of a log that a message lists."""
_BULK: Final = 0.1
"""Share of what came that, left out, is worth a warning."""
_FRAMES: Final = {
    "checksum": "frames with a wrong checksum",
    "repeated": "frames whose counter had not moved",
    "jumped": "frames whose counter had jumped",
    "too_fast": "frames that came too fast",
    "surplus": "frames of more objects than `slots`",
    "short": "frames shorter than their message",
    "late": "frames of scans that were closed already (is scan.timeout too short?)",
    "duplicate": "frames that were in their scan already",
    "discarded": "frames of scans that were discarded",
}
"""What is said of a sensor's frames that were left out, by their count."""
_OBJECTS: Final = {
    "unpaired": "objects of messages that do not belong together",
    "rejected": "objects without a place or a required message",
    "not_finite": "objects with a value that is no number",
    "out_of_range": "objects outside of the DBC's ranges",
    "impossible": "objects that moved as nothing can",
}
"""Likewise of its objects."""
_SCANS: Final = {
    "incomplete": "lacked frames",
    "distrusted": "were discarded, for too many of their frames failed",
    "unknown_look": "were of none of its looks",
    "unstamped": "came without the sensor's time stamp",
    "odd_stamps": "came with a time stamp that cannot be",
}
"""What is said of a sensor's scans, by their count."""
_CYCLES: Final = {
    "coasting": "every sensor was silent",
    "dead_reckoning": "own motion was dead reckoning: no velocity came",
    "ego_lost": "own motion was lost: no velocity had come for so long that even dead reckoning was given up",
}
"""What is said of cycles, by their count."""
_REFUSED: Final = {
    "checksum": "with a wrong checksum",
    "repeated": "whose counter had not moved",
    "jumped": "whose counter had jumped",
    "too_fast": "that came too fast",
    "short": "shorter than their message",
    "not_finite": "with a value that is no number",
    "out_of_range": "outside of the DBC's ranges",
    "impossible": "of a motion that cannot be",
}
"""Likewise of ego motion."""


def summarise(replayed: Replayed) -> dict[str, Any]:
    """Return the summary of a replay, ready for JSON. The keys are stable.

    Without `ReplayRequest.scored` there are no `predictions`, `stationary` and `duplicates`, unless predictions were
    written.

    ==================  ==============================================================================
    `log`               lines by what they are: frames, malformed, remote and error frames, ticks, of other channels,
                        without a frame by their kind; `outside` of the range of time only where there are
    `buses`             per bus: frames, used, spare (not evaluated), of those shorter than their message (spare_short),
                        unknown (no DBC entry), short (of ego motion: its values are lost), CAN FD frames where the bus
                        has no `fd: true` (fd_unset)
    `sensors`           per sensor: frames by outcome, objects rejected by cause, scans, incomplete and discarded scans,
                        frames missing; under `trust` how often it was found silent, frozen, biased, noisy, and its
                        scans cut off or weighted down
    `own_motion`        frames of ego motion rejected, by cause
    `clock`             steps back and forward that were rebased; late frames whose time was raised; reordered frames;
                        stray time stamps, far from those before and after, that were corrected
    `cycles`            reported; coasting (every sensor silent), with ego motion by dead reckoning or lost; scans
                        dropped for lack of ego motion
    `tracks`            detections received and used, obstacles initiated, confirmed, merged, slot jumps
    `nis`               mean, expected, coverage of the 95 % quantile, samples
    `predictions`       per horizon: RMSE of x and y against the sensor's later measurements, m
    `stationary`        RMS over ground of stationary objects: vx, speed in the plane, m/s
    `duplicates`        share of confirmed samples with another one within 3 m, 1 m and 1 m/s
    `output`            frames sent, values that had to be saturated
    `gnss`              only with `ego.gnss`: fixes received and by outcome, RMS innovation of the used ones, standard
                        deviation of the last georeference, m
    `seconds`           duration of the log
    `calibration`       per sensor, only where it is estimated: latency, yaw, their standard deviations, what is applied
                        (`candaemon.calibration.report`)
    `ego_calibration`   only with odometry: scale of the speed, bias of the yaw rate, their standard deviations
    `ego_signals`       how often each signal of ego motion came
    `ego_samples`       samples of ego motion, and in how many of them what was derived
    ==================  ==============================================================================
    """
    pipeline, log, score = replayed.pipeline, replayed.log, replayed.score
    counts, got = pipeline.counts, received(pipeline)
    return {
        "log": {
            "frames": log.frames,
            "lines": log.lines,
            "malformed": log.malformed,
            "examples": log.examples,
            "remote": log.remote,
            "error_frames": log.error_frames,
            "ticks": log.ticks,
            **({"outside": log.outside} if log.outside else {}),
            "other_lines": log.other_lines,
            "other_channels": dict(sorted(log.other_channels.items())),
            "truncated": log.truncated,
        },
        "buses": got["buses"],
        "sensors": got["sensors"],
        "own_motion": got["own_motion"],
        "clock": {
            "backward_steps": replayed.sequence.backward_steps,
            "late": replayed.sequence.late,
            "reordered": replayed.sequence.reordered,
            "forward_steps": replayed.sequence.forward_steps,
            "stray": replayed.stray_times,
        },
        "cycles": got["cycles"],
        "tracks": got["tracks"],
        "nis": {
            "mean": _rounded(score.nis.mean),
            "expected": _rounded(score.nis.expected),
            "coverage_95": _rounded(score.nis.coverage),
            "samples": score.nis.samples,
        },
        **({} if score.brief else _without_truth(score)),
        "output": {"frames": counts.sent, "saturated": pipeline.saturated},
        **({} if pipeline.georeferencer is None else {"gnss": _gnss(pipeline.georeferencer)}),
        "seconds": _rounded((replayed.last_ns - replayed.first_ns) * 1e-9),
        **_calibration(pipeline),
        "ego_signals": got["ego_signals"],
        "ego_samples": got["ego_samples"],
    }


def received(pipeline: Pipeline) -> dict[str, dict[str, Any]]:
    """Return the branches of a summary on what came, and what became of it, for `doubts`."""
    counts = pipeline.counts
    tracked = [asdict(tracker.counts) for tracker in pipeline.trackers]
    return {
        "buses": {
            bus.name: {**asdict(each), "used": each.used}
            for bus, each in zip(pipeline.binding.buses, counts.buses, strict=True)
        },
        "sensors": {
            sensor.name: asdict(assembler.counts) | {"trust": asdict(pipeline.trust.counts(sensor.index))}
            for sensor, assembler in zip(pipeline.binding.sensors, pipeline.assemblers, strict=True)
        },
        "own_motion": {"short": counts.ego_motion_short, **asdict(counts.ego_motion)},
        "cycles": {
            "told": counts.cycles,
            "coasting": counts.coasting_cycles,
            "dead_reckoning": counts.dead_reckoning,
            "ego_lost": counts.ego_lost,
            "without_ego": counts.without_ego,
        },
        "tracks": {key: sum(each[key] for each in tracked) for key in tracked[0]},
        "ego_signals": pipeline.ego_signals,
        "ego_samples": asdict(pipeline.ego.counts),
    }


def _without_truth(score: DriveScore) -> dict[str, Any]:
    """Return what later detections, standing objects and neighbours say of the tracks."""
    still = score.stationary.result()
    return {
        "predictions": [
            {"horizon": row.horizon, "x": _rounded(row.x), "y": _rounded(row.y), "samples": row.samples}
            for row in score.predictions.result()
        ],
        "stationary": {
            "vx": _rounded(still.vx),
            "speed": _rounded(still.speed),
            "samples": still.samples,
            "runs": still.runs,
        },
        "duplicates": {"share": _rounded(score.duplicates.share), "samples": score.duplicates.samples},
    }


def doubts(figures: Mapping[str, Any]) -> list[str]:
    """Return what to know of a drive before its results are trusted: what never came, what was left out in bulk.

    Args:
        figures: of `summarise`, or at least those of `received`.
    """
    found = [
        f"bus '{name}': {counts['fd_unset']:,} CAN FD frames, which `run` would not read; give buses.{name} fd: true"
        for name, counts in figures["buses"].items()
        if counts["fd_unset"]
    ]
    for name, counts in figures["sensors"].items():
        if not counts["used"]:
            found.append(f"sensor '{name}': not one usable frame in this log")
            continue
        for cause, what in _FRAMES.items():
            if counts[cause] > _BULK * (counts["used"] + counts[cause]):
                found.append(f"sensor '{name}': {counts[cause]:,} {what}, beside {counts['used']:,} frames used")
        for cause, what in _OBJECTS.items():
            if counts[cause] > _BULK * (counts["used"] + counts[cause]):
                found.append(f"sensor '{name}': {counts[cause]:,} {what}; {counts['used']:,} frames were used")
        scans = counts["scans"] + counts["distrusted"]
        for cause, what in _SCANS.items():
            if counts[cause] > _BULK * scans:
                found.append(f"sensor '{name}': {counts[cause]:,} of {scans:,} scans {what}")
    taken, refused = max(figures["ego_signals"].values(), default=0), figures["own_motion"]
    for cause, what in _REFUSED.items():
        if refused[cause] > _BULK * (taken + refused[cause]):
            found.append(f"own motion: {refused[cause]:,} frames {what}, beside {taken:,} taken")
    tracked, blind = figures["tracks"]["cycles"], figures["cycles"]["without_ego"]
    if figures["ego_signals"] and not figures["ego_samples"]["samples"]:
        found.append(f"own motion was never known: {_silence(figures)}")
        return found
    if blind > _BULK * (tracked + blind):
        found.append(f"own motion was not known in {blind:,} of {tracked + blind:,} scans, which were dropped")
    cycles = figures["cycles"]
    for cause, what in _CYCLES.items():
        if cycles[cause] > _BULK * cycles["told"]:
            found.append(f"in {cycles[cause]:,} of {cycles['told']:,} cycles {what}")
    samples, assumed = figures["ego_samples"]["samples"], figures["ego_samples"]["direction_assumed"]
    if assumed > _BULK * samples and "reverse" not in _silent_signals(figures):
        found.append(
            f"own motion: the signal that tells reverse was silent in {assumed:,} of {samples:,} samples, and speeds "
            "counted as ahead; where it is sent only when it changes, raise ego.reverse_age_limit"
        )
    if _silent_signals(figures):
        found.append(f"own motion: {_silence(figures)}")
    return found


def require_used(log: Path, figures: Mapping[str, Any], then: str = "nothing is written") -> None:
    """Refuse a log of which nothing can be tracked.

    Args:
        log: its name.
        figures: of `summarise`, or those of `received` with the log's own.
        then: what becomes of it.

    Raises:
        InputError: it has not one usable frame of any sensor, or own motion was not known in any scan.
    """
    tracked, blind = figures["tracks"]["cycles"], figures["cycles"]["without_ego"]
    if not any(counts["used"] for counts in figures["sensors"].values()):
        wrong = f"not one usable frame of any sensor ({', '.join(figures['sensors'])})"
    elif blind and not tracked:
        wrong = (
            f"own motion was not known in any of {blind:,} scans, and nothing is tracked without it: "
            f"{_silence(figures)}"
        )
    else:
        return
    others = ", ".join(list(figures["log"]["other_channels"])[:_CHANNELS_NAMED]) or "none"
    raise InputError(
        f"{wrong}; log channels no bus takes: {others}; check each bus's channel, or use --map CHANNEL=BUS; {then}",
        file=log,
    )


def _silent_signals(figures: Mapping[str, Any]) -> list[str]:
    return [name for name, count in figures["ego_signals"].items() if not count]


def _silence(figures: Mapping[str, Any]) -> str:
    """Return which signals of own motion never came."""
    silent = ", ".join(_silent_signals(figures))
    return f"{silent} never came" if silent else "each of its signals came, but never all of them together"


def _calibration(pipeline: Pipeline) -> dict[str, Any]:
    """Return what was estimated of the sensors and of odometry."""
    calibrator = pipeline.calibrator
    if calibrator is None:
        return {}
    sensors = {sensor.name: sensor_figures(calibrator, sensor.index) for sensor in pipeline.binding.sensors}
    ego = ego_figures(calibrator)
    return {"calibration": sensors, **({} if ego is None else {"ego_calibration": ego})}


def _gnss(georeferencer: Georeferencer) -> dict[str, Any]:
    """Return the counts of GNSS fixes."""
    counts = georeferencer.counts
    return {
        "fixes": counts.fixes,
        "incomplete": counts.incomplete,
        "invalid": counts.invalid,
        "unplaced": counts.unplaced,
        "rejected": counts.rejected,
        "restarts": counts.restarts,
        "innovation_rms": _rounded(counts.innovation_rms),
        "deviation": _rounded(georeferencer.deviation),
    }


def _rounded(value: float) -> float | None:
    """Return a figure with six decimals; None for NaN, which JSON does not have."""
    return round(value, 6) if np.isfinite(value) else None
