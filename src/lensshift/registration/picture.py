"""Shifts through the picture that all frames show, and which shifts predict frames better."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from lensshift.core.arrays import Array, Floats, Mask, Shifts
from lensshift.core.gaussian import MEDIAN_SIZE
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.least_squares import smooth_fit
from lensshift.forward.model import ForwardModel, forward_model
from lensshift.forward.operator import LinearOperator
from lensshift.registration.blocks import scatter_over_blocks
from lensshift.registration.likelihood import UNKNOWN_PX, ShiftFit, against_reference
from lensshift.registration.spectrum import PIXEL_SIGMA_PX

Places = Floats

# A grid that holds the first aliases, by which shifts are told apart.
SCALE = 2
# Of second differences in the picture, relative to the frames: a soft low pass.
STIFFNESS = 0.03
# Fewer frames than the grid has pixels in one of theirs, and one more, leave the noise in a picture
# that is so soft: shifts follow it, at SNR 10 ten times as far as they tell.
FEW_STIFFNESS = 1.0
FIRST_ITERATIONS, ITERATIONS = 60, 15
MAX_ROUNDS, CONVERGED_PX, MAX_STEP_PX = 12, 2e-3, 0.2
# Residuals beyond so many standard deviations count by their size, not its square.
HUBER_SIGMAS = 2.0
# Fewer frames fit a picture wherever they lie; and fewer than three in each half predict others by
# what smoothness adds.
LEAST_FRAMES, LEAST_PREDICTING = 4, 6
# Shifts are refuted by others that predict so much better, as a belief in noise is
# (`reconstruction.learned.belief`): in 96 simulated bursts none that erred more did.
BETTER = 0.97
CHANCE = 0.05  # that a wrong one gains in prediction, frame by frame


# Taps are looked up between so many phases: shifts are tried by the hundred, and to solve moments
# of each takes longer than to fit the picture. Linear in between, the variance is right to 1e-6.
_PHASES = np.linspace(0.0, 1.0, 513)


class _Pixel(GaussianBlur):
    """The pixel that `likely_shifts` begins with."""

    __slots__ = ()

    def table(self, phase: Floats, scale: int) -> tuple[int, Floats]:
        """Return the first tap and the weights [phase T] (see `Blur.table`)."""
        first, table = GaussianBlur.table(self, _PHASES, scale)
        place = phase * (_PHASES.size - 1)
        node = np.minimum(place.astype(np.intp), _PHASES.size - 2)
        part = (place - node)[:, None]
        return first, (1.0 - part) * table[node] + part * table[node + 1]


class Fit(NamedTuple):
    """Where frames lie: [frame (row, col) term] of `_terms`, covariance of each frame alone."""

    place_px: Places
    own: Floats
    noise: float
    settled: bool


def better_shifts(fit: ShiftFit, frames: Array, valid: Mask, reference: int) -> ShiftFit:
    """Return shifts through the picture, if they predict frames better than the fit does.

    Else the fit, its errors widened by what the two disagree beyond theirs,

        excess^2 = mean over frames (d - d')^2 - sigma^2 - sigma'^2

    Frames in general have to gain, by more than chance (t test): of frames that nearly all lie at
    one place, one that does not is predicted best too near to them, by a picture that is smooth.

    Parameters
    ----------
    frames, valid : [frame row col]
    reference : frame whose offset stays as it is
    """
    if len(frames) < LEAST_FRAMES:
        return fit
    other = picture_shifts(frames, valid, fit.offset_px, reference=reference)
    if len(frames) >= LEAST_PREDICTING:
        error, _ = prediction_error(frames, valid, fit.offset_px, patterned=True)
        other_error, apart_px = prediction_error(frames, valid, other.offset_px, patterned=True)
        # Half of the frames disagree with the other half by twice the variance of all.
        variance = np.mean((apart_px - np.median(apart_px, axis=0)) ** 2, axis=0)
        other = _widened(other, variance, reference)
        gain = error - other_error
        chance = stdtrit(gain.size - 1, 1.0 - CHANCE) * np.std(gain, ddof=1) / np.sqrt(gain.size)
        if gain.mean() > max((1.0 - BETTER) * error.mean(), chance):
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
    few = len(frames) < LEAST_PREDICTING
    stiffness = FEW_STIFFNESS if few else STIFFNESS
    fit = alternate(frames, valid, start_px[..., None], reference, stiffness=stiffness)
    found = _shifts_of(fit, reference)
    if few:
        return found

    def estimate(part: Array, part_valid: Mask) -> tuple[Shifts, Shifts]:
        alone = _shifts_of(alternate(part, part_valid, fit.place_px, reference), reference)
        return alone.offset_px, alone.sigma_px

    factor = scatter_over_blocks(estimate, frames, valid, found.offset_px).factor
    return replace(found, covariance_px2=found.covariance_px2 * factor**2)


def prediction_error(
    frames: Array, valid: Mask, place_px: Places, *, patterned: bool = False
) -> tuple[Floats, Shifts]:
    """Return the mean error [frame] of frames that are predicted from every other one.

    And by how much [frame 2] their shifts seem to be off in these pictures.

    Parameters
    ----------
    place_px : [frame 2] shifts, or [frame 2 term] as in `Fit`
    patterned : whether what is off in all frames alike counts for nothing, as a pattern of pixels:
        of places that are nearly right, for others leave the scene so
    """
    error, weight, steps = predicted(frames, valid, place_px, patterned=patterned)
    within = (1, 2)
    return np.sum(error * weight, within) / np.maximum(np.sum(weight, within), 1.0), steps


def predicted(
    frames: Array, valid: Mask, place_px: Places, *, patterned: bool = False
) -> tuple[Array, Array, Shifts]:
    """Return size and weight of the error of each pixel [frame row col], and steps [frame 2]."""
    frames = frames - frames[valid].mean()
    place_px = place_px.reshape(len(frames), 2, -1)
    steps = np.zeros((len(frames), 2))
    error, weights = np.zeros_like(frames), np.zeros(frames.shape)
    half = np.arange(len(frames)) % 2 == 0
    for known in (half, ~half):
        model, y, weight = _model(frames[known], valid[known], place_px[known])
        image = smooth_fit(model.operator, y, weight, STIFFNESS, FIRST_ITERATIONS)
        model, y, weight = _model(frames[~known], valid[~known], place_px[~known])
        steps[~known] = _step(model.operator, image, y, weight)[0][..., 0]
        error[~known], weights[~known] = y - model.operator.forward(image), weight
    if patterned:
        error -= np.sum(weights * error, axis=0) / np.maximum(np.sum(weights, axis=0), 1.0)
    return np.abs(error), weights, steps


def _model(frames: Array, valid: Mask, place_px: Places) -> tuple[ForwardModel, Array, Array]:
    """Return the model, and the frames in single precision with the weight of each pixel."""
    kind = np.complex64 if frames.dtype.kind == "c" else np.float32
    offset_px = field_px = None
    if place_px.shape[2] == 1:
        offset_px = place_px[..., 0]
    else:
        field_px = np.einsum("kit,thw->khwi", place_px, _terms(frames.shape[1:], 3))
    model = forward_model(
        frames.shape[1:], SCALE, offset_px, shift_field_px=field_px,
        blur=_Pixel(PIXEL_SIGMA_PX),
    )  # fmt: skip
    weight = (valid & model.inside).astype(np.float32)
    return model, np.where(valid, frames, 0).astype(kind), weight


def _terms(shape: tuple[int, ...], number: int) -> Floats:
    """Return 1, row and col [term row col], these -1 to 1 from border to border."""
    row, col = (np.linspace(-1.0, 1.0, size) for size in shape)
    terms = np.broadcast_arrays(1.0, row[:, None], col)
    return np.stack(terms[:number])


def alternate(
    frames: Array, valid: Mask, start_px: Places, reference: int, rounds: int = MAX_ROUNDS,
    stiffness: float = STIFFNESS,
) -> Fit:  # fmt: skip
    """Return where the frames lie, with errors as if noise alone made them.

    Parameters
    ----------
    start_px : [frame 2 term] shift, and how it grows towards the borders
    """
    level = frames[valid].mean()
    place_px, image, noise = start_px.copy(), None, 0.0
    own = np.empty(0)
    largest_px = np.inf
    for _ in range(rounds):
        model, y, weight = _model(frames - level, valid, place_px)
        A = model.operator
        number = FIRST_ITERATIONS if image is None else ITERATIONS
        image = smooth_fit(A, y, weight, stiffness, number, image)
        step_px, own, noise = _step(A, image, y, weight, place_px.shape[2])
        step_px -= step_px[reference]
        largest_px = float(np.abs(step_px).sum(axis=2).max())
        place_px = place_px + step_px * min(1.0, MAX_STEP_PX / max(largest_px, 1e-300))
        if largest_px < CONVERGED_PX:
            break
    return Fit(place_px, own, noise, largest_px < 10 * CONVERGED_PX)


def step_from(frames: Array, valid: Mask, offset_px: Shifts, terms: int) -> tuple[Places, Floats]:
    """Return how far frames seem to lie from shifts, by so many terms, in the picture of these.

    And the covariance of that, of each frame.
    """
    model, y, weight = _model(frames - frames[valid].mean(), valid, offset_px[..., None])
    image = smooth_fit(model.operator, y, weight, STIFFNESS, FIRST_ITERATIONS)
    return _step(model.operator, image, y, weight, terms)[:2]


def _step(
    A: LinearOperator, image: Array, y: Array, weight: Array, terms: int = 1
) -> tuple[Places, Floats, float]:
    """Return how far frames [frame 2 term] are off, the covariance of that, and the noise."""
    rest = y - A.forward(image)
    slopes = SCALE * np.stack(
        [-A.forward(np.ascontiguousarray(one)) for one in np.gradient(image)], axis=1
    )
    usual = float(np.median(np.abs(rest[weight > 0]))) / MEDIAN_SIZE
    weight = weight / np.maximum(np.abs(rest) / max(HUBER_SIGMAS * usual, 1e-30), 1.0)
    known = (slopes[:, :, None] * _terms(y.shape[1:], terms)).reshape(len(y), -1, *y.shape[1:])
    weighed = known.conj() * weight[:, None]
    seen = np.einsum("kihw,kjhw->kij", weighed, known).real.astype(np.float64)
    score = np.einsum("kihw,khw->ki", weighed, rest).real
    noise = float(np.sqrt(np.sum(weight * np.abs(rest) ** 2) / np.sum(weight)))
    inverse = np.linalg.pinv(seen, rcond=1e-6, hermitian=True)
    return (inverse @ score[..., None]).reshape(len(y), 2, terms), noise**2 * inverse, noise


def _shifts_of(fit: Fit, reference: int) -> ShiftFit:
    covariance = against_reference(fit.own, reference)
    return ShiftFit(fit.place_px[..., 0], covariance, np.ones(len(fit.own)), fit.noise, fit.settled)
