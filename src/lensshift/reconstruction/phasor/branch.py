"""The phasor channel of a burst: amplitude and distance out of one reconstruction."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensshift.core.errors import QualityWarning
from lensshift.core.types import Burst, Estimate, ShiftField, Status
from lensshift.core.units import PhaseScale
from lensshift.forward.blur import Blur
from lensshift.forward.prediction import FramePredictor, PhasorPredictor
from lensshift.reconstruction.adaptive import SparseGradient
from lensshift.reconstruction.classical import Tikhonov, Tv
from lensshift.reconstruction.method import Request
from lensshift.reconstruction.misfit import Misfit, find_misfit
from lensshift.reconstruction.noise import estimate_noise
from lensshift.reconstruction.phasor.frames import PolarFrames, polar_frames
from lensshift.reconstruction.phasor.joint import JointPhasor, PolarImage
from lensshift.reconstruction.phasor.noise import relative_variance
from lensshift.reconstruction.phasor.turns import settle_turns
from lensshift.reconstruction.problem import Problem, make_problem, predictor
from lensshift.reconstruction.uncertainty import propagated_std

Array = NDArray[Any]

METHODS = ("auto", "tikhonov", "tv")
# Of the brightness of the frames. No frame has less, and with less the few steps of the joint fit
# would not settle the corners, which hardly a pixel sees.
LEAST_NOISE = 5e-4
# Of the pixels: with more of them turned a picture is not shown without a warning.
TURNED_LIMIT = 0.01
# Of what is not believed: the fit wants every pixel to have some weight.
LEAST_WEIGHT = 1e-6
# Standard deviation of a phase that may be anything.
NO_PHASE_RAD = float(np.pi / np.sqrt(3.0))
# A pixel between two surfaces keeps this share of their step to both of them.
FLYING_SHARE = 0.2
FLYING_STEP = 0.05  # of the distance: smaller steps are no edges
FLYING_SIGMAS = 3.0
LEAST_STEP_M = 1e-6  # rounding of a distance


@dataclass(frozen=True, slots=True, eq=False)
class PhasorResult:
    """Both channels of the phasor branch.

    Parameters
    ----------
    amplitude, distance_m : estimates on the HR grid
    flying : [row col] pixels that lie between two surfaces
    """

    amplitude: Estimate
    distance_m: Estimate
    flying: NDArray[np.bool_]


def reconstruct_phasor(
    burst: Burst,
    used: tuple[int, ...],
    scale: int,
    method: str,
    request: Request,
    *,
    blur: Blur,
    shift_field: ShiftField | None,
    noise_sigma: float | None,
    pixel_variance: Array | None,
    photometric: bool = False,
) -> PhasorResult:
    """Reconstruct amplitude and distance of a burst from its phasors.

        y_k = D B M_k (a exp(4 pi i f d / c)) + n

    Parameters
    ----------
    used : numbers of the frames of `burst` to use
    method : "auto": `JointPhasor`, begun with the two channels reconstructed apart; "tikhonov" and
        "tv": the phasor as a complex image
    noise_sigma : of a component of the phasor of an LR pixel, in units of the amplitude
    pixel_variance : [frame row col] the same squared, of each LR pixel used
    photometric : not possible here, an error

    Raises
    ------
    ValueError
        If the method cannot do it or the burst lacks what it needs.
    """
    _check(method, request, photometric)
    part = burst.select(used)
    frames = polar_frames(part)

    def prepare(values: Array) -> Problem:
        return make_problem(
            part, values, scale, blur=blur, shift_field=shift_field, noise_sigma=None,
            pixel_variance=pixel_variance,
        )  # fmt: skip

    problem = prepare(frames.phasor)
    noise = _noise(problem, noise_sigma, pixel_variance)
    if noise_sigma is None and pixel_variance is None:
        # The root: a bright mixed pixel has much noise, and tells most of where the edge is.
        variance = np.sqrt(relative_variance(problem.y, problem.weight))
        best = float(variance[problem.weight > 0].min())
        noise *= best**0.5
        problem = replace(problem, weight=problem.weight * best / variance)
    problem = replace(problem, noise_sigma=noise)
    if method == "auto":
        settled = settle_turns(frames, noise * problem.intensity)
        _warn_of_turns(frames, settled, problem.weight > 0)
        start = _apart(prepare, settled)
        fit = _joint(problem, start, noise, request)
        misfit = _misfit(problem, fit)
        if misfit.curable and not request.shifts_doubted:
            weight = problem.weight * np.maximum(misfit.weight(), LEAST_WEIGHT)
            fit = _joint(replace(problem, weight=weight), start, noise, request)
        fit = _judged(fit, misfit, request)
    else:
        fit = _linear(problem, method, request)
    frame = predictor(burst, problem, used, fit.image.phasor * problem.intensity, shift_field)
    return _result(frame, problem, frames.scale, fit)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """An estimate in units of the problem; `std` returns that of amplitude and phase."""

    image: PolarImage
    std: Callable[[], NDArray[np.float64]] | None
    confidence: Array | None
    prior_weights: tuple[float | None, float | None]
    noise_sigma: float
    objective: tuple[float, ...]
    status: Status
    misfit: Array | None = None
    contradiction: str | None = None


def _check(method: str, request: Request, photometric: bool) -> None:
    if method not in METHODS:
        raise ValueError(
            f"expected a method among {', '.join(METHODS)} for the phasor channel, got {method!r}"
        )
    if photometric:
        raise ValueError("photometric estimation expects real frames, not the phasor channel")


def _noise(problem: Problem, noise_sigma: float | None, variance: Array | None) -> float:
    """Return the noise of the best pixels, per component: given, from variances, or estimated."""
    if noise_sigma is None and variance is not None:
        noise_sigma = float(np.sqrt(np.min(variance[problem.weight > 0])))
    if noise_sigma is not None:
        return noise_sigma / problem.intensity
    found = estimate_noise(problem.model.operator, problem.y, problem.weight).unexplained
    return max(found, LEAST_NOISE)


def _warn_of_turns(frames: PolarFrames, settled: PolarFrames, used: NDArray[np.bool_]) -> None:
    turned = float(np.mean(np.abs(settled.phase_rad - frames.phase_rad)[used] > np.pi))
    if turned > TURNED_LIMIT:
        warnings.warn(
            f"the frames do not agree how often the phase has turned: {100 * turned:.0f} % of the "
            "pixels, dark ones, took the turns of their surroundings; a dark surface may be whole "
            "turns off",
            QualityWarning,
            stacklevel=4,
        )


def _misfit(problem: Problem, fit: _Fit) -> Misfit:
    used = problem.weight > 0
    sigma = np.where(used, fit.noise_sigma / np.sqrt(np.where(used, problem.weight, 1.0)), np.inf)
    phasor = fit.image.phasor
    return find_misfit(problem.model.operator, phasor, problem.y, sigma, problem.scale)


def _judged(fit: _Fit, misfit: Misfit, request: Request) -> _Fit:
    """Note frames that contradict."""
    wrong = misfit.explain(request.frames or range(len(misfit.doubt)))
    if wrong is not None or request.shifts_doubted:
        fit = replace(fit, status=Status.CONTRADICTED)
    said = None if request.shifts_doubted else wrong
    return replace(fit, misfit=misfit.chi_square, contradiction=said)


def _apart(prepare: Callable[[Array], Problem], frames: PolarFrames) -> PolarImage:
    """Return amplitude and phase reconstructed each on its own: where the joint fit begins."""
    images = []
    for values, even_noise in ((frames.amplitude, True), (frames.phase_rad, False)):
        problem = prepare(values)
        solver = SparseGradient(
            blur_hr_px=problem.blur_sigma_px * problem.scale,
            shift_error_hr_px=problem.shift_error_px * problem.scale,
            even_noise=even_noise,
        )
        estimate = solver(problem.model.operator, problem.y, problem.weight)
        images.append((np.asarray(estimate.image), problem.intensity))
    (amplitude, _), (phase, unit_rad) = images
    return PolarImage(np.maximum(amplitude, 0.0), phase * unit_rad)


def _joint(problem: Problem, start: PolarImage, noise_sigma: float, request: Request) -> _Fit:
    A = problem.model.operator
    solver = JointPhasor(
        noise_sigma=noise_sigma,
        blur_hr_px=problem.blur_sigma_px * problem.scale,
        shift_error_hr_px=problem.shift_error_px * problem.scale,
    )
    solver = replace(solver, iterations=request.options.get("iterations", solver.iterations))
    done = solver(A, problem.y, problem.weight, start, request.on_iteration)

    def resolve(y: Array) -> Array:
        image = solver.replicate(A, y, done)
        return np.stack([image.amplitude, image.phase_rad])

    def std() -> NDArray[np.float64]:
        from scipy.ndimage import gaussian_filter

        rough = propagated_std(
            resolve, problem.y, noise_sigma, weight=problem.weight, smooth_hr_px=0.0,
            seed=request.seed,
        )  # fmt: skip
        return np.asarray(np.sqrt(gaussian_filter(rough**2, (0, 1, 1), mode="nearest")))

    return _Fit(
        image=done.image,
        std=std if request.std else None,
        confidence=np.clip(done.weight.isotropic, 0.0, 1.0),
        prior_weights=done.prior_weights,
        noise_sigma=noise_sigma,
        objective=tuple(done.objective),
        status=done.status,
    )


def _linear(problem: Problem, method: str, request: Request) -> _Fit:
    """Reconstruct the phasor as a complex image; its noise is the same in all directions."""
    kind = Tikhonov if method == "tikhonov" else Tv
    estimate = kind(request.prior_weight, **request.options)(
        problem, replace(request, non_negative=False)
    )
    amplitude = np.abs(estimate.image)

    def std() -> NDArray[np.float64]:
        of_component = np.asarray(estimate.std)
        of_phase_rad = of_component / np.maximum(amplitude, 1e-12)
        return np.stack([of_component, np.minimum(of_phase_rad, NO_PHASE_RAD)])

    return _Fit(
        image=PolarImage(amplitude, np.angle(estimate.image)),
        std=std if request.std else None,
        confidence=estimate.confidence,
        prior_weights=(estimate.prior_weight, estimate.prior_weight),
        noise_sigma=estimate.noise_sigma or 0.0,
        objective=estimate.objective,
        status=estimate.status,
    )


def _result(frame: FramePredictor, problem: Problem, scale: PhaseScale, fit: _Fit) -> PhasorResult:
    """Bring a fit back to the units of the burst."""
    unit = problem.intensity
    seen = np.abs(problem.y[problem.weight > 0])
    noise_rad = fit.noise_sigma / max(float(np.median(seen)), fit.noise_sigma)
    distance_m = scale.distance_m(fit.image.phase_rad)
    notes = {
        "channel": "phasor",
        "modulation_hz": scale.modulation_hz,
        "modulation_source": scale.source,
    }
    if fit.contradiction is not None:
        notes["contradiction"] = fit.contradiction
    std = None if fit.std is None else functools.cache(fit.std)
    shared: dict[str, Any] = {
        "objective": fit.objective, "status": fit.status, "confidence": fit.confidence,
        "notes": notes, "misfit": fit.misfit,
    }  # fmt: skip
    amplitude = Estimate(
        image=fit.image.amplitude * unit,
        uncertainty=None if std is None else lambda: std()[0] * unit,
        prior_weight=fit.prior_weights[0],
        noise_sigma=fit.noise_sigma * unit,
        predict=PhasorPredictor(frame),
        **shared,
    )
    distance = Estimate(
        image=distance_m,
        uncertainty=None if std is None else lambda: std()[1] / scale.rad_per_m,
        prior_weight=fit.prior_weights[1],
        noise_sigma=noise_rad / scale.rad_per_m,
        predict=PhasorPredictor(frame, scale),
        **shared,
    )
    noise_m = noise_rad / scale.rad_per_m
    return PhasorResult(amplitude, distance, flying_pixels(distance_m, noise_m=noise_m))


def flying_pixels(distance_m: ArrayLike, *, noise_m: ArrayLike = 0.0) -> NDArray[np.bool_]:
    """Return the pixels [row col] that lie between two surfaces and on neither.

        d - near >= q (far - near),   far - d >= q (far - near),   q = 0.2

    where near and far are either the nearest and farthest of the 3 x 3 neighbours, more than 5 % of
    near and 3 sigma apart: less may be one slanted surface; or what the two pixels on either side,
    along a row or a column, go on to at this pixel, from both of which it is off by more than
    3 sqrt(6) sigma, the noise of that comparison: steps of any height, no slanted surface.

    Parameters
    ----------
    distance_m : [row col]
    noise_m : standard deviation of the distances, sigma, one number or [row col]
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    image_m = np.asarray(distance_m, np.float64)
    sigma_m = np.broadcast_to(np.asarray(noise_m, np.float64), image_m.shape)
    near_m, far_m = minimum_filter(image_m, 3), maximum_filter(image_m, 3)
    large = far_m - near_m > np.maximum(FLYING_SIGMAS * sigma_m, FLYING_STEP * np.abs(near_m))
    flying = large & _between(image_m, near_m, far_m)
    for axis in (0, 1):
        if image_m.shape[axis] < 5:
            continue
        a, b, c, d, e, sigma = (
            np.moveaxis(part, axis, 0)[k : image_m.shape[axis] - 4 + k]
            for part, k in [(image_m, n) for n in range(5)] + [(sigma_m, 2)]
        )
        before, after = 2 * b - a, 2 * d - e
        apart = np.minimum(np.abs(c - before), np.abs(c - after))
        off = apart > np.maximum(FLYING_SIGMAS * np.sqrt(6.0) * sigma, LEAST_STEP_M)
        between = _between(c, np.minimum(before, after), np.maximum(before, after))
        np.moveaxis(flying, axis, 0)[2:-2] |= off & between
    return flying


def _between(image: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    return np.asarray(np.minimum(image - low, high - image) >= FLYING_SHARE * (high - low))
