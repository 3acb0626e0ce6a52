"""Scaled conjugate gradients as in Netlab 3.3."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lensshift.core.arrays import Floats

_STEP = 1e-4
_SCALE_MIN, _SCALE_MAX = 1e-15, 1e100


def dot(a: Floats, b: Floats) -> float:
    """Return a . b without BLAS, whose threads cost more than the product on images this small."""
    return float(np.einsum("i,i", a, b))


def minimise_scg(
    objective: Callable[[Floats], float],
    gradient: Callable[[Floats], Floats],
    x: Floats,
    iterations: int,
    tolerance: float = 1e-3,
) -> tuple[Floats, float]:
    """Minimise a function by scaled conjugate gradients; return the point and its objective.

        curvature = d . (g(x + sigma d) - g(x)) / sigma,   sigma = 1e-4 / |d|
        step = -d . g / (curvature + beta |d|^2)

    A step is taken unless the objective rises (ratio of its change to the predicted one >= 0).

    It stops when max|step| and the change of the objective are both below `tolerance`.

    Source: Moller, Neural Networks 6 (1993); Nabney, Netlab 3.3, scg.
    """
    f, g = objective(x), gradient(x)
    d = -g
    beta, successes, success = 1.0, 0, True
    slope = square = curvature = 0.0
    for _ in range(iterations):
        if success:
            slope = dot(d, g)
            if slope >= 0:  # it does not go down
                d = -g
                slope = dot(d, g)
            square = dot(d, d)
            if square < np.finfo(np.float64).eps:
                break
            sigma = _STEP / np.sqrt(square)
            curvature = dot(d, gradient(x + sigma * d) - g) / sigma
        damped = curvature + beta * square
        if damped <= 0:
            damped = beta * square
            beta -= curvature / square
        step = -slope / damped
        x_new = x + step * d
        f_new = objective(x_new)
        ratio = 2.0 * (f_new - f) / (step * slope)
        success = ratio >= 0
        if success:
            successes += 1
            x, change, f = x_new, abs(f_new - f), f_new
            if np.abs(step * d).max() < tolerance and change < tolerance:
                break
            g_old, g = g, gradient(x)
            if not g.any():
                break
        if ratio < 0.25:  # the model was poor
            beta = min(4.0 * beta, _SCALE_MAX)
        if ratio > 0.75:
            beta = max(0.5 * beta, _SCALE_MIN)
        if successes == x.size:
            d, successes = -g, 0
        elif success:
            d = dot(g_old - g, g) / slope * d - g
    return x, f
