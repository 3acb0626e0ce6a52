"""Gain and bias of each frame against the burst as a whole."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.defects import unequal_brightness
from lensshift.core.errors import QualityWarning
from lensshift.core.types import Estimate, Frame
from lensshift.forward.least_squares import smooth_fit
from lensshift.forward.operator import LinearOperator
from lensshift.reconstruction.method import Request
from lensshift.reconstruction.misfit import ESTIMATED
from lensshift.reconstruction.noise import robust_scale
from lensshift.reconstruction.quantiles import ENOUGH, weighted_median

HUBER_SIGMAS = 1.345
# Rounds end when no gain changes by more than this share, far below what it is off by in the end:
# 0.3 % on boxes and photographs of SNR 100. Each halves what is left, whatever it began with.
SETTLED, MOST_ROUNDS = 1e-3, 16
# Of the light of a frame, if another light is to explain what changed.
LIT = 0.9


def estimate_photometry(A: LinearOperator, y: Array, weight: Array) -> tuple[Floats, Floats]:
    """Estimate gain and bias [frame] such that y_k = gain_k (A x)_k + bias_k.

    A smooth x is fitted to the corrected frames and each frame is regressed on its prediction
    (Huber weights), in turn. Only ratios and differences between frames can be seen, so the
    geometric mean of the gains is held at 1 and the mean of the biases at 0.

    Parameters
    ----------
    A : HR image [row col] to frames [frame row col], gain 1
    y, weight : [frame row col]

    Raises
    ------
    ValueError
        If the frames are complex.
    """
    if y.dtype.kind == "c":
        raise ValueError("photometric estimation expects real frames, got complex phasors")
    count = len(y)
    gain, bias = np.ones(count), np.zeros(count)
    for _ in range(MOST_ROUNDS):
        before = gain.copy()
        corrected = (y - bias[:, None, None]) / gain[:, None, None]
        seen = A.forward(smooth_fit(A, corrected, weight, 0.03, 20))
        for k in range(count):
            used = weight[k] > 0
            if np.count_nonzero(used) >= 3:
                gain[k], bias[k] = _regress(seen[k][used], y[k][used])
        gain = np.maximum(gain, 1e-3)
        gain /= np.exp(np.mean(np.log(gain)))
        bias -= bias.mean()
        if np.max(np.abs(gain / before - 1.0)) < SETTLED:
            break
    return gain, bias


def light_since(frame: Frame, before: Frame) -> float:
    """Return how many times as bright a frame is as another one of the same place; 1 if not surely.

        g = median y / y',   1 unless nine tenths of the light are nearer to g times than to once

    Weighted by |y'| and at most its median, y' the brighter one (else 1 / g); of phasors both
    components have one. What is no more than noise, or in a part of the frame, as what moved, is no
    other light, and less than half a frame says nothing.
    """
    some = slice(None, None, max(1, frame.valid.size // ENOUGH) | 1)
    masks = (frame.valid.ravel()[some], before.valid.ravel()[some])
    used = masks[0] & masks[1]
    now, then = (one.amplitude.ravel()[some][used] for one in (frame, before))
    darker = float(np.sum(np.abs(now))) < float(np.sum(np.abs(then)))
    dark, bright = (now, then) if darker else (then, now)
    seen = bright != 0
    if not seen.any() or 2 * np.sum(used) < max(np.sum(mask) for mask in masks):
        return 1.0
    size, ratio = np.abs(bright[seen]), dark[seen] / bright[seen]
    weight = np.minimum(size, np.median(size))
    # Beyond 2 is noise of dark pixels, which the halvings of a median need not count to.
    parts = (np.clip(part, -2, 2) for part in (ratio.real, ratio.imag))
    mean = complex(*(weighted_median(part, weight) for part in parts))
    gain = abs(mean)
    if not 0 < gain < 1:
        return 1.0
    nearer = (ratio * mean.conjugate()).real / gain < (1 + gain) / 2
    if np.sum(weight[nearer]) < LIT * np.sum(weight):
        return 1.0
    return gain if darker else 1 / gain


def in_one_light(
    found: Estimate,
    frames: Array,
    valid: Mask,
    request: Request,
    allowing: Callable[[], Estimate],
    *,
    stacklevel: int = 2,
) -> Estimate:
    """Return the estimate that allows for other brightness of frames, if that was all there was.

    Frames that show less of a scene, as of one that turned, look darker as well. Nothing is asked
    of a stream, whose pictures follow its light, nor where it was allowed for.

    Parameters
    ----------
    found : of the frames [frame row col], which `valid` belong to
    allowing : finds the estimate that allows for it

    Warns
    -----
    QualityWarning
        If it was, or if the means of the frames differ.
    """
    if request.streamed or request.photometric:
        return found
    differ, said = unequal_brightness(frames, valid), found.notes.get("contradiction", "")
    if frames.dtype.kind != "c" and (ESTIMATED in said or (said and differ)):
        again = allowing()
        if not again.notes.get("contradiction"):
            how = "the frames differ in brightness"
            how = said.partition(":")[0] if ESTIMATED in said else how
            done = "the picture allows for it, by a gain and a bias of each frame (in its notes)"
            differ, found = f"{how}: {done}", again
    if differ:
        warnings.warn(differ, QualityWarning, stacklevel=stacklevel + 1)
    return found


def std_of_level(image: Floats, gain: Floats, bias: Floats) -> Floats:
    """Return the standard deviation of what no frame tells: the gain and bias that all share.

        std^2 = var_k(gain_k x + bias_k) / K

    The frames are as different from what they should be as from each other, so that their mean is
    off by as much as a mean of K such draws. It is one error for the whole picture.

    Parameters
    ----------
    image : [row col] in the units of the frames
    gain, bias : [frame] as estimated, at least two of them
    """
    count = len(gain)
    spread = np.cov(np.stack([gain, bias]))
    variance = spread[0, 0] * image**2 + 2 * spread[0, 1] * image + spread[1, 1]
    return np.asarray(np.sqrt(np.maximum(variance, 0.0) / count))


def _regress(x: Array, y: Array, passes: int = 8) -> tuple[float, float]:
    """Return slope and intercept of y over x by a Huber fit; slope 1 where x is flat."""
    w = np.ones_like(x)
    slope, intercept = 1.0, float(np.median(y - x))
    for _ in range(passes):
        mean_x, mean_y = np.average(x, weights=w), np.average(y, weights=w)
        spread = np.average((x - mean_x) ** 2, weights=w)
        residual = y - slope * x - intercept
        scale = max(robust_scale(residual), 1e-9)
        # Too flat a frame has no slope to see: only its bias is fitted.
        if spread * w.sum() > (10.0 * scale) ** 2:
            slope = float(np.average((x - mean_x) * (y - mean_y), weights=w) / spread)
        intercept = float(mean_y - slope * mean_x)
        residual = np.abs(y - slope * x - intercept)
        w = np.minimum(1.0, HUBER_SIGMAS * scale / np.maximum(residual, 1e-12))
    return slope, intercept
