"""The drawings of Gao et al. 2016."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from candaemon.arrays import Floats
from candaemon.papers.experiment import Figure, Line, Panel
from candaemon.papers.gao_filters import METHODS, QUANTITIES, SENSORS, Adaptation, Outcome, SensorRecording

_MOST_POINTS = 2000
_SAMPLE = "time slot"


def drive_figures(name: str, recording: SensorRecording, outcome: Outcome) -> tuple[Figure, ...]:
    """Return Figures 8 to 11 of the first drive, or those of another that are like them; all of the first run."""
    joint = METHODS[4:]
    truth = recording.truth[:, 0]
    return (
        Figure(
            f"{name}-motion",
            "The motion and the joint filter's estimate",
            _motion(truth, outcome.methods[joint[0]][:, 0]),
        ),
        Figure(f"{name}-noise", "Noise of the sensors", _noise(recording)),
        adaptation_figure(name, outcome.adaptation),
        *(
            Figure(
                f"{name}-{sensor}",
                f"Errors of the filters of the {sensor} and of the joint filters",
                _errors(truth, {m: e for m, e in outcome.methods.items() if sensor in m or m in joint}),
            )
            for sensor in SENSORS
        ),
    )


def adaptation_figure(name: str, adaptation: Adaptation) -> Figure:
    """Return the joint filter's R̂ of each component and its β over time."""
    panels = [
        Panel(
            _SAMPLE,
            f"R of {quantity}, {squared}",
            tuple(_over_time(sensor, adaptation.variance[:, s, c]) for s, sensor in enumerate(SENSORS)),
        )
        for c, (quantity, _, squared) in enumerate(QUANTITIES)
    ]
    shares = tuple(_over_time(sensor, adaptation.share[:, s]) for s, sensor in enumerate(SENSORS))
    panels.append(Panel(_SAMPLE, "β", shares))
    return Figure(f"{name}-adaptation", "R and β of the joint filter", tuple(panels))


def sweep_figure(name: str, title: str, swept: str, over: Floats, errors: Mapping[str, Floats]) -> Figure:
    """Return root mean square errors of each method, (values, 3), over the value that was swept, (values,)."""
    panels = (
        Panel(swept, f"error of {quantity}, {unit}", tuple(Line(m, over, e[:, c]) for m, e in errors.items()))
        for c, (quantity, unit, _) in enumerate(QUANTITIES)
    )
    return Figure(name, title, tuple(panels))


def _motion(truth: Floats, estimate: Floats) -> tuple[Panel, ...]:
    return tuple(
        Panel(_SAMPLE, f"{quantity}, {unit}", (_over_time("truth", truth[:, c]), _over_time("JAKF", estimate[:, c])))
        for c, (quantity, unit, _) in enumerate(QUANTITIES)
    )


def _noise(recording: SensorRecording) -> tuple[Panel, ...]:
    noise = recording.measured[:, :, 0, 0] - recording.truth[:, 0, 0]
    return tuple(
        Panel(_SAMPLE, f"noise of the {sensor}, m", (_over_time(sensor, noise[s]),)) for s, sensor in enumerate(SENSORS)
    )


def _errors(truth: Floats, methods: Mapping[str, Floats]) -> tuple[Panel, ...]:
    return tuple(
        Panel(
            _SAMPLE,
            f"error of {quantity}, {unit}",
            tuple(_over_time(m, np.abs(e[:, 0, c] - truth[:, c])) for m, e in methods.items()),
        )
        for c, (quantity, unit, _) in enumerate(QUANTITIES)
    )


def _over_time(label: str, values: Floats) -> Line:
    """Return a curve over the samples, thinned to what a drawing can show."""
    every = -(-len(values) // _MOST_POINTS)
    at = np.arange(0, len(values), every)
    return Line(label, at.astype(np.float64), values[at])
