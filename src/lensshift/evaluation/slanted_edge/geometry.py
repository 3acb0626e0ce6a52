"""Where the edge lies in a region: a first guess from all pixels, refined by least squares."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from lensshift.evaluation.slanted_edge.edge_model import Matrix, Vector, core_slopes

_ANGLE_STEP_RAD = np.deg2rad(1.0)
_COARSE = 4  # so many steps at a time first
_BIN_PX = 0.5
_SMALLEST_SIDE_SHARE = 0.03  # of the pixels, on the smaller side of the edge
_SETTLED = 1e-5
_MOST_PIXELS = 10_000
_MOST_NEAR = 4_000
_NEAR_PX = 12.0
_SIGMA_BOUNDS_PX = (0.08, 30.0)


@dataclass(frozen=True, slots=True)
class EdgeLine:
    """A straight edge x cos t + y sin t = rho; x along the columns, y along the rows."""

    angle_rad: float  # direction t of the normal, which points to the bright side
    position_px: float  # rho, from the origin of the coordinates
    sigma_px: float  # width of the Gaussian that fits best, beside the pixel aperture
    low: float  # level of the dark plateau
    high: float  # of the bright one


def find_edge(x_px: Vector, y_px: Vector, values: Vector, aperture_px: float) -> EdgeLine:
    """Find the straight edge that splits n pixels at x, y best, and fit it; ValueError if none."""
    keep: NDArray[np.intp] | slice = slice(None)
    if values.size > _MOST_PIXELS:
        keep = np.random.default_rng(0).choice(values.size, _MOST_PIXELS, replace=False)
    explained, angle_rad, position_px = _best_step(x_px[keep], y_px[keep], values[keep])
    if np.ptp(values[keep]) == 0.0 or explained <= 0.0:
        raise ValueError("expected an edge between two levels, got a flat region")
    reach_px = _NEAR_PX
    for _ in range(2):  # a blurred edge needs a wider strip
        distance_px = x_px * np.cos(angle_rad) + y_px * np.sin(angle_rad) - position_px
        some = np.flatnonzero(np.abs(distance_px) < reach_px)
        some = some[:: max(1, -(-some.size // _MOST_NEAR))]
        line = _refined(x_px[some], y_px[some], values[some], angle_rad, position_px, aperture_px)
        angle_rad, position_px, reach_px = line.angle_rad, line.position_px, 5 * line.sigma_px
        if line.sigma_px < _NEAR_PX / 4:
            break
    return line


def explained_share(
    x_px: Vector, y_px: Vector, values: Vector, near_rad: float | None = None
) -> float:
    """Return the share of the variance that one step (towards `near_rad`, if told) explains."""
    variance = float(np.var(values)) * values.size
    if np.ptp(values) == 0.0 or variance <= 0.0:  # the mean of equal values is rounded
        return 0.0
    if near_rad is None:
        return _best_step(x_px, y_px, values)[0] / variance
    near = near_rad + _ANGLE_STEP_RAD * np.arange(1 - _COARSE, _COARSE)
    return max(_steps(x_px, y_px, values - values.mean(), near))[0] / variance


def _best_step(x_px: Vector, y_px: Vector, values: Vector) -> tuple[float, float, float]:
    """Return the share of the variance that the best step explains, its angle and position."""
    centred = values - values.mean()
    wide = np.arange(-np.pi / 4, 3 * np.pi / 4, _COARSE * _ANGLE_STEP_RAD)
    best = max(_steps(x_px, y_px, centred, wide))
    near = best[1] + _ANGLE_STEP_RAD * np.arange(1 - _COARSE, _COARSE)
    return max(_steps(x_px, y_px, centred, near))


def _steps(
    x_px: Vector, y_px: Vector, centred: Vector, angles_rad: Vector
) -> list[tuple[float, float, float]]:
    """Return what the best step at each angle explains, its angle and position."""
    found = []
    smallest = max(2.0, _SMALLEST_SIDE_SHARE * centred.size)
    for angle_rad in angles_rad:
        place = x_px * np.cos(angle_rad) + y_px * np.sin(angle_rad)
        lowest = place.min()
        bins = ((place - lowest) / _BIN_PX).astype(np.intp)
        count = np.bincount(bins).cumsum()
        total = np.bincount(bins, weights=centred).cumsum()
        inside = (count >= smallest) & (count <= centred.size - smallest)
        rest = np.where(inside, centred.size - count, 1)
        explained = np.where(inside, total**2 * centred.size / np.maximum(count, 1) / rest, 0.0)
        k = int(np.argmax(explained))
        sign = -1.0 if total[k] > 0 else 1.0  # bright first: turn the normal round
        turned = float(angle_rad) + (np.pi if sign < 0 else 0.0)
        turned = float((turned + np.pi) % (2 * np.pi) - np.pi)
        found.append((float(explained[k]), turned, sign * (lowest + (k + 1) * _BIN_PX)))
    return found


def _refined(
    x_px: Vector, y_px: Vector, values: Vector, angle_rad: float, position_px: float,
    aperture_px: float,
) -> EdgeLine:  # fmt: skip
    """Fit angle, position and log width, the levels eliminated."""
    ones = np.ones_like(values)

    @lru_cache(maxsize=1)  # residuals and slopes are asked for at the same place
    def seen(*parameters: float) -> tuple[Matrix, Matrix, Vector]:
        """Return 1 and response [2 n], this with its slopes [4 n], and the levels that fit best."""
        angle, position, log_sigma = parameters
        normal_px = x_px * np.cos(angle) + y_px * np.sin(angle) - position
        slopes = core_slopes(normal_px, angle, float(np.exp(log_sigma)), aperture_px)
        columns = np.stack([ones, slopes[0]])
        ridge = 1e-9 * np.eye(2)  # an edge that left the region has no contrast to find
        return columns, slopes, np.linalg.solve(columns @ columns.T + ridge, columns @ values)

    def residual(parameters: Vector) -> Vector:
        columns, _, factors = seen(*parameters)
        return np.asarray((factors @ columns - values) / scale)

    def jacobian(parameters: Vector) -> Matrix:
        """Return [n 3], the levels followed to first order (Kaufman, BIT 15 (1975) 49)."""
        columns, slopes, factors = seen(*parameters)
        angle = parameters[0]
        turned = slopes[3] * (y_px * np.cos(angle) - x_px * np.sin(angle))
        moves = factors[1] / scale * np.stack([turned, -slopes[3], slopes[1]])
        shares = np.linalg.solve(columns @ columns.T + 1e-9 * np.eye(2), columns @ moves.T)
        return np.asarray((moves - shares.T @ columns).T)

    scale = max(float(np.std(values)), np.finfo(float).tiny)
    narrow, wide = np.log(_SIGMA_BOUNDS_PX)
    reach_px = 0.3 * float(max(np.ptp(x_px), np.ptp(y_px), 1.0))
    bounds = (
        [angle_rad - 0.3, position_px - reach_px, narrow],
        [angle_rad + 0.3, position_px + reach_px, wide],
    )
    fit = least_squares(
        residual, [angle_rad, position_px, np.log(0.6)], jac=jacobian, x_scale=[0.01, 0.05, 0.2],
        bounds=bounds, ftol=_SETTLED, xtol=_SETTLED, max_nfev=40,
    ).x  # fmt: skip
    angle_rad, position_px, log_sigma = fit.tolist()
    dark, contrast = seen(*fit)[2].tolist()
    return EdgeLine(angle_rad, position_px, float(np.exp(log_sigma)), dark, dark + contrast)
