"""Where the pixels of ifm's cameras look: x right, y down, z forward."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lensshift.core.arrays import Array, Floats

_STEEPEST = 1e3  # tangent of 89.94 degrees: no pixel of a lens looks farther aside
BOUGUET = 0  # number of the model of `bouguet_directions` in an O3R's information


def sent_directions(vectors: Array | None, shape: tuple[int, ...]) -> Floats | None:
    """Return unit vectors [row col 3] as an O3D sends them if asked; None if they are not whole."""
    if vectors is None or vectors.shape != (*shape, 3):
        return None
    whole = np.isfinite(vectors).all() and vectors.any(axis=2).all()
    return vectors.astype(np.float64) if whole else None


def bouguet_directions(numbers: Sequence[float], shape: tuple[int, ...]) -> Floats | None:
    """Return the directions [row col 3] that an O3R's intrinsic numbers lead to.

        x = (col + 1/2 - mx) / fx - alpha y,  y = (row + 1/2 - my) / fy,  r^2 = x^2 + y^2
        right = x R + 2 k3 x y + k4 (r^2 + 2 x^2),  down = y R + k3 (r^2 + 2 y^2) + 2 k4 x y
        R = 1 + k1 r^2 + k2 r^4 + k5 r^6

    None where they are not numbers of a lens, as those of a camera without a calibration.

    numbers : fx, fy, mx, my, alpha, k1, k2, k3, k4, k5, and others that do not matter

    Source: ifm's public examples for the O3R, function `intrinsic_projection`.
    """
    fx, fy, mx, my, alpha, k1, k2, k3, k4, k5 = numbers[:10]
    if not np.isfinite(numbers[:10]).all() or not min(fx, fy) > 0:
        return None
    row, col = np.indices(shape)
    with np.errstate(over="ignore", invalid="ignore"):  # numbers of no lens
        y = (row + 0.5 - my) / fy
        x = (col + 0.5 - mx) / fx - alpha * y
        square, across = x * x + y * y, 2.0 * x * y
        radial = 1.0 + square * (k1 + square * (k2 + square * k5))
        right = x * radial + k3 * across + k4 * (square + 2.0 * x * x)
        down = y * radial + k3 * (square + 2.0 * y * y) + k4 * across
        vectors = np.stack([right, down, np.ones_like(right)], axis=-1)
        if not np.all(np.abs(vectors) < _STEEPEST):  # also if it is no number
            return None
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
