"""What a slanted edge tells: numbers with intervals, and the curves they were read off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensshift.core.optical import MtfCurve
from lensshift.core.showing import AsTable, Shown

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# MTF50 of a square pixel alone, in cycles per pixel: sinc(f) = 1/2.
_PIXEL_MTF50_CPP = 0.6033545644016142
_INTERVAL_SIGMAS = 3.92  # of a normal distribution in its 95 % interval
_LEAST_STD = 1e-6
_NO_STD = 1e-100  # its square exists
_STEPS = 50  # from 0 to the LR Nyquist frequency
_HALVINGS = 60  # to the last digit


@dataclass(frozen=True, slots=True)
class Interval:
    """A measured number with its 95 % interval.

    Parameters
    ----------
    value : the estimate; NaN where the curve never gets there
    low, high : ends of the interval; NaN where the method gives none
    """

    value: float
    low: float = float("nan")
    high: float = float("nan")

    def scaled(self, factor: float) -> Interval:
        """Return the number in another unit."""
        ends = sorted((self.low * factor, self.high * factor))
        return Interval(self.value * factor, ends[0], ends[1])

    def __str__(self) -> str:
        if not np.isfinite(self.value):
            return "not reached"
        if not (np.isfinite(self.low) and np.isfinite(self.high)):
            return f"{self.value:.4g}"
        return f"{self.value:.4g} ({self.low:.4g} to {self.high:.4g})"


def interval_of(values: Vector) -> Interval:
    """Return the estimate, first of [1 + k], with 95 % of the draws behind it; NaN is unreached."""
    value, draws = float(values[0]), values[1:]
    finite = draws[np.isfinite(draws)]
    if finite.size < 0.5 * draws.size or not draws.size:
        return Interval(value)
    low, high = np.quantile(finite, (0.025, 0.975))
    if finite.size < 0.975 * draws.size:
        high = float("inf")  # in some draws the curve never falls so low
    return Interval(value, float(low), float(high))


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """A function of the distance from the edge.

    Parameters
    ----------
    normal_px : [d] signed distance, positive on the bright side
    value : [d]
    std : [d] or None
    """

    normal_px: Vector
    value: Vector
    std: Vector | None = None


@dataclass(frozen=True, slots=True)
class Region:
    """Rows and columns of an image, the ends excluded."""

    row_start: int
    row_stop: int
    col_start: int
    col_stop: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Return the slices that cut the region out of an image."""
        return slice(self.row_start, self.row_stop), slice(self.col_start, self.col_stop)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and of columns."""
        return self.row_stop - self.row_start, self.col_stop - self.col_start

    @property
    def middle_px(self) -> tuple[float, float]:
        """Row and column of the middle, counted from that of the first pixel."""
        middle = self.row_start + self.row_stop - 1, self.col_start + self.col_stop - 1
        return 0.5 * middle[0], 0.5 * middle[1]

    def __str__(self) -> str:
        rows, cols = f"{self.row_start}:{self.row_stop}", f"{self.col_start}:{self.col_stop}"
        return f"rows {rows}, columns {cols}"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class EdgeResult(Shown, AsTable):
    """One measured edge.

    Parameters
    ----------
    method : how it was measured
    region : where
    orientation : "vertical" or "horizontal", the nearer axis
    angle_rad : of the edge against that axis
    position_px : where the edge crosses the region's middle, along the other axis, from the
        middle of the image's first pixel
    rising : whether the bright side is that of the higher columns (rows)
    bend_px : rms distance of the edge from its straight line
    dark, bright : levels of the plateaus
    noise : standard deviation of a pixel over the contrast
    snr : contrast over the standard deviation of a pixel
    mtf : curve along the edge normal with standard deviation
    low, high : [f] 95 % band of the curve, None where the method gives none
    mtf50_lpmm, mtf30_lpmm, mtf10_lpmm : where the curve first falls below 0.5, 0.3, 0.1
    nyquist_lpmm : the LR Nyquist frequency
    mtf_at_nyquist : modulation there
    area_to_nyquist : mean modulation from 0 to there
    peak : largest modulation; above 1 means sharpened
    effective_pixel_mm : side of the square pixel with the same MTF50
    rise_mm : 10-90 width of the ESF
    esf, lsf : edge and line spread function
    residual : [row col] pixels minus model over the contrast, NaN where unused; None without model
    aliasing_px : rms displacement of the edge between pixels of different phase, of even and odd
        ones at a scale of 1; NaN without a model
    asymmetry : largest departure of the ESF from point symmetry
    pitch_mm : along the edge normal
    notes : what speaks against the result
    usable : whether nothing among that spoils the MTF of this edge alone, see `average_curves`
    """

    method: str
    region: Region
    orientation: str
    angle_rad: Interval
    position_px: Interval
    rising: bool
    bend_px: float
    dark: float
    bright: float
    noise: float
    snr: float
    mtf: MtfCurve
    low: Vector | None
    high: Vector | None
    mtf50_lpmm: Interval
    mtf30_lpmm: Interval
    mtf10_lpmm: Interval
    nyquist_lpmm: float
    mtf_at_nyquist: Interval
    area_to_nyquist: Interval
    peak: Interval
    effective_pixel_mm: Interval
    rise_mm: Interval
    esf: Profile
    lsf: Profile
    residual: NDArray[np.float64] | None
    aliasing_px: float
    asymmetry: Interval
    pitch_mm: float
    notes: tuple[str, ...] = field(default=())
    usable: bool = True

    @property
    def sample_nyquist_lpmm(self) -> float:
        """The Nyquist frequency of the pixels of the image, along the normal of the edge."""
        return 0.5 / self.pitch_mm

    @property
    def beyond_nyquist(self) -> bool:
        """Whether MTF50 lies beyond it, where one image holds aliases only.

        The edge, slanted, is sampled finer than that; other content of the image is not.
        """
        return bool(self.mtf50_lpmm.value > self.sample_nyquist_lpmm)

    @property
    def extent_px(self) -> tuple[int, int]:
        """Length of the region along the edge, and across it."""
        rows, cols = self.region.shape
        return (rows, cols) if self.orientation == "vertical" else (cols, rows)

    @property
    def middle_px(self) -> tuple[float, float]:
        """Row and column of the edge halfway; its region may reach farther on one side."""
        row_px, col_px = self.region.middle_px
        at_px = self.position_px.value
        if not np.isfinite(at_px):  # a method that does not tell it
            return row_px, col_px
        return (row_px, at_px) if self.orientation == "vertical" else (at_px, col_px)

    @property
    def contrast(self) -> float:
        """Michelson contrast of the edge."""
        total = self.bright + self.dark
        return (self.bright - self.dark) / total if total > 0 else float("nan")


def steps_to(nyquist_cpp: float) -> Vector:
    """Return frequencies from 0 to the LR Nyquist frequency in even steps."""
    return np.linspace(0.0, nyquist_cpp, _STEPS + 1)


def numbers_of(
    frequency_cpp: Vector,
    modulation: Matrix,
    to_nyquist: Matrix,
    normal_px: Vector,
    esf: Matrix,
    pitch_mm: float,
) -> dict[str, Any]:
    """Return the numbers of an `EdgeResult` that its curves tell; columns as in `interval_of`.

    The curve [f k] as far as it is looked at; the modulation [n k] at `steps_to` the LR Nyquist
    frequency; the ESF [d k].
    """
    at = {}
    for level in (0.5, 0.3, 0.1):
        place_cpp = interval_of(crossings(frequency_cpp, modulation, level))
        at[f"mtf{round(100 * level)}_lpmm"] = place_cpp.scaled(1.0 / pitch_mm)
    half = at["mtf50_lpmm"]
    pixel = (_PIXEL_MTF50_CPP / one for one in (half.value, half.high, half.low))
    return at | {
        "mtf_at_nyquist": interval_of(to_nyquist[-1]),
        "area_to_nyquist": interval_of(np.asarray(np.trapezoid(to_nyquist, dx=1 / _STEPS, axis=0))),
        "peak": interval_of(modulation.max(axis=0)),
        "effective_pixel_mm": Interval(*pixel),
        "rise_mm": interval_of(rises(normal_px, esf)).scaled(pitch_mm),
    }


def crossings(frequency: Vector, modulation: NDArray[np.float64], level: float) -> Vector:
    """Return for each column [f k] where it first falls below `level`, NaN where it never does."""
    falls = (modulation[:-1] >= level) & (modulation[1:] < level)
    first = np.argmax(falls, axis=0)
    columns = np.arange(modulation.shape[1])
    above, below = modulation[first, columns], modulation[first + 1, columns]
    drop = np.where(above > below, above - below, 1.0)
    share = (above - level) / drop
    place = frequency[first] + share * (frequency[first + 1] - frequency[first])
    return np.where(falls.any(axis=0), place, np.nan)


def rises(normal_px: Vector, esf: NDArray[np.float64], share: float = 0.1) -> Vector:
    """Return the width from `share` to 1 - `share` of each column [d k], from the middle."""
    middle = int(np.argmin(np.abs(normal_px)))
    up = crossings(normal_px[middle:], -esf[middle:], share - 1.0)
    return up + crossings(-normal_px[middle::-1], esf[middle::-1], share)


def usable_edges(results: Sequence[EdgeResult]) -> list[EdgeResult]:
    """Return the edges whose MTF can be trusted; the first alone if there is none."""
    return [result for result in results if result.usable] or list(results[:1])


def average_curves(results: Sequence[EdgeResult]) -> MtfCurve:
    """Return the mean curve; edges count by their mean variance, so that the mean stays an MTF.

    Where edges differ by more than their errors, what they differ by is a part of each variance.

    Parameters
    ----------
    results : edges, of which `usable_edges` are taken; curves at other frequencies than the first
        one's are interpolated
    """
    results = usable_edges(results)
    if len(results) == 1:
        return results[0].mtf
    frequency_lpmm = results[0].mtf.frequency_lpmm

    def here(curve: MtfCurve, row: Vector) -> Vector:
        return np.interp(frequency_lpmm, curve.frequency_lpmm, row)

    values = np.stack([here(one.mtf, one.mtf.modulation) for one in results])
    known = [here(one.mtf, one.mtf.std) for one in results if one.mtf.std is not None]
    label = f"mean of {len(results)} slanted edges"
    if len(known) < len(results):
        return MtfCurve(frequency_lpmm, values.mean(axis=0), None, label)
    variances = _with_scatter(values, np.stack(known) ** 2 + _LEAST_STD**2)
    weights = 1.0 / variances.mean(axis=1)
    weights /= weights.sum()
    std = np.sqrt(weights**2 @ variances)
    return MtfCurve(frequency_lpmm, weights @ values, std, label)


def average_interval(numbers: Sequence[Interval]) -> Interval:
    """Return the mean of independent measurements with its 95 % interval.

    Where they differ by more than their errors, as over the field of a lens, that counts as well.
    Those that were not reached or have no interval are left out; if none has an interval, the
    plain mean is returned.

    Parameters
    ----------
    numbers : one for each edge
    """
    reached = [one for one in numbers if np.isfinite(one.value)]
    if not reached:
        return Interval(float("nan"))
    whole = [one for one in reached if np.isfinite(one.low) and np.isfinite(one.high)]
    if not whole:
        return Interval(float(np.mean([one.value for one in reached])))
    values = np.array([one.value for one in whole])
    std = np.array([(one.high - one.low) / _INTERVAL_SIGMAS for one in whole])
    std = np.maximum(std, 1e-12 * np.abs(values) + _NO_STD)
    weights = 1.0 / _with_scatter(values, std**2)
    mean = float(np.sum(weights * values) / np.sum(weights))
    half = 0.5 * _INTERVAL_SIGMAS / float(np.sqrt(np.sum(weights)))
    return Interval(mean, mean - half, mean + half)


def _with_scatter(values: Matrix, variances: Matrix) -> Matrix:
    """Return the variances of values [k ...] with that by which the quantities themselves differ.

        sum over k of (x_k - mean)^2 / (s_k^2 + t^2) = count - 1,   t = 0 if it is less even so

    Source: Paule and Mandel, J. Res. Natl. Bur. Stand. 87 (1982) 377.
    """
    least = np.zeros_like(values[0])
    most = np.sum((values - values.mean(axis=0)) ** 2, axis=0)
    for _ in range(_HALVINGS):
        middle = 0.5 * (least + most)
        weights = 1.0 / (variances + middle)
        rest = values - np.sum(weights * values, axis=0) / np.sum(weights, axis=0)
        more = np.sum(weights * rest**2, axis=0) > len(values) - 1
        least, most = np.where(more, middle, least), np.where(more, most, middle)
    return np.asarray(variances + most)
