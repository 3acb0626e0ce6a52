"""Upscaling by interpolation: nearest neighbour, and Keys cubic on one or all frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from scipy import sparse

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.grid import hr_to_lr
from lensshift.reconstruction.baselines.holes import fill_holes
from lensshift.reconstruction.baselines.result import Baseline
from lensshift.reconstruction.toolbox.resize import cubic

# Positions half-way between two LR pixels must not depend on rounding errors of the offset.
_TIE_PX = 1e-9

Taps = Callable[[int, int, float], sparse.csr_array]


def bicubic(
    frames: Array,
    weight: Floats,
    offset_px: Floats,
    scale: int,
    combine: Literal["first", "mean", "median"] = "first",
    frame: int = 0,
) -> Baseline:
    """Interpolate with the Keys cubic (a = -1/2) and align: one frame, or all of them combined.

    Parameters
    ----------
    frames, weight : [frame row col]; pixels of weight 0 are filled from their neighbours in
        their frame, and have no say in the mean or median
    offset_px : [frame 2]
    combine : "first": only the frame of number `frame`; "mean": weighted; "median": of the real
        and of the imaginary part

    Source: Keys, Cubic convolution interpolation, IEEE Trans. ASSP 29 (1981).
    """
    if combine == "first":
        return resampled(frames[frame], weight[frame], offset_px[frame], scale, cubic_taps)
    usable = np.flatnonzero(weight.any(axis=(1, 2)))
    parts = [resampled(frames[k], weight[k], offset_px[k], scale, cubic_taps) for k in usable]
    stack = np.stack([part.image for part in parts])
    votes = np.stack([_apply(nearest_taps, weight[k], offset_px[k], scale)[0] for k in usable])
    # Where no frame has a valid pixel, all of them vote with what they were filled with.
    votes[:, ~votes.any(axis=0)] = 1.0
    if combine == "median":
        return Baseline(_median(stack, votes > 0))
    gain = np.stack([part.noise_gain for part in parts if part.noise_gain is not None])
    total = votes.sum(axis=0)
    return Baseline(
        (votes * stack).sum(axis=0) / total, np.sqrt(((votes * gain) ** 2).sum(axis=0)) / total
    )


def nearest_taps(size: int, scale: int, offset_px: float) -> sparse.csr_array:
    """Return the matrix [HR index, LR index] of nearest-neighbour sampling along one axis.

    Half-way between two LR pixels, the one that the HR pixel lies in without shift is taken.
    """
    at = hr_to_lr(np.arange(size * scale), scale) + offset_px - np.sign(offset_px) * _TIE_PX
    source = np.clip(np.floor(at + 0.5), 0, size - 1).astype(np.intp)
    return sparse.csr_array((np.ones(at.size), (np.arange(at.size), source)), shape=(at.size, size))


def cubic_taps(size: int, scale: int, offset_px: float) -> sparse.csr_array:
    """Return the matrix [HR index, LR index] of cubic interpolation; edge pixels repeat."""
    at = np.clip(hr_to_lr(np.arange(size * scale), scale) + offset_px, -2.0, size + 1.0)
    first = np.floor(at).astype(np.intp) - 1
    tap = first[:, None] + np.arange(4)
    kernel = cubic(at[:, None] - tap)
    row = np.broadcast_to(np.arange(at.size)[:, None], tap.shape)
    matrix = sparse.coo_array(
        (kernel.ravel(), (row.ravel(), np.clip(tap, 0, size - 1).ravel())), shape=(at.size, size)
    )
    # Taps that the border has folded onto one pixel are added up before anything is squared.
    return sparse.csr_array(matrix.tocsr())


def resampled(frame: Array, weight: Floats, offset_px: Floats, scale: int, taps: Taps) -> Baseline:
    """Fill the holes of a frame [row col] and resample it, with its noise gain."""
    filled, variance = fill_holes(frame, weight, np.ones(frame.shape))
    image, row, col = _apply(taps, filled, offset_px, scale)
    spread = (col**2 @ (row**2 @ variance).T).T
    return Baseline(image, np.sqrt(spread))


def _apply(
    taps: Taps, values: Array, offset_px: Floats, scale: int
) -> tuple[Array, sparse.csr_array, sparse.csr_array]:
    """Resample values [row col] along both axes; return the matrices too."""
    row, col = (
        taps(size, scale, float(offset))
        for size, offset in zip(values.shape, offset_px, strict=True)
    )
    return np.ascontiguousarray((col @ (row @ values).T).T), row, col


def _median(stack: Array, counted: Mask) -> Array:
    """Return the median over axis 0 of the samples that count, of each component."""
    if np.iscomplexobj(stack):
        return _median(stack.real, counted) + 1j * _median(stack.imag, counted)
    return np.asarray(np.nanmedian(np.where(counted, stack, np.nan), axis=0))
