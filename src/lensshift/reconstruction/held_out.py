"""How well pictures of some pixels predict the others, under other readings of the shifts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lensshift.core.arrays import Array, Mask, Shifts
from lensshift.core.gaussian import MAD_TO_SIGMA
from lensshift.forward.blur import GaussianBlur
from lensshift.forward.least_squares import smooth_fit
from lensshift.forward.model import ForwardModel, forward_model
from lensshift.forward.operator import single
from lensshift.reconstruction.learned.solver import Asked, solve_together
from lensshift.reconstruction.noise import estimate_noise
from lensshift.reconstruction.problem import blur_width_px

# Of fewer held-out pixels nothing follows.
LEAST_HELD_OUT = 50
# Of each trial the pixels of one fold, drawn at random, are held out.
FOLDS = 4
# A smooth fit of little stiffness follows the scene; what it assumes of the blur hardly matters.
STIFFNESS, ITERATIONS, BLUR_PX, LEAST_SCALE = 0.03, 15, 0.3, 2
# Errors count up to this many robust deviations, or this part of the spread of the scene.
CLIP_SIGMAS, CLIP_CONTRAST = 5.0, 0.5
# Readings whose shifts differ by less from those given are the same.
SAME_PX = 0.02
# What smaller errors tell may be noise.
SUSPICIOUS = 1.03
# Widths of squares that are all, three quarters and half of a pixel, of which nobody has told one
# yet; and the least noise that a solver is told, of the spread of the frames.
SQUARES_PX, LEAST_NOISE = [math.sqrt(share / 12) for share in (1.0, 0.75, 0.5)], 1e-3


@dataclass(frozen=True, slots=True)
class Fit:
    """How a picture is found of frames.

    Parameters
    ----------
    blur_px : width of the pixel response that it assumes
    picture : of a model, frames y [frame row col], their weight and the noise of them
    """

    blur_px: float
    picture: Callable[[ForwardModel, Array, Array, float], Array]


def _solved(model: ForwardModel, y: Array, weight: Array, noise: float) -> Array:
    """Return the picture of the learned solver, of phasors that of either part."""
    parts, turn = [y], 1.0 + 0.0j
    if np.iscomplexobj(y):
        turn = np.exp(0.5j * np.angle(np.sum(y * y)))
        parts = [(y / turn).real, (y / turn).imag]
    sigma = np.where(weight > 0, noise, np.inf)
    width_px = blur_width_px(model.blur)
    asked = [Asked(model, part, sigma, width_px, general=True, alike=True) for part in parts]
    images = [found.image for found in solve_together(asked)]
    return images[0] if len(images) == 1 else turn * (images[0] + 1j * images[1])


SMOOTH = Fit(BLUR_PX, lambda m, y, w, _: smooth_fit(m.operator, y, w, STIFFNESS, ITERATIONS))
SOLVERS = tuple(Fit(width_px, _solved) for width_px in SQUARES_PX)


class Trial:
    """Fits to a part of the pixels, and how well they predict the others."""

    def __init__(
        self,
        values: Array,
        seen: Mask,
        given_px: Shifts,
        about_px: Array | None,
        seed: int = 0,
        *,
        fit: Fit = SMOOTH,
        level: float = 1.0,
    ) -> None:
        rng = np.random.default_rng(seed)
        kind = np.complex64 if np.iscomplexobj(values) else np.float32
        self.values, self.seen, self.given_px = values.astype(kind), seen, given_px
        self.about_px, self.fit, self.level = about_px, fit, level
        self.fold = rng.integers(0, FOLDS, values.shape)
        self.noise = rng.standard_normal(values.shape, np.float32)
        self.cache: dict[tuple[bytes, int, bool], Array] = {}

    def compare(self, other_px: Shifts, folds: int) -> tuple[float, float]:
        """Return the mean error as given over that of a reading, and how sure it is larger.

        The ratio is the smaller one of that of the frames and that beyond what white noise has;
        the second number is the difference in its standard errors.
        """
        over_sensor = other_px.ndim == 4
        given_px = self.given_px[:, None, None] if over_sensor else self.given_px
        if np.abs(other_px - given_px).max() < SAME_PX:
            return 1.0, 0.0
        one, two = self._errors(self.given_px, folds), self._errors(other_px, folds)
        both = np.isfinite(one) & np.isfinite(two)
        if both.sum() < max(LEAST_HELD_OUT, 0.5 * np.isfinite(one).sum()):
            return 1.0, 0.0
        one, two = one[both], two[both]
        quiet = MAD_TO_SIGMA * min(np.median(one), np.median(two))
        clip = max(CLIP_SIGMAS * quiet, CLIP_CONTRAST)
        one, two = np.minimum(one, clip), np.minimum(two, clip)
        if one.mean() >= SUSPICIOUS * two.mean():
            noise = [self._errors(o, FOLDS, noise=True) for o in (self.given_px, other_px)]
            two = two * max(1.0, float(np.nanmean(noise[0]) / np.nanmean(noise[1])))
        sure = (one.mean() - two.mean()) / max(float(np.std(one - two)), 1e-300)
        return float(one.mean() / max(two.mean(), 1e-300)), float(sure * np.sqrt(one.size))

    def sure_by_part(self, other_px: Shifts, folds: int, along: int) -> list[float]:
        """Return the difference of the errors in standard errors, in parts of the picture.

        Parameters
        ----------
        along : parts along each axis
        """
        apart = self._errors(self.given_px, folds) - self._errors(other_px, folds)
        rows = [
            np.array_split(side, along, axis=3) for side in np.array_split(apart, along, axis=2)
        ]
        found = []
        for part in (part for row in rows for part in row):
            one = part[np.isfinite(part)]
            if one.size < 2:  # as where most of it is invalid
                continue
            found.append(float(one.mean() / max(np.std(one), 1e-300) * np.sqrt(one.size)))
        return found

    def _errors(self, offset_px: Shifts, folds: int, *, noise: bool = False) -> Array:
        """Return |error| [fold frame row col] at the pixels held out, NaN elsewhere."""
        return np.stack([self._fold_errors(offset_px, fold, noise) for fold in range(folds)])

    def _fold_errors(self, offset_px: Shifts, fold: int, noise: bool) -> Array:
        key = (offset_px.tobytes(), fold, noise)
        if key not in self.cache:
            y, level = (self.noise, 1.0) if noise else (self.values, self.level)
            model = _model(y.shape, offset_px, self.about_px, self.fit.blur_px)
            usable = self.seen & model.inside
            held = usable & (self.fold == fold)
            picture = self.fit.picture(model, y, np.where(held, 0.0, usable), level)
            error = y - model.operator.forward(single(picture))
            self.cache[key] = np.where(held, np.abs(error), np.nan).astype(np.float64)
        return self.cache[key]


def least_sure(trials: Sequence[Trial], other_px: Shifts, folds: int) -> tuple[float, float]:
    """Return what `Trial.compare` says where that is least sure."""
    return min((trial.compare(other_px, folds) for trial in trials), key=lambda said: said[1])


def by_solver(
    values: Array, seen: Mask, given_px: Shifts, about_px: Array | None
) -> tuple[Trial, ...]:
    """Return trials of the learned solver, for the pixels that nobody has told.

    It knows edges, which a smooth fit predicts best of shifts that are too small: where all lie
    between the same two samples of a pixel, by a factor of two.
    """
    model = _model(values.shape, given_px, about_px, SMOOTH.blur_px)
    weight = single(seen & model.inside)
    parts = (values.real, values.imag) if np.iscomplexobj(values) else (values,)
    noise = min(estimate_noise(model.operator, single(part), weight).sigma for part in parts)
    noise = max(noise, LEAST_NOISE)
    return tuple(Trial(values, seen, given_px, about_px, fit=fit, level=noise) for fit in SOLVERS)


def _model(
    shape: tuple[int, ...], offset_px: Array, about_px: Array | None, blur_px: float
) -> ForwardModel:
    if about_px is not None:
        offset_px = offset_px[:, None, None] + about_px
    kind = "shift_field_px" if offset_px.ndim == 4 else "offset_px"
    # What so many frames may show; thirds of a pixel are coarse steps on a grid of halves.
    scale = max(LEAST_SCALE, math.isqrt(shape[0]))
    _, *sides = shape
    return forward_model(
        (sides[0], sides[1]), scale, **{kind: offset_px}, blur=GaussianBlur(blur_px)
    )
