"""Noise of frames that differ in it, as of other exposures that were divided by them.

A smooth fit to all frames (`smooth_fit`) leaves in each of them a known part of its own white noise
and of that of the others:

    e = M v,   M_kj = mean over frequencies of |R_kj|^2,   v >= 0 the variances

e is the energy of small blocks about their mean, of the calm ones, and of these where it is low:
what lies elsewhere shows at slopes, what moved in a part, light in the mean, and noise everywhere.
What is no noise, as of frames that turned, differs more between blocks than noise does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.order import median, quantile
from lensshift.reconstruction.noise_law import MOST_FRAMES, NoiseLaw, windows
from lensshift.reconstruction.smooth_fit import MIDDLE, SmoothFits, refilled, smooth_fits

BLOCK_PX, BORDER_PX = 3, 1
# The calm half of the blocks by slope, of these the quartiles; fewer say nothing.
CALM, LOW, HIGH, FEWEST_BLOCKS = 0.5, 0.25, 0.75, 8
# Of chi-square of 8 degrees of freedom, times root n: standard error of the lower quartile over it,
# and of the logarithm of the upper over the lower one.
LOW_ERROR, SPREAD_ERROR = 0.8, 0.9
# Standard errors between a frame and what all share: frames of equal noise reached 2.9 in 61 random
# bursts of eight kinds, others 4.9 at least.
SURE = 4.0
# Where one surely differs, others likely do.
LIKELY = 2.0
# How much the logarithm of their variances differs: the noise twofold.
USUAL_LOG = 2 * math.log(2.0)
TINY = 1e-30
ROUNDED = 1e-12  # energy that single precision leaves of frames of 1
WINDOWS = 6  # of white noise: a few thousand blocks


@dataclass(frozen=True, slots=True, eq=False)
class _Calm:
    """Of the calm blocks of each frame: quartiles of energy, number, mean light, all [frame]."""

    energy: Floats
    high: Floats
    count: Floats
    light: Floats


def with_frames(
    law: NoiseLaw, offset_px: Array, y: Array, weight: Array, blur_px: float
) -> NoiseLaw:
    """Return the law with what each frame has of its noise, if they surely differ in it.

    Parameters
    ----------
    law : of all frames, as from `noise_law`
    offset_px, y, weight, blur_px : as for `noise_law`; frames without any weight are allowed
    """
    used = weight > 0
    seen = np.flatnonzero(np.any(used, axis=(1, 2)))
    variance, light, sure = np.full(len(y), np.nan), [], False
    for some in np.array_split(seen, -(-len(seen) // MOST_FRAMES)):
        found = _variances(offset_px[some], y[some], used[some], blur_px)
        if found is None:
            return law
        variance[some], of_some, differs = found
        light.append(of_some)
        sure |= differs
    if not sure:
        return law
    # Where a weight tells of more noise that is not to count twice.
    variance[seen] *= [np.median(one[on]) for one, on in zip(weight[seen], used[seen], strict=True)]
    variance = np.where(np.isnan(variance), np.nanmean(variance), variance)
    return law.of_other_frames(variance, float(np.mean(light)))


def _variances(
    offset_px: Array, y: Array, used: Mask, blur_px: float
) -> tuple[Floats, float, bool] | None:
    """Return variances [frame] and the light in calm places, and whether a frame surely differs."""
    seen, used = windows(y), windows(used)
    parts = [seen.real, seen.imag] if y.dtype.kind == "c" else [seen]
    if not used.any() or min(seen.shape[-2:]) < 2 * BORDER_PX + BLOCK_PX:
        return None
    values = np.stack([np.where(used, part - median(part[used]), 0.0) for part in parts])
    unit = float(np.sqrt(np.sum(values**2) / np.count_nonzero(used))) or 1.0
    values = (values / unit).astype(np.float32)
    offset = np.round(offset_px - offset_px[0], 6)  # what rounding adds is no new case
    geometry = offset.tobytes(), len(y), used.shape[-2:], round(float(blur_px), 3)
    fits = smooth_fits(*geometry)
    if not used.all():  # else the fit rings beside each gap
        left = (fits.residuals(one, MIDDLE)[0] for one in values)
        values = np.stack([refilled(fits, *both, ~used) for both in zip(values, left, strict=True)])
    lit = np.abs(seen) if len(parts) == 2 else seen
    calm = _calm(fits, values, used, lit)
    if calm is None:
        return None
    white, spread, leak = _white(*geometry, len(parts))
    energy, error = calm.energy / white, 1.0 / np.sqrt(len(parts) * calm.count)
    unlike = np.log(np.maximum(calm.high, TINY) / np.maximum(calm.energy * spread, TINY))
    if np.any(unlike > SURE * SPREAD_ERROR * error) or energy.min() < ROUNDED:
        return None
    variance, differs = _unmixed(energy, leak, LOW_ERROR * error)
    return variance * unit**2, float(calm.light.mean()), differs


def _unmixed(energy: Floats, leak: Floats, error: Floats) -> tuple[Floats, bool]:
    """Return v of e = M v, and whether frames differ: as many have one v as the errors allow."""
    own: list[int] = []
    log_v = np.full(len(energy), float(np.average(np.log(energy), weights=error**-2)))
    while True:
        apart = np.abs(np.log(leak @ np.exp(log_v) / energy)) / error
        apart[own] = 0.0
        if len(own) + 1 == len(energy) or apart.max() <= (LIKELY if own else SURE):
            return np.exp(log_v), bool(own)
        own.append(int(np.argmax(apart)))
        log_v = _likeliest(energy, leak, error, own, log_v)


def _likeliest(
    energy: Floats, leak: Floats, error: Floats, own: list[int], log_v: Floats
) -> Floats:
    """Return the likeliest log v of some frames with one of their own and of the others together.

    What a quiet frame has is lost beside what reaches it from the others: it is as usual, then.
    """
    from scipy.optimize import least_squares  # few bursts come here

    def spread_out(p: Floats) -> Floats:
        every = np.full(len(energy), p[0])
        every[own] = p[1:]
        return every

    def residuals(p: Floats) -> Floats:
        off = np.log(leak @ np.exp(spread_out(p)) / energy) / error
        return np.append(off, (p[1:] - p[0]) / USUAL_LOG)

    start = np.append(np.median(log_v), np.log(energy[own]))
    return spread_out(least_squares(residuals, start).x)


@lru_cache(maxsize=16)
def _white(
    offset_bytes: bytes, count: int, shape: tuple[int, int], blur_px: float, parts: int
) -> tuple[Floats, Floats, Floats]:
    """Return energy and spread [frame] of white noise, and where it comes from [frame frame]."""
    fits = smooth_fits(offset_bytes, count, shape, blur_px)
    noise = np.random.default_rng(0).standard_normal((parts, WINDOWS, count, *shape), np.float32)
    found = _calm(fits, noise, np.ones(noise.shape[1:], np.bool_), noise[0])
    leak = np.mean(np.abs(fits.response[MIDDLE][0]) ** 2, axis=(2, 3))
    if found is None:  # nor will frames tell anything
        return np.ones(count), np.ones(count), leak
    return found.energy, found.high / found.energy, leak / leak.sum(axis=1, keepdims=True)


def _calm(fits: SmoothFits, values: Array, used: Mask, lit: Array) -> _Calm | None:
    """Return what calm blocks of each frame hold, None if there are few.

    Parameters
    ----------
    values : [component window frame row col]
    used, lit : [window frame row col]
    """
    whole = values.reshape(-1, *values.shape[2:])
    rest = fits.residuals(whole, MIDDLE)[0]
    down, right = np.gradient(whole - rest, axis=(-2, -1))
    shape = len(used[0]), len(values), -1
    energy = _blocks(rest).var(axis=-1).reshape(shape).mean(axis=1)
    contrast = _blocks(down**2 + right**2).mean(axis=-1).reshape(shape).mean(axis=1)
    light, full = _blocks(lit).mean(axis=-1), np.asarray(_blocks(used).all(axis=-1))
    found = []
    for e, c, i, on in zip(energy, contrast, light, full, strict=True):
        if np.count_nonzero(on) * CALM < FEWEST_BLOCKS:
            return None
        calm = on & (c <= quantile(np.sort(c[on]), CALM))
        ordered = np.sort(e[calm])
        low, high = quantile(ordered, LOW), quantile(ordered, HIGH)
        found.append((low, high, len(ordered), i[calm].mean()))
    return _Calm(*np.array(found).T)


def _blocks(values: Array) -> Array:
    """Return [frame block pixel] of the inner pixels [window frame row col]."""
    inner = values[..., BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
    tall, wide = (n // BLOCK_PX for n in inner.shape[-2:])
    inner = inner[..., : tall * BLOCK_PX, : wide * BLOCK_PX]
    blocks = inner.reshape(*inner.shape[:-2], tall, BLOCK_PX, wide, BLOCK_PX).swapaxes(-3, -2)
    return np.asarray(blocks.swapaxes(0, 1).reshape(inner.shape[1], -1, BLOCK_PX**2))
