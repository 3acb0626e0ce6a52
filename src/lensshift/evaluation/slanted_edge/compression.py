"""What a JPEG has cut off an edge, the same in all its blocks: no residual shows it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates

from lensshift.evaluation.slanted_edge.edge_model import Matrix, Vector

_SIDE = 8  # of a block, in pixels


def steps_of(given: ArrayLike) -> Matrix:
    """Return the quantisation table [8 8]; `ValueError` if it is none."""
    steps = np.asarray(given, dtype=np.float64)
    if steps.shape != (_SIDE, _SIDE) or not np.all(np.isfinite(steps) & (steps > 0.0)):
        raise ValueError(f"expected positive jpeg_steps [8 8], got shape {steps.shape}")
    return steps


def lost_std(
    frequency_cpp: Vector, modulation: Vector, steps: Matrix, direction: Vector, noise: float
) -> Vector:
    """Return [f]: the standard deviation of the modulation that rounding in blocks makes.

        sigma = q g / sqrt(3) exp(-2 pi^2 s^2 / q^2) min(1, sqrt(q / A) / 2),   A = M / (2 g)

    An edge of height 1 has the coefficient A at most in blocks of orthonormal cosines; g is
    pi f, for a normal along rows or columns over sqrt(2). Rounding to a step q cuts off what
    is within q / 2, in every block alike: blocks do not average it. Noise s dithers it (the first
    harmonic of the error), and where the coefficient is many steps large its places within the
    blocks do.

    frequency_cpp : along the normal of the edge
    modulation : there
    steps : quantisation table [row col], over the contrast
    direction : of the normal (row, col)
    noise : of a pixel, over the contrast

    Source: Widrow and Kollar, Quantization Noise, 2008, of the harmonics.
    """
    row, col = np.minimum(2.0 * _SIDE * np.abs(direction)[:, None] * frequency_cpp, _SIDE - 1.0)
    step = map_coordinates(steps, [row, col], order=1)
    oblique = np.minimum(1.0, np.minimum(row, col))
    gain = np.pi * frequency_cpp * np.sqrt(0.5 + 0.5 * oblique)
    coefficient = np.maximum(modulation / np.maximum(2.0 * gain, 1e-9), 1e-9)
    dithered = np.exp(-2.0 * (np.pi * noise / step) ** 2)
    dithered *= np.minimum(1.0, 0.5 * np.sqrt(step / coefficient))
    return np.asarray(step * gain / np.sqrt(3.0) * dithered)


def with_losses(
    transform: NDArray[np.complex128], frequency_cpp: Vector, std: Vector, seed: int
) -> NDArray[np.complex128]:
    """Return the draws [f k] of a transform, all but the first with errors of deviation [f].

    Those of neighbouring coefficients, 1/16 cycles a pixel apart, are independent.
    """
    place = 2.0 * _SIDE * frequency_cpp
    low = place.astype(np.intp)
    share = (place - low)[:, None]
    rng = np.random.default_rng(seed)
    errors = rng.standard_normal((int(low.max()) + 2, transform.shape[1] - 1))
    between = (1.0 - share) * errors[low] + share * errors[low + 1]
    between *= std[:, None] / np.sqrt((1.0 - share) ** 2 + share**2)
    spread = transform.copy()
    spread[:, 1:] += between * np.exp(1j * np.angle(transform[:, 1:]))
    return spread
