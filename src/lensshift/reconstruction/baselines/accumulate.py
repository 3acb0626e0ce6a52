"""Putting LR samples where they belong on the HR grid: shift-and-add and drizzle."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.grid import lr_to_hr
from lensshift.reconstruction.baselines.holes import fill_holes
from lensshift.reconstruction.baselines.result import Baseline

# Positions half-way between two HR pixels must not depend on rounding errors of the offset.
_TIE_HR_PX = 1e-9
# Less than this share of the largest weight is a rounding error and not a hit.
_LEAST_HIT = 1e-6


def shift_and_add(
    frames: Array,
    weight: Floats,
    offset_px: Floats,
    scale: int,
    combine: Literal["mean", "median"] = "mean",
) -> Baseline:
    """Drop every LR sample into the HR pixel nearest to it, and fill the pixels left empty.

    For a full pattern of 1/scale steps this interlaces the frames exactly.

    Parameters
    ----------
    frames, weight : [frame row col]; samples of weight 0 are left out
    offset_px : [frame 2]
    combine : samples in one HR pixel: "mean" (weighted) or "median" (of the real and of the
        imaginary part, every sample with a weight counting once)

    Raises
    ------
    ValueError
        If no sample falls into the image.

    Source: Elad and Hel-Or, IEEE Trans. Image Process. 10 (2001); Farsiu et al., ibid. 13 (2004).
    """
    shape = (frames.shape[1] * scale, frames.shape[2] * scale)
    pixel, used = _nearest_hr_pixel(offset_px, frames.shape, scale)
    used &= weight > 0
    if not used.any():
        raise ValueError("no valid sample falls into the image; are the offsets in LR pixels?")
    pixel, sample, share = pixel[used], frames[used], weight[used]
    total = _gather(pixel, share, shape)
    hit = total > 0
    divisor = np.where(hit, total, 1.0)
    if combine == "median":
        middle = _median_by_pixel(pixel, sample, shape)
        return Baseline(fill_holes(middle, total, np.zeros(shape))[0])
    mean = _gather(pixel, share * sample, shape) / divisor
    variance = _gather(pixel, share**2, shape) / divisor**2
    image, variance = fill_holes(mean, total, variance)
    return Baseline(image, np.sqrt(variance))


def drizzle_frames(
    frames: Array,
    weight: Floats,
    offset_px: Floats,
    scale: int,
    pixfrac: float = 0.5,
    kernel: Literal["square", "point"] = "square",
) -> Baseline:
    """Drizzle the frames onto the HR grid with STScI's `drizzle`, and fill what stays empty.

    Every LR pixel is shrunk to `pixfrac` of its width and shared out to the HR pixels by area.
    The library computes in single precision. Complex frames are two runs.

    Parameters
    ----------
    frames, weight : [frame row col]; pixels of weight 0 are left out
    offset_px : [frame 2]
    pixfrac : linear size of the drop in LR pixels, in (0, 1]
    kernel : "square", or "point": all of it into the nearest HR pixel, whatever `pixfrac`

    Raises
    ------
    ValueError
        If frames are single lines, or no pixel falls into the image.

    Source: Fruchter and Hook, Drizzle, PASP 114 (2002).
    """
    if min(frames.shape[1:]) < 2:
        raise ValueError(f"drizzle expects frames of 2 x 2 pixels or more, got {frames.shape[1:]}")
    parts = [frames.real, frames.imag] if np.iscomplexobj(frames) else [frames]
    runs = [_drizzle(part, weight, offset_px, scale, pixfrac, kernel) for part in parts]
    hit_weight = runs[0][1]
    image = runs[0][0] + 1j * runs[1][0] if len(runs) == 2 else runs[0][0]
    hit_weight[hit_weight <= _LEAST_HIT * hit_weight.max()] = 0.0
    if not hit_weight.any():
        raise ValueError("no valid pixel falls into the image; are the offsets in LR pixels?")
    return Baseline(fill_holes(image, hit_weight, np.zeros(hit_weight.shape))[0])


def _drizzle(
    frames: Floats, weight: Floats, offset_px: Floats, scale: int, pixfrac: float, kernel: str
) -> tuple[Floats, Floats]:
    """Run the library; return image (0 where nothing fell) and weight."""
    from drizzle.resample import Drizzle

    rows, cols = frames.shape[1:]
    # The library throws a drop away whole when its centre lies outside the output, so the output
    # gets a margin. Left to size it by itself, it would swap rows and columns.
    margin = scale
    shape = (rows * scale + 2 * margin, cols * scale + 2 * margin)
    job = Drizzle(kernel=kernel, fillval="0", out_shape=shape, disable_ctx=True)
    for frame, share, (row_px, col_px) in zip(frames, weight, offset_px, strict=True):
        y = lr_to_hr(np.arange(rows) - row_px, scale) + margin
        x = lr_to_hr(np.arange(cols) - col_px, scale) + margin
        grid = np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1)
        job.add_image(frame, 1.0, grid, weight_map=share, pixfrac=pixfrac, in_units="cps")
    found = np.stack([job.out_img, job.out_wht]).astype(np.float64)
    image, weights = found[:, margin:-margin, margin:-margin]
    return image, weights


def _nearest_hr_pixel(
    offset_px: Floats, shape: tuple[int, ...], scale: int
) -> tuple[NDArray[np.intp], Mask]:
    """Return the flat HR index of every sample [frame row col], and whether it is inside."""
    position: list[NDArray[np.intp]] = []
    for axis in (0, 1):
        seen_px = np.arange(shape[1 + axis]) - offset_px[:, axis, None]
        at = np.floor(lr_to_hr(seen_px, scale) + 0.5 + _TIE_HR_PX)
        at = np.clip(at, -1, shape[1 + axis] * scale).astype(np.intp)
        position.append(at[:, :, None] if axis == 0 else at[:, None, :])
    row, col = np.broadcast_arrays(*position)
    rows, cols = shape[1] * scale, shape[2] * scale
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    return row * cols + col, inside


def _gather(pixel: NDArray[np.intp], values: Array, shape: tuple[int, int]) -> Array:
    """Add up the values that fall on each HR pixel."""
    size = shape[0] * shape[1]
    if np.iscomplexobj(values):
        real = np.bincount(pixel, values.real, size)
        return np.asarray(real + 1j * np.bincount(pixel, values.imag, size)).reshape(shape)
    return np.bincount(pixel, values, size).reshape(shape)


def _median_by_pixel(pixel: NDArray[np.intp], values: Array, shape: tuple[int, int]) -> Array:
    """Return the median of the values that fall on each HR pixel; 0 where none does."""
    if np.iscomplexobj(values):
        real = _median_by_pixel(pixel, values.real, shape)
        return real + 1j * _median_by_pixel(pixel, values.imag, shape)
    ranked = values[np.lexsort((values, pixel))]
    count = np.bincount(pixel, minlength=shape[0] * shape[1])
    hit = np.flatnonzero(count)
    start = (np.cumsum(count) - count)[hit]
    image = np.zeros(count.size)
    low = ranked[start + (count[hit] - 1) // 2]
    image[hit] = 0.5 * (low + ranked[start + count[hit] // 2])
    return image.reshape(shape)
