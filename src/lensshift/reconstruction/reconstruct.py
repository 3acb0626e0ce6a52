"""One call for all methods: a burst goes in, a super-resolved picture comes out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Array
from lensshift.core.defects import colour_mosaic
from lensshift.core.errors import DataError, warn_quality
from lensshift.core.lens_field import LensField
from lensshift.core.phasors import distances_without
from lensshift.core.stray_light import StrayLight
from lensshift.core.types import Burst, Estimate, Reconstruction, ShiftField, Status, expect_burst
from lensshift.reconstruction.clipping import (
    measured,
    overexposed,
    warn_of_blind_frames,
    without_blank,
    without_copies,
)
from lensshift.reconstruction.devices import Device, on_device
from lensshift.reconstruction.learned.cut_noise import cut_off
from lensshift.reconstruction.learned.noise import doubt_about_noise
from lensshift.reconstruction.method import Method, Request
from lensshift.reconstruction.methods import make_method
from lensshift.reconstruction.misfit import ESTIMATED, NOT_ENOUGH, what_else
from lensshift.reconstruction.options import positive
from lensshift.reconstruction.phasor.channel import reconstruct_phasor
from lensshift.reconstruction.phasor.choice import Channel, Choice, choose_channel
from lensshift.reconstruction.photometry import estimate_photometry, in_one_light, std_of_level
from lensshift.reconstruction.pixel_response import as_seen, told_response, undone
from lensshift.reconstruction.problem import (
    QUESTIONED_BLUR_PX,
    Problem,
    make_blur,
    make_problem,
    predictor,
)
from lensshift.reconstruction.shift_check import Doubt, warn_of_doubt
from lensshift.reconstruction.told_shifts import Told, held_against_frames
from lensshift.reconstruction.uncertainty import PropagatedStd


def reconstruct(
    burst: Burst,
    scale: int = 2,
    method: str | Method = "auto",
    channel: Channel = "auto",
    psf_sigma_px: float | Literal["auto"] | None = "auto",
    prior_weight: float | Literal["cross-validation"] | None = None,
    *,
    frames: Sequence[int] | None = None,
    fill_factor: float | None = None,
    noise_sigma: float | None = None,
    pixel_variance: ArrayLike | None = None,
    shift_field: ShiftField | None = None,
    lens_field: LensField | None = None,
    stray_light: StrayLight | None = None,
    photometric: bool = False,
    non_negative: bool = False,
    seed: int = 0,
    std: bool = True,
    on_iteration: Callable[[int, float], None] | None = None,
    streamed: bool | Reconstruction = False,
    device: str | Device | None = None,
    **options: Any,
) -> Reconstruction:
    """Reconstruct a super-resolved image from a burst of shifted frames.

        y_k = gain_k (D B M_k x) + bias_k + n

    Parameters
    ----------
    burst : the frames with their sub-pixel offsets. With "auto" and phasors, planned ones that the
        frames surely contradict are corrected (`settings["corrected_offset_px"]`), unless
        `offset_sigma_px` is 0: exact
    scale : HR pixels per LR pixel, 1 to 8
    method : one of `lensshift.method_names()`, or made with its options as in `Tv(iterations=30)`
        (see `lensshift.reconstruction.methods`); "auto" needs no tuning
    channel : "amplitude", "distance"; "phasor": both from phasors, the way a pixel mixes them; or
        "auto": phasor if that is possible (see `lensshift.reconstruction.phasor.choice`), else
        amplitude, and distance if the burst has it, each on its own
    psf_sigma_px : Gaussian width of the pixel response in LR pixels, lens included; a square pixel
        has 0.289. "auto" or None: `burst.meta["psf_sigma_px"]`, or what the frames show
        (`settings["psf_source"]` is "frames", `settings["psf_std_px"]` its standard deviation), or
        0.3 where they show none or gains are to be found. The method "auto" shows what pixels of
        1/scale of the pitch see behind the same lens, and takes the square pixel for all that is
        wider; other methods undo the lens as well. With `fill_factor`: width of the optical spot
        alone, 0 if not given
    prior_weight : a number (for frames of brightness 1, of the toolbox in 0 .. 1), None to choose
        it from the noise, or "cross-validation"
    frames : numbers of the frames to use, by default all; the others can be predicted
    fill_factor : light-sensitive share of the pixel width in (0, 1]: exact square aperture
    noise_sigma : noise of one LR pixel in units of the channel (phasor: of the amplitude, for
        the real and for the imaginary part), if it is known
    pixel_variance : [frame row col] known noise variance of each LR pixel
    shift_field : offset of every pixel of every frame instead of `burst.offset_px`, which it must
        agree with in the middle of the sensor
    lens_field : how shift and spot of the lens vary over the sensor, for the frames of any burst
        of that lens; instead of `shift_field`. `psf_sigma_px` then holds for the middle of the
        sensor, where nobody told it the pixel is square; all methods undo the spot
    stray_light : what lens and sensor throw far from where it belongs, to be taken out of light and
        phasors (of distances of several frequencies it cannot); by default what
        `burst.meta["stray_light"]` says, or none
    photometric : whether to estimate gain and bias of each frame; where frames of light surely
        differ in brightness that is done, and said, without it, and of phasors their gain
    non_negative : whether negative values are forbidden
    seed : of everything random
    std : whether the propagated noise is wanted (it is computed when first asked for)
    on_iteration : called with the number of the iteration and the objective; an exception
        raised in it ends the work and leaves nothing behind
    streamed : whether a `lensshift.stream` asks, again and again: shifts are not mended, and what
        is wrong with the camera is not said anew. Or what it had before of a scene that rests: the
        response is that one, and neither it nor the shifts are held against the frames again
    device : where the method "auto" is computed: "cpu", "cuda" or "cuda:1" by PyTorch, "numpy" by
        the same code in NumPy; None: compiled for this processor, the fastest without CUDA
    options : the fields of the method

    Returns
    -------
    Reconstruction
        with an `Estimate` for each channel

    Raises
    ------
    ValueError
        If an argument is out of range or unknown to the method, a shift field or lens field is not
        of this burst, or there is no such device.
    ImportError
        If a device needs PyTorch, which is not installed.

    Warns
    -----
    QualityWarning
        If the frames fit another sign, order of axes, unit or order of frames better, lie more than
        0.05 px (rms) from where they were told, or contradict the picture ("auto" and phasors): a
        frame lies elsewhere, something moved, the brightness changes. Or if they show another pixel
        response than was told, or are overexposed.
    """
    before = streamed if isinstance(streamed, Reconstruction) else None
    burst = _checked(burst, scale, noise_sigma, stray_light)
    options |= {} if prior_weight is None else {"prior_weight": prior_weight}
    chosen = make_method(method, options)
    name, own = chosen.name, chosen.settings
    field = _field_of(burst, shift_field, lens_field)
    response = told_response(burst, psf_sigma_px, fill_factor, before)
    blur = make_blur(response["psf_sigma_px"], fill_factor)
    used = _frame_numbers(burst, frames, field)
    request = Request(
        own.pop("prior_weight", None), seed, non_negative, std, photometric, on_iteration, own,
        frames=used, shifts_doubted=response["psf_sigma_px"] > QUESTIONED_BLUR_PX,
        streamed=bool(streamed), device=on_device(device, name),
    )  # fmt: skip
    burst, part, field = _parts(burst, used, request, field)
    variance = None if pixel_variance is None else np.asarray(pixel_variance)[list(used)]
    given = photometric or noise_sigma is not None or variance is not None
    choice = choose_channel(part, channel, name, request, given=given)
    told = Told(burst, part)
    if before is None:
        told, request = held_against_frames(burst, part, field, scale, request, chosen, choice)
    burst, part = told.burst, told.part
    seen: dict[str, Any] = {
        "scale": scale, "blur": undone(blur, response, chosen, lens_field), "shift_field": field,
        "noise_sigma": noise_sigma, "pixel_variance": variance,
    }  # fmt: skip
    if chosen.reads_response and not photometric and lens_field is None and before is None:
        response, request = as_seen(part, choice.channel, request, response, blur, seen)
        seen["blur"] = undone(blur, response, chosen, lens_field)
    settings = _settings(burst, seen, request, choice) | response | told.settings
    found, flying = _estimates(burst, part, choice.channel, chosen, request, seen)
    found = _objected(found, told.doubt, request.refuted, what_else(part, choice.channel, scale))
    return Reconstruction(
        found.get("amplitude"), found.get("distance"), burst.grid.refine(scale), scale, name,
        settings, flying, None if burst.intrinsics is None else burst.intrinsics.refine(scale),
    )  # fmt: skip


def _estimates(
    burst: Burst, part: Burst, channel: str, chosen: Method, request: Request, seen: dict[str, Any]
) -> tuple[dict[str, Estimate], Array | None]:
    """Reconstruct both channels from phasors, with what flies, or each on its own."""
    if channel == "phasor":
        both = reconstruct_phasor(burst, chosen.name, request, seen)
        return {"amplitude": both.amplitude, "distance": both.distance_m}, both.flying
    found: dict[str, Estimate] = {}
    for key, values in _channels(part, channel).items():
        problem = make_problem(
            part, values, even_noise=key != "distance", keep_outside=chosen.keep_outside,
            take_level=chosen.take_level and not request.non_negative,
            intensity=chosen.intensity, **seen,
        )  # fmt: skip
        if not (request.streamed or found):
            doubts = [overexposed(values, problem.clipped), cut_off(problem)]
            doubts += [doubt_about_noise(problem)] if chosen.name == "auto" else []
            for said in filter(None, doubts):
                warn_quality(said, 3)
        if key == "distance" and chosen.name == "auto" and seen["pixel_variance"] is None:
            problem = problem.with_brightness(part.amplitude)
        own = replace(request, law=None, still_std=0.0) if key == "distance" else request
        found[key] = _solve(burst, problem, chosen, own, seen["shift_field"])
        if key == "amplitude":
            bright = replace(own, photometric=True, law=None)
            again = partial(_solve, burst, problem, chosen, bright, seen["shift_field"])
            found[key] = in_one_light(found[key], values, part, request, again, stacklevel=3)
    return found, None


def _objected(
    found: dict[str, Estimate], doubt: Doubt | None, refuted: str | None, like_movement: str
) -> dict[str, Estimate]:
    """Warn once, where the user called, of what the frames say against the result."""
    notes, keys = [one.notes for one in found.values()], ("contradiction", "all_rejected")
    said = [refuted, *(one.get(key) for one in notes for key in keys)]
    for wrong in dict.fromkeys(text for text in said if text is not None):
        also = like_movement if "something moved" in wrong else ""
        warn_quality(f"{wrong}{also}", 3)
    blamed = any(estimate.status is Status.CONTRADICTED for estimate in found.values())
    named = doubt is not None and doubt.named  # of which the user was told
    if doubt is not None and not (named or blamed or refuted):  # nothing to blame it on
        warn_of_doubt(doubt, stacklevel=3)
    elif refuted is None and not named:
        return found
    return {
        key: one if one.status is Status.NOT_FINITE else replace(one, status=Status.CONTRADICTED)
        for key, one in found.items()
    }


def _solve(
    burst: Burst, problem: Problem, method: Method, request: Request, field: ShiftField | None
) -> Estimate:
    """Run the method and bring the estimate back to the units of the burst."""
    gain, bias = np.ones(len(problem.y)), np.zeros(len(problem.y))
    if request.photometric:
        gain, bias = estimate_photometry(problem.model.operator, problem.y, problem.telling_weight)
        problem = problem.with_photometry(gain, bias)
    estimate = method(problem, request)
    unit, level = problem.intensity, problem.level
    image = np.asarray(estimate.image) * unit + level
    fine = None if estimate.fine is None else estimate.fine * unit + level
    bias = bias * unit + level * (1.0 - gain)
    notes = dict(estimate.notes)
    if request.photometric:
        notes |= {"gain": gain.tolist(), "bias": bias.tolist()}
        if "contradiction" in notes:
            notes["contradiction"] = notes["contradiction"].replace(ESTIMATED, NOT_ENOUGH)
    std = estimate.uncertainty
    if isinstance(std, PropagatedStd):
        std = replace(std, unit=unit)
    elif std is not None:
        std = np.hypot(np.asarray(std) * unit, request.still_std)
        if (stray := problem.stray_light) is not None:
            std = np.hypot(std, unit * stray.std_of(np.asarray(estimate.image), problem.y)[0])
        if request.photometric and len(gain) > 1:
            std = np.hypot(std, std_of_level(image, gain, bias))
    return replace(
        estimate,
        image=image,
        fine=fine,
        uncertainty=std,
        noise_sigma=None if estimate.noise_sigma is None else estimate.noise_sigma * unit,
        predict=predictor(
            burst, problem, request.frames, image if fine is None else fine, field, gain, bias
        ),
        notes=notes,
    )


def _channels(burst: Burst, channel: str) -> dict[str, Array]:
    """Return the frames of each channel that is reconstructed on its own."""
    if channel == "distance" and burst.distance_m is None:
        raise ValueError("the burst has no distance_m; expected channel amplitude or auto")
    found = {}
    if channel in ("separate", "amplitude"):
        found["amplitude"] = burst.amplitude
    if channel in ("separate", "distance") and burst.distance_m is not None:
        stray = StrayLight.told(burst.meta.get("stray_light"))
        found["distance"] = distances_without(stray, burst)
    return found


def _frame_numbers(
    burst: Burst, frames: Sequence[int] | None, field: ShiftField | None
) -> tuple[int, ...]:
    numbers = tuple(int(k) for k in (range(burst.frame_count) if frames is None else frames))
    if burst.offset_source == "unknown" and field is None and len(numbers) > 1:
        problem = "nobody has said where the frames lie; lensshift.register finds it from them"
        raise DataError(problem, field="offset_px")
    if not numbers or min(numbers) < 0 or max(numbers) >= burst.frame_count:
        raise ValueError(f"expected frames from 0 to {burst.frame_count - 1}, got {list(numbers)}")
    if len(set(numbers)) != len(numbers):
        raise ValueError(f"expected each frame once, got {list(numbers)}")
    warn_of_blind_frames(burst, numbers, stacklevel=3)
    return numbers


def _parts(
    burst: Burst, used: tuple[int, ...], request: Request, field: ShiftField | None
) -> tuple[Burst, Burst, ShiftField | None]:
    """Return the burst without frames that tell nothing, what is used of it, and its field.

    Warns of what the frames can hardly be like; of those of a stream all that was done and said.
    """
    said: list[str] = []
    if not request.streamed:
        burst, said = measured(burst)
        for leaving_out in (without_blank, without_copies):
            burst, more = leaving_out(burst, used)
            said += more
    part = burst if used == tuple(range(burst.frame_count)) else burst.select(used)
    if not request.streamed:
        said.append(colour_mosaic(part.amplitude, part.valid))
    for text in filter(None, said):
        warn_quality(text, 3)
    return burst, part, None if field is None else field.select(used)


def _field_of(
    burst: Burst, shift_field: ShiftField | None, lens_field: LensField | None
) -> ShiftField | None:
    """Return what is known of each pixel of the whole burst."""
    if lens_field is None:
        if shift_field is not None:
            shift_field.check_belongs(burst.offset_px, burst.grid)
        return shift_field or burst.shift_field
    if not isinstance(lens_field, LensField):
        raise TypeError(
            f"expected a LensField, got {type(lens_field).__name__}; lensshift.load_lens_field "
            "reads one, lensshift.lens_field makes one"
        )
    if shift_field is not None or burst.affine is not None:
        other = "shift_field" if shift_field is not None else "a burst whose frames turn (affine)"
        raise ValueError(f"expected {other} or lens_field, got both")
    return lens_field.of(burst)


def _checked(
    burst: Burst, scale: int, noise_sigma: float | None, stray_light: StrayLight | None
) -> Burst:
    """Return the burst with the stray light that is told."""
    expect_burst(burst)
    if stray_light is not None:
        if not isinstance(stray_light, StrayLight):
            raise TypeError(f"expected StrayLight(share, sigma_px), got {stray_light!r:.60}")
        burst = replace(burst, meta={**burst.meta, "stray_light": stray_light.table})
    if noise_sigma is not None:
        positive().check("noise_sigma", noise_sigma)
    if isinstance(scale, bool | float) or scale not in range(1, 9):
        raise ValueError(f"expected a whole scale from 1 to 8, got {scale!r}")
    return burst


def _settings(
    burst: Burst, seen: dict[str, Any], request: Request, choice: Choice
) -> dict[str, Any]:
    cards = burst.meta.get("wcs")  # of the first frame, see `io.fits_file`
    sky = {"wcs": {"cards": cards, "offset_px": burst.offset_px[0].tolist()}} if cards else {}
    return {
        "blur": seen["blur"],
        "frames": list(request.frames),
        "prior_weight": request.prior_weight,
        "noise_sigma": seen["noise_sigma"],
        "non_negative": request.non_negative,
        "photometric": request.photometric,
        "shift_field": seen["shift_field"] is not None,
        "stray_light": burst.meta.get("stray_light"),
        "seed": request.seed,
        "device": None if request.device is None else request.device.name,
        **request.options,
        "channel": choice.channel,
        "channel_reason": choice.reason,
        **sky,
    }
