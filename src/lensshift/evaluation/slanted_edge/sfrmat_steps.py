"""The steps that sfrmat3 and sfrmat5 share, with the details in which the originals differ.

Columns and bins count from 0 here and from 1 in the originals.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.polynomial.polynomial import Polynomial, polyval
from numpy.typing import ArrayLike
from scipy import ndimage

from lensshift.evaluation.inputs import check_finite, real_array
from lensshift.evaluation.slanted_edge.result import Matrix, Vector

Window = Literal["tukey", "hamming"]

BINS_PER_PX = 4
LEAST_LINES, LEAST_COLUMNS = 5, 8
_LEAST_STEP = 1e-4  # sfrmat3 takes a line with less as one without an edge
_NO_EDGE_PX = -1.5  # and places its edge here
_LARGEST_CORRECTION = 10.0


def upright_edge(image: ArrayLike, least_lines: int) -> tuple[Matrix, bool]:
    """Return the image with its edge along the columns, and whether it was turned for that.

    It is turned counterclockwise where rows 2 and -4 differ more than columns 2 and -4. Raises
    `ValueError` if the image is not two-dimensional, real and finite, is constant or too small.
    """
    values = real_array(image, "image")
    if min(values.shape) < LEAST_LINES:
        raise ValueError(f"expected at least {LEAST_LINES} rows and columns, got {values.shape}")
    check_finite(values)
    if np.ptp(values) == 0:
        raise ValueError(f"expected an edge, got a constant image of {values[0, 0]:g}")
    down = abs(np.mean(values[-4]) - np.mean(values[2]))
    across = abs(np.mean(values[:, -4]) - np.mean(values[:, 2]))
    turned = bool(down > across)
    upright = np.rot90(values) if turned else values
    lines, columns = upright.shape
    if lines < least_lines or columns < LEAST_COLUMNS:
        raise ValueError(
            f"expected at least {least_lines} lines of {LEAST_COLUMNS} pixels across the edge, "
            f"got {lines} of {columns}"
        )
    return upright, turned


def polarity(upright: Matrix) -> int:
    """Return 1 if the edge brightens to the right, -1 if to the left.

    The originals compare the sum of five columns on the left with that of six on the right, and
    find nothing of use where this gives the wrong answer; then this raises `ValueError`.
    """
    left, right = upright[:, :5], upright[:, -6:]
    found = -1 if left.sum() > right.sum() else 1
    if found * (right.mean() - left.mean()) < 0:
        raise ValueError(
            "expected the sums of 5 columns on the left and 6 on the right to tell the brighter "
            f"side, got {left.sum():g} and {right.sum():g} for means of {left.mean():g} and "
            f"{right.mean():g}; mirror the image, take off its offset, or use method='ml'"
        )
    return found


def hamming(count: int, centre_px: ArrayLike) -> Matrix:
    """Return Hamming windows [line n] about centres m [line], in pixels.

    w(k) = 0.54 + 0.46 cos( pi (k - m) / max(m, n-1-m) )
    """
    centre = np.atleast_1d(np.asarray(centre_px, dtype=np.float64))[:, None]
    reach = np.maximum(centre, count - 1 - centre)
    return 0.54 + 0.46 * np.cos(np.pi * (np.arange(count) - centre) / reach)


def hann(count: int, centre_px: ArrayLike) -> Matrix:
    """Return Hann windows (Tukey's with alpha = 1), cut so that they peak at the given places.

        w(k) = (1 - cos(2 pi k / (N-1))) / 2,   N = round(2 max(m+1, n-m-1))

    of which the first n samples are taken if the centre m lies in the right half, else the last.
    """
    centre = np.atleast_1d(np.asarray(centre_px, dtype=np.float64))[:, None]
    length = np.floor(2.0 * np.maximum(centre + 1.0, count - centre - 1.0) + 0.5)
    skipped = np.where(centre + 1.0 >= count / 2, 0.0, length - count)
    return 0.5 * (1.0 - np.cos(2.0 * np.pi * (skipped + np.arange(count)) / (length - 1.0)))


def edge_of_sfrmat3(rising: Matrix) -> tuple[Vector, int]:
    """Return the edge as a straight line, column = p(line), and the number of lines without one.

    Centroids of the backward difference of pixels [line column], brighter to the right, under a
    Hamming window, first about the middle, then about the line of the first pass. That line is read
    one line late, as in the original. p has its constant first.
    """
    difference = np.diff(rising, axis=1) / 2
    difference = np.hstack([difference[:, :1], difference])  # sample k lies at k - 1/2
    lines, columns = difference.shape
    centre: ArrayLike = (columns - 1) / 2
    for _ in range(2):
        weighted = difference * hamming(columns, centre)
        step = weighted.sum(axis=1)
        present = step >= _LEAST_STEP
        place = weighted @ np.arange(columns) / np.where(present, step, 1.0) - 0.5
        line = _fitted(np.where(present, place, _NO_EDGE_PX), 1)
        centre = polyval(np.arange(lines) + 1.0, line)
    return line, int(np.count_nonzero(~present))


def bin_centroid_of_sfrmat3(lsf: Vector) -> float:
    """Return the centroid of the LSF, its first bin being number 1; 0 where it sums to nothing."""
    total = float(lsf.sum())
    return float(lsf @ np.arange(1, lsf.size + 1)) / total if total >= _LEAST_STEP else 0.0


def edge_of_sfrmat5(rising: Matrix, order: int, window: Window) -> tuple[Vector, Vector]:
    """Return the edge as a polynomial, column = p(line), and as a straight line; constants first.

    Centroids of the forward difference of pixels [line column], brighter to the right, under a
    window ("tukey": 95 % Hann and 5 % everywhere), first about the middle, then about the
    polynomial of the first pass. Raises `ValueError` if a line has no contrast.
    """
    difference = np.diff(rising, axis=1) / 2
    difference[:, 0] = difference[:, 1]
    difference = np.hstack([difference, difference[:, -1:]])  # sample k lies at k + 1/2
    lines, columns = difference.shape

    def weights(centre_px: ArrayLike) -> Matrix:
        centre = np.asarray(centre_px, dtype=np.float64)
        if window == "hamming":
            return hamming(columns, centre - 0.5)
        return 0.95 * hann(columns, centre - 1.0) + 0.05  # half a pixel left, as in the original

    centre: ArrayLike = (columns + 1) / 2
    for _ in range(2):
        weighted = difference * weights(centre)
        step = weighted.sum(axis=1)
        if flat := int(np.count_nonzero(step == 0)):
            raise ValueError(f"expected an edge in each of {lines} lines, got {flat} without one")
        place = weighted @ np.arange(columns) / step + 0.5
        edge = _fitted(place, order)
        centre = polyval(np.arange(lines, dtype=np.float64), edge)
    return edge, _fitted(place, 1)


def _fitted(columns_px: Vector, order: int) -> Vector:
    """Return the least-squares polynomial of the line number, constant first."""
    polynomial = Polynomial.fit(np.arange(columns_px.size), columns_px, order).convert()
    coefficients = np.zeros(order + 1)  # numpy drops powers with a coefficient of exactly 0
    coefficients[: polynomial.coef.size] = polynomial.coef
    return coefficients


def whole_phases(lines: int, slope: float) -> int:
    """Return how many lines hold whole pixel phases of 1/|slope|; `ValueError` if not even one."""
    phases = np.floor(lines * abs(slope))
    if phases == 0:
        need = 1 / abs(slope) if slope else np.inf
        raise ValueError(
            f"expected at least 1/|slope| = {need:.4g} lines for one whole pixel phase at "
            f"{np.rad2deg(np.arctan(abs(slope))):.2f} degrees, got {lines}; use method='ml'"
        )
    return rounded(phases / abs(slope))


def project(
    upright: Matrix, displacement_px: Vector, run_px: float, *, interpolate_sums: bool
) -> tuple[Vector, int]:
    """Return the ESF [4 columns], the mean of the pixels in quarter-pixel bins, and the empty bins.

    The count of an empty bin becomes the mean of its neighbours', filled ones included. Its sum
    does so only in sfrmat5; in sfrmat3 the ESF is 0 there. It is NaN where no count is found. The
    edge lies `displacement_px` from where it is at line 0, and runs over `run_px` in all, which
    says where the ESF starts.
    """
    columns = upright.shape[1]
    place_px = np.arange(columns) - displacement_px[:, None]
    run = rounded(-BINS_PER_PX * run_px)
    bins = np.maximum(np.ceil(BINS_PER_PX * place_px).astype(np.intp) - min(0, run), 0).ravel()
    start, length = rounded(0.5 * abs(run)), BINS_PER_PX * columns
    used = slice(start, start + length)
    count = np.bincount(bins, minlength=start + length + 1).astype(np.float64)
    total = np.bincount(bins, weights=upright.ravel(), minlength=start + length + 1)
    empty = start + np.flatnonzero(count[used] == 0)
    for i in empty:
        # Nothing lies left of bin 0: the originals take its right neighbour alone.
        neighbours = [i - 1, i + 1] if i > 0 else [i + 1]
        count[i] = np.mean(count[neighbours])
        if interpolate_sums:
            total[i] = np.mean(total[neighbours])
    esf = np.full(length, np.nan)
    np.divide(total[used], count[used], out=esf, where=count[used] > 0)
    return esf, int(empty.size)


def shifted(values: Vector, steps: int) -> Vector:
    """Return the samples moved to the left by some steps, zeros following."""
    return np.asarray(ndimage.shift(values, -steps, order=0))


def modulation_of(windowed: Vector) -> Vector:
    """Return the modulation [round(n/4 + 1/2)] of a windowed LSF [n], up to one cycle per pixel.

        SFR(i) = |FFT(i)| / |FFT(0)| * D(i),   D = min(10, x / sin x),   x = pi (i+1) / (n/2 + 2)

    D makes up for the finite difference; the originals count i from 1 there, an index too far.
    """
    count = windowed.size // 2 + 1
    spectrum = np.abs(np.fft.rfft(windowed))
    if spectrum[0] == 0:
        raise ValueError("expected an edge, got an LSF that sums to 0 under its window")
    phase = np.pi * np.arange(1, count + 1) / (count + 1)
    correction = np.minimum(_LARGEST_CORRECTION, phase / np.sin(phase))
    correction[0] = 1.0
    modulation: Vector = spectrum / spectrum[0] * correction
    return modulation[: rounded(count / 2)]


def rounded(value: float) -> int:
    """Round half away from zero."""
    return int(np.copysign(np.floor(abs(value) + 0.5), value))
