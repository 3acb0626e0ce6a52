"""Gradient of an edge between two limits, on one line profile or on many."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from lensshift.core.arrays import Floats
from lensshift.core.errors import warn_quality
from lensshift.evaluation.inputs import check_finite, real_array
from lensshift.evaluation.limits import first_fall

Limits = Literal["range", "literal"]
Plateaus = Literal["median", "extremes"]

_STEEP_SHARE = 0.2  # of the steepest place of the line
_APART_PX = 3  # places nearer than this belong to one edge, so does the spike of a flying pixel
_LEAST_SHARE = 0.25  # of the largest step: more than the overshoot of a restoration
_LEAST_SIGMAS = 6.0
OF_NORMAL = 1.4826  # deviation of a normal distribution over its median absolute one
_MIN_SAMPLES = 4
_DRAWS = 1000
_BINS_PER_PX = 4
_MAX_PHASE_GAP_PX = 0.5  # a wider gap leaves whole samples of the averaged profile to guess


@dataclass(frozen=True, slots=True)
class ProfileEdge:
    """The edge of one profile; slopes are positive, `falling` tells the direction."""

    low: float  # values of the plateaus
    high: float
    low_limit: float  # values between which the slope is taken
    high_limit: float
    low_position_mm: float  # where the profile crosses the limits, from its first sample
    high_position_mm: float
    position_mm: float  # where it crosses the middle between the limits
    falling: bool

    @property
    def width_mm(self) -> float:
        """Distance between the limits: 10-90 % for a share of 0.1."""
        return abs(self.high_position_mm - self.low_position_mm)

    @property
    def slope_per_mm(self) -> float:
        """Slope between the limits, in units of the values per mm."""
        return (self.high_limit - self.low_limit) / self.width_mm

    @property
    def normalised_per_mm(self) -> float:
        """Slope divided by the difference of the plateaus, in 1/mm."""
        return self.slope_per_mm / (self.high - self.low)


@dataclass(frozen=True, slots=True, eq=False)
class EdgeGradient:
    """Gradient of an edge, line by line and of the profile averaged over the phases.

    Parameters
    ----------
    lines : the edge of each line
    averaged : the edge after the lines were laid onto one another, in four bins a pixel: the width
        to trust. The bins widen the edge of a bare pixel by 7 %, where the samples of one line
        widen it by half. None if the lines see too few positions of the edge within a pixel.
    mean_per_mm, median_per_mm : of the normalised slopes of the lines
    interval_per_mm : 95 % of the mean, from a bootstrap over the lines; None for one line
    """

    lines: tuple[ProfileEdge, ...]
    averaged: ProfileEdge | None
    mean_per_mm: float
    median_per_mm: float
    interval_per_mm: tuple[float, float] | None

    @property
    def slope_per_mm(self) -> Floats:
        """Slope of each line [line], in units of the values per mm."""
        return np.array([line.slope_per_mm for line in self.lines])

    @property
    def normalised_per_mm(self) -> Floats:
        """Slope of each line over the difference of its plateaus [line], in 1/mm."""
        return np.array([line.normalised_per_mm for line in self.lines])

    @property
    def width_mm(self) -> Floats:
        """Width of each line between the limits [line]."""
        return np.array([line.width_mm for line in self.lines])


@dataclass(frozen=True, slots=True)
class GradientRatio:
    """How much steeper one edge is than another; about the gain in resolution."""

    ratio: float  # of the means of the normalised slopes
    interval: tuple[float, float] | None  # 95 %, both sets of lines drawn apart; None for one line
    averaged: float | None  # of the slopes of the averaged profiles; None where one is missing


def edge_gradient(
    values: ArrayLike,
    *,
    step_mm: float,
    limits: Limits = "range",
    share: float = 0.10,
    plateaus: Plateaus = "median",
) -> EdgeGradient:
    """Measure the gradient of an edge between two limits.

        range:    low' = low + q (high - low),   high' = high - q (high - low)
        literal:  low' = (1 + q) low,            high' = (1 - q) high
        slope = (high' - low') / (x_high - x_low)

    with linear crossings between the samples. The source paper takes q = 0.10 for amplitudes and
    0.05 for distances; its words are the literal limits, which depend on an offset of the values
    and do not exist for small steps. The plateaus are by default the medians of the outer halves
    on both sides of the edge, because noise and the overshoot of a restoration move the extremes,
    which the paper takes. Slopes and widths are along the lines: multiply the width of a slanted
    edge by the cosine of its slant. Where two surfaces reflect unequally their distance edge is
    steeper than the resolution allows, for a pixel on both averages phasors and not metres.

    Parameters
    ----------
    values : [n] one profile, or [line n] lines across one straight edge; finite
    step_mm : spacing of the samples along a line
    limits : how the limits are reckoned
    share : q, above 0 and below 0.5
    plateaus : how the plateaus are found

    Raises
    ------
    ValueError
        If an argument is out of range, most lines cross more than one edge, the lines do not all
        rise or all fall, or a line has no edge or does not reach a limit.

    Warns
    -----
    QualityWarning
        If the lines see the edge at too few places within a pixel; a single line always does.

    Source: line profiles of the lens-shift paper (Advanced Optical Technologies); Efron and
    Tibshirani, An Introduction to the Bootstrap, 1993.
    """
    lines = _lines(values)
    _check(step_mm, limits, share, plateaus)
    refuse_two_edges(lines)
    place_mm = np.arange(lines.shape[1], dtype=np.float64) * step_mm
    edges = []
    for number, line in enumerate(lines):
        try:
            edges.append(profile_edge(place_mm, line, limits, share, plateaus))
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from error
    falling = sum(edge.falling for edge in edges)
    if falling not in (0, len(edges)):
        raise ValueError(
            f"expected one edge across all lines, got {falling} falling of {len(edges)} lines"
        )
    averaged = None
    if _phases_suffice([edge.position_mm / step_mm for edge in edges]):
        esf_mm, esf = _averaged_profile(lines, [edge.position_mm for edge in edges], step_mm)
        averaged = profile_edge(esf_mm, esf, limits, share, plateaus)
    slopes = np.array([edge.normalised_per_mm for edge in edges])
    interval = _interval(_mean_draws(slopes, seed=0)) if len(edges) > 1 else None
    middles = float(slopes.mean()), float(np.median(slopes))
    return EdgeGradient(tuple(edges), averaged, *middles, interval)


def gradient_ratio(fine: EdgeGradient, coarse: EdgeGradient) -> GradientRatio:
    """Compare the gradients of one edge in two images.

        ratio = mean_i s_fine,i / mean_j s_coarse,j,   s = slope / (high - low) in 1/mm

    Parameters
    ----------
    fine, coarse : of the same edge, measured with the same limits, for example the
        super-resolved image and one frame
    """
    interval = None
    if len(fine.lines) > 1 and len(coarse.lines) > 1:
        draws = _mean_draws(fine.normalised_per_mm, seed=0)
        interval = _interval(draws / _mean_draws(coarse.normalised_per_mm, seed=1))
    averaged = None
    if fine.averaged is not None and coarse.averaged is not None:
        averaged = fine.averaged.normalised_per_mm / coarse.averaged.normalised_per_mm
    return GradientRatio(fine.mean_per_mm / coarse.mean_per_mm, interval, averaged)


def profile_edge(
    place_mm: Floats, values: Floats, limits: Limits, share: float, plateaus: Plateaus
) -> ProfileEdge:
    """Measure the edge of a profile at rising places; ValueError if it does not reach a limit."""
    split = split_index(values)
    falling = bool(values[:split].mean() > values[split:].mean())
    if falling:
        place_mm, values, split = -place_mm[::-1], values[::-1], values.size - split
    low, high = _plateau_levels(values, split, plateaus)
    low_limit, high_limit = _limit_values(low, high, limits, share)
    above = np.flatnonzero(values[split:] >= high_limit)
    if above.size == 0:
        raise ValueError(
            f"expected an edge that reaches the high limit {high_limit:.6g}, "
            f"got at most {values[split:].max():.6g}"
        )
    below = np.flatnonzero(values[: split + above[0]] <= low_limit)
    if below.size == 0:
        raise ValueError(
            f"expected an edge that starts below the low limit {low_limit:.6g}, "
            f"got at least {values[: split + above[0]].min():.6g}"
        )
    start = int(below[-1])  # the last low sample before the edge
    middle = (low_limit + high_limit) / 2
    low_mm, middle_mm, high_mm = (
        first_fall(place_mm[start:], level - values[start:])
        for level in (low_limit, middle, high_limit)
    )
    sign = -1.0 if falling else 1.0
    places_mm = sign * low_mm, sign * high_mm, sign * middle_mm
    return ProfileEdge(low, high, low_limit, high_limit, *places_mm, falling)


def split_index(values: Floats) -> int:
    """Return where two constants fit best, by least squares: the first sample of the second one."""
    count = values.size
    first = np.arange(1, count)
    centred = values - values.mean()
    return int(np.argmax(np.cumsum(centred)[:-1] ** 2 / (first * (count - first)))) + 1


def steps_of(line: Floats) -> list[int]:
    """Return the samples after which the line steps from one level to another, but for noise."""
    jump = np.diff(line)
    steep = np.flatnonzero(np.abs(jump) > _STEEP_SHARE * np.abs(jump).max())
    groups = np.split(steep, np.flatnonzero(np.diff(steep) > _APART_PX) + 1)
    heights = [abs(line[group[-1] + 1] - line[group[0]]) for group in groups if group.size]
    noise = OF_NORMAL / np.sqrt(2.0) * float(np.median(np.abs(jump)))  # of a difference
    least = max(_LEAST_SHARE * max(heights, default=0.0), _LEAST_SIGMAS * noise)
    both = zip(groups, heights, strict=False)
    return [int(np.median(group)) for group, height in both if height > least]


def refuse_two_edges(lines: Floats) -> None:
    """Refuse lines [line n] most of which cross two edges or more; ValueError says where."""
    found = [steps_of(line) for line in lines]
    several = [steps for steps in found if len(steps) > 1]
    if 2 * len(several) > len(lines):
        places = " and ".join(str(place) for place in several[len(several) // 2])
        raise ValueError(
            f"expected one edge across the lines, got several in {len(several)} of {len(lines)} "
            f"lines, as after samples {places}; give a region around one of them"
        )


def _plateau_levels(values: Floats, split: int, plateaus: Plateaus) -> tuple[float, float]:
    if plateaus == "extremes":
        low, high = values.min(), values.max()
    else:
        # The inner halves may belong to a wide edge.
        low = np.median(values[: (split + 1) // 2])
        high = np.median(values[(split + values.size) // 2 :])
    if not low < high:
        raise ValueError(f"expected an edge, got plateaus of {low:.6g} and {high:.6g}")
    return float(low), float(high)


def _limit_values(low: float, high: float, limits: Limits, share: float) -> tuple[float, float]:
    if limits == "range":
        return low + share * (high - low), high - share * (high - low)
    low_limit, high_limit = (1 + share) * low, (1 - share) * high
    if not low_limit < high_limit:
        raise ValueError(
            f"expected a low limit below the high one, got {low_limit:.6g} and {high_limit:.6g}: "
            f"literal limits of {share:g} need low / high below {(1 - share) / (1 + share):.3f}, "
            f"here it is {low / high:.3f}; take limits='range'"
        )
    return low_limit, high_limit


def _phases_suffice(positions_px: list[float]) -> bool:
    """Warn if the edge falls on too few places within a pixel."""
    if len(positions_px) == 1:
        warn_quality(
            "one line profile cannot measure a gain of 2: depending on where the edge falls "
            "within a pixel two profiles give anything from 1.3 to 4; pass the lines across a "
            "slanted edge",
            stacklevel=3,
        )
        return False
    phases = np.sort(np.mod(_straight(np.array(positions_px)), 1.0))
    gap_px = float(np.max(np.diff(phases, append=phases[0] + 1.0)))
    if gap_px > _MAX_PHASE_GAP_PX:
        warn_quality(
            f"the edge leaves {gap_px:.2f} of a pixel unvisited in {len(positions_px)} lines: "
            "their slopes depend on where it falls; slant it more or take more lines",
            stacklevel=3,
        )
        return False
    return True


def _averaged_profile(
    lines: Floats, positions_mm: list[float], step_mm: float
) -> tuple[Floats, Floats]:
    """Lay the lines onto one another along the fitted edge and average in narrow bins."""
    count = lines.shape[1]
    offset_mm = _straight(np.array(positions_mm))
    place_mm = (np.arange(count) * step_mm - offset_mm[:, None]).ravel()
    bins = np.floor((place_mm - place_mm.min()) * (_BINS_PER_PX / step_mm)).astype(np.int64)
    _, bins, number = np.unique(bins, return_inverse=True, return_counts=True)  # the filled ones
    return np.bincount(bins, place_mm) / number, np.bincount(bins, lines.ravel()) / number


def _straight(positions: Floats) -> Floats:
    number = np.arange(positions.size)
    return np.asarray(np.polyval(np.polyfit(number, positions, 1), number))


def _mean_draws(slopes: Floats, seed: int) -> Floats:
    index = np.random.default_rng(seed).integers(slopes.size, size=(_DRAWS, slopes.size))
    return np.asarray(slopes[index].mean(axis=1))


def _interval(draws: Floats) -> tuple[float, float]:
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(low), float(high)


def _lines(values: ArrayLike) -> Floats:
    lines = real_array(np.atleast_2d(np.asarray(values)), "profile", "[line n]")
    if lines.shape[1] < _MIN_SAMPLES:
        raise ValueError(f"expected lines of at least {_MIN_SAMPLES} samples, got {lines.shape}")
    check_finite(lines)
    return lines


def _check(step_mm: float, limits: str, share: float, plateaus: str) -> None:
    if not (np.isfinite(step_mm) and step_mm > 0):
        raise ValueError(f"expected a positive step in mm, got {step_mm}")
    if not 0 < share < 0.5:
        raise ValueError(f"expected a share above 0 and below 0.5, got {share}")
    if limits not in ("range", "literal"):
        raise ValueError(f"expected limits 'range' or 'literal', got {limits!r}")
    if plateaus not in ("median", "extremes"):
        raise ValueError(f"expected plateaus 'median' or 'extremes', got {plateaus!r}")
