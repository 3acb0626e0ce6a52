"""The pixel response of a burst: as told, unless frames object, as they show it, or a usual one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from numbers import Real
from typing import Any, Literal

import numpy as np

from lensshift.core.arrays import Array
from lensshift.core.errors import DataError
from lensshift.core.lens_field import LensField
from lensshift.core.optical import gaussian_width
from lensshift.core.phasors import has_phasors, phasor_frames
from lensshift.core.types import Burst, Reconstruction
from lensshift.forward.blur import ApertureBlur, Blur, GaussianBlur
from lensshift.reconstruction.clipping import silent_pixels
from lensshift.reconstruction.learned.noise import noise_map
from lensshift.reconstruction.learned.response import (
    ASSUMED_PX,
    SCALE,
    Response,
    known_widths_px,
    likely_response,
)
from lensshift.reconstruction.method import Method, Request
from lensshift.reconstruction.noise_law import NoiseLaw
from lensshift.reconstruction.phasor.frames import polar_frames
from lensshift.reconstruction.problem import (
    MOST_PIXELS,
    NOMINAL_BLUR_PX,
    SQUARE_PIXEL_PX,
    blur_width_px,
    make_problem,
    square_pixel,
    without_lens,
)

WidthSource = Literal["given", "burst", "frames", "assumed"]

# A variance: the learned solver sharpens beyond a square pixel by 0.4 to 1.4 % of the contrast at
# 0.2 to 0.43 cycles per pixel where there is no lens, as if the pixel were wider by so much. A
# spot that is not undone hides it; undone with a lens field it would add up.
SHARPENED_PX2 = 0.0037
# A width that is read counts where the frames have at least halved the spread of the widths that
# training drew (0.08 px), or say by two standard deviations that a square pixel is another. One
# that was told is right until they say by three that it is not.
TELLING_PX, REFUTED, OBJECTED = 0.04, 2.0, 3.0
# The width of a burst is that of a Gaussian of the same MTF50 at an edge. A square pixel has its
# MTF50 at 0.6034 cycles per pixel, sinc f = 1/2, so it was told as wider than it is by so much.
WIDER_BY_MTF50 = gaussian_width(0.6034) / SQUARE_PIXEL_PX
BYTES = 256
# Of few numbers all but chance is different, if they were measured finely.
ALL_DIFFER = 0.9
# Smaller frames hold no edge with both its sides.
LEAST_SIDE_PX = 6


def told_response(
    burst: Burst,
    psf_sigma_px: float | str | None,
    fill_factor: float | None,
    before: Reconstruction | None = None,
) -> dict[str, Any]:
    """Return the width of the blur in LR pixels, and where it is from; or that of a picture."""
    if before is not None:
        names = ("psf_sigma_px", "psf_source", "psf_std_px")
        return {name: before.settings[name] for name in names if name in before.settings}
    if isinstance(psf_sigma_px, str) and psf_sigma_px != "auto":
        raise ValueError(f"psf_sigma_px: expected a number or 'auto', got {psf_sigma_px!r}")
    if psf_sigma_px is not None and psf_sigma_px != "auto":
        return {"psf_sigma_px": psf_sigma_px, "psf_source": "given"}
    told = burst.meta.get("psf_sigma_px")
    if told is None or fill_factor is not None:  # that of the burst holds the pixel as well
        width_px = NOMINAL_BLUR_PX if fill_factor is None else 0.0
        return {"psf_sigma_px": width_px, "psf_source": "assumed"}
    if isinstance(told, bool) or not isinstance(told, Real):
        raise DataError(f"expected a number, got {told!r:.40}", field="meta.psf_sigma_px")
    error_px = burst.meta.get("psf_std_px")
    error = {"psf_std_px": float(error_px)} if isinstance(error_px, Real) else {}
    return {"psf_sigma_px": float(told), "psf_source": "burst"} | error


def as_seen(
    part: Burst,
    channel: str,
    request: Request,
    response: dict[str, Any],
    blur: Blur,
    seen: Mapping[str, Any],
) -> tuple[dict[str, Any], Request]:
    """Return the width that the frames of `part` show, if they show one; else the usual one.

    Of a response that was told: that, with what the frames say against it in the request. And the
    noise of the light that was found for it, unless it was known. Not to be asked where gains would
    look like edges, or spots vary.

    Parameters
    ----------
    channel : what is reconstructed
    response : as from `told_response`
    blur : the whole of it; a fill factor was always told
    seen : scale, blur, shift_field, noise_sigma and pixel_variance, as in `make_problem`,
        with what is undone if the frames do not tell; noise that may be that of distances says
        nothing of the light
    """
    if response["psf_source"] != "assumed" or isinstance(blur, ApertureBlur):
        return response, _questioned(part, channel, request, response, blur, seen)
    found, request = _found(part, channel, request, seen)
    refuted = abs(found.width_px - SQUARE_PIXEL_PX) > REFUTED * found.std_px
    if found.std_px > TELLING_PX and not refuted:
        return {"psf_sigma_px": NOMINAL_BLUR_PX, "psf_source": "assumed"}, request
    read = {"psf_sigma_px": found.width_px, "psf_source": "frames", "psf_std_px": found.std_px}
    return read, request


def _questioned(
    part: Burst,
    channel: str,
    request: Request,
    response: Mapping[str, Any],
    told: Blur,
    seen: Mapping[str, Any],
) -> Request:
    """Return the request with what the frames say against the response that was told, if they do.

    Of a response that is wider than any that the reader knows the frames have to say that they are
    as soft as the widest of these.
    """
    if part.distance_m is None or channel == "phasor":
        found, request = _found(part, channel, request, seen)
    elif has_phasors(part):  # An amplitude of two distances is no mean of theirs.
        light = dict(seen) | {"noise_sigma": None, "pixel_variance": None}
        found, _ = _found(part, "phasor", request, light)
    else:
        return request
    told_px, named = blur_width_px(told), ""
    least_px = told_px / (WIDER_BY_MTF50 if response["psf_source"] == "burst" else 1.0)
    nearest_px = np.clip(found.width_px, least_px, told_px)
    off_px = found.width_px - float(np.clip(nearest_px, *known_widths_px()))
    std_px = math.hypot(found.std_px, response.get("psf_std_px", 0.0))
    if isinstance(told, ApertureBlur):
        named = f"fill_factor {told.fill_factor:g}"
        if told.optics_sigma_px == 0:  # of the lens nothing was told
            off_px = min(off_px, 0.0)
    if abs(off_px) <= OBJECTED * std_px:
        return request
    named = named or f"psf_sigma_px {told_px:g}"
    refuted = (
        f"the frames are {'sharper' if off_px < 0 else 'softer'} than {named} lets them be: "
        f"they show {found.width_px:.2f} +- {found.std_px:.2f} LR pixels "
        f"(a square pixel has {SQUARE_PIXEL_PX:.2f})"
    )
    return replace(request, refuted=refuted)


def _found(
    part: Burst, channel: str, request: Request, seen: Mapping[str, Any]
) -> tuple[Response, Request]:
    """Return what the frames show, and their noise."""
    values, small = averaged(part, channel), min(part.grid.shape) < LEAST_SIDE_PX
    if small or request.shifts_doubted or _for_people(values):
        return Response(NOMINAL_BLUR_PX, np.inf), request
    found, law = _read(part, values, channel, seen)
    return found, replace(request, law=law)


def _read(
    part: Burst, values: Array, channel: str, seen: Mapping[str, Any]
) -> tuple[Response, NoiseLaw]:
    if part.distance_m is not None and channel not in ("amplitude", "phasor"):
        seen = dict(seen) | {"noise_sigma": None, "pixel_variance": None}
    problem = make_problem(part, values, take_level=values.dtype.kind != "c", **seen)
    law, _, noise = noise_map(problem)
    if problem.y.dtype.kind != "c":  # the end of what was filled in is no edge of the scene
        problem = replace(problem, clipped=silent_pixels(problem.y, problem.clipped))
    y, model = problem.y, replace(problem.model, blur=GaussianBlur(ASSUMED_PX)).on_grid(SCALE)
    if y.dtype.kind == "c":  # what lies along the mean phasor
        y = (y * np.exp(-1j * np.angle(np.sum(y)))).real
    return likely_response(model, y, problem.judging(noise)), law.scaled(
        problem.intensity, problem.level
    )


def _for_people(values: Array) -> bool:
    """Tell whether frames are bytes, as cameras for people give them.

    A tone curve, clipping and sharpening lie between a pixel and its byte, and edges look sharper
    than any pixel sees them: 0.19 px was read from a chart whose other frames 0.29 px predicts.
    """
    some = np.ravel(values)[:: max(1, values.size // MOST_PIXELS) | 1]
    different = np.unique(some).size
    return bool(different <= BYTES and different < ALL_DIFFER * some.size)


def averaged(part: Burst, channel: str) -> Array:
    """Return frames [frame row col] whose pixels average a scene: of phasors these."""
    if channel == "phasor" and part.phasors is not None:
        return phasor_frames(part)
    return polar_frames(part).phasor if channel == "phasor" else part.amplitude


def undone(
    blur: Blur, response: Mapping[str, Any], method: Method, lens_field: LensField | None
) -> Blur:
    """Return what the method undoes of a response; with a lens field that of the pixel alone."""
    if response["psf_source"] == "frames":
        blur = GaussianBlur(response["psf_sigma_px"])
    if lens_field is not None:
        told = response["psf_source"] != "assumed"
        blur = blur.widened(-lens_field.middle_px2) if told else square_pixel(blur)
        if not method.undoes_lens:
            return without_lens(blur).widened(-SHARPENED_PX2)
    return blur if method.undoes_lens else without_lens(blur)
