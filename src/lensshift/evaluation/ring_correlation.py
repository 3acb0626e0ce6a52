"""Fourier ring correlation: up to which frequency two independent images agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.evaluation.inputs import check_finite, real_array
from lensshift.evaluation.limits import first_fall, pitch_pair_mm

Pitch = float | tuple[float, float]  # one or (row, col)

FIXED_THRESHOLD = 1 / 7
_MIN_SIDE_PX = 8
# With fewer samples the correlation of pure noise scatters by more than the fixed threshold.
_MIN_SAMPLES = 1 / FIXED_THRESHOLD**2
_SURE = 3.0  # deviations of the correlation of noise
_MATCH = 6.0  # deviations of the correlation at all places; of noise, none of 1e6 exceeds 5.2
_BETTER = 0.05  # of it: where a broad match lies is not told to a pixel
_SAME = 1.0 - 1e-9  # rounding alone


@dataclass(frozen=True, slots=True, eq=False)
class RingCorrelation:
    """Correlation of two images, ring by ring in frequency.

    Parameters
    ----------
    frequency_lpmm : [ring] mean frequency of the ring
    correlation : [ring] from -1 to 1
    samples : [ring] Fourier samples, less what the window correlates; the correlation of pure noise
        has a standard deviation of 1 / sqrt(samples)
    half_bit : [ring] threshold for half a bit of information per sample
    cutoff_lpmm : first crossing of the half-bit threshold
    fixed_cutoff_lpmm : first crossing of 1/7

    Cut-offs are 0 if the first ring is already below, None if no ring is. A scene without coarse
    structure, as the spokes of a star alone, has nothing to correlate in the first ring.
    """

    frequency_lpmm: Floats
    correlation: Floats
    samples: Floats
    half_bit: Floats
    cutoff_lpmm: float | None
    fixed_cutoff_lpmm: float | None


def fourier_ring_correlation(
    first: ArrayLike,
    second: ArrayLike,
    *,
    pitch_mm: Pitch,
    window: bool = True,
) -> RingCorrelation:
    """Correlate two images of one scene with independent noise.

        FRC(r) = Re sum F1 F2* / sqrt( sum |F1|^2 sum |F2|^2 ),   sums over ring r
        half bit: T(r) = (0.2071 + 1.9102 / sqrt n) / (1.2071 + 0.9102 / sqrt n)

    For signal and white noise of power S and N in each image FRC = S / (S + N). Rings are as wide
    as one Fourier sample along the shorter side and end at the smaller Nyquist frequency. What
    both images share counts as signal: two results of one prior, or of frames they have in common,
    agree in what the prior invented. One image twice would agree in its own noise.

    Parameters
    ----------
    first, second : [row col], finite, of one shape and at least 8 pixels on each side
    pitch_mm : pixel spacing, one or (row, col)
    window : whether to lay a Hann window, against the jump from border to border

    Raises
    ------
    ValueError
        If an argument is out of range, an image has no contrast, or both are the same one.

    Warns
    -----
    QualityWarning
        If the median ring has too few samples to tell 1/7 from noise, the first ring does not agree
        although finer ones do, or the images lie a pixel or more apart.

    Source: van Heel and Schatz, J. Struct. Biol. 151 (2005) 250; Banterle et al., J. Struct. Biol.
    183 (2013) 363.
    """
    images = [_image(first, "first"), _image(second, "second")]
    shape, other = (image.shape for image in images)
    if shape != other:
        raise ValueError(f"expected two images of one shape, got {shape} and {other}")
    # Zero half a pixel outside the image, so that no pixel is thrown away.
    hann = [np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2 for n in shape]
    weight = np.outer(*hann) if window else np.ones(shape)
    spectra = [_spectrum(image, weight) for image in images]
    radius_lpmm, ring = _rings(shape, pitch_mm)
    inside = ring > 0
    index = ring[inside] - 1

    def ring_sums(values: Floats) -> Floats:
        return np.bincount(index, weights=values[inside]).astype(np.float64)

    count = ring_sums(np.ones(shape))
    cross = ring_sums(np.real(spectra[0] * np.conj(spectra[1])))
    power = [ring_sums(np.abs(spectrum) ** 2) for spectrum in spectra]
    norm = np.sqrt(power[0] * power[1])
    correlation = np.divide(cross, norm, out=np.zeros_like(cross), where=norm > 0)
    if np.min(np.abs(correlation)) > _SAME:
        raise ValueError(
            "expected two images with noise of their own, got one image twice (or its multiple), "
            "which correlates with its own noise; take two captures, or frames apart"
        )
    _warn_if_apart(spectra[0] * np.conj(spectra[1]), weight)
    samples = count**2 / ring_sums(_neighbours(ring, weight))
    root = np.sqrt(samples)
    half_bit = (0.2071 + 1.9102 / root) / (1.2071 + 0.9102 / root)
    frequency_lpmm = ring_sums(radius_lpmm) / count
    _warn_of_samples(samples, correlation - half_bit)
    cutoffs_lpmm = (
        _first_crossing_lpmm(frequency_lpmm, correlation - least)
        for least in (half_bit, FIXED_THRESHOLD)
    )
    return RingCorrelation(frequency_lpmm, correlation, samples, half_bit, *cutoffs_lpmm)


def _warn_if_apart(cross: NDArray[np.complex128], weight: Floats) -> None:
    """Warn if the images match better elsewhere, and match at all."""
    match = np.fft.ifft2(cross).real
    # Windowed noise matches by chance where the windows lie on one another.
    chance = np.fft.ifft2(np.abs(np.fft.fft2(weight**2)) ** 2).real
    match /= np.sqrt(np.maximum(chance, 0.05 * chance[0, 0]))
    place = np.unravel_index(int(np.argmax(match)), match.shape)
    best = float(match[place])
    if best > _MATCH * float(np.std(match)) and best - match[0, 0] > _BETTER * best:
        row, col = (int((k + n // 2) % n - n // 2) for k, n in zip(place, match.shape, strict=True))
        warn_quality(
            f"the images lie {-row} rows and {-col} columns apart, which counts as disagreement: "
            "shift one of them back",
            stacklevel=3,
        )


def _spectrum(image: Floats, weight: Floats) -> NDArray[np.complex128]:
    # The weighted mean, or the window would spread what is left of it over the first ring.
    centred = image - np.average(image, weights=weight)
    if np.abs(centred).max() <= 1e-12 * np.abs(image).max():
        raise ValueError(f"expected images with contrast, got a constant {image.flat[0]:.6g}")
    return np.fft.fft2(centred * weight)


def _rings(shape: tuple[int, ...], pitch_mm: Pitch) -> tuple[Floats, NDArray[np.int64]]:
    """Return frequency and ring (from 1; 0 for none) of each Fourier sample [row col]."""
    pitches = np.array(pitch_pair_mm(pitch_mm))
    row_lpmm, col_lpmm = (np.fft.fftfreq(n, p) for n, p in zip(shape, pitches, strict=True))
    radius_lpmm = np.hypot(row_lpmm[:, None], col_lpmm)
    width_lpmm = float(np.max(1 / (np.array(shape) * pitches)))
    nyquist_lpmm = 1 / (2 * pitches.max())
    last = int(nyquist_lpmm / width_lpmm * (1 + 1e-9))
    ring = np.rint(radius_lpmm / width_lpmm).astype(np.int64)
    ring[ring > last] = 0
    return radius_lpmm, ring


def _neighbours(ring: NDArray[np.int64], weight: Floats) -> Floats:
    """Return how many samples of its own ring each sample is worth, itself included [row col].

    A window w correlates Fourier samples d apart by c(d) = FFT(w^2)(d) / sum w^2; the variance of a
    sum over a ring grows by the sum of |c|^2.
    """
    squares = np.fft.fft2(weight**2)
    kernel = np.abs(squares / squares[0, 0]) ** 2
    worth = np.zeros(ring.shape)
    for shift in np.argwhere(kernel > 1e-6):  # 25 for a Hann window
        worth += kernel[tuple(shift)] * (np.roll(ring, shift, (0, 1)) == ring)
    return worth


def _warn_of_samples(samples: Floats, excess: Floats) -> None:
    """Warn if they are few, or if the coarsest ring does not agree though most rings do."""
    median = float(np.median(samples))
    if median < _MIN_SAMPLES:
        warn_quality(
            f"the median of {samples.size} rings has {median:.0f} independent samples: the "
            f"correlation of noise scatters by {1 / np.sqrt(median):.2f}; average over several "
            "pairs or take a larger image",
            stacklevel=3,
        )

    agreeing = int(np.count_nonzero(excess * np.sqrt(samples) > _SURE))
    if excess[0] < 0 and 2 * agreeing > excess.size:
        warn_quality(
            f"the coarsest ring does not agree although {agreeing} of {excess.size} do: the scene "
            "has no coarse structure, and a cut-off of 0 says nothing of the resolution",
            stacklevel=3,
        )


def _first_crossing_lpmm(frequency_lpmm: Floats, excess: Floats) -> float | None:
    """Return where the excess over a threshold first falls below 0."""
    if excess[0] < 0:
        return 0.0
    found = first_fall(frequency_lpmm, excess)
    return None if np.isnan(found) else found


def _image(image: ArrayLike, name: str) -> Floats:
    values = real_array(image, f"{name} image")
    if min(values.shape) < _MIN_SIDE_PX:
        raise ValueError(
            f"expected the {name} image as [row col] of at least {_MIN_SIDE_PX} pixels a side, "
            f"got shape {values.shape}"
        )
    check_finite(values, f" in the {name} image")
    return values
