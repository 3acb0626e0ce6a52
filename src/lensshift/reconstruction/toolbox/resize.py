"""Bicubic resizing as MATLAB publishes it, and the toolbox's starting image."""

from __future__ import annotations

import math

import numpy as np

from lensshift.core.arrays import Floats


def cubic(distance_px: Floats) -> Floats:
    """Return the Keys kernel with a = -1/2 at a distance in samples of the stretched grid."""
    d = np.abs(distance_px)
    near = (1.5 * d - 2.5) * d * d + 1.0
    far = ((-0.5 * d + 2.5) * d - 4.0) * d + 2.0
    return np.where(d <= 1, near, np.where(d <= 2, far, 0.0))


def resize_axis(values: Floats, size: int, axis: int) -> Floats:
    """Resize an array along one axis to `size` samples.

    The border is mirrored with its edge sample repeated, and the kernel is stretched
    (antialiased) when the array shrinks.
    """
    count = values.shape[axis]
    if size == count:
        return values
    scale = size / count
    stretch = min(scale, 1.0)
    width = 4.0 / stretch
    centre = (np.arange(size) + 0.5) / scale - 0.5
    first = np.floor(centre - width / 2).astype(np.intp)
    mirrored = np.concatenate((np.arange(count), np.arange(count)[::-1]))
    moved = np.moveaxis(values, axis, 0)
    resized = np.zeros((size, *moved.shape[1:]))
    total = np.zeros((size, *(1,) * (moved.ndim - 1)))
    # One tap at a time: the stacked prior weights are a vector of millions of samples.
    for tap in range(math.ceil(width) + 2):
        weight = cubic(stretch * (centre - first - tap)).reshape(total.shape)
        total += weight
        resized += weight * moved[mirrored[np.mod(first + tap, 2 * count)]]
    return np.moveaxis(resized / total, 0, axis)


def resize_bicubic(image: Floats, shape: tuple[int, ...]) -> Floats:
    """Resize an image [row col] to `shape`; a = -1/2, antialiased, mirrored border.

    Source: MATLAB's documentation of imresize, method bicubic.
    """
    return resize_axis(resize_axis(image, shape[0], 0), shape[1], 1)


def temporal_median(frames: Floats, offset_px: Floats) -> Floats:
    """Return the median over the frames [frame row col], each moved back by its offset.

    The toolbox moves bilinearly, fills with zeros and leaves samples that are not positive out
    of the median; a pixel that no frame sees becomes 0.

    Source: medfilttemp of the toolbox.
    """
    stack = np.stack([_move_back(*pair) for pair in zip(frames, offset_px, strict=True)])
    stack = np.sort(np.where(stack > 0, stack, np.inf), axis=0)
    count = np.isfinite(stack).sum(axis=0)
    low, high = np.take_along_axis(stack, np.stack([(count - 1) // 2, count // 2]), axis=0)
    return np.where(count > 0, 0.5 * (low + high), 0.0)


def _move_back(frame: Floats, offset_px: Floats) -> Floats:
    """Sample a frame bilinearly at u + offset; 0 outside the hull of its pixel centres."""
    moved = frame
    for axis in (0, 1):
        size = frame.shape[axis]
        at = np.clip(np.arange(size) + offset_px[axis], -1.0, size)
        inside = (at >= 0) & (at <= size - 1)
        low = np.clip(np.floor(at).astype(np.intp), 0, max(size - 2, 0))
        high = np.minimum(low + 1, size - 1)
        share = np.where(inside, at - low, 0.0)
        column = (slice(None), None) if axis == 0 else (None, slice(None))
        moved = inside[column] * (
            (1.0 - share)[column] * np.take(moved, low, axis=axis)
            + share[column] * np.take(moved, high, axis=axis)
        )
    return moved
