"""Compiled loops that find the weights of IRW-SR, in single precision."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[Any]

# The histogram has so many bins to a factor of two, and goes from 2^-20 to 2^4.
_BINS_PER_OCTAVE, _OCTAVES, _LOWEST = 32, 24, -20
_BINS = _BINS_PER_OCTAVE * _OCTAVES
# The bits of a single: sign, exponent + 127, mantissa. What is left of them is a bin.
_SHIFT = 18
_FIRST = (_LOWEST + 127) * _BINS_PER_OCTAVE
_WITHOUT_SIGN = 0x7FFFFFFF
# Of more values than this, evenly spread ones are taken: good to 2 % of the scale.
_ENOUGH = 1 << 13
_TINY = np.float32(1e-12)
_TUNING = np.float32(2.0)
_MAD_TO_SIGMA = 1.4826


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _edge(b: int) -> float:
    """Return the lower edge of bin b of the magnitudes."""
    octave, part = b // _BINS_PER_OCTAVE, b % _BINS_PER_OCTAVE
    return float(2.0 ** (octave + _LOWEST) * (1.0 + part / _BINS_PER_OCTAVE))


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _histogram(values: Array, weights: Array, centre: float) -> Array:
    """Return the weight of the v - centre in each bin: the negative ones, then the positive."""
    histogram = np.zeros(2 * _BINS)
    step = max(1, values.size // _ENOUGH) | 1
    middle = np.float32(centre)
    block, scale = np.empty(256, np.float32), np.empty(256, np.float32)
    bits = block.view(np.int32)
    span = 256 * step
    for start in range(0, values.size, span):
        count = min(256, (values.size - start + step - 1) // step)
        for n in range(count):
            block[n] = values[start + n * step] - middle
            scale[n] = weights[start + n * step]
        for n in range(count):
            size = ((bits[n] & _WITHOUT_SIGN) >> _SHIFT) - _FIRST
            size = min(max(size, 0), _BINS - 1)
            histogram[_BINS + size if bits[n] >= 0 else _BINS - 1 - size] += scale[n]
    return histogram


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _middle_of(histogram: Array, half: float) -> float:
    """Return below what lies `half` of the weight; the bins are signed, or of magnitudes."""
    reached, b = 0.0, 0
    while b < len(histogram) - 1 and reached + histogram[b] < half:
        reached += histogram[b]
        b += 1
    share = (half - reached) / histogram[b] if histogram[b] > 0 else 0.0
    b -= len(histogram) - _BINS  # now of the magnitude, and below 0 if the value is
    if b in (0, -1):  # what is smaller than the smallest bin counts as 0
        return 0.0
    low, high = (_edge(b), _edge(b + 1)) if b > 0 else (-_edge(-b), -_edge(-1 - b))
    return float(low + share * (high - low))


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def _below(cumulative: Array, value: float) -> float:
    """Return the weight below a value; `cumulative` begins with 0 before the first bin."""
    size = max(abs(value), 2.0**_LOWEST)
    octave = np.floor(np.log2(size))
    place = _BINS_PER_OCTAVE * (octave - _LOWEST + size / 2.0**octave - 1.0)
    place = _BINS + place if value >= 0 else _BINS - place
    b = min(max(int(place), 0), 2 * _BINS - 1)
    return float(cumulative[b] + min(place - b, 1.0) * (cumulative[b + 1] - cumulative[b]))


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def weighted_median(values: Array, weights: Array) -> float:
    """Return the weighted median of single-precision values; 0 if there is no weight.

    By a histogram whose bins are 1/32 octave wide, with the weight of a bin spread evenly over
    it: the error is some 1e-3 of the result, whatever its scale.
    """
    histogram = _histogram(values, weights, 0.0)
    half = 0.5 * histogram.sum()
    return _middle_of(histogram, half) if half > 0.0 else 0.0


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def weighted_mad(values: Array, weights: Array) -> float:
    """Return the weighted median of |v - m|, m the weighted median; 0 if there is no weight.

    As `weighted_median`, and from the same histogram where m is small beside the result: its
    bins are finest around 0.
    """
    histogram = _histogram(values, weights, 0.0)
    half = 0.5 * histogram.sum()
    if half <= 0.0:
        return 0.0
    centre = _middle_of(histogram, half)
    cumulative = np.zeros(2 * _BINS + 1)
    for b in range(2 * _BINS):
        cumulative[b + 1] = cumulative[b] + histogram[b]
    low, high = max(4.0 * abs(centre), 2.0**_LOWEST), 2.0 ** (_LOWEST + _OCTAVES)
    least = _below(cumulative, centre + low) - _below(cumulative, centre - low)
    if least >= half:
        folded = _histogram(values, weights, centre)
        return _middle_of(folded[_BINS:] + folded[:_BINS][::-1], half)
    most = 2.0 * half
    while high > 1.01 * low:
        between = np.sqrt(low * high)
        held = _below(cumulative, centre + between) - _below(cumulative, centre - between)
        if held < half:
            low, least = between, held
        else:
            high, most = between, held
    return float(low + (half - least) / (most - least) * (high - low))


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def observation_weights(
    residual: Array, static: Array, confidence: Array, bias_threshold: float
) -> float:
    """Update the confidence [frame pixel] of the LR pixels in place and return their noise.

        sigma = 1.4826 MAD(r),   beta = [|median r_k| < bias] min(1, 2 sigma / |r|)

    Parameters
    ----------
    residual, static : [frame pixel]; static is the weight that the caller gives
    confidence : [frame pixel] of the step before; static * beta afterwards
    """
    frames, pixels = residual.shape
    believed = np.empty(frames, np.float32)
    for k in range(frames):
        bias = weighted_median(residual[k], static[k])
        believed[k] = 1.0 if abs(bias) < bias_threshold else 0.0
        if believed[k] == 0:
            for n in range(pixels):
                confidence[k, n] = 0
    flat, trust = residual.ravel(), confidence.ravel()
    sigma = max(_MAD_TO_SIGMA * weighted_mad(flat, trust), 1e-7)
    limit = _TUNING * np.float32(sigma)
    for k in range(frames):
        r, given, out, frame = residual[k], static[k], confidence[k], believed[k]
        for n in range(pixels):
            out[n] = frame * given[n] * min(np.float32(1.0), limit / max(abs(r[n]), _TINY))
    return sigma


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def median_3x3(image: Array, factor: Array, out: Array) -> None:
    """Write factor times the 3 x 3 median of an image into out, zeros outside.

    Each column of three is sorted; the median of the nine is the median of the greatest of the
    low ones, the median of the middle ones and the least of the high ones. No branches, so that
    the loops vectorise. Source: Paeth, in Graphics Gems, 1990.
    """
    rows, cols = image.shape
    low, middle, high = (
        np.zeros(cols + 2, image.dtype), np.zeros(cols + 2, image.dtype),
        np.zeros(cols + 2, image.dtype),
    )  # fmt: skip
    zero = np.zeros(cols, image.dtype)
    for i in range(rows):
        above = image[i - 1] if i > 0 else zero
        here = image[i]
        below = image[i + 1] if i + 1 < rows else zero
        lows, middles, highs = low[1 : cols + 1], middle[1 : cols + 1], high[1 : cols + 1]
        for j in range(cols):
            p, q, r = above[j], here[j], below[j]
            less, more = min(p, q), max(p, q)
            lows[j] = min(less, r)
            highs[j] = max(more, r)
            middles[j] = max(less, min(more, r))
        target = out[i]
        low_left, low_right = low[:cols], low[2:]
        mid_left, mid_right = middle[:cols], middle[2:]
        high_left, high_right = high[:cols], high[2:]
        for j in range(cols):
            a = max(low_left[j], max(lows[j], low_right[j]))
            c = min(high_left[j], min(highs[j], high_right[j]))
            less, more = min(mid_left[j], middles[j]), max(mid_left[j], middles[j])
            b = max(less, min(more, mid_right[j]))
            less, more = min(a, b), max(a, b)
            target[j] = factor * max(less, min(more, c))


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def prior_weights(
    steps: Array, share: Array, exponent: float, filtered: Array, beta: Array
) -> float:
    """Update the weights of the differences in place and return their scale s.

        beta = (1 + |z| / s)^(p - 1),   z = share_d median3x3(D_d x),   s = MAD(z)

    the derivative of the concave penalty s ((1 + |z| / s)^p - 1) / p. The published weight is 1
    up to 2 s, where it jumps to p and falls from there, p (|z| / 2 s)^(p - 1).

    Parameters
    ----------
    steps : [direction row col] differences
    share : [direction] alpha^(|l| + |m|)
    exponent : p
    filtered : [direction row col] work space
    beta : [direction row col] weights of the step before; the new ones afterwards

    Source: Koehler et al. 2016.
    """
    for d in range(len(steps)):
        median_3x3(steps[d], share[d], filtered[d])
    z, weight = filtered.ravel(), beta.ravel()
    scale = max(weighted_mad(z, weight), 1e-9)
    unit, power = np.float32(1.0 / scale), np.float32(exponent - 1.0)
    one = np.float32(1.0)
    if exponent == 0.5:
        for n in range(z.size):
            weight[n] = one / np.sqrt(one + unit * abs(z[n]))
    else:
        for n in range(z.size):
            weight[n] = (one + unit * abs(z[n])) ** power
    return scale


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def touching_quadratic(
    steps: Array, beta: Array, factor: Array, smoothing: float, a: Array
) -> None:
    """Write a_d = factor_d beta_d / sqrt(e_d^2 + mu) into a [direction row col].

    2 sqrt(e^2 + mu) <= 2 sqrt(e0^2 + mu) + (e^2 - e0^2) / sqrt(e0^2 + mu)
    """
    mu = np.float32(smoothing)
    for d in range(len(steps)):
        scale = factor[d]
        for i in range(steps.shape[1]):
            e, weight, out = steps[d, i], beta[d, i], a[d, i]
            for j in range(e.size):
                out[j] = scale * weight[j] / np.sqrt(e[j] * e[j] + mu)


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def penalty(steps: Array, beta: Array, factor: Array, smoothing: float) -> float:
    """Return 2 sum_d factor_d beta_d (sqrt(e_d^2 + mu) - sqrt(mu)), 0 if flat."""
    mu, floor = np.float32(smoothing), np.float32(np.sqrt(smoothing))
    total = 0.0
    for d in range(len(steps)):
        for i in range(steps.shape[1]):
            e, weight, line = steps[d, i], beta[d, i], np.float32(0.0)
            for j in range(e.size):
                line += weight[j] * (np.sqrt(e[j] * e[j] + mu) - floor)
            total += 2.0 * factor[d] * line
    return total


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def misfit(residual: Array, confidence: Array) -> float:
    """Return sum w r^2 over [frame pixel]."""
    total = 0.0
    for k in range(len(residual)):
        r, w = residual[k], confidence[k]
        for start in range(0, r.size, 4096):
            part = np.float32(0.0)
            for n in range(start, min(start + 4096, r.size)):
                part += w[n] * r[n] * r[n]
            total += float(part)
    return total


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def objective(
    residual: Array, confidence: Array, steps: Array, beta: Array, factor: Array, smoothing: float
) -> float:
    """Return misfit plus penalty."""
    return float(misfit(residual, confidence) + penalty(steps, beta, factor, smoothing))


@njit(cache=True, fastmath=True, nogil=True, error_model="numpy")
def largest_change(before: Array, after: Array) -> float:
    """Return the largest |after - before| of two images [row col]."""
    largest = np.float32(0.0)
    for i in range(len(before)):
        old, new = before[i], after[i]
        for j in range(old.size):
            largest = max(largest, abs(new[j] - old[j]))
    return float(largest)
