"""The toolbox's weighted bilateral total variation, with its two pixel orders."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lensshift.core.arrays import Floats
from lensshift.reconstruction.quantiles import median_3x3

SMOOTHING = 1e-4


def directions(window: int) -> list[tuple[int, int]]:
    """Return the shifts (row, col) of the window without (0, 0), rows outermost."""
    span = range(-window, window + 1)
    return [(row, col) for row in span for col in span if (row, col) != (0, 0)]


def sparse_transform(image: Floats, window: int, alpha: float) -> Floats:
    """Return z [direction row col] = alpha^(|l|+|m|) (S_lm x - x), 3 x 3 median filtered."""
    padded = np.pad(image, window, mode="symmetric")
    steps = directions(window)
    found = np.empty((len(steps), *image.shape))
    for (row, col), out in zip(steps, found, strict=True):
        slope = _shifted(padded, image.shape, window, row, col) - image
        median_3x3(slope, alpha ** (abs(row) + abs(col)), out)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class WeightedBtv:
    """Weighted BTV as the toolbox evaluates it.

        R(x) = sum_lm alpha^(|l|+|m|) sum_i a_lm,i sqrt(e_i^2 + 1e-4),   e = S_lm x - x

    Defects kept on purpose: `value` pairs the weights, which are stored by rows, with differences
    counted by columns; `gradient` multiplies by the unshifted weights, where the derivative needs
    them shifted with the difference, and shifts back with zeros, which is not the adjoint of
    the mirrored border.

    Parameters
    ----------
    shape : (rows, cols) of the image
    weights : [direction row col]

    Source: btvPriorWeighted and btvPriorWeighted_grad of the toolbox.
    """

    shape: tuple[int, ...]
    window: int
    alpha: float
    weights: Floats
    _weights_by_columns: Floats = field(init=False)

    def __post_init__(self) -> None:
        # The weight vector runs by rows, but `value` of the toolbox reads it by columns.
        misread = self.weights.reshape(-1, *self.shape[::-1]).swapaxes(1, 2)
        object.__setattr__(self, "_weights_by_columns", np.ascontiguousarray(misread))

    def value(self, x: Floats) -> float:
        """Return R(x)."""
        total = 0.0
        for share, slope, weight in zip(*self._slopes(x), self._weights_by_columns, strict=True):
            total += share * float(np.einsum("ij,ij", weight, np.sqrt(slope**2 + SMOOTHING)))
        return total

    def gradient(self, x: Floats) -> Floats:
        """Return what the toolbox takes for the gradient of R, as a vector."""
        gradient = np.zeros(self.shape)
        steps = directions(self.window)
        for step, share, slope, weight in zip(steps, *self._slopes(x), self.weights, strict=True):
            term = slope / np.sqrt(slope**2 + SMOOTHING)
            here, there = _overlap(self.shape, *step)
            back = term[there].copy()
            term[here] -= back
            gradient += term * weight * share
        return gradient.ravel()

    def _slopes(self, x: Floats) -> tuple[list[float], list[Floats]]:
        """Return alpha^(|l|+|m|) and x - S_lm x [row col] of each direction."""
        image = x.reshape(self.shape)
        padded = np.pad(image, self.window, mode="symmetric")
        steps = directions(self.window)
        slopes = [image - _shifted(padded, self.shape, self.window, *step) for step in steps]
        return [self.alpha ** (abs(row) + abs(col)) for row, col in steps], slopes


def _overlap(
    shape: tuple[int, ...], row: int, col: int
) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return the pixels u whose partner u + (row, col) is inside the image, and the partners."""
    here, there = (
        tuple(
            slice(max(-way * step, 0), size - max(way * step, 0))
            for step, size in zip((row, col), shape, strict=True)
        )
        for way in (1, -1)
    )
    return here, there


def _shifted(padded: Floats, shape: tuple[int, ...], window: int, row: int, col: int) -> Floats:
    """Return S x with (S x)[i, j] = x[i - row, j - col], cut out of the padded image."""
    return padded[window - row : window - row + shape[0], window - col : window - col + shape[1]]
