"""Some frames at a glance: their busiest part, and the shifts that it seems to tell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.arrays import Array, Mask, Shifts
from lensshift.core.gaussian import MAD_TO_SIGMA
from lensshift.core.order import median, quantile
from lensshift.reconstruction.noise import ordered_around, usual_size
from lensshift.reconstruction.quick_shifts import found_shifts, low_passed

# A part of the sensor and some of the frames tell enough, at a bounded price. Shifts in a unit that
# is too small go far: frames that they move by more than FAR_PX are asked from where they lie, too.
MOST_PX, MOST_FRAMES, FAR_PX = 48, 9, 3.0
LEAST_PX = 8
# Robust deviations from the neighbours that no scene has.
STANDS_OUT = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Glance:
    """The busiest part of some frames, and the shifts that they tell at a glance.

    Parameters
    ----------
    numbers : of the frames
    values : [frame row col] in units of their spread, 0 where not seen
    seen : [frame row col], without pixels that stand out
    given_px : [frame 2] as told, about their mean
    about_px : [frame row col 2] by how much the pixels' own shifts differ from those, if any do
    smooth : `low_passed`
    found_px : `found_shifts`
    """

    numbers: NDArray[np.intp]
    values: Array
    seen: Mask
    given_px: Shifts
    about_px: Array | None
    smooth: Array
    found_px: Shifts

    @property
    def apart_px(self) -> Shifts:
        """How far [frame 2] the frames seem to lie from where they were told."""
        return self.found_px - self.given_px


def glance(frames: ArrayLike, offset_px: ArrayLike, valid: Mask) -> Glance | None:
    """Return what some frames [frame row col], real or complex, tell at a glance.

    None if that is too little.
    """
    values = np.asarray(frames)
    shown = np.flatnonzero(np.any(valid, axis=(1, 2)))
    if len(shown) < 2:
        return None
    evenly = np.linspace(0, len(shown) - 1, min(len(shown), MOST_FRAMES)).round()
    some = shown[evenly.astype(np.intp)]
    offsets = np.asarray(offset_px, np.float64)[some]
    values, seen, given, about = _part(values[some], valid[some], offsets)
    if min(values.shape[1:]) < LEAST_PX or seen.mean() < 0.5:
        return None
    values = (values - _middle(values[seen])) / max(float(np.std(values[seen])), 1e-300)
    values = np.where(seen, values, 0.0)
    seen = seen & ~_lone(values)
    values = np.where(seen, values, 0.0)
    smooth = low_passed(values, seen)
    if smooth is None:
        return None
    return Glance(some, values, seen, given, about, smooth, found_shifts(smooth, given))


def _middle(values: Array) -> complex:
    """Return the median, of complex numbers that of their parts."""
    if np.iscomplexobj(values):
        return complex(median(values.real), median(values.imag))
    return median(values)


def _lone(values: Array) -> Mask:
    """Return the pixels [frame row col] that stand out among their neighbours in all frames.

    Salt and pepper draws a fit to itself, and least where all frames lie at one place.
    """
    if np.iscomplexobj(values):
        return _lone(values.real) | _lone(values.imag)
    around = ordered_around(values)
    apart = values - quantile(around, 0.5)
    usual = np.maximum(usual_size(apart), MAD_TO_SIGMA * median(np.abs(apart)))
    return np.asarray(np.abs(apart) > STANDS_OUT * usual)


def _part(values: Array, seen: Mask, offset_px: Shifts) -> tuple[Array, Mask, Shifts, Array | None]:
    """Return the busiest part of frames that overlap in it, and their shifts about the mean.

    And by how much [frame row col 2] the pixels' own shifts differ from those, if any do.
    """
    from scipy.ndimage import minimum_filter, uniform_filter

    first = int(np.argmax(seen.sum(axis=(1, 2))))  # that shows most
    shown = np.where(seen[first], values[first], 0.0)
    down, right = np.gradient(shown) if min(shown.shape) > 1 else (shown, shown)
    edge = minimum_filter(seen[first], 3)  # and none of what was not seen
    span_px = float(np.ptp(offset_px, axis=tuple(range(offset_px.ndim - 1))).max())
    side = MOST_PX + (min(math.ceil(span_px), MOST_PX) if span_px > FAR_PX else 0)
    busy = [uniform_filter(np.abs(np.where(edge, g, 0.0)) ** 2, side) for g in (down, right)]
    middle = np.unravel_index(int(np.argmax(np.minimum(*busy))), shown.shape)
    starts = (
        max(0, min(int(at) - side // 2, size - side))
        for at, size in zip(middle, shown.shape, strict=True)
    )
    window = tuple(slice(start, start + side) for start in starts)
    about_px = None
    if offset_px.ndim == 4:
        field_px = offset_px[:, *window]
        offset_px = field_px.mean(axis=(1, 2))
        about_px = field_px - offset_px[:, None, None]
    offset_px = offset_px - offset_px.mean(axis=0)
    kind = np.complex128 if np.iscomplexobj(values) else np.float64
    return values[:, *window].astype(kind), seen[:, *window], offset_px, about_px
