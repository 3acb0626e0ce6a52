"""Reasons to doubt an edge, each with its number."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lensshift.evaluation.slanted_edge.edge_model import Vector
from lensshift.evaluation.slanted_edge.noise_model import NOISELESS
from lensshift.evaluation.slanted_edge.result import EdgeResult, Profile

Numbers = NDArray[np.intp]

_LARGEST_GAP_PX = 0.25  # between the phases at which the lines cross the pixels
_CLIPPED_SHARE = 0.05
_SURELY = 4.0  # standard deviations of counts: less than one edge in 10^4 by chance
_LARGEST_ASYMMETRY = 0.005
_LARGEST_ALIASING_PX = 0.03
_LARGEST_APART_PX = 0.1  # rms: as a blur, it takes 2 % of the contrast at 0.3 cycles a pixel
_LEAST_BEND_PX = 0.05
_SECOND_SHARE = 0.2  # of the contrast, and of the slope; a ghost has a tenth
_LEVEL_SHARE = 0.1  # of the slope of a second rise: between two edges it falls so far
_LARGEST_TURN_DEG = 15.0  # from the middle of an edge to its ends; distortion turns far less
_LEAST_LINES = 8
_LARGEST_RISE = 0.5  # of the extent of the region across the edge
_FEWEST_LEVELS = 4
_MOST_UNSEEN = 0.1  # of the contrast: by how much a level may lie beyond all pixels
_MOST_LEFT_OUT = 0.2  # of the pixels: of three areas that meet, two edges remain
_FEWEST_BITS = 8
_NO_NOISE = 1e-6  # of the contrast: rounding to 16 bits alone is 4e-6


def doubted(
    result: EdgeResult, lines: int, gap_px: float, values: Vector, out: int = 0,
    apart_px: float = 0.0, lsf: Profile | None = None,
) -> EdgeResult:  # fmt: skip
    """Return the result with what speaks against it.

    Levels, clipping, how the lines cross the pixels and frames that do not lie on one another
    make an edge unusable; what its profile shows may be true of the whole image. `out` pixels stand
    out and were left out; from frame to frame the edge moves by `apart_px` beside the offsets.
    `lsf` is that of a model over the whole region.
    A low contrast or a small angle says nothing by itself: noise and phases do.
    """
    found = _shape(values, result, out, lsf)
    if result.dark + result.bright <= 0.0:
        found.append(
            f"the levels of the edge, {result.dark:.3g} and {result.bright:.3g}, are not positive: "
            "was too much of the black level taken off?"
        )
    found += _clipping(values, result)
    if lines < _LEAST_LINES:
        found.append(f"only {lines} lines cross the edge, expected {_LEAST_LINES} or more")
    # Two sides of a square look like one edge that bends: as a parabola, by so many degrees.
    turn_deg = math.degrees(math.atan(6.0 * 5.0**0.5 * result.bend_px / result.extent_px[0]))
    if turn_deg > _LARGEST_TURN_DEG:
        found.append(
            f"the edge turns by {turn_deg:.0f} degrees from its middle to its ends: does the "
            "region hold a corner, two sides of a square?"
        )
    if gap_px > _LARGEST_GAP_PX:
        found.append(
            f"the edge is tilted by {abs(np.rad2deg(result.angle_rad.value)):.2f} degrees: "
            f"its {lines} lines leave {gap_px:.2f} px of the pixel unsampled; take more lines or "
            "another angle"
        )
    if apart_px > _LARGEST_APART_PX:
        found.append(
            f"the edge moves by {apart_px:.2f} px rms from frame to frame beside the offsets: are "
            "these right, and of the right sign?"
        )
    usable = not found
    if out:
        found.append(f"{out} pixels stand out (hot, dead, dusty, of a corner) and are left out")
    if result.bend_px > _LEAST_BEND_PX:
        found.append(f"the edge is not straight: it bends by {result.bend_px:.2f} px rms")
    if min((asymmetry := result.asymmetry).low, asymmetry.value) > _LARGEST_ASYMMETRY:
        found.append(
            f"the edge profile is asymmetric by {100 * asymmetry.value:.1f} % of the contrast: "
            "is the response linear (no gamma)? A second edge, a ghost and coma show so, too"
        )
    if result.aliasing_px > _LARGEST_ALIASING_PX:
        found.append(
            f"the edge moves by {result.aliasing_px:.2f} px rms with the phase of the pixels: "
            "aliasing is left, rows are interlaced or pixels repeated; the MTF is not the lens's"
        )
    return replace(result, notes=tuple(found), usable=usable)


def _shape(values: Vector, result: EdgeResult, out: int, lsf: Profile | None) -> list[str]:
    """Of black and white alone, without plateaus or among others a profile is the model's own."""
    found = []
    share = out / max(out + values.size, 1)
    if share > _MOST_LEFT_OUT:
        found.append(
            f"{100 * share:.0f} % of the pixels belong to something else than this edge; choose a "
            "region around it alone"
        )
    count = np.unique(values).size
    if count < _FEWEST_LEVELS:
        found.append(f"the pixels have {count} levels only: the profile of the edge is lost")
    wide = result.extent_px[1]
    rise_px = result.rise_mm.value / result.pitch_mm
    if rise_px > _LARGEST_RISE * wide:
        found.append(
            f"the edge is {rise_px:.0f} px wide (10 to 90 %) in a region of {wide}: no plateau is "
            "seen; choose a wider region"
        )
    low, high = float(np.min(values)), float(np.max(values))
    unseen = max(low - result.dark, result.bright - high)
    if unseen > _MOST_UNSEEN * (result.bright - result.dark):
        found.append(
            f"the levels of the edge, {result.dark:.3g} and {result.bright:.3g}, lie beyond all "
            f"pixels ({low:.3g} to {high:.3g}): no plateau is seen; choose a wider region"
        )
    if lsf is not None and (apart_px := second_rise_px(lsf)):
        found.append(
            f"the edge rises twice, {apart_px:.1f} px apart, and is level in between: two edges, "
            "or a picture seen double; choose a region around one edge"
        )
    return found


def second_rise_px(lsf: Profile) -> float:
    """Return how far a second rise lies from the steepest one; 0 if there is none.

    Blur of one edge, of whatever shape, does not fall to nothing before it rises as much again.
    """
    place_px, slope = lsf.normal_px, lsf.value
    first, light = int(np.argmax(slope)), slope * np.gradient(place_px)
    for side in (np.s_[first:], np.s_[first::-1]):
        rise, beyond = slope[side], light[side][::-1].cumsum()[::-1]
        lowest = np.minimum.accumulate(rise)
        again = (rise >= _SECOND_SHARE * rise[0]) & (lowest <= _LEVEL_SHARE * rise)
        second = int(np.argmax(np.where(again, rise, 0.0)))
        between = int(np.argmin(rise[: second + 1]))
        if again.any() and beyond[between] >= _SECOND_SHARE * light.sum():
            return float(abs(place_px[side][second] - place_px[first]))
    return 0.0


def _clipping(values: Vector, result: EdgeResult) -> list[str]:
    """A clipped plateau holds its extreme value more often than the value next to it.

    That of noise is rarer than its neighbour. Where the noise is below the step between the two any
    value is frequent; then the extreme one must be the end of a range of whole numbers. Few pixels
    tell, too, where only the overshoot of a sharpened edge is cut off.
    """
    if result.noise < _NO_NOISE:
        return []  # computed, not taken: plateaus are level without being clipped
    found = []
    middle = 0.5 * (result.dark + result.bright)
    for side, name, end, inwards in (
        (values[values > middle], "bright", -1, -1),
        (values[values <= middle], "dark", 0, 1),
    ):
        levels, counts = np.unique(side, return_counts=True)
        if levels.size < 4:  # no noise to be cut off
            continue
        outer, step = levels[end], abs(levels[end + inwards] - levels[end])
        # What the model errs by passes for noise of a computed image.
        coarse = result.noise < max(step / (result.bright - result.dark), NOISELESS)
        half, bits = math.frexp(float(outer) + 1.0)  # of the largest number of 8 bits or more
        if coarse and outer not in (0.0, 1.0) and not (half == 0.5 and bits > _FEWEST_BITS):
            continue
        share, more = counts[end] / side.size, int(counts[end]) - int(counts[end + inwards])
        surely = more > _SURELY * np.sqrt(counts[end] + counts[end + inwards])
        if surely or (share > _CLIPPED_SHARE and more > 0):
            found.append(f"{100 * share:.0f} % of the {name} pixels are clipped at {outer:g}")
    return found


def largest_phase_gap_px(lines: Vector, angle_rad: float) -> float:
    """Return the largest gap between the phases of pixels at which lines [n] cross the edge."""
    phases = np.sort(np.unique(np.round(np.mod(lines * np.tan(angle_rad), 1.0), 9)))
    return float(np.max(np.diff(np.append(phases, phases[0] + 1.0))))


def displacement_px(residual: Vector, slope: Vector, group: Numbers, noise: float) -> float:
    """Return by how much the edge moves between groups [n] of pixels, rms over the groups.

        r_i = -m_g E'(d_i) + noise,   g the group of pixel i

    from residuals r and slopes E' [n] of the ESF per px. What noise alone makes is taken off the
    mean square.
    """
    weight = np.bincount(group, weights=slope**2)
    product = np.bincount(group, weights=slope * residual)
    used = weight > 1e-3 * weight.max()
    moved = product[used] / weight[used]
    moved = moved - np.average(moved, weights=weight[used])
    by_noise = noise**2 / weight[used]
    excess = float(np.mean(moved**2 - 3.0 * by_noise))
    return float(np.sqrt(max(excess, 0.0)))
