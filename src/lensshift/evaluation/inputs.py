"""What measurements take: real images of one shape, or a `ValueError` that says what is wrong."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats, Mask


def real_array(values: ArrayLike, name: str, axes: str = "[row col]") -> Floats:
    """Return a real array with so many axes as floats; not empty, but perhaps not finite."""
    array = np.asarray(values)
    if array.dtype.kind not in "buif":
        raise ValueError(f"expected a real {name}, got dtype {array.dtype}")
    if array.ndim != len(axes.split()) or array.size == 0:
        raise ValueError(f"expected the {name} as {axes}, got shape {array.shape}")
    return array.astype(np.float64)


def check_finite(values: Floats, within: str = "") -> None:
    """Raise if a value is not finite; `within` ends the message."""
    if bad := int(np.count_nonzero(~np.isfinite(values))):
        raise ValueError(f"expected finite pixels, got {bad} NaN or infinite{within}")


def mask_array(valid: ArrayLike | None, shape: tuple[int, ...]) -> Mask:
    """Return a boolean mask, all true for None."""
    if valid is None:
        return np.ones(shape, dtype=np.bool_)
    mask = np.asarray(valid)
    if mask.shape != shape or mask.dtype != np.bool_:
        raise ValueError(
            f"expected a boolean mask of shape {shape}, got {mask.dtype} of shape {mask.shape}"
        )
    return mask


def check_shape(image: Floats, truth: Floats) -> None:
    """Raise if the shapes of image and truth differ."""
    if image.shape != truth.shape:
        raise ValueError(f"expected an image of shape {truth.shape}, got {image.shape}")
