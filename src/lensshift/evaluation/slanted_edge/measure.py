"""Measure the MTF of slanted edges: one call for an image, a burst, one region or all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, fields
from typing import Any, Literal, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.errors import warn_quality
from lensshift.core.linear_algebra import one_thread
from lensshift.core.optical import MtfCurve
from lensshift.evaluation.slanted_edge.compression import steps_of
from lensshift.evaluation.slanted_edge.fit import LikelySettings
from lensshift.evaluation.slanted_edge.likely import measure_likely
from lensshift.evaluation.slanted_edge.prepare import EdgeFrames, take_frames
from lensshift.evaluation.slanted_edge.regions import find_regions
from lensshift.evaluation.slanted_edge.result import EdgeResult, Region, average_curves

Method = Literal["ml", "sfrmat3", "sfrmat5"]
METHODS: tuple[Method, ...] = ("ml", "sfrmat3", "sfrmat5")
_OPTIONS: dict[Method, tuple[str, ...]] = {
    "ml": tuple(one.name for one in fields(LikelySettings) if one.name != "jpeg_steps"),
    "sfrmat3": (),
    "sfrmat5": ("order", "window"),
}


class MethodOptions(TypedDict, total=False):
    """Options of `measure_edges` that only one method knows."""

    aperture_px: float | None
    most_bends: int
    tilt: bool | None
    noise_covariance: ArrayLike | None
    seed: int
    order: int
    window: Literal["tukey", "hamming"]


class EdgeOptions(MethodOptions, total=False):
    """Options of `measure_edges`."""

    method: Method
    region: Region | tuple[int, int, int, int] | None
    offset_px: ArrayLike | None
    valid: ArrayLike | None
    scale: int
    frequency_lpmm: ArrayLike | None
    jpeg_steps: ArrayLike | None


def slanted_edge_mtf(
    image: ArrayLike, pitch_mm: float | tuple[float, float] = 1.0, **options: Unpack[EdgeOptions]
) -> MtfCurve:
    """Measure the MTF along the normal of a slanted edge; see `measure_edges` for the options.

        MTF(f) = | F[LSF](f) | / F[LSF](0)

    Several usable edges are averaged, weighted by their variances.

    Parameters
    ----------
    image : [row col], or [frame row col] with `offset_px`
    pitch_mm : distance of the pixels, or (row, col); 1 gives cycles per pixel
    options : as in `measure_edges`

    Returns
    -------
    MtfCurve
        With standard deviation for the default method.

    Raises
    ------
    ValueError
        As in `measure_edges`.
    """
    return average_curves(measure_edges(image, pitch_mm, **options))


def measure_edge(
    image: ArrayLike, pitch_mm: float | tuple[float, float] = 1.0, **options: Unpack[EdgeOptions]
) -> EdgeResult:
    """Measure one slanted edge, the first that `measure_edges` returns."""
    return measure_edges(image, pitch_mm, **options)[0]


@one_thread()
def measure_edges(
    image: ArrayLike,
    pitch_mm: float | tuple[float, float] = 1.0,
    *,
    method: Method = "ml",
    region: Region | tuple[int, int, int, int] | None = None,
    offset_px: ArrayLike | None = None,
    valid: ArrayLike | None = None,
    scale: int = 1,
    frequency_lpmm: ArrayLike | None = None,
    jpeg_steps: ArrayLike | None = None,
    **options: Unpack[MethodOptions],
) -> list[EdgeResult]:
    """Measure every slanted edge of an image, usable ones first, of these the longest.

    The default method models all pixels of a region at once: a straight or bent edge, a line
    spread function that is a Gaussian seen by a square pixel of unknown fill plus a spline with
    a Gaussian process prior, levels and noise. Geometry, prior and noise maximise the restricted
    likelihood; weighted draws around that optimum give the intervals. There are no bins, no
    finite difference and no window.

    Parameters
    ----------
    image : [row col], or [frame row col] of one scene, fitted jointly
    pitch_mm : distance of the pixels, or (row, col); 1 gives cycles per pixel
    method : "ml", or the published algorithms "sfrmat3" and "sfrmat5" for comparison
    region : the edge, as (row start, row stop, col start, col stop); found by itself if None
    offset_px : [frame 2] how far the content moved in each frame, in pixels of the image
    valid : mask like `image`; pixels that are NaN are invalid as well
    scale : of a super-resolved image: its LR pixels are that many pixels wide
    frequency_lpmm : [f] where the curve is wanted; 0 to 1 cycles per pixel in steps of 0.01
        if None
    jpeg_steps : [8 8] quantisation table (row, col) of the JPEG that the image comes from, in
        levels of the image: what it cut off counts in the intervals, of which ml alone has some
    aperture_px : of ml: side of the largest pixel that the base of the LSF allows, in pixels of
        the image; `scale` by default. A smaller one is found if the image says so.
    most_bends : of ml: most bending terms of the edge, 4 by default; 0 keeps it straight
    tilt : of ml: whether the illumination is uneven; None lets the plateaus tell
    noise_covariance : of ml: [2 m + 1, 2 n + 1] of the noise at the lags (row, col), its variance
        in the middle, as `noise_autocovariance` returns; None lets the plateaus tell
    seed : of ml: of the draws
    order, window : of sfrmat5, which defaults to order 5 and the Tukey window

    Raises
    ------
    ValueError
        If there is no edge, a shape or an option does not fit, or the method does not know it.

    Source: restricted maximum likelihood after Patterson and Thompson, Biometrika 58 (1971) 545.
    """
    if method not in METHODS:
        raise ValueError(f"expected a method of {', '.join(METHODS)}, got {method!r}")
    if foreign := sorted(set(options) - set(_OPTIONS[method])):
        known = ", ".join(_OPTIONS[method]) or "none"
        raise ValueError(f"{method} does not know {', '.join(foreign)}; its options: {known}")
    given: dict[str, Any] = dict(options)
    steps = None if jpeg_steps is None else steps_of(jpeg_steps)
    if method == "ml":
        if given.get("aperture_px") is None:
            given["aperture_px"] = scale
        if given.get("noise_covariance") is not None:
            given["noise_covariance"] = np.asarray(given["noise_covariance"], dtype=float)
        likely = LikelySettings(**given, jpeg_steps=steps)
    else:
        from lensshift.evaluation.slanted_edge.sfrmat import measure_binned
    frames = take_frames(image, pitch_mm, offset_px=offset_px, valid=valid, scale=scale)
    places = [_given(region, frames)] if region is not None else find_regions(frames.first)
    wanted = None if frequency_lpmm is None else np.asarray(frequency_lpmm, dtype=np.float64)
    results = []
    for place in places:
        if method == "ml":
            result = measure_likely(frames, place, wanted, likely)
        else:
            result = measure_binned(frames, place, wanted, method, given)
        for doubt in result.notes:
            warn_quality(f"edge in {result.region}: {doubt}")
        results.append(result)
    return sorted(results, key=lambda one: (one.usable, one.extent_px[0]), reverse=True)


def _given(region: Region | Sequence[int], frames: EdgeFrames) -> Region:
    ends = astuple(region) if isinstance(region, Region) else tuple(region)
    if len(ends) != 4 or not all(float(end).is_integer() for end in ends):
        raise ValueError(
            f"expected a region of whole row start, row stop, col start, col stop, got {ends}"
        )
    place = Region(*map(int, ends))
    for name, part, most in zip(("rows", "columns"), place.slices, frames.first.shape, strict=True):
        if not 0 <= part.start < part.stop <= most:
            raise ValueError(f"expected {name} of the region within 0 to {most}, got {place}")
    return place
