"""The forward model once more, slowly and by other means: quadrature, optimisation and loops."""

import math

import numpy as np
import scipy.integrate
import scipy.optimize
import scipy.sparse
import scipy.special

from lensshift.forward.blur import APERTURE_TAIL, GAUSSIAN_TAIL, ApertureBlur, GaussianBlur


def response(blur: GaussianBlur | ApertureBlur, v: float, scale: int) -> dict[int, float]:
    """Return {HR index: weight} of a pixel centred at HR coordinate v of an endless image."""
    if isinstance(blur, GaussianBlur):
        return gaussian_response(v, blur.sigma_px * scale)
    return aperture_response(v, blur.fill_factor * scale, blur.optics_sigma_px * scale)


def gaussian_response(v: float, sigma: float) -> dict[int, float]:
    below = math.floor(v)
    p = v - below
    if sigma**2 <= p * (1 - p) + 1e-12:
        return {below: 1 - p, below + 1: p}
    peak = min(1.0, 1 / (sigma * math.sqrt(2 * math.pi)))
    reach = max(1.5, sigma * math.sqrt(2 * math.log(max(100.0, peak / GAUSSIAN_TAIL))))
    taps = [n for n in range(below - 99, below + 100) if abs(n - v) <= reach + 1e-9]
    d = np.array(taps) - v

    if len(taps) == 3:  # the moments leave no freedom
        w = np.linalg.solve(np.stack([d**0, d, d**2]), [1.0, 0.0, sigma**2])
        return dict(zip(taps, w, strict=True))

    def miss(theta: np.ndarray) -> np.ndarray:
        w = scipy.special.softmax(theta[0] * d + theta[1] * d**2)
        return np.array([w @ d, w @ d**2 - sigma**2])

    found = scipy.optimize.root(miss, [0.0, -0.5 / sigma**2], method="hybr", tol=1e-13)
    if np.abs(found.fun).max() > 1e-11:
        raise AssertionError(f"no Gaussian found at v = {v}, sigma = {sigma}: {found.message}")
    w = scipy.special.softmax(found.x[0] * d + found.x[1] * d**2)
    return dict(zip(taps, w, strict=True))


def aperture_response(v: float, width: float, sigma: float) -> dict[int, float]:
    weights = {}
    for n in range(math.floor(v - width - 8 * sigma) - 2, math.ceil(v + width + 8 * sigma) + 3):
        if sigma == 0:
            overlap = min(n + 0.5, v + width / 2) - max(n - 0.5, v - width / 2)
            weight = max(overlap, 0.0) / width
        else:
            weight = scipy.integrate.quad(
                lambda t: (
                    (
                        scipy.special.ndtr((t - v + width / 2) / sigma)
                        - scipy.special.ndtr((t - v - width / 2) / sigma)
                    )
                    / width
                ),
                n - 0.5,
                n + 0.5,
                epsabs=1e-13,
            )[0]
        if weight >= APERTURE_TAIL:
            weights[n] = weight
    total = sum(weights.values())
    return {n: w / total for n, w in weights.items()}


def on_image(weights: dict[int, float], size: int) -> dict[int, float]:
    kept = {n: w for n, w in weights.items() if 0 <= n < size and w > 0}
    if not kept:
        return {0 if min(weights) < 0 else size - 1: 1.0}
    total = sum(kept.values())
    return {n: w / total for n, w in kept.items()}


def system_matrix(
    lr_shape: tuple[int, int],
    scale: int,
    shift_field_px: np.ndarray,
    blur: GaussianBlur | ApertureBlur,
) -> scipy.sparse.csr_array:
    """Return the matrix from the raveled HR image to the raveled frames [frame row col]."""
    hr_rows, hr_cols = lr_shape[0] * scale, lr_shape[1] * scale
    known: dict[tuple[float, int], dict[int, float]] = {}

    def axis_response(u: int, offset: float, size: int) -> dict[int, float]:
        v = scale * (u - offset) + (scale - 1) / 2
        key = (v, size)
        if key not in known:
            known[key] = on_image(response(blur, v, scale), size)
        return known[key]

    matrix = scipy.sparse.lil_array((shift_field_px.size // 2, hr_rows * hr_cols))
    pixel = 0
    for frame in shift_field_px:
        for u in range(lr_shape[0]):
            for w in range(lr_shape[1]):
                row_response = axis_response(u, frame[u, w, 0], hr_rows)
                col_response = axis_response(w, frame[u, w, 1], hr_cols)
                for i, row_weight in row_response.items():
                    for j, col_weight in col_response.items():
                        matrix[pixel, i * hr_cols + j] = row_weight * col_weight
                pixel += 1
    return matrix.tocsr()
