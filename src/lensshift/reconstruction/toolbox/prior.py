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
        image = x.reshape(self.shape)
        padded = np.pad(image, self.window, mode="symmetric")
        loss = np.empty(self.shape)
        total = 0.0
        for (row, col), weight in zip(
            directions(self.window), self._weights_by_columns, strict=True
        ):
            np.subtract(_shifted(padded, self.shape, self.window, row, col), image, out=loss)
            np.multiply(loss, loss, out=loss)
            np.add(loss, SMOOTHING, out=loss)
            np.sqrt(loss, out=loss)
            total += self.alpha ** (abs(row) + abs(col)) * float(np.einsum("ij,ij", weight, loss))
        return total

    def gradient(self, x: Floats) -> Floats:
        """Return what the toolbox takes for the gradient of R, as a vector."""
        image = x.reshape(self.shape)
        padded = np.pad(image, self.window, mode="symmetric")
        slope, term, gradient = np.empty(self.shape), np.empty(self.shape), np.zeros(self.shape)
        for (row, col), weight in zip(directions(self.window), self.weights, strict=True):
            np.subtract(image, _shifted(padded, self.shape, self.window, row, col), out=slope)
            np.multiply(slope, slope, out=term)
            np.add(term, SMOOTHING, out=term)
            np.sqrt(term, out=term)
            np.divide(slope, term, out=slope)
            term[...] = slope
            here, there = _overlap(self.shape, row, col)
            term[here] -= slope[there]
            np.multiply(term, weight, out=term)
            np.multiply(term, self.alpha ** (abs(row) + abs(col)), out=term)
            gradient += term
        return gradient.ravel()


def _overlap(
    shape: tuple[int, ...], row: int, col: int
) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Return the pixels u whose partner u + (row, col) is inside the image, and the partners."""
    here = tuple(
        slice(max(-step, 0), size - max(step, 0))
        for step, size in zip((row, col), shape, strict=True)
    )
    there = tuple(
        slice(max(step, 0), size - max(-step, 0))
        for step, size in zip((row, col), shape, strict=True)
    )
    return here, there


def _shifted(padded: Floats, shape: tuple[int, ...], window: int, row: int, col: int) -> Floats:
    """Return S x with (S x)[i, j] = x[i - row, j - col], cut out of the padded image."""
    return padded[window - row : window - row + shape[0], window - col : window - col + shape[1]]
