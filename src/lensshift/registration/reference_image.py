"""A finely sampled picture of the scene, from many frames whose shifts are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Floats

# Knots per pixel, and how stiff the spline is where no pixel says anything. Two hold no edge of a
# half-filled pixel behind a sharp lens, whose misfit reads as a shift that varies; three do.
KNOTS_PER_PX = 3
_STIFFNESS = 1e-3  # of the spline, over the weight of what it is fitted to
_PASSES = 60  # of conjugate gradients


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceImage:
    """A cubic spline that all frames sample, and what each frame should look like.

    Parameters
    ----------
    seen : [frame row col] what the spline predicts of each frame
    slope : [axis frame row col] its derivative by the place in the scene, per pixel
    """

    seen: Floats
    slope: Floats


def reference_image(
    frames: Floats, weight: Floats, offset_px: NDArray[np.float64], slip_px: Floats | None = None
) -> ReferenceImage:
    """Fit one cubic spline to all frames.

        minimise  sum w_k (y_k - s(u - d_k))^2 + small |second differences|^2

    Parameters
    ----------
    frames, weight : [frame row col]; weight 0 at pixels that count for nothing
    offset_px : [frame 2]
    slip_px : [axis frame row col] small further shift of each pixel, to first order, or None
    """
    rows = [_splines(frames.shape[1], d, offset_px[:, 0]) for d in offset_px[:, 0]]
    cols = [_splines(frames.shape[2], d, offset_px[:, 1]) for d in offset_px[:, 1]]
    operators = [(r[0], c[0]) for r, c in zip(rows, cols, strict=True)]
    shape = (rows[0][0].shape[1], cols[0][0].shape[1])
    target = frames
    knots = np.full(shape, float(np.average(frames, weights=weight)))
    knots = _fitted(target, weight, operators, knots)
    if slip_px is not None:
        slope = _slopes(knots, rows, cols)
        target = frames + np.sum(slope * slip_px, axis=0)
        knots = _fitted(target, weight, operators, knots)
    seen = np.stack([_seen(knots, r, c) for r, c in operators])
    slope = _slopes(knots, rows, cols)
    if slip_px is not None:
        seen = seen - np.sum(slope * slip_px, axis=0)
    return ReferenceImage(seen, slope)


def _splines(size: int, offset_px: float, all_px: NDArray[np.float64]) -> tuple[Any, Any]:
    """Return the cubic B-splines and their derivatives at the pixels of a frame, [pixel knot]."""
    from scipy.sparse import csr_array

    first = np.floor(KNOTS_PER_PX * -all_px.max()) - 1
    last = np.ceil(KNOTS_PER_PX * (size - 1 - all_px.min())) + 2
    at = KNOTS_PER_PX * (np.arange(size) - offset_px) - first
    whole = np.floor(at).astype(np.intp)
    p = at - whole
    values = np.stack(
        [(1 - p) ** 3, 3 * p**3 - 6 * p**2 + 4, 3 * (1 - p) ** 3 - 6 * (1 - p) ** 2 + 4, p**3], -1
    )
    slopes = np.stack(
        [-((1 - p) ** 2), 3 * p**2 - 4 * p, -3 * (1 - p) ** 2 + 4 * (1 - p), p**2], axis=-1
    )
    index = whole[:, None] + np.arange(-1, 3)
    row = np.broadcast_to(np.arange(size)[:, None], index.shape)
    shape = (size, int(last - first) + 1)
    place = (row.ravel(), index.ravel())
    return (
        csr_array((values.ravel() / 6.0, place), shape=shape),
        csr_array((0.5 * KNOTS_PER_PX * slopes.ravel(), place), shape=shape),
    )


def _seen(knots: Floats, row: Any, col: Any) -> Floats:
    return np.asarray((col @ (row @ knots).T).T)


def _slopes(knots: Floats, rows: list[Any], cols: list[Any]) -> Floats:
    pairs = list(zip(rows, cols, strict=True))
    down = np.stack([_seen(knots, r[1], c[0]) for r, c in pairs])
    right = np.stack([_seen(knots, r[0], c[1]) for r, c in pairs])
    return np.stack([down, right])


def _fitted(frames: Floats, weight: Floats, operators: list[Any], start: Floats) -> Floats:
    """Return the knots of the penalised least-squares spline (conjugate gradients)."""
    stiffness = _STIFFNESS * len(frames) * float(weight.mean())
    back = [(row.T.tocsr(), col.T.tocsr()) for row, col in operators]  # once, not in each pass

    def normal(knots: Floats) -> Floats:
        total = stiffness * _stiff(knots)
        for w, (row, col), (up, left) in zip(weight, operators, back, strict=True):
            total += _seen(w * _seen(knots, row, col), up, left)
        return total

    knots = start.copy()
    residual = -normal(knots)
    for y, w, (up, left) in zip(frames, weight, back, strict=True):
        residual += _seen(w * y, up, left)
    direction = residual.copy()
    size = first = float(np.sum(residual**2))
    for _ in range(_PASSES):
        if size <= 1e-9 * first:
            break
        bent = normal(direction)
        length = size / float(np.sum(direction * bent))
        knots += length * direction
        residual -= length * bent
        before, size = size, float(np.sum(residual**2))
        direction = residual + size / before * direction
    return knots


def _stiff(knots: Floats) -> Floats:
    """Return the gradient of half the sum of squared second differences along both axes."""
    total = np.zeros_like(knots)
    for axis in (0, 1):
        bent = np.diff(knots, 2, axis=axis)
        padded = np.pad(bent, [(2, 2) if a == axis else (0, 0) for a in (0, 1)])
        total += np.diff(padded, 2, axis=axis)
    return total
