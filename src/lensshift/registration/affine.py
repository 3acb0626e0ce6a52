"""Frames that turn, grow or shear against each other: a shift for every pixel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri, stdtrit

from lensshift.core.arrays import Array, Floats, Mask, Shifts
from lensshift.registration import picture

# Coarse frames come first: there what turns moves by few pixels.
COARSE_PX = 64
ROUNDS = 30
# Frames whose corners move by less against their middle are as good as shifted.
LEAST_CORNER_PX = 0.1
# Frames turn if those that only shift would predict each other so much worse by chance once in:
CHANCE = 0.01
_NO_TURN = ((0, 0), (0, 0), (0, 2))  # beside a shift


class AffineFit(NamedTuple):
    """Shift of pixel u of each frame, offset + affine (u - middle)."""

    offset_px: Shifts  # [frame 2] in the middle of the sensor, relative to the reference
    affine: Floats  # [frame 2 2] of (row, col) by (row, col)
    sigma_px: Shifts  # [frame 2] standard error of the offset that noise makes
    noise: float  # of a pixel, as these shifts leave it
    settled: bool  # whether the search did

    def said(self, shape: tuple[int, ...]) -> str:
        """Return in words by how much the frames turn and grow, and what that is in a corner."""
        turn_deg, growth = turns_of(self.affine)
        return (
            f"by up to {np.abs(turn_deg).max():.2g} degrees in turn and "
            f"{100 * np.abs(growth).max():.2g} % in size, {corner_px(self.affine, shape):.1f} px "
            "in a corner"
        )


def turns_of(affine: Floats) -> tuple[Floats, Floats]:
    """Return by how many degrees each frame turns, and by what part of its size it grows."""
    turn_deg = np.rad2deg((affine[:, 1, 0] - affine[:, 0, 1]) / 2)
    return turn_deg, np.trace(affine, axis1=1, axis2=2) / 2


def corner_px(affine: Floats, shape: tuple[int, ...]) -> float:
    """Return how far a corner of a frame moves against its middle, of the frame that does most."""
    half = (np.array(shape) - 1) / 2
    return float(np.max(np.abs(affine * half).sum(axis=2)))


def affine_motion(frames: Array, valid: Mask, start_px: Shifts, *, reference: int = 0) -> AffineFit:
    """Find the picture, and how each frame shifts, turns, grows and shears, in turn.

        minimise over x, d, M   sum |y_k - A(d_k + M_k (u - middle)) x|^2 + s |L x|^2

    As `picture_shifts` with six numbers a frame, from coarse frames to fine ones.

    Parameters
    ----------
    frames, valid : [frame row col]
    start_px : [frame 2] shifts relative to the reference
    reference : frame that is taken to be upright
    """
    levels = [(frames, valid)]
    while min(levels[-1][0].shape[1:]) >= 2 * COARSE_PX:
        levels.append(_halved(*levels[-1]))
    coarsest, *finer = reversed(levels)
    start = np.asarray(start_px)[..., None] / 2 ** len(finer)
    fit = picture.alternate(*coarsest, np.pad(start, _NO_TURN), reference, ROUNDS)
    for seen, known in finer:
        fit = picture.alternate(seen, known, 2 * fit.place_px, reference, ROUNDS)
    own = np.einsum("kii->ki", fit.own).reshape(fit.place_px.shape)[..., 0]
    half = np.maximum((np.array(frames.shape[1:]) - 1) / 2, 0.5)
    return AffineFit(
        fit.place_px[..., 0], fit.place_px[..., 1:] / half, np.sqrt(own + own[reference]),
        fit.noise, fit.settled,
    )  # fmt: skip


def turning(frames: Array, valid: Mask, offset_px: Shifts, reference: int = 0) -> AffineFit | None:
    """Return how frames turn against each other, if that tells more of them than shifts do.

    Quarters of frames that are predicted from every other frame have to gain by it, by more than
    chance and four more numbers a frame explain: the quarter of the sensor that gains most left
    out, since what moves is somewhere.
    """
    if len(frames) < picture.LEAST_FRAMES:
        return None
    seen, known, px = frames, valid, offset_px
    while min(seen.shape[1:]) >= 2 * COARSE_PX:
        (seen, known), px = _halved(seen, known), px / 2
    size = frames.shape[1] / seen.shape[1]
    first, own = picture.step_from(seen, known, px, terms=3)
    away = (first - first[reference])[..., 1:]
    corner = size * np.abs(away).sum(axis=2).max()
    if corner < LEAST_CORNER_PX or _by_chance(away, own + own[reference], reference):
        return None
    shifted = picture.alternate(seen, known, px[..., None], reference)
    turned = picture.alternate(seen, known, np.pad(shifted.place_px, _NO_TURN), reference, ROUNDS)
    if not turned.settled:  # noise leads it on, and it follows
        return None
    gain = np.subtract(*(_quarter_errors(seen, known, fit) for fit in (shifted, turned)))
    elsewhere = np.delete(gain, np.argmax(gain.mean(axis=0)), axis=1)
    error = np.std(elsewhere, ddof=1) / np.sqrt(elsewhere.size)
    if elsewhere.mean() <= stdtrit(elsewhere.size - 1, 1 - CHANCE) * error:
        return None
    found = affine_motion(frames, valid, offset_px, reference=reference)
    return found if corner_px(found.affine, frames.shape[1:]) > LEAST_CORNER_PX else None


def _by_chance(away: Floats, own: Floats, reference: int) -> bool:
    """Return whether noise alone makes frames seem to turn so [frame 2 2] often enough.

    Then a search would follow it for long.
    """
    turn = np.delete(away.reshape(-1, 4), reference, axis=0)
    terms = [1, 2, 4, 5]  # of (row, col) by (1, row, col)
    spread = np.delete(own, reference, axis=0)[:, terms][:, :, terms]
    square = np.einsum("ki,kij,kj->", turn, np.linalg.pinv(spread, hermitian=True), turn)
    return bool(square < chdtri(turn.size, CHANCE))


def _quarter_errors(frames: Array, valid: Mask, fit: picture.Fit) -> Floats:
    """Return the error of prediction [frame quarter], without what numbers fitted take from it."""
    error, weight, _ = picture.predicted(frames, valid, fit.place_px)
    row, col = (size // 2 for size in frames.shape[1:])
    parts = [np.s_[:, r, c] for r in (np.s_[:row], np.s_[row:]) for c in (np.s_[:col], np.s_[col:])]
    means = [np.sum((error * weight)[part], axis=(1, 2))
             / np.maximum(np.sum(weight[part], axis=(1, 2)), 1.0) for part in parts]  # fmt: skip
    fitted = fit.place_px[0].size / np.maximum(weight.sum(axis=(1, 2)), fit.place_px[0].size + 1)
    return np.asarray(np.stack(means, axis=1) / np.sqrt(1 - fitted)[:, None])


def _halved(frames: Array, valid: Mask) -> tuple[Array, Mask]:
    """Return frames of a quarter of the pixels, each the mean of four."""
    rows, cols = (size // 2 for size in frames.shape[1:])
    parts = [one[:, : 2 * rows, : 2 * cols].reshape(len(one), rows, 2, cols, 2)
             for one in (np.where(valid, frames, 0), valid)]  # fmt: skip
    total, number = (part.sum(axis=(2, 4)) for part in parts)
    return total / np.maximum(number, 1), number > 0
