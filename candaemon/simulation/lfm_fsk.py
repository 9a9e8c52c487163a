"""The radar front end of Avatirak et al. 2012: LFM-FSK, range and speed from a beat frequency and a phase difference.

Two chirps A and B sweep the same bandwidth in steps taken in turn, B a little below A. A target is a peak at the same
beat frequency in both spectra; neither that nor the phase between the two determines range and speed, but both together
do, in one short measurement and for each peak on its own (Rohling and Meinecke, "Waveform design principles for
automotive radar systems", 2001). Targets of one beat frequency form one peak.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from candaemon.arrays import Floats, Indices
from candaemon.config.sensors import LfmFskSettings

SPEED_OF_LIGHT = 299_792_458.0
"""m/s."""
_REFERENCE_RANGE = 50.0
"""m, to which the signal-to-noise ratio of the settings refers."""
_BELOW_ZERO = 0.05
"""Share of the unambiguous interval below range 0, so that noise does not wrap a near target to the far end."""


class LfmFsk:
    """The waveform: beat frequency and phase of a target, and range and speed of a peak.

    Args:
        settings: of the front end.

    Attributes:
        range_cell: ΔR = c / 2B, m.
        speed_cell: Δv = λ / 2T, m/s.
    """

    def __init__(self, settings: LfmFskSettings) -> None:
        self._steps = settings.steps
        self.range_cell = SPEED_OF_LIGHT / (2 * settings.bandwidth)
        self.speed_cell = SPEED_OF_LIGHT / settings.carrier / (2 * settings.chirp_time)
        self._phase_per_range = 2 * math.pi * settings.step_frequency / settings.bandwidth
        self._phase_per_speed = math.pi / (settings.steps - 1)

    @property
    def unambiguous_range(self) -> float:
        """Range at which the phase difference wraps, m, at one beat frequency."""
        return 2 * math.pi / (self._phase_per_range + self._phase_per_speed) * self.range_cell

    def beat(self, distance: Floats, rate: Floats) -> tuple[Floats, Floats]:
        """Return where targets appear in the spectra.

        Args:
            distance: m, (n,).
            rate: of range, m/s, positive away, (n,).

        Returns:
            Beat frequency in cells of 1 / T, in [−N/2, N/2), and phase of B less that of A, rad, in [−π, π); both
            wrapped.
        """
        ranges, speeds = distance / self.range_cell, -rate / self.speed_cell
        phase = self._phase_per_speed * speeds + self._phase_per_range * ranges
        return _wrapped(speeds - ranges, self._steps), _wrapped(phase, 2 * math.pi)

    def target(self, beat: Floats, phase: Floats) -> tuple[Floats, Floats]:
        """Return range (m) and range rate (m/s, positive away) of peaks, the inverse of `beat`.

        A target beyond the unambiguous range, or with a wrapped beat frequency, appears at a wrong range, as
        with a real radar.
        """
        ranges = (phase - self._phase_per_speed * beat) / (self._phase_per_speed + self._phase_per_range)
        interval = self.unambiguous_range / self.range_cell
        first = -_BELOW_ZERO * interval
        ranges = np.mod(ranges - first, interval) + first
        return np.maximum(ranges, 0.0) * self.range_cell, -(beat + ranges) * self.speed_cell


def _wrapped(value: Floats, interval: float) -> Floats:
    """Return values wrapped to half an interval around 0."""
    return np.asarray(np.mod(value + interval / 2, interval) - interval / 2)


@dataclass(frozen=True, slots=True)
class Peaks:
    """The peaks that a receiver resolves in one measurement.

    Attributes:
        strongest: index of each peak's strongest echo (p,).
        distance: m, (p,).
        rate: m/s, positive away, (p,).
        azimuth: rad, left positive, (p,).
    """

    strongest: Indices
    distance: Floats
    rate: Floats
    azimuth: Floats


class LfmFskReceiver:
    """Finds the peaks of a scan's echoes.

    Args:
        settings: of the front end.
    """

    def __init__(self, settings: LfmFskSettings) -> None:
        self._waveform = LfmFsk(settings)
        self._oversampling = settings.oversampling
        self._snr = 10 ** (settings.snr_db / 10)
        self._threshold = 10 ** (settings.threshold_db / 10)

    def receive(self, distance: Floats, rate: Floats, azimuth: Floats, noise: Floats) -> Peaks:
        """Return the peaks, those of the strongest echoes first.

        Echoes less than one cell of beat frequency from a stronger one merge into its peak, weighted by their power,
        which falls with the fourth power of range. The errors of a peak's beat frequency and phase have the variance of
        the Cramér-Rao bound.

        Args:
            distance: of the echoes, m, (n,).
            rate: of range, m/s, positive away, (n,).
            azimuth: as measured, rad, left positive, (n,).
            noise: standard normal numbers (2, n).
        """
        power = self._snr * (_REFERENCE_RANGE / np.maximum(distance, 1e-3)) ** 4
        beat, phase = self._waveform.beat(distance, rate)
        peak, strongest = _unresolved(beat, power)
        snr = np.bincount(peak, power)
        deviation = np.sqrt(1.0 / snr)
        beat = np.bincount(peak, power * beat) / snr + noise[0, strongest] * deviation * math.sqrt(3) / (2 * math.pi)
        beat = np.rint(beat * self._oversampling) / self._oversampling
        phase = _mean_angle(peak, power, phase) + noise[1, strongest] * deviation
        ranges, rates = self._waveform.target(beat, phase)
        seen = snr >= self._threshold
        return Peaks(strongest[seen], ranges[seen], rates[seen], _mean_angle(peak, power, azimuth)[seen])


def _unresolved(beat: Floats, power: Floats) -> tuple[Indices, Indices]:
    """Return the peak that each echo belongs to (n,), and each peak's strongest echo, in order of falling power.

    The strongest echo absorbs those less than one cell away, then the strongest of the rest, and so on: no peak is
    wider than two cells, however closely the echoes are spaced.
    """
    strongest: list[int] = []
    peak: Indices = np.full(len(beat), -1, dtype=np.intp)
    for echo in np.argsort(-power, kind="stable").tolist():
        if peak[echo] < 0:
            peak[(peak < 0) & (np.abs(beat - beat[echo]) < 1.0)] = len(strongest)
            strongest.append(echo)
    return peak, np.array(strongest, dtype=np.intp)


def _mean_angle(peak: Indices, power: Floats, angle: Floats) -> Floats:
    """Return the phase of the sum of each peak's echoes, weighted by power."""
    return np.arctan2(np.bincount(peak, power * np.sin(angle)), np.bincount(peak, power * np.cos(angle)))
