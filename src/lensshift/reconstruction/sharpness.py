"""Frames that are less sharp than the others: shaken while they were exposed, or out of focus.

What widens the response of frame k by second moments C_k shows, to first order, as

    y_k = A_k x + sum over i, j of C_k,ij / 2  A_k d_i d_j x

so its residual goes with the second derivatives of the picture, as that of a wrong shift d goes
with the first; and with the second as if C_k were d d^T, which is taken off. What all frames share
is the picture's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lensshift.core.arrays import Array, Floats
from lensshift.forward.differences import image_slopes
from lensshift.forward.operator import LinearOperator, single
from lensshift.reconstruction.displacement import (
    ALLOWED_SHIFT_PX,
    SURE,
    reweighted,
    slopes_of,
    some_pixels,
    told_shifts,
)

# Frames of which most are alike, so that one can be told from them.
LEAST_FRAMES = 4
# A response that is wider by half a pixel of shaking counts (standard deviation); errors of the
# model may look like less (0.3 px in 1 of 200 right bursts).
LEAST_PX2 = 0.5**2


def moments_px2(
    A: LinearOperator, image: Array, y: Array, sigma: Floats, scale: int
) -> dict[int, Floats]:
    """Return C_k = (row row, row col, col col) of the frames that are surely sharper or less sharp.

    Of none, unless one is less sharp by as much as counts.

    Parameters
    ----------
    A : HR image [row col] to frames [frame row col]
    image : [row col] the picture x
    y, sigma : [frame row col] frames, and noise of each LR pixel, infinite where it was not used
    scale : HR pixels per LR pixel
    """
    if len(y) < LEAST_FRAMES or min(image.shape) < 3:
        return {}
    used = np.isfinite(sigma)
    rest = np.where(used, y - A.forward(single(image)), 0.0)
    slopes, _ = slopes_of(A, single(image), scale)
    variance = np.where(used, sigma, 1.0) ** 2 + ALLOWED_SHIFT_PX**2 * np.sum(slopes**2, axis=0)
    terms = np.concatenate([_curvatures(A, image, scale), slopes])
    terms, on, r, variance = (some_pixels(v) for v in (terms.swapaxes(0, 1), used, rest, variance))
    found, covariance = reweighted(terms, variance, r, on)
    off_px, _ = told_shifts(found[:, 3:], covariance[:, 3:, 3:])
    down, right = off_px.T
    own = (found - np.median(found, axis=0))[:, :3] - np.stack([down**2, down * right, right**2], 1)
    error = np.sqrt(np.einsum("kii->ki", covariance))[:, :3]
    sure = np.abs(own) > SURE * error
    if not np.any((sure & (own > LEAST_PX2))[:, [0, 2]]):  # nothing makes a frame sharper
        return {}
    return {int(k): own[k] for k in np.flatnonzero(sure.any(axis=1))}


def as_sharp_as_most(
    A: LinearOperator, image: Array, y: Array, scale: int, moments: Mapping[int, Array]
) -> Array:
    """Return the frames [frame row col] as they would be without the moments C_k of theirs."""
    curvatures, y = _curvatures(A, image, scale), y.copy()
    for k, own in moments.items():
        y[k] -= np.tensordot(own, curvatures[:, k], 1).astype(y.dtype)
    return y


def told(moments: Mapping[int, Array], frames: Sequence[int]) -> str:
    """Return in words which frames are not as sharp as the others, and what to do.

    Parameters
    ----------
    frames : their numbers in the burst
    """
    said = []
    for k, (rows, _, cols) in moments.items():
        if max(rows, cols) > LEAST_PX2:
            width = ", ".join(f"{np.sign(m) * np.sqrt(abs(m)):+.1f}" for m in (rows, cols))
            said.append(f"frame {frames[k]} is less sharp than the others, by ({width}) px")
    return (
        f"{', '.join(said)}, as if the camera shook: the picture allows for it "
        "(hold it still, or leave frames out by frames=)"
    )


def _curvatures(A: LinearOperator, image: Array, scale: int) -> Array:
    """Return half of d_r d_r x, twice half of d_r d_c x and half of d_c d_c x in the frames."""
    down, right = image_slopes(image)
    (down_down, down_right), (_, right_right) = image_slopes(down), image_slopes(right)
    second = down_down / 2, down_right, right_right / 2
    return np.stack([scale**2 * A.forward(np.ascontiguousarray(single(part))) for part in second])
