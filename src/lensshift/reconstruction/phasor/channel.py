"""The phasor channel of a burst: amplitude and distance out of one reconstruction."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lensshift.core.arrays import Floats, Mask
from lensshift.core.errors import warn_quality
from lensshift.core.gaussian import MEDIAN_ERROR
from lensshift.core.order import median
from lensshift.core.types import Burst, Estimate, Status
from lensshift.core.units import PhaseScale, distance_to_phase, unambiguous_range_m
from lensshift.forward.prediction import (
    FramePredictor,
    PhasorPredictor,
    in_turn_of,
    phasor_predictors,
)
from lensshift.reconstruction.classical import Tikhonov, Tv
from lensshift.reconstruction.learned.behind_spots import wider_behind_spots
from lensshift.reconstruction.learned.harmonics import as_bars
from lensshift.reconstruction.learned.method import solved
from lensshift.reconstruction.learned.noise import noise_map
from lensshift.reconstruction.learned.phasors import NO_PHASE_RAD
from lensshift.reconstruction.learned.unseen import LEAST_SEEN, share_seen, with_gaps
from lensshift.reconstruction.method import Request
from lensshift.reconstruction.misfit import ESTIMATED
from lensshift.reconstruction.phasor.flying import flying_pixels
from lensshift.reconstruction.phasor.frames import polar_frames
from lensshift.reconstruction.phasor.frequencies import Tones, common_distance, doubt_about_phases
from lensshift.reconstruction.phasor.rounding import Steps
from lensshift.reconstruction.phasor.turns import nearest_turns, settle_turns
from lensshift.reconstruction.photometry import std_of_level
from lensshift.reconstruction.problem import Problem, blur_width_px, make_problem, predictor

METHODS = ("auto", "tikhonov", "tv")
# Of the pixels: with more of them turned a picture is not shown without a warning.
TURNED_LIMIT = 0.01
# Gains are estimated of real frames, which costs the distance where there are but phasors.
DIVIDED = "divide amplitudes, or phasors, by the exposure of their frame"


@dataclass(frozen=True, slots=True, eq=False)
class PhasorResult:
    """Both channels of the phasor branch.

    Parameters
    ----------
    amplitude, distance_m : estimates on the HR grid
    flying : [row col] pixels that lie between two surfaces, or that frames hardly show
    unseen : [row col] the latter
    """

    amplitude: Estimate
    distance_m: Estimate
    flying: Mask
    unseen: Mask


def reconstruct_phasor(
    burst: Burst, method: str, request: Request, seen: Mapping[str, Any]
) -> PhasorResult:
    """Reconstruct amplitude and distance of a burst from its phasors.

        y_k = D B M_k (a exp(4 pi i f d / c)) + n

    Several frequencies are reconstructed one after the other and then agree on the distance.

    Parameters
    ----------
    method : "auto": the learned solver for phasors; "tikhonov" and "tv": the phasor as a complex
        image
    seen : scale, blur, shift_field; noise_sigma of a component of the phasor of an LR pixel, in
        units of the amplitude; pixel_variance [frame row col], the same squared, of each pixel used

    Raises
    ------
    ValueError
        If the method cannot do it or the burst lacks what it needs.
    """
    _check(method, request)
    if burst.phasors is None:
        return _unsure_of_drift(_one_frequency(burst, method, request, seen))
    each = []
    for number, (z, hz) in enumerate(zip(burst.phasors, burst.frequencies_hz, strict=True)):
        one = replace(burst, amplitude=z, modulation_hz=hz, distance_m=None, phasors=None)
        gain, turn_rad, still_rad = (
            None if of_all is None else of_all[number, None]
            for of_all in (request.gain, request.turn_rad, request.still_rad)
        )
        alone = replace(
            request, std=True, law=None, gain=gain, turn_rad=turn_rad, still_rad=still_rad
        )
        each.append(_one_frequency(one, method, alone, seen))
    return _unsure_of_drift(_agreed(burst.frequencies_hz, each, request))


def _unsure_of_drift(found: PhasorResult) -> PhasorResult:
    """Return the result with what the median of distances that drift is off by, in its std.

    One error of the whole picture, and of all frequencies: it makes nothing fly.
    """
    distance_m = found.distance_m
    std_m, drift_m = distance_m.uncertainty, distance_m.notes.get("drift_m")
    if drift_m is None or std_m is None:
        return found
    shared_m = MEDIAN_ERROR * np.std(drift_m, ddof=1) / np.sqrt(len(drift_m))

    def std() -> Floats:
        return np.asarray(np.hypot(np.asarray(distance_m.std), shared_m))

    wider = functools.cache(std) if callable(std_m) else std()
    return replace(found, distance_m=replace(distance_m, uncertainty=wider))


def _agreed(hz: tuple[float, ...], each: list[PhasorResult], request: Request) -> PhasorResult:
    """Return the amplitude of the highest frequency, and the distance that fits all of them.

    Where the frames of another one contradict their picture, that is said and shown of the
    distance: what is wrong with one is wrong with all.
    """
    per_m = distance_to_phase(1.0, 1.0) * np.asarray(hz)[:, None, None]
    pictures = Tones(
        hz,
        np.stack([one.distance_m.image for one in each]) * per_m,
        np.stack([np.asarray(one.distance_m.std) for one in each]) * per_m,
    )
    if said := doubt_about_phases(pictures):
        warn_quality(said, 5)
    distance_m, std_m = common_distance(pictures)
    highest = each[int(np.argmax(hz))]
    fine_m = highest.distance_m.fine
    if fine_m is not None:
        times = fine_m.shape[0] // distance_m.shape[0]
        near_m = distance_m.repeat(times, axis=0).repeat(times, axis=1)
        fine_m = in_turn_of(fine_m, near_m, max(hz))
    pictures_m = [highest.distance_m, *(one.distance_m for one in each)]
    doubted = (one for one in pictures_m if one.status is Status.CONTRADICTED)
    shown = next(doubted, highest.distance_m)
    distance = replace(
        highest.distance_m,
        image=distance_m,
        fine=fine_m,
        uncertainty=std_m if request.std else None,
        notes=dict(shown.notes) | {"modulation_hz": list(hz)},
        status=shown.status,
        misfit=shown.misfit,
        confidence=shown.confidence,
    )
    amplitude = highest.amplitude if request.std else replace(highest.amplitude, uncertainty=None)
    seen = highest.distance_m.predict
    if isinstance(seen, PhasorPredictor) and seen.distance is not None:
        finest_m = distance_m if fine_m is None else fine_m
        light, far = phasor_predictors(seen.phasor, finest_m, seen.distance)
        amplitude, distance = replace(amplitude, predict=light), replace(distance, predict=far)
    flying = flying_pixels(distance_m, noise_m=std_m) | highest.unseen
    return PhasorResult(amplitude, distance, flying, highest.unseen)


def _one_frequency(
    burst: Burst, method: str, request: Request, seen: Mapping[str, Any]
) -> PhasorResult:
    part = burst.select(request.frames)
    frames = polar_frames(part)
    gain = np.ones(len(part.amplitude)) if request.gain is None else request.gain[0]
    variance = seen["pixel_variance"]
    variance = None if variance is None else variance / gain[:, None, None] ** 2
    problem = make_problem(part, frames.phasor, **{**seen, "pixel_variance": variance})
    steps = Steps.of(problem, part, frames)
    sigma = np.maximum(noise_map(problem, request.law)[2], steps.least_noise(problem))
    used = problem.weight > 0
    typical = median(sigma[used])
    if method == "auto":
        found = _learned(problem, sigma, request)
        told = np.asarray(found.std) if request.std else None
        if told is not None:
            told = np.hypot(told, steps.shared(problem, sigma))
            if request.gain is not None:
                told[0] = np.hypot(told[0], std_of_level(np.abs(found.image), gain, 0 * gain))
            if request.still_rad is not None:
                told[1] = np.hypot(told[1], request.still_rad[0])
            found = replace(found, uncertainty=np.hypot(told, _of_stray_light(found, problem)))
    else:
        found = _linear(replace(problem, noise_sigma=float(sigma[used].min())), method, request)
    settled, phase_rad = settle_turns(frames, typical * problem.intensity), np.angle(found.image)
    phase_rad = nearest_turns(phase_rad, settled, used, problem.offset_px, problem.scale)
    turned = float(np.mean(np.abs(settled.phase_rad - frames.phase_rad)[used] > np.pi))
    if turned > TURNED_LIMIT:
        warn_quality(
            f"the frames do not agree how often the phase has turned: {100 * turned:.0f} % of the "
            "pixels, dark ones, took the turns of their surroundings; a dark surface may be whole "
            "turns off",
            3,
        )
    notes = dict(found.notes)
    if "contradiction" in notes:
        notes["contradiction"] = notes["contradiction"].replace(ESTIMATED, DIVIDED)
    if request.gain is not None:
        notes["gain"] = gain.tolist()
    if request.turn_rad is not None:
        notes["drift_m"] = (request.turn_rad[0] / frames.scale.rad_per_m).tolist()
    estimate = replace(
        found,
        noise_sigma=typical,
        notes=notes
        | {
            "channel": "phasor",
            "modulation_hz": frames.scale.modulation_hz,
            "modulation_source": frames.scale.source,
        },
    )
    seen_as = found.image if found.fine is None else found.fine
    frame = predictor(
        burst, problem, request.frames, seen_as * problem.intensity, seen["shift_field"], gain
    )
    return _result(frame, problem, estimate, phase_rad, frames.scale)


def _check(method: str, request: Request) -> None:
    if method not in METHODS:
        raise ValueError(
            f"expected a method among {', '.join(METHODS)} for the phasor channel, got {method!r}"
        )
    if request.photometric:
        raise ValueError("photometric estimation expects real frames, not the phasor channel")


def _learned(problem: Problem, sigma: Floats, request: Request) -> Estimate:
    """Return the complex picture with the std [2 row col] of amplitude and phase in radians."""
    found, std = solved(problem, sigma, request)
    std[0] *= wider_behind_spots(problem, sigma)
    found, std = with_gaps(problem, found, std)
    std = as_bars(found.image, std, blur_width_px(problem.model.blur), problem.scale)
    amplitude = np.abs(found.image)
    of_phase_rad = np.minimum(std[1] / np.maximum(amplitude, 1e-12), NO_PHASE_RAD)
    return replace(found, uncertainty=np.stack([std[0], of_phase_rad]) if request.std else None)


def _of_stray_light(found: Estimate, problem: Problem) -> Floats | float:
    """Return the std of amplitude and phase that is left by stray light which was taken out."""
    if problem.stray_light is None:
        return 0.0
    along, across = problem.stray_light.std_of(found.image, problem.y)
    light = np.maximum(np.abs(found.image), 1e-12)
    return np.stack([along, np.minimum(across / light, NO_PHASE_RAD)])


def _linear(problem: Problem, method: str, request: Request) -> Estimate:
    """Reconstruct the phasor as a complex image; its noise is the same in all directions."""
    kind = Tikhonov if method == "tikhonov" else Tv
    own = replace(request, non_negative=False)
    estimate = kind(request.prior_weight, **request.options)(problem, own)

    def std() -> Floats:
        of_component = np.asarray(estimate.std)
        of_phase_rad = of_component / np.maximum(np.abs(estimate.image), 1e-12)
        return np.stack([of_component, np.minimum(of_phase_rad, NO_PHASE_RAD)])

    return replace(estimate, uncertainty=functools.cache(std) if request.std else None)


def _result(
    frame: FramePredictor, problem: Problem, found: Estimate, phase_rad: Floats, scale: PhaseScale
) -> PhasorResult:
    """Bring a complex estimate back to the units of the burst, as amplitude and distance."""
    unit, std = problem.intensity, found.uncertainty
    noise = found.noise_sigma or 0.0
    bright = max(median(np.abs(problem.y[problem.weight > 0])), noise) or 1.0
    noise_m = noise / bright / scale.rad_per_m
    distance_m = scale.distance_m(phase_rad)
    fine = found.fine

    def part(number: int, factor: float) -> Any:
        if callable(std):
            return lambda: std()[number] * factor
        return None if std is None else std[number] * factor

    amplitude = replace(
        found,
        image=np.abs(found.image) * unit,
        fine=None if fine is None else np.abs(fine) * unit,
        uncertainty=part(0, unit),
        noise_sigma=noise * unit,
        predict=PhasorPredictor(frame),
    )
    distance = replace(
        found,
        image=distance_m,
        fine=None if fine is None else scale.distance_m(np.angle(fine)),
        uncertainty=part(1, 1 / scale.rad_per_m),
        noise_sigma=noise_m,
        predict=PhasorPredictor(frame, scale),
    )
    std_m = distance.uncertainty if isinstance(distance.uncertainty, np.ndarray) else noise_m
    unseen = share_seen(problem.model.operator, problem.weight > 0) < LEAST_SEEN
    range_m = unambiguous_range_m(scale.modulation_hz) if scale.circular else None
    flying = flying_pixels(distance_m, noise_m=std_m, range_m=range_m) | unseen
    return PhasorResult(amplitude, distance, flying, unseen)
