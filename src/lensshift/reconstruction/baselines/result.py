"""What a plain method returns, and the check of what it is given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Baseline:
    """The HR image of a plain method.

    Parameters
    ----------
    image : [row col], real or complex
    noise_gain : [row col] standard deviation of an HR pixel where that of every LR pixel is 1
        and their noises are independent; None where the method is not linear
    hit_weight : [row col] total weight of the LR samples that fell on an HR pixel; 0 where it
        was filled from its neighbours; None for methods that interpolate
    """

    image: NDArray[Any]
    noise_gain: NDArray[np.float64] | None = None
    hit_weight: NDArray[np.float64] | None = None


def check_frames(
    frames: ArrayLike, weight: ArrayLike | None, offset_px: ArrayLike, scale: int
) -> tuple[NDArray[Any], NDArray[np.float64], NDArray[np.float64]]:
    """Return frames, weight [frame row col] and offset [frame 2], with 0 at unusable pixels.

    Raises
    ------
    ValueError
        If shapes disagree, `scale` is not a positive integer, no pixel is usable, or a pixel
        that has a weight is not finite.
    """
    values = np.asarray(frames)
    if values.ndim != 3 or values.size == 0 or values.dtype.kind not in "uifc":
        raise ValueError(
            f"expected numbers [frame row col], got shape {values.shape} of {values.dtype}"
        )
    values = values.astype(np.complex128 if values.dtype.kind == "c" else np.float64)
    offset = np.asarray(offset_px, dtype=np.float64)
    if offset.shape != (len(values), 2) or not np.isfinite(offset).all():
        raise ValueError(
            f"expected one finite (row, col) in offset_px for each of the {len(values)} frames, "
            f"got shape {offset.shape}"
        )
    if scale != int(scale) or scale < 1:
        raise ValueError(f"expected an integer scale of at least 1, got {scale}")
    share = np.ones(values.shape) if weight is None else np.asarray(weight, dtype=np.float64)
    if share.shape != values.shape:
        raise ValueError(f"expected a weight of shape {values.shape}, got {share.shape}")
    if not (np.isfinite(share).all() and (share >= 0).all()):
        raise ValueError("expected finite weights of at least 0")
    used = share > 0
    if not used.any():
        raise ValueError("every pixel has weight 0; nothing is left to use")
    if not np.isfinite(values[used]).all():
        raise ValueError("some pixels are NaN or infinite; give them a weight of 0")
    return np.where(used, values, 0.0), share, offset


def check_frame(
    frame: ArrayLike, weight: ArrayLike | None, offset_px: ArrayLike, scale: int
) -> tuple[NDArray[Any], NDArray[np.float64], NDArray[np.float64]]:
    """Check a single frame [row col] as `check_frames` does a stack of them."""
    frames, share, offset = check_frames(
        np.asarray(frame)[None],
        None if weight is None else np.asarray(weight)[None],
        np.asarray(offset_px)[None],
        scale,
    )
    return frames[0], share[0], offset[0]
