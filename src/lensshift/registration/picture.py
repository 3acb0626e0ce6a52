"""Shifts through the picture that all frames show, and which shifts predict frames better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lensshift.core.arrays import Array
from lensshift.core.gaussian import MEDIAN_SIZE
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.least_squares import smooth_fit
from lensshift.forward.model import ForwardModel, forward_model
from lensshift.forward.operator import LinearOperator
from lensshift.registration.blocks import scatter_over_blocks
from lensshift.registration.likelihood import ShiftFit
from lensshift.registration.spectrum import PIXEL_SIGMA_PX

Shifts = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A grid that holds the first aliases, by which shifts are told apart.
SCALE = 2
# Of second differences in the picture, relative to the frames: a soft low pass.
STIFFNESS = 0.03
FIRST_ITERATIONS, ITERATIONS = 60, 15
MAX_ROUNDS, CONVERGED_PX, MAX_STEP_PX = 12, 2e-3, 0.2
# Residuals beyond so many standard deviations count by their size, not its square.
HUBER_SIGMAS = 2.0
# A shift that is known to a pixel is not known.
UNKNOWN_PX = 1.0
# Fewer frames fit a picture wherever they lie; and fewer than three in each half predict others by
# what smoothness adds.
LEAST_FRAMES, LEAST_PREDICTING = 4, 6
# Shifts are refuted by others that predict so much better, as a belief in noise is
# (`reconstruction.learned.belief`): in 96 simulated bursts none that erred more did.
BETTER = 0.97


def better_shifts(fit: ShiftFit, frames: Array, valid: Mask, reference: int) -> ShiftFit:
    """Return shifts through the picture, if they predict frames better than the fit does.

    Else the fit, its errors widened by what the two disagree beyond theirs,

        excess^2 = mean over frames (d - d')^2 - sigma^2 - sigma'^2

    Parameters
    ----------
    frames, valid : [frame row col]
    reference : frame whose offset stays as it is
    """
    if len(frames) < LEAST_FRAMES:
        return fit
    other = picture_shifts(frames, valid, fit.offset_px, reference=reference)
    if len(frames) >= LEAST_PREDICTING:
        error, _ = prediction_error(frames, valid, fit.offset_px)
        other_error, apart_px = prediction_error(frames, valid, other.offset_px)
        # Half of the frames disagree with the other half by twice the variance of all.
        variance = np.mean((apart_px - np.median(apart_px, axis=0)) ** 2, axis=0)
        other = _widened(other, variance, reference)
        if other_error < BETTER * error:
            return _where_known(replace(other, gain=fit.gain), fit)
    square = (fit.offset_px - other.offset_px) ** 2 - fit.sigma_px**2 - other.sigma_px**2
    excess = np.maximum(np.delete(square, reference, axis=0).mean(axis=0), 0.0)
    return _widened(fit, excess, reference)


def _where_known(other: ShiftFit, fit: ShiftFit) -> ShiftFit:
    """Return the other shifts but along what the fit knows nothing of, as along a single edge.

    There a picture drifts, and what it is told by is the noise.
    """
    variance, along = np.linalg.eigh(fit.covariance_px2)
    blind = along * (variance > UNKNOWN_PX**2)
    drift_px = blind @ blind.T @ (other.offset_px - fit.offset_px).ravel()
    return replace(
        other,
        offset_px=other.offset_px - drift_px.reshape(-1, 2),
        covariance_px2=other.covariance_px2 + (blind * variance) @ blind.T,
    )


def _widened(fit: ShiftFit, variance_px2: Shifts, reference: int) -> ShiftFit:
    """Return the fit with a variance (row, col) more for each frame but the reference."""
    more = np.tile(variance_px2, (len(fit.offset_px), 1))
    more[reference] = 0.0
    return replace(fit, covariance_px2=fit.covariance_px2 + np.diag(more.ravel()))


def picture_shifts(frames: Array, valid: Mask, start_px: Shifts, *, reference: int = 0) -> ShiftFit:
    """Find picture and shifts in turn, from shifts that are right to a fraction of a pixel.

        minimise over x, d   sum |y_k - A(d_k) x|^2 + s |L x|^2

    Nothing is taken for known of the scene but that it is smooth on a grid twice as fine, of the
    noise but that few residuals are large. Where the model of `likely_shifts` is right this is
    less exact, and biased where print is finer than the grid; where it is wrong (frames that
    cameras sharpen, compress or turn) this follows the frames.

    Parameters
    ----------
    frames, valid : [frame row col]
    start_px : [frame 2]
    reference : frame whose offset stays as it is
    """

    found = _alternate(frames, valid, start_px, reference)

    def estimate(part: Array, part_valid: Mask) -> tuple[Shifts, Shifts]:
        alone = _alternate(part, part_valid, found.offset_px, reference)
        return alone.offset_px, alone.sigma_px

    factor = scatter_over_blocks(estimate, frames, valid, found.offset_px)
    return replace(found, covariance_px2=found.covariance_px2 * factor**2)


def prediction_error(frames: Array, valid: Mask, offset_px: Shifts) -> tuple[float, Shifts]:
    """Return the mean error of frames that are predicted from every other one.

    And by how much [frame 2] their shifts seem to be off in these pictures.
    """
    frames = frames - frames[valid].mean()
    steps = np.zeros_like(offset_px)
    total, half = 0.0, np.arange(len(frames)) % 2 == 0
    for known in (half, ~half):
        model, y, weight = _model(frames[known], valid[known], offset_px[known])
        image = smooth_fit(model.operator, y, weight, STIFFNESS, FIRST_ITERATIONS)
        model, y, weight = _model(frames[~known], valid[~known], offset_px[~known])
        steps[~known] = _step(model.operator, image, y, weight)[0]
        rest = np.abs(y - model.operator.forward(image))
        total += float(np.sum(rest * weight) / max(float(np.sum(weight)), 1.0))
    return total / 2, steps


def _model(frames: Array, valid: Mask, offset_px: Shifts) -> tuple[ForwardModel, Array, Array]:
    """Return the model, and the frames in single precision with the weight of each pixel."""
    kind = np.complex64 if frames.dtype.kind == "c" else np.float32
    model = forward_model(frames.shape[1:], SCALE, offset_px, blur=GaussianBlur(PIXEL_SIGMA_PX))
    weight = (valid & model.inside).astype(np.float32)
    return model, np.where(valid, frames, 0).astype(kind), weight


def _alternate(frames: Array, valid: Mask, start_px: Shifts, reference: int) -> ShiftFit:
    """Return the shifts, with errors as if noise alone made them."""
    level = frames[valid].mean()
    offset_px, image, noise = start_px.copy(), None, 0.0
    own = np.empty((0, 2, 2))
    largest_px = np.inf
    for _ in range(MAX_ROUNDS):
        model, y, weight = _model(frames - level, valid, offset_px)
        A = model.operator
        number = FIRST_ITERATIONS if image is None else ITERATIONS
        image = smooth_fit(A, y, weight, STIFFNESS, number, image)
        step_px, own, noise = _step(A, image, y, weight)
        step_px -= step_px[reference]
        largest_px = float(np.abs(step_px).max())
        offset_px = offset_px + step_px * min(1.0, MAX_STEP_PX / max(largest_px, 1e-300))
        if largest_px < CONVERGED_PX:
            break
    settled = largest_px < 10 * CONVERGED_PX
    return ShiftFit(offset_px, _against(own, reference), np.ones(len(frames)), noise, settled)


def _step(
    A: LinearOperator, image: Array, y: Array, weight: Array
) -> tuple[Shifts, NDArray[np.float64], float]:
    """Return how far frames lie from where they should, [frame 2 2] covariance, and the noise."""
    rest = y - A.forward(image)
    slopes = SCALE * np.stack(
        [-A.forward(np.ascontiguousarray(one)) for one in np.gradient(image)], axis=1
    )
    usual = float(np.median(np.abs(rest[weight > 0]))) / MEDIAN_SIZE
    weight = weight / np.maximum(np.abs(rest) / max(HUBER_SIGMAS * usual, 1e-30), 1.0)
    weighed = slopes.conj() * weight[:, None]
    seen = np.einsum("kihw,kjhw->kij", weighed, slopes).real.astype(np.float64)
    score = np.einsum("kihw,khw->ki", weighed, rest).real
    noise = float(np.sqrt(np.sum(weight * np.abs(rest) ** 2) / np.sum(weight)))
    inverse = np.linalg.pinv(seen, rcond=1e-6, hermitian=True)
    return (inverse @ score[..., None])[..., 0], noise**2 * inverse, noise


def _against(own: Array, reference: int) -> Shifts:
    """Return the covariance of differences from the reference, from [frame 2 2] of each alone."""
    count = len(own)
    covariance = np.kron(np.ones((count, count)), own[reference])
    for k in range(count):
        covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += own[k]
    covariance[2 * reference : 2 * reference + 2] = 0.0
    covariance[:, 2 * reference : 2 * reference + 2] = 0.0
    return covariance
