"""The default method behind the common call: Problem, Request -> Estimate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lensshift.core.arrays import Array, Floats, Mask
from lensshift.core.types import Estimate, Status
from lensshift.reconstruction.learned.behind_spots import wider_behind_spots
from lensshift.reconstruction.learned.belief import as_predicted, refuted
from lensshift.reconstruction.learned.cut_noise import before_the_cut
from lensshift.reconstruction.learned.finer import finer_grid, of_larger_pixels, seen_finer
from lensshift.reconstruction.learned.harmonics import as_bars
from lensshift.reconstruction.learned.noise import noise_map, rounded_std, tells_little
from lensshift.reconstruction.learned.phasors import finished, with_finer_amplitude
from lensshift.reconstruction.learned.residual import less_noise
from lensshift.reconstruction.learned.solver import Asked, Solution, solve_together
from lensshift.reconstruction.learned.unseen import with_gaps
from lensshift.reconstruction.method import Request
from lensshift.reconstruction.misfit import Misfit, find_misfit
from lensshift.reconstruction.noise_law import NoiseLaw
from lensshift.reconstruction.problem import Problem, blur_width_px
from lensshift.reconstruction.sharpness import as_sharp_as_most, moments_px2, told

# A frame of which less is believed counts as left out.
BELIEVED_FRAME = 0.5
# Pixels that are believed less in the second solution are left out: the solver takes the mean noise
# for its unit, which few pixels should not move.
LEAST_WEIGHT = 0.04
# What calibrated actuators leave, LR pixels: taken for granted of every phasor burst, as it was in
# training. Beside a surface twenty times as bright it is more than the noise.
USUAL_SHIFT_ERROR_PX = 0.02
# Nearer than this, LR pixels, samples lie on the pixels of a grid; the finest that there is; and
# how much around a doubted part is looked at, the reach of the solver.
NODE_PX, MOST_SCALE, AROUND_PX = 0.05, 8, 16
# After the second, what is taken off frames that were shaken changes no more.
SHARPENINGS = 2


def auto(problem: Problem, request: Request) -> Estimate:
    """Exact data steps and a learned prior; the noise decides what is believed of both."""
    too_dark: Floats | float = 0.0

    def brighter(problem: Problem, law: NoiseLaw) -> Array:
        noise = noise_map(problem, law.scaled(problem.intensity, problem.level))[2]
        return solved(problem, noise, replace(request, on_iteration=None))[0].image

    if not request.streamed and (cut := before_the_cut(problem, brighter)) is not None:
        problem, law, too_dark = cut
        request = replace(request, law=law.scaled(problem.intensity, problem.level))
    law, least, noise = noise_map(problem, request.law)
    if law.ceiling:
        asked = _asked(problem, with_shift_errors(noise, problem))
        law = law.times(less_noise(asked, partial(_picture, request=request)))
        known = law.scaled(problem.intensity, problem.level)
        law, least, noise = noise_map(problem, known)
    found, std = solved(problem, noise, request)
    std = std * wider_behind_spots(problem, noise)
    found, std = with_gaps(problem, found, std)
    std = as_bars(found.image, std, blur_width_px(problem.model.blur), problem.scale)
    if std.ndim == 3:  # of a complex picture, that of a component
        std = np.sqrt(np.mean(std**2, axis=0))
    std = np.hypot(np.hypot(std, too_dark), rounded_std(problem, law))
    image = found.image
    if request.non_negative and image.dtype.kind == "f":
        image = np.maximum(image, 0)
    in_units = law.scaled(problem.intensity, problem.level)
    return replace(
        found,
        image=image,
        uncertainty=std if request.std else None,
        noise_sigma=max(law.sigma, least),
        notes=dict(found.notes) | {"noise_law": in_units.coefficients} | in_units.noise_of_frames,
    )


def solved(problem: Problem, noise: Floats, request: Request) -> tuple[Estimate, Floats]:
    """Solve, let the frames refute it, and solve again with what is believed of them.

    Parameters
    ----------
    noise : [frame row col] of each LR pixel, of each component if it has two

    Returns
    -------
    Estimate, std
        in units of the problem; std as in `Solution`, wider where the frames disagree
        Its notes may hold a "contradiction", in words.
    """
    if finer := _on_finer_grid(problem, noise, request):
        return of_larger_pixels(*solved(finer, noise, request))
    noise = with_shift_errors(noise, problem)
    objective: list[float] = []

    def on_stage(number: int, misfit: float) -> None:
        objective.append(misfit)
        if request.on_iteration is not None:
            request.on_iteration(len(objective), misfit)

    asked = replace(_asked(problem, noise), on_stage=on_stage)
    run = partial(_solved_once, problem, request)
    found, misfit = run(asked)
    shaken: dict[int, Array] = {}
    if not request.streamed and not asked.general and not asked.of_phasors:
        judging = problem.judging
        asked, found, misfit, shaken = _as_they_fit(asked, found, misfit, run, request, judging)
        problem, noise = replace(problem, y=asked.y), asked.sigma
    if misfit.curable and not misfit.off_px and not request.shifts_doubted:
        misfit = _seen_otherwise(problem, noise, misfit, request)
    left, weighed, used = misfit, noise, problem.weight > 0
    wrong = request.refuted or _refuted_by(misfit, shaken, request.frames or range(len(used)))
    if not problem.even_noise:
        # A distance where two surfaces mix is no mean of theirs: static scenes seem to contradict.
        wrong = None
    if request.refuted is None and misfit.curable and not request.shifts_doubted:
        trust = misfit.weight(of_phasors=asked.of_phasors)
        less_sure = noise / np.sqrt(np.maximum(trust, LEAST_WEIGHT))
        weighed = np.where(trust > LEAST_WEIGHT, less_sure, np.inf)
        found, left = run(replace(asked, sigma=weighed))
    if asked.of_phasors:
        believed = replace(asked, sigma=weighed, on_stage=None)
        solve = partial(_picture, request=request)
        found = with_finer_amplitude(believed, found, problem.scale, solve)
    estimate = Estimate(
        image=found.image,
        objective=tuple(objective),
        status=status_of(found),
        confidence=found.weight * (np.where(np.isfinite(noise), noise, 0.0) / weighed) ** 2,
        notes={"std_of": "error", "misfit": float(np.mean(misfit.chi_square))},
        misfit=misfit.chi_square,
    )
    std = np.hypot(found.std, left.unexplained)
    return _judged(estimate, wrong, used, request), std


def _asked(problem: Problem, noise: Floats) -> Asked:
    # Of the pixel: the networks have seen few responses that are much wider.
    pixel_px = blur_width_px(problem.model.blur)
    # Distances are no light that pixels average, on which those of the square were trained.
    return Asked(problem.model, problem.y, noise, pixel_px, general=not problem.even_noise)


def _on_finer_grid(problem: Problem, noise: Floats, request: Request) -> Problem | None:
    """Return the problem with smaller pixels, of which those asked for are the means, or None.

    Of phasors only where an HR pixel is an LR pixel: else their light is (`with_finer_amplitude`).
    """
    model = finer_grid(problem.model)
    if model is None or problem.scale == 1:
        return None if model is None else replace(problem, model=model)
    if not problem.even_noise or problem.y.dtype.kind == "c":
        return None
    asked = _asked(problem, with_shift_errors(noise, problem))
    wanted = seen_finer(asked, partial(_picture, request=request)) is not None
    return replace(problem, model=model) if wanted else None


def _refuted_by(misfit: Misfit, shaken: dict[int, Array], names: Sequence[int]) -> str | None:
    """Say what the frames contradict, if they do."""
    said = [told(shaken, names)] if shaken else []
    other = misfit.explain(names)
    return "; and ".join([*said, *([other] if other else [])]) or None


def _picture(asked: Asked, request: Request) -> Solution:
    """Return the picture, found where the request says."""
    there = request.device
    return solve_together([asked])[0] if there is None else there.solve(asked)


def _solved_once(problem: Problem, request: Request, asked: Asked) -> tuple[Solution, Misfit]:
    """Return picture and misfit."""
    A, noise = problem.model.operator, problem.judging(asked.sigma)
    found = _picture(asked, request)
    if asked.of_phasors:
        solve = partial(_picture, request=request)
        found = finished(asked, found, problem.scale, solve)
    misfit = find_misfit(A, found.image, asked.y, noise, problem.scale)
    if misfit.contradicts and tells_little(problem):
        misfit = replace(misfit, doubt=np.minimum(misfit.doubt, 1.0), off_px={}, brightness=0.0)
    return found, misfit


def _as_they_fit(
    asked: Asked,
    found: Solution,
    misfit: Misfit,
    run: Callable[[Asked], tuple[Solution, Misfit]],
    request: Request,
    judging: Callable[[Floats], Floats],
) -> tuple[Asked, Solution, Misfit, dict[int, Array]]:
    """Return what is asked and found of frames that are not all as sharp or as noisy as told.

    And the moments of the frames that are less sharp than the others.
    """
    A, y, scale = asked.model.operator, asked.y, asked.model.scale
    shaken: dict[int, Array] = {}
    contradicted = misfit.lit or misfit.doubt.max(initial=0.0) > 1.0
    for _ in range(SHARPENINGS if contradicted and not misfit.off_px else 0):
        moments = moments_px2(A, found.image, y, judging(asked.sigma), scale)
        if not moments:
            break
        shaken = moments
        asked = replace(asked, y=as_sharp_as_most(A, found.image, y, scale, shaken))
        found, misfit = run(asked)
    if refuted(replace(asked, sigma=judging(asked.sigma)), found):
        asked = as_predicted(asked, found, lambda other: _picture(other, request))
        found, misfit = run(asked)
    return asked, found, misfit, shaken


def _seen_otherwise(problem: Problem, noise: Floats, misfit: Misfit, request: Request) -> Misfit:
    """Return the misfit without doubt, if there is a grid on which the frames leave none.

    A sample in the middle of four pixels does not see the finest pattern of the grid, and detail
    may be finer than the grid. Both seem to contradict in those frames that are not believed there.
    """
    model, scale = problem.model, problem.scale
    doubted = np.any(misfit.doubt > 1.0, axis=0)
    rows, cols = (
        slice(max(0, int(at.min()) - AROUND_PX), int(at.max()) + 1 + AROUND_PX)
        for at in np.nonzero(doubted)
    )
    rows, cols = (
        slice(p.start, min(p.stop, n)) for p, n in zip((rows, cols), doubted.shape, strict=True)
    )
    turns = np.exp(2j * np.pi * (scale * model.mean_offset_px + (scale - 1) / 2))
    off_px = np.angle(turns.mean(axis=0)) / (2 * np.pi * scale)
    grids = [(scale, off_px)] if np.max(np.abs(off_px)) > NODE_PX else []
    grids += [(2 * scale, np.zeros(2))] if 2 * scale <= MOST_SCALE else []
    for finer, moved_px in grids:
        other = model.on_grid(finer, moved_px).crop(rows, cols)
        clipped = None if problem.clipped is None else problem.clipped[:, rows, cols]
        y, weight = (np.ascontiguousarray(a[:, rows, cols]) for a in (problem.y, problem.weight))
        part = replace(problem, model=other, y=y, weight=weight, clipped=clipped)
        sigma = np.where(other.inside, noise[:, rows, cols], np.inf)
        asked = Asked(other, part.y, sigma, blur_width_px(other.blur))
        _, again = _solved_once(part, request, asked)
        if not again.contradicts:  # in a part what moved may pass for light, or for most frames
            return replace(misfit, doubt=np.minimum(misfit.doubt, 1.0))
    return misfit


def with_shift_errors(sigma: Floats, problem: Problem) -> Floats:
    """Return the noise of each LR pixel with what the errors of the shifts add where it is steep.

    sigma^2 + e_k^2 |grad y_k|^2,   e_k the standard deviation of the shift of frame k

    That of phasors includes the usual error, as it did in their training.
    """
    of_phasors = problem.y.dtype.kind == "c"
    usual_px, components = (USUAL_SHIFT_ERROR_PX, 2.0) if of_phasors else (0.0, 1.0)
    error_px = np.hypot(np.broadcast_to(problem.shift_error_px, len(sigma)), usual_px)
    if not np.any(error_px) or min(problem.y.shape[1:]) < 2:
        return sigma
    slopes = np.gradient(problem.y, axis=(1, 2))
    steep = np.sum(np.abs(slopes) ** 2, axis=0) / components
    return np.asarray(np.sqrt(sigma**2 + error_px[:, None, None] ** 2 * steep))


def status_of(found: Solution) -> Status:
    """Return CONVERGED where the last stage moved the picture by less than its error bar.

    Else COMPLETE: the number of stages is part of what was learned.
    """
    if not np.all(np.isfinite(found.image)):
        return Status.NOT_FINITE
    return Status.CONVERGED if found.change < 1.0 else Status.COMPLETE


def _judged(estimate: Estimate, wrong: str | None, used: Mask, request: Request) -> Estimate:
    """Note the frames that were not believed, and what contradicts."""
    believed = estimate.confidence if estimate.confidence is not None else used.astype(float)
    trust = np.array([c[u].mean() if u.any() else 1.0 for c, u in zip(believed, used, strict=True)])
    notes = dict(estimate.notes) | {
        "trust": float(believed[used].mean()),
        "rejected": np.flatnonzero(trust < BELIEVED_FRAME).tolist(),
    }
    status = estimate.status
    if wrong is not None and not request.shifts_doubted:
        notes["contradiction"] = wrong
    if status is not Status.NOT_FINITE and (wrong is not None or request.shifts_doubted):
        status = Status.CONTRADICTED
    return replace(estimate, notes=notes, status=status)
