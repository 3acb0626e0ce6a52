"""Linear operators as values: two shapes, forward, adjoint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array


@dataclass(frozen=True, slots=True)
class LinearOperator:
    """y = A x between N-D arrays, with the exact adjoint beside it.

    ValueError if it is called with an array of another shape than `in_shape`.
    """

    in_shape: tuple[int, ...]
    out_shape: tuple[int, ...]
    forward: Callable[[Array], Array]
    adjoint: Callable[[Array], Array]

    def __call__(self, x: Array) -> Array:
        """Return A x, after a check of the shape."""
        if x.shape != self.in_shape:
            raise ValueError(f"operator expects an array of shape {self.in_shape}, got {x.shape}")
        return self.forward(x)


def chained(second: LinearOperator, first: LinearOperator) -> LinearOperator:
    """Return x -> second(first(x))."""
    return LinearOperator(
        first.in_shape,
        second.out_shape,
        lambda x: second.forward(first.forward(x)),
        lambda y: first.adjoint(second.adjoint(y)),
    )


def single(values: Array) -> Array:
    """Return real or complex values in single precision, which is enough to judge a picture by."""
    return values.astype(np.complex64 if values.dtype.kind == "c" else np.float32, copy=False)


def mean_seen(A: LinearOperator, values: Array, weight: Array) -> Array:
    """Return at each HR pixel the mean of values of at least 0 over the LR pixels that see it.

        A^T (w v) / A^T w,   0 <= it <= max v

    Skewed responses have taps below 0 where they fade, so beside LR pixels without weight neither
    sum is sure to be positive; a mean stays among what it is of.

    Parameters
    ----------
    values, weight : [frame row col]; weights of at least 0
    """
    mean = A.adjoint(weight * values) / np.maximum(A.adjoint(weight), 1e-9)
    most = float(np.max(values, where=weight > 0, initial=0.0))
    return np.clip(mean, 0.0, most, out=mean)


def by_parts(apply: Callable[[Array], Array], values: Array) -> Array:
    """Apply a real linear map to the real and to the imaginary part of values.

    Single precision stays single; all but floating-point numbers count as double.
    """
    if values.dtype.kind == "c":
        parts = [apply(np.ascontiguousarray(part)) for part in (values.real, values.imag)]
        both = np.empty(parts[0].shape, np.result_type(parts[0], np.complex64))
        both.real, both.imag = parts
        return both
    kind = np.float32 if values.dtype == np.float32 else np.float64
    return apply(np.ascontiguousarray(values, kind))
