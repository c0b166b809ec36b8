# SPDX-License-Identifier: Apache-2.0
"""Whitening: what sensor noise alone leaves in the residuals, and the causal filter that removes its colour.

Noise enters a residual three times: in its own channel, through the observer, and through smoothed
neighbours. Replaying a recording with fresh noise added shows its spectrum; the minimum-phase inverse
of that spectrum turns noise-only residuals into unit white noise. The filter must be causal: in a
closed loop later inputs depend on earlier noise, and a two-sided filter would correlate the two.
"""

from collections.abc import Mapping

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal import welch

from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.systems.system import System, Values

DRAWS = 5
NEIGHBOURS = 5  # frequencies that are averaged above the lowest ones
TAPS = 1024
SEGMENT = 2048
COARSE = 0.5  # of the step between readings: noise that does not cross it; that of rounding alone is 0.29


class Whitener:
    """Causal whitening filters of one run, one a channel."""

    def __init__(self, filters: Mapping[str, np.ndarray]):
        self._filters = filters
        self._responses: dict[tuple[str, int], np.ndarray] = {}

    def __call__(self, channel: str, columns: np.ndarray) -> np.ndarray:
        """Filter columns (n, ...) along time."""
        taps = self._filters[channel]
        n = len(columns)
        size = next_fast_len(n + len(taps), real=True)
        if (channel, size) not in self._responses:
            self._responses[channel, size] = rfft(taps, size)
        response = self._responses[channel, size]
        if columns.ndim == 1:
            white: np.ndarray = irfft(rfft(columns, size) * response, size)[:n]
            return white
        # transforms along rows are several times faster than along columns
        rows = np.ascontiguousarray(columns.T)
        spectrum = rfft(rows, size)
        spectrum *= response  # in place: these are large
        turned: np.ndarray = irfft(spectrum, size, overwrite_x=True)[:, :n].T
        return turned


def noise_levels(residuals: Mapping[str, list[np.ndarray]], periods: list[float]) -> dict[str, float]:
    """Return each channel's noise (sd) from the upper half of the band, where models err least.

    `residuals` maps a channel to its residuals in each run.
    """
    return {
        channel: float(np.sqrt(np.median([_upper_power(r, h) for r, h in zip(runs, periods, strict=True)])))
        for channel, runs in residuals.items()
    }


def _upper_power(residual: np.ndarray, period: float) -> float:
    """Return the variance of white noise with the power density of the upper half of the band."""
    _, density = welch(residual, fs=1.0, nperseg=min(SEGMENT, len(residual)))
    upper = density[len(density) // 2 : -1]
    return 0.5 * float(np.mean(upper))


def noise_whitener(
    replay: Replay, run: Run, noise: Values, cutoff: float, warm_up: int, seed: int
) -> tuple[Whitener, dict[str, float]]:
    """Return the whitener of one run and each channel's rms of noise alone, from replays with noise added.

    The model has no effects.

    Args:
        noise: channel or input -> standard deviation.
        warm_up: samples at the start to leave out.
    """
    rng, values = np.random.default_rng(seed), replay.defaults(())
    spectra: dict[str, list[np.ndarray]] = {}
    for _ in range(DRAWS):
        noisy = Run(replay.system, run.recording, cutoff, drawn(rng, replay.system, run, noise))
        for equation in replay.system.equations:
            change = replay.residuals(noisy, equation, (), values)
            change = change - replay.residuals(run, equation, (), values)
            for i, channel in enumerate(equation.channels):
                spectra.setdefault(channel, []).append(_density(change[warm_up:, i]))
        replay.forget(noisy)
    mean = {channel: np.mean(many, axis=0) for channel, many in spectra.items()}
    floor = {
        channel: float(np.sqrt(np.sum(density) * 0.5 / (len(density) - 1)))
        for channel, density in mean.items()
    }
    return Whitener({channel: minimum_phase(_smooth(density)) for channel, density in mean.items()}), floor


def drawn(rng: np.random.Generator, system: System, run: Run, noise: Values) -> dict[str, np.ndarray]:
    """Return samples of noise, channel or input -> (n,), of given standard deviations.

    That of an input that is read in coarse steps stays as long as the reading: rounding is no white noise
    while an input rests.
    """
    samples = {key: sd * rng.standard_normal(run.recording.samples) for key, sd in noise.items()}
    for name in {*stated(system)} & {*samples} & {*run.recording.signals}:
        read = run.recording.signals[name]
        if noise[name] < COARSE * step_of(read):
            changes = np.diff(read, prepend=np.nan) != 0
            samples[name] = samples[name][changes][np.cumsum(changes) - 1]
    return samples


def step_of(read: np.ndarray) -> float:
    """Return the step between readings; 0 if these are all alike."""
    levels = np.unique(read)
    return float(np.diff(levels).min()) if len(levels) > 1 else 0.0


def stated(system: System) -> dict[str, float]:
    """Return the noise (sd) of the inputs of which a user says that they have some."""
    return {name: sd for name, sd in system.input_noise.items() if sd}


def _density(values: np.ndarray) -> np.ndarray:
    density: np.ndarray = welch(values, fs=1.0, nperseg=min(SEGMENT, len(values)), detrend=False)[1]
    return density


def _smooth(density: np.ndarray) -> np.ndarray:
    """Return the density averaged over neighbouring frequencies, the lowest ones (colour) left alone."""
    mean = np.convolve(density, np.ones(NEIGHBOURS) / NEIGHBOURS, "same")
    kept = slice(2 * NEIGHBOURS, -NEIGHBOURS)
    out: np.ndarray = density.copy()
    out[kept] = mean[kept]
    return out


def minimum_phase(density: np.ndarray) -> np.ndarray:
    """Return the causal filter whose squared gain is the inverse of a one-sided density (per sample).

    Kolmogorov's factorisation: the causal half of the cepstrum (Oppenheim & Schafer).
    """
    size = 4 * TAPS
    grid = np.linspace(0.0, 0.5, size // 2 + 1)
    known = np.linspace(0.0, 0.5, len(density))
    two_sided = 0.5 * density.copy()
    two_sided[0], two_sided[-1] = two_sided[1], two_sided[-2]
    log_gain = -0.5 * np.interp(grid, known, np.log(np.maximum(two_sided, 1e-300)))
    cepstrum = irfft(log_gain, size)
    cepstrum[1 : size // 2] *= 2.0
    cepstrum[size // 2 + 1 :] = 0.0
    taps: np.ndarray = irfft(np.exp(rfft(cepstrum)), size)[:TAPS]
    return taps
