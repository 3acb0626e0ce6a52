"""A finely sampled picture of the scene, from many frames whose shifts are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.forward.least_squares import conjugate_gradient

# Knots per pixel, and how stiff the spline is where no pixel says anything. Two hold no edge of a
# half-filled pixel behind a sharp lens, whose misfit reads as a shift that varies; three do.
KNOTS_PER_PX = 3
_STIFFNESS = 1e-3  # of the spline, over the weight of what it is fitted to
_PASSES, _SOLVED = 60, 1e-9**0.5  # of conjugate gradients
_NUMBERS_AT_ONCE = 50_000  # of the spline in some frames, so that they stay in the cache


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceImage:
    """A cubic spline that all frames sample, and what each frame should look like."""

    seen: Floats  # [frame row col] what the spline predicts of each frame
    slope: Floats  # [axis frame row col] its derivative by the place in the scene, per pixel


def reference_image(
    frames: Floats, weight: Floats, offset_px: Floats, slip_px: Floats | None = None
) -> ReferenceImage:
    """Fit one cubic spline to all frames.

        minimise  sum w_k (y_k - s(u - d_k))^2 + small |second differences|^2

    Parameters
    ----------
    frames, weight : [frame row col]; weight 0 at pixels that count for nothing
    offset_px : [frame 2]
    slip_px : [axis frame row col] small further shift of each pixel, to first order, or None
    """
    groups = _groups(frames.shape, offset_px)
    target = frames
    knots = np.full(groups[0].knots, float(np.average(frames, weights=weight)))
    knots = _fitted(target, weight, groups, knots)
    if slip_px is not None:
        target = frames + np.sum(_slopes(knots, groups) * slip_px, axis=0)
        knots = _fitted(target, weight, groups, knots)
    seen = np.concatenate([one.seen(knots) for one in groups])
    slope = _slopes(knots, groups)
    if slip_px is not None:
        seen = seen - np.sum(slope * slip_px, axis=0)
    return ReferenceImage(seen, slope)


def shown_everywhere(frames: Array, valid: Mask, offset_px: Floats) -> Array:
    """Return the frames; what a pixel does not see is what other frames show there.

    A defect lies at one place in all frames: where what is behind it is guessed from what is beside
    it, the guess stands still while the scene moves.
    """
    if valid.all():
        return frames
    if frames.dtype.kind == "c":
        real, imag = (
            shown_everywhere(part, valid, offset_px) for part in (frames.real, frames.imag)
        )
        return np.asarray(real + 1j * imag)
    seen = reference_image(np.where(valid, frames, 0.0), valid.astype(np.float64), offset_px).seen
    return np.where(valid, frames, seen)


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Frames that sample the spline at once: matrices of all, since each alone is little work."""

    part: slice  # which frames
    # of a frame and of the spline
    shape: tuple[int, int]
    knots: tuple[int, int]
    # [frame row, knot row] splines of all frames, one below the other, and their derivatives
    rows: tuple[Any, Any]
    # [frame col, frame knot col] a block for each frame, and their derivatives
    cols: tuple[Any, Any]

    def seen(self, knots: Floats, down: int = 0, right: int = 0) -> Floats:
        """Return the spline in each frame, [frame row col], or its derivative down or right."""
        (height, width), across = self.shape, self.knots[1]
        by_row = (self.rows[down] @ knots).reshape(-1, height, across)
        turned = by_row.transpose(0, 2, 1).reshape(-1, height)
        return np.asarray((self.cols[right] @ turned).reshape(-1, width, height).swapaxes(1, 2))

    def back(self, frames: Floats) -> Floats:
        """Return what pixels [frame row col] say to each knot: the transpose of `seen`."""
        height, across = self.shape[0], self.knots[1]
        turned = frames.transpose(0, 2, 1).reshape(-1, height)
        by_col = (self.cols[0].T @ turned).reshape(-1, across, height)
        return np.asarray(self.rows[0].T @ by_col.transpose(0, 2, 1).reshape(-1, across))


def _groups(shape: tuple[int, ...], offset_px: Floats) -> list[_Group]:
    from scipy.sparse import block_diag, vstack

    count, height, width = shape
    down, right = offset_px.T
    rows = [_splines(height, one, down) for one in down]
    cols = [_splines(width, one, right) for one in right]
    knots = (rows[0][0].shape[1], cols[0][0].shape[1])
    step = max(1, _NUMBERS_AT_ONCE // (height * knots[1]))
    parts = [slice(first, min(first + step, count)) for first in range(0, count, step)]
    return [
        _Group(
            part,
            (height, width),
            knots,
            tuple(vstack(of, format="csr") for of in zip(*rows[part], strict=True)),
            tuple(block_diag(of, format="csr") for of in zip(*cols[part], strict=True)),
        )
        for part in parts
    ]


def _splines(size: int, offset_px: float, all_px: Floats) -> tuple[Any, Any]:
    """Return the cubic B-splines and their derivatives at the pixels of a frame, [pixel knot]."""
    from scipy.interpolate import BSpline

    first = np.floor(KNOTS_PER_PX * -all_px.max()) - 1
    last = np.ceil(KNOTS_PER_PX * (size - 1 - all_px.min())) + 2
    at = KNOTS_PER_PX * (np.arange(size) - offset_px) - first
    ends = np.arange(-2.0, last - first + 3.0)  # of pieces: spline n is centred at n
    bent = BSpline.design_matrix(at, ends, 2)
    return BSpline.design_matrix(at, ends, 3), KNOTS_PER_PX * (bent[:, :-1] - bent[:, 1:])


def _slopes(knots: Floats, groups: list[_Group]) -> Floats:
    """Return the derivatives of the spline in each frame, [axis frame row col]."""
    return np.stack(
        [np.concatenate([one.seen(knots, *axis) for one in groups]) for axis in ((1, 0), (0, 1))]
    )


def _fitted(frames: Floats, weight: Floats, groups: list[_Group], start: Floats) -> Floats:
    """Return the knots of the penalised least-squares spline (conjugate gradients)."""
    stiffness = _STIFFNESS * len(frames) * float(weight.mean())

    def normal(knots: Floats) -> Floats:
        total = stiffness * _stiff(knots)
        for one in groups:
            total += one.back(weight[one.part] * one.seen(knots))
        return total

    rest = -normal(start)
    for one in groups:
        rest += one.back(weight[one.part] * frames[one.part])
    none, same = np.zeros_like(rest), np.ones(1)
    return start + conjugate_gradient(
        normal, rest, none, same, _PASSES, _SOLVED, residual=rest.copy()
    )


def _stiff(knots: Floats) -> Floats:
    """Return the gradient of half the sum of squared second differences along both axes."""
    total = np.zeros_like(knots)
    for axis in (0, 1):
        around = [(2, 2) if a == axis else (0, 0) for a in (0, 1)]
        total += np.diff(np.pad(np.diff(knots, 2, axis=axis), around), 2, axis=axis)
    return total
