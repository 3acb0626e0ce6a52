"""How much finer one measurement of a target is than another, and what noise that costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lensshift.core.errors import warn_quality
from lensshift.evaluation.slanted_edge.result import EdgeResult, Interval, average_interval

_MAX_TURN_RAD = np.deg2rad(1.0)  # two measurements of one edge agree better than that
_SHARPENED = 1.0 + 1e-3  # 1 at frequency 0, but for the steps of the curve
_MAX_APART = 0.25  # of the length of an edge, between its middles in the two images
_MAX_ASIDE_PX = 1.0  # of the coarse image: frames of one burst lie nearer to one another


@dataclass(frozen=True, slots=True)
class ResolutionGain:
    """Ratios of two measurements of one edge; above 1 the first is finer.

    Parameters
    ----------
    mtf50, mtf10 : frequency of the fine one over that of the coarse one
    width : 10-90 width of the coarse one over that of the fine one
    noise : noise of the fine one over that of the coarse one, each over its contrast
    edges : number of edges behind the ratios
    """

    mtf50: Interval
    mtf10: Interval
    width: Interval
    noise: float
    edges: int = 1


def resolution_gain(fine: EdgeResult, coarse: EdgeResult) -> ResolutionGain:
    """Compare two measurements of one edge.

        R = a / b
        log R_low  = log R - sqrt( log^2(a / a_low)  + log^2(b_high / b) )
        log R_high = log R + sqrt( log^2(a_high / a) + log^2(b / b_low) )

    The two are taken as independent. A super-resolved image shares noise with the frame it is
    compared with; where that pushes both numbers the same way, the interval is too wide.

    Parameters
    ----------
    fine, coarse : of one edge, with the pitch of each in the same unit

    Warns
    -----
    QualityWarning
        If the edges differ in angle by more than a degree, in their bright side, or lie a coarse
        pixel aside of one another, so are hardly one target, or an image is sharpened: its MTF
        rises above 1 by more than its errors.

    Source: Donner and Zou, Statistical Methods in Medical Research 21 (2012) 347, for the interval.
    """
    turn_rad = abs(fine.angle_rad.value - coarse.angle_rad.value)
    if fine.orientation != coarse.orientation or turn_rad > _MAX_TURN_RAD:
        told = " and ".join(
            f"{edge.orientation} at {np.rad2deg(edge.angle_rad.value):.1f} degrees"
            for edge in (fine, coarse)
        )
        warn_quality(f"expected two measurements of one edge, got {told}")
    elif doubt := _other_picture(fine, coarse):
        warn_quality(doubt)
    for name, edge in (("finer", fine), ("coarser", coarse)):
        if edge.peak.low > _SHARPENED:
            warn_quality(
                f"the {name} image is sharpened, its MTF rises to {edge.peak}: the ratio tells of "
                "that, and not of what is resolved; ask a pattern (evaluate resolution)"
            )
    return ResolutionGain(
        mtf50=ratio_of(fine.mtf50_lpmm, coarse.mtf50_lpmm),
        mtf10=ratio_of(fine.mtf10_lpmm, coarse.mtf10_lpmm),
        width=ratio_of(coarse.rise_mm, fine.rise_mm),
        noise=fine.noise / coarse.noise,
    )


def _other_picture(fine: EdgeResult, coarse: EdgeResult) -> str:
    """Return how two edges of one angle tell that their images are not of one scene, or nothing."""
    if fine.rising != coarse.rising:
        return (
            "the edge is bright on one side in the finer image and on the other in the coarser "
            "one: is one of them inverted or mirrored?"
        )
    scale, turn_rad = coarse.pitch_mm / fine.pitch_mm, coarse.angle_rad.value
    along = 0 if coarse.orientation == "vertical" else 1
    line_px = (fine.region.middle_px[along] + 0.5) / scale - 0.5 - coarse.region.middle_px[along]
    there_px = coarse.position_px.value - line_px * np.tan(turn_rad)
    here_px = (fine.position_px.value + 0.5) / scale - 0.5
    aside_px = abs(here_px - there_px) * np.cos(turn_rad)
    if aside_px > _MAX_ASIDE_PX:  # not of methods that do not tell the place
        return (
            f"the edge lies {aside_px:.1f} px of the coarser image aside in the finer one: do both "
            "show the whole scene (none cropped, or shifted against the other)?"
        )
    return ""


def ratio_of(above: Interval, below: Interval) -> Interval:
    """Return the ratio of two independent positive numbers with its 95 % interval."""
    if not (above.value > 0 and below.value > 0):
        return Interval(float("nan"))
    value = above.value / below.value
    with np.errstate(divide="ignore", invalid="ignore"):
        down = np.hypot(*np.log([above.value / above.low, below.high / below.value]))
        up = np.hypot(*np.log([above.high / above.value, below.value / below.low]))
        return Interval(value, float(value * np.exp(-down)), float(value * np.exp(up)))


def average_gain(gains: Sequence[ResolutionGain]) -> ResolutionGain:
    """Return the geometric mean over edges, each ratio weighted by its variance.

    Parameters
    ----------
    gains : at least one; ratios that were not reached are left out

    Raises
    ------
    ValueError
        If there is none.
    """
    if not gains:
        raise ValueError("expected at least one gain, got none")
    ratios = zip(*((gain.mtf50, gain.mtf10, gain.width) for gain in gains), strict=True)
    mtf50, mtf10, width = map(_geometric_mean, ratios)
    noise = float(np.exp(np.mean([np.log(gain.noise) for gain in gains])))
    return ResolutionGain(mtf50, mtf10, width, noise, len(gains))


def pair_edges(
    fine: Sequence[EdgeResult], coarse: Sequence[EdgeResult], scale: float
) -> list[tuple[EdgeResult, EdgeResult]]:
    """Return the edges that both images show, as (fine, coarse): the usable ones if there are any.

    Parameters
    ----------
    fine, coarse : edges of two images of one scene
    scale : pixels of the fine image per pixel of the coarse one
    """
    pairs = []
    left = list(fine)
    for there in coarse:
        middle_px, length_px = np.array(there.middle_px), there.extent_px[0]
        apart = [
            float(np.hypot(*((np.array(here.middle_px) + 0.5) / scale - 0.5 - middle_px)))
            + (0.0 if here.orientation == there.orientation else np.inf)
            for here in left
        ]
        if apart and min(apart) <= _MAX_APART * length_px:
            pairs.append((left.pop(int(np.argmin(apart))), there))
    return [pair for pair in pairs if pair[0].usable and pair[1].usable] or pairs


def _geometric_mean(ratios: Sequence[Interval]) -> Interval:
    reached = [ratio for ratio in ratios if np.isfinite(ratio.value)]
    if len(reached) < 2:
        return reached[0] if reached else Interval(float("nan"))
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = [Interval(*np.log([one.value, one.low, one.high]).tolist()) for one in reached]
    mean = average_interval(logs)
    return Interval(*np.exp([mean.value, mean.low, mean.high]).tolist())
