"""What residuals say of shifts: each goes with the slopes of its frame if that lies elsewhere."""

from __future__ import annotations

import numpy as np

from lensshift.core.arrays import Array, Mask
from lensshift.core.gaussian import MEDIAN_SIZE
from lensshift.core.local_means import mean_around
from lensshift.forward.differences import image_slopes
from lensshift.forward.operator import LinearOperator

# Pixels that are judged together, along a side: so few tell apart what moved and what did not.
WINDOW_PX = 5
# Errors like those of a shift by this are no contradiction: at an edge, a square pixel and the
# Gaussian of its width differ as by 0.06 px, shifts are told to 0.05 px or so, and detail finer
# than the grid adds to it (with 0.08 a right burst of fine bars and one of real frames warned).
ALLOWED_SHIFT_PX = 0.1
# Pixels beyond 3 sigma are outliers; beyond 5 they count no more, one of them proves nothing.
OUTLIER_SQUARE, MOST_SQUARE = 9.0, 25.0
# Something is somewhere else if it is off by twice as much, and a frame if it contradicts in so
# much of what would show it.
LEAST_OFF_PX, LEAST_SHARE, TELLING_SHARE = 0.2, 0.5, 0.25
# Of the noise of an LR pixel, a pixel: noise alone draws slopes of 0.06 (four frames of an even
# scene), which go with residuals as if a frame lay off by 0.006 / slope^2 px.
LEAST_SLOPE = 0.5
# Standard errors that a shift has to differ by (`shift_check.LEAST_T` is as sure).
SURE = 5.0
# So many pixels tell a mean of all to 1 %.
MOST_PIXELS = 10_000
# Steps in which pixels that are off for another reason come to count less.
REWEIGHTED = 4
# Of nothing, a shift is not known.
LEAST_KNOWN = 1e-9


def slopes_of(A: LinearOperator, image: Array, scale: int) -> tuple[Array, Array]:
    """Return slopes [axis frame row col] of the frames, and their mean square around each pixel.

    By an LR pixel; times the square of the error of a shift, the second is what that error leaves.
    """
    of_frames = np.stack([scale * A.forward(np.ascontiguousarray(g)) for g in image_slopes(image)])
    square = np.sum(np.abs(of_frames) ** 2, axis=0)
    return of_frames, around(square, np.ones_like(square), 3, 0.0)


def displaced(r: Array, slopes: Array, variance: Array, seen: Array) -> Array:
    """Return [frame row col] how surely what is around each pixel lies elsewhere, above 1 if so.

        d^2 / (e^2 + t^2 / l),   l = sum (u g)^2 / s^2,   d = sum (u g) r / s^2 / l

    g the slopes, u both principal directions of sum g g^T / s^2 over a window: a shift d by more
    than e that is t standard errors from none. What moved a little goes along with its slopes long
    before it leaves large residuals. Outliers count as far as they are like the others, and errors
    that neighbours share, as of a camera that compresses, as they usually are.

    Parameters
    ----------
    r : [frame row col] residuals
    slopes : [axis frame row col] as from `slopes_of`
    variance : [frame row col] of r, what errors of the model leave with it
    seen : [frame row col] 1 where a pixel is looked at, else 0
    """
    down, right = slopes
    weight = seen / np.maximum(variance, np.abs(r) ** 2 / OUTLIER_SQUARE)
    products = [down.conj() * down, down.conj() * right, right.conj() * right]
    products += [down.conj() * r, right.conj() * r]
    weighed = np.stack([product.real * weight for product in products])
    a, b, c, p, q = WINDOW_PX**2 * mean_around(weighed, WINDOW_PX, zeros=True)
    mean, half = (a + c) / 2, np.hypot((a - c) / 2, b)
    cos = np.sqrt(np.clip(0.5 + (a - c) / 4 / np.maximum(half, LEAST_KNOWN), 0.0, 1.0))
    sin = np.copysign(np.sqrt(1.0 - cos**2), b)
    known = np.maximum(np.stack([mean + half, mean - half]), LEAST_KNOWN)
    pull = np.stack([cos * p + sin * q, cos * q - sin * p])
    squares = pull[0] ** 2 / known[0]
    # Errors of a camera are in every frame; what moves is where the picture has it in some.
    ordinary = usual(some_pixels(squares), some_pixels(known[0]))[seen.any(axis=(1, 2))]
    chance = max(float(ordinary.min(initial=np.inf)) / MEDIAN_SIZE**2, 1.0)
    least = LEAST_OFF_PX**2 * known**2 + SURE**2 * chance * known
    return np.asarray(np.max(pull**2 / least, axis=0))


def usual(values: Array, weight: Array) -> Array:
    """Return the weighted median [frame] of values [frame pixel]."""
    order = np.argsort(values, axis=-1)
    total = np.cumsum(np.take_along_axis(weight, order, -1), axis=-1)
    middle = np.argmax(total >= total[:, -1:] / 2, axis=-1)[:, None]
    return np.take_along_axis(values, np.take_along_axis(order, middle, -1), -1)[:, 0]


def around(values: Array, seen: Array, side_px: int, missing: float) -> Array:
    """Return the mean [frame row col] around each pixel; those not seen count as `missing`."""
    return missing + mean_around((values - missing) * seen, side_px, zeros=True)


def some_pixels(values: Array) -> Array:
    """Return pixels [... pixel] of pictures [... row col], spread over all where they are many."""
    flat = values.reshape(*values.shape[:-2], -1)
    return flat[..., :: max(1, flat.shape[-1] // MOST_PIXELS) | 1]


def fits(terms: Array, variance: Array, r: Array, on: Mask) -> tuple[Array, Array]:
    """Return the weighted least-squares coefficients [frame term] and their covariance.

    Parameters
    ----------
    terms : [frame term pixel]
    variance, r, on : [frame pixel], on: where to look
    """
    weighed = terms.conj() * (on / variance)[:, None]
    values, vectors = np.linalg.eigh((weighed @ terms.swapaxes(1, 2)).real)
    told = values > 1e-9 * values[:, -1:]
    inverse = told / np.where(told, values, 1.0)
    covariance = (vectors * inverse[:, None]) @ vectors.swapaxes(1, 2)
    return (covariance @ (weighed @ r[..., None]).real)[..., 0], covariance


def reweighted(terms: Array, variance: Array, r: Array, on: Mask) -> tuple[Array, Array]:
    """Do what `fits` does; pixels that are off by more for another reason count less each time."""
    left = r
    for _ in range(REWEIGHTED):
        odd = np.maximum(np.abs(left) ** 2 / variance / OUTLIER_SQUARE, 1.0)
        found, covariance = fits(terms, variance * odd, r, on)
        left = r - (found[:, None] @ terms)[:, 0]
    return found, covariance


def told_shifts(found_px: Array, covariance: Array) -> tuple[Array, Array]:
    """Return by how much [frame 2] frames lie off the usual one, and the error [frame] of that.

    Along directions in which they surely do: along a single edge nothing tells a shift.
    """
    _, along = np.linalg.eigh(covariance.sum(axis=0))
    own = found_px @ along
    own = own - np.median(own, axis=0)
    error = np.sqrt(np.maximum(np.einsum("ia,kij,ja->ka", along, covariance, along), 0.0))
    sure = np.abs(own) > SURE * error
    shifts = np.where(sure, own, 0.0) @ along.T
    return shifts, np.linalg.norm(np.where(sure, error, 0.0), axis=1)


def elsewhere(
    r: Array, slopes: Array, variance: Array, used: Mask, doubt: Array, limit: float
) -> tuple[dict[int, tuple[float, float]], bool]:
    """Return how far frames lie from where they should, and whether most of the picture says so.

    The residuals of a frame that lies elsewhere go with its slopes; where these are large it has to
    contradict. Outliers count as far as they are like the others. Directions in which a shift is
    not told, as along a single edge, are left out. So are slopes that may be noise: that is in the
    residuals of its frame as well, and goes with them.
    """
    energy = np.sum(np.abs(slopes) ** 2, axis=0)
    on = some_pixels(
        used & (around(energy, np.ones_like(energy), 3, 0.0) > LEAST_SLOPE**2 * variance)
    )
    enough = on.sum(axis=-1) >= WINDOW_PX**2
    known = some_pixels(slopes.swapaxes(0, 1))
    found, covariance = reweighted(known, some_pixels(variance), some_pixels(r), on)
    shifts, error = told_shifts(np.where(enough[:, None], -found, 0.0), covariance)
    off_px, everywhere = {}, True
    for k, (down, right) in enumerate(shifts):
        if not enough[k] or np.hypot(down, right) - SURE * error[k] < LEAST_OFF_PX:
            continue
        shown = np.abs(down * slopes[0, k] + right * slopes[1, k]) ** 2 / variance[k]
        square = around(np.minimum(shown, MOST_SQUARE), used[k], WINDOW_PX, 1.0)
        telling = used[k] & (square > limit)
        if not telling.any() or np.mean(doubt[k][telling] > 1.0) >= LEAST_SHARE:
            off_px[k] = (float(down), float(right))
            everywhere &= float(telling[used[k]].mean()) > TELLING_SHARE
    return off_px, everywhere
