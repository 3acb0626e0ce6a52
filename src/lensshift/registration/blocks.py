"""Standard errors made honest: what parts of the sensor say, each on its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array, Floats, Mask, Shifts
from lensshift.core.threads import bands
from lensshift.registration.likelihood import (
    UNKNOWN_PX,
    ShiftFit,
    likely_shifts,
    likely_steps,
)

# Frames and validity of a part of the sensor -> offsets and their standard errors.
Estimate = Callable[[Array, Mask], tuple[Shifts, Shifts]]

# Of larger frames the likelihood is asked of a part: its time goes with their pixels.
MOST_PX = 96
# And of so many frames together: its time goes with their cube. Scans for a calibration have 35.
MOST_TOGETHER = 36
LEAST_BLOCK_PX = 12  # along an axis, for a shift of its own
LEAST_VALID = 0.5  # of the pixels of a block or frame


def blocks_of(shape: tuple[int, ...]) -> list[tuple[slice, slice]]:
    """Return four parts of a sensor, along its longer side if it is long; [] if it is small."""
    rows, cols = shape
    split = (2, 2)
    if cols >= 3 * rows:
        split = (1, 4)
    elif rows >= 3 * cols:
        split = (4, 1)
    if rows // split[0] < LEAST_BLOCK_PX or cols // split[1] < LEAST_BLOCK_PX:
        return []
    down, across = (
        [slice(*ends) for ends in bands(size, parts)]
        for size, parts in zip(shape, split, strict=True)
    )
    return list(product(down, across))


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """What parts of the sensor, each on its own, say of the errors of the whole."""

    factor: float  # how much more the parts scatter than their errors say, 1 or more
    covariance_px2: Floats  # [2 frame, 2 frame] of the shifts of the whole, by that scatter alone

    def widened(self, covariance_px2: Floats) -> Floats:
        """Return a covariance with that part of the scatter which the errors do not explain."""
        return np.asarray(covariance_px2 + (1.0 - self.factor**-2) * self.covariance_px2)


def scatter_over_blocks(
    estimate: Estimate, frames: Array, valid: Mask, offset_px: Shifts
) -> Scatter:
    """Return how the parts of the sensor scatter about the whole, each asked on its own."""
    return scatter_of(
        [(found_px - offset_px, sigma_px)
         for rows, cols in _seen_blocks(valid)
         for found_px, sigma_px in [estimate(frames[:, rows, cols], valid[:, rows, cols])]],
        offset_px.size,
    )  # fmt: skip


def _seen_blocks(valid: Mask) -> list[tuple[slice, slice]]:
    """Return the parts of the sensor of which all frames show enough."""
    return [
        block
        for block in blocks_of(valid.shape[1:])
        if valid[:, *block].mean(axis=(1, 2)).min() >= LEAST_VALID
    ]


def scatter_of(parts: list[tuple[Shifts, Shifts]], size: int) -> Scatter:
    """Return how parts scatter about the whole, from their distance to it and standard errors.

        factor^2 = n / (n - 1) mean over blocks, frames, axes of ((d_block - d) / sigma_block)^2
        covariance = n / (n - 1) sum over blocks of g g^T,   g = w (d_block - d) / sum of w

    with w = 1 / sigma_block^2. A model that does not fit the scene (edges are no random field,
    line pairs have lines in their spectrum) makes estimates scatter more than noise does; the
    parts show by how much. Parts without texture are left out.

    Source of the covariance: Liang and Zeger (1986), each part a cluster.
    """
    away_px, weight = [], []
    for found_px, sigma_px in parts:
        known = (sigma_px > 0) & (sigma_px < 0.2)
        if np.any(known):
            away_px.append(found_px.ravel())
            weight.append(np.where(known, sigma_px, np.inf).ravel() ** -2)
    blocks = len(weight)
    if blocks < 2:
        return Scatter(1.0, np.zeros((size, size)))
    away, w = np.array(away_px), np.array(weight)
    usual = blocks / (blocks - 1)
    mean = float(np.mean((w * away**2)[w > 0]))
    part_px = w * away / np.maximum(w.sum(axis=0), 1e-300)
    factor = max(1.0, float(np.sqrt(mean * usual)))
    return Scatter(factor, np.asarray(usual * part_px.T @ part_px))


def telling_part(
    frames: Array, valid: Mask, offset_px: Shifts, side_px: int
) -> tuple[slice, slice, slice]:
    """Return the part of frames with most detail along its poorer axis.

    So large that all frames have in common what is `side_px` large.
    """
    shape, sides_px = frames.shape[1:], side_px + np.ceil(np.ptp(offset_px, axis=0)).astype(int)
    rows, cols = (min(side, size) for side, size in zip(sides_px, shape, strict=True))
    if (rows, cols) == shape:
        return np.s_[:], np.s_[:], np.s_[:]
    slopes = np.gradient(filled(frames, valid).mean(axis=0))
    energy = np.pad([np.cumsum(np.cumsum(np.abs(s) ** 2, 0), 1) for s in slopes],
                    ((0, 0), (1, 0), (1, 0)))  # fmt: skip
    inside = (energy[:, rows:, cols:] - energy[:, :-rows, cols:]
              - energy[:, rows:, :-cols] + energy[:, :-rows, :-cols])  # fmt: skip
    detail = inside.min(axis=0)
    top, left = np.unravel_index(int(np.argmax(detail)), detail.shape)
    return np.s_[:], slice(int(top), int(top) + rows), slice(int(left), int(left) + cols)


def filled(frames: Array, valid: Mask) -> Array:
    """Return the frames with invalid pixels taken from the mean of the others, or their mean."""
    good = np.where(valid, frames, 0)
    number = valid.sum(axis=0)
    overall = good.sum() / max(int(number.sum()), 1)
    mean = np.where(number > 0, good.sum(axis=0) / np.maximum(number, 1), overall)
    return np.where(valid, frames, mean)


def likely_where_telling(
    frames: Array, valid: Mask, start_px: Shifts, *, reference: int, photometric: bool
) -> ShiftFit:
    """Return the likeliest shifts; of large frames those of the part that shows most of them.

    Of many frames some at a time, each time with the reference.
    """
    part, count = telling_part(frames, valid, start_px, MOST_PX), len(frames)
    frames, valid = frames[part], valid[part]
    fits = []
    for numbers in _together(count, reference):
        fit = likely_shifts(
            frames[numbers], valid[numbers], start_px[numbers],
            reference=int(np.searchsorted(numbers, reference)), photometric=photometric,
        )  # fmt: skip
        fits.append((numbers, fit))
    return fits[0][1] if len(fits) == 1 else _joined(fits, count)


def _joined(fits: list[tuple[NDArray[np.intp], ShiftFit]], count: int) -> ShiftFit:
    """Return one fit of all frames; what the error of the reference adds to all is left out."""
    offset_px, gain = np.zeros((count, 2)), np.ones(count)
    covariance_px2, axes = np.zeros((count, 2, count, 2)), np.arange(2)
    for numbers, fit in fits:
        size = len(numbers)
        offset_px[numbers], gain[numbers] = fit.offset_px, fit.gain
        own = fit.covariance_px2.reshape(size, 2, size, 2)
        covariance_px2[np.ix_(numbers, axes, numbers, axes)] = own
    return ShiftFit(
        offset_px,
        covariance_px2.reshape(2 * count, 2 * count),
        gain,
        float(np.sqrt(np.mean([fit.noise_sigma**2 for _, fit in fits]))),
        all(fit.converged for _, fit in fits),
    )


def scatter_of_parts(
    frames: Array, valid: Mask, fit: ShiftFit, reference: int, *, photometric: bool
) -> Scatter:
    """Return how the parts of the sensor scatter, as much as expected where that says nothing.

    What moves in the scene says where it was as surely as what rests. Along a single edge parts
    may lie anywhere. Of many frames some are asked at a time, each time with the reference.
    """
    if np.any(fit.sigma_px > UNKNOWN_PX):
        return scatter_of([], fit.offset_px.size)
    part = telling_part(frames, valid, fit.offset_px, MOST_PX)
    frames, valid = frames[part], valid[part]
    blocks = _seen_blocks(valid)
    least = [min((block[axis].stop - block[axis].start for block in blocks), default=0)
             for axis in (0, 1)]  # fmt: skip
    span_px = np.ceil(np.ptp(fit.offset_px, axis=0))
    if np.any(np.array(least) - span_px < LEAST_BLOCK_PX // 2):
        return scatter_of([], fit.offset_px.size)
    height, width = least
    alike = [(slice(rows.start, rows.start + height), slice(cols.start, cols.start + width))
             for rows, cols in blocks]  # fmt: skip
    steps = np.zeros((len(alike), 2, *fit.offset_px.shape))
    for numbers in _together(len(frames), reference):
        some = replace(fit, offset_px=fit.offset_px[numbers], gain=fit.gain[numbers])
        steps[:, :, numbers] = likely_steps(
            frames[numbers], valid[numbers], some, alike,
            reference=int(np.searchsorted(numbers, reference)), photometric=photometric,
        )  # fmt: skip
    return scatter_of([(step_px, sigma_px) for step_px, sigma_px in steps], fit.offset_px.size)


def _together(count: int, reference: int) -> list[NDArray[np.intp]]:
    """Return numbers of frames that are asked at a time, the reference always among them."""
    others = np.delete(np.arange(count), reference)
    parts = np.array_split(others, -(-len(others) // (MOST_TOGETHER - 1)))
    return [np.sort([reference, *some]) for some in parts]
